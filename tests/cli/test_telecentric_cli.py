"""The command line before scenes with an orthographic sensor."""

import json
import math

import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.cli import main

SCENE = """<scene version="3.0.0">
  <integrator type="direct"/>
  <sensor type="{sensor}">{more}
    <film type="hdrfilm">
      <integer name="width" value="16"/><integer name="height" value="16"/>
    </film>
    <sampler type="independent"><integer name="sample_count" value="4"/></sampler>
  </sensor>
  <shape type="sphere">
    <point name="center" x="0" y="0" z="2.5"/><float name="radius" value="0.5"/>
  </shape>
  <emitter type="constant"/>
</scene>"""


@pytest.fixture
def scene(tmp_path):
    def written(sensor="orthographic", more=""):
        path = tmp_path / f"{sensor}.xml"
        path.write_text(SCENE.format(sensor=sensor, more=more), encoding="utf-8")
        return str(path)

    return written


def test_an_orthographic_scene_is_rendered_and_focused_anew(scene, tmp_path):
    picture, samples, again = (str(tmp_path / name) for name in ("a.exr", "s.exr", "b.exr"))
    lens = ["--half-angle", "5", "--focus-distance", "2"]
    assert main(["render", scene(), *lens, "-o", picture, "--samples", samples]) == 0
    assert pm.PointSamples.load(samples).lens == pm.TelecentricLens(5.0, 2.0)
    assert main(["focus", samples, "--half-angle", "9", "-o", again]) == 0
    first, second = (np.array(mi.Bitmap(path)) for path in (picture, again))
    assert first.shape[:2] == second.shape[:2] == (16, 16)
    assert np.abs(first[..., :3] - second[..., :3]).max() > 1e-4


def test_the_focus_that_an_orthographic_scene_states_need_not_be_told(scene, tmp_path):
    stated = scene(more='<float name="focus_distance" value="2"/>')
    samples = str(tmp_path / "s.exr")
    told = ["--half-angle", "5", "-o", str(tmp_path / "a.exr"), "--samples", samples]
    assert main(["render", stated, *told]) == 0
    assert pm.PointSamples.load(samples).lens == pm.TelecentricLens(5.0, 2.0)


@pytest.mark.parametrize(
    ("command", "sensor", "options", "message"),
    [
        ("render", "orthographic", [], "--half-angle and --focus-distance"),
        (
            "render",
            "perspective",
            ["--half-angle", "5"],
            "--half-angle=5.0: is for an ortho",
        ),
        (
            "compare",
            "orthographic",
            ["--half-angle", "5", "--focus-distance", "2"],
            "is orthographic, must be perspective",
        ),
    ],
)
def test_what_does_not_fit_is_refused_by_name(
    scene, tmp_path, capsys, command, sensor, options, message
):
    output = ["-o", str(tmp_path / "a.png")]
    assert main([command, scene(sensor), *options, *output]) != 0
    assert message in " ".join(capsys.readouterr().err.split())


def test_a_stack_of_an_orthographic_scene_goes_by_equal_steps_of_depth(scene, tmp_path):
    foci = ["--near", "1", "--far", "3", "--count", "3", "--depth-map", "--circle-map", "--pinhole"]
    output = ["-o", str(tmp_path / "out" / "{}.exr")]
    assert main(["stack", scene(), "--half-angle", "5", *foci, *output]) == 0
    told = json.loads((tmp_path / "out" / "stack.json").read_text())
    assert [one["focus_distance"] for one in told["pictures"]] == [1, 2, 3]
    assert told["camera"]["pixels_per_unit"] == 8
    circles = told["pictures"][0]["circle_of_confusion"]
    assert circles["scale"] == pytest.approx(2 * math.tan(math.radians(5)) * 8)
    farthest = circles["scale"] * (told["depth"]["farthest"] - 1)
    assert circles["largest_pixels"] == pytest.approx(farthest)


def test_lengths_with_units_ask_for_that_of_the_scene(scene, tmp_path, capsys):
    kept = str(tmp_path / "s.samples")
    lens = ["--half-angle", "5", "--focus-distance", "20mm", "-o", str(tmp_path / "a.exr")]
    assert main(["render", scene(), *lens]) == 1
    assert "--focus-distance=20.0mm: needs the size of a scene unit" in capsys.readouterr().err
    assert main(["render", scene(), *lens, "--units", "cm", "--samples", kept]) == 0
    assert pm.PointSamples.load(kept).lens == pm.TelecentricLens(5.0, 2.0)
    ends = ["--near", "20mm", "--far", "3cm", "--count", "2", "-o", str(tmp_path / "{:02d}.exr")]
    assert main(["stack", kept, *ends]) == 1
    assert "must have no unit" in capsys.readouterr().err
    assert main(["stack", kept, *ends, "--units", "cm"]) == 0
    told = json.loads((tmp_path / "stack.json").read_text())
    assert [one["focus_distance"] for one in told["pictures"]] == [2, 3]


def test_info_needs_no_lens(scene, capsys):
    assert main(["info", scene(), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["nearest"] == pytest.approx(2, abs=0.1)
    assert found["half_angle"] == 0
