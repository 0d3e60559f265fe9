"""How many rays of the pinhole there are in a pixel."""

from __future__ import annotations

import math

import numpy as np

from .columns import Columns
from .raster import Window

ENOUGH_TO_COUNT = 1 << 18
"""So many samples tell how many there are in a pixel."""

ROUNDED_PLACES = 0.01
"""Samples of a pixel that rounding may have moved to the next row."""


def primary_rays(samples: Columns, crop: Window, window: Window, on_lattice: bool) -> int:
    """Primary rays in a pixel of the window ``crop``: mean, rounded down.

    ``window`` is what was sampled; ``on_lattice`` are samples that may belong to several pixels.
    What a ray sees behind half-transparent things are several samples, of one position. Of many
    samples those of some rows of pixels are counted.
    """
    some: slice | np.ndarray = slice(None)
    every = 1 if on_lattice else min(-(-len(samples) // ENOUGH_TO_COUNT), crop.height)
    pixels = len(range(every // 2, crop.height, every)) * crop.width
    if every > 1:
        rows = samples.y.astype(np.int32)
        rows -= crop.top + every // 2
        some = np.flatnonzero(rows // every * every == rows)  # Faster than remainders.
    x, y = samples.x[some], samples.y[some]
    own = crop.shows(x, y, window) & (samples.layer[some] == 0)
    weight = samples.weight[some][own]
    count = len(weight)
    if count > 0 and weight.min() < weight.max():
        x, y = (of[own].view(np.uint32) for of in (x, y))
        # NumPy's own unique hashes them, which takes seconds for these.
        places = np.sort(x.astype(np.uint64) << np.uint64(32) | y)
        count = 1 + np.count_nonzero(np.diff(places))
    return math.floor(count / pixels + ROUNDED_PLACES)
