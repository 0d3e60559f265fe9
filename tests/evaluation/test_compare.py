import re

import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi import cli
from potmesil_mi._version import package_version
from potmesil_mi.evaluation import compare, metrics, timing
from potmesil_mi.evaluation.report import PICTURES, output_paths
from potmesil_mi.evaluation.thinlens import SAMPLERS
from potmesil_mi.pictures.reading import PictureFile
from scenes import SCENES, papers_scene

FIGURE = str(SCENES / "figure11.xml")
OPTIONS = {"method": "paper", "inverse_square": False, "tables": 60}
FILES = sorted(f"{name}{suffix}" for name in PICTURES for suffix in (".exr", ".png"))


@pytest.fixture(autouse=True)
def timed_once(monkeypatch):
    """Only ``comparison``, which is made before, is rendered several times for medians of times."""
    monkeypatch.setattr(timing, "REPEATS", 1)


@pytest.fixture(scope="module")
def comparison():
    mi.set_variant("llvm_ad_rgb")
    return compare(papers_scene(res=32), spp=4, **OPTIONS)


def test_the_focused_picture_is_that_of_focus(variant_llvm, comparison):
    samples = pm.render_samples(papers_scene(res=32), spp=4)
    expected = np.array(pm.focus(samples, **OPTIONS))
    np.testing.assert_allclose(comparison.focused.picture, expected, atol=1e-5)
    assert comparison.focused.spp == 4 * (1 + pm.Sampling().refine)
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
        tables=9,
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
    even = pm.Sampling(refine=0)
    result = compare(papers_scene(res=16), spp=256, reference_spp=8, sampling=even, **OPTIONS)
    assert result.reference_spp == 8
    assert result.needed.bound == ">"
    assert result.equal_error is None
    assert result.thinlens is result.equal_samples
    assert "more --reference-spp" in result.summary()
    assert f"needs more than {result.needed.spp:.3g} samples" in result.summary()


def test_noise_and_bias_are_told_apart(comparison):
    """Together they are the error, up to the noise of the reference."""
    bias, error = comparison.bias
    reference = 10 ** (-comparison.floor / 10)
    total = comparison.noise + bias
    assert comparison.focused.mean_square == pytest.approx(total, abs=4 * error + 2 * reference)
    assert comparison.noise > 3 * error
    decibels = f"{metrics.decibels(comparison.noise):.2f} dB (two seeds)"
    assert decibels in comparison.summary()


def test_more_samples_lower_the_noise_and_not_the_bias(variant_llvm):
    few, many = (
        compare(papers_scene(res=32), spp=spp, reference_spp=64, budget=0.0, **OPTIONS)
        for spp in (4, 64)
    )
    assert many.noise < few.noise / 4


def test_without_time_as_little_is_rendered_as_can_be(variant_llvm):
    result = compare(papers_scene(res=16), spp=256, budget=0.0, **OPTIONS)
    assert result.reference_spp == 128
    assert result.needed.spp <= 1024  # to which a sampler rounds the 320 up
    assert "more --reference-spp or --budget" in result.summary()


def test_denoised_is_compared_with_denoised(variant_llvm):
    pytest.importorskip("mitsuba_oidn")
    result = compare(papers_scene(res=32), spp=4, reference_spp=256, denoise=True)
    plain = compare(papers_scene(res=32), spp=4, reference_spp=256)
    assert plain.denoising is None
    assert result.denoising > 0
    assert result.first_picture > result.denoising
    assert not np.allclose(result.focused.picture, plain.focused.picture, atol=1e-3)
    assert not np.allclose(result.equal_samples.picture, plain.equal_samples.picture, atol=1e-3)
    np.testing.assert_allclose(result.pinhole.picture, plain.pinhole.picture)
    assert "denoised in" in result.summary()


@pytest.mark.parametrize("budget", [-1.0, np.nan, np.inf])
def test_a_bad_budget_is_named(variant_llvm, budget):
    with pytest.raises(ValueError, match="budget="):
        compare(papers_scene(res=16), budget=budget)


@pytest.mark.parametrize("options", [{"denoise": "yes"}, {"budget": "long"}])
def test_what_is_of_another_type_is_named(variant_llvm, options):
    (name,) = options
    with pytest.raises(TypeError, match=f"{name}="):
        compare(papers_scene(res=16), **options)


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
    said = {name: PictureFile(tmp_path / f"{name}.exr").parts[0].attributes for name in PICTURES}
    assert said["focused"]["potmesil:method"].startswith("paper")
    assert said["focused"]["potmesil:spp"] == 4
    assert said["reference"]["potmesil:method"] == "thinlens"
    assert said["reference"]["potmesil:spp"] <= 128
    assert {of["Software"] for of in said.values()} == {f"potmesil_mi {package_version()}"}
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
    made = output_paths(f"{tmp_path}/deeper/made/")
    assert sorted(path.name for path in made) == FILES
    assert (tmp_path / "deeper" / "made").is_dir()
    assert len(output_paths(f"{tmp_path}/none/prefix")) == len(FILES)
    (tmp_path / "file").touch()
    with pytest.raises(NotADirectoryError, match="is in a file, not a folder"):
        output_paths(f"{tmp_path}/file/prefix")


PERSPECTIVE = """<scene version="3.0.0"><integrator type="direct"/><emitter type="constant"/>
  <sensor type="perspective"><film type="hdrfilm"><integer name="width" value="{}"/>
  <integer name="height" value="16"/></film></sensor><shape type="sphere"/></scene>"""


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["nothing.xml"], "nothing.xml"),
        ([FIGURE, "-o", "/dev/null/a"], "is in a file, not a folder"),
        ([FIGURE, "--tables", "1"], "tables=1"),
        ([FIGURE, "-D", "res=16", "--sensor", "5"], "sensor=5"),
        ([FIGURE, "-D", "res=16", "--reference-spp", "1"], "--reference-spp=1"),
        ([FIGURE, "-D", "res=16", "--reference-floor", "inf"], "--reference-floor=inf"),
        ([FIGURE, "-D", "res=16", "--seed", "-1"], "seed=-1"),
        ([FIGURE, "-D", "res=16", "--budget", "-1"], r"budget=-1\.0"),
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
    lens = ["--f-number", "2", "--focus-distance", "1.2", "--method", "paper", "--tables", "9"]
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
