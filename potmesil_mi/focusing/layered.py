"""The picture through the lens with what hides what: the methods ``layered`` and ``lightfield``.

Samples are gathered to fragments; what the points of the lens see of them is found, and kept for
the next focus. A focus is then planned in slices of depth, and for each from near to far light is
splatted, convolved and composited.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import drjit as dr
import numpy as np

from .. import _backend as jit
from .._progress import track
from ..optics.blur import Blur
from ..optics.psf import aperture_behind
from ..samples.raster import Window
from .composite import Compositor, SpreadSlice
from .convolve import spread
from .density import Evened, evened
from .detail import detail_degree
from .exposure import FINE_SUBPIXELS, Exposure
from .exposure_view import view_of_exposure
from .film import FinePicture
from .fragments import Fragments
from .gathering import gather_with_known, with_offsets
from .lens_points import LensPoints
from .lens_view import LensView, ViewPyramid
from .memo import Memo
from .reach import within_reach
from .slices import DepthSlice, Fineness, plan
from .splat import SliceImages, splat

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


class Visibility(NamedTuple):
    """From how many points of the lens visibility is found, and whether of exactly that lens.

    Otherwise that of a lens with a similar aperture will do.
    """

    lens_points: int
    exact: bool


def form(exposure: Exposure, memo: Memo, how: Visibility) -> FinePicture:
    """The picture of the crop window on subpixels, (height, width, 3 or 4).

    Subpixels that no light reaches are 0. What each counts in its pixel is how densely it was
    sampled, 1 on the average.
    """
    of_pixels = Blur.of(exposure.lens, exposure.samples.camera)
    samples, memo = within_reach(exposure.samples, of_pixels, memo)
    exposure = dataclasses.replace(exposure, samples=samples)
    fineness = fineness_of(exposure, how.exact)
    views = _views(exposure, memo, how)
    channels = views.finest.unoccluded.values.shape[1]
    groups = plan(
        views, exposure.lens, exposure.psf, exposure.blur, exposure.subpixels_per_mm, fineness
    )
    density, moments = (
        None if of is None else cropped(of, exposure.crop) for of in (views.density, views.moments)
    )
    compositor = Compositor(exposure.crop, channels, exposure.subpixels, density, moments)
    begun: list[tuple[DepthSlice, SliceImages]] = []
    for group in track(groups, "Focusing"):
        images = [(each, splat(each, channels)) for each in group]
        # While Dr.Jit makes the images of this group, those of the group before it are spread.
        compositor.put_behind([_light_of(*each) for each in begun])
        begun = images
    compositor.put_behind([_light_of(*each) for each in begun])
    return compositor.finished()


def fineness_of(exposure: Exposure, exact: bool) -> Fineness:
    """How finely the circles of an exposure are spread."""
    kept_radius, small_area = 0.0, float(SMALL_AREA)
    if exact:
        kept_radius, small_area = EXACT_KEPT_RADIUS, math.inf
    elif exposure.subpixels >= FINE_SUBPIXELS:
        kept_radius, small_area = FINE_KEPT_RADIUS, SMALL_AREA * exposure.subpixels**2
    finest = aperture_behind(exposure.psf).finest
    return Fineness(max(kept_radius * exposure.subpixels, finest), small_area)


def radius_of_view(exposure: Exposure, exact: bool) -> float:
    """Radius of circles, in subpixels per unit of vergence, of the lens that is looked through.

    Unless that is to be ``exact``, it is the nearest of some fixed ones.
    """
    radius = exposure.blur.radius_per_vergence
    if radius == 0:
        return CLOSED_RADIUS
    if exact:
        return radius
    step = math.log1p(2 * SIMILAR_RADIUS)
    return math.exp(round(math.log(radius) / step) * step)


def cropped(array: np.ndarray, crop: Window) -> np.ndarray:
    """The part of an array of the samples' window that is in the crop; 0 where it is beyond."""
    window = Window(0, 0, *array.shape[1::-1])
    cropped = np.zeros((*crop.shape, *array.shape[2:]), array.dtype)
    shared = crop.intersection(window)
    cropped[shared.slices_in(crop)] = array[shared.slices_in(window)]
    return cropped


def _views(exposure: Exposure, memo: Memo, how: Visibility) -> ViewPyramid:
    """What the lens sees of the samples: known from before, or found out now."""
    samples, subpixels, alpha = exposure.samples, exposure.subpixels, exposure.alpha
    aperture = aperture_behind(exposure.psf)
    radius = radius_of_view(exposure, how.exact)
    if exposure.blur.radius_per_vergence == 0 and not samples.moves:
        # What moves uncovers what is hidden, also before a pinhole.
        samples = samples.visible()
    lens_points = LensPoints.of(aperture, exposure.lens, samples, how.lens_points, subpixels)
    diffracts = aperture.diffracts
    degree = 0 if diffracts else exposure.degree
    about = (jit.name(), subpixels, alpha, radius, diffracts, degree)

    def located(fragments: Fragments) -> Fragments:
        return with_offsets(fragments, samples, subpixels)

    def fragments() -> Evened:
        # Another filter than a box asks for the places of light itself, before it is spread.
        detailed = 0 if diffracts or degree > 0 else detail_degree(samples, subpixels)
        gathered = gather_with_known(
            samples, subpixels, radius, alpha, degree, detail_degree=detailed
        )
        if samples.window.size * subpixels**2 > MOST_KEPT:
            dr.flush_malloc_cache()
        found = evened(gathered.fragments, subpixels, gathered.detail)
        found = found._replace(seen=gathered.seen)
        return found._replace(fragments=located(found.fragments)) if diffracts else found

    def views() -> ViewPyramid:
        if samples.moves:
            return view_of_exposure(samples, subpixels, radius, alpha, lens_points, not diffracts)
        found = memo.get(("fragments", about), fragments)
        seen = found.seen
        if seen is not None:
            seen = lens_points.nearest(seen, samples, radius, subpixels)
        view = LensView.of(found.fragments, radius, lens_points, not diffracts, located, seen)
        return ViewPyramid(view, found.density, found.moments, found.detail)

    return memo.get(("view", about, lens_points), views)


def _light_of(depth_slice: DepthSlice, images: SliceImages) -> SpreadSlice:
    """The light of a slice after its images were spread by their kernels and added up."""
    spread_ones = [
        (each.stack.image(index), kernel)
        for each in images.spread
        for index, kernel in enumerate(each.kernels)
    ]
    light = spread(*zip(*spread_ones, strict=True))
    moments = [stack.image(0).dense() for stack in images.moments]
    box, resolution = depth_slice.box, depth_slice.resolution
    is_sharp = depth_slice.octaves[0] == 0
    return SpreadSlice(light, box.left, box.top, resolution, is_sharp, moments)
