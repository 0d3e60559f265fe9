"""Gradients of pictures and of depth reach the samples that copy their pixels."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm

pytestmark = pytest.mark.usefixtures("variant_llvm")

LENS = pm.ThinLens(50, 1.4, 2.0, frame_width=2, millimeters_per_unit=1000)
SIZE = 12


def image(channels=3):
    """A near column, beside which what is farther goes on behind it."""
    rgb = np.random.default_rng(1).random((SIZE, SIZE, channels))
    depth = np.full((SIZE, SIZE), 6.0)
    depth[:, 5:9] = 2.0
    return rgb.astype(np.float32), depth.astype(np.float32)


def samples_of(rgb, depth, **options):
    given = {"camera": LENS.fov, "lens": LENS, "depth_kind": "z", "antialiased": False, **options}
    return pm.PointSamples.from_image(rgb, depth, **given)


def attached(array):
    tensor = mi.TensorXf(array)
    dr.enable_grad(tensor)
    return tensor


@pytest.mark.parametrize("channels", [3, 4])
def test_samples_are_attached_to_the_pixels_that_they_copy(channels):
    rgb, depth = image(channels)
    plain = samples_of(rgb, depth)
    given, its_depth = attached(rgb), attached(depth)
    samples = samples_of(given, its_depth)
    assert samples.layer.max() == 1  # There are hidden copies.
    for name in ("x", "y", "rgb", "alpha", "z", "weight", "layer"):
        np.testing.assert_array_equal(getattr(samples, name), getattr(plain, name))
    assert set(samples.attached) == {"rgb", "z"} | ({"alpha"} if channels == 4 else set())
    for name, values in samples.attached.items():
        np.testing.assert_array_equal(np.array(values), getattr(plain, name).ravel())
    total = dr.sum(dr.square(samples.attached["rgb"])) + dr.sum(samples.attached["z"])
    dr.backward(total)
    np.testing.assert_allclose(np.array(its_depth.grad).sum(), len(samples))
    expected = 2 * np.square(plain.rgb.astype(float)).sum()
    np.testing.assert_allclose((np.array(given.grad) * rgb).sum(), expected, rtol=1e-5)


def test_depth_in_other_units_has_its_scale_and_a_background_no_gradient():
    rgb, depth = image()
    its_depth = attached(depth)
    samples = samples_of(rgb, its_depth, depth_scale=0.5, background=3.0, hidden="none")
    dr.backward(dr.sum(1 / samples.attached["z"]))
    near = depth < 3
    expected = np.where(near, -0.5 / (0.5 * depth) ** 2, 0)
    np.testing.assert_allclose(np.array(its_depth.grad), expected, rtol=1e-6)
    assert np.isinf(samples.z).sum() == (~near).sum()


@pytest.mark.parametrize(
    ("name", "options", "match"),
    [
        ("rgb", {"antialiased": True}, "antialiased=True: .*rgb has gradients"),
        ("depth", {"depth_kind": "distance"}, "depth_kind='distance': .*depth has gradients"),
        ("depth", {"depth_kind": "inverse"}, "depth_kind='inverse': .*depth has gradients"),
    ],
)
def test_what_has_no_derivative_is_refused_by_name(name, options, match):
    given = dict(zip(("rgb", "depth"), image(), strict=True))
    given[name] = attached(given[name])
    with pytest.raises(NotImplementedError, match=match):
        samples_of(**given, **options)


def test_depth_with_gradients_beside_a_file_is_refused():
    with pytest.raises(NotImplementedError, match=r"depth=.*the file beauty\.exr"):
        samples_of("beauty.exr", attached(image()[1]))
