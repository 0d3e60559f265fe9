"""The picture through the lens with what hides what: the methods ``layered`` and ``lightfield``.

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
import weakref
from collections.abc import Callable, Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import scipy.fft
import scipy.ndimage
import scipy.signal

from .disocclusion import parallax_scale
from .elements import MOST_BINS, SHARE, Elements, scatter_mode
from .lens import ThinLens
from .progress import track
from .psf import Aperture, PointSpreadFunction, aperture_behind, disc_table
from .samples import PointSamples
from .visibility import Turns, visibility, visibility_of_few

SIMILAR = 0.025
"""Apertures that differ by no more see the same, as far as ``layered`` can tell."""

BRIGHT = 8
"""Elements so many times as bright as most show the shape of the lens where they are blurred."""

BRIGHT_BESIDE, NEIGHBOURHOOD = 6, 33
"""And so many times as bright as the mean of so many squares each way around them."""

MOST_BRIGHT = 1 << 14
"""Most elements that are seen from ``MORE`` times as many lens points because they are bright."""

MORE = 16

MOST_KEPT = 4
"""Apertures (and other questions) for which is kept what they see of samples: it is large."""

CLOSED = 1e-9
"""What a closed aperture's circles have for a radius, in squares per unit of vergence."""

EXACT_FINEST = 16
"""Where visibility is exact circles of at least twice this radius, in pixels, are spread on
squares so much coarser that their radius there is no less; else those of an aperture's own."""

MOVED = 3
"""Squares on each side among which a spot is shared to be in its place."""

NARROW = 0.1
"""Share of the light in one square from which on a pattern is too narrow for polynomials."""

PATTERNS = 8
"""Tables an octave of circles where their pattern changes with them."""

GROUPS = 4.0 ** np.arange(12)
"""Radii between which circles are one group; up to the first they are of both signs. In a group
the squares of the radii that have a table are a factor of 2 apart."""

LEAST_SEEN = 8
"""What the innermost point of the lens sees at least, of 255, of what the pinhole sees."""

SQUARE, LINEAR = 1 / 12, 1 / 6
"""Variance along an axis of a square, and of what is shared linearly by the squares around it."""

MIDDLE = (0.5, 0.5)

FAINTEST = 1e-5
"""Share of a square below which nothing is told from the rounding of the transforms."""


@dataclasses.dataclass(frozen=True)
class Pupil:
    """The points of the lens from which visibility is found.

    ``points`` are (M, 2), ``more`` those for bright elements, in radii of the aperture, x to the
    right and y downwards in the picture of a highlight nearer than the focused plane. With a
    ``cell`` those are not turned, see :class:`potmesil_mi.visibility.Turns`. The rim of the lens
    is in front of the aperture: seen from a square it is moved by what the square is from
    ``middle``, (2,), divided by ``far``, where there is one.
    """

    points: np.ndarray
    more: np.ndarray
    cell: float
    squeeze: float
    middle: tuple[float, float]
    far: float

    @classmethod
    def of(
        cls, aperture: Aperture, lens: ThinLens, samples: PointSamples, count: int, per_pixel: int
    ) -> Pupil:
        """``count`` points of the lens; ``per_pixel`` squares are on a side of a pixel."""
        scale = -1 / np.array([lens.squeeze, 1])
        width, height = samples.camera.film_size
        offset = samples.camera.principal_point_offset
        left, top = samples.window[:2]
        middle = (
            ((0.5 + offset[0]) * width - left) * per_pixel,
            ((0.5 + offset[1]) * height - top) * per_pixel,
        )
        corner = math.hypot(width, height) / 2 * per_pixel
        whole_disc = aperture.is_round and lens.squeeze == 1 and lens.vignetting == 0
        return cls(
            aperture.points(count) * scale,
            aperture.points(MORE * count) * scale,
            0.0 if whole_disc else 1 / math.sqrt(MORE * count),
            float(lens.squeeze),
            middle,
            corner / (2 * lens.vignetting) if lens.vignetting > 0 else math.inf,
        )

    @property
    def key(self) -> Any:
        """What it has in common with equal ones."""
        return (self.points.tobytes(), self.more.shape, self.cell, self.far)

    def open(self, elements: Elements, points: np.ndarray) -> np.ndarray:
        """Whether the rim lets through what points see of elements, bool (N, M)."""
        across, down = (
            (at + 0.5 - middle) / self.far
            for at, middle in zip((elements.x, elements.y), self.middle, strict=True)
        )
        u, v = points[:, 0] * self.squeeze, points[:, 1]
        return (u - across[:, None]) ** 2 + (v - down[:, None]) ** 2 <= 1


@dataclasses.dataclass(frozen=True)
class Partial:
    """Elements of which parts of the lens see nothing, or not all.

    ``seen``, uint8 (N, M), is what each of the lens's ``points``, (M, 2), sees of each, from
    none to 255. The values of the elements are not multiplied by it. With ``turns`` the points
    are arranged for each element.
    """

    elements: Elements
    seen: np.ndarray
    points: np.ndarray
    turns: Turns | None = None

    def coarser(self, factor: int) -> Partial:
        """The same on squares, and in bins of depth, ``factor`` times as large."""
        elements, index = self.elements.coarser(factor)
        weight = self.elements.values[:, SHARE].astype(np.float64)
        total = np.bincount(index, weight, len(elements))
        seen = [np.bincount(index, weight * column, len(elements)) for column in self.seen.T]
        mean = np.rint(np.stack(seen, axis=1) / total[:, None])
        return Partial(elements, mean.astype(np.uint8), self.points)

    @functools.cached_property
    def on_device(self) -> dict[str, Any]:
        """The columns as Dr.Jit arrays.

        The values are such that times what a point sees they are its share.
        """
        share = np.float32(1 / (255 * len(self.points)))
        columns = _columns(self.elements, self.elements.values * share)
        columns["seen"] = mi.UInt8(self.seen.ravel())
        columns["u"], columns["v"] = (mi.Float(column) for column in self.points.T.copy())
        return columns


@dataclasses.dataclass(frozen=True)
class Layers:
    """What is known of samples before the lens is focused.

    ``whole`` are elements that the whole lens sees, ``partial`` those of which parts of it do
    not see all. ``bright`` are the colours, without the shares, of some of either kind, whose light
    shows the shape of the lens and how it is cut up; they are seen from more points, and kept on
    the squares of the picture.
    """

    whole: Elements
    partial: Partial
    bright: Partial
    factor: int = 1

    @classmethod
    def of(cls, elements: Elements, scale: float, pupil: Pupil, spots: bool = True) -> Layers:
        """Elements and what the points of a lens see of them.

        ``scale`` is the radius of the circle in squares per unit of vergence. Without ``spots``
        only bright elements are looked at closely that are seen in part.
        """
        coverable, seen = visibility(elements, scale, pupil.points)
        # The pinhole does see its samples: without a trace of them there might be black holes.
        first = elements.front[coverable] == 0
        seen[first, 0] = np.maximum(seen[first, 0], LEAST_SEEN)
        if pupil.far < math.inf:
            coverable, seen, elements = _within_rim(elements, coverable, seen, pupil)
        all_seen, some_seen = seen.min(axis=1) == 255, seen.any(axis=1)
        whole, partial = ~coverable, np.zeros(len(elements), dtype=bool)
        whole[coverable], partial[coverable] = all_seen, some_seen & ~all_seen
        bright = _is_bright(elements) & ((whole & spots) | partial)
        few, more = elements.chosen(bright), pupil.more
        seen_of_few = visibility_of_few(elements, few, scale, more, pupil.cell)
        if pupil.far < math.inf:
            seen_of_few *= pupil.open(few, more)
        # The bright ones' colours leave their shares of the squares behind.
        colours, shares = few.values.copy(), elements.values.copy()
        colours[:, SHARE:] = 0
        shares[bright, :SHARE] = 0
        elements = dataclasses.replace(elements, values=shares)
        few = dataclasses.replace(few, values=colours)
        return cls(
            elements.chosen(whole),
            Partial(elements.chosen(partial), seen[partial[coverable]], pupil.points),
            Partial(few, seen_of_few, more, Turns(few, pupil.cell)),
        )

    def coarser(self, factor: int) -> Layers:
        """The same on squares, and in bins of depth, ``factor`` times as large."""
        whole = self.whole.coarser_linearly(factor)
        return Layers(whole, self.partial.coarser(factor), self.bright, factor)

    @property
    def elements(self) -> list[Elements]:
        """All that there are."""
        return [self.whole, self.partial.elements, self.bright.elements]

    @functools.cached_property
    def on_device(self) -> dict[str, Any]:
        """Columns of what the whole lens sees, as Dr.Jit arrays."""
        return _columns(self.whole, self.whole.values)

    @functools.cached_property
    def spots(self) -> np.ndarray:
        """Those of ``whole``, (n,), of which one sees where in their squares they are."""
        if self.whole.offset is None:
            return np.empty(0, dtype=np.int64)
        return np.flatnonzero(_is_bright(self.whole))


def _within_rim(
    elements: Elements, coverable: np.ndarray, seen: np.ndarray, pupil: Pupil
) -> tuple[np.ndarray, np.ndarray, Elements]:
    """The same of all elements, where the rim of the lens lets only part of the light through.

    That part becomes brighter, for what the rim takes changes shapes here and not the exposure.
    """
    open_ = pupil.open(elements, pupil.points)
    open_[~open_.any(axis=1), 0] = True
    count = len(pupil.points)
    all_of_them = np.full((len(elements), count), 255, dtype=np.uint8)
    all_of_them[coverable] = seen
    all_of_them *= open_
    unseen = ~all_of_them.any(axis=1) & (elements.front == 0)
    all_of_them[unseen, open_[unseen].argmax(axis=1)] = LEAST_SEEN
    values = elements.values * (count / open_.sum(axis=1, keepdims=True)).astype(np.float32)
    whole = np.ones(len(elements), dtype=bool)
    return whole, all_of_them, dataclasses.replace(elements, values=values)


def _is_bright(elements: Elements) -> np.ndarray:
    """The elements, bool (N,), much brighter than most and than what is around them.

    There are no more than ``MOST_BRIGHT``.
    """
    peak = elements.values[:, :SHARE].max(axis=1)
    picture = np.zeros((elements.height, elements.width), dtype=np.float32)
    np.maximum.at(picture, (elements.y, elements.x), peak)
    around = scipy.ndimage.uniform_filter(picture, NEIGHBOURHOOD)[elements.y, elements.x]
    least = BRIGHT * np.median(peak)
    peak[peak < BRIGHT_BESIDE * around] = 0
    if len(peak) > MOST_BRIGHT:
        least = max(least, float(np.partition(peak, -MOST_BRIGHT)[-MOST_BRIGHT]))
    return peak > least


def _columns(elements: Elements, values: np.ndarray) -> dict[str, Any]:
    columns = {
        "x": mi.Int32(elements.x),
        "y": mi.Int32(elements.y),
        "vergence": mi.Float(elements.vergence),
        "values": mi.Float(np.ascontiguousarray(values[:, :4]).ravel()),
    }
    if values.shape[1] > 4:
        columns["alpha"] = mi.Float(np.ascontiguousarray(values[:, 4]))
    return columns


class _Kept:
    """What has been found out about samples, by the questions that were asked last."""

    def __init__(self) -> None:
        self.elements: dict[Any, Elements] = {}
        self.layers: dict[Any, dict[int, Layers]] = {}

    def of_question(self, about: Any) -> dict[int, Layers]:
        """Layers, by the size of their squares; those of the question asked first are given up."""
        layers = self.layers.pop(about, {})
        while len(self.layers) >= MOST_KEPT:
            del self.layers[next(iter(self.layers))]
        self.layers[about] = layers
        return layers


_kept: weakref.WeakKeyDictionary[PointSamples, _Kept] = weakref.WeakKeyDictionary()


def see_through(
    samples: PointSamples,
    lens: ThinLens,
    psf: PointSpreadFunction,
    *,
    alpha: bool,
    lens_points: int,
    per_pixel: int,
    exact: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """The picture that ``lens`` forms of ``samples``, (height * per_pixel, width * per_pixel, C).

    And what each of its squares counts in its pixel.

    Visibility is that of ``lens_points`` points of a lens of the same aperture, or, unless
    ``exact``, of one that differs by at most ``SIMILAR``, for with the film at F the aperture
    changes a little as the lens is focused.
    """
    scale = parallax_scale(lens, samples.camera) * per_pixel
    similar = scale
    if scale == 0:
        samples, similar = samples.visible(), CLOSED
    elif not exact:
        steps = round(math.log(scale) / math.log1p(2 * SIMILAR))
        similar = math.exp(steps * math.log1p(2 * SIMILAR))

    aperture = aperture_behind(psf)
    pupil = Pupil.of(aperture, lens, samples, lens_points, per_pixel)
    of_samples = (mi.variant(), per_pixel, alpha, similar, aperture.diffracts)
    about = (*of_samples, pupil.key)

    kept = _kept.setdefault(samples, _Kept())
    known = kept.of_question(about)

    def layers_at(factor: int) -> Layers:
        if factor not in known:
            if factor > 1:
                known[factor] = layers_at(1).coarser(factor)
            else:
                if of_samples not in kept.elements:
                    elements = Elements.of(samples, per_pixel, similar, alpha)
                    if aperture.diffracts:
                        elements = elements.placed(samples, per_pixel)
                    kept.elements = {of_samples: elements}
                elements = kept.elements[of_samples]
                known[factor] = Layers.of(elements, similar, pupil, spots=not aperture.diffracts)
        return known[factor]

    left, top = (
        (offset - start) * per_pixel
        for offset, start in zip(samples.camera.crop_offset, samples.window[:2], strict=True)
    )
    width, height = (size * per_pixel for size in samples.camera.crop_size)
    squares_per_mm = samples.camera.focal_length_pixels * per_pixel / lens.film_distance
    finest = max(EXACT_FINEST * per_pixel if exact else 0, aperture.finest)
    return through_lens(
        layers_at, lens, psf, (left, top, width, height), scale, squares_per_mm, finest
    )


def through_lens(
    layers_at: Callable[[int], Layers],
    lens: ThinLens,
    psf: PointSpreadFunction,
    crop: tuple[int, int, int, int],
    scale: float,
    squares_per_mm: float,
    finest: float,
) -> tuple[np.ndarray, np.ndarray]:
    """The picture that ``lens`` forms of layers, float32 (height, width, 3 or 4).

    ``layers_at`` gives the layers on squares so many times as large. ``crop`` is the left, top,
    width and height of the picture in squares of the window, ``scale`` the radius of the circle
    in squares per unit of vergence; circles of a radius of twice ``finest`` squares or more are
    spread on coarser ones. Squares that no light reaches are 0.

    Also returns the light that reaches each square, float32 (height, width), 1 on the average:
    what it counts in its pixel, for chance puts more samples here than there.
    """
    layers = layers_at(1)
    diffracts = aperture_behind(psf).diffracts
    channels = layers.whole.values.shape[1]
    # In the column of shares what is covered adds up.
    total = np.zeros((crop[3], crop[2], channels), dtype=np.float32)
    arrived = np.zeros((crop[3], crop[2]), dtype=np.float32)
    for band in track(list(_bands(layers, lens, scale, finest, diffracts)), "Focusing"):
        group = _Group(layers_at(band.factor), band, lens, psf, squares_per_mm, scale)
        image, rows, columns = _cropped(*group.spread(channels), band.factor, crop)
        if image.size == 0:
            continue
        nearer = total[rows, columns]
        np.maximum(image, 0, out=image)
        light, free = image[..., SHARE], 1 - nearer[..., SHARE]
        arrived[rows, columns] += light
        admitted = np.zeros_like(free)
        np.divide(free, light, out=admitted, where=light > FAINTEST)
        image *= np.clip(admitted, 0, 1, out=admitted)[..., None]
        nearer += image
    covered = total[..., SHARE]
    lit = covered > FAINTEST
    arrived[~lit], covered[~lit] = 0, np.inf
    picture = np.delete(total, SHARE, axis=-1)
    picture /= covered[..., None]
    return picture, arrived


@dataclasses.dataclass(frozen=True)
class _Band:
    """Elements of similar circles: of the bins from ``first`` on that come before ``end``.

    ``inner`` and ``outer`` are radii, in squares, between which theirs are; ``inner`` is 0 where
    they are of both signs. They are spread on squares ``factor`` times as large, by ``steps``
    and one more tables from ``inner`` to ``outer``.
    """

    first: int
    end: int
    inner: float
    outer: float
    sign: float
    factor: int
    steps: int


def _bands(
    layers: Layers, lens: ThinLens, scale: float, finest: float, patterns: bool
) -> Iterator[_Band]:
    """The bands that have elements, from the nearest.

    Where ``patterns`` change with the circle there are more tables, from the smallest circle to
    the largest.
    """
    focused = 1 / float(lens.focus_distance)
    some = layers.bright.elements

    def bin_at(edge: float) -> int:
        """The first bin beyond a signed radius, whole also in the coarser bins on either side."""
        if scale == 0:
            return 0 if edge < 0 else MOST_BINS + 1
        coarsest = _factor(abs(edge), finest)
        bin_ = (edge / scale + focused - some.least) / some.step
        return min(max(round(bin_ / coarsest), 0) * coarsest, MOST_BINS + 1)

    edges = [*-GROUPS[::-1], *GROUPS]
    for least, most in zip(edges[-2::-1], edges[:0:-1], strict=True):
        bins: list[int] = []
        radii: list[float] = []
        for elements in layers.elements:
            part = elements.between(bin_at(least), bin_at(most))
            if part.start < part.stop:
                vergence = elements.vergence[part]
                bins.extend(elements.bin[[part.start, part.stop - 1]])
                radii.extend(scale * (end - focused) for end in (vergence.min(), vergence.max()))
        if not bins:
            continue
        first, end = int(min(bins)), int(max(bins)) + 1
        size, sign = np.abs(radii), math.copysign(1, most)
        if least < 0 < most:
            outer = float(size.max()) if patterns else most
            yield _Band(first, end, 0.0, outer, 1.0, 1, min(1, math.ceil(outer)))
            continue
        inner, outer = sorted((abs(least), abs(most)))
        if patterns:
            inner, outer = float(max(size.min(), inner)), float(min(size.max(), outer))
            steps = math.ceil(PATTERNS * math.log2(outer / inner) - 1e-3)
        else:  # To whole octaves, for which there are tables.
            octaves = np.floor(np.log2(np.clip(size, inner, outer * 0.999) / inner))
            inner, outer = inner * 2 ** octaves.min(), inner * 2 ** (octaves.max() + 1)
            steps = 2 * round(math.log2(outer / inner))
        yield _Band(first, end, inner, outer, sign, _factor(inner, finest), steps)


def _factor(radius: float, finest: float) -> int:
    """How many times as large the squares are on which circles of at least a radius are spread."""
    if radius < finest:
        return 1
    return 2 ** max(0, math.floor(math.log2(radius / finest)))


class _Group:
    """Elements of similar circles, to be spread over the picture."""

    def __init__(
        self,
        layers: Layers,
        band: _Band,
        lens: ThinLens,
        psf: PointSpreadFunction,
        squares_per_mm: float,
        scale: float,
    ) -> None:
        self.layers, self.lens, self.psf, self.sign = layers, lens, psf, band.sign
        self.diffracts = aperture_behind(psf).diffracts
        self.squares_per_mm, self.scale = squares_per_mm / band.factor, scale / band.factor
        self.focused = 1 / float(lens.focus_distance)
        self.factor = band.factor
        # What interpolation between coarser squares adds, less what their size leaves out.
        steps = 0.25 ** np.arange(round(math.log2(band.factor)))
        self.smeared = 3 / 16 * steps.sum() - SQUARE / band.factor**2 + (band.factor == 1) * SQUARE
        # How many squares of the elements' own make one of the group's.
        self.sizes = (1, 1, layers.factor)
        self.parts = [
            elements.between(band.first // own, (band.end - 1) // own + 1)
            for elements, own in zip(layers.elements, (band.factor, band.factor, 1), strict=True)
        ]
        self.inner, self.outer = band.inner / band.factor, band.outer / band.factor
        self.knots, self.octaves = [0.0, self.outer][: band.steps + 1], [0.0]
        if self.inner > 0:
            octaves = max(1, math.ceil(math.log2(self.outer / self.inner) - 1e-3))
            self.octaves = [self.inner * 2**i for i in range(octaves)]
            self.knots = np.geomspace(self.inner, self.outer, band.steps + 1).tolist()

    def spread(self, channels: int) -> tuple[np.ndarray, int, int]:
        """Light over the squares around its elements, float32 (H, W, C), and its left and top."""
        boxes = [
            np.array([e.x[part].min(), e.y[part].min(), e.x[part].max(), e.y[part].max()]) // size
            for e, part, size in zip(self.layers.elements, self.parts, self.sizes, strict=True)
            if part.start < part.stop
        ]
        left, top = (min(box[i] for box in boxes) for i in (0, 1))
        right, bottom = (max(box[i] for box in boxes) + 1 for i in (2, 3))
        # Farther than the window is wide (and a square more to interpolate) nothing is seen.
        self.largest = (self.layers.whole.width + 2, self.layers.whole.height + 2)
        tables = [self._table(radius) for radius in self.knots]
        cells = math.ceil(self.outer * (1 + 1 / math.sqrt(len(self.layers.partial.points)))) + 2
        if self.diffracts:
            cells += max(self._in_focus().shape) // 2
        reach = max(cells, *(max(table.shape) // 2 + 1 for table in tables)) + MOVED
        self.left, self.top = int(left) - reach, int(top) - reach
        self.width, self.height = (
            scipy.fft.next_fast_len(int(size) + 2 * reach, real=True)
            for size in (right - left, bottom - top)
        )
        images = [*self._at_knots(tables, channels)]
        partials = (self.layers.partial, self.layers.bright)
        for partial, part, size in zip(partials, self.parts[1:], self.sizes[1:], strict=True):
            if part.start < part.stop:
                images.extend(self._by_points(partial, part, size, channels))
        least = 9 if self.diffracts else 10  # Patterns of 3 x 3 are not separable.
        far = [(image, kernel) for image, kernel in images if kernel.size >= least]
        total = self._spread_far(far) if far else None
        for image, kernel in images:
            if kernel.size < least:
                _spread_a_little(image, kernel)
                total = image if total is None else np.add(total, image, out=total)
        if total is None:
            total = np.zeros((0, 0, channels), dtype=np.float32)
        return total, self.left, self.top

    def _spread_far(self, images: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
        """The sum of images spread by their kernels, by one inverse transform."""
        total = np.zeros(0, dtype=np.complex64)
        with scipy.fft.set_workers(os.cpu_count() or 1):
            for image, kernel in images:
                centred = np.zeros((self.height, self.width), dtype=np.float32)
                rows, columns = kernel.shape
                centred[:rows, :columns] = kernel
                centred = np.roll(centred, (-(rows // 2), -(columns // 2)), axis=(0, 1))
                spectrum = scipy.fft.rfft2(image, axes=(0, 1), overwrite_x=True)
                spectrum *= scipy.fft.rfft2(centred)[..., None]
                total = np.add(total, spectrum, out=total) if total.size else spectrum
            frame = (self.height, self.width)
            return scipy.fft.irfft2(total, frame, axes=(0, 1), overwrite_x=True)

    def _at_knots(
        self, tables: list[np.ndarray], channels: int
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Images of the elements at each knot, and the knot's table."""
        columns, part = self.layers.on_device, self.parts[0]
        if part.start == part.stop:
            return
        buffer = _Buffer(len(self.knots), self.height, self.width, channels)
        element = dr.arange(mi.UInt32, part.stop - part.start)
        element += dr.opaque(mi.UInt32, part.start)
        size = dr.opaque(mi.UInt32, self.height * self.width)
        place = self._place(columns["x"], columns["y"], element)
        knot, share = self._between_knots(columns, element)
        place += knot * size
        buffer.add(columns, element, place, 1 - share)
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
                    buffer.add(columns, element, place + beside + at, moved * part, colours=True)
        for table, image in zip(tables, buffer.images(), strict=True):
            if image.any():
                yield image, table

    def _between_knots(
        self, columns: dict[str, Any], element: mi.UInt32
    ) -> tuple[mi.UInt32, mi.Float]:
        """The knot before the circles of elements, and the share of the one beyond.

        Between tables the area of the circle is interpolated, and so the blur's variance.
        """
        if len(self.knots) == 1:
            return mi.UInt32(0), mi.Float(0)
        square = dr.square(self._radius(columns, element))
        first, last = (dr.opaque(mi.Float, radius**2) for radius in (self.inner, self.outer))
        if self.inner == 0:
            return mi.UInt32(0), dr.clip(square / last, 0, 1)
        ratio = (self.knots[1] / self.knots[0]) ** 2
        steps = dr.log2(dr.maximum(square / first, 1)) * dr.opaque(mi.Float, 1 / math.log2(ratio))
        steps = dr.minimum(dr.floor(steps), len(self.knots) - 2)
        before = first * dr.exp2(steps * dr.opaque(mi.Float, math.log2(ratio)))
        step = before * dr.opaque(mi.Float, ratio - 1)
        return mi.UInt32(steps), dr.clip((square - before) / step, 0, 1)

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

    def _by_points(
        self, partial: Partial, part: slice, size: int, channels: int
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Images of what single lens points see, by octave, and the table of their cells.

        ``size`` is that of a square in squares of the elements.
        """
        columns, count = partial.on_device, len(partial.points)
        buffer = _Buffer(len(self.octaves), self.height, self.width, channels)
        lane = dr.arange(mi.UInt32, (part.stop - part.start) * count)
        element = lane // dr.opaque(mi.UInt32, count)
        point = lane - element * dr.opaque(mi.UInt32, count)
        element += dr.opaque(mi.UInt32, part.start)
        lane += dr.opaque(mi.UInt32, part.start * count)
        seen = mi.Float(dr.gather(mi.UInt8, columns["seen"], lane))
        # Single bright elements show gaps between points; of the others edges do.
        cell = (1 if partial.turns is None else 2) / math.sqrt(count)
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
        for edge, image in zip(self.octaves, buffer.images(), strict=True):
            if image.any():
                kernel = without(0, functools.partial(_scaled_disc, cell * edge))
                if self.diffracts:
                    kernel = scipy.signal.fftconvolve(kernel, self._in_focus())
                yield image, kernel

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
            return np.ones((1, 1))
        smeared = self.smeared + (LINEAR if self.factor > 1 else 0)
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

    def images(self) -> np.ndarray:
        """The pictures, float32 (count, H, W, C)."""
        images = np.asarray(self.colours).reshape(*self.shape, 4)
        if self.alpha is None:
            return images
        alpha = np.asarray(self.alpha).reshape(*self.shape, 1)
        return np.concatenate([images, alpha], axis=-1)


def _scaled_disc(radius: float, finer: float) -> np.ndarray:
    return disc_table(radius * finer)


def without(smeared: float, table: Callable[[float], np.ndarray]) -> np.ndarray:
    """A table that spreads squares as the point-spread function spreads points.

    ``table(s)`` gives the integrals over squares, for a distribution s times as large: they
    smear it by a square, as gathering samples by square has done already. So, and for what
    else has ``smeared`` it, a variance along an axis, the distribution is made smaller.
    """
    kernel = table(1.0)
    # Of a few squares a table does not tell the variance: ask for it on squares a 16th as large.
    small = max(kernel.shape) <= 11
    variance = _variance(table(16.0)) / 256 if small else _variance(kernel) - SQUARE
    left = max(variance - smeared, 0)
    if left < 1 / 3:
        row = np.array([left / 2, 1 - left, left / 2])
        return np.outer(row, row) if left > 0 else np.ones((1, 1))
    return table(math.sqrt((left - SQUARE) / variance))


def _variance(table: np.ndarray) -> float:
    """Mean variance along rows and columns."""
    rows, columns = (np.arange(n) - n // 2 for n in table.shape)
    return float((table.sum(axis=1) @ rows**2 + table.sum(axis=0) @ columns**2) / 2)


def _spread_a_little(image: np.ndarray, kernel: np.ndarray) -> None:
    """Spread ``image`` in place by a kernel of one square, or symmetric, separable, of 3 x 3."""
    if kernel.size == 1:
        return
    beside = np.empty_like(image)
    for axis, weights in enumerate((kernel.sum(axis=1), kernel.sum(axis=0))):
        rows, others = (np.moveaxis(array, axis, 0) for array in (image, beside))
        np.multiply(image, image.dtype.type(weights[0]), out=beside)
        image *= image.dtype.type(weights[1])
        rows[1:] += others[:-1]
        rows[:-1] += others[1:]


def _cropped(
    image: np.ndarray, left: int, top: int, factor: int, crop: tuple[int, int, int, int]
) -> tuple[np.ndarray, slice, slice]:
    """The part of ``image`` that lies in the crop, and its rows and columns there.

    The squares of ``image``, whose first is (``left``, ``top``), are ``factor`` times as large as
    those of the crop. Between their middles it is interpolated linearly.
    """
    parts: list[tuple[slice, int, int]] = []
    places: list[slice] = []
    for first, count, start, size in (
        (top, image.shape[0], crop[1], crop[3]),
        (left, image.shape[1], crop[0], crop[2]),
    ):
        begin = max(first * factor, start)
        end = max(min((first + count) * factor, start + size), begin)
        places.append(slice(begin - start, end - start))
        # One square more on each side to interpolate with.
        needed = slice(max(begin // factor - first - 1, 0), -(-end // factor) - first + 1)
        parts.append((needed, begin - (needed.start + first) * factor, end - begin))
    (rows, row, height), (columns, column, width) = parts
    image = image[rows, columns]
    while factor > 1 and image.size:
        image = _doubled(_doubled(image, 0), 1)
        factor //= 2
    return image[row : row + height, column : column + width], places[0], places[1]


def _doubled(image: np.ndarray, axis: int) -> np.ndarray:
    """Twice as many squares along an axis, interpolated linearly between their middles."""
    image = np.moveaxis(image, axis, 0)
    padded = np.concatenate([image[:1], image, image[-1:]])
    result = np.empty((2 * len(image), *image.shape[1:]), dtype=image.dtype)
    result[0::2] = 0.75 * image + 0.25 * padded[:-2]
    result[1::2] = 0.75 * image + 0.25 * padded[2:]
    return np.moveaxis(result, 0, axis)
