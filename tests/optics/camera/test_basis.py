"""Position and orientation of a camera: gaze and up, look-at, angles, dolly, both axes."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from potmesil_mi.optics.camera import (
    HALF_TURN,
    angles_of,
    basis_from_gaze,
    camera_from_world,
    convert_axes,
    dolly,
    look_at,
    orientation,
    rigid_inverse,
    transform_points,
    world_from_camera,
)

ANGLES = st.floats(-360, 360)
LEFT, UP, AHEAD = np.eye(3)
RIGHT = -LEFT
RANDOM = np.random.default_rng(5)
EYES, TARGETS, UPS = RANDOM.normal(0, 3, (3, 40, 3))


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


def test_opengl_axes_of_the_angles_are_half_a_turn_from_mitsubas():
    ours, theirs = orientation(10, 20, 30, axes="opengl"), orientation(10, 20, 30)
    np.testing.assert_allclose(ours @ HALF_TURN[:3, :3], theirs, atol=1e-15)


@pytest.mark.parametrize("axes", ["opengl", "mitsuba"])
@given(st.floats(-179, 179), st.floats(-89, 89), st.floats(-179, 179))
def test_angles_come_back(axes, pan, tilt, swing):
    found = angles_of(orientation(pan, tilt, swing, axes=axes), axes)
    np.testing.assert_allclose(found, (pan, tilt, swing), atol=1e-10)


@pytest.mark.parametrize("tilt", [90, -90])
@pytest.mark.parametrize("axes", ["opengl", "mitsuba"])
def test_looking_straight_up_or_down_all_of_the_turn_is_pan(tilt, axes):
    rotation = orientation(50, tilt, 20, axes=axes)
    found = angles_of(rotation, axes)
    assert found.swing == 0
    np.testing.assert_allclose(orientation(*found, axes=axes), rotation, atol=1e-12)


# ---------------------------------------------------------------- gaze and up, look-at


@pytest.mark.parametrize("axes", ["opengl", "mitsuba"])
def test_the_basis_is_orthonormal_right_handed_and_looks_along_the_gaze(axes):
    basis = basis_from_gaze(TARGETS, UPS, axes)
    np.testing.assert_allclose(
        np.swapaxes(basis, -1, -2) @ basis, np.eye(3) + 0 * basis, atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(basis), 1, atol=1e-12)
    gaze = TARGETS / np.linalg.norm(TARGETS, axis=-1, keepdims=True)
    view = basis[..., 2] * (1 if axes == "mitsuba" else -1)
    np.testing.assert_allclose(view, gaze, atol=1e-14)


def test_up_is_as_near_to_the_axis_as_the_view_plane_allows():
    """Section 5.5: v is the projection of t onto the view plane, made of length 1."""
    basis = basis_from_gaze(TARGETS, UPS)
    gaze = TARGETS / np.linalg.norm(TARGETS, axis=-1, keepdims=True)
    projected = UPS - np.sum(UPS * gaze, axis=-1, keepdims=True) * gaze
    projected /= np.linalg.norm(projected, axis=-1, keepdims=True)
    np.testing.assert_allclose(basis[..., 1], projected, atol=1e-11)


@pytest.mark.parametrize(("axes", "sign"), [("opengl", -1), ("mitsuba", 1)])
def test_the_target_is_on_the_axis_of_view(axes, sign):
    matrix = look_at(EYES, TARGETS, UPS, axes)
    seen = transform_points(rigid_inverse(matrix), TARGETS)
    distance = np.linalg.norm(TARGETS - EYES, axis=-1)
    np.testing.assert_allclose(seen, np.outer(sign * distance, [0, 0, 1]), atol=1e-12)


def test_world_and_camera_are_inverse_to_each_other():
    basis = basis_from_gaze(TARGETS, UPS)
    there, back = world_from_camera(basis, EYES), camera_from_world(basis, EYES)
    np.testing.assert_allclose(there @ back, np.eye(4) + 0 * there, atol=1e-13)
    np.testing.assert_allclose(rigid_inverse(there), back, atol=1e-13)
    np.testing.assert_allclose(rigid_inverse(back), there, atol=1e-13)


def test_axes_are_converted_by_half_a_turn():
    ours, theirs = look_at(EYES, TARGETS, UPS), look_at(EYES, TARGETS, UPS, "mitsuba")
    np.testing.assert_allclose(ours @ HALF_TURN, theirs, atol=1e-15)
    np.testing.assert_allclose(theirs @ HALF_TURN, ours, atol=1e-15)
    np.testing.assert_array_equal(convert_axes(convert_axes(EYES)), EYES)
    np.testing.assert_array_equal(convert_axes([1, 2, 3]), [-1, 2, -3])


@pytest.mark.parametrize(("axes", "sign"), [("opengl", -1), ("mitsuba", 1)])
def test_dollying_moves_the_camera_along_its_view_and_does_not_turn_it(axes, sign):
    before = look_at(EYES, TARGETS, UPS, axes)
    after = dolly(before, 2.5, axes)
    np.testing.assert_array_equal(after[..., :3], before[..., :3])
    step = after[..., :3, 3] - before[..., :3, 3]
    np.testing.assert_allclose(step, 2.5 * sign * before[..., :3, 2], atol=1e-14)


# ---------------------------------------------------------------- degenerate cameras


@pytest.mark.parametrize("up", [(0, 0, -2), (0, 0, 3), (0, 1e-9, 1)])
def test_an_up_along_the_gaze_is_refused(up):
    with pytest.raises(
        ValueError, match=r"^up=\(0.0, .*\): must be another direction than the gaze"
    ):
        basis_from_gaze((0, 0, -1), up)
    with pytest.raises(ValueError, match=r"^up="):
        look_at((0, 0, 1), (0, 0, 0), up)


@pytest.mark.parametrize(
    ("gaze", "up", "text"),
    [
        ((0, 0, 0), (0, 1, 0), r"^gaze=\(0.0, 0.0, 0.0\): must be a finite vector other than zero"),
        ((0, math.nan, 1), (0, 1, 0), r"^gaze=\(0.0, nan, 1.0\)"),
        ((0, math.inf, 1), (0, 1, 0), r"^gaze=\(0.0, inf, 1.0\)"),
        ((0, 0, 1), (0, 0, 0), r"^up=\(0.0, 0.0, 0.0\): must be a finite vector other than zero"),
    ],
)
def test_directions_without_a_direction_are_refused(gaze, up, text):
    with pytest.raises(ValueError, match=text):
        basis_from_gaze(gaze, up)


def test_a_target_at_the_eye_is_refused():
    with pytest.raises(ValueError, match=r"^target=\(1.0, 2.0, 3.0\): must be another point than"):
        look_at([(0, 0, 0), (1, 2, 3)], (1, 2, 3))


def test_the_bad_one_of_a_batch_is_named():
    with pytest.raises(ValueError, match=r"^gaze=\(0.0, 0.0, 0.0\)"):
        basis_from_gaze([(0, 0, 1), (0, 0, 0), (1, 0, 0)])


def test_a_matrix_that_scales_has_no_rigid_inverse():
    with pytest.raises(ValueError, match=r"^matrix=\(2.0, 0.0, 0.0\): must be a rotation"):
        rigid_inverse(np.diag([2.0, 1, 1, 1]))


@pytest.mark.parametrize("call", [basis_from_gaze, look_at, dolly])
def test_unknown_axes_are_refused_and_the_known_ones_named(call):
    arguments = {
        basis_from_gaze: [(0, 0, 1)],
        look_at: [(0, 0, 1), (0, 0, 0)],
        dolly: [np.eye(4), 1],
    }
    with pytest.raises(ValueError, match=r"^axes='z': must be one of opengl, mitsuba"):
        call(*arguments[call], axes="z")
