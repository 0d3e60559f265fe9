"""The picture through the lens where something has gradients: it is attached to these."""

from __future__ import annotations

import math

import drjit as dr

from ... import _backend as jit
from ...optics.blur import Blur
from ...optics.lens import ThinLens
from ...optics.psf import aperture_behind
from ...samples.raster import Window
from ..exposure import Exposure
from ..film import (
    FinePicture,
    ReconstructionFilter,
    interleaved,
    reconstruct_channels,
    rows_and_columns,
)
from ..fragments import Fragments, gathered
from ..layered import Visibility, cropped, fineness_of, radius_of_view
from ..lens_points import LensPoints
from ..memo import Memo
from .composite import Spread, composite
from .gathering import gather
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
    rfilter: ReconstructionFilter | None,
) -> jit.TensorXf:
    """The picture (h, w, 3 or 4) of the crop window, attached to all that has gradients.

    ``lens`` is that of the ``exposure``, with its gradients.
    """
    samples, subpixels = exposure.samples, exposure.subpixels
    view = _view(exposure, memo, how)
    plain = exposure.blur
    in_subpixels = samples.camera.focal_length_pixels * subpixels
    blur = Blur(jit.Float(lens.aperture_radius * in_subpixels), jit.Float(1 / lens.focus_distance))
    # Numbers of the user's would be compiled into each kernel.
    dr.make_opaque(blur.radius_per_vergence, blur.focused_vergence)
    light = view.light(samples, subpixels)
    seen = _seen(view, light, blur)
    slices = plan(
        view,
        exposure.lens,
        exposure.psf,
        plain,
        exposure.subpixels_per_mm,
        fineness_of(exposure, how.exact),
    )
    spread = [_spread(view, light, seen, blur, plain, each) for each in slices]
    density = view.gathering.density
    crop = exposure.crop
    its_gradient = None
    if light.density is not None:
        its_gradient = _cropped(light.density, view.gathering.fragments, crop)
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


def _cropped(values: jit.Float, fragments: Fragments, crop: Window) -> jit.Float:
    """The part of an array of the samples' window that is in the crop."""
    row, column = rows_and_columns(dr.arange(jit.UInt32, crop.size), crop.width)
    place = (row + crop.top) * dr.opaque(jit.UInt32, fragments.width) + (column + crop.left)
    return gathered(jit.Float, values, place)


def _view(exposure: Exposure, memo: Memo, how: Visibility) -> SmoothView:
    """What the lens sees: known from before, or found out now."""
    samples, subpixels, alpha = exposure.samples, exposure.subpixels, exposure.alpha
    radius = radius_of_view(exposure, how.exact)
    # Bins that changed with each aperture would join other samples, and part other surfaces.
    of_bins = 2 ** (math.ceil(math.log2(radius) * BINS_AN_OCTAVE) / BINS_AN_OCTAVE)
    aperture = aperture_behind(exposure.psf)
    points = LensPoints.of(aperture, exposure.lens, samples, how.lens_points, subpixels)
    about = ("smooth", jit.name(), subpixels, alpha, of_bins)
    gathering = memo.get(about, lambda: gather(samples, subpixels, of_bins, alpha))
    return memo.get(
        (*about, radius, points),
        lambda: SmoothView.of(gathering, samples, subpixels, radius, points),
    )


def _seen(view: SmoothView, light: Light, blur: Blur) -> jit.Float:
    """What each lens point sees of each occluded fragment, 0 to 1, lane by lane."""
    edges = view.edges
    if view.seen.size == 0:
        return jit.Float()
    seen = jit.Float(jit.from_numpy(jit.UInt8, view.seen.ravel())) / 255

    def parallax(vergence: jit.Float, radius: jit.Float) -> jit.Float:
        own, its = (gathered(jit.Float, vergence, of) for of in (edges.fragment, edges.occluder))
        return radius * (own - its)

    known = parallax(view.plain.vergence, dr.opaque(jit.Float, view.radius_per_vergence))
    moved = parallax(light.vergence, blur.radius_per_vergence) - known
    dr.eval(seen)
    dr.scatter_add(seen, moved * edges.along, edges.lane, mode=dr.ReduceMode.Direct)
    return seen


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
