"""How elements seen through a lens become a picture.

Light of an element at signed circle radius c lands at x + c u for all lens points u that see it.
Elements that the whole lens sees are spread by tables of the point-spread function at circles
close to theirs; for the others each lens point that sees them puts its share where it belongs,
spread over its cell of the lens.

Elements are formed into a picture in groups of similar circles, from the nearest to the farthest,
and a group gets no more of a square than those before it have left. Within a group tables and
squares get coarser as the circles grow, so that the cost does not grow with their area.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
import os
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import scipy.fft
import scipy.signal

from .._progress import track
from ..optics.lens import ThinLens
from ..optics.psf import Aperture, PointSpreadFunction, aperture_behind
from .fragments import BIN, SHARE, scatter_mode
from .kernels import LINEAR, MIDDLE, SQUARE, cell_table, circle_table, without
from .lens_view import Layers, Partial

MOVED = 3
"""Squares on each side among which a spot is shared to be in its place."""

NARROW = 0.1
"""Share of the light in one square from which on a pattern is too narrow for polynomials."""

GROUPS = 4.0 ** np.arange(12)
"""Radii between which circles are one group; up to the first they are of both signs."""

BRIGHT_FINEST = 5
"""So many times as many squares a radius there are for bright elements."""

CELL, BRIGHT_CELL = 1.0, 1.7
"""Over what a lens point's share is spread, in radii of a disc of its part of the lens: single
bright elements show gaps between points, of the others edges do."""

PARTING = math.sqrt(2)
"""By so much at most groups are parted at a smaller or larger radius."""

APART = math.sqrt(2)
"""Ratio, at most, of radii that have a table, if there are circles between them."""

SMALL_APART = 1.25
"""The same in small parts of the window, where more tables cost little."""

ALIKE = 0.06
"""Radii that differ by no more than this part of them, or by ``BIN``, have one table."""

BETWEEN = 0.6
"""Which part of the largest radius has a table too where circles are of both signs."""

PATTERNS_APART = 2 ** (1 / 8)
"""The same where the pattern changes with the circle."""

FAINTEST = 1e-5
"""Share of a square below which nothing is told from the rounding of the transforms."""

ROWS = 32
"""Rows of a picture that are worked on at once: they stay near the processor."""


def through_lens(
    layers_at: Callable[[int], Layers],
    lens: ThinLens,
    psf: PointSpreadFunction,
    crop: tuple[int, int, int, int],
    scale: float,
    squares_per_mm: float,
    finest: float,
    small: float,
) -> tuple[np.ndarray, np.ndarray]:
    """The picture that ``lens`` forms of layers, float32 (height, width, 3 or 4).

    ``layers_at`` gives the layers on squares so many times as large. ``crop`` is the left, top,
    width and height of the picture in squares of the window, ``scale`` the radius of the circle
    in squares per unit of vergence; circles of a radius of twice ``finest`` squares or more are
    spread on coarser ones. In parts of the window of up to ``small`` squares tables are closer to
    each other. Squares that no light reaches are 0.

    Also returns the light that reaches each square, float32 (height, width), 1 on the average:
    what it counts in its pixel, for chance puts more samples here than there.
    """
    layers = layers_at(1)
    channels = layers.whole.values.shape[1]
    picture = _Picture(crop, channels)
    before: list[_Sheet] = []
    for band in track(list(_bands(layers, lens, scale, finest)), "Focusing"):
        sheets = [
            _Sheet(layers_at(coarse), band, factor, kinds, lens, psf, squares_per_mm, scale, small)
            for coarse, factor, kinds in band.sheets()
        ]
        sheets = [sheet for sheet in sheets if sheet.starts(channels)]
        # While Dr.Jit makes the images of one group, those of the group before it are spread.
        picture.put_behind(before)
        before = sheets
    picture.put_behind(before)
    return picture.finished()


class _Picture:
    """A picture that is formed from the nearest to the farthest.

    ``crop`` is its left, top, width and height in squares of the window.
    """

    def __init__(self, crop: tuple[int, int, int, int], channels: int) -> None:
        self.crop = crop
        # In the column of shares what is covered adds up.
        self.total = np.zeros((crop[3], crop[2], channels), dtype=np.float32)
        self.arrived = np.zeros((crop[3], crop[2]), dtype=np.float32)

    def put_behind(self, sheets: Sequence[_Sheet]) -> None:
        """Put the light of a group's sheets where there is still room for it."""
        parts = [
            _Overlap.of(sheet.spread(), sheet.left, sheet.top, sheet.factor, self.crop)
            for sheet in sheets
        ]
        parts = [part for part in parts if part.width > 0 and part.height > 0]
        if not parts:
            return
        left, top = min(part.left for part in parts), min(part.top for part in parts)
        right = max(part.left + part.width for part in parts)
        bottom = max(part.top + part.height for part in parts)
        for start in range(top, bottom, ROWS):
            end = min(start + ROWS, bottom)
            if len(parts) == 1:
                light = parts[0].rows(start, end)
            else:
                light = np.zeros((end - start, right - left, self.total.shape[-1]), np.float32)
                for part in parts:
                    rows = slice(max(start, part.top), min(end, part.top + part.height))
                    if rows.start < rows.stop:
                        columns = slice(part.left - left, part.left - left + part.width)
                        there = light[rows.start - start : rows.stop - start, columns]
                        there += part.rows(rows.start, rows.stop)
            np.maximum(light, 0, out=light)
            nearer, share = self.total[start:end, left:right], light[..., SHARE]
            self.arrived[start:end, left:right] += share
            admitted = (1 - nearer[..., SHARE]) / np.maximum(share, FAINTEST)
            np.clip(admitted, 0, 1, out=admitted)
            admitted[share <= FAINTEST] = 0
            light *= admitted[..., None]
            nearer += light

    def finished(self) -> tuple[np.ndarray, np.ndarray]:
        """The picture without the column of shares, and the light that reached each square."""
        colours = [i for i in range(self.total.shape[-1]) if i != SHARE]
        picture = np.empty((*self.arrived.shape, len(colours)), dtype=np.float32)
        for start in range(0, len(picture), ROWS):
            rows = slice(start, start + ROWS)
            covered = self.total[rows, :, SHARE]
            lit = covered > FAINTEST
            self.arrived[rows][~lit], covered[~lit] = 0, np.inf
            for to, of in enumerate(colours):
                np.divide(self.total[rows, :, of], covered, out=picture[rows, :, to])
        return picture, self.arrived


@dataclasses.dataclass(frozen=True)
class _Band:
    """Elements of similar circles: of the bins from ``first`` on that come before ``end``.

    ``inner`` and ``outer`` are radii, in squares, between which theirs are; ``inner`` is 0 where
    they are of both signs. They are spread on squares ``factor`` times as large, bright ones, of
    which one sees the edges, on squares ``bright`` times as large.
    """

    first: int
    end: int
    inner: float
    outer: float
    sign: float
    factor: int
    bright: int

    def sheets(self) -> list[tuple[int, int, tuple[bool, bool, bool]]]:
        """Sizes of the squares of layers and of sheets, and which elements are on these.

        Of whole, partial and bright ones; bright ones are the same in all layers.
        """
        if self.bright == self.factor:
            return [(self.factor, self.factor, (True, True, True))]
        return [
            (self.factor, self.factor, (True, True, False)),
            (1, self.bright, (False, False, True)),
        ]


def _bands(layers: Layers, lens: ThinLens, scale: float, finest: float) -> Iterator[_Band]:
    """The bands that have elements, from the nearest.

    Around each of the radii ``GROUPS`` they are parted where there are fewest elements: rather
    between surfaces than in one.
    """
    counts, some = layers.counts, layers.whole
    if scale == 0:
        yield _Band(0, len(counts), 0.0, 0.0, 1.0, 1, 1)
        return
    focused = (1 / float(lens.focus_distance) - some.least) / some.step
    bins = 1 / (scale * some.step)

    def parting(edge: float) -> int:
        """The first bin beyond a signed radius, whole also in the coarser bins on either side."""
        size = _factor(abs(edge) * PARTING, finest)
        ends = sorted(focused + edge * bins * by for by in (1 / PARTING, PARTING))
        first, last = (min(max(round(end / size), 0), len(counts) // size + 1) for end in ends)
        at = np.arange(first, last + 1) * size
        beside = np.pad(counts, (1, 2 * size + 1))
        number = beside[at] + beside[at + 1]
        fewest = at[number == number.min()]
        return int(fewest[np.abs(fewest - (focused + edge * bins)).argmin()])

    edges = [*-GROUPS[::-1], *GROUPS]
    partings = [0, *(parting(edge) for edge in edges[1:-1]), len(counts)]
    for i in reversed(range(len(edges) - 1)):
        filled = partings[i] + np.flatnonzero(counts[partings[i] : partings[i + 1]])
        if len(filled) == 0:
            continue
        first, end = int(filled[0]), int(filled[-1]) + 1
        inner, outer = sorted(abs(end - focused) / bins for end in (first, end))
        if edges[i] < 0 < edges[i + 1]:
            yield _Band(first, end, 0.0, outer, 1.0, 1, 1)
        else:
            sign = math.copysign(1, edges[i])
            factor, bright = _factor(inner, finest), _factor(inner, BRIGHT_FINEST * finest)
            yield _Band(first, end, inner, outer, sign, factor, bright)


def _factor(radius: float, finest: float) -> int:
    """How many times as large the squares are on which circles of at least a radius are spread."""
    if radius < finest:
        return 1
    return 2 ** max(0, math.floor(math.log2(radius / finest)))


class _Sheet:
    """Elements of similar circles, to be spread over the picture on squares of one size."""

    def __init__(
        self,
        layers: Layers,
        band: _Band,
        factor: int,
        kinds: tuple[bool, bool, bool],
        lens: ThinLens,
        psf: PointSpreadFunction,
        squares_per_mm: float,
        scale: float,
        small: float,
    ) -> None:
        self.layers, self.lens, self.psf, self.sign = layers, lens, psf, band.sign
        self.diffracts = aperture_behind(psf).diffracts
        self.squares_per_mm, self.scale = squares_per_mm / factor, scale / factor
        self.focused = 1 / float(lens.focus_distance)
        self.factor, self.small = factor, small
        # What interpolation between coarser squares adds, less what their size leaves out.
        steps = 0.25 ** np.arange(round(math.log2(factor)))
        self.smeared = 3 / 16 * steps.sum() - SQUARE / factor**2 + (factor == 1) * SQUARE
        # How many squares of the elements' own make one of the sheet's.
        self.sizes = (1, 1, factor)
        self.parts = [
            elements.between(band.first // own, (band.end - 1) // own + 1) if there else slice(0, 0)
            for elements, own, there in zip(
                layers.elements, (factor, factor, 1), kinds, strict=True
            )
        ]
        self.inner, self.outer = band.inner / factor, band.outer / factor
        self.octaves = [0.0]
        if self.inner > 0:
            octaves = max(1, math.ceil(math.log2(self.outer / self.inner) - 1e-3))
            self.octaves = [self.inner * 2**i for i in range(octaves)]
        self.bins, self.radii = self._radii()

    def _radii(self) -> tuple[np.ndarray, np.ndarray]:
        """The bins that have elements of ``whole``, and their mean radii in squares."""
        part, own = self.parts[0], self.layers.whole.bin
        bins, vergences = self.layers.vergences
        if part.start == part.stop:
            return bins[:0], vergences[:0]
        ends = np.searchsorted(bins, own[[part.start, part.stop - 1]])
        these = slice(ends[0], ends[1] + 1)
        return bins[these], np.abs(vergences[these] - self.focused) * self.scale

    def _knots(self, area: int) -> np.ndarray:
        """Radii, as few as will do, for which there are tables; with circles near each.

        ``area`` is that, in squares, in which there are elements.
        """
        if self.inner == 0:
            outer = float(self.radii.max(initial=0.0))
            return np.array([0.0, BETWEEN * outer, outer] if outer > 0 else [0.0])
        radii = np.sort(self.radii)
        alike = len(radii) > 0 and radii[-1] - radii[0] <= max(BIN, ALIKE * radii[0])
        if alike and not self.diffracts:
            return np.array([math.sqrt(radii[0] * radii[-1])])
        apart = APART if area > self.small else SMALL_APART
        if self.diffracts:
            apart = PATTERNS_APART
        knots: list[float] = []
        next_ = 0
        while next_ < len(radii):
            knots.append(float(radii[next_]))
            last = int(np.searchsorted(radii, knots[-1] * apart, side="right")) - 1
            next_ = max(last, next_ + 1)
        return np.array(knots)

    def starts(self, channels: int) -> bool:
        """Begin with the images of the elements, and find the tables that are to spread them.

        Returns whether there are any.
        """
        boxes = [
            np.array([e.x[part].min(), e.y[part].min(), e.x[part].max(), e.y[part].max()]) // size
            for e, part, size in zip(self.layers.elements, self.parts, self.sizes, strict=True)
            if part.start < part.stop
        ]
        if not boxes:
            return False
        left, top = (min(box[i] for box in boxes) for i in (0, 1))
        right, bottom = (max(box[i] for box in boxes) + 1 for i in (2, 3))
        self.knots = self._knots((right - left) * (bottom - top))
        # Farther than the window is wide (and a square more to interpolate) nothing is seen.
        self.largest = (self.layers.whole.width + 2, self.layers.whole.height + 2)
        tables = [self._table(radius) for radius in self.knots]
        cell = math.sqrt(2 / len(self.layers.partial.points)) * CELL
        cells = math.ceil(self.outer * (1 + cell)) + 3
        if self.diffracts:
            cells += max(self._in_focus().shape) // 2
        reach = max([cells, *(max(table.shape) // 2 + 1 for table in tables)]) + MOVED
        self.left, self.top = int(left) - reach, int(top) - reach
        self.width, self.height = (
            scipy.fft.next_fast_len(int(size) + 2 * reach, real=True)
            for size in (right - left, bottom - top)
        )
        self.images = self._at_knots(tables, channels)
        partials = (self.layers.partial, self.layers.bright)
        for partial, part, size in zip(partials, self.parts[1:], self.sizes[1:], strict=True):
            self.images += self._by_points(partial, part, size, channels)
        return True

    def spread(self) -> np.ndarray:
        """The elements' light, float32 (H, W, C), of which ``left`` and ``top`` are the first."""
        images = [(buffer.image(index), table) for buffer, index, table in self.images]
        far = [(image, kernel) for image, kernel in images if kernel.ndim == 2]
        total = self._spread_far(far) if far else np.zeros_like(images[0][0])
        for image, kernel in images:
            if kernel.ndim == 1:
                _add_spread(total, image, kernel)
        return total

    def _spread_far(self, images: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
        """The sum of images spread by their kernels, by one inverse transform."""
        total = np.zeros(0, dtype=np.complex64)
        with scipy.fft.set_workers(os.cpu_count() or 1):
            for image, kernel in images:
                spectrum = scipy.fft.rfft2(image, axes=(0, 1), overwrite_x=True)
                spectrum *= self._spectrum(kernel)[..., None]
                total = np.add(total, spectrum, out=total) if total.size else spectrum
            frame = (self.height, self.width)
            return scipy.fft.irfft2(total, frame, axes=(0, 1), overwrite_x=True)

    def _spectrum(self, kernel: np.ndarray) -> np.ndarray:
        """The transform of a table whose middle is the first square of the images."""
        rows, columns = kernel.shape
        across = np.zeros((rows, self.width), dtype=np.float32)
        across[:, :columns] = kernel
        across = scipy.fft.rfft(np.roll(across, -(columns // 2), axis=1))
        spectrum = np.zeros((self.height, across.shape[1]), dtype=np.complex64)
        spectrum[: rows - rows // 2] = across[rows // 2 :]
        spectrum[self.height - rows // 2 :] = across[: rows // 2]
        return scipy.fft.fft(spectrum, axis=0, overwrite_x=True)

    def _at_knots(self, tables: list[np.ndarray], channels: int) -> list[_Image]:
        """Images of the elements at each knot."""
        columns, part = self.layers.on_device, self.parts[0]
        if part.start == part.stop:
            return []
        buffer = _Buffer(len(self.knots), self.height, self.width, channels)
        element = dr.arange(mi.UInt32, part.stop - part.start)
        element += dr.opaque(mi.UInt32, part.start)
        size = dr.opaque(mi.UInt32, self.height * self.width)
        place = self._place(columns["x"], columns["y"], element)
        knot, share = self._between_knots(columns, element)
        place += knot * size
        buffer.add(columns, element, place, 1 - share)
        if len(self.knots) > 1:
            buffer.add(columns, element, place + size, share, share > 0)
        spots = self.layers.spots
        spots = spots[(spots >= part.start) & (spots < part.stop)]
        if len(spots):
            wide = max(table.max() for table in tables) < NARROW
            wide &= not getattr(self.psf, "truncated", False)  # Their edge is sharp.
            spot = mi.UInt32(spots - part.start)
            element, place, share = (
                dr.gather(type(column), column, spot) for column in (element, place, share)
            )
            for beside, moved in self._moved(spots, MOVED if wide else 1):
                for at, part in ((0, 1 - share), (size, share)):
                    there = place + beside + at
                    buffer.add(columns, element, there, moved * part, part > 0, colours=True)
        buffer.start()
        return [(buffer, knot, tables[knot]) for knot in range(len(self.knots))]

    def _between_knots(
        self, columns: dict[str, Any], element: mi.UInt32
    ) -> tuple[mi.UInt32, mi.Float]:
        """The knot before the circles of elements, and the share of the one beyond.

        Between tables the area of the circle is interpolated, and so the blur's variance.
        """
        squares = self.knots**2
        before = np.clip(np.searchsorted(self.knots, self.radii, side="right") - 1, 0, None)
        if len(self.knots) > 1:
            before = np.minimum(before, len(self.knots) - 2)
        knot_of = np.zeros(self.bins[-1] - self.bins[0] + 1, dtype=np.uint32)
        knot_of[self.bins - self.bins[0]] = before
        steps = 1 / np.diff(squares, append=np.inf)
        bin_ = dr.gather(mi.UInt32, columns["bin"], element)
        knot = dr.gather(mi.UInt32, mi.UInt32(knot_of), bin_ - dr.opaque(mi.UInt32, self.bins[0]))
        first, step = (dr.gather(mi.Float, mi.Float(of), knot) for of in (squares, steps))
        return knot, dr.clip((dr.square(self._radius(columns, element)) - first) * step, 0, 1)

    def _moved(self, spots: np.ndarray, most: int) -> Iterator[tuple[mi.Int32, mi.Float]]:
        """What moves spots from the middle of their squares to where they are in these.

        Squares around, as steps in the picture, and what they get, less what is there: the
        weights with which a pattern is interpolated between ``2 most + 1`` squares, by polynomials
        of that degree less one; or linearly for 1, as narrow patterns must be.
        """
        offset = self.layers.whole.offset
        assert offset is not None
        nodes = np.arange(-most, most + 1)
        if most == 1:
            weights = [np.maximum(1 - np.abs(offset[spots] - k), 0) for k in nodes]
        else:
            weights = [
                np.prod([(offset[spots] - j) / (k - j) for j in nodes if j != k], axis=0)
                for k in nodes
            ]
        for (dx, x), (dy, y) in itertools.product(zip(nodes, weights, strict=True), repeat=2):
            share = x[:, 0] * y[:, 1] - (dx == 0 and dy == 0)
            yield mi.Int32(int(dy) * self.width + int(dx)), mi.Float(share.astype(np.float32))

    def _by_points(self, partial: Partial, part: slice, size: int, channels: int) -> list[_Image]:
        """Images of what single lens points see, by octave, to be spread over their cells.

        ``size`` is that of a square in squares of the elements.
        """
        if part.start == part.stop:
            return []
        columns, count = partial.on_device, len(partial.points)
        buffer = _Buffer(len(self.octaves), self.height, self.width, channels)
        lane = dr.arange(mi.UInt32, (part.stop - part.start) * count)
        element = lane // dr.opaque(mi.UInt32, count)
        point = lane - element * dr.opaque(mi.UInt32, count)
        element += dr.opaque(mi.UInt32, part.start)
        lane += dr.opaque(mi.UInt32, part.start * count)
        seen = mi.Float(dr.gather(mi.UInt8, columns["seen"], lane))
        cell = (CELL if partial.turns is None else BRIGHT_CELL) / math.sqrt(count)
        radius = self._radius(columns, element)
        if partial.turns is not None and self.factor > 1:
            # Whole discs they make: of the right size with what coarse squares and cells add.
            added = dr.opaque(mi.Float, 4 * (LINEAR + self.smeared))
            square = dr.fma(dr.square(radius), dr.opaque(mi.Float, 1 - cell**2), -added)
            radius = dr.copysign(dr.sqrt(dr.maximum(square, 0)), radius)
        u, v = (dr.gather(mi.Float, columns[name], point) for name in "uv")
        if partial.turns is not None:
            u, v = partial.turns.points(u, v, point, element)
        # Of the middle of the element's square, in squares; there it is the middle again.
        own = dr.opaque(mi.Float, 1 / size)
        x, y = (
            dr.fma(mi.Float(dr.gather(mi.Int32, columns[name], element)) + 0.5, own, -0.5)
            - dr.opaque(mi.Float, first)
            + radius * lens
            for name, first, lens in (("x", self.left, u), ("y", self.top, v))
        )
        x0, y0 = dr.floor(x), dr.floor(y)
        fx, fy = x - x0, y - y0
        width = dr.opaque(mi.UInt32, self.width)
        place = mi.UInt32(y0) * width + mi.UInt32(x0)
        for edge in self.octaves[1:]:
            beyond = dr.abs(radius) >= dr.opaque(mi.Float, edge)
            place += dr.select(beyond, dr.opaque(mi.UInt32, self.height * self.width), 0)
        seen *= own * own
        for dx, share_x in ((0, 1 - fx), (1, fx)):
            for dy, share_y in ((0, 1 - fy), (1, fy)):
                beside = place + dy * width + dx
                buffer.add(columns, element, beside, share_x * share_y * seen, seen > 0)
        buffer.start()
        ends = partial.elements.bin[[part.start, part.stop - 1]] + np.array([0, 1])
        vergences = partial.elements.least + partial.elements.step * ends - self.focused
        largest = np.abs(vergences).max() * self.scale
        images: list[_Image] = []
        for octave, edge in enumerate(self.octaves):
            if octave == 0 or edge <= largest:
                kernel = cell_table(cell * edge)
                if self.diffracts:
                    if kernel.ndim == 1:
                        kernel = np.outer(kernel, kernel)
                    kernel = scipy.signal.fftconvolve(kernel, self._in_focus())
                images.append((buffer, octave, kernel))
        return images

    def _radius(self, columns: dict[str, Any], element: mi.UInt32) -> mi.Float:
        """Signed radius of the circles of confusion in squares."""
        vergence = dr.gather(mi.Float, columns["vergence"], element)
        return dr.fma(
            vergence,
            dr.opaque(mi.Float, self.scale),
            dr.opaque(mi.Float, -self.scale * self.focused),
        )

    def _place(self, x: mi.Int32, y: mi.Int32, element: mi.UInt32) -> mi.UInt32:
        column = dr.gather(mi.Int32, x, element) - dr.opaque(mi.Int32, self.left)
        row = dr.gather(mi.Int32, y, element) - dr.opaque(mi.Int32, self.top)
        return mi.UInt32(row * dr.opaque(mi.Int32, self.width) + column)

    def _table(self, radius: float) -> np.ndarray:
        if self.diffracts:
            return self._exact_table(radius, 1.0)
        if radius == 0 or self.scale == 0:
            return np.ones(1)
        smeared = self.smeared + (LINEAR if self.factor > 1 else 0)
        if isinstance(self.psf, Aperture) and type(self.psf).table is Aperture.table:
            squeeze = float(self.lens.squeeze)
            return circle_table(self.psf, self.sign * radius, squeeze, smeared, self.largest)
        return without(smeared, functools.partial(self._exact_table, radius))

    def _exact_table(self, radius: float, finer: float) -> np.ndarray:
        """The table of circles of a radius in squares, on squares so many times as fine."""
        vergence = self.focused
        if self.scale > 0:
            vergence += self.sign * radius / self.scale
        if vergence < 0:  # No point is there: take one as far in front of what is focused.
            vergence = self.focused + radius / self.scale
        depth = 1 / vergence if vergence > 0 else math.inf
        largest = (round(self.largest[0] * finer), round(self.largest[1] * finer))
        return self.psf.table(self.lens, depth, self.squares_per_mm * finer, MIDDLE, largest)

    def _in_focus(self) -> np.ndarray:
        """What diffraction makes of a point in focus: the table of the light of lens points."""
        return self._exact_table(0.0, 1.0)


class _Buffer:
    """Pictures into which the light of elements is scattered."""

    def __init__(self, count: int, height: int, width: int, channels: int) -> None:
        self.shape = (count, height, width)
        self.colours = dr.zeros(mi.Float, count * height * width * 4)
        self.alpha = dr.zeros(mi.Float, count * height * width) if channels > 4 else None

    def add(
        self,
        columns: dict[str, Any],
        element: mi.UInt32,
        place: mi.UInt32,
        share: mi.Float,
        active: mi.Bool = True,
        colours: bool = False,
    ) -> None:
        """Add the shares of elements to their places, or of their ``colours`` alone."""
        mode = scatter_mode()
        values = dr.gather(mi.Vector4f, columns["values"], element, active)
        if colours:
            values.w = 0
        dr.scatter_add(self.colours, values * share, place, active, mode=mode)
        if self.alpha is not None and not colours:
            values = dr.gather(mi.Float, columns["alpha"], element, active)
            dr.scatter_add(self.alpha, values * share, place, active, mode=mode)

    def start(self) -> None:
        """Have the pictures made, without waiting for them."""
        dr.eval(self.colours, self.alpha)

    def image(self, index: int) -> np.ndarray:
        """One of the pictures, float32 (H, W, C)."""
        parts = [part[index] for part in self._on_host]
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-1)

    @functools.cached_property
    def _on_host(self) -> list[np.ndarray]:
        """All pictures, (count, H, W, 4), and their alpha, (count, H, W, 1), if there is any."""
        parts = [part for part in (self.colours, self.alpha) if part is not None]
        return [np.asarray(part).reshape(*self.shape, -1) for part in parts]


_Image = tuple[_Buffer, int, np.ndarray]
"""The buffer of an image, which of its pictures it is, and the table that is to spread it."""


def _add_spread(total: np.ndarray, image: np.ndarray, row: np.ndarray) -> None:
    """Add ``image`` to ``total``, spread by a short symmetric row along both axes.

    Along its border there must be nothing.
    """
    middle = len(row) // 2
    weights = row[middle:].astype(image.dtype)
    for start in range(middle, len(image) - middle, ROWS):
        end = min(start + ROWS, len(image) - middle)
        down = image[start:end] * weights[0]
        for step in range(1, middle + 1):
            pair = image[start - step : end - step] + image[start + step : end + step]
            pair *= weights[step]
            down += pair
        if middle == 0:
            total[start:end] += down
            continue
        for step in range(1, middle + 1):
            pair = down[:, : -2 * step] + down[:, 2 * step :]
            pair *= weights[step]
            total[start:end, step:-step] += pair
        down *= weights[0]
        total[start:end] += down


@dataclasses.dataclass(frozen=True)
class _Overlap:
    """What of an image lies in a crop: from its ``left`` and ``top`` on, in squares of the crop.

    ``column`` and ``row`` are where this begins in ``image``, whose squares are 1 or 2 (then
    ``factor``) times as large.
    """

    image: np.ndarray
    factor: int
    column: int
    row: int
    left: int
    top: int
    width: int
    height: int

    @classmethod
    def of(
        cls, image: np.ndarray, left: int, top: int, factor: int, crop: tuple[int, int, int, int]
    ) -> _Overlap:
        """Of an image whose squares are ``factor`` times as large, the first at (left, top)."""
        needed: list[slice] = []
        parts: list[tuple[int, int, int]] = []
        for first, count, start, size in (
            (left, image.shape[1], crop[0], crop[2]),
            (top, image.shape[0], crop[1], crop[3]),
        ):
            begin = max(first * factor, start)
            end = max(min((first + count) * factor, start + size), begin)
            # A square more on each side to interpolate with.
            needed.append(slice(max(begin // factor - first - 1, 0), -(-end // factor) - first + 1))
            parts.append((begin - (needed[-1].start + first) * factor, begin - start, end - begin))
        (column, across, width), (row, down, height) = parts
        image = image[needed[1], needed[0]]
        while factor > 2 and image.size:
            image = _doubled(_doubled(image, 0), 1)
            factor //= 2
        return cls(image, factor, column, row, across, down, width, height)

    def rows(self, start: int, end: int) -> np.ndarray:
        """Rows of the crop, with no more than the columns of the overlap.

        Between the middles of larger squares they are interpolated linearly.
        """
        columns = slice(self.column, self.column + self.width)
        start, end = start - self.top + self.row, end - self.top + self.row
        if self.factor == 1:
            return self.image[start:end, columns]
        first = max(start // 2 - 1, 0)
        rows = self.image[first : (end + 1) // 2 + 1]
        return _doubled(_doubled(rows, 0)[start - 2 * first : end - 2 * first], 1)[:, columns]


def _doubled(image: np.ndarray, axis: int) -> np.ndarray:
    """Twice as many squares along an axis, 0 or 1, interpolated linearly between their middles."""
    quarter = np.moveaxis(image * image.dtype.type(0.25), axis, 0)
    even = image * image.dtype.type(0.75)
    odd = even.copy()
    first, second = np.moveaxis(even, axis, 0), np.moveaxis(odd, axis, 0)
    first[1:] += quarter[:-1]
    first[:1] += quarter[:1]
    second[:-1] += quarter[1:]
    second[-1:] += quarter[-1:]
    # Pixels are moved faster whole than by channel.
    pixel = np.dtype((np.void, image.itemsize * image.shape[-1]))
    result = np.empty([size * (1 + (i == axis)) for i, size in enumerate(image.shape)], image.dtype)
    places = np.moveaxis(result.view(pixel), axis, 0)
    places[0::2] = np.moveaxis(even.view(pixel), axis, 0)
    places[1::2] = np.moveaxis(odd.view(pixel), axis, 0)
    return result
