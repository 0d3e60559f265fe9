"""Compositing: slices of a picture are put behind each other, from the nearest to the farthest.

A slice gets no more of a subpixel than those before it have left of it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import drjit as dr
import numpy as np

from .. import _backend as jit
from .._threads import for_each
from ..samples.raster import Window
from .film import (
    FinePicture,
    interleaved,
    on_device,
    places_of_crop,
    rows_and_columns,
    values_at,
)
from .fragments import SHARE
from .kernels import SUBPIXEL_VARIANCE

ROWS = 32
"""Rows of an image that are worked on at once: they stay in the processor's cache."""

FAINTEST = 1e-5
"""Share of a subpixel below which nothing is told from the rounding of the transforms."""


MOST_FILLED = 0.5
"""Part by which light behind what is sharp is made brighter to fill a subpixel, at most."""

FAINTEST_BLUR = 1e-2
"""Share of a subpixel below which the colour of what is blurred is not told from rounding."""


MOST_SHARPENED = 0.25
"""Part of its light by which a subpixel is made darker for one beside it, at most."""


class SpreadSlice(NamedTuple):
    """The light of a depth slice after it was spread.

    ``light`` is float32 (H, W, C), RGB, share and perhaps alpha, on pixels ``resolution``
    subpixels wide, of which ``left`` and ``top`` are the first. What is nearly in focus
    ``is_sharp``: it is one slice, alone at its depth; its pixels are subpixels, and it may have
    ``moments``, float32 (H, W, C) each.
    """

    light: np.ndarray
    left: int
    top: int
    resolution: int
    is_sharp: bool = False
    moments: Sequence[np.ndarray] = ()

    @property
    def box(self) -> Window:
        """Its pixels, in pixels of the slice."""
        return Window(self.left, self.top, *self.light.shape[1::-1])


class Compositor:
    """A picture that is formed from the nearest slice to the farthest.

    ``crop`` is what the picture shows, in subpixels of the samples' window; ``channels`` are R, G,
    B, the share of what is covered, and perhaps alpha. The samples have a ``density``, (H, W),
    ``None`` where it is even, and ``moments``, (H, W, K), see
    :class:`potmesil_mi.focusing.density.Evened`; a pixel has ``subpixels`` on a side. If it
    ``is_tile`` what is nearly in focus may be in other tiles alone.
    """

    def __init__(
        self,
        crop: Window,
        channels: int,
        subpixels: int = 1,
        density: np.ndarray | None = None,
        moments: np.ndarray | None = None,
        is_tile: bool = False,
    ) -> None:
        self.crop, self.subpixels, self.density, self.moments = crop, subpixels, density, moments
        self.is_tile = is_tile
        # What is covered adds up in the column of shares, and with all that is behind in a plane.
        self.total = np.zeros((*crop.shape, channels), dtype=np.float32)
        self.covered = np.zeros(crop.shape, dtype=np.float32)
        # What is sharp, of whose light there is the part that was admitted, and what is behind it.
        self.sharp: SpreadSlice | None = None
        self.admitted = np.zeros(crop.shape, dtype=np.float32)
        self.behind: np.ndarray | None = None

    def put_behind(self, slices: Sequence[SpreadSlice]) -> None:
        """Put the light of slices that are at about one depth where there is still room for it."""
        parts = [_Overlap.of(each, self.crop) for each in slices]
        parts = [part for part in parts if not part.place.is_empty]
        if not parts:
            if self.is_tile and slices and slices[0].is_sharp:
                self.sharp = slices[0]
            return
        left, top = min(part.place.left for part in parts), min(part.place.top for part in parts)
        right = max(part.place.right for part in parts)
        bottom = max(part.place.bottom for part in parts)
        if self.sharp is not None and self.behind is None:
            self.behind = np.zeros_like(self.total)
        for start in range(top, bottom, ROWS):
            rows = Window(left, start, right - left, min(start + ROWS, bottom) - start)
            if len(parts) == 1:
                light = parts[0].rows(rows.top, rows.bottom)
            else:
                light = self._sum(parts, rows)
            self._admit(light, rows, slices[0].is_sharp)
        if slices[0].is_sharp:
            self.sharp = slices[0]

    def _sum(self, parts: Sequence[_Overlap], rows: Window) -> np.ndarray:
        """The light of several parts in some rows, float32 (H, W, C)."""
        light = np.zeros((*rows.shape, self.total.shape[-1]), np.float32)
        for part in parts:
            first, end = max(rows.top, part.place.top), min(rows.bottom, part.place.bottom)
            if first < end:
                there = Window(part.place.left, first, part.place.width, end - first)
                light[there.slices_in(rows)] += part.rows(first, end)
        return light

    def _admit(self, light: np.ndarray, rows: Window, is_sharp: bool) -> None:
        """Add the part of ``light``, which becomes that part, for which there is room.

        If it ``is_sharp``, the parts that were admitted are kept for its moments.
        """
        place = rows.slices_in(Window(0, 0, *self.crop[2:]))
        covered, share = self.covered[place], light[..., SHARE]
        # A veil's light may be negative in one sample and not in the mean: it is not clipped.
        np.maximum(share, 0, out=share)
        admitted = (1 - covered) / np.maximum(share, FAINTEST)
        np.clip(admitted, 0, 1, out=admitted)
        admitted[share <= FAINTEST] = 0
        if is_sharp:
            self.admitted[place] = admitted
        light *= _in_each_channel(admitted, light.shape[-1])
        covered += light[..., SHARE]
        nearer = self.total if self.behind is None else self.behind
        nearer[place] += light

    def finished(self) -> FinePicture:
        """The picture. Where no light came it is 0 and counts nothing."""
        colours = [i for i in range(self.total.shape[-1]) if i != SHARE]
        picture = np.empty((*self.crop.shape, len(colours)), dtype=np.float32)

        def finish(start: int) -> None:
            rows = slice(start, start + ROWS)
            total, covered = self.total[rows], self.covered[rows]
            if self.behind is not None:
                _fill(total, self.behind[rows], covered)
            covered[:] = total[..., SHARE]
            there = np.where(covered > FAINTEST, covered, np.inf)
            for to, of in enumerate(colours):
                np.divide(total[..., of], there, out=picture[rows, :, to])

        for_each(finish, range(0, len(picture), ROWS))
        weights = self._weights()
        if self.moments is None:
            return FinePicture(picture, weights)
        return self._placed(picture, weights, self.moments)

    def _weights(self) -> np.ndarray:
        """What subpixels count in their pixels, see :func:`weights_of`."""
        share = None
        if self.sharp is not None:
            share = np.zeros(self.crop.shape, np.float32)
            both = self.sharp.box.intersection(self.crop)
            of_sharp = self.sharp.light[both.slices_in(self.sharp.box)]
            share[both.slices_in(self.crop)] = of_sharp[..., SHARE]
        alone = self.subpixels == 1 and self.moments is None  # The only one in its pixel.
        return weights_of(self.covered, share, self.density, self.subpixels, alone=alone)

    def _placed(
        self, picture: np.ndarray, weights: np.ndarray, of_samples: np.ndarray
    ) -> FinePicture:
        """The picture with its weights and moments.

        What is sharp has its own moments. What is blurred has light all over its subpixels: it gets
        the moments of the samples that are not those of what is sharp.
        """
        shape, count = picture.shape, picture.shape[-1]
        colours = [*range(SHARE), *range(SHARE + 1, count + 1)]
        place = dr.arange(jit.UInt32, self.crop.size)
        scale = 1 / dr.maximum(jit.from_numpy(jit.Float, self.covered.ravel()), FAINTEST)
        light = None if self.sharp is None else self.sharp.light
        sharp = [of * scale for of in self._of_sharp(light)]
        rest = dr.maximum(1 - sharp[SHARE], 0)
        blurred = [
            dr.select(rest > FAINTEST_BLUR, (value - sharp[of]) / rest, value)
            for value, of in zip(values_at(on_device(picture), place, count), colours, strict=True)
        ]
        image = interleaved([*blurred, rest])
        dr.eval(image, scale, sharp)
        *blurred, rest = _sharpened(image, place, self.crop, count + 1)
        found = [
            interleaved([sharp[of] + rest * b for b, of in zip(blurred, colours, strict=True)])
        ]
        weight = jit.from_numpy(jit.Float, weights.ravel())
        scale = scale * weight * jit.from_numpy(jit.Float, self.admitted.ravel())
        moments = () if self.sharp is None else self.sharp.moments
        for term, own in enumerate(values_at(on_device(of_samples), place, of_samples.shape[-1])):
            image = moments[term] if moments else None
            of_sharp = [of * scale for of in self._of_sharp(image)]
            left = own * weight - of_sharp[SHARE]
            values = [left * b + of_sharp[of] for b, of in zip(blurred, colours, strict=True)]
            found.append(interleaved([*values, own * weight]))
        dr.eval(found)
        shapes = [shape, *[(*shape[:2], count + 1)] * (len(found) - 1)]
        tensors = [jit.TensorXf(of, size) for of, size in zip(found, shapes, strict=True)]
        return FinePicture(tensors[0], weights, tensors[1:])

    def _of_sharp(self, image: np.ndarray | None) -> list[jit.Float]:
        """The values of an image of the sharp slice, if there is one, in the crop.

        They are 0 where it is not.
        """
        channels = self.total.shape[-1]
        if self.sharp is None or image is None:
            return [jit.Float(0)] * channels
        there, inside = places_of_crop(self.crop, self.sharp.box)
        values = values_at(on_device(image), there, channels)
        return [dr.select(inside, value, 0) for value in values]


def weights_of(
    covered: np.ndarray,
    sharp: np.ndarray | None,
    density: np.ndarray | None,
    subpixels: int,
    *,
    alone: bool,
) -> np.ndarray:
    """What subpixels count in their pixels, float32 (H, W).

    Near what is sharp, whose share of each is given, they count as densely as they were sampled,
    as do the samples themselves. Elsewhere their light comes from all around, and chance that is
    their own is but noise; so it is where one is ``alone`` in its pixel.
    """
    lit = (covered > FAINTEST).astype(np.float32)
    if density is None or sharp is None or alone:
        return lit
    near = sharp > FAINTEST_BLUR * np.maximum(covered, FAINTEST)
    for of in (near, near.T):
        grown = of.copy(order="K")
        for step in range(1, subpixels + 1):
            grown[step:] |= of[:-step]
            grown[:-step] |= of[step:]
        of[:] = grown
    return np.where(near, density * lit, lit)


def _in_each_channel(plane: np.ndarray, channels: int) -> np.ndarray:
    """A plane, (H, W), in each channel of an image, (H, W, C).

    NumPy multiplies by this faster than by a plane for which it has to repeat each element.
    """
    image = np.empty((*plane.shape, channels), plane.dtype)
    for channel in range(channels):
        image[..., channel] = plane
    return image


def _fill(total: np.ndarray, behind: np.ndarray, covered: np.ndarray) -> None:
    """Add what is ``behind`` what is sharp, so that it fills the subpixels as far as it is there.

    What is sharp covers just what its samples say. What shows beside it is known less well: at
    an edge a little of it is missing, and more of the edge is not to show instead.
    """
    more = (1 - covered) / np.maximum(behind[..., SHARE], FAINTEST)
    np.clip(more, 0, MOST_FILLED, out=more)
    more += 1
    behind *= _in_each_channel(more, behind.shape[-1])
    total += behind


def _sharpened(
    image: jit.Float, place: jit.UInt32, raster: Window, channels: int
) -> list[jit.Float]:
    """What a picture was before it was twice spread by a subpixel, at each ``place`` of a raster.

    Gathering spread it, and the film takes the mean of its filter over a subpixel. Beside something
    far brighter what is dark stays nearly as it is. The last of the ``channels`` is the share of it
    in the subpixels: it stays as it is, and so does the picture where it is the smaller part.
    """
    row, column = rows_and_columns(place, raster.width)
    *own, share = values_at(image, place, channels)
    result = list(own)
    for at, count, stride in ((row, raster.height, raster.width), (column, raster.width, 1)):
        step = dr.opaque(jit.UInt32, stride)
        for inside, beside in (
            (at > 0, place - step),
            (at + 1 < dr.opaque(jit.UInt32, count), place + step),
        ):
            *others, its_share = values_at(image, dr.select(inside, beside, place), channels)
            known = (share > 0.5) & (its_share > 0.5)
            for channel, (value, other) in enumerate(zip(own, others, strict=True)):
                most = dr.maximum(dr.minimum(value, other), 0) * MOST_SHARPENED
                moved = dr.clip((other - value) * SUBPIXEL_VARIANCE, -most, most)
                result[channel] = result[channel] - dr.select(known, moved, 0)
    return [*result, share]


@dataclasses.dataclass(frozen=True)
class _Overlap:
    """The part of a slice that lies in the crop.

    ``place`` is where it lies, in subpixels of the crop; ``column`` and ``row`` are where it begins
    in ``light``, whose pixels are 1 or 2 (then ``resolution``) subpixels wide.
    """

    light: np.ndarray
    resolution: int
    column: int
    row: int
    place: Window

    @classmethod
    def of(cls, spread: SpreadSlice, crop: Window) -> _Overlap:
        light, factor = spread.light, spread.resolution
        needed: list[slice] = []
        parts: list[tuple[int, int, int]] = []
        for first, count, start, size in (
            (spread.left, light.shape[1], crop.left, crop.width),
            (spread.top, light.shape[0], crop.top, crop.height),
        ):
            begin = max(first * factor, start)
            end = max(min((first + count) * factor, start + size), begin)
            # One pixel more on each side to interpolate with.
            needed.append(slice(max(begin // factor - first - 1, 0), -(-end // factor) - first + 1))
            parts.append((begin - (needed[-1].start + first) * factor, begin - start, end - begin))
        (column, across, width), (row, down, height) = parts
        light = light[needed[1], needed[0]]
        while factor > 2 and light.size:
            light = _doubled(_doubled(light, 0), 1)
            factor //= 2
        return cls(light, factor, column, row, Window(across, down, width, height))

    def rows(self, start: int, end: int) -> np.ndarray:
        """Rows ``start`` to ``end`` of the crop, with no more than the columns of the overlap.

        Between the middles of larger pixels they are interpolated linearly.
        """
        columns = slice(self.column, self.column + self.place.width)
        start, end = start - self.place.top + self.row, end - self.place.top + self.row
        if self.resolution == 1:
            return self.light[start:end, columns]
        first = max(start // 2 - 1, 0)
        rows = self.light[first : (end + 1) // 2 + 1]
        return _doubled(_doubled(rows, 0)[start - 2 * first : end - 2 * first], 1)[:, columns]


def _doubled(image: np.ndarray, axis: int) -> np.ndarray:
    """Twice as many pixels along an axis, 0 or 1, interpolated linearly between their middles."""
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
