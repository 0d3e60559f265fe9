"""Spreading: the images of a slice, each by its kernel, become light. Linear in the images.

Light is made tile by tile: tiles stay in the processor's cache, and many have no light.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.fft

from .._threads import for_each, processors
from ..optics.convolution import convolve_cyclically, fast_size, kernel_spectrum
from ..samples.raster import Window

ROWS = 32
"""Rows of an image that are worked on at once: they stay in the processor's cache."""

TILE = 128
"""Width in pixels of tiles, with what is around them."""

TILE_REACHES = 12
"""The least such width in reaches of the kernels: then little of it is around the tile."""


def spread(images: Sequence[np.ndarray], kernels: Sequence[np.ndarray]) -> np.ndarray:
    """The sum of images, float32 (H, W, C), each spread by its kernel: float32 (H, W, C).

    A kernel is an array (K, L), or a short symmetric row (n,) that spreads along both axes one
    after the other. Around the light, images have empty borders as wide as half their kernels.
    """
    pairs = list(zip(images, kernels, strict=True))
    wide = [pair for pair in pairs if pair[1].ndim == 2]
    by_row = [pair for pair in pairs if pair[1].ndim == 1]
    total = np.zeros_like(images[0])
    height, width, channels = total.shape
    down, across = (
        _Cut.of(size, max((kernel.shape[axis] // 2 for _, kernel in wide), default=0))
        for axis, size in enumerate((height, width))
    )
    frame = down.frame, across.frame
    spectra = [
        np.repeat(kernel_spectrum(kernel, frame, np.float32)[..., None], channels, axis=2)
        for _, kernel in wide
    ]

    def spread_to(tile: Window) -> None:
        place = tile.slices_in(Window(0, 0, width, height))
        rows, columns = down.around(place[0]), across.around(place[1])
        near = [image[rows, columns] for image, _ in wide]
        with scipy.fft.set_workers(workers):
            light = convolve_cyclically(near, spectra, frame)
        if light is not None:
            top, left = place[0].start - rows.start, place[1].start - columns.start
            total[place] = light[top : top + tile.height, left : left + tile.width]
        for image, kernel in by_row:
            _add_spread_by_row(total, image, kernel, tile)

    tiles = [
        Window(left, top, min(across.step, width - left), min(down.step, height - top))
        for top in range(0, height, down.step)
        for left in range(0, width, across.step)
    ]
    workers = max(processors() // len(tiles), 1)
    for_each(spread_to, tiles)
    return total


class _Cut(NamedTuple):
    """How an axis of ``size`` pixels is cut into tiles.

    A tile has ``step`` pixels, and gets light from ``reach`` pixels on each side. With these it
    fits into a ``frame``; where there is one tile, the frame has as many pixels as the axis, whose
    empty ends meet.
    """

    size: int
    reach: int
    step: int
    frame: int

    @classmethod
    def of(cls, size: int, reach: int) -> _Cut:
        width = max(TILE, TILE_REACHES * reach)
        count = round(size / (width - 2 * reach))
        if count <= 1:
            return cls(size, 0, size, size)
        step = -(-size // count)
        return cls(size, reach, step, fast_size(step + 2 * reach))

    def around(self, tile: slice) -> slice:
        """A tile and what is around it, as far as there is anything."""
        return slice(max(tile.start - self.reach, 0), min(tile.stop + self.reach, self.size))


def _add_spread_by_row(
    total: np.ndarray, image: np.ndarray, row: np.ndarray, tile: Window
) -> None:
    """Add ``image``, (H, W, C), to a tile of ``total``, spread along both axes by a short row.

    The row is symmetric. The border of the image, as wide as half of it, must be empty.
    """
    middle = len(row) // 2
    height, width = image.shape[:2]
    inner = Window(middle, middle, width - 2 * middle, height - 2 * middle).intersection(tile)
    if inner.is_empty:
        return
    left, top, right, bottom = inner.left, inner.top, inner.right, inner.bottom
    near = image[top - middle : bottom + middle, left - middle : right + middle]
    if not near.any():
        return
    weights = row[middle:].astype(image.dtype)
    down = _spread_along(near, weights, 0)
    total[top:bottom, left:right] += _spread_along(down, weights, 1)


def _spread_along(image: np.ndarray, weights: np.ndarray, axis: int) -> np.ndarray:
    """An image spread along an axis, 0 or 1, where all that is spread there is in the image.

    ``weights`` are those of the middle of a symmetric row and of what follows.
    """
    middle = len(weights) - 1
    moved = [
        image[(slice(None),) * axis + (slice(start, image.shape[axis] - 2 * middle + start),)]
        for start in range(2 * middle + 1)
    ]
    result = moved[middle] * weights[0]
    for step in range(1, middle + 1):
        pair = moved[middle - step] + moved[middle + step]
        pair *= weights[step]
        result += pair
    return result
