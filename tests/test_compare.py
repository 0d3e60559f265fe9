import math
import re
import sys

import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi import cli
from potmesil_mi.evaluation import metrics
from potmesil_mi.evaluation.compare import (
    PICTURES,
    SAMPLERS,
    compare,
    output_paths,
    thinlens_sensor,
)
from scenes import SCENES, papers_scene, still_life

MODULE = sys.modules[compare.__module__]
FIGURE = str(SCENES / "figure11.xml")
OPTIONS = {"method": "paper", "inverse_square": False, "tables": 60}
FILES = sorted(f"{name}{suffix}" for name in PICTURES for suffix in (".exr", ".png"))


@pytest.fixture
def noise():
    return np.random.default_rng(0).uniform(0.2, 0.8, (32, 40, 3)).astype(np.float32)


# ---------------------------------------------------------------- metrics


@pytest.mark.parametrize("offset", [0.1, -0.01])
def test_psnr_of_a_constant_offset_is_its_square(noise, offset):
    expected = -20 * math.log10(abs(offset))
    assert metrics.psnr(noise + offset, noise) == pytest.approx(expected, abs=1e-3)
    assert metrics.mean_square(noise, noise + offset) == pytest.approx(offset**2, rel=1e-4)


def test_equal_pictures_have_no_error(noise):
    assert metrics.psnr(noise, noise) == math.inf
    assert metrics.ssim(noise, noise) == pytest.approx(1, abs=1e-12)
    assert metrics.flip(noise, noise) == 0


def test_what_a_screen_clips_does_not_count(noise):
    brighter = noise.copy()
    noise[:4], brighter[:4] = 1, 50
    noise[4:8], brighter[4:8] = 0, -1
    assert metrics.psnr(brighter, noise) == math.inf
    assert metrics.flip(brighter, noise) == 0


def test_ssim_of_constant_pictures_is_its_luminance_term():
    a, b = (np.full((16, 16, 3), value) for value in (0.2, 0.6))
    x, y, c1 = metrics.srgb(0.2), metrics.srgb(0.6), 0.01**2
    expected = (2 * x * y + c1) / (x**2 + y**2 + c1)
    assert metrics.ssim(a, b) == pytest.approx(expected, rel=1e-6)


def test_flip_grows_with_the_error_up_to_that_of_black_and_white(noise):
    black = np.zeros((32, 32, 3))
    near, far = (metrics.flip(noise + offset, noise) for offset in (0.02, 0.2))
    assert 0 < near < far < metrics.flip(black + 1, black) < 1
    # Seen from farther away, noise is blurred.
    other = np.clip(noise + np.random.default_rng(1).normal(0, 0.1, noise.shape), 0, 1)
    close, distant = (metrics.flip(other, noise, pixels_per_degree=ppd) for ppd in (20, 200))
    assert distant < close / 2


def test_srgb_is_the_standards(variant_llvm):
    linear = np.linspace(-0.1, 1.1, 60, dtype=np.float32).reshape(4, 5, 3)
    inside = np.clip(linear, 0, 1)
    expected = np.array(mi.Bitmap(inside).convert(srgb_gamma=True))
    np.testing.assert_allclose(metrics.srgb(linear), expected, atol=1e-5)


def test_alpha_and_mitsubas_tensors_may_be_measured(variant_llvm, noise):
    with_alpha = mi.TensorXf(np.dstack([noise, np.ones(noise.shape[:2], np.float32)]))
    assert metrics.psnr(with_alpha, noise) == math.inf
    assert metrics.ssim(with_alpha, mi.TensorXf(noise)) == pytest.approx(1)


@pytest.mark.parametrize(
    ("metric", "a", "b", "text"),
    [
        ("psnr", (8, 8, 3), (8, 9, 3), "8x8 pixels.*9x8"),
        ("psnr", (8, 8), (8, 8), r"picture: has shape \(8, 8\)"),
        ("flip", (8, 8, 3), (8, 8, 1), "reference: has shape"),
        ("psnr", (0, 8, 3), (0, 8, 3), "shape"),
        ("ssim", (10, 20, 3), (10, 20, 3), "20x10 pixels.*11x11"),
    ],
)
def test_pictures_that_cannot_be_compared_are_named(metric, a, b, text):
    with pytest.raises(ValueError, match=text):
        getattr(metrics, metric)(np.zeros(a), np.zeros(b))


def test_pixels_per_degree_are_positive(noise):
    with pytest.raises(ValueError, match="pixels_per_degree=0"):
        metrics.flip(noise, noise, pixels_per_degree=0)


@pytest.mark.parametrize(
    ("module", "package"), [("skimage.metrics", "scikit-image"), ("flip_evaluator", "flip-")]
)
def test_a_missing_extra_says_how_to_install_it(monkeypatch, capsys, module, package):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match=rf"{package}.*'potmesil_mi\[compare\]'"):
        metrics.require_extra()
    assert cli.main(["compare", FIGURE]) == 1
    assert "pip install 'potmesil_mi[compare]'" in capsys.readouterr().err


# ---------------------------------------------------------------- the equivalent thinlens


def test_thinlens_sensor_stands_where_the_sensor_stood(variant_llvm):
    film = {"crop_width": 12, "crop_height": 10, "crop_offset_x": 5, "crop_offset_y": 3}
    place = mi.ScalarTransform4f().look_at([0.2, 0.1, 0], [0, 0, 2.3], [0, 1, 0])
    sensor = {"type": "potmesil", "focal_length": 50.0, "frame_width": 40.0, "f_number": 0.5}
    sensor |= {"focus_distance": 2.0, "to_world": place, "near_clip": 0.5, "far_clip": 50.0}
    scene = still_life(film={**film, "rfilter": {"type": "gaussian"}}, sensor=sensor)
    sensor = scene.sensors()[0]
    closed = thinlens_sensor(sensor, sensor.lens().replace(aperture_radius=0), spp=4)
    seen = np.array(mi.render(scene, sensor=closed, spp=64, seed=3))
    expected = np.array(mi.render(scene, sensor=sensor, spp=64, seed=3))
    assert seen.shape == (10, 12, 3)
    np.testing.assert_allclose(seen, expected, atol=0.02)
    assert closed.near_clip() == pytest.approx(0.5)

    opened = thinlens_sensor(sensor, spp=4)
    assert "ThinLens" in opened.class_name()
    radius = mi.traverse(opened)["aperture_radius"][0]
    assert radius == pytest.approx(sensor.lens().aperture_radius)


def test_thinlens_sensor_keeps_the_field_of_view_of_the_samples(variant_llvm):
    sensor = still_life().sensors()[0]
    other = pm.ThinLens(85.0, 2.0, 2500.0, film="focused")  # in millimetres
    parameters = mi.traverse(thinlens_sensor(sensor, other))
    assert parameters["x_fov"][0] == pytest.approx(sensor.camera().x_fov, abs=1e-4)
    assert parameters["focus_distance"][0] == pytest.approx(2.5)
    assert parameters["aperture_radius"][0] == pytest.approx(85 / 4 / 1000)


def test_thinlens_sensor_takes_the_samples_that_its_sampler_can(variant_llvm, capfd):
    sensor = still_life().sensors()[0]
    assert thinlens_sensor(sensor, sampler="orthogonal", spp=10).sampler().sample_count() == 25
    assert thinlens_sensor(sensor, sampler="multijitter", spp=10).sampler().sample_count() == 12
    assert "rounding" not in capfd.readouterr().err


def test_a_principal_point_off_the_centre_has_no_thinlens(variant_llvm):
    lens = {"focal_length": 50.0, "frame_width": 40.0, "f_number": 2.0, "focus_distance": 2.0}
    sensor = {"type": "potmesil", **lens, "principal_point_offset_x": 0.1}
    with pytest.raises(ValueError, match=r"principal_point_offset=\(0\.1"):
        compare(still_life(sensor=sensor))


# ---------------------------------------------------------------- the comparison


@pytest.fixture(scope="module")
def comparison():
    mi.set_variant("llvm_ad_rgb")
    return compare(papers_scene(res=32), spp=4, **OPTIONS)


def test_the_focused_picture_is_that_of_focus(variant_llvm, comparison):
    samples = pm.render_samples(papers_scene(res=32), spp=4)
    expected = np.array(pm.focus(samples, **OPTIONS))
    np.testing.assert_allclose(comparison.focused.picture, expected, atol=1e-5)
    assert comparison.focused.spp == 4
    assert comparison.point_samples == len(samples)


def test_the_reference_is_converged_and_both_come_near_it(comparison):
    assert comparison.floor >= comparison.focused.psnr + 9.9
    assert comparison.focused.psnr > 28
    assert comparison.equal_samples.psnr > 28
    for rendering in (comparison.focused, comparison.equal_samples):
        assert rendering.psnr == pytest.approx(
            metrics.psnr(rendering.picture, comparison.reference), abs=1e-3
        )
        assert 0.8 < rendering.ssim < 1
        assert 0 < rendering.flip < 0.1


def test_the_noise_floor_is_that_of_the_mean(comparison):
    """Another reference differs by the noise of both."""
    again = compare(
        papers_scene(res=32),
        seed=5000,
        spp=4,
        method="paper",
        reference_spp=comparison.reference_spp,
        reference_floor=200,
    )
    assert again.reference_spp == comparison.reference_spp
    apart = metrics.mean_square(again.reference, comparison.reference)
    noise = sum(10 ** (-floor / 10) for floor in (again.floor, comparison.floor))
    assert apart == pytest.approx(noise, rel=0.3)


def test_thinlens_needs_samples_between_those_measured(comparison):
    assert comparison.sampler in SAMPLERS
    assert comparison.needed.bound in ("", "<=")
    assert 1 <= comparison.needed.spp <= comparison.reference_spp
    assert comparison.equal_error is comparison.thinlens
    assert comparison.refocus_speedup > 0
    assert comparison.first_speedup > 0


def test_the_difference_is_amplified(comparison):
    apart = np.abs(comparison.focused.picture - comparison.reference)
    clipped = np.clip(np.stack([comparison.focused.picture, comparison.reference]), 0, 1)
    assert clipped.max() < 1
    np.testing.assert_allclose(comparison.difference, 8 * apart, atol=1e-5)


def test_out_of_reach_is_said_so(variant_llvm):
    result = compare(papers_scene(res=16), spp=256, reference_spp=8, **OPTIONS)
    assert result.reference_spp == 8
    assert result.needed.bound == ">"
    assert result.equal_error is None
    assert result.thinlens is result.equal_samples
    assert "more --reference-spp" in result.summary()
    assert f"needs more than {result.needed.spp:.3g} samples" in result.summary()


class _Points:
    """A sampler whose error is 1/spp^1.5 and which takes 0.1 s and 0.01 s a sample."""

    def __init__(self, counts):
        self.counts = counts

    def rounded_up(self, spp):
        return next((n for n in self.counts if n >= spp), self.counts[-1] * 2)

    def search(self, monkeypatch, error, start, most=1000):
        def measured(render, spp):
            return np.full((1, 1, 3), spp**-0.75), spp, 0.0, 0.1 + 0.01 * spp

        monkeypatch.setattr(MODULE, "_measured", measured)
        search = MODULE._Search(None, self.rounded_up, np.zeros((1, 1, 3)), lambda text: None)
        search.run(error, start, most)
        return search


@pytest.mark.parametrize("start", [4, 25, 150, 600])
@pytest.mark.parametrize("counts", [range(1, 1001), [n * n for n in (2, 3, 5, 7, 11, 13, 17, 31)]])
def test_the_search_finds_the_samples_of_an_error(monkeypatch, start, counts):
    search = _Points(list(counts)).search(monkeypatch, 60**-1.5, start)
    assert search.needed.bound == ""
    assert search.needed.spp == pytest.approx(60, rel=1e-3)
    assert search.needed.seconds == pytest.approx(0.7, rel=0.02)
    assert search.reached.spp in ((60, 61) if 60 in counts else (49,))


def test_the_search_keeps_to_its_bounds(monkeypatch):
    counts = list(range(4, 1001))
    more = _Points(counts).search(monkeypatch, 1e-9, 4, most=100)
    assert (more.needed.spp, more.needed.bound, more.reached) == (64, ">", None)
    fewer = _Points(counts).search(monkeypatch, 0.9, 64)
    assert (fewer.needed.spp, fewer.needed.bound, fewer.reached.spp) == (4, "<=", 4)
    assert fewer.rank < more.rank


# ---------------------------------------------------------------- files and the command line


def test_the_command_writes_the_pictures_and_prints_a_table(tmp_path, capsys):
    options = ["-D", "res=32", "-D", "spp=4", "--reference-spp", "128", "--method", "paper"]
    assert cli.main(["compare", FIGURE, *options, "-o", str(tmp_path)]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == FILES
    text = capsys.readouterr().out
    assert re.search(r"thinlens, equal samples + +\d+ ", text)
    assert "67 pixels a degree" in text
    assert str(tmp_path / "focused.exr") in text

    pictures = {name: np.array(mi.Bitmap(str(tmp_path / f"{name}.exr"))) for name in PICTURES}
    assert all(picture.shape == (32, 32, 3) for picture in pictures.values())
    assert all(picture.dtype == np.float32 for picture in pictures.values())
    psnr = metrics.psnr(pictures["focused"], pictures["reference"])
    assert re.search(rf"focus, .*{psnr:.2f}", text)
    apart = np.abs(
        np.clip(pictures["focused"], 0, 1).astype(float) - np.clip(pictures["reference"], 0, 1)
    )
    np.testing.assert_allclose(pictures["difference"], 8 * apart, atol=1e-5)


def test_output_is_a_folder_or_a_prefix(tmp_path):
    assert sorted(path.name for path in output_paths(tmp_path)) == FILES
    prefixed = output_paths(tmp_path / "a-b")
    assert sorted(path.name for path in prefixed) == sorted(f"a-b-{name}" for name in FILES)
    assert prefixed[tmp_path / "a-b-thinlens.png"] == "thinlens"
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        output_paths(f"{tmp_path}/none/")


PERSPECTIVE = """<scene version="3.0.0"><integrator type="direct"/><emitter type="constant"/>
  <sensor type="perspective"><film type="hdrfilm"><integer name="width" value="{}"/>
  <integer name="height" value="16"/></film></sensor><shape type="sphere"/></scene>"""


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["nothing.xml"], "nothing.xml"),
        ([FIGURE, "-o", "{}/no/a"], "there is no folder"),
        ([FIGURE, "--tables", "1"], "tables=1"),
        ([FIGURE, "-D", "res=16", "--sensor", "5"], "sensor=5"),
        ([FIGURE, "-D", "res=16", "--reference-spp", "1"], "reference_spp=1"),
        ([FIGURE, "-D", "res=16", "--reference-floor", "inf"], "reference_floor=inf"),
        ([FIGURE, "-D", "res=16", "--seed", "-1"], "seed=-1"),
        ([FIGURE, "-D", "res=8"], "8x8 pixels, must have at least 11x11"),
        (["{}/scene.xml"], "has no lens; describe one with --f-number"),
        ([FIGURE, "-D", "res=16", "-m", "scalar_rgb"], "scalar_rgb|vectorised"),
    ],
)
def test_an_error_is_one_line_with_exit_code_1_and_no_file(tmp_path, capsys, arguments, text):
    scene = tmp_path / "scene.xml"
    scene.write_text(PERSPECTIVE.format(20))
    assert cli.main(["compare", *(argument.format(tmp_path) for argument in arguments)]) == 1
    message = capsys.readouterr().err
    assert re.search(text, message)
    assert "potmesil: error:" in message
    assert list(tmp_path.iterdir()) == [scene]


def test_a_perspective_scene_is_compared_through_the_lens_of_the_options(tmp_path, capsys):
    scene = tmp_path / "scene.xml"
    scene.write_text(PERSPECTIVE.format(20))
    lens = ["--f-number", "2", "--focus-distance", "1.2", "--method", "paper"]
    assert cli.main(["compare", str(scene), *lens, "--spp", "2", "--reference-spp", "8"]) == 0
    assert "f/2, focused at 1.2" in capsys.readouterr().out


def test_help_has_units_and_examples(capsys):
    with pytest.raises(SystemExit) as caught:
        cli.main(["compare", "--help"])
    assert caught.value.code == 0
    text = capsys.readouterr().out
    assert "examples:" in text
    assert "in mm" in text
    assert "x 8" in text
