"""What all samples of a picture say of its tiles, before any is looked at."""

from __future__ import annotations

import functools
import math

import drjit as dr
import numpy as np

from ... import _backend as jit
from ...optics.psf import aperture_behind
from ...samples.point_samples import PointSamples
from ..bands import resolution_of
from ..choices import Choices
from ..density import EVEN, SPARSE_REACH
from ..equation20 import as_seen, table_ends
from ..exposure import Exposure, Visibility
from ..fragments import scatter_mode
from ..gathering import bins_of, depth_of_covers, has_known
from ..highlights import NEIGHBOURHOOD
from ..kernels import MIDDLE, is_plain
from ..lens_points import HIGHLIGHT_POINTS
from ..locating import Raster, located_in, one_subpixel_each, parts_of
from ..memo import Memo
from ..slices import MOVED_REACH
from ..viewing import Viewing

PIXELS_BESIDE = 5
"""Pixels of a slice farther than its circles that light may be: it is shared between two, gathered
from two, interpolated between two, and circles and cells are rounded up."""

BESIDE = NEIGHBOURHOOD // 2 + 2
"""Subpixels around a fragment on which it depends, besides those that parallax moves before it."""


def whole_of_tables(exposure: Exposure) -> Choices:
    """What a picture by equation 20 has chosen, of all samples of the ``exposure``."""
    seen = as_seen(exposure)
    ends = table_ends(seen)
    depths = {float(ends.nearest) or 1.0, float(ends.farthest) or 1.0}
    if exposure.telecentric:
        depths = {1 / depth for depth in depths}
    elif not (seen.samples.z <= ends.last).all() or np.isinf(seen.samples.z).any():
        depths.add(math.inf)
    reach = max(_reach_of_table(exposure, depth) for depth in depths) + BESIDE
    window = exposure.samples.window
    return Choices(window, -(-reach // exposure.subpixels) + 1, tables=ends)


def whole_of_view(exposure: Exposure, how: Visibility) -> Choices:
    """What a picture of what is visible has chosen, as far as its samples alone tell."""
    viewing = Viewing(exposure, Memo(), how)
    samples, subpixels, blur = viewing.samples, exposure.subpixels, exposure.blur
    bins = bins_of(samples, viewing.radius_per_vergence)
    covers = depth_of_covers(samples) if has_known(samples) else samples.z
    ends = bins.vergence_min, 1 / float(min(samples.z.min(), covers.min()))
    radii = [blur.radius_per_vergence * abs(end - blur.focused_vergence) for end in ends]
    coarsest = resolution_of(max(radii), viewing.fineness.kept_radius)
    light = [math.ceil(_reach_of_light(exposure, how, *of)) for of in zip(radii, ends, strict=True)]
    # Where light diffracts, single points are told from what is beside them in the view.
    beside = BESIDE if viewing.diffracts else 0
    light = [of + (PIXELS_BESIDE + MOVED_REACH) * coarsest + beside for of in light]
    # The points from which highlights are looked at are moved by a little.
    most = 1 + 1 / math.sqrt(HIGHLIGHT_POINTS * how.lens_points)
    parallax = most * viewing.radius_per_vergence * (ends[1] - ends[0])
    densities = _densities(samples, subpixels)
    borrowed = max(subpixels, SPARSE_REACH * (math.sqrt(float(densities.max())) - 1))
    # What is nearest is hidden by nothing; what is farthest may be by what is nearest.
    halo = max(light[0] + parallax, light[1]) + borrowed + BESIDE
    return Choices(
        samples.window,
        math.ceil(halo / subpixels),
        max(light),
        coarsest // math.gcd(coarsest, subpixels),
        bins=bins,
        bin_count=math.ceil((ends[1] - ends[0]) / bins.width) + 1,
        is_even=bool(np.abs(densities - 1).max() < EVEN),
        has_known=has_known(samples),
        detail_degree=viewing.detail_degree,
    )


def _reach_of_light(exposure: Exposure, how: Visibility, radius: float, vergence: float) -> float:
    """How far the light of what has circles of a ``radius`` is from it, in subpixels."""
    # A lens point's light is spread over its cell.
    reach = radius * (1 + math.sqrt(2 / how.lens_points))
    if is_plain(exposure.psf):
        return reach
    at = _reach_of_table(exposure, 1 / vergence if vergence > 0 else math.inf)
    if aperture_behind(exposure.psf).diffracts:
        at += _reach_of_table(exposure, float(exposure.lens.focus_distance))
    return max(reach, at)


def _reach_of_table(exposure: Exposure, depth: float) -> int:
    """How far the point-spread function of what is at a ``depth`` reaches, in subpixels."""
    window = exposure.samples.window.subdivided(exposure.subpixels)
    largest = window.width + 2, window.height + 2
    per_mm = exposure.subpixels_per_mm
    table = exposure.psf.table(exposure.lens, depth, per_mm, np.array(MIDDLE), largest)
    return max(table.shape) // 2


def _densities(samples: PointSamples, subpixels: int) -> np.ndarray:
    """The share of each subpixel that there is of samples of what the pinhole sees, (N,)."""
    samples = one_subpixel_each(samples, subpixels)
    raster = Raster.of(samples, subpixels)
    located = functools.partial(located_in, samples, subpixels, raster)
    sums, area = dr.zeros(jit.Float, raster.size), dr.opaque(jit.Float, subpixels**2)
    for part, _ in parts_of(len(samples)):
        at, weight = located(part), jit.from_numpy(jit.Float, samples.weight[part])
        dr.scatter_add(sums, weight * area, at.subpixel, at.visible, mode=scatter_mode())
        dr.eval(sums)
    return np.array(sums)
