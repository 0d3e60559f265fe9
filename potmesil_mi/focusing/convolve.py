"""Spreading: the images of a slice, each by its kernel, become light. Linear in the images.

Light is made tile by tile: tiles stay in the processor's cache, and where no light is near an image
is not even read.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .._threads import for_each, processors
from ..optics.convolution import (
    convolve_cyclically,
    correlate_cyclically,
    fast_size,
    kernel_spectrum,
    spectrum_of,
)
from ..samples.raster import Window
from .blocks import BLOCK, BlockImage, in_blocks

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
    down, across = _cuts((height, width), [kernel.shape for _, kernel in wide])
    frame = down.frame, across.frame
    spectra = [
        np.repeat(kernel_spectrum(kernel, frame, np.float32)[..., None], channels, axis=2)
        for _, kernel in wide
    ]

    def spread_to(place: tuple[slice, slice]) -> None:
        tile = _window_of(*place)
        rows, columns = down.around(place[0]), across.around(place[1])
        around = _window_of(rows, columns)
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

    tiles = _tiles(down, across)
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
    light = np.ascontiguousarray(light, dtype=np.float32)
    stored = np.zeros((block_count, BLOCK, BLOCK, light.shape[2]), np.float32)
    height, width = light.shape[:2]
    wide = [kernel.shape for kernel in kernels if kernel.ndim == 2]
    down, across = _cuts((height, width), wide)
    frame = down.frame, across.frame
    tiles = _tiles(down, across)
    around = [(down.around(of[0]), across.around(of[1])) for of in tiles]
    spectra: list[np.ndarray] = []
    if wide:
        spectra = [np.empty(0)] * len(tiles)

        def transform(i: int) -> None:
            spectra[i] = spectrum_of(light[around[i]], frame)

        for_each(transform, range(len(tiles)))
    padded = (-(-size // BLOCK) * BLOCK for size in (height, width))
    image = np.zeros((*padded, light.shape[2]), np.float32)
    whole = Window(0, 0, width, height)
    for kernel, own in zip(kernels, number, strict=True):
        lit = own > 0
        if not lit.any():
            continue
        if kernel.ndim == 1:
            image[:] = 0
            _add_spread_by_row(image[:height, :width], BlockImage.of(light), kernel, whole)
        else:
            spectrum = kernel_spectrum(kernel, frame, np.float32)

            def correlate(i: int, spectrum: np.ndarray = spectrum, lit: np.ndarray = lit) -> None:
                rows, columns = tiles[i]
                if lit[_blocks(rows), _blocks(columns)].any():
                    found = correlate_cyclically(spectra[i], spectrum, frame)
                    top, left = (
                        a.start - b.start for a, b in zip(tiles[i], around[i], strict=True)
                    )
                    size = rows.stop - rows.start, columns.stop - columns.start
                    image[tiles[i]] = found[top : top + size[0], left : left + size[1]]

            for_each(correlate, range(len(tiles)))
        stored[own[lit]] = in_blocks(image)[lit]
    return stored


def _window_of(rows: slice, columns: slice) -> Window:
    """The window of some rows and columns."""
    size = columns.stop - columns.start, rows.stop - rows.start
    return Window(columns.start, rows.start, *size)


def _blocks(pixels: slice) -> slice:
    """The blocks that some pixels are in."""
    return slice(pixels.start // BLOCK, -(-pixels.stop // BLOCK))


def _cuts(size: tuple[int, int], kernels: Sequence[tuple[int, ...]]) -> tuple[_Cut, _Cut]:
    """How an image of a ``size`` is cut down and across for kernels of some shapes."""
    down, across = (
        _Cut.of(of, max((shape[axis] // 2 for shape in kernels), default=0))
        for axis, of in enumerate(size)
    )
    return down, across


def _tiles(down: _Cut, across: _Cut) -> list[tuple[slice, slice]]:
    """The rows and columns of all tiles."""
    return [
        (
            slice(top, min(top + down.step, down.size)),
            slice(left, min(left + across.step, across.size)),
        )
        for top in range(0, down.size, down.step)
        for left in range(0, across.size, across.step)
    ]


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
