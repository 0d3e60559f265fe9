import json
import subprocess
import sys

import numpy as np
import OpenEXR
import pytest

import potmesil_mi as pm
from potmesil_mi.samples import deep_exr
from scenes import overscanned, papers_scene, pinhole_mean, synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")


# ---------------------------------------------------------------- what samples must be


@pytest.mark.parametrize(
    ("field", "bad"),
    [
        ("rgb", np.nan),
        ("rgb", np.inf),
        ("alpha", np.nan),
        ("z", np.nan),
        ("z", -1.0),
        ("x", np.inf),
        ("weight", 0.0),
    ],
)
def test_bad_samples_are_dropped_and_counted(field, bad):
    good = synthetic(100)
    column = getattr(good, field).copy()
    column[[3, 50]] = bad
    with pytest.warns(RuntimeWarning, match="dropped 2 of 100 samples"):
        samples = good.replace(**{field: column})
    assert len(samples) == 98
    np.testing.assert_array_equal(samples.y, np.delete(good.y, [3, 50]))
    assert np.isfinite(np.array(pm.focus(samples))).all()


def test_no_samples_at_all_are_refused():
    with pytest.raises(ValueError, match="no samples"):
        synthetic(0)
    good = synthetic(5)
    with (
        pytest.warns(RuntimeWarning, match="dropped 5 of 5"),
        pytest.raises(ValueError, match="no samples"),
    ):
        good.replace(rgb=np.full((5, 3), np.nan))


def test_columns_of_the_wrong_shape_are_named():
    with pytest.raises(ValueError, match=r"z: has shape \(3,\), must have \(5,\)"):
        synthetic(5, z=np.ones(3))
    with pytest.raises(ValueError, match="rgb: has shape"):
        synthetic(5, rgb=np.ones((5, 4)))


def test_a_sample_on_the_films_last_edge_belongs_to_the_last_pixel():
    samples = synthetic(3, x=[0.0, 19.999, 20.0], y=[0.0, 13.5, 14.0])
    np.testing.assert_array_equal(samples.pixel(), [0, 13 * 20 + 19, 13 * 20 + 19])


def test_the_window_is_the_crop_window_unless_told():
    camera = overscanned(1).camera
    assert synthetic(5, camera=camera).window == (2, 3, 20, 14)
    window = synthetic(5, window=np.array([-3, -2, 26, 18])).window
    assert window == (-3, -2, 26, 18)
    assert all(type(number) is int for number in window)
    assert synthetic(5, window=(-3, -2, 26, 18)).replace(window=None).window == (0, 0, 20, 14)


@pytest.mark.parametrize(
    ("window", "error", "text"),
    [
        ((0, 0, 0, 14), ValueError, r"window\[2\]=0"),
        ((0, 0, 20, -1), ValueError, r"window\[3\]=-1"),
        ((0, -(1 << 25), 20, 14), ValueError, r"window\[1\]="),
        ((0, 0, 20), ValueError, r"window=\(0, 0, 20\): must be left, top, width and height"),
        ((0.0, 0, 20, 14), TypeError, r"window\[0\]=0.0: must be a whole number"),
        ((0, True, 20, 14), TypeError, r"window\[1\]=True"),
        ("crop", TypeError, r"window\[0\]='c'"),
        (20, TypeError, "window=20: must be left"),
    ],
)
def test_a_bad_window_is_named(window, error, text):
    with pytest.raises(error, match=text):
        synthetic(5, window=window)


def test_pixels_are_counted_in_the_window():
    samples = synthetic(
        5, window=(-3, -2, 26, 18), x=[-3, -1e-9, 0, 22.5, 40], y=[-2, -0.5, 0, 15.5, 40]
    )
    np.testing.assert_array_equal(
        samples.pixel(), [0, 26 + 2, 2 * 26 + 3, 17 * 26 + 25, 17 * 26 + 25]
    )


# ---------------------------------------------------------------- layers


def test_samples_are_visible_unless_told():
    samples = synthetic(5)
    assert samples.layer.dtype == np.uint8
    np.testing.assert_array_equal(samples.layer, 0)
    assert samples.visible() is samples


def test_what_is_visible_is_layer_0():
    samples = overscanned(300)
    visible = samples.visible()
    first = samples.layer == 0
    assert 0 < len(visible) == first.sum() < 300
    assert visible.window == samples.window
    np.testing.assert_array_equal(visible.rgb, samples.rgb[first])
    np.testing.assert_array_equal(visible.layer, 0)


def test_layers_follow_their_samples():
    samples = overscanned(300)
    assert samples.replace(lens=samples.lens.replace(f_number=8.0)).layer is samples.layer
    rgb = samples.rgb.copy()
    rgb[[3, 50]] = np.nan
    with pytest.warns(RuntimeWarning, match="dropped 2 of 300"):
        fewer = samples.replace(rgb=rgb)
    np.testing.assert_array_equal(fewer.layer, np.delete(samples.layer, [3, 50]))
    with pytest.raises(ValueError, match=r"layer: has shape \(300,\), must have \(5,\)"):
        synthetic(5, layer=samples.layer)


# ---------------------------------------------------------------- merging


def test_merging_keeps_the_light_of_every_pixel():
    samples = synthetic(20_000)
    merged = samples.merge(tolerance=3.0)
    assert len(merged) < len(samples) / 2
    np.testing.assert_allclose(pinhole_mean(merged), pinhole_mean(samples), atol=1e-5)
    assert merged.weight.sum() == pytest.approx(samples.weight.sum(), rel=1e-5)


def test_merging_joins_only_what_the_rule_allows():
    here = {"x": [1.1, 1.2, 1.7, 1.1], "y": [1.1] * 4, "z": [2.0, 2.0001, 2.0, 2.0]}
    surface = [1, 1, 1, 2]
    samples = synthetic(4, **here, surface=surface, weight=[1, 3, 1, 1])
    merged = samples.merge()
    assert len(merged) == 3
    joined = merged.weight == 4
    assert merged.x[joined] == pytest.approx(1.175)
    assert 1 / merged.z[joined] == pytest.approx((1 / 2.0 + 3 / 2.0001) / 4)
    np.testing.assert_allclose(
        merged.rgb[joined][0], (samples.rgb[0] + 3 * samples.rgb[1]) / 4, rtol=1e-6
    )


def test_merging_keeps_layers_apart():
    here = {"x": [-0.9] * 4, "y": [1.1] * 4, "z": [2.0] * 4, "surface": [1] * 4}
    samples = synthetic(4, **here, layer=[0, 1, 2, 1], weight=[1, 1, 1, 3], window=(-2, 0, 22, 14))
    merged = samples.merge()
    np.testing.assert_array_equal(np.sort(merged.layer), [0, 1, 2])
    assert merged.weight[merged.layer == 1] == 4
    np.testing.assert_allclose(
        merged.rgb[merged.layer == 1][0], (samples.rgb[1] + 3 * samples.rgb[3]) / 4, rtol=1e-6
    )
    assert merged.window == samples.window


def test_merging_keeps_the_light_of_every_layer_and_pixel_of_the_window():
    samples = overscanned(30_000).replace(alpha=np.ones(30_000))
    merged = samples.merge(tolerance=3.0)
    assert len(merged) < 0.8 * len(samples)
    for layer in range(3):
        one, other = (
            s.replace(layer=np.where(s.layer == layer, 0, 1)).visible() for s in (samples, merged)
        )
        np.testing.assert_allclose(
            pinhole_mean(other, whole=True), pinhole_mean(one, whole=True), atol=1e-5
        )
        assert other.weight.sum() == pytest.approx(one.weight.sum(), rel=1e-5)


def test_merging_by_a_finer_step_changes_the_picture_less():
    samples = pm.render_samples(papers_scene(64), spp=64)
    # At small circles no method can tell merged samples from these.
    lens = samples.lens.replace(f_number=0.7)
    image = np.array(pm.focus(samples, lens))
    errors, counts = [], []
    for tolerance in (4.0, 0.1):
        merged = samples.merge(lens, tolerance)
        counts.append(len(merged))
        errors.append(np.sqrt(np.mean((np.array(pm.focus(merged, lens)) - image) ** 2)))
    assert counts[0] < counts[1] < len(samples) / 4
    assert errors[1] < 2e-4
    assert errors[1] < errors[0] / 2


def test_samples_on_a_lattice_are_not_merged():
    samples = synthetic(50, lattice=2)
    assert samples.merge() is samples


def test_a_bad_tolerance_is_named():
    for tolerance in (0, -1, np.inf, np.nan):
        with pytest.raises(ValueError, match=f"tolerance={tolerance}"):
            synthetic(5).merge(tolerance=tolerance)
    with pytest.raises(ValueError, match="lattice=-1"):
        synthetic(5, lattice=-1)


# ---------------------------------------------------------------- deep EXR


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


def as_version(path, version):
    """Write the file anew as one of another version: 1 had positions relative to the pixel."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        header = dict(file.header())
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    about = {**json.loads(header["potmesil:samples"]), "version": version}
    header = {n: v for n, v in header.items() if n not in ("channels", "name")}
    header["potmesil:samples"] = json.dumps(about)
    left, top = header["dataWindow"][0]
    for y, x in np.ndindex(channels["Z"].shape) if version == 1 else ():
        for name, start in (("potmesil.x", x + left), ("potmesil.y", y + top)):
            channels[name][y, x] = channels[name][y, x] - np.float32(start)
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))


def test_files_of_version_1_are_loaded(tmp_path):
    samples = synthetic(2000, camera=overscanned(1).camera)
    samples = samples.replace(x=samples.x + 2, y=samples.y + 3)
    samples.save(tmp_path / "samples.exr")
    as_version(tmp_path / "samples.exr", 1)
    loaded = pm.PointSamples.load(tmp_path / "samples.exr")
    assert loaded.window == (2, 3, 20, 14)
    assert_same_samples(loaded, samples)


def test_files_of_a_later_version_are_refused(tmp_path):
    synthetic(200).save(tmp_path / "samples.exr")
    as_version(tmp_path / "samples.exr", 3)
    with pytest.raises(ValueError, match="version 3: must be 1 or 2"):
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


def test_samples_are_described_in_a_line():
    text = repr(synthetic(5))
    assert text.startswith("PointSamples(5 in 20x14 pixels, z = ")
    assert "['one', 'two', 'three']" in text


def test_a_failed_save_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = tmp_path / "samples.exr"
    path.write_text("precious")

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(deep_exr, "_header", interrupted)
    with pytest.raises(KeyboardInterrupt):
        synthetic(50).save(path)
    assert path.read_text() == "precious"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("name", "error"),
    [
        ("samples.png", ValueError),
        ("missing/samples.exr", FileNotFoundError),
        ("folder.exr", IsADirectoryError),
    ],
)
def test_a_name_that_cannot_be_saved_to_is_refused(tmp_path, name, error):
    (tmp_path / "folder.exr").mkdir()
    with pytest.raises(error, match=name):
        synthetic(5).save(tmp_path / name)


def test_files_are_the_same_whatever_process_wrote_them(tmp_path):
    code = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "import mitsuba as mi; mi.set_variant('llvm_ad_rgb')\n"
        "from scenes import synthetic; synthetic(200).save(sys.argv[2])"
    )
    from pathlib import Path

    for name in ("a.exr", "b.exr"):
        subprocess.run(
            [sys.executable, "-c", code, str(Path(__file__).parent), str(tmp_path / name)],
            check=True,
        )
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()
