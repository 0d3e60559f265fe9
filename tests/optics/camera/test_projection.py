"""Windows off the axis, far planes at infinity, projections in both axes, and what is refused."""

import math

import numpy as np
import pytest

from potmesil_mi.optics import camera as cam

RANDOM = np.random.default_rng(3)
POINTS = RANDOM.uniform([-3, -3, -9], [3, 3, -1], (30, 3))


def applied(matrix, points):
    return cam.perspective_divide(cam.multiply(matrix, cam.homogeneous(points)))


def test_corners_of_a_window_off_the_axis_become_corners_of_the_cube():
    window = (-1, 3, -0.5, 2)
    matrix = cam.perspective_clip_from_camera(*window, 2, 10)
    for z, depth in ((-1, 2), (1, 10)):
        for x, left in ((-1, -1), (1, 3)):
            for y, bottom in ((-1, -0.5), (1, 2)):
                corner = (left * depth / 2, bottom * depth / 2, -depth)
                np.testing.assert_allclose(applied(matrix, corner), [x, y, z], atol=1e-12)


def test_the_box_of_an_orthographic_camera_becomes_the_cube():
    matrix = cam.orthographic_clip_from_camera(-1, 3, -0.5, 2, -2, 10)
    for z, depth in ((-1, -2), (1, 10)):
        for (x, left), (y, bottom) in (((-1, -1), (-1, -0.5)), ((1, 3), (1, 2))):
            np.testing.assert_allclose(
                applied(matrix, (left, bottom, -depth)), [x, y, z], atol=1e-12
            )


def test_orthographic_ndc_is_affine_in_depth_and_scales_the_image():
    matrix = cam.orthographic_clip_from_camera(-2, 2, -2, 2, 1, 9)
    ndc = applied(matrix, POINTS)
    np.testing.assert_allclose(ndc[:, :2], cam.orthographic_image(POINTS, 0.5), atol=1e-12)
    np.testing.assert_allclose(ndc[:, 2], (-POINTS[:, 2] - 5) / 4, atol=1e-12)


@pytest.mark.parametrize(
    "project",
    [
        lambda p, axes: cam.image_from_camera(p, 2, axes),
        lambda p, axes: cam.orthographic_image(p, 2, axes),
        lambda p, axes: cam.vanishing_point(p, 2, axes),
        lambda p, axes: cam.pseudodepth(p[:, 2], 1, 9, axes),
        lambda p, axes: applied(cam.perspective_clip_from_camera(-1, 3, -1, 2, 1, 9, axes), p),
        lambda p, axes: applied(cam.orthographic_clip_from_camera(-1, 3, -1, 2, 1, 9, axes), p),
    ],
)
def test_what_is_projected_does_not_depend_on_the_axes_it_is_stated_in(project):
    theirs = project(cam.convert_axes(POINTS), "mitsuba")
    np.testing.assert_allclose(theirs, project(POINTS, "opengl"), atol=1e-12)


def test_a_far_plane_at_infinity_is_the_limit():
    """-1 and -2 n in the third row; pseudodepth 1 - 2 n/depth."""
    assert cam.pseudodepth(-4.0, 1, math.inf) == pytest.approx(0.5, abs=1e-15)
    near = cam.perspective_clip_from_camera(-1, 1, -1, 1, 2, 1e15)
    at = cam.perspective_clip_from_camera(-1, 1, -1, 1, 2, math.inf)
    np.testing.assert_allclose(at, near, rtol=1e-14)
    np.testing.assert_allclose(at[2], [0, 0, -1, -4], atol=1e-15)


def test_a_light_at_the_origin_gives_the_matrix_of_the_text():
    plane = cam.plane_through((0, -3, 0), (0, 1, 0))
    found = cam.projection_onto_plane(plane, (0, 0, 0))
    np.testing.assert_allclose(found, cam.plane_projection((0, 1, 0), 3), atol=1e-15)


def test_sunlight_is_the_light_of_a_point_far_away():
    plane, direction = cam.plane_through((0, -3, 1), (0.1, 1, 0.2)), np.array([0.3, -1, 0.2])
    parallel = cam.parallel_projection_onto_plane(plane, direction)
    shadows = applied(cam.projection_onto_plane(plane, -1e7 * direction), POINTS)
    np.testing.assert_allclose(cam.transform_points(parallel, POINTS), shadows, atol=1e-5)
    np.testing.assert_allclose(applied(parallel, POINTS) @ plane[:3] + plane[3], 0, atol=1e-12)
    np.testing.assert_array_equal(parallel[3], [0, 0, 0, 1])


def test_a_point_behind_the_light_has_no_shadow():
    plane = cam.plane_through((0, 0, 0), (0, 1, 0))
    clip = cam.multiply(cam.projection_onto_plane(plane, (0, 4, 0)), (1, 5, 0, 1))
    assert np.isnan(cam.perspective_divide(clip, behind="nan")).all()
    with pytest.raises(ValueError, match=r"^clip=.*: must be in front of the camera"):
        cam.perspective_divide(clip)


@pytest.mark.parametrize("z", [0.0, 2.0])
def test_points_at_and_behind_the_camera_are_refused_or_flagged(z):
    points = [(1, 1, -2), (1, 2, z)]
    with pytest.raises(ValueError, match=rf"^points=\(1.0, 2.0, {z}\): must be in front of the"):
        cam.image_from_camera(points, 1)
    image = cam.image_from_camera(points, 1, behind="nan")
    np.testing.assert_array_equal(np.isnan(image), [[False] * 2, [True] * 2])
    matrix = cam.image_from_world_matrix(0, 0, 0, (0, 0, 0), 1)  # looks along +z
    with pytest.raises(ValueError, match=r"^points=\(1.0, 1.0, -2.0\): must be in front"):
        cam.image_from_world(points, matrix)
    with pytest.raises(ValueError, match=r"^behind='no': must be one of refuse, nan"):
        cam.image_from_camera(points, 1, behind="no")


def test_a_vertex_behind_the_camera_is_refused_in_the_pipeline_or_flagged():
    arguments = np.eye(4), np.eye(4), cam.Frustum(90, 1, 1, 9).clip_from_camera(), 10, 10
    with pytest.raises(ValueError, match=r"^clip=.*: must be in front of the camera \(clip it"):
        cam.project_vertices([(0, 0, -2), (0, 0, 2)], *arguments)
    steps = cam.project_vertices([(0, 0, -2), (0, 0, 2)], *arguments, behind="nan")
    np.testing.assert_array_equal(np.isnan(steps.pixels), [[False] * 2, [True] * 2])
    assert np.isfinite(steps.clip).all()


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: cam.image_from_camera((0, 0, -1), 0), r"^focal_length=0.0: must be > 0"),
        (lambda: cam.homogeneous_perspective(-1), r"^focal_length=-1.0: must be > 0"),
        (lambda: cam.image_from_world_matrix(0, 0, 0, (0, 0, 0), 0), r"^focal_length=0.0"),
        (lambda: cam.pseudodepth(-1, 0, 3), r"^near=0.0: must be > 0 and less than far=3"),
        (lambda: cam.pseudodepth_perspective(3, 3), r"^near=3.0: must be > 0 and less than far=3"),
        (lambda: cam.perspective_clip_from_camera(-1, 1, -1, 1, 3, 2), r"^near=3.0: must be > 0"),
        (lambda: cam.perspective_clip_from_camera(1, 1, -1, 1, 1, 2), r"^right=1.0: .*left=1"),
        (lambda: cam.perspective_clip_from_camera(-1, 1, 2, 2, 1, 2), r"^top=2.0: .*bottom=2"),
        (lambda: cam.orthographic_clip_from_camera(-1, 1, -1, 1, 3, 3), r"^near=3.0: must be fini"),
        (lambda: cam.orthographic_clip_from_camera(-1, 1, -1, 1, 3, math.inf), r"^near=3.0: .*inf"),
        (lambda: cam.orthographic_clip_from_camera(-1, -1, -1, 1, 3, 4), r"^right=-1.0"),
        (
            lambda: cam.plane_projection((0, 0, 0), 1),
            r"^normal=\(0.0, 0.0, 0.0\): must be a finite",
        ),
        (lambda: cam.plane_projection((0, 0, 1), 0), r"^distance=0.0: must be > 0"),
        (lambda: cam.projection_onto_plane((0, 1, 0, 0), (0, 0, 0)), r"^center=.*: must be on the"),
        (lambda: cam.projection_onto_plane((0, 1, 0, 0), (0, -1, 0)), r"^center=\(0.0, -1.0, 0.0"),
        (
            lambda: cam.parallel_projection_onto_plane((0, 1, 0, 0), (1, 0, 0)),
            r"^direction=\(1.0, 0.0, 0.0\): must be not parallel to the plane",
        ),
        (lambda: cam.pixel_from_ndc((0, 0), 0, 1), r"^width=0.0: must be > 0 pixels"),
        (lambda: cam.ndc_from_pixel((0, 0), 1, math.inf), r"^height=inf: must be > 0 pixels"),
        (lambda: cam.pseudodepth(-1, 1, 2, axes="z"), r"^axes='z': must be one of opengl, mitsuba"),
    ],
)
def test_degenerate_projections_are_refused_by_name(call, text):
    with pytest.raises(ValueError, match=text):
        call()
