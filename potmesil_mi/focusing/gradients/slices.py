"""The plan of a focus with gradients: slices, and the circles at which kernels stand.

The slices are those of a focus without gradients. The circles do not depend on what is in focus:
between two of them a circle is a weighted sum of both, whose weights change smoothly.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from ... import _backend as jit
from ...optics.blur import Blur
from ...optics.convolution import fast_size
from ...optics.lens import ThinLens
from ...samples.raster import Window
from ..bands import Band, bands
from ..fragments import Fragments
from ..kernels import KernelFactory, is_plain
from ..locating import Bins
from ..slices import CELL_RADIUS, Fineness, smeared
from ..small_circles import responses_of
from .opening import AttachedKernels, Opening
from .view import SmoothView

CIRCLES_AN_OCTAVE = 4
"""Circles at which kernels stand, from one radius to twice that radius."""

SMALLEST_CIRCLE = 2 ** (-3 / 2)
"""The radius of the smallest of them but for 0, in subpixels."""

CELLS_AN_OCTAVE = 1
"""Circles of which lens points' cells have kernels."""

SMALLEST_CELL = 2.0
"""The radius of the circle of the smallest cell but for 0, in subpixels."""

CELL_OF_CIRCLE = CELL_RADIUS / math.sqrt(2)
"""Radius of cells, see :data:`potmesil_mi.focusing.slices.CELL_RADIUS`: those are of the smallest
circle of an octave, these of each."""


def circles_around(inner: float, outer: float, smallest: float, an_octave: int) -> np.ndarray:
    """Radii, float64 (K,), that stand still: 0, ``smallest``, and so many an octave.

    They are those from the last that is not above ``inner`` to the first that is not below
    ``outer``; at least two.
    """
    last = max(math.ceil(math.log2(max(outer, smallest) / smallest) * an_octave), 0)
    first = -1
    if inner >= smallest:
        first = min(math.floor(math.log2(inner / smallest) * an_octave), last - 1)
    radii = [0.0 if k < 0 else smallest * 2 ** (k / an_octave) for k in range(first, last + 1)]
    return np.array(radii)


@dataclasses.dataclass(frozen=True)
class SmoothSlice:
    """Fragments of similar circles, and by what kernels they are spread.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``resolution``, ``box``       its pixels, as those of a :class:`.slices.DepthSlice`
    ``is_sharp``                  whether the circles are of both signs
    ``unoccluded``, ``occluded``  which of the view's fragments are in it
    ``small``                     where circles are small and the detail of fragments is known,
                                  the table of what subpixels around get of it, see
                                  :func:`.responses_of`;
                                  there is one kernel then, of no width
    ``circles``, ``kernels``      radii in subpixels, float64 (K,), and a kernel for each
    ``attached_kernels``          the same kernels where they have gradients, or ``None``
    ``cells``, ``cell_kernels``   radii in subpixels of circles, float64 (L,), and a kernel for
                                  the cell of a lens point of each
    ============================  ==========================================================
    """

    resolution: int
    box: Window
    is_sharp: bool
    unoccluded: slice
    occluded: slice
    small: jit.Float | None
    circles: np.ndarray
    kernels: list[np.ndarray]
    attached_kernels: AttachedKernels | None
    cells: np.ndarray
    cell_kernels: list[np.ndarray]


def plan(
    view: SmoothView,
    lens: ThinLens,
    opening: Opening,
    blur: Blur,
    subpixels_per_mm: float,
    fineness: Fineness,
) -> list[SmoothSlice]:
    """The slices of a focus, from the nearest; all but the ``opening`` has plain numbers."""
    fragments = view.gathering.fragments
    bins = Bins(fragments.vergence_min, fragments.bin_width)
    slices = []
    for band in bands(view.counts, bins, blur, fineness.kept_radius):
        parts = [
            slice(*np.searchsorted(fragments.bin[kind], [band.first, band.end]))
            for kind in (view.unoccluded, view.occluded)
        ]
        index = [view.unoccluded[parts[0]], view.occluded[parts[1]]]
        if len(index[0]) + len(index[1]) > 0:
            these = fragments.chosen(np.concatenate(index))
            slices.append(_planned(view, these, parts, band, lens, opening, blur, subpixels_per_mm))
    return slices


def _planned(
    view: SmoothView,
    fragments: Fragments,
    parts: Sequence[slice],
    band: Band,
    lens: ThinLens,
    opening: Opening,
    blur: Blur,
    subpixels_per_mm: float,
) -> SmoothSlice:
    """The slice of a ``band``, which has the ``fragments``."""
    factor = band.resolution
    factory = KernelFactory(
        lens,
        opening.psf,
        subpixels_per_mm / factor,
        blur.radius_per_vergence / factor,
        blur.focused_vergence,
        band.sign,
        smeared(factor),
        (fragments.width + 2, fragments.height + 2),
    )
    radii = np.abs(blur.radius(fragments.vergence))
    ends = float(radii.min()), float(radii.max())
    is_sharp, small = band.inner == 0, None
    if is_sharp:
        ends, small = (0.0, ends[1]), _small_circles(view, opening, float(lens.squeeze))
    circles, kernels, attached = np.zeros(1), [np.ones(1)], None
    if small is None:
        circles = circles_around(*ends, SMALLEST_CIRCLE, CIRCLES_AN_OCTAVE)
        kernels = [factory.of_radius(radius / factor) for radius in circles]
        attached = opening.kernels(factory, circles / factor, kernels)
    cells = circles_around(*ends, SMALLEST_CELL, CELLS_AN_OCTAVE)
    cell = CELL_OF_CIRCLE / math.sqrt(len(view.points))
    cell_kernels = [factory.of_cell(cell * radius / factor) for radius in cells]
    reach = math.ceil(ends[1] / factor * float(np.hypot(*view.points.T).max())) + 3
    reach += max(kernel.shape[0] // 2 for kernel in cell_kernels)
    reach = max([reach, *(max(kernel.shape) // 2 + 2 for kernel in kernels)]) + 2
    x, y = fragments.x // factor, fragments.y // factor
    left, top = int(x.min()) - reach, int(y.min()) - reach
    box = Window(
        left,
        top,
        fast_size(int(x.max()) + 1 + reach - left),
        fast_size(int(y.max()) + 1 + reach - top),
    )
    return SmoothSlice(
        factor,
        box,
        is_sharp,
        parts[0],
        parts[1],
        small,
        circles,
        kernels,
        attached,
        cells,
        cell_kernels,
    )


def _small_circles(view: SmoothView, opening: Opening, squeeze: float) -> jit.Float | None:
    """The table of what subpixels get of small circles, if it can be used."""
    detail, psf = view.plain.detail, opening.psf
    if detail is None or not is_plain(psf):
        return None
    return opening.responses(responses_of(psf, squeeze, detail.degree), squeeze)
