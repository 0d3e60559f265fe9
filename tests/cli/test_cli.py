import argparse
import dataclasses
import inspect
import json
import re
import subprocess
import sys
from typing import ClassVar

import mitsuba as mi
import numpy as np
import OpenImageIO as oiio
import pytest

import potmesil_mi as pm
from potmesil_mi import cli
from potmesil_mi._image import write_picture
from potmesil_mi.cli import given, options, taking
from potmesil_mi.focusing import api
from potmesil_mi.focusing.methods import Method
from potmesil_mi.tracing import hidden_surface
from scenes import OTHERS, SCENES, synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")

FIGURE = str(SCENES / "figure11.xml")
SMALL = ["-D", "res=24", "-D", "spp=4"]


def read(path):
    return np.array(mi.Bitmap(str(path)))


@pytest.mark.parametrize("method", ["layered", "lightfield", "paper"])
def test_render_writes_every_picture_and_the_samples(tmp_path, method):
    paths = [tmp_path / name for name in ("a.png", "a.exr", "a.jpg")]
    outputs = [argument for path in paths for argument in ("-o", str(path))]
    samples = tmp_path / "samples.exr"
    arguments = [*outputs, "--samples", str(samples), "--method", method]
    assert cli.main(["render", FIGURE, *SMALL, *arguments]) == 0
    assert sorted(tmp_path.iterdir()) == sorted([*paths, samples])
    linear = read(paths[1])
    assert linear.shape == (24, 24, 3)
    assert linear.dtype == np.float32
    expected = np.array(pm.focus(pm.PointSamples.load(samples), method=method))
    np.testing.assert_allclose(linear, expected, atol=1e-5)
    for path in (paths[0], paths[2]):
        assert read(path).dtype == np.uint8
    srgb = np.array(
        mi.Bitmap(expected).convert(srgb_gamma=True, component_format=mi.Struct.Type.UInt8)
    )
    assert np.abs(read(paths[0]).astype(int) - srgb).max() <= 1


def header_of(path):
    spec = oiio.ImageInput.open(str(path)).spec()
    return {attribute.name: attribute.value for attribute in spec.extra_attribs}


def test_pictures_and_samples_say_of_which_scene_and_by_what_they_are(tmp_path):
    samples, rendered, again = (str(tmp_path / name) for name in ("a.samples", "a.exr", "b.png"))
    command = ["render", FIGURE, *SMALL, "--seed", "5", "-o", rendered, "--samples", samples]
    assert cli.main(command) == 0
    provenance = pm.PointSamples.load(samples).provenance
    assert provenance["scene"] == "figure11.xml"
    assert provenance["seed"] == 5
    assert provenance["define"] == "res=24 spp=4"
    assert json.loads(header_of(rendered)["potmesil:provenance"]) == provenance
    assert (
        cli.main(["focus", samples, "--method", "paper", "--focus-distance", "290", "-o", again])
        == 0
    )
    said = header_of(again)
    assert json.loads(said["potmesil:provenance"]) == provenance
    assert said["potmesil:method"] == "paper"
    assert float(said["potmesil:focus_distance"]) == 290


def test_of_files_in_definitions_the_names_alone_are_told(tmp_path):
    given = [("mesh", f"{tmp_path}/my mesh.ply"), ("color", "1/0.5/0.2")]
    source = taking.source_of(argparse.Namespace(scene=f"{tmp_path}/a.xml", define=given))
    assert source == {"scene": "a.xml", "define": "'mesh=my mesh.ply' color=1/0.5/0.2"}


def test_pictures_have_the_bits_and_the_quality_that_are_asked_for(tmp_path, capsys):
    samples = tmp_path / "a.samples"
    synthetic(500).save(samples)
    for name, form, kind in (
        ("a.png", ["--bit-depth", "16"], "uint16"),
        ("a.tif", [], "uint16"),
        ("a.tif", ["--bit-depth", "float"], "float"),
        ("a.exr", ["--bit-depth", "half"], "half"),
        ("a.jpg", ["--quality", "30"], "uint8"),
    ):
        assert cli.main(["focus", str(samples), "-o", str(tmp_path / name), *form]) == 0
        assert str(oiio.ImageInput.open(str(tmp_path / name)).spec().format) == kind
    for form, problem in (
        (["--bit-depth", "float"], "--bit-depth='float': must be one of 8, 16"),
        (["--quality", "30"], "quality=30: must be left out"),
    ):
        capsys.readouterr()
        assert cli.main(["focus", str(samples), "-o", str(tmp_path / "b.png"), *form]) == 1
        assert problem in capsys.readouterr().err
    assert not (tmp_path / "b.png").exists()


@pytest.mark.parametrize("name", ["a.png", "a.jpg"])
def test_very_bright_pixels_are_white_in_pictures_of_eight_bits(tmp_path, name):
    picture = np.zeros((8, 16, 3), dtype=np.float32)
    picture[:, 8:] = np.geomspace(2, 1e9, 8)[:, None, None]
    write_picture(mi.TensorXf(picture), tmp_path / name)
    written = read(tmp_path / name)
    assert written[:, 9:].min() > 245
    assert written[:, :7].max() < 10


@pytest.mark.parametrize(
    "options",
    [
        ["--aperture", "polygon:blades=5,rotation=10"],
        ["--aperture", "lommel:wavelengths=550"],
        ["--squeeze", "1.5"],
        ["--vignetting", "0.4"],
    ],
)
def test_the_aperture_of_the_command_line_is_that_of_the_samples(tmp_path, options):
    picture, samples = tmp_path / "a.exr", tmp_path / "samples.exr"
    arguments = [*SMALL, "--f-number", "1.4", *options]
    assert (
        cli.main(["render", FIGURE, *arguments, "-o", str(picture), "--samples", str(samples)]) == 0
    )
    lens = pm.PointSamples.load(samples).lens
    name, value = options[0][2:], options[1]
    expected = pm.aperture_of(value) if name == "aperture" else float(value)
    assert getattr(lens, name) == expected
    again = tmp_path / "b.exr"
    assert cli.main(["focus", str(samples), "-o", str(again)]) == 0
    np.testing.assert_allclose(read(again), read(picture), atol=1e-5)
    plain = ["--aperture", "disc", "--squeeze", "1", "--vignetting", "0"]
    assert cli.main(["focus", str(samples), *plain, "-o", str(again)]) == 0
    assert np.abs(read(again) - read(picture)).max() > 1e-4


def test_definitions_and_options_change_the_picture(tmp_path):
    def render(name, *arguments):
        path = tmp_path / name
        assert cli.main(["render", FIGURE, *SMALL, *arguments, "-o", str(path)]) == 0
        return read(path)

    focused = render("a.exr", "-D", "focus_distance=290")
    np.testing.assert_allclose(render("b.exr", "--focus-distance", "290"), focused, atol=1e-5)
    assert np.abs(render("c.exr") - focused).max() > 0.01
    paper = ["--focus-distance", "290", "--method", "paper"]
    printed = render("d.exr", *paper)
    assert np.abs(printed - focused).max() > 0.01
    other = render("f.exr", *paper, "--no-inverse-square", "--tables", "9")
    assert np.abs(other - printed).max() > 0.01
    grid = render("e.exr", "--pattern", "uniform", "--focus-distance", "290")
    assert 0 < np.sqrt(np.mean((grid - focused) ** 2)) < 0.1


@pytest.mark.parametrize(
    ("method", "name"),
    [
        (None, "a.samples"),
        ("layered", "samples.exr"),
        ("lightfield", "a.samples"),
        ("paper", "samples.exr"),
    ],
)
def test_kept_samples_are_refocused(tmp_path, method, name):
    samples, path = tmp_path / name, tmp_path / "far.exr"
    first = ["render", FIGURE, *SMALL, "-o", str(tmp_path / "a.exr"), "--samples", str(samples)]
    assert cli.main(first) == 0
    refocus = ["focus", str(samples), "--focus-distance", "980", "--f-number", "2", "-o", str(path)]
    assert cli.main([*refocus, *(["--method", method] if method else [])]) == 0
    loaded = pm.PointSamples.load(samples)
    lens = loaded.lens.replace(focus_distance=980, f_number=2)
    expected = pm.focus(loaded, lens, **({"method": method} if method else {}))
    np.testing.assert_allclose(read(path), np.array(expected), atol=1e-5)


def test_denoise_renders_and_refocuses_denoised_samples_and_keeps_them_as_they_were(tmp_path):
    pytest.importorskip("mitsuba_oidn", reason="needs mitsuba-oidn: pip install '.[denoise]'")
    rendered, samples, again = (str(tmp_path / name) for name in ("a.exr", "s.exr", "b.exr"))
    room = [str(SCENES / "room.xml"), "-D", "res=32", "--spp", "4", "--denoise"]
    assert cli.main(["render", *room, "-o", rendered, "--samples", samples]) == 0
    assert cli.main(["focus", samples, "--denoise", "-o", again]) == 0
    kept = pm.PointSamples.load(samples)
    assert np.abs(read(rendered) - np.array(pm.focus(kept))).max() > 0.02
    np.testing.assert_allclose(read(rendered), np.array(pm.focus(kept.denoised())), atol=1e-4)
    np.testing.assert_allclose(read(again), read(rendered), atol=1e-4)


def test_samples_without_features_are_not_denoised(tmp_path, capsys):
    samples = str(tmp_path / "s.exr")
    first = ["render", FIGURE, *SMALL, "-o", str(tmp_path / "a.exr"), "--samples", samples]
    assert cli.main(first) == 0
    assert cli.main(["focus", samples, "--denoise", "-o", str(tmp_path / "b.exr")]) == 1
    assert "features=True" in capsys.readouterr().err
    assert not (tmp_path / "b.exr").exists()


def test_without_the_denoiser_nothing_is_rendered(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "mitsuba_oidn", None)
    monkeypatch.setattr(
        hidden_surface, "render_samples", lambda *_, **__: pytest.fail("rendering started")
    )
    assert cli.main(["render", FIGURE, *SMALL, "--denoise", "-o", str(tmp_path / "a.exr")]) == 1
    assert "potmesil_mi[denoise]" in capsys.readouterr().err


PERSPECTIVE = """<scene version="3.0.0">
  <integrator type="direct"/><emitter type="constant"/>
  <shape type="sphere" id="ball"><point name="center" x="0" y="0" z="3"/></shape>
  <sensor type="{}"><float name="fov" value="60"/>{}
    <film type="hdrfilm"><integer name="width" value="20"/>
      <integer name="height" value="14"/></film>
    <sampler type="independent"><integer name="sample_count" value="4"/></sampler>
  </sensor></scene>"""
THINLENS = '<float name="aperture_radius" value="0.05"/><float name="focus_distance" value="2"/>'


def test_a_perspective_scene_is_rendered_through_a_lens_unedited(tmp_path):
    scene, out, samples = (tmp_path / name for name in ("scene.xml", "out.exr", "samples.exr"))
    scene.write_text(PERSPECTIVE.format("perspective", ""))
    lens = ["--f-number", "2", "--focus-distance", "1.2"]
    arguments = ["render", str(scene), *lens, "-o", str(out), "--samples", str(samples)]
    assert cli.main(arguments) == 0
    loaded = pm.PointSamples.load(samples)
    assert loaded.lens.f_number == 2
    assert loaded.lens.focus_distance == 1.2
    assert loaded.camera.x_fov == pytest.approx(60, abs=1e-4)


def test_a_perspective_scene_without_a_lens_is_asked_for_one(tmp_path, capsys):
    scene = tmp_path / "scene.xml"
    scene.write_text(PERSPECTIVE.format("perspective", ""))
    out = tmp_path / "out.png"
    assert cli.main(["render", str(scene), "--focus-distance", "2", "-o", str(out)]) == 1
    assert "--f-number" in capsys.readouterr().err
    assert not out.exists()


def test_a_thinlens_scene_keeps_its_aperture_and_focus(tmp_path):
    scene, samples = tmp_path / "scene.xml", tmp_path / "samples.exr"
    scene.write_text(PERSPECTIVE.format("thinlens", THINLENS))
    out = ["-o", str(tmp_path / "out.png"), "--samples", str(samples)]
    assert cli.main(["render", str(scene), *out]) == 0
    lens = pm.PointSamples.load(samples).lens
    assert lens.aperture_radius == pytest.approx(0.05)
    assert lens.focus_distance == pytest.approx(2)


@pytest.mark.parametrize(
    ("scene", "options"),
    [
        ("cbox/cbox-rgb.xml", ["--focus-distance", "1000", "--millimeters-per-unit", "1"]),
        ("matpreview/matpreview.xml", ["--focus-distance", "5.2"]),
    ],
)
def test_scenes_of_others_are_rendered_through_a_lens(tmp_path, scene, options):
    if not (OTHERS / scene).exists():
        pytest.skip(f"{scene} is not here")
    out = tmp_path / "out.exr"
    small = ["-D", "spp=4", *(["-D", "res=48"] if "cbox" in scene else ["-D", "width=64"])]
    small += [] if "cbox" in scene else ["-D", "height=48"]
    arguments = ["render", str(OTHERS / scene), *small, "--f-number", "1.4", *options]
    assert cli.main([*arguments, "-o", str(out)]) == 0
    image = read(out)
    assert image.shape[0] == 48
    assert np.isfinite(image).all()
    assert 0.02 < image.mean() < 2


# ---------------------------------------------------------------- dof


def test_dof_prints_table_1(capsys):
    assert cli.main(["dof"]) == 0
    text = capsys.readouterr().out
    rows = [re.findall(r"[\d.]+", line) for line in text.splitlines() if "f/" in line][:12]
    assert rows[0] == ["5.6", "2000", "2511", "1662", "849"]
    assert rows[3] == ["5.6", "290", "299", "282", "17"]
    assert rows[8] == ["22", "2000", "10000", "1111", "8889"]
    assert rows[11] == ["22", "290", "328", "260", "68"]
    assert "9.82 mm at f/5.6, 5.00 mm at f/11, 2.50 mm at f/22" in text


def test_dof_prints_any_lens_in_scene_units(capsys):
    lens = ["--focal-length", "50", "--f-number", "1.8", "--millimeters-per-unit", "1000"]
    assert cli.main(["dof", *lens, "--focus-distance", "1.5", "inf"]) == 0
    text = capsys.readouterr().out
    assert "1.423" in text
    assert "inf" in text


# ---------------------------------------------------------------- what goes wrong


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["render", "nothing.xml", "-o", "{}/a.png"], "nothing.xml"),
        (["render", FIGURE, "-o", "{}/a.gif"], r"a\.gif.*\.exr, \.png"),
        (["render", FIGURE, "-o", "/dev/null/a.png"], "is in a file, not a folder"),
        (["focus", "/dev/null", "-o", "{}/a.png"], "/dev/null: is not a file that can be read"),
        (
            ["render", FIGURE, *SMALL, "-o", "{}/a.png", "--f-number", "1e-320"],
            "--f-number=1e-320: must",
        ),
        (["render", FIGURE, "-o", "{}/a.png", "-D", "res=1000000"], "not enough memory: sampling"),
        (
            ["render", FIGURE, "-o", "{}/a.png", "--samples", "{}/a.png"],
            r"end in one of \.exr, \.samples",
        ),
        (["render", FIGURE, *SMALL, "-o", "{}/a.png", "--f-number", "0"], "--f-number=0"),
        (
            ["render", FIGURE, *SMALL, "-o", "{}/a.png", "--focus-distance", "50"],
            "--focus-distance=50",
        ),
        (["render", FIGURE, *SMALL, "-o", "{}/a.png", "--tables", "1"], "--tables=1"),
        (["render", FIGURE, *SMALL, "-o", "{}/a.png", "--sensor", "5"], "--sensor=5"),
        (["render", FIGURE, "-D", "colour=red", "-o", "{}/a.png"], "colour"),
        (["focus", "nothing.exr", "-o", "{}/a.png"], "nothing.exr"),
        (["focus", "nothing.samples", "-o", "{}/a.png"], r"nothing\.samples: there is no such"),
        (["focus", FIGURE, "-o", "{}/a.png"], "is a scene; `potmesil render --samples`"),
        (["dof", "--f-number", "-1"], "--f-number=-1"),
        (["render", FIGURE, *SMALL, "-m", "llvm_rgb", "-o", "{}/a.png"], "llvm_rgb"),
    ],
)
def test_an_error_is_one_line_with_exit_code_1_and_no_file(tmp_path, capsys, arguments, text):
    assert cli.main([argument.format(tmp_path) for argument in arguments]) == 1
    message = capsys.readouterr().err
    assert re.search(text, message)
    assert "potmesil: error:" in message
    assert "Traceback" not in message
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments",
    [
        ["-o", "{}/folder.png"],
        ["-o", "{}/a.exr", "--samples", "{}/a.exr"],
        ["-o", "{}/a.png", "--tables", "1"],
        ["-o", "{}/a.png", "--squares", "0"],
    ],
)
def test_what_must_fail_at_the_end_is_found_before_rendering(tmp_path, monkeypatch, arguments):
    monkeypatch.setattr(
        hidden_surface, "render_samples", lambda *_, **__: pytest.fail("rendering started")
    )
    (tmp_path / "folder.png").mkdir()
    arguments = [argument.format(tmp_path) for argument in arguments]
    assert cli.main(["render", FIGURE, *SMALL, *arguments]) == 1


def test_a_picture_does_not_take_the_place_of_its_samples(tmp_path, capsys):
    samples = tmp_path / "samples.exr"
    first = ["render", FIGURE, *SMALL, "-o", str(tmp_path / "a.png"), "--samples", str(samples)]
    assert cli.main(first) == 0
    whole = samples.read_bytes()
    assert cli.main(["focus", str(samples), "-o", str(samples)]) == 1
    assert "must not take the place" in capsys.readouterr().err
    assert samples.read_bytes() == whole


@pytest.mark.parametrize(
    "arguments",
    [[], ["paint"], ["render", FIGURE], ["render", FIGURE, "-o", "a.png", "-D", "res"]],
)
def test_wrong_usage_ends_with_exit_code_2(arguments):
    with pytest.raises(SystemExit) as caught:
        cli.main(arguments)
    assert caught.value.code == 2


def interrupted(*_, **__):
    raise KeyboardInterrupt


def test_ctrl_c_ends_with_exit_code_130_and_no_file(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(api, "focus", interrupted)
    assert cli.main(["render", FIGURE, *SMALL, "-o", str(tmp_path / "a.png")]) == 130
    assert "interrupted" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("module", ["numpy", "mitsuba"])
def test_ctrl_c_during_imports_ends_with_exit_code_130(module):
    code = f"""
import sys

class Finder:
    def find_spec(name, *_):
        if name == "{module}":
            raise KeyboardInterrupt

sys.meta_path.insert(0, Finder)
from potmesil_mi.cli import main
sys.exit(main(["render", "scene.xml", "-o", "a.png"]))"""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (result.returncode, result.stderr) == (130, "potmesil: interrupted\n")


@pytest.mark.parametrize("command", ["render", "focus", "dof"])
def test_help_has_units_and_examples(command, capsys):
    with pytest.raises(SystemExit) as caught:
        cli.main([command, "--help"])
    assert caught.value.code == 0
    text = capsys.readouterr().out
    assert "examples:" in text
    assert "in mm" in text


@pytest.mark.parametrize(
    ("texts", "owners"),
    [
        (options.SAMPLING_OPTIONS, [pm.Sampling]),
        (options.LENS_OPTIONS, [pm.ThinLens, pm.TelecentricLens]),
    ],
    ids=["sampling", "lens"],
)
def test_every_parameter_has_an_option_and_every_option_a_parameter(texts, owners):
    assert set(texts) == {name for each in owners for name in inspect.signature(each).parameters}


def test_every_option_of_the_method_is_one_of_focus():
    assert set(options.METHOD_OPTIONS) < set(inspect.signature(pm.focus).parameters)


def given_method(*arguments, said=None):
    parser = argparse.ArgumentParser()
    options.add_method(parser)
    return given.given_method(parser.parse_args(arguments), said)


def test_a_method_is_a_text_with_parameters_or_one_s_own():
    @dataclasses.dataclass(frozen=True)
    class Sharp(Method):
        sharpness: float = 1.0
        squares: int | None = None
        name: ClassVar[str] = "sharp"

    try:
        assert given_method() == pm.Layered()
        assert given_method("--method", "layered:lens_points=64") == pm.Layered(64)
        assert given_method("--method", "layered:lens_points=64", "--squares", "2") == pm.Layered(
            64, 2
        )
        assert given_method("--method", "sharp:sharpness=3", "--squares", "4") == Sharp(3, 4)
    finally:
        del Method._registered["sharp"]


def test_the_scene_says_of_the_method_what_the_options_do_not():
    said = pm.LightField(16, 3)
    assert given_method(said=said) is said
    assert given_method("--lens-points", "8", said=said) == pm.LightField(8, 3)
    assert given_method("--method", "layered", said=said) == pm.Layered(16, 3)
    assert given_method("--method", "layered:lens_points=64", said=said) == pm.Layered(64, 3)
    both = ["--method", "layered:lens_points=64", "--lens-points", "8"]
    assert given_method(*both, said=said) == pm.Layered(8, 3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sharp", "--method='sharp': must be one of layered, lightfield, paper;"),
        ("paper:lens_points=3", "lens_points: not a parameter of the method paper, which has ta"),
        ("layered:lens_points=0", "lens_points=0: must be"),
    ],
)
@pytest.mark.parametrize("command", ["render", "focus"])
def test_a_method_that_is_unknown_is_named_at_once(tmp_path, capsys, command, text, message):
    path = tmp_path / "a.png"
    assert cli.main([command, "absent", "--method", text, "-o", str(path)]) == 1
    assert capsys.readouterr().err.startswith(f"potmesil: error: {message}")


def test_help_names_the_methods(capsys):
    with pytest.raises(SystemExit):
        cli.main(["focus", "--help"])
    text = " ".join(capsys.readouterr().out.split())
    assert all(name in text for name in ("layered", "lightfield", "paper"))
    assert "such as layered:lens_points=64" in text


def test_the_program_lists_its_commands_and_tells_its_version(capsys):
    for arguments, text in (["--help"], "print depths of field"), (["--version"], "0.1.0\n"):
        with pytest.raises(SystemExit) as caught:
            cli.main(arguments)
        assert caught.value.code == 0
        assert text in capsys.readouterr().out


def test_a_picture_is_an_aperture_without_a_variant_too(tmp_path):
    picture, samples = tmp_path / "heart.png", tmp_path / "a.samples"
    write_picture(np.ones((8, 8, 3)), picture)
    arguments = ["render", FIGURE, *SMALL, "-o", str(tmp_path / "a.exr"), "--samples", str(samples)]
    assert cli.main(arguments) == 0
    command = ["focus", str(samples), "--aperture", f"image:filename={picture}", "-o"]
    outputs = [str(tmp_path / name) for name in ("b.exr", "c.exr")]
    program = f"from potmesil_mi.cli import main; raise SystemExit(main({[*command, outputs[0]]}))"
    process = [sys.executable, "-c", program]
    run = subprocess.run(process, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert cli.main([*command, outputs[1]]) == 0
    np.testing.assert_allclose(*map(read, outputs), rtol=1e-4, atol=1e-5)
