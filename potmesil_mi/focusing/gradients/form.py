"""The picture through the lens where something has gradients: it is attached to these."""

from __future__ import annotations

import math

import drjit as dr

from ... import _backend as jit
from ...optics.aperture import Aperture
from ...optics.attached import DifferentiableAperture
from ...optics.blur import Blur
from ...optics.image_aperture import ImageAperture
from ...optics.lens import ThinLens
from ...optics.psf import PointSpreadFunction, aperture_behind
from ...samples.raster import Window
from ..exposure import Exposure, Visibility
from ..film import (
    FinePicture,
    ReconstructionFilter,
    interleaved,
    places_of_crop,
    reconstruct_channels,
)
from ..fragments import gathered
from ..layered import cropped
from ..memo import Memo
from ..viewing import Viewing
from .composite import Spread, composite
from .gathering import gather
from .opening import Opening
from .opening_of_numbers import OpeningOfNumbers
from .opening_of_picture import OpeningOfPicture
from .slices import SmoothSlice, plan
from .splat import splat
from .spread import light_of
from .view import Light, SmoothView

BINS_AN_OCTAVE = 2
"""Widths of bins from one to twice that: samples are gathered anew for each."""


def form(
    exposure: Exposure,
    memo: Memo,
    how: Visibility,
    lens: ThinLens,
    psf: PointSpreadFunction,
    rfilter: ReconstructionFilter | None,
) -> jit.TensorXf:
    """The picture (h, w, 3 or 4) of the crop window, attached to all that has gradients.

    ``lens`` and ``psf`` are those of the ``exposure``, with their gradients.
    """
    viewing, opening = Viewing(exposure, memo, how), _opening(psf)
    samples, subpixels = viewing.samples, exposure.subpixels
    view = _view(viewing, opening.seen_from)
    plain = exposure.blur
    in_subpixels = samples.camera.focal_length_pixels * subpixels
    blur = Blur(jit.Float(lens.aperture_radius * in_subpixels), jit.Float(1 / lens.focus_distance))
    # Numbers of the user's would be compiled into each kernel.
    dr.make_opaque(blur.radius_per_vergence, blur.focused_vergence)
    light = view.light(samples, subpixels)
    seen = _seen(view, light, blur, opening.weights(len(view.points)))
    slices = plan(
        view,
        exposure.lens,
        opening,
        plain,
        exposure.subpixels_per_mm,
        viewing.fineness,
    )
    spread = [_spread(view, light, seen, blur, plain, each) for each in slices]
    density = view.gathering.density
    crop = exposure.crop
    its_gradient = None
    if light.density is not None:
        fragments = view.gathering.fragments
        window = Window(0, 0, fragments.width, fragments.height)
        its_gradient = gathered(jit.Float, light.density, *places_of_crop(crop, window))
    found = composite(
        spread, crop, subpixels, None if density is None else cropped(density, crop), its_gradient
    )
    shape = (*crop.shape, len(found.channels))
    fine = FinePicture(
        jit.TensorXf(interleaved(found.channels), shape), jit.TensorXf(found.weights, crop.shape)
    )
    pixels = reconstruct_channels(fine, subpixels, rfilter)
    size = crop.height // subpixels, crop.width // subpixels, len(pixels)
    return jit.TensorXf(interleaved(pixels), size)


def _opening(psf: PointSpreadFunction) -> Opening:
    """The opening that ``psf`` is, attached to what has gradients of it."""
    if isinstance(psf, DifferentiableAperture) and psf.attached:
        return OpeningOfPicture(psf) if isinstance(psf, ImageAperture) else OpeningOfNumbers(psf)
    return Opening(psf, aperture_behind(psf))


def _view(viewing: Viewing, aperture: Aperture) -> SmoothView:
    """What the lens sees from the points of an aperture: known from before, or found out now."""
    exposure, radius = viewing.exposure, viewing.radius_per_vergence
    samples, subpixels, alpha = viewing.samples, exposure.subpixels, exposure.alpha
    # Bins that changed with each aperture would join other samples, and part other surfaces.
    of_bins = 2 ** (math.ceil(math.log2(radius) * BINS_AN_OCTAVE) / BINS_AN_OCTAVE)
    points = viewing.points_of(aperture)
    about = ("smooth", jit.name(), subpixels, alpha, of_bins)
    gathering = viewing.memo.get(about, lambda: gather(samples, subpixels, of_bins, alpha))
    return viewing.memo.get(
        (*about, radius, points),
        lambda: SmoothView.of(gathering, samples, subpixels, radius, points),
    )


def _seen(view: SmoothView, light: Light, blur: Blur, weights: jit.Float | None) -> jit.Float:
    """What each lens point shows of each occluded fragment, lane by lane.

    That is what it sees, 0 to 1, times what it counts, if the points have ``weights``.
    """
    if view.seen.size == 0:
        return jit.Float()
    seen = jit.Float(jit.from_numpy(jit.UInt8, view.seen.ravel())) / 255
    edges = view.edges
    if dr.width(edges.lane) > 0:
        parallax = edges.parallax(light.vergence, blur.radius_per_vergence)
        dr.eval(seen)
        moved = (parallax - view.parallax) * edges.along
        dr.scatter_add(seen, moved, edges.lane, mode=dr.ReduceMode.Direct)
    if weights is None:
        return seen
    point = dr.arange(jit.UInt32, view.seen.size) % dr.opaque(jit.UInt32, len(view.points))
    return seen * dr.gather(jit.Float, weights, point)


def _spread(
    view: SmoothView, light: Light, seen: jit.Float, blur: Blur, plain: Blur, each: SmoothSlice
) -> Spread:
    """The light of a slice."""
    parts = [light_of(images) for images in splat(view, light, seen, blur, plain, each)]
    colours = parts[0][0] if len(parts) == 1 else parts[0][0] + parts[1][0]
    alpha = parts[0][1]
    if alpha is not None and len(parts) > 1:
        alpha = alpha + parts[1][1]
    return Spread(colours, alpha, each.box, each.resolution, each.is_sharp)
