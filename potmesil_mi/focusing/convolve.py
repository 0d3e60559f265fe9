"""Spreading: the images of a slice, each by its kernel, become light. Linear in the images.

Light is made tile by tile: tiles stay in the processor's cache, and where no light is near an image
is not even read.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .._threads import for_each, processors
from ..optics.convolution import convolve_cyclically, fast_size, kernel_spectrum
from ..samples.raster import Window
from .blocks import BLOCK, BlockImage

TILE = 192
"""Width in pixels of tiles, with what is around them."""

TILE_REACHES = 12
"""The least such width in reaches of the kernels: then little of it is around the tile."""


def spread(images: Sequence[BlockImage], kernels: Sequence[np.ndarray]) -> np.ndarray:
    """The sum of images of one size, each spread by its kernel: float32 (H, W, C).

    A kernel is an array (K, L), or a short symmetric row (n,) that spreads along both axes one
    after the other. Around the light, images have empty borders as wide as half their kernels, and
    twice as wide around what rows spread.
    """
    every = list(zip(images, kernels, strict=True))
    wide = [(image, kernel) for image, kernel in every if kernel.ndim == 2]
    by_row = [(image, kernel) for image, kernel in every if kernel.ndim == 1]
    height, width = images[0].shape
    channels = images[0].channel_count
    total = np.empty((height, width, channels), np.float32)
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
        around = Window(
            columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start
        )
        near = []
        for (image, _), spectrum in zip(wide, spectra, strict=True):
            lit = image.lit_in(around)
            if not lit.is_empty:
                in_rows = around._replace(top=lit.top, height=lit.height)
                near.append((image.part(in_rows), lit.top - around.top, spectrum))
        if near:
            light = convolve_cyclically(near, frame, workers)
            top, left = tile.top - around.top, tile.left - around.left
            total[place] = light[top : top + tile.height, left : left + tile.width]
        else:
            total[place] = 0
        for image, row in by_row:
            _add_spread_by_row(total, image, row, tile)

    tiles = [
        Window(left, top, min(across.step, width - left), min(down.step, height - top))
        for top in range(0, height, down.step)
        for left in range(0, width, across.step)
    ]
    workers = max(processors() // len(tiles), 1)
    for_each(spread_to, tiles)
    return total


def spread_back(
    light: np.ndarray, kernels: Sequence[np.ndarray], number: np.ndarray, block_count: int
) -> np.ndarray:
    """The transpose of :func:`spread`: of light, float32 (H, W, C), the blocks of its images.

    ``number``, (K, h, w), are those of the blocks of each image, see :class:`.blocks.BlockImage`,
    of which ``block_count`` are stored. Each is the light correlated with its kernel, float32
    (n, ``BLOCK``, ``BLOCK``, C).
    """
    image = BlockImage.of(np.ascontiguousarray(light, dtype=np.float32))
    stored = np.zeros((block_count, BLOCK, BLOCK, light.shape[2]), np.float32)
    for kernel, own in zip(kernels, number, strict=True):
        if own.any():
            turned = kernel if kernel.ndim == 1 else kernel[::-1, ::-1]
            found = BlockImage.of(spread([image], [turned]), all_blocks=True)
            lit = own > 0
            stored[own[lit]] = found.channels[0][found.number[lit]]
    return stored


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


def _add_spread_by_row(total: np.ndarray, image: BlockImage, row: np.ndarray, tile: Window) -> None:
    """Add an image to a tile of ``total``, spread along both axes by a short symmetric row.

    The border of the image, as wide as half of it, must be empty.
    """
    middle = len(row) // 2
    height, width = total.shape[:2]
    inner = Window(middle, middle, width - 2 * middle, height - 2 * middle).intersection(tile)
    lit = image.lit_in(inner.grown(middle))
    if lit.is_empty:
        return
    reached = lit.grown(middle).intersection(inner)
    weights = row[middle:].astype(total.dtype)
    down = _spread_along(image.part(reached.grown(middle)), weights, 0)
    total[reached.slices_in(Window(0, 0, width, height))] += _spread_along(down, weights, 1)


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
