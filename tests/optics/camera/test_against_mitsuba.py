"""The same cameras in Mitsuba, whose numbers are of single precision."""

import mitsuba as mi
import numpy as np
import pytest

from potmesil_mi import potmesil_sensor
from potmesil_mi.optics import camera as cam

SINGLE = 1e-6
RANDOM = np.random.default_rng(8)


def relative_to_its_size(found, expected):
    np.testing.assert_allclose(found, expected, atol=SINGLE * np.abs(expected).max(), rtol=0)


def as_mitsubas(ndc):
    """Mitsuba's sample space: x and y from 0 to 1, from the top left; depth from 0 to 1."""
    x, y, z = np.moveaxis(ndc, -1, 0)
    return np.stack([(x + 1) / 2, (1 - y) / 2, (z + 1) / 2], -1)


def transformed(transform, points):
    return np.array([np.array(transform @ mi.Point3f(point)).ravel() for point in points.tolist()])


@pytest.mark.parametrize("seed", range(5))
def test_look_at(seed, variant_llvm):
    eye, target, up = np.random.default_rng(seed).normal(0, 3, (3, 3))
    theirs = mi.ScalarTransform4f().look_at(eye.tolist(), target.tolist(), up.tolist())
    relative_to_its_size(cam.look_at(eye, target, up, axes="mitsuba"), np.array(theirs.matrix))


@pytest.mark.parametrize(
    ("fov", "size", "near", "far"),
    [
        (60, (200, 100), 0.5, 10),
        (20, (64, 64), 1, 100),
        (100, (90, 160), 2, 3),
    ],
)
def test_perspective_projection(fov, size, near, far, variant_llvm):
    theirs = mi.perspective_projection(size, size, [0, 0], fov, near, far)
    view = cam.Frustum.from_x_fov(fov, size[0] / size[1], near, far)
    points = RANDOM.uniform([-3, -3, near], [3, 3, far], (20, 3))
    clip = cam.multiply(view.clip_from_camera("mitsuba"), cam.homogeneous(points))
    relative_to_its_size(as_mitsubas(cam.perspective_divide(clip)), transformed(theirs, points))


def test_orthographic_projection(variant_llvm):
    """Mitsuba's ``orthographic`` sees the square of side 2 in the film's width."""
    theirs = mi.orthographic_projection([200, 100], [200, 100], [0, 0], 0.5, 10)
    matrix = cam.orthographic_clip_from_camera(-1, 1, -0.5, 0.5, 0.5, 10, "mitsuba")
    points = RANDOM.uniform([-2, -2, 0.5], [2, 2, 10], (20, 3))
    ndc = cam.perspective_divide(cam.multiply(matrix, cam.homogeneous(points)))
    relative_to_its_size(as_mitsubas(ndc), transformed(theirs, points))


def test_orthographic_transform_is_the_depth_of_the_matrix(variant_llvm):
    """``Transform4f.orthographic`` scales z alone to 0 to 1."""
    theirs = mi.ScalarTransform4f().orthographic(0.5, 10)
    matrix = cam.orthographic_clip_from_camera(-1, 1, -1, 1, 0.5, 10, "mitsuba")
    points = RANDOM.uniform([-2, -2, 0.5], [2, 2, 10], (20, 3))
    ndc = cam.perspective_divide(cam.multiply(matrix, cam.homogeneous(points)))
    found = np.array([np.array(theirs @ mi.ScalarPoint3f(*p)) for p in points])
    relative_to_its_size(np.stack([-ndc[:, 0], ndc[:, 1], (ndc[:, 2] + 1) / 2], -1), found)


SENSORS = {
    "plain": {},
    "off_axis": {"principal_point_offset_x": 0.2, "principal_point_offset_y": -0.1},
    "fov_along_y": {"fov_axis": "y", "fov": 30},
}


@pytest.mark.parametrize("case", SENSORS)
def test_rays_of_perspective_go_through_the_points_of_their_pixels(case, variant_llvm):
    """`Camera.world_from_pixel` and `pixel_from_world` against `sample_ray` of the sensor."""
    film = {"type": "hdrfilm", "width": 200, "height": 120}
    sensor = mi.load_dict(
        {
            "type": "perspective",
            "fov": 55.0,
            "near_clip": 0.5,
            "far_clip": 50.0,
            "to_world": mi.ScalarTransform4f().look_at([1, 2, 3], [0, 0.5, -2], [0.2, 1, 0]),
            "film": film,
            **SENSORS[case],
        }
    )
    camera = potmesil_sensor(sensor, f_number=8).camera()
    shares = RANDOM.uniform(0, 1, (25, 2))
    ray, _ = sensor.sample_ray(0, 0, mi.Point2f(*shares.T), mi.Point2f(0))
    pixels = shares * [200, 120]
    for t in (1.0, 7.0):
        points = np.array(ray(t)).T
        found = camera.pixel_from_world(points)
        np.testing.assert_allclose(found, pixels, atol=200 * 2e-6)
        back = camera.world_from_pixel(pixels, camera.depth_from_world(points))
        relative_to_its_size(back, points)
    lit = camera.pixel_from_world(ray(3.0))  # Mitsuba's own points, on Dr.Jit
    np.testing.assert_allclose(np.array(lit).T, pixels, atol=200 * 5e-6)
