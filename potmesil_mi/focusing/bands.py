"""Bands: bins of vergence whose circles are similar, from the nearest to the farthest."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..optics.blur import Blur
from .locating import Bins

SLICE_RADII = 4.0 ** np.arange(12)
"""Radii in subpixels between which circles form a slice; up to the first they are of both signs."""

PARTING = math.sqrt(2)
"""Slices are parted at most so many times below or above one of the ``SLICE_RADII``."""

HIGHLIGHT_FINER = 5
"""Circles of highlights have so many times as many pixels a radius, at least, as others."""


class Raster(NamedTuple):
    """The pixels of a slice, and what is spread on them.

    ``coarsening`` is that of the view's fragments, ``resolution`` that of the slice; ``has_view``
    says whether unoccluded and occluded fragments are there, ``has_highlights`` highlights.
    """

    coarsening: int
    resolution: int
    has_view: bool
    has_highlights: bool


@dataclasses.dataclass(frozen=True)
class Band:
    """Bins of similar circles: from ``first`` on, before ``end``.

    Circles' radii, in subpixels, are between ``inner`` and ``outer``; ``inner`` is 0 where they
    are of both signs. They are spread on pixels of ``resolution`` subpixels; highlights, of which
    one sees the edges, on pixels of ``highlight_resolution``.
    """

    first: int
    end: int
    inner: float
    outer: float
    sign: float
    resolution: int
    highlight_resolution: int

    def rasters(self) -> list[Raster]:
        """The pixels on which the band is spread: highlights may have their own."""
        if self.highlight_resolution == self.resolution:
            return [Raster(self.resolution, self.resolution, True, True)]
        return [
            Raster(self.resolution, self.resolution, True, False),
            Raster(1, self.highlight_resolution, False, True),
        ]


def bands(counts: np.ndarray, bins: Bins, blur: Blur, kept_radius: float) -> Iterator[Band]:
    """The bands that have fragments, from the nearest.

    ``counts``, (B,), tell how many fragments each of the ``bins`` has. Around each of the
    ``SLICE_RADII`` they are parted where there are the fewest fragments: between surfaces rather
    than within one.
    """
    if blur.radius_per_vergence == 0:
        yield Band(0, len(counts), 0.0, 0.0, 1.0, 1, 1)
        return
    focused = (blur.focused_vergence - bins.vergence_min) / bins.width
    bins_of_radius = 1 / (blur.radius_per_vergence * bins.width)

    def fragments_in(bin_: np.ndarray) -> np.ndarray:
        inside = (bin_ >= 0) & (bin_ < len(counts))
        return np.where(inside, counts[np.clip(bin_, 0, len(counts) - 1)], 0)

    def parting(edge: float) -> int:
        """The first bin beyond a signed radius; it begins a bin of the coarser views, too."""
        size = resolution_of(abs(edge) * PARTING, kept_radius)
        ends = sorted(focused + edge * bins_of_radius * by for by in (1 / PARTING, PARTING))
        first, last = (min(max(round(end / size), 0), len(counts) // size + 1) for end in ends)
        at = np.arange(first, last + 1) * size
        number = fragments_in(at - 1) + fragments_in(at)
        fewest = at[number == number.min()]
        return int(fewest[np.abs(fewest - (focused + edge * bins_of_radius)).argmin()])

    edges = [*-SLICE_RADII[::-1], *SLICE_RADII]
    partings = [0, *(parting(edge) for edge in edges[1:-1]), len(counts)]
    for i in reversed(range(len(edges) - 1)):
        filled = partings[i] + np.flatnonzero(counts[partings[i] : partings[i + 1]])
        if len(filled) == 0:
            continue
        first, end = int(filled[0]), int(filled[-1]) + 1
        inner, outer = sorted(abs(end - focused) / bins_of_radius for end in (first, end))
        if edges[i] < 0 < edges[i + 1]:
            yield Band(first, end, 0.0, outer, 1.0, 1, 1)
        else:
            sign = math.copysign(1, edges[i])
            resolution = resolution_of(inner, kept_radius)
            highlight_resolution = resolution_of(inner, HIGHLIGHT_FINER * kept_radius)
            yield Band(first, end, inner, outer, sign, resolution, highlight_resolution)


def resolution_of(radius: float, kept_radius: float) -> int:
    """Width in subpixels of the pixels on which circles of at least a ``radius`` are spread."""
    if radius < kept_radius:
        return 1
    return 2 ** max(0, math.floor(math.log2(radius / kept_radius)))
