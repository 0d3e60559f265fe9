"""The plan of a focus: what of it is discrete, made first, on the host.

Fragments of similar circles form a depth slice. A plan says, for each slice, on pixels of what size
it is spread, in which box, by kernels of which radii. The operators of ``.splat``, ``.convolve``
and ``.composite`` then apply it; they are linear in the light, or piecewise smooth.

Within a slice, pixels and kernel radii get coarser as the circles grow, so that the cost of a
focus does not grow with their area.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from ..optics.blur import Blur
from ..optics.convolution import fast_size
from ..optics.lens import ThinLens
from ..optics.psf import PointSpreadFunction, aperture_behind
from ..samples.raster import Window
from .bands import Band, Raster, bands
from .fragments import BIN_RADIUS, Fragments
from .kernels import LINEAR_VARIANCE, SUBPIXEL_VARIANCE, KernelFactory, is_plain
from .lens_view import Occluded, ViewPyramid
from .locating import Bins
from .small_circles import STEP, SmallCircles, responses_of
from .view_counts import SliceFacts, ViewCounts, box_of, parts_of_slice

CELL_RADIUS = 1.0
"""Over what the share of a lens point is spread, in radii of a disc of its part of the lens."""

HIGHLIGHT_CELL_RADIUS = 1.7
"""The same for highlights, of which one sees gaps between the points."""

KERNEL_RATIO = math.sqrt(2)
"""Largest ratio of neighbouring kernel radii with circles between them."""

SMALL_AREA_KERNEL_RATIO = 1.25
"""The same in small parts of the window, where more kernels cost little."""

SMALL_CIRCLE_KERNEL_RATIO = 2 ** (1 / 4)
"""The same there for circles so small that they are spread on subpixels, and not on coarser
pixels."""

DIFFRACTION_KERNEL_RATIO = 2 ** (1 / 8)
"""The same where the pattern changes with the circle."""

SAME_KERNEL = 0.06
"""Circles whose radii differ by no more than this part of them, or by ``BIN_RADIUS`` pixels, have
one kernel."""

MIDDLE_KERNEL = 0.6
"""Where circles are of both signs, there is a kernel for this part of the largest radius."""

MOVED_REACH = 3
"""Pixels on each side among which a single point is shared to be in its place."""

NARROW = 0.1
"""Share of the light in one pixel from which on a kernel is too narrow for polynomials."""


class Fineness(NamedTuple):
    """How finely circles are spread.

    ``kept_radius``: circles of at least twice this radius, in subpixels, are spread on pixels so
    many times as large that it stays no less. ``small_area``: boxes of up to so many pixels have
    more kernels.
    """

    kept_radius: float
    small_area: float


@dataclasses.dataclass(frozen=True)
class CirclePlan:
    """Unoccluded fragments of a slice, spread by kernels of circles close to theirs.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``fragments``                 those of the view
    ``part``                      which of them are in the slice
    ``kernel_radii``              float64 (K,), ascending, in pixels of the slice
    ``kernels``                   one for each radius
    ``small``                     the detail of the fragments where their circles are small and
                                  it is known; else ``None``
    ``first_bin``                 of the bins in ``kernel_of_bin``
    ``kernel_of_bin``             uint32 (bins,), index of the kernel before a bin's circles
    ``single_points``             int64 (n,), fragments of ``part`` so bright that their place
                                  within a pixel shows
    ``moved_reach``               pixels on each side among which these are shared
    ============================  ==========================================================
    """

    fragments: Fragments
    part: slice
    kernel_radii: np.ndarray
    kernels: list[np.ndarray]
    small: SmallCircles | None
    first_bin: int
    kernel_of_bin: np.ndarray
    single_points: np.ndarray
    moved_reach: int


@dataclasses.dataclass(frozen=True)
class PointPlan:
    """Occluded fragments of a slice, of which each lens point that sees them gets its share.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``occluded``                  those of the view
    ``part``                      which of them are in the slice
    ``pixel``                     width of the slice's pixels in subpixels of the fragments
    ``cell``                      radius of a lens point's cell, in radii of the circle
    ``kernels``                   of a cell, one for each octave that has circles
    ============================  ==========================================================
    """

    occluded: Occluded
    part: slice
    pixel: int
    cell: float
    kernels: list[np.ndarray]


@dataclasses.dataclass(frozen=True)
class DepthSlice:
    """Fragments of similar circles, and how they are to be spread.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``resolution``                width of the slice's pixels in subpixels
    ``box``                       pixels of the slice that its light reaches
    ``blur``                      of the lens, in pixels of the slice
    ``octaves``                   radii, ascending, from each of which on circles have cells of
                                  one size
    ``smeared``                   variance, in pixels squared, with which the images are spread
                                  by the pixels' size and by interpolation between them
    ``moments``                   how many moments tell where in a pixel light is: those of the
                                  fragments where circles are about as small, else 0
    ``circles``                   the unoccluded fragments
    ``points``                    occluded fragments, and highlights
    ============================  ==========================================================
    """

    resolution: int
    box: Window
    blur: Blur
    octaves: list[float]
    smeared: float
    moments: int
    circles: CirclePlan
    points: list[PointPlan]


def plan(
    views: ViewPyramid,
    lens: ThinLens,
    psf: PointSpreadFunction,
    blur: Blur,
    subpixels_per_mm: float,
    fineness: Fineness,
    whole: ViewCounts | None = None,
) -> list[list[DepthSlice]]:
    """The slices of a focus, those at about one depth together, from the nearest.

    ``blur`` is that of the lens in subpixels. ``whole`` has the counts of the picture that the
    views are a tile of, if they are: its slices are chosen by them.
    """
    groups = []
    finest = views.finest
    bins = Bins(finest.unoccluded.vergence_min, finest.unoccluded.bin_width)
    counts = finest.counts if whole is None else whole.total
    for band in bands(counts, bins, blur, fineness.kept_radius):
        slices = [
            _SlicePlanner(views, lens, psf, blur, subpixels_per_mm, band, raster, whole).planned(
                fineness
            )
            for raster in band.rasters()
        ]
        groups.append([each for each in slices if each is not None])
    return groups


def smeared(resolution: int) -> float:
    """Variance, in pixels squared, that pixels of a ``resolution`` add to what is spread on them.

    It is that of interpolation between coarser pixels and of gathering by them, less what their
    size leaves out.
    """
    if resolution == 1:
        return 0.0
    steps = 0.25 ** np.arange(round(math.log2(resolution)))
    return float(3 / 16 * steps.sum() - SUBPIXEL_VARIANCE / resolution**2 + LINEAR_VARIANCE)


class _SlicePlanner:
    """Plans the slice of one band on one raster."""

    def __init__(
        self,
        views: ViewPyramid,
        lens: ThinLens,
        psf: PointSpreadFunction,
        blur: Blur,
        subpixels_per_mm: float,
        band: Band,
        raster: Raster,
        whole: ViewCounts | None,
    ) -> None:
        factor = raster.resolution
        self.band, self.raster = band, raster
        self.detail = views.detail
        self.view = views.at(raster.coarsening, range(band.first, band.end))
        self.blur = Blur(blur.radius_per_vergence / factor, blur.focused_vergence)
        self.inner, self.outer = band.inner / factor, band.outer / factor
        self.parts = parts_of_slice(self.view, band, raster)
        self.box = box_of(self.view, self.parts, raster)
        if whole is None:
            self.facts = SliceFacts.of(self.view, self.parts, self.box)
        else:
            self.facts = whole.facts(band, raster)
        # Farther than the window is wide, and a pixel more to interpolate with, nothing is seen.
        largest = (self.facts.width + 2, self.facts.height + 2)
        self.factory = KernelFactory(
            lens,
            psf,
            subpixels_per_mm / factor,
            self.blur.radius_per_vergence,
            self.blur.focused_vergence,
            band.sign,
            smeared(factor),
            largest,
        )
        radii = np.abs(self.facts.vergences - self.blur.focused_vergence)
        self.radii = radii * self.blur.radius_per_vergence

    def planned(self, fineness: Fineness) -> DepthSlice | None:
        """The slice; ``None`` if it has no fragments.

        One that is sharp, of a tile that has none of its fragments, stays without them.
        """
        if self.box.is_empty and (self.facts.area == 0 or self.inner > 0):
            return None
        ratio = KERNEL_RATIO
        if self.facts.area <= fineness.small_area:
            on_subpixels = self.raster.resolution == 1
            ratio = SMALL_CIRCLE_KERNEL_RATIO if on_subpixels else SMALL_AREA_KERNEL_RATIO
        circles = self._circles(ratio)
        box = Window(0, 0, 1, 1)
        if not self.box.is_empty:
            box = self.box.grown(self._reach(circles.kernels))
            box = box._replace(width=fast_size(box.width), height=fast_size(box.height))
        octaves = self._octaves()
        occluded = (self.view.occluded, CELL_RADIUS), (self.view.highlights, HIGHLIGHT_CELL_RADIUS)
        # How many of the fragments' own subpixels make a pixel of the slice.
        pixels = 1, self.raster.resolution
        return DepthSlice(
            self.raster.resolution,
            box,
            self.blur,
            octaves,
            self.factory.smeared,
            self._moments(),
            circles,
            [
                self._points(some, part, pixel, radius, octaves, last_bins)
                for (some, radius), part, pixel, last_bins in zip(
                    occluded, self.parts[1:], pixels, self.facts.ends, strict=True
                )
                if part.start < part.stop
            ],
        )

    def _moments(self) -> int:
        moments = self.view.unoccluded.moments
        return 0 if moments is None or self.inner > 0 else moments.shape[1]

    def _circles(self, ratio: float) -> CirclePlan:
        small = self._small()
        radii = np.zeros(1) if small is not None else self._kernel_radii(ratio)
        kernels = [self.factory.of_radius(radius) for radius in radii]
        part = self.parts[0]
        single_points = self.view.single_points
        single_points = single_points[(single_points >= part.start) & (single_points < part.stop)]
        wide = len(single_points) > 0 and max(kernel.max() for kernel in kernels) < NARROW
        # The edge of a truncated pattern is sharp.
        wide = wide and not aperture_behind(self.factory.psf).ends_sharply
        before = np.clip(np.searchsorted(radii, self.radii, side="right") - 1, 0, None)
        if len(radii) > 1:
            before = np.minimum(before, len(radii) - 2)
        first_bin, every_bin = 0, np.empty(0, np.int64)
        if part.start < part.stop:
            first_bin, last_bin = self.view.unoccluded.bin[[part.start, part.stop - 1]].tolist()
            every_bin = np.arange(first_bin, last_bin + 1)
        number = np.searchsorted(self.facts.bins, every_bin, side="right") - 1
        kernel_of_bin = before[np.maximum(number, 0)].astype(np.uint32)
        return CirclePlan(
            self.view.unoccluded,
            part,
            radii,
            kernels,
            small,
            first_bin,
            kernel_of_bin,
            single_points,
            MOVED_REACH if wide else 1,
        )

    def _small(self) -> SmallCircles | None:
        """The detail of the fragments, if it is known and their circles are small."""
        psf = self.factory.psf
        is_small = self.inner == 0 and self.radii.max(initial=0) > STEP / 2
        if not is_small or self.detail is None or not is_plain(psf):
            return None
        squeeze = float(self.factory.lens.squeeze)
        return SmallCircles(self.detail, responses_of(psf, squeeze, self.detail.degree))

    def _kernel_radii(self, ratio: float) -> np.ndarray:
        """Radii, as few as will do, that have kernels; there are circles near each.

        ``ratio`` is the largest of neighbouring ones with circles between them.
        """
        if self.inner == 0:
            outer = float(self.radii.max(initial=0.0))
            return np.array([0.0, MIDDLE_KERNEL * outer, outer] if outer > 0 else [0.0])
        radii = np.sort(self.radii)
        alike = len(radii) > 0 and radii[-1] - radii[0] <= max(BIN_RADIUS, SAME_KERNEL * radii[0])
        if alike and not self.factory.diffracts:
            return np.array([math.sqrt(radii[0] * radii[-1])])
        if self.factory.diffracts:
            ratio = DIFFRACTION_KERNEL_RATIO
        chosen: list[float] = []
        next_ = 0
        while next_ < len(radii):
            chosen.append(float(radii[next_]))
            last = int(np.searchsorted(radii, chosen[-1] * ratio, side="right")) - 1
            next_ = max(last, next_ + 1)
        return np.array(chosen)

    def _reach(self, kernels: list[np.ndarray]) -> int:
        """Pixels beyond the fragments that their light may reach."""
        cell = math.sqrt(2 / self.view.occluded.count) * CELL_RADIUS
        paths = [
            along / pixel + deeper * self.blur.radius_per_vergence
            for (along, deeper), pixel in (
                (self.view.occluded.fragments.path_reach, 1),
                (self.view.highlights.fragments.path_reach, self.raster.resolution),
            )
        ]
        cells = math.ceil(self.outer * (1 + cell) + max(paths)) + 3
        if self.factory.diffracts:
            cells += max(self.factory.in_focus().shape) // 2
        return max([cells, *(max(kernel.shape) // 2 + 1 for kernel in kernels)]) + MOVED_REACH

    def _octaves(self) -> list[float]:
        if self.inner == 0:
            return [0.0]
        count = max(1, math.ceil(math.log2(self.outer / self.inner) - 1e-3))
        return [self.inner * 2**i for i in range(count)]

    def _points(
        self,
        some: Occluded,
        part: slice,
        pixel: int,
        radius: float,
        octaves: list[float],
        last_bins: tuple[int, int],
    ) -> PointPlan:
        cell = radius / math.sqrt(some.count)
        ends = np.array(last_bins) + np.array([0, 1])
        vergences = some.fragments.vergence_min + some.fragments.bin_width * ends
        vergences = vergences - self.blur.focused_vergence
        largest = np.abs(vergences).max() * self.blur.radius_per_vergence
        kernels = [
            self.factory.of_cell(cell * edge)
            for octave, edge in enumerate(octaves)
            if octave == 0 or edge <= largest
        ]
        return PointPlan(some, part, pixel, cell, kernels)
