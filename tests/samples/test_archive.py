"""Archives of columns: that they keep everything, and what is refused."""

import dataclasses
import json
import random
import struct
import subprocess
import sys
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.samples import archive
from potmesil_mi.samples.columns import COLUMNS
from scenes import overscanned, synthetic

COUNT = 300


@pytest.fixture(autouse=True)
def short_frames(monkeypatch):
    """Columns of a few samples have several frames, the last of them shorter."""
    monkeypatch.setattr(archive, "FRAME", 128)


@pytest.fixture
def saved(tmp_path):
    """A small archive."""
    path = tmp_path / "a.samples"
    synthetic(COUNT).save(path)
    return path


def entries_of(path):
    with zipfile.ZipFile(path) as file:
        return {entry.filename: file.read(entry) for entry in file.infolist()}


def write_entries(path, entries, compression=zipfile.ZIP_STORED):
    """An archive with the right checksums, whatever is in it."""
    with zipfile.ZipFile(path, "w", compression) as file:
        for name, data in entries.items():
            file.writestr(zipfile.ZipInfo(name), data, compression)


def edited(path, **changes):
    """Put other values in a JSON text: ``lens={"f_number": 3}``; ``None`` takes one out."""
    entries = entries_of(path)
    for name, values in changes.items():
        kept = json.loads(entries[f"{name}.json"]) | values
        kept = {key: value for key, value in kept.items() if value is not None}
        entries[f"{name}.json"] = json.dumps(kept).encode()
    write_entries(path, entries)


def refused(path, text):
    """Loading must end in a ValueError that names the file and says ``text``."""
    with pytest.raises(ValueError, match=text) as caught:
        pm.PointSamples.load(path)
    assert str(path) in str(caught.value)


def assert_equal(loaded, samples):
    """Every bit of every column, in the same order, and all else."""
    for field in COLUMNS:
        here, there = getattr(loaded, field.name), getattr(samples, field.name)
        if there is None:
            assert here is None, field.name
        else:
            assert here.dtype == there.dtype
            assert here.shape == there.shape
            assert here.tobytes() == there.tobytes(), field.name
            assert here.flags.writeable == there.flags.writeable
    for name in (
        "camera",
        "lens",
        "surfaces",
        "lattice",
        "window",
        "visibility_radius",
        "aov_names",
    ):
        assert getattr(loaded, name) == getattr(samples, name), name


# ---------------------------------------------------------------- what survives


def with_everything():
    """Samples that have every column, and numbers that are easily lost."""
    rng = np.random.default_rng(5)
    samples = overscanned(1000)
    return samples.replace(
        rgb=np.where(rng.random((1000, 3)) < 0.1, -1e-40, samples.rgb),
        z=np.where(rng.random(1000) < 0.1, np.inf, samples.z),
        surface=rng.integers(0, 2**32, 1000, np.uint32),
        layer=rng.choice(np.array([0, 1, 240, 255], np.uint8), 1000),
        through=rng.choice([0.0, 1.5], 1000),
        visibility=rng.integers(0, 2**64, 1000, np.uint64),
        visibility_radius=(0.1, 0.2),
        aovs=rng.choice([0.0, np.nan, np.inf, 1e-40, -7.0], (1000, 63)),
        aov_names=tuple(f"{i:b}.é" + "x" * 190 for i in range(63)),
        surfaces={2**32 - 1: "Fläche", 7: "", 8: '"{\n'},
        lattice=4,
    )


def telecentric():
    samples = synthetic(COUNT)
    camera = dataclasses.replace(
        samples.camera, x_fov=0.0, projection="orthographic", film_width=2.0
    )
    return samples.replace(camera=camera, lens=pm.TelecentricLens(5.0, 2.0))


def through_a_picture():
    samples = synthetic(COUNT)
    aperture = pm.ImageAperture(np.array([[65535, 1000], [30_000, 7]]) / 65535)
    return samples.replace(lens=samples.lens.replace(aperture=aperture, focus_distance=np.inf))


@pytest.mark.parametrize(
    "make",
    [lambda: synthetic(1), lambda: synthetic(128), with_everything, telecentric, through_a_picture],
)
def test_everything_survives_bit_for_bit_and_in_order(tmp_path, make):
    samples = make()
    samples.save(tmp_path / "a.samples")
    assert_equal(pm.PointSamples.load(tmp_path / "a.samples"), samples)


def test_an_archive_has_the_columns_that_the_samples_have(tmp_path):
    """So a new column needs no code here."""
    for name, samples in {"few.samples": synthetic(9), "ALL.SAMPLES": with_everything()}.items():
        samples.save(tmp_path / name)
        columns = {n for n in entries_of(tmp_path / name) if not n.endswith(".json")}
        assert columns == {field.name for field in samples.present()}


@pytest.mark.usefixtures("variant_llvm")
def test_an_archive_and_a_deep_exr_give_the_same_picture(tmp_path):
    samples = overscanned(3000)
    pictures = []
    for name in ("a.samples", "a.exr"):
        samples.save(tmp_path / name)
        pictures.append(np.array(pm.focus(pm.PointSamples.load(tmp_path / name))))
    np.testing.assert_allclose(*pictures, rtol=1e-5, atol=1e-6)


def test_bits_that_are_alike_take_little_room(tmp_path, monkeypatch):
    """Samples come by pixel: the first bits of a position are those of the one before."""
    monkeypatch.undo()
    places = np.sort(synthetic(50_000).x)
    samples = synthetic(50_000, x=places, weight=np.full(50_000, 1 / 16))
    samples.save(tmp_path / "a.samples")
    with zipfile.ZipFile(tmp_path / "a.samples") as file:
        sizes = {entry.filename: entry.file_size for entry in file.infolist()}
    assert sizes["weight"] < 0.02 * samples.weight.nbytes
    assert sizes["x"] < 0.7 * samples.x.nbytes


@pytest.mark.parametrize("which", archive.ZSTD_COLUMNS)
def test_columns_of_one_number_are_not_taken_for_damage(tmp_path, monkeypatch, which):
    """Nothing is smaller than what a reader believes."""
    monkeypatch.undo()
    count = 1 << 17
    samples = synthetic(count, **{which: np.full(count, 0.5)})
    samples.save(tmp_path / "a.samples")
    assert_equal(pm.PointSamples.load(tmp_path / "a.samples"), samples)


def test_archives_are_the_same_whatever_process_wrote_them(tmp_path):
    code = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "from scenes import synthetic; synthetic(200).save(sys.argv[2])"
    )
    for name in ("a.samples", "b.samples"):
        subprocess.run(
            [sys.executable, "-c", code, str(Path(__file__).parents[1]), str(tmp_path / name)],
            check=True,
        )
    assert (tmp_path / "a.samples").read_bytes() == (tmp_path / "b.samples").read_bytes()


def test_a_failed_save_leaves_the_old_archive_and_nothing_else(saved, monkeypatch):
    whole = saved.read_bytes()

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(archive, "_pack", interrupted)
    with pytest.raises(KeyboardInterrupt):
        synthetic(50).save(saved)
    assert saved.read_bytes() == whole
    assert list(saved.parent.iterdir()) == [saved]


@pytest.mark.parametrize(
    ("surfaces", "error"), [({-1: "a"}, ValueError), ({"1": "a"}, TypeError), ({1: 2}, TypeError)]
)
def test_names_that_cannot_be_loaded_are_not_saved(tmp_path, surfaces, error):
    with pytest.raises(error, match="surfaces"):
        synthetic(5).replace(surfaces=surfaces).save(tmp_path / "a.samples")
    assert not list(tmp_path.iterdir())


# ---------------------------------------------------------------- what is not trusted


@pytest.mark.parametrize("data", [b"", b"no archive", b"PK\3\4", b"v/1\1" + bytes(100)])
def test_what_is_no_archive_is_refused(tmp_path, data):
    (tmp_path / "a.samples").write_bytes(data)
    refused(tmp_path / "a.samples", "is not an archive of samples")


def test_a_missing_archive_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nothing\.samples"):
        pm.PointSamples.load(tmp_path / "nothing.samples")


def test_an_archive_that_ends_too_early_is_refused(saved):
    whole = saved.read_bytes()
    for length in range(0, len(whole), 97):
        saved.write_bytes(whole[:length])
        refused(saved, "truncated|damaged")


def test_a_changed_byte_is_found(saved):
    """By the checksum of its entry; elsewhere it changes nothing, such as a date."""
    samples, whole = synthetic(COUNT), saved.read_bytes()
    changed = found = 0
    for place in range(0, len(whole), 23):
        data = bytearray(whole)
        data[place] ^= 1 << place % 8
        saved.write_bytes(data)
        changed += 1
        try:
            assert_equal(pm.PointSamples.load(saved), samples)
        except ValueError as error:
            assert str(saved) in str(error)  # noqa: PT017
            found += 1
    assert found > 0.8 * changed


def test_frames_with_the_right_checksum_are_not_trusted(saved):
    """They are refused, or hold other numbers; no memory is read that is not theirs."""
    entries, chance = entries_of(saved), random.Random(1)
    columns = [name for name in entries if not name.endswith(".json")]
    refusals = 0
    for _ in range(300):
        name = chance.choice(columns)
        data = bytearray(entries[name])
        for _ in range(chance.choice([1, 4])):
            place = chance.randrange(min(len(data), chance.choice([20, len(data)])))
            data[place] = chance.randrange(256)
        write_entries(saved, {**entries, name: bytes(data)})
        try:
            assert len(pm.PointSamples.load(saved)) == COUNT
        except ValueError as error:
            assert str(saved) in str(error)  # noqa: PT017
            refusals += 1
    assert refusals > 100


@pytest.mark.parametrize(
    ("field", "value"), [("rgb", np.nan), ("z", np.nan), ("z", -1), ("weight", 0), ("x", np.inf)]
)
def test_samples_that_no_program_saves_are_damage(saved, field, value):
    entries = entries_of(saved)
    column = np.array(getattr(synthetic(COUNT), field))
    column[[3, 200]] = value
    parts = [column[i : i + archive.FRAME] for i in range(0, COUNT, archive.FRAME)]
    frames = [archive._pack(field, part) for part in parts]
    write_entries(saved, {**entries, field: b"".join(frames)})
    refused(saved, f"2 of {COUNT} samples have")


@pytest.mark.parametrize(
    ("text", "changes", "message"),
    [
        ("samples", {"version": 2}, "version 2: must be 1$"),
        ("samples", {"version": True}, "version True: must be 1$"),
        ("samples", {"lattice": -1}, "lattice=-1"),
        ("samples", {"more": 1}, "samples.json: must be a JSON object with lattice, version"),
        ("samples", {"visibility_radius": [1, 1]}, "visibility_radius"),
        ("samples", {"aov_names": ["a"]}, r"aov_names=\['a'\]: has 1 names, must have 0"),
        ("samples", {"aov_names": 7}, "aov_names=7: must be a sequence of names"),
        ("samples", {"aov_names": "a"}, "aov_names='a': must be a sequence of names"),
        ("samples", {"aov_names": {"a": 1}}, "aov_names=.*: must be a sequence of names"),
        ("samples", {"aov_names": [["a"]]}, r"\['a'\] must be text"),
        ("samples", {"aov_names": ["a", "b", "a"]}, "aov_names=.*: 'a' is there twice"),
        ("samples", {"aov_names": [""]}, "aov_names=.*: '' must be printable"),
        ("samples", {"aov_names": ["a\0"]}, "aov_names=.*: .* must be printable"),
        ("samples", {"aov_names": ["é" * 101]}, "must be printable, of 1 to 200 bytes"),
        ("samples", {"aov_names": [*map(str, range(64))]}, "64 names, must have at most 63"),
        ("columns", {"aovs": {"dtype": "<f4", "shape": [COUNT, 64]}}, "columns.json: aovs: is"),
        ("lens", {"f_number": 1e300}, "f_number=1e"),
        ("lens", {"aperture": "image:filename=/etc/passwd"}, "must not name another"),
        ("camera", {"x_fov": 0}, "x_fov=0"),
        ("window", {"left": 0.5}, r"window\[0\]=0.5"),
        ("window", {"width": 1}, "crop window"),
        ("window", {"width": None}, "window.json: must be a JSON object with left"),
        ("surfaces", {"-1": "a"}, "surfaces.json: id '-1': must be 0 to 4294967295"),
        ("surfaces", {"9999999999": "a"}, "surfaces: id=9999999999"),
        ("surfaces", {"²": "a"}, "surfaces.json: id '²'"),
        ("surfaces", {"1": ["a"]}, r"surfaces\[1\]=\['a'\]: must be text"),
        ("columns", {"x": None}, "columns.json: must have the shape of x"),
        ("columns", {"x": {"dtype": "<f4", "shape": []}}, "columns.json: must have the shape of x"),
        ("columns", {"x": {"dtype": "<f8", "shape": [COUNT]}}, "columns.json: x: is .*<f8.*<f4"),
        ("columns", {"x": {"dtype": "|O", "shape": [COUNT]}}, r"columns.json: x: is .*\|O"),
        ("columns", {"x": {"dtype": "<f4", "shape": [COUNT - 1]}}, "columns.json: y: is .*300"),
        ("columns", {"x": {"dtype": "<f4", "shape": [0]}}, "number of samples=0: must be 1"),
        ("columns", {"x": {"dtype": "<f4", "shape": ["9"]}}, "number of samples='9'"),
        ("columns", {"rgb": {"dtype": "<f4", "shape": [COUNT, 4]}}, "rgb: is .*4.*must be .*3"),
        ("columns", {"z": None}, "columns.json: z: is None"),
        ("columns", {"heat": {"dtype": "<f4", "shape": [COUNT]}}, "heat: is .*must be None"),
        (
            "columns",
            {"through": {"dtype": "<f4", "shape": [COUNT]}},
            "is damaged: it has no column through",
        ),
    ],
)
def test_texts_are_data_of_a_known_form(saved, text, changes, message):
    edited(saved, **{text: changes})
    refused(saved, message)


@pytest.mark.parametrize("data", [b"", b"[1]", b"\xff", b"[" * 100_000, b"{'a': 1}"])
@pytest.mark.parametrize("name", ["camera", "window", "columns"])
def test_a_text_that_is_no_json_object_is_named(saved, name, data):
    write_entries(saved, entries_of(saved) | {f"{name}.json": data})
    refused(saved, f"{name}.json: ")


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("lens.json", None, "does not hold point samples: it has no lens.json"),
        ("z", None, "is damaged: it has no column z"),
        ("setup.py", b"print()", "holds 'setup.py', which is not of this version"),
    ],
)
def test_entries_are_those_of_samples(saved, name, data, message):
    entries = {**entries_of(saved), name: data}
    write_entries(saved, {n: value for n, value in entries.items() if value is not None})
    refused(saved, message)


def test_entries_that_are_packed_or_there_twice_are_refused(saved):
    """A packed one may be far larger than the file."""
    entries = entries_of(saved)
    write_entries(saved, entries, zipfile.ZIP_DEFLATED)
    refused(saved, "is not stored once, as is")
    write_entries(saved, entries)
    with zipfile.ZipFile(saved, "a") as file, pytest.warns(UserWarning, match="Duplicate"):
        file.writestr("z", entries["z"])
    refused(saved, "entry 'z' is not stored once, as is")


def claimed(frame, unpacked=None, packed=None):
    """A frame whose head says other sizes."""
    width, real, block, length = archive.FRAME_HEADER.unpack_from(frame)
    head = struct.pack("<BIII", width, unpacked or real, block, packed or length)
    return frame[:3] + head + frame[16:]


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data[:10],
        lambda data: data[:-1],
        lambda data: data + bytes(16),
        lambda data: claimed(data, unpacked=1 << 31),
        lambda data: claimed(data, unpacked=8),
        lambda data: claimed(data, packed=1 << 31),
        lambda data: claimed(data, packed=8),
    ],
)
def test_frames_say_no_sizes_but_their_own(saved, change):
    entries = entries_of(saved)
    write_entries(saved, entries | {"z": change(entries["z"])})
    refused(saved, "damaged")


@pytest.mark.parametrize("count", [10**7, 1 << 40, 1 << 60])
def test_memory_is_taken_only_as_the_size_of_the_archive_justifies(saved, count):
    columns = json.loads(entries_of(saved)["columns.json"])
    for about in columns.values():
        about["shape"][0] = count
    edited(saved, columns=columns)
    tracemalloc.start()
    refused(saved, "a.samples: ")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1 << 22
