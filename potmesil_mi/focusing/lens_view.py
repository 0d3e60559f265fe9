"""What the points of a lens see of elements: :class:`Layers`.

It is found once for an aperture, before the lens is focused.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Any

import mitsuba as mi
import numpy as np
import scipy.ndimage

from ..optics.lens import ThinLens
from ..optics.psf import Aperture
from ..samples.point_samples import PointSamples
from .fragments import SHARE, Elements
from .visibility import Turns, visibility, visibility_of_few

BRIGHT = 8
"""Elements so many times as bright as most show the shape of the lens where they are blurred."""

BRIGHT_BESIDE, NEIGHBOURHOOD = 6, 33
"""And so many times as bright as the mean of so many squares each way around them."""

MOST_BRIGHT = 1 << 14
"""Most elements that are seen from ``MORE`` times as many lens points because they are bright."""

MORE = 16

LEAST_SEEN = 8
"""What the innermost point of the lens sees at least, of 255, of what the pinhole sees."""


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
        return Layers(whole, self.partial.coarser(factor), self.bright)

    @property
    def elements(self) -> list[Elements]:
        """All that there are."""
        return [self.whole, self.partial.elements, self.bright.elements]

    @functools.cached_property
    def counts(self) -> np.ndarray:
        """How many elements each bin has."""
        counts = [np.bincount(elements.bin) for elements in self.elements]
        longest = max(len(count) for count in counts)
        return np.sum([np.pad(count, (0, longest - len(count))) for count in counts], axis=0)

    @functools.cached_property
    def vergences(self) -> tuple[np.ndarray, np.ndarray]:
        """The bins that have elements of ``whole``, and the mean vergence of these."""
        counts = np.bincount(self.whole.bin)
        bins = np.flatnonzero(counts)
        return bins, np.bincount(self.whole.bin, self.whole.vergence)[bins] / counts[bins]

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
    red, green, blue = elements.values.T[:SHARE]
    peak = np.maximum(np.maximum(red, green), blue)
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
        "bin": mi.UInt32(elements.bin),
        "values": mi.Float(np.ascontiguousarray(values[:, :4]).ravel()),
    }
    if values.shape[1] > 4:
        columns["alpha"] = mi.Float(np.ascontiguousarray(values[:, 4]))
    return columns
