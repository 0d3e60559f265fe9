"""Orientation by pan, tilt and swing, fields of view, and the camera's description."""

import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from potmesil_mi import Camera
from potmesil_mi.optics.camera import FOV_AXES, horizontal_fov, orientation

ANGLES = st.floats(-360, 360)
LEFT, UP, AHEAD = np.eye(3)
RIGHT = -LEFT


# ---------------------------------------------------------------- orientation


def test_without_angles_the_camera_looks_along_z_with_y_up():
    np.testing.assert_array_equal(orientation(0, 0, 0), np.eye(3))


@pytest.mark.parametrize(
    ("angles", "axis", "turned_to"),
    [
        ((90, 0, 0), AHEAD, RIGHT),
        ((90, 0, 0), UP, UP),
        ((0, 90, 0), AHEAD, UP),
        ((0, 90, 0), LEFT, LEFT),
        ((0, 0, 90), UP, RIGHT),
        ((0, 0, 90), AHEAD, AHEAD),
    ],
    ids=["pan_right", "pan_about_y", "tilt_up", "tilt_about_x", "swing_clockwise", "swing_about_z"],
)
def test_positive_angles_turn_right_upwards_and_clockwise(angles, axis, turned_to):
    np.testing.assert_allclose(orientation(*angles) @ axis, turned_to, atol=1e-15)


@given(ANGLES, ANGLES, ANGLES)
def test_orientation_is_a_rotation(pan, tilt, swing):
    rotation = orientation(pan, tilt, swing)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(rotation) == pytest.approx(1, abs=1e-14)


def turned(vectors, axis, degrees):
    """The columns of `vectors` turned about `axis`, right-handed (Rodrigues)."""
    angle = math.radians(degrees)
    along = np.outer(axis, axis @ vectors)
    across = np.cross(axis, vectors, axisb=0, axisc=0)
    return along + math.cos(angle) * (vectors - along) + math.sin(angle) * across


@given(ANGLES, ANGLES, ANGLES)
def test_pan_then_tilt_then_swing_about_the_axes_that_moved_along(pan, tilt, swing):
    frame = np.eye(3)
    frame = turned(frame, frame[:, 1], -pan)
    frame = turned(frame, frame[:, 0], -tilt)
    frame = turned(frame, frame[:, 2], swing)
    np.testing.assert_allclose(orientation(pan, tilt, swing), frame, atol=1e-13)


@given(ANGLES, ANGLES, ANGLES)
def test_swing_leaves_the_line_of_sight(pan, tilt, swing):
    p, t = math.radians(pan), math.radians(tilt)
    line_of_sight = [-math.sin(p) * math.cos(t), math.sin(t), math.cos(p) * math.cos(t)]
    np.testing.assert_allclose(orientation(pan, tilt, swing) @ AHEAD, line_of_sight, atol=1e-14)


@given(ANGLES, ANGLES)
def test_without_swing_the_horizon_is_level(pan, tilt):
    assert (orientation(pan, tilt, 0) @ LEFT) @ UP == pytest.approx(0, abs=1e-15)


# ---------------------------------------------------------------- fields of view


@pytest.mark.parametrize("axis", FOV_AXES)
@given(st.floats(0.5, 175), st.floats(0.2, 5))
def test_horizontal_fov_follows_from_the_distance_of_the_film(axis, fov, aspect):
    """A film of height 1 stands where its side (or diagonal) fills the field of view."""
    sides = {"x": aspect, "y": 1.0, "diagonal": math.sqrt(aspect * aspect + 1)}
    sides |= {"smaller": min(aspect, 1.0), "larger": max(aspect, 1.0)}
    distance = sides[axis] / 2 / math.tan(math.radians(fov) / 2)
    expected = 2 * math.degrees(math.atan2(aspect / 2, distance))
    assert horizontal_fov(fov, axis, aspect) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("axis", ["smaller", "larger", "x", "y"])
def test_every_side_of_a_square_film_has_the_same_field_of_view(axis):
    assert horizontal_fov(40, axis, 1.0) == pytest.approx(40, rel=1e-14)


@pytest.mark.parametrize("fov", [0, 180, -1, 400, math.nan])
def test_impossible_fields_of_view_are_refused(fov):
    with pytest.raises(ValueError, match=f"^fov={fov}: "):
        horizontal_fov(fov, "x", 1.5)


def test_unknown_axes_are_refused_and_the_known_ones_named():
    with pytest.raises(ValueError, match=r"^fov_axis='z': .*x, y, diagonal, smaller, larger"):
        horizontal_fov(40, "z", 1.5)


# ---------------------------------------------------------------- the camera's description


def camera():
    return Camera(
        film_size=(320, 200),
        crop_offset=(10, 20),
        crop_size=(100, 50),
        x_fov=39.6,
        to_world=tuple(map(tuple, np.arange(16.0).reshape(4, 4).tolist())),
        near_clip=0.1,
        far_clip=77.0,
        principal_point_offset=(0.25, -0.125),
        shutter_open=0.5,
        shutter_close=1.5,
    )


def test_camera_survives_json_unchanged():
    restored = Camera.from_dict(json.loads(json.dumps(camera().to_dict())))
    assert restored == camera()
    assert hash(restored) == hash(camera())  # lists have become tuples, all the way down


def test_camera_refuses_unknown_fields():
    with pytest.raises(TypeError, match="aperture"):
        Camera.from_dict({**camera().to_dict(), "aperture": 1})


def test_camera_cannot_be_changed_under_the_samples_it_took():
    with pytest.raises(dataclasses.FrozenInstanceError):
        camera().x_fov = 10


@pytest.mark.parametrize(("fov", "pixels"), [(90, 160), (2 * math.degrees(math.atan(0.5)), 320)])
def test_focal_length_in_pixels_is_that_of_the_whole_film(fov, pixels):
    whole = dataclasses.replace(camera(), x_fov=fov)
    assert whole.focal_length_pixels == pytest.approx(pixels, rel=1e-14)
    assert dataclasses.replace(whole, crop_size=(1, 1)).focal_length_pixels == pytest.approx(pixels)


@pytest.mark.parametrize(
    ("field", "value", "error", "text"),
    [
        ("film_size", (320,), TypeError, r"film_size=\(320,\): must be a tuple of 2"),
        ("film_size", (320, 0), ValueError, r"film_size\[1\]=0: must be 1 to"),
        ("film_size", (320.0, 200), TypeError, r"film_size\[0\]=320.0: must be a whole number"),
        ("crop_offset", (-1, 0), ValueError, r"crop_offset\[0\]=-1"),
        ("crop_offset", 3, TypeError, "crop_offset=3: must be a tuple of 2"),
        ("crop_size", (311, 50), ValueError, "crop window must lie in the film of 320 pixels"),
        ("crop_size", (100, True), TypeError, r"crop_size\[1\]=True"),
        ("x_fov", 0, ValueError, "x_fov=0: must be > 0 and < 180"),
        ("x_fov", 180.0, ValueError, "x_fov=180.0"),
        ("x_fov", math.nan, ValueError, "x_fov=nan"),
        ("x_fov", 10**400, ValueError, "x_fov=1000"),
        ("x_fov", "40", TypeError, "x_fov='40': must be a number"),
        ("to_world", ((1.0,) * 4,) * 3, TypeError, "to_world=.*must be a tuple of 4"),
        ("to_world", ((1.0,) * 3,) * 4, TypeError, r"to_world\[0\]=.*must be a tuple of 4"),
        ("to_world", ((math.inf,) * 4,) * 4, ValueError, r"to_world\[0\]\[0\]=inf"),
        ("near_clip", 0.0, ValueError, "near_clip=0.0, far_clip=77.0: must be > 0"),
        ("far_clip", 0.05, ValueError, "near_clip=0.1, far_clip=0.05"),
        ("far_clip", math.nan, ValueError, "far_clip=nan"),
        ("principal_point_offset", (0, math.inf), ValueError, r"principal_point_offset\[1\]=inf"),
        ("shutter_close", 0.25, ValueError, "shutter_close=0.25: must be >= 0.5"),
        ("shutter_open", None, TypeError, "shutter_open=None: must be a number"),
    ],
)
def test_a_bad_field_of_a_camera_is_named(field, value, error, text):
    with pytest.raises(error, match=text):
        dataclasses.replace(camera(), **{field: value})


def test_the_far_plane_may_be_at_infinity():
    assert dataclasses.replace(camera(), far_clip=math.inf).far_clip == math.inf


def test_a_missing_field_is_named():
    values = camera().to_dict()
    del values["x_fov"]
    with pytest.raises(TypeError, match="x_fov: must be given"):
        Camera.from_dict(values)
