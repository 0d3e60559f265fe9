"""What would take more memory than there is is refused before it begins, with what takes less."""

import functools
import subprocess
import sys

import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi import _memory
from potmesil_mi.cli import main
from potmesil_mi.focusing.memory import BYTES_OF_SUBPIXEL, COVERED, memory_of_focus
from potmesil_mi.tracing.memory import BYTES_OF_RAY, memory_of_sampling
from potmesil_mi.tracing.patterns import visible_count
from scenes import SCENES, still_life, synthetic

FIGURE = str(SCENES / "figure11.xml")


@pytest.mark.parametrize(
    ("text", "size"), [("4G", 4 << 30), ("500 MB", 500 << 20), ("1.5GiB", 3 << 29), ("1000", 1000)]
)
def test_sizes_are_read_as_people_write_them(text, size):
    assert _memory.size_in_bytes("max_memory", text) == size


@pytest.mark.parametrize("text", ["", "much", "-1G", "0", "4X", "nan", "1e9"])
def test_what_is_no_size_is_refused_by_name(text, tmp_path, capsys):
    with pytest.raises(ValueError, match=rf"max_memory={text}: must be a size"):
        _memory.size_in_bytes("max_memory", text)
    arguments = ["render", FIGURE, "-o", str(tmp_path / "a.png"), f"--max-memory={text}"]
    assert main(arguments) == 1
    assert "max_memory=" in capsys.readouterr().err


def group(folder, **files):
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name.replace("__", ".")).write_text(text)


def system(tmp_path, monkeypatch, available=8 << 20, cgroup="0::/job"):
    monkeypatch.delenv(_memory.VARIABLE, raising=False)
    monkeypatch.setattr(_memory, "PROCESS", tmp_path / "proc")
    monkeypatch.setattr(_memory, "GROUPS", tmp_path / "groups")
    monkeypatch.setattr(_memory, "_of_limit", lambda: None)
    group(tmp_path / "proc", meminfo=f"MemTotal: 1 kB\nMemAvailable:   {available} kB\n")
    group(tmp_path / "proc" / "self", cgroup=cgroup + "\n")


def test_what_is_free_is_the_least_of_machine_and_control_groups(tmp_path, monkeypatch):
    system(tmp_path, monkeypatch)
    assert _memory.free_memory() == 8 << 30
    groups = tmp_path / "groups"
    rest = {"memory__current": str(3 << 30), "memory__stat": f"anon 1\ninactive_file {1 << 30}\n"}
    group(groups / "job", memory__max="max", **rest)
    assert _memory.free_memory() == 8 << 30
    group(groups / "job", memory__max=str(5 << 30), **rest)
    assert _memory.free_memory() == 3 << 30
    group(groups, memory__max=str(4 << 30), **rest)
    assert _memory.free_memory() == 2 << 30
    group(groups, memory__max=str(1 << 30), **rest)
    assert _memory.free_memory() == 0
    monkeypatch.setenv(_memory.VARIABLE, "7G")
    assert _memory.free_memory() == 7 << 30


def test_control_groups_of_version_1_count_too(tmp_path, monkeypatch):
    system(tmp_path, monkeypatch, cgroup="4:cpu,memory:/job")
    group(
        tmp_path / "groups" / "memory" / "job",
        memory__limit_in_bytes=str(4 << 30),
        memory__usage_in_bytes=str(1 << 30),
        memory__stat=f"total_inactive_file {1 << 29}\n",
    )
    assert _memory.free_memory() == (3 << 30) + (1 << 29)


def test_where_nothing_tells_what_is_free_nothing_is_refused(tmp_path, monkeypatch):
    monkeypatch.delenv(_memory.VARIABLE, raising=False)
    monkeypatch.setattr(_memory, "PROCESS", tmp_path / "proc")
    monkeypatch.setattr(_memory, "_of_limit", lambda: None)
    assert _memory.free_memory() is None
    _memory.require_memory(1e30, "all", "nothing")


LIMITED = """
import resource
from potmesil_mi._memory import free_memory
resource.setrlimit(resource.RLIMIT_AS, (1 << 31, 1 << 31))
assert 0 < free_memory() < 1 << 31
"""


def test_a_limit_of_the_address_space_counts():
    assert subprocess.run([sys.executable, "-c", LIMITED], check=False).returncode == 0


def test_sampling_and_focusing_say_what_they_would_take(variant_llvm, monkeypatch):
    scene, samples = still_life(), synthetic(100)
    monkeypatch.setenv(_memory.VARIABLE, "100M")
    with pytest.raises(MemoryError, match=r"sampling .* samples each .* about 0\.3 GB.*\(spp\)"):
        pm.render_samples(scene)
    monkeypatch.setenv(_memory.VARIABLE, "1M")
    with pytest.raises(MemoryError, match=r"focusing 20x14 pixels on 4x4 .* fewer squares"):
        pm.focus(samples, method="lightfield", squares=4)
    monkeypatch.setenv(_memory.VARIABLE, "100M")
    pm.focus(samples, method="lightfield", squares=4)


def test_what_sampling_would_take_counts_its_samples_and_their_columns(variant_llvm):
    scene = still_life()
    samples = pm.render_samples(scene, sampling=pm.Sampling(overscan=40, features=True))
    crop, window, spp = samples.crop_window, samples.window, 4
    take = functools.partial(memory_of_sampling, crop, window, spp)
    plain = pm.Sampling(layers=1, refine=0)
    count = visible_count(crop, window, spp, plain)
    assert count < window.size * spp  # Far from the crop window cells are larger.
    assert count == int((samples.layer == 0).sum()) - spp * crop.size // 4
    more = pm.Sampling(layers=1, refine=1)
    of_sample = synthetic(100).nbytes / 100
    expected = crop.size * spp * (of_sample + BYTES_OF_RAY)
    assert take(more, False) - take(plain, False) == pytest.approx(expected)
    features = take(pm.Sampling(layers=1, refine=0, features=True), False)
    assert features - take(plain, False) == pytest.approx(24 * count)
    assert take(plain, True) > take(plain, False)


def test_what_a_focus_would_take_counts_subpixels_hidden_samples_and_points_of_the_lens():
    few, many = synthetic(100), synthetic(400)
    behind = few.replace(layer=np.ones(100, np.uint8))
    method = pm.Layered(lens_points=32, squares=1)
    layered = memory_of_focus(few, method)
    assert memory_of_focus(few, pm.Layered(lens_points=32), 1) == layered
    finer = memory_of_focus(few, pm.Layered(squares=2))
    assert finer - layered > 3 * BYTES_OF_SUBPIXEL * few.window.size
    assert memory_of_focus(behind, method) == layered + COVERED * 32 * 100
    for method in (pm.Layered(squares=1), pm.LightField(squares=1), pm.Equation20()):
        assert memory_of_focus(many, method) > memory_of_focus(few, method)
    points = memory_of_focus(few, pm.Layered(lens_points=64, squares=1))
    assert points > memory_of_focus(few, pm.Layered(lens_points=32, squares=1))


def test_a_large_picture_ends_in_a_line_before_it_is_sampled(tmp_path, capsys):
    size = ["-D", "res=2000", "--spp", "1000"]
    arguments = ["render", FIGURE, *size, "-o", str(tmp_path / "a.png"), "--max-memory", "4G"]
    assert main(arguments) == 1
    said = capsys.readouterr().err
    assert "there is not enough memory: sampling 2138x2138 pixels" in said
    assert "and 4.3 GB are free" in said
    assert list(tmp_path.iterdir()) == []
