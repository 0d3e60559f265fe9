"""AOVs in the film of the integrators, and in the files of the command line."""

import mitsuba as mi
import numpy as np
import OpenEXR
import pytest

import potmesil_mi as pm
from potmesil_mi.cli import main
from scenes import still_life

pytestmark = pytest.mark.usefixtures("variant_llvm")

AOV = {"type": "aov", "aovs": "dd:depth,al:albedo", "image": {"type": "path", "max_depth": 3}}
NAMES = ["dd.T", "al.R", "al.G", "al.B"]


def film_of(scene):
    return [field.name for field in scene.sensors()[0].film().bitmap().struct_()]


def test_the_film_has_the_picture_as_without_aovs_and_unfocused_ones():
    scene = still_life({"type": "focus", "nested": AOV})
    picture = np.array(mi.render(scene))
    assert picture.shape == (16, 24, 3 + 4)
    assert film_of(scene) == ["R", "G", "B", *(f"unfocused.{name}" for name in NAMES)]
    plain = np.array(mi.render(still_life({"type": "focus", "nested": AOV["image"]})))
    # Threads add up the same light in any order.
    np.testing.assert_allclose(picture[..., :3], plain, atol=1e-6)
    maps = pm.aov_maps(pm.render_samples(scene))
    for i, name in enumerate(NAMES):
        np.testing.assert_array_equal(picture[..., 3 + i], maps[name])


def test_alpha_comes_before_aovs():
    scene = still_life({"type": "focus", "nested": AOV}, film={"pixel_format": "rgba"})
    picture = np.array(mi.render(scene))
    assert picture.shape == (16, 24, 4 + 4)
    assert film_of(scene)[3:5] == ["A", "unfocused.dd.T"]
    assert picture[8, 12, 3] == pytest.approx(1)


def test_focused_aovs_have_the_names_of_their_own():
    scene = still_life({"type": "focus", "nested": AOV, "focus_aovs": True})
    picture = np.array(mi.render(scene))
    assert film_of(scene) == ["R", "G", "B", *NAMES]
    found = pm.focus_aovs(pm.render_samples(scene), rfilter=scene.sensors()[0].film().rfilter())
    np.testing.assert_allclose(picture[..., 3:], np.stack([*found.values()], axis=-1), atol=1e-6)
    assert "focus_aovs = True" in str(scene.integrator())


def test_other_than_true_or_false_is_refused():
    with pytest.raises(RuntimeError, match="focus_aovs=2: must be true or false"):
        mi.load_dict({"type": "focus", "nested": AOV, "focus_aovs": 2})


def test_point_samples_have_them_beside_their_own():
    scene = still_life({"type": "point_samples", "nested": AOV})
    picture = np.array(mi.render(scene))
    assert film_of(scene) == ["R", "G", "B", "x", "y", "z", "id", "weight", *NAMES]
    met = np.isfinite(picture[..., 5])
    assert (picture[met][:, 8] > 1).all()
    np.testing.assert_array_equal(picture[~met][:, 8:], 0)


SCENE = """<scene version="3.0.0">
  <integrator type="focus">{integrator}</integrator>
  <sensor type="potmesil">
    <float name="f_number" value="2"/><float name="focus_distance" value="2"/>
    <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="6"/></film>
    <sampler type="independent"><integer name="sample_count" value="4"/></sampler>
  </sensor>
  <shape type="sphere"><point name="center" x="0" y="0" z="3"/></shape>
  <emitter type="constant"/>
</scene>"""
NESTED = """<integrator type="aov"><string name="aovs" value="dd:depth,nn:sh_normal"/>
<integrator type="path"/></integrator>"""


def channels_of(path):
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels for name, channel in file.channels().items()}


def test_commands_write_them_beside_the_picture(tmp_path, capsys):
    scene, kept, picture = (str(tmp_path / name) for name in ("a.xml", "a.samples", "a.exr"))
    (tmp_path / "a.xml").write_text(SCENE.format(integrator=NESTED))
    aovs = {"unfocused.dd.T", "unfocused.nn.X", "unfocused.nn.Y", "unfocused.nn.Z"}
    maps = ["--maps", "depth", "aovs"]
    assert main(["render", scene, "-o", picture, "--samples", kept, *maps, "normal"]) == 0
    rendered = channels_of(picture)
    assert aovs | {"R", "G", "B", "Z", "N.X", "N.Y", "N.Z"} == set(rendered)
    assert main(["focus", kept, "-o", picture, *maps]) == 0
    focused = channels_of(picture)
    for name in aovs:
        np.testing.assert_array_equal(focused[name], rendered[name])
    focused = NESTED + '<boolean name="focus_aovs" value="true"/>'
    (tmp_path / "a.xml").write_text(SCENE.format(integrator=focused))
    assert main(["render", scene, "-o", picture]) == 0
    assert {"R", "G", "B", "dd.T", "nn.X", "nn.Y", "nn.Z"} == set(channels_of(picture))
    (tmp_path / "a.xml").write_text(SCENE.format(integrator='<integrator type="path"/>'))
    assert main(["render", scene, "-o", picture, *maps]) == 1
    assert "maps=aovs: the integrator has none; put it into an aov" in capsys.readouterr().err
