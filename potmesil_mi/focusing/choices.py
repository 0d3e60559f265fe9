"""Choices: what a picture that is formed by tiles chooses as a whole.

What of a picture is discrete is chosen from all of its samples. Tiles that share these choices are
parts of one picture: beside each other they show no seam.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from ..samples.raster import Window
from .highlights import HighlightLimits
from .lens_view import ViewLimits
from .locating import Bins
from .view_counts import ViewCounts


class TableEnds(NamedTuple):
    """Of equation 20: depths of the first and the last table, and up to which it is not infinite.

    What is farther than ``last`` has a table of its own.
    """

    nearest: np.float32
    farthest: np.float32
    last: float


@dataclasses.dataclass(frozen=True)
class Choices:
    """What a picture has chosen as a whole, for one point-spread function.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``window``                    pixels of the film that its samples are of
    ``halo``                      how far around a tile samples are needed, in pixels
    ``light``                     how far from fragments their light is, in subpixels
    ``alignment``                 tiles begin at multiples of so many pixels of the window, in
                                  which they have the coarser pixels of the whole
    ``tables``                    of equation 20: where its tables end; ``None`` for others
    ``bins``, ``bin_count``       the bins of vergence, and how many there are
    ``is_even``                   whether there are as many samples everywhere
    ``has_known``                 whether the visibility of some is known
    ``detail_degree``             of the moments that tell the detail of fragments
    ``limits``                    what its fragments say of the view; found from all tiles
    ``counts``                    what its view has of fragments; found from all tiles then
    ``single``                    the limits of its single points, where it has any
    ============================  ==========================================================
    """

    window: Window
    halo: int
    light: int = 0
    alignment: int = 1
    tables: TableEnds | None = None
    bins: Bins | None = None
    bin_count: int = 0
    is_even: bool = False
    has_known: bool = False
    detail_degree: int = 0
    limits: ViewLimits | None = None
    counts: ViewCounts | None = None
    single: HighlightLimits | None = None
