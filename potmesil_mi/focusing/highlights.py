"""Highlights: fragments so bright that their light shows the shape of the lens."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import NamedTuple

import numpy as np
import scipy.ndimage

from .detail import NO_DETAIL
from .fragments import SHARE, Fragments

HIGHLIGHT_TO_MEDIAN = 8
"""A highlight is so many times as bright as the median of what the pinhole sees, at least."""

HIGHLIGHT_CONTRAST = 6
"""A highlight is so many times as bright as the mean of its neighbourhood, at least."""

NEIGHBOURHOOD = 33
"""Subpixels on a side of the neighbourhood of a highlight."""

MAX_HIGHLIGHTS = 1 << 14
"""Most highlights of a view: the brightest ones."""


class HighlightLimits(NamedTuple):
    """What all of a picture says of its highlights.

    They are brighter than ``least``, and than ``faintest``, the brightest that there is no room
    for.
    """

    least: np.float64
    faintest: float


class Peaks(NamedTuple):
    """How bright fragments are.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``shape``                     rows and columns of the raster
    ``subpixel``                  int (N,), where each is
    ``first``                     bool (N,), whether the pinhole sees it
    ``peak``                      float32 (N,), the largest of R, G and B where it fills a
                                  subpixel
    ============================  ==========================================================
    """

    shape: tuple[int, int]
    subpixel: np.ndarray
    first: np.ndarray
    peak: np.ndarray

    @classmethod
    def of(cls, fragments: Fragments) -> Peaks:
        """Those of ``fragments``."""
        # Samples of what is hidden may be more than fill a subpixel.
        filled = np.maximum(fragments.values[:, SHARE], 1)
        peak = fragments.values[:, :SHARE].max(axis=1, initial=0) / filled
        shape = fragments.height, fragments.width
        return cls(shape, fragments.subpixel, fragments.first, peak)

    def highlights(
        self, limits: HighlightLimits | None = None
    ) -> tuple[np.ndarray, HighlightLimits]:
        """The highlights, bool (N,), and the ``limits`` of these, found here unless given."""
        shape, subpixel, first, peak = self
        picture = np.bincount(subpixel[first], peak[first], shape[0] * shape[1])
        around = scipy.ndimage.uniform_filter(picture.reshape(shape), NEIGHBOURHOOD)
        least = (
            HIGHLIGHT_TO_MEDIAN * np.median(picture[subpixel]) if limits is None else limits.least
        )
        bright = peak > least
        stands_out = np.zeros(shape, dtype=bool)
        contrasts = peak > HIGHLIGHT_CONTRAST * around.ravel()[subpixel]
        stands_out.flat[subpixel[bright & contrasts]] = True
        bright &= scipy.ndimage.binary_dilation(stands_out, np.ones((3, 3))).ravel()[subpixel]
        if limits is None:
            faintest = -math.inf
            if bright.sum() > MAX_HIGHLIGHTS:
                faintest = np.partition(peak[bright], -MAX_HIGHLIGHTS)[-MAX_HIGHLIGHTS]
            limits = HighlightLimits(least, float(faintest))
        bright &= peak > limits.faintest
        return bright, limits


def is_highlight(fragments: Fragments, limits: HighlightLimits | None = None) -> np.ndarray:
    """The fragments, bool (N,), much brighter than most subpixels and than what is around them.

    So are bright ones beside these: where such a thing ends in the middle of a subpixel it shows,
    too. There are at most ``MAX_HIGHLIGHTS``. ``limits`` are those of the picture that the
    fragments are a tile of, if they are.
    """
    return Peaks.of(fragments).highlights(limits)[0]


def parted(fragments: Fragments, bright: np.ndarray) -> tuple[Fragments, Fragments]:
    """Fragments without the highlights in those that are ``bright``, bool (N,), and these.

    Highlights are colours alone: the part that exceeds the mean of the subpixels beside that are
    not bright. The rest, which keeps the share, is spread with what is beside it.
    """
    chosen = dataclasses.replace(fragments.chosen(bright), moments=None, detail=None)
    if len(chosen) == 0:
        return fragments, chosen
    rest = _no_brighter(chosen, _mean_beside(fragments, bright))
    light = chosen.values - rest
    chosen = dataclasses.replace(chosen, values=light)
    values = fragments.values.copy()
    values[bright] = rest
    share = rest[:, SHARE, None]
    evenly = rest[:, :SHARE] / np.where(share != 0, share, np.inf)
    moments, detail = fragments.moments, fragments.detail
    if moments is not None:
        moments = moments.copy()
        moments[bright, :, :SHARE] = moments[bright, :, SHARE, None] * evenly[:, None]
    if detail is not None:
        detail = np.where(bright, np.int32(NO_DETAIL), detail)
    fragments = dataclasses.replace(fragments, values=values, moments=moments, detail=detail)
    return fragments, chosen


def _mean_beside(fragments: Fragments, bright: np.ndarray) -> np.ndarray:
    """The mean colours of what is not bright beside fragments that are, float32 (n, 3)."""
    shape, others = (fragments.height, fragments.width), fragments.first & ~bright
    x, y = fragments.x[bright], fragments.y[bright]
    around = []
    for column in fragments.values[others, : SHARE + 1].T:
        of = np.bincount(fragments.subpixel[others], column, shape[0] * shape[1])
        padded = np.pad(of.reshape(shape), 1)
        around.append(sum(padded[y + j, x + i] for i, j in itertools.product(range(3), repeat=2)))
    *colours, share = around
    return (np.stack(colours, axis=1) / np.where(share > 0, share, np.inf)[:, None]).astype(
        np.float32
    )


def _no_brighter(fragments: Fragments, colours: np.ndarray) -> np.ndarray:
    """The values of fragments, no brighter than ``colours``, (N, 3)."""
    values = fragments.values.copy()
    most = colours * values[:, SHARE, None]
    values[:, :SHARE] = np.minimum(values[:, :SHARE], most)
    return values
