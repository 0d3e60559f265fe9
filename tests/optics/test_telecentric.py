"""The telecentric lens: closed forms, what is refused, and the thin lens in its place."""

import dataclasses
import json
import math

import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.optics.blur import Blur
from potmesil_mi.optics.telecentric import as_thin_lens, require_fitting

LENS = pm.TelecentricLens(10.0, 3.0)


def orthographic(**fields):
    given = {
        "film_size": (40, 20),
        "crop_offset": (0, 0),
        "crop_size": (40, 20),
        "x_fov": 0.0,
        "to_world": tuple(map(tuple, np.eye(4).tolist())),
        "projection": "orthographic",
        "film_width": 4.0,
    }
    return pm.Camera(**{**given, **fields})


def test_the_circle_is_the_cone_at_the_distance_from_focus():
    slope = math.tan(math.radians(10))
    assert LENS.circle_of_confusion(2.0) == pytest.approx(2 * slope, rel=1e-15)
    depth = np.array([1.0, 3.0, 5.0])
    np.testing.assert_allclose(LENS.circle_of_confusion(depth), slope * np.array([4.0, 0, -4]))
    assert LENS.circle_of_confusion(math.inf) == -math.inf
    assert pm.TelecentricLens(0, 3.0).circle_of_confusion(math.inf) == 0


def test_depth_of_field_ends_where_the_circle_has_that_size():
    near, far = LENS.depth_of_field(0.1)
    np.testing.assert_allclose(LENS.circle_of_confusion(np.array([near, far])), [0.1, -0.1])
    assert pm.TelecentricLens(0, 3.0).depth_of_field(0.1).depth == math.inf
    with pytest.raises(ValueError, match="circle=0: must be > 0"):
        LENS.depth_of_field(0)


def test_a_lens_comes_back_from_its_dictionary():
    lens = pm.TelecentricLens(5.0, -1.0, "polygon:blades=5", 1.5)
    assert pm.TelecentricLens.from_dict(json.loads(json.dumps(lens.to_dict()))) == lens
    assert lens.replace(half_angle=2.0) == dataclasses.replace(lens, half_angle=2.0)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"half_angle": 81}, "half_angle=81: "),
        ({"half_angle": -1}, "half_angle=-1: "),
        ({"focus_distance": math.inf}, "focus_distance=inf: "),
        ({"squeeze": 5}, "squeeze=5: "),
        ({"aperture": "lommel"}, "aperture=lommel: must not diffract"),
        ({"f_number": 2.0}, "f_number: not a parameter of TelecentricLens"),
    ],
)
def test_bad_parameters_are_refused_by_name(parameters, message):
    with pytest.raises((ValueError, TypeError), match=message):
        LENS.replace(**parameters)


@pytest.mark.parametrize("focus_distance", [-2.0, 1.5, 4.0, 50.0])
def test_the_thin_lens_has_the_same_circles_in_pixels(focus_distance):
    lens, camera = LENS.replace(focus_distance=focus_distance), orthographic()
    depth = np.array([1.0, 2.5, 4.0])
    picture = as_thin_lens(depth, lens, camera)
    expected = lens.circle_of_confusion(depth) / 2 * camera.pixels_per_unit
    vergence = picture.reference - depth
    blur = Blur.of(picture.lens, picture.camera)
    np.testing.assert_allclose(blur.radius(vergence), expected, rtol=1e-10, atol=1e-10)
    per_mm = picture.camera.focal_length_pixels / picture.lens.film_distance
    circles = picture.lens.circle_of_confusion(1 / vergence) / 2 * per_mm
    np.testing.assert_allclose(circles, expected, rtol=1e-10, atol=1e-10)
    changed = picture.depth(np.array([*depth, np.inf], dtype=np.float32))
    np.testing.assert_allclose(changed, [*(1 / vergence), np.inf], rtol=1e-6)


def test_the_reference_depth_does_not_change_as_the_lens_is_focused_within_the_scene():
    depth = np.linspace(1, 5, 9)
    references = {
        as_thin_lens(depth, LENS.replace(focus_distance=u), orthographic()).reference
        for u in (-1.0, 1.0, 3.0, 5.0)
    }
    assert len(references) == 1


def test_an_orthographic_camera_projects_in_parallel():
    camera = orthographic()
    pixels = camera.pixel_from_world([[1.0, 0.5, 3.0], [1.0, 0.5, 9.0]])
    np.testing.assert_allclose(pixels, [[10, 5], [10, 5]], atol=1e-12)
    np.testing.assert_allclose(camera.world_from_pixel([10.0, 5.0], 3.0), [1, 0.5, 3], atol=1e-12)
    assert camera.pixels_per_unit == 10
    assert pm.Camera.from_dict(json.loads(json.dumps(camera.to_dict()))) == camera


@pytest.mark.parametrize("name", ["focal_length_pixels", "frustum"])
def test_what_needs_a_pinhole_is_refused_by_name(name):
    with pytest.raises(ValueError, match=f"must be 'perspective' for {name}"):
        getattr(orthographic(), name)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"projection": "oblique"}, "projection='oblique'"),
        ({"film_width": None}, "film_width: must be given"),
        ({"film_width": 0.0}, r"film_width=0\.0: "),
        ({"x_fov": 40.0}, r"x_fov=40\.0: must be 0"),
        ({"projection": "perspective", "x_fov": 40.0}, "film_width=4.0: must be None"),
    ],
)
def test_a_camera_that_is_half_orthographic_is_refused(fields, message):
    with pytest.raises((ValueError, TypeError), match=message):
        orthographic(**fields)


def test_a_perspective_header_is_what_it_was():
    camera = orthographic(projection="perspective", film_width=None, x_fov=40.0)
    assert not {"projection", "film_width"} & camera.to_dict().keys()


def test_each_camera_needs_its_lens():
    with pytest.raises(ValueError, match="lens=ThinLens: must be a TelecentricLens"):
        require_fitting(orthographic(), pm.ThinLens(50.0, 2.0))
