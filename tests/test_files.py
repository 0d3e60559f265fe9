"""Files that are written whole or not at all, and what is there already."""

import os
import signal
import stat
import subprocess
import sys
import time

import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi._files import require_readable, require_writable, written_whole
from potmesil_mi._image import write_picture
from potmesil_mi.cli import main
from scenes import SCENES, synthetic

PICTURE = np.ones((4, 6, 3))


def dead_process():
    """The number of a process that is no more."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def test_a_file_keeps_its_mode(tmp_path):
    path = tmp_path / "a.png"
    path.touch(0o640)
    path.chmod(0o604)
    write_picture(PICTURE, path)
    assert stat.S_IMODE(path.stat().st_mode) == 0o604
    assert path.stat().st_size > 0


@pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="only root may give files away")
def test_a_file_keeps_its_owner_as_far_as_that_is_allowed(tmp_path):
    path = tmp_path / "a.png"
    path.touch()
    os.chown(path, 1234, 4321)
    write_picture(PICTURE, path)
    assert (path.stat().st_uid, path.stat().st_gid) == (1234, 4321)


@pytest.mark.parametrize("ending", [".exr", ".png", ".samples"])
def test_a_link_stays_one_and_what_it_leads_to_is_replaced(tmp_path, ending):
    (tmp_path / "elsewhere").mkdir()
    target, link = tmp_path / "elsewhere" / f"real{ending}", tmp_path / f"link{ending}"
    target.write_text("old")
    link.symlink_to(target)
    if ending == ".samples":
        synthetic(20).save(link)
    else:
        write_picture(PICTURE, link)
    assert link.is_symlink()
    assert target.read_bytes() != b"old"
    assert sorted(of.name for of in (tmp_path / "elsewhere").iterdir()) == [target.name]


def test_missing_folders_are_made(tmp_path):
    path = tmp_path / "deep" / "deeper" / "a.samples"
    synthetic(20).save(path)
    assert len(pm.PointSamples.load(path)) == 20
    stored = str(path)
    picture = tmp_path / "other" / "a.png"
    assert main(["focus", stored, "-o", str(picture)]) == 0
    assert picture.is_file()


def test_what_killed_programs_left_is_removed_and_what_others_write_stays(tmp_path):
    path = tmp_path / "a.b.png"
    left = tmp_path / f".a.b.{dead_process()}.png"
    running, unlike = tmp_path / ".a.b.1.png", tmp_path / ".a.b.12x.png"
    other = tmp_path / f".c.{dead_process()}.png"
    for file in (left, running, unlike, other):
        file.write_text("half")
    write_picture(PICTURE, path)
    assert not left.exists()
    assert path.is_file()
    assert all(file.is_file() for file in (running, unlike, other))


def test_errors_name_the_file_that_was_asked_for(tmp_path):
    path = tmp_path / "a.png"

    def write():
        with written_whole(path) as temporary:
            temporary.write_bytes(b"half")
            raise OSError(f"no room for {temporary}, that is {temporary.name}")

    with pytest.raises(OSError, match=rf"^no room for {path}, that is a\.png$"):
        write()
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_is_full_for_a_library_is_an_os_error(tmp_path):
    path = tmp_path / "a.exr"

    def write():
        with written_whole(path):
            raise RuntimeError("no space left")

    with pytest.raises(OSError, match=rf"^{path}: no space left$"):
        write()


def test_places_where_no_file_can_be_are_named(tmp_path):
    (tmp_path / "file").touch()
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "loop.png").symlink_to(tmp_path / "loop.png")
    for place, error, text in (
        ("file/a.png", NotADirectoryError, "is in a file"),
        ("pipe.png", OSError, "not a file that can be replaced"),
        ("a\0.png", ValueError, "not the name of a file"),
        ("n" * 300 + ".png", OSError, "too long"),
    ):
        with pytest.raises(error, match=text):
            require_writable(f"{tmp_path}/{place}", (".png",))
    for place, error, text in (
        ("pipe.png", OSError, "can be read from its end"),
        ("a\0.png", ValueError, "not the name of a file"),
        ("loop.png", OSError, r"loop\.png: .*symbolic links"),
        ("none.png", FileNotFoundError, "there is no such file"),
    ):
        with pytest.raises(error, match=text):
            require_readable(f"{tmp_path}/{place}")


def test_the_picture_is_written_even_where_the_samples_cannot_be(tmp_path, capsys, monkeypatch):
    def full(self, path):
        raise OSError(f"{path}: No space left on device")

    monkeypatch.setattr(pm.PointSamples, "save", full)
    samples, picture = tmp_path / "a.samples", tmp_path / "a.png"
    scene = ["render", str(SCENES / "figure11.xml"), "-D", "res=8", "--spp", "1"]
    assert main([*scene, "-o", str(picture), "--samples", str(samples)]) == 1
    written, error = capsys.readouterr().err.splitlines()
    assert written.startswith(f"potmesil: wrote {picture}: 8x8")
    assert error == f"potmesil: error: {samples}: No space left on device"
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]


WRITES = """
import sys, time
from pathlib import Path
from potmesil_mi import cli
from potmesil_mi._files import written_whole

class Slowly:
    def run(arguments):
        with written_whole(Path(arguments[0])) as temporary:
            temporary.write_text("half")
            print("writing", flush=True)
            time.sleep(60)

sys.modules["potmesil_mi.cli.program"] = Slowly
sys.exit(cli.main(sys.argv[1:]))
"""


@pytest.mark.parametrize(
    ("name", "code"), [("SIGTERM", 143), ("SIGINT", 130), ("SIGHUP", 129), ("SIGKILL", -9)]
)
def test_a_program_that_is_ended_leaves_the_old_file_and_nothing_else(tmp_path, name, code):
    path = tmp_path / "a.png"
    path.write_text("old")
    command = [sys.executable, "-c", WRITES, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as program:
        assert program.stdout.readline() == b"writing\n"
        time.sleep(0.1)
        program.send_signal(getattr(signal, name))
        _, said = program.communicate(timeout=30)
    assert program.returncode == code
    assert b"Traceback" not in said
    assert path.read_text() == "old"
    assert len(list(tmp_path.iterdir())) == (2 if name == "SIGKILL" else 1)
    write_picture(PICTURE, path)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("error", [KeyError("a"), ZeroDivisionError(), MemoryError(), ValueError()])
def test_an_error_that_nobody_expected_is_a_line_too(monkeypatch, capsys, error):
    def fails(_):
        raise error

    monkeypatch.setattr("potmesil_mi.cli.program.run", fails)
    assert main([]) == 1
    said = capsys.readouterr().err
    assert said.startswith("potmesil: error: ")
    assert said.count("\n") == 1
    assert type(error).__name__ in said or "not enough memory" in said
    monkeypatch.setenv("POTMESIL_TRACEBACK", "1")
    with pytest.raises(type(error)):
        main([])
