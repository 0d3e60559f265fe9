"""Deep EXR files: what survives them, what other readers find, what is refused."""

import base64
import dataclasses
import json
import os
import struct
import subprocess
import sys
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

import potmesil_mi as pm
from potmesil_mi.samples import deep_exr, exr_layout
from potmesil_mi.samples.raster import Window
from scenes import overscanned, papers_scene, pinhole_mean, synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")

BROKEN = Path(__file__).parents[3] / "shared" / "cases" / "broken"


# ---------------------------------------------------------------- what survives a file


@pytest.mark.parametrize("pattern", ["sampler", "uniform", "adaptive"])
def test_a_saved_file_gives_the_same_picture(tmp_path, pattern):
    samples = pm.render_samples(papers_scene(48), spp=4, sampling=pm.Sampling(pattern))
    samples.save(tmp_path / "samples.exr")
    loaded = pm.PointSamples.load(tmp_path / "samples.exr")
    assert loaded.lens == samples.lens
    assert loaded.camera == samples.camera
    assert loaded.surfaces == samples.surfaces == {1: "background", 2: "cube", 3: "sphere"}
    assert loaded.lattice == samples.lattice
    np.testing.assert_allclose(
        np.array(pm.focus(loaded)), np.array(pm.focus(samples)), rtol=1e-5, atol=1e-6
    )


def assert_same_samples(loaded, samples):
    assert loaded.camera == samples.camera
    assert loaded.lens == samples.lens
    assert loaded.window == samples.window
    assert loaded.surfaces == samples.surfaces
    assert len(loaded) == len(samples)
    here, there = (np.lexsort([s.z, s.y, s.x]) for s in (loaded, samples))
    for name in ("x", "y", "z", "surface", "weight", "alpha", "layer"):
        np.testing.assert_array_equal(getattr(loaded, name)[here], getattr(samples, name)[there])
    np.testing.assert_allclose(loaded.rgb[here], samples.rgb[there], rtol=3e-7)


def test_every_column_survives_a_file(tmp_path):
    samples = synthetic(3000, alpha=np.arange(3000) % 3 / 2)
    samples = samples.replace(z=np.where(np.arange(3000) % 7, samples.z, np.inf))
    samples.save(tmp_path / "samples.exr")
    assert_same_samples(pm.PointSamples.load(tmp_path / "samples.exr"), samples)


def test_what_is_known_of_windows_survives_a_file(tmp_path):
    rng = np.random.default_rng(5)
    samples = synthetic(
        3000,
        layer=rng.choice(np.array([0, 1, 255], np.uint8), 3000),
        through=rng.choice([0.0, 1.5], 3000),
        visibility=rng.integers(0, 2**64, 3000, np.uint64),
        visibility_radius=(0.1, 0.2),
    )
    samples.save(tmp_path / "samples.exr")
    loaded = pm.PointSamples.load(tmp_path / "samples.exr")
    assert_same_samples(loaded, samples)
    assert loaded.visibility_radius == (0.1, 0.2)
    here, there = (np.lexsort([s.z, s.y, s.x]) for s in (loaded, samples))
    for name in ("through", "visibility"):
        np.testing.assert_array_equal(getattr(loaded, name)[here], getattr(samples, name)[there])
    # As the header says it: low bits first.
    with OpenEXR.File(str(tmp_path / "samples.exr"), separate_channels=True) as file:
        channels = file.parts[0].channels
        low, high = (
            np.concatenate([v for v in channels[name].pixels.ravel() if v is not None])
            for name in ("potmesil.visibility0", "potmesil.visibility1")
        )
    words = np.sort(low.astype(np.uint64) | high.astype(np.uint64) << np.uint64(32))
    np.testing.assert_array_equal(words, np.sort(samples.visibility[samples.layer == 0]))


@pytest.mark.parametrize("radius", [[0.1], [0.1, -1.0], "wide", 5, [0.1, 1e300]])
def test_half_widths_of_a_lens_in_a_file_are_not_trusted(tmp_path, radius):
    path = tmp_path / "samples.exr"
    synthetic(50, visibility=np.ones(50, np.uint64), visibility_radius=(0.1, 0.1)).save(path)
    edited(path, "samples", visibility_radius=radius)
    with pytest.raises(ValueError, match="visibility_radius"):
        pm.PointSamples.load(path)


def test_features_survive_a_file_in_channels_that_others_know(tmp_path):
    rng = np.random.default_rng(3)
    normal = rng.normal(size=(2000, 3))
    samples = overscanned(2000).replace(
        albedo=rng.random((2000, 3)), normal=normal / np.linalg.norm(normal, axis=1)[:, None]
    )
    samples.save(tmp_path / "samples.exr")
    loaded = pm.PointSamples.load(tmp_path / "samples.exr")
    assert_same_samples(loaded, samples)
    here, there = (np.lexsort([s.z, s.y, s.x]) for s in (loaded, samples))
    for name in ("albedo", "normal"):
        np.testing.assert_array_equal(getattr(loaded, name)[here], getattr(samples, name)[there])
    with OpenEXR.File(str(tmp_path / "samples.exr"), separate_channels=True) as file:
        for part in file.parts:
            assert {"albedo.R", "albedo.G", "albedo.B", "N.X", "N.Y", "N.Z"} <= part.channels.keys()
    synthetic(50).save(tmp_path / "plain.exr")
    assert pm.PointSamples.load(tmp_path / "plain.exr").albedo is None


@pytest.mark.parametrize("margin", [0, 5, 60])
def test_layers_and_window_survive_a_file(tmp_path, margin):
    samples = overscanned(margin=margin)
    x = samples.x.copy()
    x[0] = -1e-9  # relative to the left edge of its pixel, float32 would round it to 0
    samples = samples.replace(x=x)
    samples.save(tmp_path / "samples.exr")
    assert_same_samples(pm.PointSamples.load(tmp_path / "samples.exr"), samples)


@pytest.mark.parametrize("layer", [0, 255])
def test_samples_of_one_layer_survive_a_file(tmp_path, layer):
    samples = overscanned(500)
    samples = samples.replace(layer=np.full(500, layer))
    samples.save(tmp_path / "samples.exr")
    assert_same_samples(pm.PointSamples.load(tmp_path / "samples.exr"), samples)


def test_hidden_surfaces_of_a_scene_survive_a_file(tmp_path):
    samples = pm.render_samples(papers_scene(48), spp=4)
    assert (samples.layer > 0).any()
    assert samples.window[0] < 0
    samples.save(tmp_path / "samples.exr")
    assert_same_samples(pm.PointSamples.load(tmp_path / "samples.exr"), samples)


@pytest.mark.parametrize(
    "samples", [synthetic(5000, alpha=np.arange(5000) % 2), overscanned(15_000)]
)
def test_flattening_the_deep_pixels_gives_the_pinhole_picture(tmp_path, samples):
    samples.save(tmp_path / "samples.exr")
    with OpenEXR.File(str(tmp_path / "samples.exr"), separate_channels=True) as file:
        channels = {name: file.channels()[name].pixels for name in ("R", "G", "B", "A", "Z")}
    expected = pinhole_mean(samples, whole=True)
    width = samples.window[2]
    visible = samples.visible()
    for y, x in [(0, 0), (7, 11), (13, 19), (expected.shape[0] - 1, width - 1)]:
        assert (np.diff(channels["Z"][y, x]) >= 0).all()
        colour, clear = np.zeros(3), 1.0
        for i, alpha in enumerate(channels["A"][y, x]):
            colour += clear * np.array([channels[c][y, x][i] for c in "RGB"])
            clear *= 1 - alpha
        here = visible.pixel() == y * width + x
        assert len(channels["A"][y, x]) == here.sum() > 0
        weight, coverage = visible.weight[here], visible.alpha[here]
        np.testing.assert_allclose(colour, expected[y, x], rtol=1e-5)
        assert 1 - clear == pytest.approx(np.average(coverage, weights=weight), abs=1e-5)


def test_hidden_samples_are_in_a_part_of_their_own(tmp_path):
    samples = overscanned()
    samples.save(tmp_path / "samples.exr")
    samples.visible().save(tmp_path / "visible.exr")

    def parts(name):
        with OpenEXR.File(str(tmp_path / name), separate_channels=True) as file:
            return {
                part.name(): {n: c.pixels.ravel() for n, c in part.channels.items()}
                for part in file.parts
            }

    both, one = parts("samples.exr"), parts("visible.exr")
    assert list(both) == ["visible", "hidden"]
    assert list(one) == ["visible"]
    for name, pixels in one["visible"].items():
        for pixel, other in zip(pixels, both["visible"][name], strict=True):
            np.testing.assert_array_equal(pixel, other)
    assert set(both["hidden"]) - set(both["visible"]) == {"potmesil.layer"}
    layers = np.concatenate(list(both["hidden"]["potmesil.layer"]))
    np.testing.assert_array_equal(np.sort(layers), np.sort(samples.layer[samples.layer > 0]))
    assert all((np.diff(z) >= 0).all() for z in both["hidden"]["Z"])


def test_the_data_window_is_what_was_sampled(tmp_path):
    overscanned(500).save(tmp_path / "samples.exr")
    with OpenEXR.File(str(tmp_path / "samples.exr"), header_only=True) as file:
        headers = [dict(file.header(part)) for part in range(2)]
    for header in headers:
        np.testing.assert_array_equal(header["displayWindow"], [[0, 0], [39, 29]])
        np.testing.assert_array_equal(header["dataWindow"], [[-3, -2], [26, 21]])
        assert [e.id() for e in header["idManifest"][0]] == [1, 2, 3]


def rewritten(path, **attributes):
    """Write the first part of a file anew with other attributes of the header."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        header = dict(file.header())
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    header = {n: v for n, v in header.items() if n not in ("channels", "name")} | attributes
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))


def text_of(path, name):
    with OpenEXR.File(str(path), header_only=True) as file:
        return json.loads(file.header()[name])


def edited(path, name, **changes):
    """Write a file anew with other values in the JSON of ``potmesil:name``; None takes one out."""
    values = text_of(path, f"potmesil:{name}") | changes
    values = {key: value for key, value in values.items() if value is not None}
    rewritten(path, **{f"potmesil:{name}": json.dumps(values)})


def as_version(path, version):
    """Write the file anew as one of another version: 1 had positions relative to the pixel.

    Before version 3 the lens's film was its image_distance.
    """
    with OpenEXR.File(str(path), separate_channels=True) as file:
        header = dict(file.header())
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    about = {**json.loads(header["potmesil:samples"]), "version": version}
    header = {n: v for n, v in header.items() if n not in ("channels", "name")}
    header["potmesil:samples"] = json.dumps(about)
    if version < 3:
        lens = json.loads(header["potmesil:lens"])
        lens["image_distance"] = lens.pop("film")
        header["potmesil:lens"] = json.dumps(lens)
    left, top = header["dataWindow"][0]
    for y, x in np.ndindex(channels["Z"].shape) if version == 1 else ():
        for name, start in (("potmesil.x", x + left), ("potmesil.y", y + top)):
            channels[name][y, x] = channels[name][y, x] - np.float32(start)
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))


@pytest.mark.parametrize("version", [1, 2])
def test_files_of_earlier_versions_are_loaded(tmp_path, version):
    samples = synthetic(2000, camera=overscanned(1).camera)
    lens = samples.lens.replace(film="focused")
    samples = samples.replace(x=samples.x + 2, y=samples.y + 3, lens=lens)
    samples.save(tmp_path / "samples.exr")
    as_version(tmp_path / "samples.exr", version)
    loaded = pm.PointSamples.load(tmp_path / "samples.exr")
    assert loaded.window == (2, 3, 20, 14)
    assert_same_samples(loaded, samples)


@pytest.mark.parametrize("version", [0, 4, True, "2", None])
def test_files_of_an_unknown_version_are_refused(tmp_path, version):
    synthetic(200).save(tmp_path / "samples.exr")
    about = json.dumps({"version": version, "lattice": 0})
    rewritten(tmp_path / "samples.exr", **{"potmesil:samples": about})
    with pytest.raises(ValueError, match=rf"version {version}: must be 1, 2 or 3"):
        pm.PointSamples.load(tmp_path / "samples.exr")


def test_the_header_says_what_other_readers_look_for(tmp_path):
    camera = pm.Camera((40, 30), (5, 6), (20, 14), 40.0, synthetic(1).camera.to_world)
    samples = synthetic(500, camera=camera)
    samples = samples.replace(x=samples.x + 5, y=samples.y + 6)
    samples.save(tmp_path / "samples.exr")
    with OpenEXR.File(str(tmp_path / "samples.exr"), header_only=True) as file:
        header = dict(file.header())
    assert header["type"] == OpenEXR.deepscanline
    np.testing.assert_array_equal(header["displayWindow"], [[0, 0], [39, 29]])
    np.testing.assert_array_equal(header["dataWindow"], [[5, 6], [24, 19]])
    assert header["aperture"] == 2
    assert header["focus"] == 2
    assert {e.id(): e.text() for e in header["idManifest"][0]} == {
        1: ["one"],
        2: ["two"],
        3: ["three"],
    }
    assert pm.PointSamples.load(tmp_path / "samples.exr").camera == camera


def test_empty_pixels_are_saved_and_loaded(tmp_path):
    samples = synthetic(3, x=[1.5, 1.6, 9.5], y=[2.5, 2.5, 3.5])
    samples.save(tmp_path / "samples.exr")
    assert len(pm.PointSamples.load(tmp_path / "samples.exr")) == 3


def flat_exr(path):
    with OpenEXR.File(
        {"type": OpenEXR.scanlineimage}, {"RGB": np.zeros((4, 4, 3), np.float32)}
    ) as file:
        file.write(str(path))


def foreign_deep_exr(path):
    pixels = np.empty((1, 1), dtype=object)
    pixels[0, 0] = np.ones(2, dtype=np.float32)
    header = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}
    with OpenEXR.File(header, {"R": pixels, "Z": pixels}) as file:
        file.write(str(path))


def truncated_exr(path):
    synthetic(500).save(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) * 2 // 3])


def truncated_hidden_part(path):
    overscanned(5000).save(path)
    path.write_bytes(path.read_bytes()[:-10])


def damaged_exr(path):
    synthetic(500).save(path)
    path.write_bytes(path.read_bytes().replace(b'"focal_length"', b'"vocal_length"'))


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (flat_exr, "does not hold point samples"),
        (foreign_deep_exr, "does not hold point samples"),
        (truncated_exr, "truncated or damaged"),
        (truncated_hidden_part, "truncated or damaged"),
        (damaged_exr, "damaged or not of this version"),
        (lambda path: path.write_text("no picture"), "is not an EXR file"),
        (lambda path: path.write_bytes(b""), "is not an EXR file"),
    ],
)
def test_a_file_that_holds_no_samples_is_refused(tmp_path, make, text):
    path = tmp_path / "file.exr"
    make(path)
    with pytest.raises(ValueError, match=text) as caught:
        pm.PointSamples.load(path)
    assert str(path) in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nothing\.exr"):
        pm.PointSamples.load(tmp_path / "nothing.exr")


def test_a_folder_is_not_taken_for_a_missing_file(tmp_path):
    with pytest.raises(IsADirectoryError, match="is a folder"):
        pm.PointSamples.load(tmp_path)


def test_a_failed_save_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = tmp_path / "samples.exr"
    path.write_text("precious")

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(deep_exr, "_attributes", interrupted)
    with pytest.raises(KeyboardInterrupt):
        synthetic(50).save(path)
    assert path.read_text() == "precious"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("name", "error"),
    [
        ("samples.png", ValueError),
        ("file/samples.exr", NotADirectoryError),
        ("folder.exr", IsADirectoryError),
    ],
)
def test_a_name_that_cannot_be_saved_to_is_refused(tmp_path, name, error):
    (tmp_path / "folder.exr").mkdir()
    (tmp_path / "file").touch()
    with pytest.raises(error, match=name):
        synthetic(5).save(tmp_path / name)


def test_files_are_the_same_whatever_process_wrote_them(tmp_path):
    code = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "import mitsuba as mi; mi.set_variant('llvm_ad_rgb')\n"
        "from scenes import synthetic; synthetic(200).save(sys.argv[2])"
    )
    for name in ("a.exr", "b.exr"):
        subprocess.run(
            [sys.executable, "-c", code, str(Path(__file__).parents[1]), str(tmp_path / name)],
            check=True,
        )
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


# ---------------------------------------------------------------- files are not trusted


def refused(path, text):
    """Loading must end in a ValueError that names the file and says ``text``."""
    with pytest.raises(ValueError, match=text) as caught:
        pm.PointSamples.load(path)
    assert str(path) in str(caught.value)


@pytest.fixture
def saved(tmp_path):
    """A small file of samples."""
    path = tmp_path / "samples.exr"
    synthetic(300).save(path)
    return path


@pytest.mark.parametrize("key", ["filename", " filename "])
def test_a_lens_in_a_file_names_no_file(saved, tmp_path, key):
    """The picture is there and would be taken."""
    picture = tmp_path / "heart.exr"
    with OpenEXR.File(
        {"type": OpenEXR.scanlineimage}, {"Y": np.ones((4, 4), dtype=np.float32)}
    ) as file:
        file.write(str(picture))
    edited(saved, "lens", aperture=f"image:{key}={picture}")
    refused(saved, "a file must not name another one")


def test_an_aperture_in_a_file_is_unpacked_no_further_than_it_is_large(saved):
    packed = zlib.compress(bytes(1 << 24))
    data = base64.urlsafe_b64encode(packed).decode().rstrip("=")
    edited(saved, "lens", aperture=f"image:width=4,height=4,data={data}")
    tracemalloc.start()
    refused(saved, "samples.exr: ")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1 << 22


def test_an_image_aperture_survives_a_file(tmp_path):
    samples = synthetic(300)
    # Files keep 16 bits of each element.
    aperture = pm.ImageAperture(np.array([[65535, 1000], [30_000, 7]]) / 65535)
    samples = samples.replace(lens=samples.lens.replace(aperture=aperture))
    samples.save(tmp_path / "samples.exr")
    assert pm.PointSamples.load(tmp_path / "samples.exr").lens == samples.lens


@pytest.mark.parametrize(
    ("part", "changes", "text"),
    [
        ("lens", {"f_number": 1e300}, "f_number=1e\\+300: must be 0.0001 to 1e\\+12, or inf"),
        ("lens", {"f_number": 1e-320}, "f_number=1e-320: must be"),
        ("lens", {"f_number": "2"}, "f_number='2': must be a number"),
        ("lens", {"f_number": 0}, "f_number=0: must be > 0"),
        ("lens", {"f_number": float("nan")}, "potmesil:lens: is not JSON: NaN"),
        ("lens", {"focal_length": [50, 20]}, "focal_length=.50, 20.: must be a number or text"),
        ("lens", {"focal_length": 10**400}, "focal_length"),
        ("lens", {"focal_length": 1e-40}, "focal_length=1e-40: must be 0, or 1e-30 to 1e"),
        ("lens", {"focal_length": None}, "focal_length"),
        ("lens", {"vocal_length": 3}, "vocal_length"),
        ("lens", {"film": "x"}, "film='x': must be one of focal, focused"),
        ("lens", {"aperture": "polygon:blades=2"}, "blades=2"),
        ("lens", {"aperture": "image:width=1,height=1,data=AAAA"}, "samples.exr: "),
        ("lens", {"aperture": "image:width=2,height=2,data=!"}, "samples.exr: "),
        ("camera", {"film_size": [20]}, "film_size=.20,.: must be a tuple of 2"),
        ("camera", {"film_size": [0, 14]}, "film_size.0.=0: must be 1 to"),
        ("camera", {"crop_size": [100_000, 100_000]}, "crop window must lie in the film"),
        ("camera", {"crop_size": [20, 14.0]}, "crop_size.1.=14.0: must be a whole number"),
        (
            "camera",
            {"film_size": [99, 99], "crop_offset": [70, 70]},
            "crop window .70, 70, 20, 14.",
        ),
        ("camera", {"x_fov": 0}, "x_fov=0: must be > 0 and < 180"),
        ("camera", {"x_fov": 1e-300}, "x_fov=1e-300: must be 0, or 1e-30"),
        ("camera", {"x_fov": 10**400}, "x_fov=1"),
        ("camera", {"x_fov": True}, "x_fov=True: must be a number"),
        ("camera", {"to_world": [[1, 0, 0, 0]]}, "to_world="),
        ("camera", {"to_world": [[1, 0, 0, 0]] * 3 + [[1, 0, 0, 1e300]]}, "to_world.3..3.=1e"),
        ("camera", {"to_world": {"a": 1}}, "to_world="),
        ("camera", {"near_clip": 3.0, "far_clip": 2.0}, "near_clip=3.0, far_clip=2.0"),
        ("camera", {"near_clip": None, "far_clip": "far"}, "far_clip='far'"),
        ("camera", {"shutter_close": -1.0}, "shutter_close=-1.0: must be >= 0"),
        ("camera", {"aperture": 1}, "aperture: not a field of Camera"),
        ("camera", {"x_fov": None}, "x_fov: must be given"),
        ("samples", {"lattice": -1}, "lattice=-1"),
        ("samples", {"lattice": None}, "potmesil:samples: must be a JSON object with lattice"),
        ("samples", {"more": 1}, "potmesil:samples: must be a JSON object with lattice"),
    ],
)
def test_a_header_is_data_of_a_known_form(saved, part, changes, text):
    edited(saved, part, **changes)
    refused(saved, text)


@pytest.mark.parametrize(
    "text",
    ["{'a':1}", "", "[1]", "3", "null", "[" * 100_000, '{"a":' * 100_000, "{" + "9" * 9999 + "}"],
)
@pytest.mark.parametrize("part", ["samples", "camera", "lens"])
def test_a_header_that_is_no_json_object_is_named(saved, part, text):
    rewritten(saved, **{f"potmesil:{part}": text})
    refused(saved, f"potmesil:{part}: ")


def test_what_cannot_be_loaded_is_not_saved(tmp_path):
    """A samples file that its own program refuses would be a loss."""
    samples = synthetic(50)
    lens = samples.lens.replace(f_number=1e30)
    with pytest.raises(ValueError, match="f_number=1e\\+30"):
        samples.replace(lens=lens).save(tmp_path / "samples.exr")
    with pytest.raises(ValueError, match="crop window"):
        samples.replace(window=Window(0, 0, 20, 13)).save(tmp_path / "b.exr")
    assert not list(tmp_path.iterdir())
    samples.replace(lens=samples.lens.replace(f_number=np.inf)).save(tmp_path / "samples.exr")
    assert pm.PointSamples.load(tmp_path / "samples.exr").lens.f_number == np.inf


def test_samples_that_no_program_saves_are_damage(saved):
    with OpenEXR.File(str(saved), separate_channels=True) as file:
        header = {n: v for n, v in file.header().items() if n not in ("channels", "name")}
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    count = len(channels["Z"][3, 3])
    channels["Z"][3, 3] = np.full(count, np.nan, dtype=np.float32)
    with OpenEXR.File(header, channels) as file:
        file.write(str(saved))
    refused(saved, f"{count} of 300 samples have")


def with_data_window(path, right, bottom):
    """Other last pixels of the data window, which OpenEXR would not write."""
    whole = path.read_bytes()
    start = whole.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4 + 8
    box = np.array([right, bottom], dtype="<i4").tobytes()
    path.write_bytes(whole[:start] + box + whole[start + 8 :])


@pytest.mark.parametrize(
    ("right", "bottom"), [(1 << 24, 13), (19, 1 << 24), (2**31 - 1, 2**31 - 1), (-5, 13)]
)
def test_memory_is_taken_only_as_the_size_of_the_file_justifies(saved, right, bottom):
    with_data_window(saved, right, bottom)
    tracemalloc.start()
    refused(saved, "samples.exr: ")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1 << 24


def test_the_size_of_all_samples_is_known_before_they_are_read(tmp_path):
    samples = overscanned(3000)
    samples.save(tmp_path / "samples.exr")
    visible, hidden = exr_layout.parts_of(tmp_path / "samples.exr")
    count = (samples.layer == 0).sum()
    rows = samples.window.height
    names = visible.names
    assert visible == exr_layout.Part(samples.window.size, rows, 4 * 10 * count, 10, names)
    assert hidden == exr_layout.Part(samples.window.size, rows, 4 * 11 * (3000 - count), 11, names)
    assert 4 * sum(map(len, samples.surfaces.values())) < names < 10_000


def test_a_part_of_very_many_channels_is_refused(saved):
    """OpenEXR reads all of them, whether they are asked for or not."""
    with OpenEXR.File(str(saved), separate_channels=True) as file:
        header = {n: v for n, v in file.header().items() if n not in ("channels", "name")}
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    for count in (exr_layout.MOST_CHANNELS - len(channels), 300):
        more = {f"more{i}": channels["Z"] for i in range(count)}
        with OpenEXR.File(header, channels | more) as file:
            file.write(str(saved))
        if count < 300:
            assert len(pm.PointSamples.load(saved)) == 300
            (part,) = exr_layout.parts_of(saved)
            assert part.channels == exr_layout.MOST_CHANNELS
            fewer = dataclasses.replace(part, channels=exr_layout.USUAL_CHANNELS)
            assert part.memory > fewer.memory
    refused(saved, "it has more than 95 channels in a part")


@pytest.mark.parametrize(
    "surfaces",
    [
        {1: "surface"},
        {},
        {i: f"surface {i % 40} " + "x" * (i % 40) * 20 for i in range(1, 200)},
        {i: "x" * (i % 7) * 100 + str(i % 5) for i in range(1, 20_000, 3)},
        {2**32 - 1: "Fläche", 7: "", 8: "Fläche"},
    ],
)
def test_names_of_surfaces_survive_a_file(tmp_path, surfaces):
    synthetic(50).replace(surfaces=surfaces).save(tmp_path / "samples.exr")
    assert pm.PointSamples.load(tmp_path / "samples.exr").surfaces == surfaces
    (part,) = exr_layout.parts_of(tmp_path / "samples.exr")
    assert part.names > 4 * sum(map(len, surfaces.values()))


def with_manifest(path, unpacked, stated=None):
    """Another manifest of ids in the header, which OpenEXR would not write."""
    whole = path.read_bytes()
    start = whole.index(b"idManifest\0idmanifest\0") + len(b"idManifest\0idmanifest\0")
    (length,) = struct.unpack_from("<i", whole, start)
    value = struct.pack("<Q", stated or len(unpacked)) + zlib.compress(unpacked)
    header = whole[:start] + struct.pack("<i", len(value)) + value
    rest = bytearray(whole[start + 4 + length :])
    # Where the chunks start is told after the header; the first of them right after that.
    _, height = synthetic(1).camera.film_size
    at = rest.index(struct.pack("<Q", first_chunk(path)))
    for i in range(at, at + 8 * height, 8):
        (offset,) = struct.unpack_from("<Q", rest, i)
        struct.pack_into("<Q", rest, i, offset + len(value) - length)
    path.write_bytes(header + rest)


def first_chunk(path):
    with path.open("rb") as file:
        file.seek(8)
        exr_layout._header(file, path.stat().st_size)
        return struct.unpack("<Q", file.read(8))[0]


def manifest(texts, ranges, ids):
    """A manifest as OpenEXR unpacks it, its texts as they stand in it."""
    sizes = b"".join(
        bytes([len(t) & 127 | 128, len(t) >> 7 & 127 | 128, len(t) >> 14]) for t in texts
    )
    return b"".join(
        [
            struct.pack("<II", 0, len(texts)) + sizes + b"".join(texts),
            struct.pack("<I", len(ranges)) + b"".join(struct.pack("<II", *r) for r in ranges),
            struct.pack("<I", 1) + b"\1\0\0\0\2id" + b"\1\0\0\0\4name" + b"\2",
            b"\4\0\0\0none" + b"\2\0\0\0id" + b"\2" + struct.pack("<I", len(ids)),
            b"".join(bytes(pair) for pair in ids),
        ]
    )


LONG = b"n" * 60_000


@pytest.mark.parametrize(
    ("data", "text"),
    [
        # One name, of very many ids; names that go on from the one before; empty names.
        (manifest([LONG], [(0, 0)], [(1, 0)] * 5000), "names of surfaces would take"),
        (
            manifest([LONG, *[b"\xea\x60a"] * 5000], [(0, 5000)], [(1, 0)]),
            "names of surfaces would take",
        ),
        (manifest([b"\0"] * 600_000, [(0, 599_999)], [(1, 0)]), "names of surfaces would take"),
        (struct.pack("<II", 0, 2**31 - 1) + bytes(100), "truncated or damaged"),
        (manifest([b"a", b"\2b"], [(0, 1)], [(1, 0)]), "truncated or damaged"),
        (manifest([b"a", b"\1b"], [(0, 0)], [(1, 0)]), "truncated or damaged"),
        (manifest([b"a", b"\1b"], [(0, 2)], [(1, 0)]), "truncated or damaged"),
        (manifest([b"a"], [(0, 0)], [(1, 1)]), "truncated or damaged"),
        (manifest([b"a"], [(0, 0)], [(1, 0)])[:-1], "truncated or damaged"),
        (b"\1" + manifest([b"a"], [(0, 0)], [(1, 0)])[1:], "not of version 0"),
        (
            manifest([b"a"], [(0, 0)], [(1, 0)]).replace(b"\1\0\0\0\4name", b"\2\0\0\0\2\2name"),
            "ids of surfaces stand for more than a name",
        ),
        (bytes(100), "not of one group of ids"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_names_of_surfaces_are_unpacked_no_further_than_the_file_justifies(saved, data, text):
    with_manifest(saved, data)
    tracemalloc.start()
    refused(saved, text)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1 << 26


@pytest.mark.parametrize("stated", [1, 1000, 1 << 40, (1 << 64) - 1])
def test_a_manifest_is_as_long_as_it_says(saved, stated):
    with_manifest(saved, manifest([b"a"], [(0, 0)], [(1, 0)]))
    assert pm.PointSamples.load(saved).surfaces == {1: "a"}
    with_manifest(saved, manifest([b"a"], [(0, 0)], [(1, 0)]), stated)
    refused(saved, "truncated or damaged")


@pytest.mark.parametrize("first", [True, False])
def test_every_part_must_be_deep(tmp_path, first):
    path = tmp_path / "samples.exr"
    synthetic(50).save(path)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        header = {n: v for n, v in file.header().items() if n not in ("channels", "name")}
        deep = OpenEXR.Part(header, {n: c.pixels for n, c in file.channels().items()}, name="deep")
        flat = {"type": OpenEXR.scanlineimage, "dataWindow": header["dataWindow"]}
        flat |= {"displayWindow": header["displayWindow"]}
        pixels = {"Y": np.zeros(deep.channels["Z"].pixels.shape, dtype=np.float32)}
        parts = [deep, OpenEXR.Part(flat, pixels, name="flat")]
        with OpenEXR.File(parts[::-1] if first else parts) as other:
            other.write(str(tmp_path / "both.exr"))
    refused(tmp_path / "both.exr", f"part {int(not first)} must be of type deepscanline")


@pytest.mark.parametrize("field", ["to_world", "principal_point_offset"])
def test_numbers_beside_larger_ones_may_be_as_small_as_they_like(tmp_path, field):
    turn = np.array([[1, 0, 0, 0], [0, 6e-17, -1, 0], [0, 1, 6e-17, 0], [0, 0, 0, 1]])
    other = np.array([[6e-17, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 6e-17, 0], [0, 0, 0, 1]])
    value = tuple(map(tuple, (turn @ other).tolist())) if field == "to_world" else (1e-40, 0.1)
    samples = synthetic(50)
    samples = samples.replace(camera=dataclasses.replace(samples.camera, **{field: value}))
    samples.save(tmp_path / "samples.exr")
    assert pm.PointSamples.load(tmp_path / "samples.exr").camera == samples.camera


def test_a_camera_with_numbers_of_numpy_is_saved(tmp_path):
    samples = synthetic(50)
    camera = dataclasses.replace(
        samples.camera,
        crop_size=tuple(np.array(samples.camera.crop_size)),
        x_fov=np.float32(samples.camera.x_fov),
    )
    samples.replace(camera=camera).save(tmp_path / "samples.exr")
    assert pm.PointSamples.load(tmp_path / "samples.exr").camera == camera


def test_chunks_that_say_they_are_huge_are_not_believed(saved):
    """The size of a chunk's samples stands in it, and may not be more than deflate can pack."""
    whole = bytearray(saved.read_bytes())
    # After a chunk's row stand the sizes of its table, of its samples, and of these unpacked.
    starts = [
        at
        for at in range(len(whole) - 28)
        if whole[at : at + 4] == (13).to_bytes(4, "little")
        and int.from_bytes(whole[at + 4 : at + 12], "little") in range(1, 200)
        and int.from_bytes(whole[at + 20 : at + 28], "little") in range(1, 5000)
    ]
    whole[starts[-1] + 20 : starts[-1] + 28] = (1 << 33).to_bytes(8, "little")
    saved.write_bytes(bytes(whole))
    refused(saved, "is truncated or damaged")


def test_a_picture_of_one_colour_is_loaded(tmp_path, monkeypatch):
    """What compresses best: each byte of the file becomes the most memory."""
    monkeypatch.setattr(exr_layout, "ALWAYS_ALLOWED", 0)
    x, y = (axis.ravel() + 0.5 for axis in np.meshgrid(np.arange(200), np.arange(60)))
    same = {"alpha": np.ones(len(x)), "z": np.full(len(x), 2), "surface": np.ones(len(x))}
    samples = synthetic(
        len(x), size=(200, 60), x=x, y=y, rgb=np.ones((len(x), 3)), weight=np.ones(len(x)), **same
    )
    samples.save(tmp_path / "samples.exr")
    assert len(pm.PointSamples.load(tmp_path / "samples.exr")) == len(x)


def test_what_is_no_regular_file_is_named(tmp_path):
    os.mkfifo(tmp_path / "pipe.exr")
    with pytest.raises(OSError, match=r"pipe\.exr: is not a file"):
        pm.PointSamples.load(tmp_path / "pipe.exr")


@pytest.mark.skipif(not BROKEN.is_dir(), reason="the collection of broken files is not there")
@pytest.mark.parametrize("name", sorted(path.name for path in BROKEN.glob("*.exr")))
def test_files_that_were_found_to_do_harm(name):
    if name.startswith("seed"):
        assert np.isfinite(np.array(pm.focus(pm.PointSamples.load(BROKEN / name)))).all()
    else:
        refused(BROKEN / name, f"{name}: ")
