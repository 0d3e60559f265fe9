"""Depth between z, NDC, disparity and ray length, against closed forms and Mitsuba's rays."""

import itertools
import math

import mitsuba as mi
import numpy as np
import pytest

from potmesil_mi.optics import depth as d
from potmesil_mi.optics.camera import Frustum, homogeneous, multiply, perspective_divide

CONVENTIONS = list(itertools.product(d.CLIPS, (False, True)))
PLANES = [(1.0, 3.0), (0.5, 10.0), (2.0, 10.0), (0.01, 100.0), (0.3, math.inf)]


def between(near, far, count=1001):
    """Depths from the near plane to the far one, which may be infinite."""
    return near / np.linspace(1, near / far, count, dtype=np.float64)[:-1]


def gradient(function, at):
    """d function / d at by central differences, of an array of doubles."""
    step = 1e-6 * np.abs(at)
    return (function(at + step) - function(at - step)) / (2 * step)


def check_gradient(function, at):
    """Dr.Jit's gradient of ``function`` in double precision, beside central differences."""
    import drjit as dr
    from drjit.llvm.ad import Float64

    variable = Float64(at)
    dr.enable_grad(variable)
    dr.backward(dr.sum(function(variable)))
    np.testing.assert_allclose(np.asarray(variable.grad), gradient(function, at), rtol=1e-7)


# ---------------------------------------------------------------- NDC depth


@pytest.mark.parametrize(("near", "far"), PLANES)
def test_ndc_depth_is_the_g_of_exercise_5(near, far):
    z = -between(near, far)  # The text's, whose camera looks along -z.
    if math.isinf(far):
        expected = 1 + 2 * near / z
    else:
        expected = (far + near) / (far - near) + 2 * near * far / (far - near) / z
    np.testing.assert_allclose(d.ndc_from_depth(-z, near, far), expected, atol=1e-12)


def test_ndc_depth_is_the_pseudodepth_of_section_5_7():
    f, F = -2.0, -10.0
    a, b = -(f + F) / (f - F) / f, 2 * F / (f - F)
    z = -np.linspace(2, 10, 101)
    np.testing.assert_allclose(d.ndc_from_depth(-z, 2, 10), f / z * (a * z + b), atol=1e-12)


@pytest.mark.parametrize(("near", "far"), PLANES)
def test_ndc_depth_is_what_the_frustums_matrix_gives(near, far):
    z = between(near, far)
    points = np.stack([0.1 * z, -0.2 * z, -z], axis=-1)
    ndc = perspective_divide(
        multiply(Frustum(60, 1.5, near, far).clip_from_camera(), homogeneous(points))
    )
    np.testing.assert_allclose(d.ndc_from_depth(z, near, far), ndc[:, 2], atol=1e-12)


@pytest.mark.parametrize(("clip", "reverse"), CONVENTIONS)
def test_the_planes_are_where_the_convention_has_them(clip, reverse):
    low, high = (-1, 1) if clip == "opengl" else (0, 1)
    ends = (high, low) if reverse else (low, high)
    got = [d.ndc_from_depth(z, 1.0, 3.0, clip=clip, reverse=reverse) for z in (1.0, 3.0)]
    assert got == pytest.approx(ends, abs=1e-12)


@pytest.mark.parametrize(("clip", "reverse"), CONVENTIONS)
@pytest.mark.parametrize(("near", "far"), PLANES)
def test_depth_returns_from_ndc(near, far, clip, reverse):
    z = between(near, far).reshape(10, 100)
    ndc = d.ndc_from_depth(z, near, far, clip=clip, reverse=reverse)
    back = d.depth_from_ndc(ndc, near, far, clip=clip, reverse=reverse)
    # NDC depth near 1 is rounded by 1e-16, which is so much of 1/z = ndc / n.
    assert back.shape == z.shape
    np.testing.assert_array_less(abs(1 / back - 1 / z) * near, 1e-15)
    np.testing.assert_allclose(back[z < 10 * near], z[z < 10 * near], rtol=1e-12)


@pytest.mark.parametrize(("near", "far"), PLANES[:3])
def test_depth_from_ndc_is_the_closed_form(near, far):
    ndc = np.linspace(-1, 1, 101)
    expected = 2 * near * far / ((far + near) - ndc * (far - near))
    np.testing.assert_allclose(d.depth_from_ndc(ndc, near, far), expected, rtol=1e-12)


@pytest.mark.parametrize(("clip", "reverse"), CONVENTIONS)
@pytest.mark.parametrize(("near", "far"), PLANES)
def test_ndc_depth_sorts_points(near, far, clip, reverse):
    steps = np.diff(d.ndc_from_depth(between(near, far), near, far, clip=clip, reverse=reverse))
    assert np.all(steps < 0 if reverse else steps > 0)


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("far", [3.0, math.inf])
def test_infinity_has_a_stored_depth_and_returns_from_it(far, reverse):
    stored = d.stored_from_depth(math.inf, 1.0, far, reverse=reverse)
    beyond = 1 / (1 - 1 / far)
    assert stored == pytest.approx(1 - beyond if reverse else beyond, abs=1e-12)
    assert d.depth_from_stored(stored, 1.0, far, reverse=reverse) == math.inf


def test_an_infinite_far_plane_is_the_limit_of_far_ones():
    z = np.geomspace(1, 100, 11)
    limit = d.ndc_from_depth(z, 1.0)
    np.testing.assert_allclose(d.ndc_from_depth(z, 1.0, 1e13), limit, atol=1e-12)
    np.testing.assert_allclose(limit, 1 - 2 / z, atol=1e-12)


def test_whole_numbers_and_numpy_numbers_are_numbers():
    assert d.ndc_from_depth(2, 1, 3) == pytest.approx(0.5, abs=1e-12)
    assert d.depth_from_ndc(np.float64(0.5), np.int64(1), 3) == pytest.approx(2, abs=1e-12)
    assert isinstance(d.ndc_from_depth(2, 1, 3), float)


@pytest.mark.parametrize("shape", [(), (4,), (2, 3), (2, 1, 3)])
def test_shapes_are_kept_and_planes_may_be_arrays(shape):
    z = np.full(shape, 2.0)
    assert np.shape(d.depth_from_ndc(d.ndc_from_depth(z, 1.0, 3.0), 1.0, 3.0)) == shape
    near = np.array([0.5, 1.0, 1.5])
    got = d.stored_from_depth(np.full((2, 3), 2.0), near, 4.0)
    np.testing.assert_allclose(got[1], (1 - near / 2) / (1 - near / 4), atol=1e-12)


@pytest.mark.usefixtures("variant_llvm")
@pytest.mark.parametrize("reverse", [False, True])
def test_gradients_of_depth_and_ndc_are_those_of_finite_differences(reverse):
    z = np.array([1.1, 1.7, 2.9])
    check_gradient(lambda z: d.ndc_from_depth(z, 1.0, 3.0, reverse=reverse), z)
    check_gradient(lambda near: d.ndc_from_depth(2.0, near, 3.0, reverse=reverse), z / 3)
    check_gradient(lambda far: d.depth_from_ndc(0.2, 1.0, far, reverse=reverse), z)
    ndc = np.array([-0.9, 0.1, 0.8])
    check_gradient(lambda ndc: d.depth_from_ndc(ndc, 1.0, 3.0, reverse=reverse), ndc)


@pytest.mark.usefixtures("variant_llvm")
def test_drjit_arrays_and_tensors_give_what_numpy_does():
    z = np.linspace(1, 3, 6)
    expected = d.ndc_from_depth(z, 1.0, 3.0)
    np.testing.assert_allclose(d.ndc_from_depth(mi.Float(z), 1.0, 3.0), expected, atol=1e-6)
    tensor = mi.TensorXf64(z.reshape(2, 3))
    np.testing.assert_allclose(
        np.array(d.ndc_from_depth(tensor, 1.0, 3.0)), expected.reshape(2, 3), atol=1e-12
    )


# ---------------------------------------------------------------- vergence and disparity


def test_vergence_is_inverse_depth_with_infinity_at_0():
    z = np.array([0.25, 2.0, math.inf])
    np.testing.assert_array_equal(d.vergence_from_depth(z), [4, 0.5, 0])
    np.testing.assert_array_equal(d.depth_from_vergence(d.vergence_from_depth(z)), z)


def test_disparity_is_the_difference_of_two_projections():
    baseline, focal_length = 0.2, 800.0
    x, z = np.array([-1.0, 0.0, 3.0]), np.array([2.0, 5.0, 40.0])
    left, right = focal_length * x / z, focal_length * (x - baseline) / z
    disparity = d.disparity_from_depth(z, baseline, focal_length)
    np.testing.assert_allclose(disparity, left - right, rtol=1e-12)
    np.testing.assert_allclose(
        d.depth_from_disparity(disparity, baseline, focal_length), z, rtol=1e-12
    )
    assert d.depth_from_disparity(0, baseline, focal_length) == math.inf


@pytest.mark.usefixtures("variant_llvm")
def test_gradients_of_disparity_are_those_of_finite_differences():
    z = np.array([1.1, 1.7, 2.9])
    check_gradient(lambda z: d.disparity_from_depth(z, 0.2, 800.0), z)
    check_gradient(lambda disparity: d.depth_from_disparity(disparity, 0.2, 800.0), z)
    check_gradient(lambda baseline: d.disparity_from_depth(2.0, baseline, 800.0), z)


# ---------------------------------------------------------------- length of the ray


def test_the_ray_through_the_principal_point_is_as_long_as_its_depth():
    assert d.ray_length_from_depth(7.0, 50, 25, d.camera_of(60, (100, 50))) == 7
    shifted = d.camera_of(60, (100, 50), (0.1, -0.2))
    assert d.ray_length_from_depth(7.0, 40, 35, shifted) == pytest.approx(7, abs=1e-12)


def test_the_ray_through_the_edge_is_longer_by_the_cosine_of_half_the_field_of_view():
    camera = d.camera_of(90, (100, 50))
    assert d.ray_length_per_depth(0, 25, camera) == pytest.approx(math.sqrt(2), abs=1e-12)
    assert d.ray_length_per_depth(100, 0, camera) == pytest.approx(1.5, abs=1e-12)


def test_depth_returns_from_ray_lengths_of_a_whole_picture():
    camera = d.camera_of(47, (30, 20), (0.05, 0.1))
    x, y = np.arange(30) + 0.5, np.arange(20)[:, None] + 0.5
    z = np.linspace(1, 9, 600).reshape(20, 30)
    length = d.ray_length_from_depth(z, x, y, camera)
    assert np.all(length > z)
    np.testing.assert_allclose(d.depth_from_ray_length(length, x, y, camera), z, rtol=1e-12)


@pytest.mark.usefixtures("variant_llvm")
@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.1, -0.2)])
def test_rays_of_a_perspective_sensor_have_these_lengths(offset):
    sensor = mi.load_dict(
        {
            "type": "perspective",
            "fov": 50,
            "principal_point_offset_x": offset[0],
            "principal_point_offset_y": offset[1],
            "film": {"type": "hdrfilm", "width": 40, "height": 30},
        }
    )
    x, y = np.meshgrid(np.arange(40) + 0.5, np.arange(30) + 0.5)
    position = mi.Point2f(x.ravel() / 40, y.ravel() / 30)
    ray, _ = sensor.sample_ray(0, 0, position, 0)
    along = np.array(ray.d.z).reshape(30, 40)  # The cosine, of a camera that is not turned.
    got = d.ray_length_per_depth(x, y, d.camera_of(50, (40, 30), offset))
    np.testing.assert_allclose(1 / along, got, rtol=1e-6)


@pytest.mark.usefixtures("variant_llvm")
def test_gradients_of_ray_lengths_are_those_of_finite_differences():
    camera, at = d.camera_of(47, (30, 20)), np.array([1.1, 8.7, 29.0])
    check_gradient(lambda x: d.ray_length_from_depth(2.0, x, 5.5, camera), at)
    check_gradient(lambda z: d.ray_length_from_depth(z, 1.5, 5.5, camera), at)
    check_gradient(lambda length: d.depth_from_ray_length(length, 1.5, 5.5, camera), at)


# ---------------------------------------------------------------- errors

CAMERA = d.camera_of(47, (30, 20))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: d.ndc_from_depth(2, 0, 3), "near=0: must be > 0 scene units"),
        (lambda: d.ndc_from_depth(2, math.inf), "near=inf: must be"),
        (lambda: d.ndc_from_depth(2, 3, 3), "far=3: must be > near=3"),
        (lambda: d.depth_from_ndc(0, 3, 1), "far=1: must be > near=3"),
        (lambda: d.depth_from_stored(0, 1, math.nan), "far=nan: must be > near=1"),
        (lambda: d.ndc_from_depth(0, 1, 3), "depth=0: must be > 0 scene units, before the camera"),
        (lambda: d.ndc_from_depth(np.array([2.0, -1.0]), 1, 3), r"depth=-1.0: must be > 0"),
        (lambda: d.stored_from_depth(math.nan, 1, 3), "depth=nan: must be > 0"),
        (lambda: d.depth_from_ndc(2.1, 1, 3), "ndc=2.1: must be a depth no farther than infinity"),
        (lambda: d.depth_from_stored(1.01, 1), "stored=1.01: must be a depth no farther"),
        (lambda: d.depth_from_stored(-0.01, 1, reverse=True), "stored=-0.01: must be a depth"),
        (lambda: d.depth_from_stored(math.nan, 1), "stored=nan: must be a depth"),
        (lambda: d.ndc_from_depth(2, 1, 3, clip="gl"), "clip='gl': must be one of opengl, direct"),
        (lambda: d.vergence_from_depth(-1), "depth=-1: must be > 0"),
        (lambda: d.depth_from_vergence(-1), "vergence=-1: must be >= 0"),
        (lambda: d.disparity_from_depth(1, 0, 800), "baseline=0: must be > 0"),
        (lambda: d.disparity_from_depth(1, 1, -8), "focal_length_pixels=-8: must be > 0"),
        (lambda: d.depth_from_disparity(-1, 1, 800), "disparity=-1: must be >= 0 pixels"),
        (lambda: d.ray_length_from_depth(0, 1, 1, CAMERA), "depth=0: must be > 0"),
        (lambda: d.depth_from_ray_length(-2, 1, 1, CAMERA), "ray_length=-2: must be > 0"),
        (lambda: d.ray_length_per_depth(math.inf, 1, CAMERA), "x=inf: must be a finite number"),
        (lambda: d.camera_of(180, (30, 20)), "x_fov=180: must be > 0 and < 180"),
        (lambda: d.camera_of(90, (0, 20)), r"film_size\[0\]=0: must be"),
    ],
)
def test_errors_name_the_parameter_its_value_and_what_is_allowed(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_text_is_no_depth():
    with pytest.raises(TypeError, match="depth='2': must be a number"):
        d.ndc_from_depth("2", 1, 3)
