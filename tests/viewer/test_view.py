"""A view of samples: what it answers, without a page."""

import dataclasses
import json
import math

import mitsuba as mi
import numpy as np
import OpenImageIO as oiio
import pytest

import potmesil_mi as pm
from potmesil_mi._image import linear_from_srgb
from potmesil_mi.evaluation import metrics
from potmesil_mi.viewer import view as module
from potmesil_mi.viewer.beside import Beside
from potmesil_mi.viewer.opening import view_of
from potmesil_mi.viewer.view import Viewer
from scenes import evenly_spread, still_life, synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")

LENS = pm.ThinLens(50.0, 0.25, 2.0, millimeters_per_unit=1000.0)
OF_SCENE = {"sensor": 0, "spp": 2, "seed": 0, "sampling": None}


def samples_of_two_things(**fields):
    """Near on the left at 1.5, far on the right at 4."""
    samples = evenly_spread((30, 20), 2)
    left = samples.x < 15
    return samples.replace(
        z=np.where(left, 1.5, 4.0), surface=np.where(left, 1, 2), lens=LENS, **fields
    )


def question(view, **changes):
    return json.loads(json.dumps({**view.about["start"], "id": "1", **changes}))


def answered(view, **changes):
    answer = view.answer(question(view, **changes))
    assert answer.message["kind"] == "picture", answer.message
    json.dumps(answer.message, allow_nan=False)
    return answer


def error(view, **changes):
    message = question(view, **changes)
    answer = view.answer({name: value for name, value in message.items() if value != "left out"})
    assert answer.message["kind"] == "error"
    assert answer.message["id"] == "1"
    assert answer.picture == b""
    return answer.message["text"]


def decoded(answer, tmp_path):
    """The picture in an answer, linear (H, W, 3)."""
    path = tmp_path / f"answer.{answer.message['type'].removeprefix('image/')}"
    path.write_bytes(answer.picture)
    return linear_from_srgb(oiio.ImageBuf(str(path)).get_pixels("float"))


# ---------------------------------------------------------------- pictures


def test_a_click_focuses_on_what_is_there_and_the_picture_is_that_of_a_focus(tmp_path):
    samples = samples_of_two_things()
    view = Viewer(samples)
    for x, depth in ((5, 1.5), (25, 4.0)):
        answer = answered(view, at=[x, 10])
        assert answer.message["focus_distance"] == depth
        assert view.lens == view.lens.replace(focus_distance=depth)
        expected = np.clip(pm.focus(samples, LENS.replace(focus_distance=depth)), 0, 1)
        assert metrics.psnr(decoded(answer, tmp_path), expected) > 35


def test_the_answer_tells_the_lens_in_words():
    message = answered(Viewer(samples_of_two_things()), focus_distance=1.5, opening=0.5).message
    assert message["line"].startswith("f/0.5 focused at 1.5 m, sharp from ")
    assert (message["focus_text"], message["opening_text"]) == ("1.5 m", "f/0.5")


def test_a_small_picture_is_of_a_smaller_film_and_says_where_it_goes(monkeypatch, tmp_path):
    monkeypatch.setattr(module, "SMALL_PIXELS", 100)
    camera = dataclasses.replace(
        samples_of_two_things().camera, crop_offset=(1, 1), crop_size=(28, 18)
    )
    view = Viewer(samples_of_two_things(camera=camera, window=(0, 0, 30, 20)))
    assert view.about["has_small"] is True
    answer = answered(view, small=True)
    assert answer.message["small"] is True
    assert answer.message["box"] == [-1, -1, 30, 21]
    assert decoded(answer, tmp_path).shape == (7, 10, 3)
    whole = answered(view)
    assert (whole.message["small"], whole.message["box"]) == (False, [0, 0, 28, 18])


def test_a_small_film_has_no_smaller_one():
    view = Viewer(samples_of_two_things())
    assert view.about["has_small"] is False
    assert answered(view, small=True).message["small"] is False


def test_exposure_shows_the_same_picture_lighter_and_forms_it_once(monkeypatch, tmp_path):
    view = Viewer(samples_of_two_things(rgb=np.full((2400, 3), 0.2)))
    formed = []
    focus = pm.FocusSession.focus
    monkeypatch.setattr(
        pm.FocusSession, "focus", lambda *a, **k: formed.append(1) or focus(*a, **k)
    )
    dark, light = (decoded(answered(view, exposure=e), tmp_path).mean() for e in (0, 1))
    assert light == pytest.approx(2 * dark, rel=0.02)
    assert formed == [1]


def test_blades_and_methods_change_the_picture():
    view = Viewer(samples_of_two_things())
    pictures = {
        answered(view, **changes).picture
        for changes in (
            {},
            {"shape": "polygon", "blades": 3},
            {"shape": "polygon", "blades": 5},
            {"method": "paper"},
        )
    }
    assert len(pictures) == 4


def test_small_pictures_of_the_slow_method_are_by_the_quick_one(monkeypatch):
    monkeypatch.setattr(module, "SMALL_PIXELS", 100)
    view = Viewer(samples_of_two_things(), method="lightfield")
    formed = []
    monkeypatch.setattr(
        module, "FocusSession", lambda s, m: formed.append(m) or pm.FocusSession(s, m)
    )
    answered(view, small=True)
    assert formed == [pm.Layered()]
    assert "method='lightfield'" in answered(view).message["python"]
    assert formed[1:] == [pm.LightField()]


# ---------------------------------------------------------------- overlays


def test_the_depth_is_shown_nearest_white_and_sky_black(tmp_path):
    samples = samples_of_two_things()
    samples = samples.replace(z=np.where(samples.y < 5, np.inf, samples.z))
    picture = decoded(answered(Viewer(samples), overlay="depth"), tmp_path)
    assert picture[10, 5].tolist() == [1, 1, 1]
    assert 0.02 < picture[10, 25, 0] < 0.5
    assert picture[2, 5].tolist() == [0, 0, 0]


def test_circles_are_orange_nearer_and_blue_beyond(tmp_path):
    picture = decoded(
        answered(Viewer(samples_of_two_things()), overlay="circles", focus_distance=2.0), tmp_path
    )
    assert picture[10, 5, 0] > picture[10, 5, 2]
    assert picture[10, 25, 2] > picture[10, 25, 0]


def test_what_is_not_sharp_loses_its_colour(tmp_path):
    view = Viewer(samples_of_two_things(rgb=np.tile([0.8, 0.2, 0.1], (2400, 1))))
    picture = decoded(answered(view, overlay="sharp", at=[25, 10]), tmp_path)
    assert picture[10, 25] == pytest.approx([0.8, 0.2, 0.1], abs=0.05)
    assert np.ptp(picture[10, 3]) < 0.02


def test_the_difference_to_thinlens_becomes_less_noisy_from_answer_to_answer():
    scene = still_life()
    view = view_of(scene, None, "layered", (), OF_SCENE)
    assert "difference" in view.about["overlays"]
    first, second = (answered(view, overlay="difference").message for _ in range(2))
    assert "with 32 samples a pixel, whose noise is at" in first["line"]
    assert "with 64 samples a pixel" in second["line"]
    assert second["more"] is True
    other = answered(view, overlay="difference", focus_distance=3.0).message
    assert "with 32 samples a pixel" in other["line"]
    assert "must be a disc" in error(view, overlay="difference", shape="polygon")


def test_without_a_scene_there_is_no_difference():
    view = Viewer(samples_of_two_things())
    assert "difference" not in view.about["overlays"]
    assert error(view, overlay="difference").startswith("overlay=difference: needs a scene")


# ---------------------------------------------------------------- sliders


def test_the_focus_goes_by_equal_steps_of_the_circle_through_all_that_is_in_sight():
    about = Viewer(samples_of_two_things()).about
    distances = about["foci"]
    assert distances[0] == pytest.approx(1.5)
    assert distances[-1] == pytest.approx(4)
    steps = np.diff(1 / np.array(distances))
    assert np.ptp(steps) < 1e-9
    assert about["focus_texts"][0] == "1.5 m"


def test_the_sky_is_at_the_end_of_the_focus():
    samples = samples_of_two_things()
    view = Viewer(samples.replace(z=np.where(samples.y < 5, np.inf, samples.z)))
    assert view.about["foci"][-1] == "inf"
    message = answered(view, focus_distance="inf").message
    assert (message["focus_distance"], message["focus_text"]) == ("inf", "infinity")
    assert 'focus_distance=float("inf")' in message["python"]


def test_the_aperture_ends_where_samples_serve_no_wider_one():
    samples = pm.render_samples(still_life(), spp=2)
    widest = min(Viewer(samples).about["openings"])
    assert widest == pytest.approx(0.25)
    narrow = samples.replace(lens=samples.lens.replace(f_number=2.0))
    assert min(Viewer(narrow).about["openings"]) == pytest.approx(0.25)
    by_radius = samples.lens.replace(aperture_radius=float(samples.lens.aperture_radius))
    view = Viewer(samples, by_radius)
    assert max(view.about["openings"]) == pytest.approx(by_radius.aperture_radius, rel=1e-3)
    assert "aperture_radius=" in answered(view).message["python"]
    assert error(view, opening=1e3).startswith("aperture_radius=1000.0: must be ")


def test_a_pinhole_has_nothing_to_refocus():
    with pytest.raises(ValueError, match="lens: is a pinhole"):
        Viewer(samples_of_two_things().replace(lens=LENS.replace(f_number=math.inf)))
    with pytest.raises(ValueError, match="lens: must be given, for the scene's sensor has none"):
        view_of(still_life(sensor={"type": "perspective"}), None, "layered", (), OF_SCENE)


@pytest.mark.parametrize("sensor", [None, {"type": "perspective", "fov": 60}])
def test_a_scene_gets_another_lens_and_keeps_its_field_of_view(sensor):
    scene = still_life(sensor=sensor)
    own = pm.potmesil_sensor(scene.sensors()[0]).camera()
    lens = pm.ThinLens(80.0, 1.4, 3.0, millimeters_per_unit=1000.0)
    view = view_of(scene, lens, "layered", (), OF_SCENE)
    assert view.lens.f_number == 1.4
    assert view._full.samples.camera.x_fov == pytest.approx(own.x_fov)


@pytest.mark.parametrize(
    ("z", "focus", "ends"),
    [
        (np.inf, math.inf, (0.1, "inf")),
        (np.inf, 3.0, (0.1, "inf")),
        (2.0, 2.0, (1.05, 4.0)),
        (0.02, 3.0, (0.1, 3.0)),
        (2.0, 0.07, (0.07, 2.0)),
    ],
)
def test_wherever_things_are_there_is_a_range_to_focus_in(z, focus, ends):
    samples = samples_of_two_things().replace(z=np.full(2400, z))
    distances = Viewer(samples, LENS.replace(focus_distance=focus)).about["foci"]
    assert distances[0] == pytest.approx(ends[0])
    assert distances[-1] == (ends[1] if z == np.inf else pytest.approx(ends[1]))


# ---------------------------------------------------------------- other samples


def test_an_aperture_that_is_a_picture_is_named_and_copied():
    heart = pm.ImageAperture(np.eye(8))
    view = Viewer(samples_of_two_things(), LENS.replace(aperture=heart))
    assert view.about["shapes"] == {"own": "image", "disc": "disc", "polygon": "polygon"}
    names = {"pm": pm, "samples": samples_of_two_things()}
    exec(answered(view).message["python"], names)
    assert names["lens"] == view.lens


def test_a_telecentric_lens_has_a_half_angle():
    camera = dataclasses.replace(
        synthetic(1).camera, projection="orthographic", x_fov=0.0, film_width=5.0
    )
    samples = synthetic(2000, camera=camera, lens=pm.TelecentricLens(5.0, 2.0))
    view = Viewer(samples)
    assert np.ptp(np.diff(view.about["foci"])) < 1e-9
    message = answered(view, at=[10, 7]).message
    assert message["opening_text"] == "5°"
    assert "pm.TelecentricLens(half_angle=5.0" in message["python"]
    assert "half_angle=80.0: must be" in error(view, opening=80.0)


def test_samples_that_move_are_shown_as_they_were_exposed():
    samples = synthetic(2000, motion=np.tile([1.0, 0, 0], (2000, 1)), time=np.full(2000, 0.5))
    assert answered(Viewer(samples)).message["kind"] == "picture"


def test_samples_on_a_lattice_are_shown_small(monkeypatch):
    monkeypatch.setattr(module, "SMALL_PIXELS", 100)
    samples = pm.render_samples(still_life(), sampling=pm.Sampling("uniform"))
    assert samples.lattice > 0
    assert answered(Viewer(samples), small=True).message["small"] is True


def test_spectral_samples_are_shown(variant_spectral):
    view = view_of(still_life(), None, "layered", (), OF_SCENE)
    assert answered(view).message["kind"] == "picture"


def test_a_warning_of_a_focus_is_a_note():
    samples = pm.render_samples(still_life(), spp=2)
    wider = samples.lens.replace(f_number=0.1)
    note = answered(Viewer(samples, wider)).message["note"]
    assert "is wider than the lens that the samples were taken for" in note


# ---------------------------------------------------------------- what is not trusted


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"focus_distance": "near"}, "focus_distance='near': must be a number"),
        ({"focus_distance": -1}, "focus_distance="),
        ({"focus_distance": 0.01}, "beyond the focal length"),
        ({"at": [1]}, "at: must be two numbers"),
        ({"at": [1, "2"]}, "at[1]='2': must be a number"),
        ({"at": [31, 2]}, "must be in the picture"),
        ({"opening": None}, "opening=None: must be a number"),
        ({"opening": 0.1}, "f_number=0.1: must be"),
        ({"shape": "image:filename=/etc/passwd"}, "must be one of own, disc, polygon"),
        ({"blades": 13}, "blades=13: must be 3 to 12"),
        ({"blades": 5.5}, "blades=5.5: must be a whole number"),
        ({"method": "layered:lens_points=4096"}, "must be one of own, layered"),
        ({"exposure": 1e9}, "exposure=1000000000.0: must be -6 to 6"),
        ({"overlay": []}, "overlay=[]: must be one of none"),
        ({"small": 1}, "small=1: must be True or False"),
        ({"opening": "left out"}, "message: must have opening"),
        ({"more": 1}, "message='more': must have"),
    ],
)
def test_what_a_page_may_not_ask_is_refused_by_name(changes, text):
    assert text in error(Viewer(samples_of_two_things()), **changes)


@pytest.mark.parametrize("message", [None, [], "text", 5, {}, {"id": {}}])
def test_what_is_no_question_is_answered_by_an_error(message):
    answer = Viewer(samples_of_two_things()).answer(message)
    assert answer.message["kind"] == "error"
    assert "must" in answer.message["text"]


def test_an_error_that_nobody_expected_is_told_and_the_next_question_answered(monkeypatch):
    view = Viewer(samples_of_two_things())
    with monkeypatch.context() as patch:
        patch.setattr(module, "encoded_picture", lambda *_: {}["lost"])
        assert error(view) == "KeyError: 'lost' (unexpected)"
    assert answered(view)


# ---------------------------------------------------------------- copied


@pytest.mark.parametrize("sensor", [None, {"type": "perspective", "fov": 50}, "crop"])
def test_the_copied_lens_is_the_one_that_is_shown(sensor):
    crop = {"crop_offset_x": 2, "crop_offset_y": 1, "crop_width": 20, "crop_height": 12}
    is_crop = sensor == "crop"
    scene = still_life(film=crop if is_crop else None, sensor=None if is_crop else sensor)
    view = view_of(scene, LENS if sensor and not is_crop else None, "layered", (), OF_SCENE)
    message = answered(view, focus_distance=2.5, shape="polygon", blades=7).message
    loaded = mi.load_string(message["xml"])
    assert loaded.lens().focus_distance == 2.5
    assert loaded.lens().f_number == pytest.approx(float(view.lens.f_number), rel=1e-6)
    assert loaded.lens().aperture == pm.Polygon(7)
    mine, theirs = view._full.samples.camera, loaded.camera()
    assert theirs.x_fov == pytest.approx(mine.x_fov, rel=1e-5)
    assert np.allclose(theirs.to_world, mine.to_world, atol=1e-6)
    assert (theirs.film_size, theirs.crop_offset) == (mine.film_size, mine.crop_offset)
    names = {"pm": pm, "samples": view._full.samples}
    exec(message["python"], names)
    assert names["lens"] == view.lens
    assert names["image"].shape == (mine.crop_size[1], mine.crop_size[0], 3)


def test_the_copied_sensor_of_a_telecentric_lens_loads():
    scaled = mi.ScalarTransform4f().scale([1.5, 1.5, 1])
    scene = still_life(sensor={"type": "orthographic", "to_world": scaled})
    view = view_of(scene, pm.TelecentricLens(4.0, 2.0), "layered", (), OF_SCENE)
    loaded = mi.load_string(answered(view).message["xml"])
    assert loaded.lens() == view.lens
    assert loaded.camera().film_width == pytest.approx(3.0)


def test_beside_refuses_what_has_no_thinlens():
    scene = still_life()
    beside = Beside(scene, pm.potmesil_sensor(scene.sensors()[0]), 0)
    with pytest.raises(ValueError, match="lens=TelecentricLens: must be a ThinLens"):
        beside.difference(np.zeros((16, 24, 3)), pm.TelecentricLens(1.0, 2.0))
