"""Splatting with gradients: the light of fragments in images of circles and of lens points' cells.

Where light goes, and between which two circles, is found without gradients; the weights have them.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import drjit as dr
import numpy as np

from ... import _backend as jit
from ...optics.blur import Blur
from ..blocks import BLOCK
from ..fragments import Fragments, as_column, gathered
from ..lit import dark, lit_around, mark
from ..small_circles import REACH, shared
from ..splat import ImageStack
from .opening import AttachedKernels
from .slices import SmoothSlice
from .view import Light, SmoothView


class SmoothImages(NamedTuple):
    """Images, and the kernels that are to spread them."""

    stack: ImageStack
    kernels: list[np.ndarray]
    attached_kernels: AttachedKernels | None = None


def splat(
    view: SmoothView, light: Light, seen: jit.Float, blur: Blur, plain: Blur, each: SmoothSlice
) -> list[SmoothImages]:
    """The images of a slice.

    ``blur`` may have gradients, ``plain`` has the same numbers without. ``seen`` is what each lens
    point shows of each occluded fragment, 1 on the average where all see it.
    """
    images = []
    if each.unoccluded.start < each.unoccluded.stop:
        images.append(_splat_circles(view, light, blur, plain, each))
    if each.occluded.start < each.occluded.stop:
        images.append(_splat_points(view, light, seen, blur, plain, each))
    return images


def _before(radii: np.ndarray, circles: np.ndarray) -> np.ndarray:
    """Of each of some radii the number of the last of the ``circles`` not above it, uint32 (N,)."""
    before = np.searchsorted(circles, radii, side="right") - 1
    return np.clip(before, 0, len(circles) - 2).astype(np.uint32)


def _share(radius: jit.Float, before: jit.UInt32, circles: np.ndarray) -> jit.Float:
    """What part of circles is that of the larger one: their area is interpolated."""
    squares = circles**2
    steps = np.append(1 / np.diff(squares), 0)
    first, step = (
        dr.gather(jit.Float, as_column(of.astype(np.float32)), before) for of in (squares, steps)
    )
    return dr.clip((dr.square(radius) - first) * step, 0, 1)


def _splat_circles(
    view: SmoothView, light: Light, blur: Blur, plain: Blur, each: SmoothSlice
) -> SmoothImages:
    """Unoccluded fragments, each in the images of two circles."""
    index = view.unoccluded[each.unoccluded]
    fragments, factor, box = view.gathering.fragments, each.resolution, each.box
    if each.small is not None:
        return _splat_small_circles(fragments, index, light, blur, each, each.small)
    before = _before(np.abs(plain.radius(fragments.vergence[index])), each.circles)
    x, y = (
        _beside(of[index], factor, first)
        for of, first in ((fragments.x, box.left), (fragments.y, box.top))
    )
    lit = dark(len(each.circles), box, BLOCK)
    for (column, _), (row, _) in itertools.product(x, y):
        for beyond in (0, 1):
            mark(lit, before + np.uint32(beyond), column, row, BLOCK)
    channels = 4 if light.alpha is None else 5
    stack = ImageStack(box, channels, 2 * len(x) * len(y) * len(index), lit)
    fragment = jit.from_numpy(jit.UInt32, index)
    kernel = jit.from_numpy(jit.UInt32, before)
    radius = blur.radius(gathered(jit.Float, light.vergence, fragment))
    share = _share(radius, kernel, each.circles)
    values = gathered(jit.Array4f, light.values, fragment)
    alpha = None if light.alpha is None else gathered(jit.Float, light.alpha, fragment)
    for (column, across), (row, down) in itertools.product(x, y):
        place = (jit.from_numpy(jit.Int32, of) for of in (column, row))
        there = list(place)
        part = jit.Float(1)
        if factor > 1:  # Pixels have the density of their light, not its sum.
            part = jit.from_numpy(jit.Float, across * down / factor**2)
        for beyond, of_it in ((0, 1 - share), (1, share)):
            stack.scatter(values, alpha, stack.place(kernel + beyond, *there), of_it * part)
    return SmoothImages(stack, each.kernels, each.attached_kernels)


def _splat_small_circles(
    fragments: Fragments,
    index: np.ndarray,
    light: Light,
    blur: Blur,
    each: SmoothSlice,
    responses: jit.Float,
) -> SmoothImages:
    """Unoccluded fragments in the place of each and around it, spread by their small circles."""
    box, detail = each.box, light.detail
    assert detail is not None
    x, y = fragments.x[index] - box.left, fragments.y[index] - box.top
    lit = dark(1, box, BLOCK)
    for across, down in itertools.product((-REACH, REACH), repeat=2):
        mark(lit, 0, x + across, y + down, BLOCK)
    stack = ImageStack(box, 4 if light.alpha is None else 5, 25 * len(index), lit)
    fragment = jit.from_numpy(jit.UInt32, index)
    column, row = jit.from_numpy(jit.Int32, x), jit.from_numpy(jit.Int32, y)
    radius = blur.radius(gathered(jit.Float, light.vergence, fragment))
    for target, of_it, its_detail, kind in (
        (stack.colours, light.values, detail.colours, jit.Array4f),
        (stack.alpha, light.alpha, detail.alpha, jit.Float),
    ):
        if target is None:
            continue
        values = [gathered(kind, of, fragment) for of in (of_it, *its_detail)]
        for share in shared(values, radius, responses, between=True):
            there = stack.place(jit.UInt32(0), column + share.across, row + share.down)
            dr.scatter_add(target, share.light, there, share.active, mode=stack.mode)
    return SmoothImages(stack, each.kernels)


def _beside(at: np.ndarray, factor: int, first: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """The pixels, ``factor`` subpixels wide, that share subpixels, and what each gets of them.

    Pixels are counted from ``first``.
    """
    if factor == 1:
        return [(at - first, np.ones(len(at), np.float32))]
    place = (at + np.float32(0.5)) / factor - np.float32(0.5)
    before = np.floor(place)
    beyond = place - before
    column = before.astype(np.int32) - first
    return [(column, 1 - beyond), (column + 1, beyond)]


def _splat_points(
    view: SmoothView,
    light: Light,
    seen: jit.Float,
    blur: Blur,
    plain: Blur,
    each: SmoothSlice,
) -> SmoothImages:
    """Occluded fragments: a share for each lens point, in the images of two cells."""
    part, box, factor = each.occluded, each.box, each.resolution
    index, fragments, count = view.occluded[part], view.gathering.fragments, len(view.points)
    before = _before(np.abs(plain.radius(fragments.vergence[index])), each.cells)
    lane = dr.arange(jit.UInt32, len(index) * count)
    row = lane // dr.opaque(jit.UInt32, count)
    point = lane - row * dr.opaque(jit.UInt32, count)
    of_row = jit.from_numpy(jit.UInt32, index)
    kernel_of_row = jit.from_numpy(jit.UInt32, before)
    radius_of_row = blur.radius(gathered(jit.Float, light.vergence, of_row))
    share_of_row = _share(radius_of_row, kernel_of_row, each.cells)
    dr.eval(radius_of_row, share_of_row)
    fragment, kernel = (dr.gather(jit.UInt32, of, row) for of in (of_row, kernel_of_row))
    radius, share = (gathered(jit.Float, of, row) for of in (radius_of_row, share_of_row))
    own = dr.opaque(jit.Float, 1 / factor)
    places = []
    for of, lens, first in (
        (fragments.x[index], view.points[:, 0], box.left),
        (fragments.y[index], view.points[:, 1], box.top),
    ):
        middle = jit.from_numpy(jit.Float, of + np.float32(0.5))
        u = dr.gather(jit.Float, as_column(lens.astype(np.float32)), point)
        at = dr.fma(radius, u, dr.gather(jit.Float, middle, row)) * own - 0.5
        at -= dr.opaque(jit.Float, first)
        before_it = dr.floor(dr.detach(at))
        places.append((jit.Int32(before_it), at - before_it))
    (column, across), (line, down) = places
    lit = _lit_by_points(view, plain, each, index, before)
    stack = ImageStack(box, 4 if light.alpha is None else 5, 8 * len(index) * count, lit)
    lanes = dr.arange(jit.UInt32, len(index) * count) + dr.opaque(jit.UInt32, part.start * count)
    times = gathered(jit.Float, seen, lanes) * (own * own * dr.opaque(jit.Float, 1 / count))
    values = gathered(jit.Array4f, light.values, fragment)
    alpha = None if light.alpha is None else gathered(jit.Float, light.alpha, fragment)
    for (dx, x_share), (dy, y_share) in itertools.product(
        enumerate((1 - across, across)), enumerate((1 - down, down))
    ):
        for beyond, of_it in ((0, 1 - share), (1, share)):
            place = stack.place(kernel + beyond, column + dx, line + dy)
            stack.scatter(values, alpha, place, of_it * x_share * y_share * times)
    return SmoothImages(stack, each.cell_kernels)


def _lit_by_points(
    view: SmoothView, plain: Blur, each: SmoothSlice, index: np.ndarray, before: np.ndarray
) -> np.ndarray:
    """Which blocks of the images of cells may have light, bool (L, h, w)."""
    fragments, factor, box = view.gathering.fragments, each.resolution, each.box
    radii = np.abs(plain.radius(fragments.vergence[index])) / factor
    x, y = (
        of[index] // factor - first
        for of, first in ((fragments.x, box.left), (fragments.y, box.top))
    )
    reach = float(np.hypot(*view.points.T).max())
    lit = dark(len(each.cells), box, BLOCK)
    for first in range(len(each.cells) - 1):
        here = before == first
        if here.any():
            lit[first] |= lit_around(x[here], y[here], box, reach * float(radii[here].max()))
            lit[first + 1] |= lit[first]
    return lit
