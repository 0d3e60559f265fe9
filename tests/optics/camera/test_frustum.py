"""The frustum in other terms, balls in it, zoom, and parameters that make none."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from potmesil_mi.optics import camera as cam

FOVS, ASPECTS, NEARS = st.floats(1, 170), st.floats(0.2, 5), st.floats(0.01, 10)
RANDOM = np.random.default_rng(6)


@given(FOVS, ASPECTS, NEARS)
def test_every_set_of_parameters_describes_the_same_frustum(fov, aspect, near):
    view = cam.Frustum(fov, aspect, near, 50)
    others = [
        cam.Frustum.from_x_fov(view.x_fov, aspect, near, 50),
        cam.Frustum.from_near_plane(view.near_width, view.near_height, near, 50),
        cam.Frustum.from_far_plane(view.far_width, view.far_height, near, 50),
        cam.Frustum.from_lens(view.focal_length(36), 36, 36 / aspect, near, 50),
    ]
    for other in others:
        assert (other.y_fov, other.aspect) == pytest.approx((fov, aspect), rel=1e-12)
        assert (other.near, other.far) == (near, 50)


def test_a_normal_lens():
    """A 50 mm lens before a 36 by 24 mm frame: 39.6° by 27.0°."""
    view = cam.Frustum.from_lens(50, 36, 24, 0.1, 100)
    assert view.x_fov == pytest.approx(2 * math.degrees(math.atan(18 / 50)), rel=1e-12)
    assert view.y_fov == pytest.approx(2 * math.degrees(math.atan(12 / 50)), rel=1e-12)


@pytest.mark.parametrize("axes", ["opengl", "mitsuba"])
def test_planes_go_through_the_corners_and_face_inwards(axes):
    view = cam.Frustum(50, 1.5, 1, 8)
    corners = np.stack(view.corners(axes))
    distances = view.distances(corners, axes)
    on = {
        "left": [0, 3, 4, 7],
        "right": [1, 2, 5, 6],
        "bottom": [0, 1, 4, 5],
        "top": [2, 3, 6, 7],
        "near": [0, 1, 2, 3],
        "far": [4, 5, 6, 7],
    }
    for name, values in zip(cam.FRUSTUM_PLANES, distances, strict=True):
        np.testing.assert_allclose(values[on[name]], 0, atol=1e-12)
        assert (np.delete(values, on[name]) > 0.1).all()
    middle = corners.mean(0)
    for plane, distance in zip(view.planes(axes), view.distances(middle, axes), strict=True):
        foot = middle - distance * plane[:3]
        assert foot @ plane[:3] + plane[3] == pytest.approx(0, abs=1e-12)
        assert np.linalg.norm(plane[:3]) == pytest.approx(1, rel=1e-12)


def test_left_is_where_the_picture_is_left():
    view = cam.Frustum(50, 1.5, 1, 8)
    point = (-9.0, 0, -5)
    assert view.distances(point).left < 0 < view.distances(point).right
    assert cam.outside_planes(cam.multiply(view.clip_from_camera(), (*point, 1))).left


@pytest.mark.parametrize("axes", ["opengl", "mitsuba"])
def test_a_far_plane_at_infinity_holds_everything_in_front(axes):
    view = cam.Frustum(50, 1.5, 1, math.inf)
    points = np.array([(0, 0, -1e9), (0, 0, -0.5)]) * (1 if axes == "opengl" else -1)
    np.testing.assert_array_equal(view.contains(points, axes), [True, False])
    np.testing.assert_allclose(view.clip_from_camera()[2], [0, 0, -1, -2], atol=1e-15)


def test_balls_are_inside_outside_or_cut_planes():
    view = cam.Frustum(90, 2, 2, 10)
    centers = [(0, 0, -5), (0, 0, -2.5), (0, 0, -20), (0, 4, -5), (0, 9, -5)]
    ball = view.ball(centers, 1)
    np.testing.assert_array_equal(ball.inside, [True, False, False, False, False])
    np.testing.assert_array_equal(ball.outside, [False, False, True, False, True])
    np.testing.assert_array_equal(ball.cuts.near, [False, True, False, False, False])
    np.testing.assert_array_equal(ball.cuts.top, [False, False, False, True, False])
    np.testing.assert_allclose(ball.distances.top[3], 1 / math.sqrt(2), atol=1e-12)


def test_a_ball_is_inside_where_all_of_its_surface_is():
    view, radius = cam.Frustum(60, 1.5, 1, 9), 0.5
    centers = RANDOM.uniform([-5, -4, -10], [5, 4, 0], (400, 3))
    surface = RANDOM.normal(0, 1, (4000, 3))
    surface *= radius / np.linalg.norm(surface, axis=-1, keepdims=True)
    ball = view.ball(centers, radius)
    seen = view.contains(centers[:, None] + surface)
    margin = min_distance = np.min(np.abs(np.abs(ball.distances) - radius), axis=0)
    clear = min_distance > 0.01  # The surface is sampled: what touches within 0.01 is left out.
    assert margin.shape == (400,)
    np.testing.assert_array_equal(ball.inside[clear], seen.all(-1)[clear])
    assert not seen[ball.outside].any()


@pytest.mark.parametrize("axes", ["opengl", "mitsuba"])
def test_dolly_zoom_keeps_the_size_of_what_is_at_the_depth_and_no_other(axes):
    view, place = cam.Frustum(50, 1.5, 0.1, 99), cam.look_at((3, 2, 1), (0, 0, 0), axes=axes)
    ahead = -1 if axes == "opengl" else 1
    corners = [(x, y, ahead * depth) for depth in (6.0, 9.0) for x, y in ((1, 0.5), (-0.5, 1))]
    world = cam.transform_points(place, corners)

    def images(frustum, matrix):
        camera = cam.transform_points(cam.rigid_inverse(matrix), world)
        clip = cam.multiply(frustum.clip_from_camera(axes), cam.homogeneous(camera))
        return cam.perspective_divide(clip)[:, :2]

    moved = cam.dolly_zoom(view, place, 6.0, 2.0, axes)
    before, after = images(view, place), images(*moved)
    np.testing.assert_allclose(after[:2], before[:2], atol=1e-12)
    assert (np.linalg.norm(after[2:], axis=-1) < np.linalg.norm(before[2:], axis=-1)).all()
    assert moved[0].y_fov > view.y_fov
    np.testing.assert_allclose(moved[1], cam.dolly(place, 2.0, axes), atol=1e-15)


def test_zoom_magnifies_the_picture():
    view, point = cam.Frustum(50, 1.5, 1, 8), (0.3, 0.2, -3, 1)
    before = cam.perspective_divide(cam.multiply(view.clip_from_camera(), point))
    after = cam.perspective_divide(cam.multiply(view.zoom(2.5).clip_from_camera(), point))
    np.testing.assert_allclose(after[:2], 2.5 * before[:2], rtol=1e-12)
    assert view.zoom(1).y_fov == pytest.approx(50, rel=1e-14)


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ((0, 1, 1, 10), r"^y_fov=0.0: must be > 0 and < 180 degrees"),
        ((180, 1, 1, 10), r"^y_fov=180.0: must be"),
        ((-5, 1, 1, 10), r"^y_fov=-5.0"),
        ((math.nan, 1, 1, 10), r"^y_fov=nan"),
        ((50, 0, 1, 10), r"^aspect=0.0: must be > 0 and finite"),
        ((50, -1, 1, 10), r"^aspect=-1.0"),
        ((50, math.inf, 1, 10), r"^aspect=inf"),
        ((50, 1, 0, 10), r"^near=0.0: must be > 0 and less than far=10"),
        ((50, 1, 10, 10), r"^near=10.0: must be > 0 and less than far=10"),
        ((50, 1, 11, 10), r"^near=11.0"),
        ((50, 1, math.inf, math.inf), r"^near=inf"),
        ((50, 1, 1, math.nan), r"^near=1.0: must be > 0 and less than far=nan"),
        ((np.array([50, 200.0]), 1, 1, 2), r"^y_fov=200.0"),
    ],
)
def test_frustums_that_are_none_are_refused(parameters, text):
    with pytest.raises(ValueError, match=text):
        cam.Frustum(*parameters)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda v: cam.Frustum.from_x_fov(180, 1, 1, 2), r"^x_fov=180.0: must be > 0 and < 180"),
        (lambda v: cam.Frustum.from_x_fov(90, 0, 1, 2), r"^aspect=0.0: must be > 0"),
        (lambda v: cam.Frustum.from_near_plane(0, 1, 1, 2), r"^width=0.0: must be > 0"),
        (lambda v: cam.Frustum.from_near_plane(1, -1, 1, 2), r"^height=-1.0: must be > 0"),
        (lambda v: cam.Frustum.from_far_plane(1, 1, 1, math.inf), r"^far=inf: must be > 0 and fin"),
        (lambda v: cam.Frustum.from_lens(0, 36, 24, 1, 2), r"^focal_length=0.0: must be > 0"),
        (lambda v: v.zoom(0), r"^magnification=0.0: must be > 0"),
        (lambda v: v.focal_length(0), r"^frame_width=0.0: must be > 0"),
        (lambda v: v.ball((0, 0, -1), -1), r"^radius=-1.0: must be >= 0"),
        (lambda v: v.planes("z"), r"^axes='z': must be one of opengl, mitsuba"),
        (lambda v: v.corners("z"), r"^axes='z'"),
        (lambda v: v.clip_from_camera("z"), r"^axes='z'"),
        (lambda v: cam.dolly_zoom(v, np.eye(4), 0, -1), r"^depth=0.0: must be > 0"),
        (lambda v: cam.dolly_zoom(v, np.eye(4), 3, 3), r"^distance=3.0: must be less than depth=3"),
    ],
)
def test_bad_parameters_of_a_frustum_are_named(call, text):
    with pytest.raises(ValueError, match=text):
        call(cam.Frustum(50, 1.5, 1, 8))
