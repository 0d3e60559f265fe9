"""Opacity: what part a fragment hides of what is behind it.

Optical depth is the negative logarithm of what is let through: it adds up.
"""

from __future__ import annotations

import math

import numpy as np

from .fragments import SHARE, Fragments

ROUNDING = 1e-6
"""Shares of a subpixel that differ by less are the same."""

DEPTH_STEP = 2.0**-12
"""Optical depths are multiples of it, so that single precision adds them up without rounding, in
whatever order threads do so."""

OPAQUE = 16.0
"""Optical depth of what hides all that is behind it."""


def optical_depth(fragments: Fragments) -> np.ndarray:
    """The optical depth of each fragment, float32 (N,).

    Of what the pinhole sees in a subpixel each fragment has a share. Its opacity is its part of
    what the nearer ones leave: behind all of them nothing is left, and where chance has put fewer
    samples there is no hole. So it is with what is hidden, but for what is at the depth of what is
    seen: it is more of that, whose opacity is known.
    """
    subpixel, seen = fragments.subpixel, fragments.first
    size = fragments.width * fragments.height
    result = np.full(len(fragments), OPAQUE, np.float32)
    # Most subpixels have one fragment, which is opaque. Of the others the nearest comes first.
    others = np.flatnonzero(np.bincount(subpixel, minlength=size)[subpixel] > 1)[::-1]
    if len(others) == 0:
        return result
    others = others[np.lexsort([~seen[others], -fragments.bin[others], subpixel[others]])]
    subpixel, seen = subpixel[others], seen[others]
    share = fragments.values[others, SHARE].astype(np.float64)
    total = np.bincount(subpixel, share * seen, size)[subpixel]
    share /= np.where(total > 0, total, 1)
    # Those of one subpixel and one bin are one thing.
    begins = np.diff(subpixel, prepend=-1) != 0
    first = np.flatnonzero(begins | (np.diff(fragments.bin[others], prepend=-1) != 0))
    visible, hidden = (np.add.reduceat(share * which, first) for which in (seen, ~seen))
    begins = begins[first]
    hidden = np.where(visible > 0, 0, hidden)
    opacity = _part_of_rest(visible, begins) + _part_of_rest(hidden, begins)
    result[others] = 0
    depth = -np.log(np.maximum(1 - opacity, math.exp(-OPAQUE)))
    result[others[first]] = np.rint(depth / DEPTH_STEP) * DEPTH_STEP
    return result


def _part_of_rest(shares: np.ndarray, begins: np.ndarray) -> np.ndarray:
    """What part each of ``shares`` is of what those before it leave of 1, at most 1, (N,).

    A new sequence of shares begins where ``begins`` is true.
    """
    before = np.cumsum(shares) - shares
    before -= before[begins][np.cumsum(begins) - 1]
    rest = 1 - before
    return np.where(shares < rest - ROUNDING, shares / np.maximum(rest, ROUNDING), 1) * (shares > 0)
