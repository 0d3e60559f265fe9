"""Spreading: the images of a slice, each by its kernel, become light. Linear in the images.

Light is made tile by tile: tiles stay in the processor's cache, and where no light is near an image
is not even read.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from .._threads import for_each, processors
from ..optics.convolution import convolve_cyclically, fast_size, kernel_spectrum
from ..samples.raster import Window

CELL = 4
"""Width in pixels of the cells of which one knows whether there is light.

It is no less than ``slices.MOVED_REACH``: cells next to those that are marked cover what is moved.
"""

TILE = 256
"""Width in pixels of tiles, with what is around them."""

TILE_REACHES = 12
"""The least such width in reaches of the kernels: then little of it is around the tile."""


class _Image(NamedTuple):
    """An image (H, W, C), its kernel, and which of its cells may have light, (h, w)."""

    light: np.ndarray
    kernel: np.ndarray
    lit: np.ndarray | None

    def near(self, rows: slice, columns: slice) -> np.ndarray | None:
        """A part of the image; ``None`` where it has no light."""
        if self.lit is not None:
            down, across = (
                slice(of.start // CELL, (of.stop - 1) // CELL + 1) for of in (rows, columns)
            )
            if not self.lit[down, across].any():
                return None
        return self.light[rows, columns]


def spread(
    images: Sequence[np.ndarray],
    kernels: Sequence[np.ndarray],
    lit: Sequence[np.ndarray] | None = None,
) -> np.ndarray:
    """The sum of images, float32 (H, W, C), each spread by its kernel: float32 (H, W, C).

    A kernel is an array (K, L), or a short symmetric row (n,) that spreads along both axes one
    after the other. Around the light, images have empty borders as wide as half their kernels, and
    twice as wide around what rows spread.
    ``lit`` tells for each which of its cells, of ``CELL`` x ``CELL`` pixels, may have light, bool
    (h, w); all, by default.
    """
    cells: Iterable[np.ndarray | None] = lit if lit is not None else itertools.repeat(None)
    every = list(map(_Image, images, kernels, cells))
    wide = [image for image in every if image.kernel.ndim == 2]
    by_row = [image for image in every if image.kernel.ndim == 1]
    total = np.empty_like(images[0])
    height, width, channels = total.shape
    down, across = (
        _Cut.of(size, max((image.kernel.shape[axis] // 2 for image in wide), default=0))
        for axis, size in enumerate((height, width))
    )
    frame = down.frame, across.frame
    spectra = [
        np.repeat(kernel_spectrum(image.kernel, frame, np.float32)[..., None], channels, axis=2)
        for image in wide
    ]

    def spread_to(tile: Window) -> None:
        place = tile.slices_in(Window(0, 0, width, height))
        rows, columns = down.around(place[0]), across.around(place[1])
        parts = [image.near(rows, columns) for image in wide]
        near = [(part, of) for part, of in zip(parts, spectra, strict=True) if part is not None]
        if near:
            light = convolve_cyclically(near, frame, workers)
            top, left = place[0].start - rows.start, place[1].start - columns.start
            total[place] = light[top : top + tile.height, left : left + tile.width]
        else:
            total[place] = 0
        for image in by_row:
            _add_spread_by_row(total, image, tile)

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


def _add_spread_by_row(total: np.ndarray, image: _Image, tile: Window) -> None:
    """Add an image to a tile of ``total``, spread along both axes by a short symmetric row.

    The border of the image, as wide as half of it, must be empty.
    """
    middle = len(image.kernel) // 2
    height, width = total.shape[:2]
    inner = Window(middle, middle, width - 2 * middle, height - 2 * middle).intersection(tile)
    if inner.is_empty:
        return
    near = image.near(
        slice(inner.top - middle, inner.bottom + middle),
        slice(inner.left - middle, inner.right + middle),
    )
    if near is None:
        return
    weights = image.kernel[middle:].astype(total.dtype)
    down = _spread_along(near, weights, 0)
    total[inner.top : inner.bottom, inner.left : inner.right] += _spread_along(down, weights, 1)


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
