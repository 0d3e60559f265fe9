"""Each operator's transpose is its transpose: <A x, y> = <x, A' y>."""

import numpy as np
import pytest

from potmesil_mi.focusing.blocks import BLOCK, BlockImage, numbered
from potmesil_mi.focusing.convolve import spread, spread_back


def kernel_of(rng, size):
    """A kernel that looks different upside down; a row for one number."""
    if isinstance(size, int):
        row = rng.random(size)
        row = row + row[::-1]
        return row / row.sum()
    kernel = rng.random(size)
    return kernel / kernel.sum()


@pytest.mark.parametrize(
    ("shape", "kernels"),
    [
        ((90, 75), [(5, 7), (11, 9), 3]),
        ((40, 33), [3]),
        ((420, 400), [(9, 9), (31, 21)]),
    ],
    ids=["one tile", "a row", "tiles"],
)
def test_the_transpose_of_spreading_is_its_transpose(shape, kernels):
    rng = np.random.default_rng(1)
    kernels = [kernel_of(rng, size) for size in kernels]
    border = max(2 * kernel.shape[0] for kernel in kernels)
    down, across = (-(-size // BLOCK) for size in shape)
    lit = rng.random((len(kernels), down, across)) > 0.3
    inner = np.zeros((down * BLOCK, across * BLOCK), bool)
    inner[border : shape[0] - border, border : shape[1] - border] = True
    lit &= inner.reshape(down, BLOCK, across, BLOCK).any(axis=(1, 3))
    number = numbered(lit)
    count = int(number.max()) + 1
    stored = rng.standard_normal((count, BLOCK, BLOCK, 4)).astype(np.float32)
    for own in number:  # Light keeps away from the borders, as it does in slices.
        for y, x in zip(*np.nonzero(own), strict=True):
            there = inner[y * BLOCK : (y + 1) * BLOCK, x * BLOCK : (x + 1) * BLOCK]
            stored[own[y, x]] *= there[..., None]
    stored[0] = 0
    light = spread([BlockImage(shape, own, [stored]) for own in number], kernels)
    other = rng.standard_normal(light.shape).astype(np.float32)
    back = spread_back(other, kernels, number, count)
    forward = np.vdot(light.astype(np.float64), other)
    assert abs(forward) > 1
    for own in number:
        for y, x in zip(*np.nonzero(own), strict=True):
            there = inner[y * BLOCK : (y + 1) * BLOCK, x * BLOCK : (x + 1) * BLOCK]
            back[own[y, x]] *= there[..., None]
    assert np.vdot(stored.astype(np.float64), back) == pytest.approx(forward, rel=1e-5)
