"""How images are spread by kernels and rows: against SciPy's direct convolution."""

import numpy as np
import pytest
import scipy.ndimage

from potmesil_mi.focusing.blocks import BlockImage
from potmesil_mi.focusing.convolve import TILE, spread

RNG = np.random.default_rng(0)
BORDER = 6


def image(channels=4, size=(64, 72)):
    """Random light, with an empty border."""
    result = np.zeros((*size, channels), dtype=np.float32)
    inner = tuple(n - 2 * BORDER for n in size)
    result[BORDER:-BORDER, BORDER:-BORDER] = RNG.uniform(0, 1, (*inner, channels))
    return result


def directly(light, kernel):
    if kernel.ndim == 1:
        kernel = np.outer(kernel, kernel)
    return scipy.ndimage.convolve(light.astype(float), kernel[..., None], mode="constant")


ROW = np.array([0.1, 0.2, 0.4, 0.2, 0.1])
KERNELS = [np.ones(1), ROW, RNG.uniform(0, 1, (5, 9)), RNG.uniform(0, 1, (11, 3))]


@pytest.mark.parametrize("channels", [4, 5])
@pytest.mark.parametrize("kernel", KERNELS, ids=["one", "row", "wide", "high"])
def test_an_image_is_convolved_with_its_kernel(kernel, channels):
    light = image(channels)
    np.testing.assert_allclose(
        spread([BlockImage.of(light)], [kernel]), directly(light, kernel), rtol=1e-4, atol=2e-5
    )


def test_images_with_kernels_and_rows_add_up():
    images = [image() for _ in KERNELS]
    expected = sum(directly(light, kernel) for light, kernel in zip(images, KERNELS, strict=True))
    found = spread([BlockImage.of(light) for light in images], KERNELS)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=5e-5)
    assert found.dtype == np.float32


def test_large_images_are_spread_as_well():
    size = 2 * TILE + 50, 3 * TILE + 20
    images = [image(size=size) for _ in KERNELS]
    for empty in images[1:]:
        empty[: TILE + 9], empty[:, 2 * TILE - 7 :] = 0, 0
    expected = sum(directly(light, kernel) for light, kernel in zip(images, KERNELS, strict=True))
    found = spread([BlockImage.of(light) for light in images], KERNELS)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=5e-5)


def test_spreading_is_linear_and_its_adjoint_spreads_by_the_mirrored_kernel():
    x, y = image(), image()
    for kernel in KERNELS:
        mirrored = kernel[::-1] if kernel.ndim == 1 else kernel[::-1, ::-1]
        forward = np.vdot(spread([BlockImage.of(x)], [kernel]).astype(float), y)
        backward = np.vdot(x, spread([BlockImage.of(y)], [mirrored]).astype(float))
        assert forward == pytest.approx(backward, rel=1e-5)
