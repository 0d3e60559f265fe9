"""Viewing: what a lens sees of the samples of an exposure, found out step by step, and kept.

Samples are gathered to fragments, these are evened, and then what the points of the lens see of
them is found. None of it depends on where the lens is focused.
"""

from __future__ import annotations

import dataclasses
import functools
import math

import drjit as dr

from .. import _backend as jit
from ..optics.aperture import Aperture
from ..optics.blur import Blur
from ..optics.psf import aperture_behind
from ..samples.point_samples import PointSamples
from .density import Evened, evened
from .detail import detail_degree
from .exposure import FINE_SUBPIXELS, Exposure, Visibility
from .exposure_view import view_of_exposure
from .fragments import Fragments
from .gathering import gather_with_known, with_offsets
from .lens_points import LensPoints
from .lens_view import LensView, ViewPyramid
from .memo import Memo
from .reach import within_reach
from .slices import Fineness

SIMILAR_RADIUS = 0.025
"""Apertures whose radii differ by no more than this part see the same, as far as ``layered`` can
tell: with the film at F an aperture changes a little as the lens is focused."""

CLOSED_RADIUS = 1e-9
"""Radius of a closed aperture's circles, in subpixels per unit of vergence."""

SMALL_AREA = 1 << 17
"""Pixels of a slice up to which ``layered`` takes more kernels."""

EXACT_KEPT_RADIUS = 16
"""Radius in pixels that circles keep on coarser rasters where visibility is exact."""

FINE_KEPT_RADIUS = 4
"""The same on fine subpixels, on which ``layered`` takes more kernels in parts of the same size in
pixels."""

MOST_KEPT = 1 << 22
"""Subpixels up to which Dr.Jit keeps the memory by which samples were gathered for the next ones:
of larger pictures the fragments need it."""


class Viewing:
    """What the lens sees of an exposure: known from before, by a memo, or found out now.

    The samples of the ``exposure`` become those within reach, unless it is that of a tile, which
    has them already.
    """

    def __init__(self, exposure: Exposure, memo: Memo, how: Visibility) -> None:
        if exposure.choices is None:
            of_pixels = Blur.of(exposure.lens, exposure.samples.camera)
            samples, memo = within_reach(exposure.samples, of_pixels, memo)
            exposure = dataclasses.replace(exposure, samples=samples)
        self.exposure, self.memo, self._how = exposure, memo, how

    @property
    def fineness(self) -> Fineness:
        """How finely circles are spread."""
        exposure, how = self.exposure, self._how
        kept_radius, small_area = 0.0, float(SMALL_AREA)
        if how.exact:
            kept_radius, small_area = EXACT_KEPT_RADIUS, math.inf
        elif exposure.subpixels >= FINE_SUBPIXELS:
            kept_radius, small_area = FINE_KEPT_RADIUS, SMALL_AREA * exposure.subpixels**2
        finest = aperture_behind(exposure.psf).finest
        return Fineness(max(kept_radius * exposure.subpixels, finest), small_area)

    @functools.cached_property
    def samples(self) -> PointSamples:
        """The samples that are looked at."""
        samples = self.exposure.samples
        # What moves uncovers what is hidden, also before a pinhole.
        is_closed = self.exposure.blur.radius_per_vergence == 0
        return samples.visible() if is_closed and not samples.moves else samples

    @property
    def radius_per_vergence(self) -> float:
        """Radius of the circle, in subpixels per unit of vergence, of the lens that looks."""
        radius = self.exposure.blur.radius_per_vergence
        if radius == 0:
            return CLOSED_RADIUS
        if self._how.exact:
            return radius
        step = math.log1p(2 * SIMILAR_RADIUS)
        return math.exp(round(math.log(radius) / step) * step)

    @functools.cached_property
    def lens_points(self) -> LensPoints:
        """The points of the lens."""
        return self.points_of(aperture_behind(self.exposure.psf))

    def points_of(self, aperture: Aperture) -> LensPoints:
        """As many points of the lens, with another aperture."""
        exposure, count = self.exposure, self._how.lens_points
        return LensPoints.of(aperture, exposure.lens, self.samples, count, exposure.subpixels)

    @property
    def diffracts(self) -> bool:
        """Whether light diffracts at the aperture."""
        return aperture_behind(self.exposure.psf).diffracts

    @property
    def degree(self) -> int:
        """The degree of the moments that the film asks for."""
        return 0 if self.diffracts else self.exposure.degree

    @property
    def detail_degree(self) -> int:
        """The degree of the moments that tell the detail of fragments."""
        if self.exposure.choices is not None:
            return self.exposure.choices.detail_degree
        # Another filter than a box asks for the places of light itself, before it is spread.
        is_needed = not self.diffracts and self.degree == 0
        return detail_degree(self.samples, self.exposure.subpixels) if is_needed else 0

    @property
    def _about(self) -> tuple[object, ...]:
        exposure = self.exposure
        radius, diffracts, degree = self.radius_per_vergence, self.diffracts, self.degree
        return (jit.name(), exposure.subpixels, exposure.alpha, radius, diffracts, degree)

    def evened(self) -> Evened:
        """The fragments of the samples, evened; nothing may move."""
        return self.memo.get(("fragments", self._about), self._evened)

    def _evened(self) -> Evened:
        exposure, chosen = self.exposure, self.exposure.choices
        gathered = gather_with_known(
            self.samples,
            exposure.subpixels,
            self.radius_per_vergence,
            exposure.alpha,
            self.degree,
            None if chosen is None else chosen.bins,
            self.detail_degree,
            None if chosen is None else chosen.window,
            None if chosen is None else chosen.has_known,
        )
        if self.samples.window.size * exposure.subpixels**2 > MOST_KEPT:
            dr.flush_malloc_cache()
        is_even = None if chosen is None else chosen.is_even
        found = evened(gathered.fragments, exposure.subpixels, gathered.detail, is_even)
        found = found._replace(seen=gathered.seen)
        return found._replace(fragments=self._located(found.fragments)) if self.diffracts else found

    def _located(self, fragments: Fragments) -> Fragments:
        """Fragments with their offsets."""
        chosen = self.exposure.choices
        window = None if chosen is None else chosen.window
        return with_offsets(fragments, self.samples, self.exposure.subpixels, window)

    def pyramid(self) -> ViewPyramid:
        """What the lens sees."""
        return self.memo.get(("view", self._about, self.lens_points), self._pyramid)

    def _pyramid(self) -> ViewPyramid:
        exposure, radius = self.exposure, self.radius_per_vergence
        subpixels, single_points = exposure.subpixels, not self.diffracts
        if self.samples.moves:
            return view_of_exposure(
                self.samples, subpixels, radius, exposure.alpha, self.lens_points, single_points
            )
        found = self.evened()
        seen = found.seen
        if seen is not None:
            seen = self.lens_points.nearest(seen, self.samples, radius, subpixels)
        limits = None if exposure.choices is None else exposure.choices.limits
        view = LensView.of(
            found.fragments,
            radius,
            self.lens_points,
            single_points,
            self._located,
            seen,
            limits,
            exposure.lit,
        )
        return ViewPyramid(view, found.density, found.moments, found.detail)
