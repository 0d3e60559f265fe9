"""Splatting: the light of fragments is scattered into the images of a depth slice.

Light of a fragment whose circle has the signed radius r lands at x + r u for all lens points u
that see it. Unoccluded fragments go into images that kernels of circles close to theirs spread;
of the others each lens point that sees them gets its share where it belongs, to be spread over its
cell of the lens. Each operator is linear in the fragments' values.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import drjit as dr
import numpy as np

from .. import _backend as jit
from ..optics.blur import Blur
from ..samples.raster import Window
from .blocks import BLOCK, BlockImage, numbered
from .detail import NO_DETAIL
from .fragments import FragmentColumns, among_few, as_column, scatter_mode
from .lit import lit_by_circles, lit_by_points
from .moments import degree_with, orders
from .slices import CirclePlan, DepthSlice, PointPlan
from .small_circles import SmallCircles, shared

LEAST_WIDTH = 0.05
"""Width in subpixels of light at the edge of one."""


SIZES_AN_OCTAVE = 2
"""Sizes that images may have, from one power of 2 to the next."""

SIZES_OF_SMALL_CIRCLES = 1
"""The same of those of small circles, whose code is long."""


class ImageStack:
    """Images of the pixels of ``box``, into which light is scattered ``times`` times.

    ``lit``, bool (K, h, w), are the blocks of each that may have light; only these are stored.
    """

    def __init__(
        self,
        box: Window,
        channels: int,
        times: int,
        lit: np.ndarray,
        sizes_an_octave: int = SIZES_AN_OCTAVE,
    ) -> None:
        self.box, self.number = box, numbered(lit)
        size = among_few(np.count_nonzero(lit) + 1, sizes_an_octave) * BLOCK**2
        self.mode = scatter_mode(times / size)
        self.colours = dr.zeros(jit.Float, size * 4)
        self.alpha = dr.zeros(jit.Float, size) if channels > 4 else None
        self._number = jit.from_numpy(jit.UInt32, self.number.ravel())

    def place(
        self, image: jit.UInt32, column: jit.Int32, row: jit.Int32, active: jit.Bool = True
    ) -> jit.UInt32:
        """Where the pixels in the images are stored."""
        _, down, across = self.number.shape
        row, column = jit.UInt32(row), jit.UInt32(column)
        block = image * dr.opaque(jit.UInt32, down) + row // BLOCK
        block = block * dr.opaque(jit.UInt32, across) + column // BLOCK
        number = dr.gather(jit.UInt32, self._number, block, active)
        return (number * BLOCK + row % BLOCK) * BLOCK + column % BLOCK

    def add(
        self,
        columns: FragmentColumns,
        fragment: jit.UInt32,
        place: jit.UInt32,
        share: jit.Float,
        active: jit.Bool = True,
        *,
        only_colours: bool = False,
        term: int = 0,
    ) -> None:
        """Add the ``share`` of fragments' values at the ``place`` where a pixel is stored.

        With ``only_colours`` neither the share of the area nor alpha is added. From ``term`` 1 on
        these are not the values but their moments.
        """
        values, alpha = dr.gather(jit.Array4f, columns.values[term], fragment, active), None
        if only_colours:
            values.w = 0
        elif self.alpha is not None:
            alpha = dr.gather(jit.Float, columns.alpha[term], fragment, active)
        self.scatter(values, alpha, place, share, active)

    def scatter(
        self,
        values: jit.Array4f,
        alpha: jit.Float | None,
        place: jit.UInt32,
        share: jit.Float,
        active: jit.Bool = True,
    ) -> None:
        """Add the ``share`` of RGB and share, and of alpha, at the ``place`` of a stored pixel."""
        dr.scatter_add(self.colours, values * share, place, active, mode=self.mode)
        if self.alpha is not None and alpha is not None:
            dr.scatter_add(self.alpha, alpha * share, place, active, mode=self.mode)

    def start(self) -> None:
        """Have the images made, without waiting for them."""
        dr.eval(self.colours, self.alpha)

    def image(self, index: int) -> BlockImage:
        """One of the images."""
        return BlockImage(self.box.shape, self.number[index], self._on_host)

    @functools.cached_property
    def _on_host(self) -> list[np.ndarray]:
        """The blocks of all images, RGB and share of each pixel, and their alpha, if any."""
        return self.stored([part for part in (self.colours, self.alpha) if part is not None])

    def stored(self, parts: Sequence[jit.Float]) -> list[np.ndarray]:
        """The blocks of values that are stored as ``colours`` are, and as ``alpha`` is, if any."""
        size = self.colours.shape[0] // 4
        return [np.asarray(part).reshape(-1, BLOCK, BLOCK, len(part) // size) for part in parts]

    @property
    def block_count(self) -> int:
        """How many blocks are stored."""
        return self.colours.shape[0] // (4 * BLOCK**2)


class KernelImages(NamedTuple):
    """The first images of a stack, and the kernels that are to spread them."""

    stack: ImageStack
    kernels: list[np.ndarray]


class SliceImages(NamedTuple):
    """The images of a slice; those of its ``moments``, one stack for each, are not spread."""

    spread: list[KernelImages]
    moments: list[ImageStack]


def splat(depth_slice: DepthSlice, channels: int) -> SliceImages:
    """The images of a slice, whose making is begun and not waited for."""
    images = []
    if depth_slice.circles.part.start < depth_slice.circles.part.stop:
        images.append(_splat_circles(depth_slice, depth_slice.circles, channels))
    moments = _splat_moments(depth_slice, channels)
    images += [_splat_points(depth_slice, each, channels, moments) for each in depth_slice.points]
    for stack in moments:
        stack.start()
    return SliceImages(images, moments)


def _splat_moments(depth_slice: DepthSlice, channels: int) -> list[ImageStack]:
    """The moments of the fragments of a slice, whose circles are hardly larger than a pixel.

    They stay where they are: spreading light by something symmetric leaves its middle in place.
    Those of fragments that have an offset are left out.
    """
    circles, box = depth_slice.circles, depth_slice.box
    kinds = [(circles.fragments.on_device, circles.part, None)]
    for each in depth_slice.points:
        on_device = each.occluded.on_device
        kinds.append((on_device.fragments, each.part, on_device.seen_sum))
    times = sum(part.stop - part.start for _, part, _ in kinds)
    every = np.ones((1, *(-(-size // BLOCK) for size in box.shape)), bool)
    stacks = [ImageStack(box, channels, times, every) for _ in range(depth_slice.moments)]
    for columns, part, seen in kinds:
        if not stacks or part.start == part.stop or columns.offset is not None:
            continue
        fragment = dr.arange(jit.UInt32, part.stop - part.start)
        fragment += dr.opaque(jit.UInt32, part.start)
        share = jit.Float(1) if seen is None else dr.gather(jit.Float, seen, fragment)
        column, row = _column_and_row(columns, fragment, box)
        for term, stack in enumerate(stacks, 1):
            place = stack.place(jit.UInt32(0), column, row)
            stack.add(columns, fragment, place, share, term=term)
    return stacks


def _splat_circles(depth_slice: DepthSlice, circles: CirclePlan, channels: int) -> KernelImages:
    """Unoccluded fragments in images of the kernel radii around theirs."""
    columns, part, box = circles.fragments.on_device, circles.part, depth_slice.box
    count = part.stop - part.start
    sizes = SIZES_AN_OCTAVE if circles.small is None else SIZES_OF_SMALL_CIRCLES
    stack = ImageStack(box, channels, 2 * count, lit_by_circles(circles, box), sizes)
    fragment = dr.arange(jit.UInt32, count)
    fragment += dr.opaque(jit.UInt32, part.start)
    column, row = _column_and_row(columns, fragment, box)
    if circles.small is not None:
        radius = _radius(columns, fragment, depth_slice.blur)
        _splat_small_circles(stack, columns, circles.small, fragment, (column, row), radius)
        stack.start()
        return KernelImages(stack, circles.kernels)
    kernel, share = _between_kernels(columns, fragment, circles, depth_slice.blur)
    stack.add(columns, fragment, stack.place(kernel, column, row), 1 - share)
    if len(circles.kernels) > 1:
        beyond = stack.place(kernel + 1, column, row)
        stack.add(columns, fragment, beyond, share, share > 0)
    if len(circles.single_points):
        chosen = jit.from_numpy(jit.UInt32, circles.single_points - part.start)
        fragment, column, row, kernel, share = (
            dr.gather(type(of), of, chosen) for of in (fragment, column, row, kernel, share)
        )
        for across, down, moved in _moved(circles):
            for beyond, of_it in ((0, 1 - share), (1, share)):
                there = stack.place(kernel + beyond, column + across, row + down, of_it > 0)
                stack.add(columns, fragment, there, moved * of_it, of_it > 0, only_colours=True)
    stack.start()
    return KernelImages(stack, circles.kernels)


def _splat_small_circles(
    stack: ImageStack,
    columns: FragmentColumns,
    small: SmallCircles,
    fragment: jit.UInt32,
    place: tuple[jit.Int32, jit.Int32],
    radius: jit.Float,
) -> None:
    """Unoccluded fragments in the ``place`` of each and around it, spread by their small circles.

    ``radius`` is signed, in subpixels.
    """
    assert columns.detail is not None
    table_row = dr.gather(jit.Int32, columns.detail, fragment)
    known, table_row = table_row != NO_DETAIL, jit.UInt32(table_row)
    column, row = place
    table = as_column(small.responses)
    for target, of_it, its_detail, kind in (
        (stack.colours, columns.values[:1], small.detail.colours, jit.Array4f),
        (stack.alpha, columns.alpha[:1], small.detail.alpha, jit.Float),
    ):
        light = [dr.gather(kind, of, fragment) for of in of_it]
        light += [dr.gather(kind, of, table_row, known) for of in its_detail]
        for share in shared(light, radius, table) if light else ():
            beside = column + share.across, row + share.down
            there = stack.place(jit.UInt32(0), *beside, share.active)
            dr.scatter_add(target, share.light, there, share.active, mode=stack.mode)


def _between_kernels(
    columns: FragmentColumns, fragment: jit.UInt32, circles: CirclePlan, blur: Blur
) -> tuple[jit.UInt32, jit.Float]:
    """The kernel before the circles of fragments, and the share of the one beyond.

    Between kernels the area of the circle is interpolated, and so the variance of the blur.
    """
    squares = circles.kernel_radii**2
    steps = 1 / np.diff(squares, append=np.inf)
    bin_ = dr.gather(jit.UInt32, columns.bin, fragment) - dr.opaque(jit.UInt32, circles.first_bin)
    kernel = dr.gather(jit.UInt32, jit.from_numpy(jit.UInt32, circles.kernel_of_bin), bin_)
    first, step = (
        dr.gather(jit.Float, jit.from_numpy(jit.Float, of), kernel) for of in (squares, steps)
    )
    radius = _radius(columns, fragment, blur)
    return kernel, dr.clip((dr.square(radius) - first) * step, 0, 1)


def _moved(circles: CirclePlan) -> Iterator[tuple[int, int, jit.Float]]:
    """What moves single points from the middles of their pixels to where they are in them.

    Yields steps across and down to pixels around, and what these get, less what is there: the
    weights with which a pattern is interpolated between ``2 moved_reach + 1`` pixels, by
    polynomials of that degree less one, or linearly for 1, as narrow patterns must be.
    """
    assert circles.fragments.offset is not None
    offset, reach = circles.fragments.offset[circles.single_points], circles.moved_reach
    nodes = np.arange(-reach, reach + 1)
    if reach == 1:
        weights = [np.maximum(1 - np.abs(offset - k), 0) for k in nodes]
    else:
        weights = [
            np.prod([(offset - j) / (k - j) for j in nodes if j != k], axis=0) for k in nodes
        ]
    for (dx, x), (dy, y) in itertools.product(zip(nodes, weights, strict=True), repeat=2):
        share = x[:, 0] * y[:, 1] - (dx == 0 and dy == 0)
        yield int(dx), int(dy), jit.from_numpy(jit.Float, share)


def _splat_points(
    depth_slice: DepthSlice, points: PointPlan, channels: int, moments: list[ImageStack]
) -> KernelImages:
    """Occluded fragments in images of the octaves of their circles, a share for each lens point.

    The ``moments`` of what lens points make of fragments with an offset are added to these.
    """
    occluded, part, box = points.occluded, points.part, depth_slice.box
    on_device, count = occluded.on_device, occluded.count
    columns = on_device.fragments
    lanes = (part.stop - part.start) * count
    stack = ImageStack(box, channels, 4 * lanes, lit_by_points(depth_slice, points))
    lane = dr.arange(jit.UInt32, lanes)
    fragment = lane // dr.opaque(jit.UInt32, count)
    point = lane - fragment * dr.opaque(jit.UInt32, count)
    fragment += dr.opaque(jit.UInt32, part.start)
    lane += dr.opaque(jit.UInt32, part.start * count)
    seen = jit.Float(dr.gather(jit.UInt8, on_device.seen, lane))
    radius, along = _radius(columns, fragment, depth_slice.blur), [jit.Float(0)] * 2
    if columns.motion is not None and on_device.time is not None:
        time = dr.gather(jit.Float, on_device.time, point)
        *along, deeper = (dr.gather(jit.Float, of, fragment) * time for of in columns.motion)
        radius = dr.fma(deeper, dr.opaque(jit.Float, depth_slice.blur.radius_per_vergence), radius)
    look = point
    if columns.instant is not None:
        look = look + dr.gather(jit.UInt32, columns.instant, fragment) * dr.opaque(
            jit.UInt32, count
        )
    u, v = (dr.gather(jit.Float, column, look) for column in (on_device.u, on_device.v))
    if occluded.jitter is not None:
        if depth_slice.resolution > 1:
            radius = _without_cell(radius, points.cell, depth_slice.smeared)
        u, v = occluded.jitter.moved(u, v, point, fragment)
    # From the middle of the fragment's subpixel, in pixels; there it is the middle again.
    own = dr.opaque(jit.Float, 1 / points.pixel)
    offset, wide = _offset(columns, fragment, depth_slice)
    x, y = (
        dr.fma(jit.Float(dr.gather(jit.Int32, column, fragment)) + 0.5 + moved, own, -0.5)
        - dr.opaque(jit.Float, first)
        + radius * lens
        for column, moved, first, lens in (
            (columns.x, offset[0] + along[0], box.left, u),
            (columns.y, offset[1] + along[1], box.top, v),
        )
    )
    x0, y0 = dr.floor(x), dr.floor(y)
    column, row = jit.Int32(x0), jit.Int32(y0)
    octave = jit.UInt32(0)
    for edge in depth_slice.octaves[1 : len(points.kernels)]:
        octave += dr.select(dr.abs(radius) >= dr.opaque(jit.Float, edge), 1, 0)
    seen *= own * own
    added = orders(degree_with(len(moments))) if columns.offset is not None else []
    for across, down in itertools.product(_parts(x - x0, wide[0]), _parts(y - y0, wide[1])):
        beside = column + across.step, row + down.step
        share = across.share * down.share * seen
        stack.add(columns, fragment, stack.place(octave, *beside, seen > 0), share, seen > 0)
        for (i, j), moment in zip(added, moments, strict=False):
            there = share * across.means[i] * down.means[j]
            place = moment.place(jit.UInt32(0), *beside, seen > 0)
            moment.add(columns, fragment, place, there, seen > 0)
    stack.start()
    return KernelImages(stack, points.kernels)


class _Part(NamedTuple):
    """The part of something that falls into one of two pixels beside each other.

    ``step`` is 0 or 1, ``share`` how much of it there is, and ``means`` are those of the Legendre
    polynomials of order 0 to 2 over it.
    """

    step: int
    share: jit.Float
    means: tuple[jit.Float, jit.Float, jit.Float]


def _parts(middle: jit.Float, wide: jit.Float) -> list[_Part]:
    """The parts of what is ``wide``, up to a pixel, around ``middle``, from 0 to 1.

    It is counted from the middle of the first pixel.
    """
    begin, end = middle - wide / 2, middle + wide / 2
    parts = []
    for step, first, last in (
        (0, begin, dr.minimum(end, 0.5)),
        (1, dr.maximum(begin, 0.5), end),
    ):
        share = dr.maximum(last - first, 0) / wide
        a, b = 2 * (first - step), 2 * (last - step)
        means = (jit.Float(1), (a + b) / 2, (a * a + a * b + b * b - 1) / 2)
        parts.append(_Part(step, share, means))
    return parts


def _offset(
    columns: FragmentColumns, fragment: jit.UInt32, depth_slice: DepthSlice
) -> tuple[list[jit.Float], list[jit.Float]]:
    """Where in a subpixel its light is, across and down, and how wide it is; in subpixels.

    What is off the middle does not fill the subpixel: it reaches to its nearer edge.
    """
    if columns.offset is None:
        return [jit.Float(0)] * 2, [jit.Float(1)] * 2
    offset = [dr.gather(jit.Float, of, fragment) for of in columns.offset]
    if depth_slice.resolution > 1:
        return offset, [jit.Float(1)] * 2
    return offset, [dr.maximum(1 - 2 * dr.abs(of), LEAST_WIDTH) for of in offset]


def _without_cell(radius: jit.Float, cell: float, smeared: float) -> jit.Float:
    """Signed radii that, with what coarse pixels and cells add, give discs of the right size."""
    added = dr.opaque(jit.Float, 4 * smeared)
    square = dr.fma(dr.square(radius), dr.opaque(jit.Float, 1 - cell**2), -added)
    return dr.copysign(dr.sqrt(dr.maximum(square, 0)), radius)


def _radius(columns: FragmentColumns, fragment: jit.UInt32, blur: Blur) -> jit.Float:
    """Signed radius of the circles of confusion in pixels."""
    vergence = dr.gather(jit.Float, columns.vergence, fragment)
    return dr.fma(
        vergence,
        dr.opaque(jit.Float, blur.radius_per_vergence),
        dr.opaque(jit.Float, -blur.radius_per_vergence * blur.focused_vergence),
    )


def _column_and_row(
    columns: FragmentColumns, fragment: jit.UInt32, box: Window
) -> tuple[jit.Int32, jit.Int32]:
    """Column and row of fragments' pixels in an image of ``box``."""
    column = dr.gather(jit.Int32, columns.x, fragment) - dr.opaque(jit.Int32, box.left)
    row = dr.gather(jit.Int32, columns.y, fragment) - dr.opaque(jit.Int32, box.top)
    return column, row
