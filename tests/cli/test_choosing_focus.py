"""What helps to choose a focus, and what a command says of its pictures."""

import json
import re
import subprocess
import sys

import numpy as np
import OpenEXR
import pytest

import potmesil_mi as pm
from potmesil_mi import cli
from scenes import SCENES

pytestmark = pytest.mark.usefixtures("variant_llvm")

FIGURE = str(SCENES / "figure11.xml")
SMALL = ["-D", "res=24", "-D", "spp=4"]

IN_CENTIMETERS = """<scene version="3.0.0">
  <integrator type="direct"/>
  <sensor type="perspective">
    <float name="fov" value="40"/>
    <film type="hdrfilm">
      <integer name="width" value="48"/><integer name="height" value="32"/>
    </film>
    <sampler type="independent"><integer name="sample_count" value="4"/></sampler>
  </sensor>
  <emitter type="constant"/>
  <shape type="sphere" id="cup"><point name="center" x="-25" y="0" z="120"/>
    <float name="radius" value="20"/></shape>
  <shape type="sphere" id="jug"><point name="center" x="60" y="0" z="300"/>
    <float name="radius" value="50"/></shape>
</scene>"""


@pytest.fixture
def table(tmp_path):
    """A scene in centimetres that has a pinhole alone."""
    (tmp_path / "table.xml").write_text(IN_CENTIMETERS)
    return str(tmp_path / "table.xml")


def told(capsys):
    return capsys.readouterr().err


@pytest.mark.filterwarnings("always::potmesil_mi._warnings.FocusWarning")
def test_a_scene_in_centimetres_is_told_to_be_sharp_and_its_unit_helps(table, tmp_path, capsys):
    lens = ["--f-number", "f/2", "--focus-on", "cup", "-o", str(tmp_path / "a.exr")]
    assert cli.main(["render", table, *lens]) == 0
    said = told(capsys)
    assert "warning: everything is sharp" in said
    assert "--units" in said
    assert cli.main(["render", table, *lens, "--units", "cm", "--f-number", "0.5"]) == 0
    said = told(capsys)
    assert "warning" not in said
    line = (
        r"wrote \S+/a\.exr: 48x32, f/0\.5 focused at 10\d(\.\d+)? cm, sharp from .* circles up to"
    )
    assert re.search(line, said)


@pytest.mark.parametrize(
    ("place", "least", "most"),
    [
        (["--focus-on", "cup"], 100, 120),
        (["--focus-at", "75%,50%"], 100, 125),
        (["--focus-at", "12,16"], 250, 300),
        (["--focus-distance", "1.1m"], 110, 110),
        (["--focus-distance", "1100mm"], 110, 110),
    ],
)
def test_a_focus_is_chosen_by_name_by_place_or_by_length(
    table, tmp_path, capsys, place, least, most
):
    kept = str(tmp_path / "s.samples")
    arguments = ["-o", str(tmp_path / "a.exr"), "--samples", kept, "--units", "cm"]
    assert cli.main(["render", table, "--f-number", "0.5", *place, *arguments]) == 0
    distance = pm.PointSamples.load(kept).lens.focus_distance
    assert least - 1e-3 <= distance <= most + 1e-3
    again = ["focus", kept, *place, "-o", str(tmp_path / "b.exr"), "--json"]
    capsys.readouterr()
    assert cli.main(again) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["focus_distance"] == pytest.approx(distance, abs=2)
    assert said["written"] == [str(tmp_path / "b.exr")]
    assert said["largest_circle_pixels"] > 1


@pytest.mark.filterwarnings("always::potmesil_mi._warnings.FocusWarning")
def test_an_aperture_without_a_focus_is_told(table, tmp_path, capsys):
    lens = ["--f-number", "0.5", "--units", "cm"]
    assert cli.main(["render", table, *lens, "-o", str(tmp_path / "a.exr")]) == 0
    assert "focus_distance: is not given, so that the lens is focused at infinity" in told(capsys)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--focus-on", "cop"], "--focus-on='cop': is not in the scene; did you mean 'cup'?"),
        (["--focus-at", "50,3"], "--focus-at: x=50, y=3: must be in the picture, 0 to 48 across"),
        (["--focus-at", "3,3", "--focus-on", "cup"], "must not be given beside focus_at"),
        (["--focus-at", "3,3", "--focus-distance", "3"], "must not be given beside focus_at or"),
        (["--units", "cm", "--millimeters-per-unit", "3"], "--units=cm: must not be given beside"),
    ],
)
def test_a_focus_that_cannot_be_chosen_is_refused_by_its_option(
    table, tmp_path, capsys, options, text
):
    lens = ["--f-number", "0.5", *options, "-o", str(tmp_path / "a.exr")]
    assert cli.main(["render", table, *lens]) == 1
    assert text in told(capsys)
    assert not (tmp_path / "a.exr").exists()


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--focus-at", "3"], "must be two numbers with a comma between"),
        (["--focus-distance", "1.2q"], "must be a length, such as 1.2, 1.2m or 290mm"),
        (["--f-number", "two"], "must be an f-number, such as 2.8 or f/2.8"),
        (["--f-nubmer", "2"], "unrecognized arguments: --f-nubmer 2; did you mean --f-number?"),
        (["--f-num", "2"], "unrecognized arguments: --f-num 2; did you mean --f-number?"),
    ],
)
def test_wrong_usage_of_a_command_is_told_by_the_command(tmp_path, capsys, options, text):
    with pytest.raises(SystemExit) as ended:
        cli.main(["render", FIGURE, *options, "-o", str(tmp_path / "a.png")])
    assert ended.value.code == 2
    said = told(capsys)
    assert "potmesil render: error: " in said
    assert text in said
    assert len(said.splitlines()) == 3, "the usage, the error and where help is"


def test_an_unknown_command_is_told_what_may_be_meant(capsys):
    with pytest.raises(SystemExit):
        cli.main(["foucs", "a.samples"])
    assert "did you mean focus?" in told(capsys)


def test_quiet_says_nothing_and_verbose_says_more(tmp_path, capsys):
    arguments = ["render", FIGURE, *SMALL, "-o", str(tmp_path / "a.png")]
    assert cli.main([*arguments, "--quiet"]) == 0
    assert told(capsys) == ""
    assert cli.main([*arguments, "--verbose"]) == 0
    said = told(capsys)
    assert said.count("potmesil: ") == 2
    assert "GB of memory at most" in said


def test_info_tells_what_there_is_to_focus_on(table, tmp_path, capsys):
    lens = ["--f-number", "0.5", "--units", "cm", "--focus-on", "cup"]
    assert cli.main(["info", table, *lens, "--map", str(tmp_path / "map.png")]) == 0
    said = capsys.readouterr().out
    assert "48x32 pixels, perspective, 40 degrees across" in said
    assert re.search(r"cup +\d+\.\d % +10\d(\.\d)? cm", said)
    assert (tmp_path / "map.png").exists()
    assert cli.main(["info", table, *lens, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {one["name"] for one in found["surfaces"]} == {"cup", "jug"}
    assert found["has_sky"]
    assert found["sharp_from"] < found["focus_distance"] < found["sharp_to"]


def test_info_needs_no_lens_and_reads_samples_and_pictures(table, tmp_path, capsys):
    assert cli.main(["info", table]) == 0
    assert "a pinhole" in capsys.readouterr().out
    kept, picture = str(tmp_path / "s.samples"), str(tmp_path / "a.exr")
    sharp = ["--f-number", "inf", "--focus-distance", "100", "-o", picture, "--maps", "depth"]
    assert cli.main(["render", table, *sharp, "--samples", kept]) == 0
    assert cli.main(["info", kept]) == 0
    assert "a pixel" in capsys.readouterr().out
    for source in (kept, picture):
        capsys.readouterr()
        assert cli.main(["info", source, "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert (found["width"], found["height"]) == (48, 32)
        assert 95 < found["nearest"] < 105
        assert found["samples"] >= 48 * 32 > found["spp"]
        assert found["focus_bytes"] > 1e6


def test_info_is_of_the_lens_that_the_scene_has(capsys):
    """The options replace parts of it; a pinhole stays one where they open none."""
    assert cli.main(["info", FIGURE, *SMALL, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["f_number"], found["focus_distance"]) == (pytest.approx(5.6), pytest.approx(550))
    assert cli.main(["info", FIGURE, *SMALL, "--json", "--focus-distance", "29cm"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["f_number"], found["focus_distance"]) == (pytest.approx(5.6), pytest.approx(290))


def test_a_map_of_circles_has_their_diameters(table, tmp_path):
    path = tmp_path / "map.exr"
    lens = ["--f-number", "0.5", "--units", "cm", "--focus-on", "cup"]
    assert cli.main(["info", table, *lens, "--map", str(path)]) == 0
    with OpenEXR.File(str(path), separate_channels=True) as file:
        read = file.channels()["coc"].pixels
    assert read.shape == (32, 48)
    assert np.abs(read[16, 36]) < 1, "the cup"
    assert -5 < read[16, 12] < -3, "the jug"
    assert read[0, 0] < -6, "the sky"


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_shells_learn_commands_and_options(shell, capsys):
    assert cli.main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert "animate" in script
    assert shell == "tcsh" or "--focus-on" in script


def test_depths_of_field_are_told_as_json(capsys):
    arguments = ["--focal-length", "5cm", "--f-number", "f/2", "--focus-distance", "2m", "--json"]
    assert cli.main(["dof", *arguments]) == 0
    (row,) = json.loads(capsys.readouterr().out)["rows"]
    near, far = pm.ThinLens(50, 2, 2000).depth_of_field()
    assert (row["near"], row["far"], row["lens_diameter_mm"]) == (near, far, 25)


def test_help_needs_neither_mitsuba_nor_rich():
    code = (
        "import sys; from potmesil_mi import cli\n"
        "try: cli.main(['--help'])\n"
        "except SystemExit: pass\n"
        "print([n for n in ('mitsuba', 'drjit', 'rich', 'scipy', 'shtab') if n in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.splitlines()[-1] == "[]"
