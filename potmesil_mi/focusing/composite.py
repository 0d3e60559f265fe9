"""Compositing: slices of a picture are put behind each other, from the nearest to the farthest.

A slice gets no more of a subpixel than those before it have left of it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.ndimage

from ..samples.raster import Window
from .convolve import ROWS
from .film import FinePicture
from .fragments import SHARE
from .kernels import SUBPIXEL_VARIANCE

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
    ``is_sharp``; its pixels are subpixels, and it may have ``moments``, float32 (H, W, C) each.
    """

    light: np.ndarray
    left: int
    top: int
    resolution: int
    is_sharp: bool = False
    moments: Sequence[np.ndarray] = ()


class Compositor:
    """A picture that is formed from the nearest slice to the farthest.

    ``crop`` is what the picture shows, in subpixels of the samples' window; ``channels`` are R, G,
    B, the share of what is covered, and perhaps alpha. The samples have a ``density``, (H, W),
    ``None`` where it is even, and ``moments``, (H, W, K), see
    :class:`potmesil_mi.focusing.density.Evened`; a pixel has ``subpixels`` on a side.
    """

    def __init__(
        self,
        crop: Window,
        channels: int,
        subpixels: int = 1,
        density: np.ndarray | None = None,
        moments: np.ndarray | None = None,
    ) -> None:
        self.crop, self.subpixels, self.density = crop, subpixels, density
        self.moments = [] if moments is None else list(np.moveaxis(moments, -1, 0))
        # What is covered adds up in the column of shares.
        self.total = np.zeros((*crop.shape, channels), dtype=np.float32)
        # What there was in the total when what is sharp had been added.
        self.up_to_sharp: np.ndarray | None = None
        # Of what is sharp: its part of the total, and each moment.
        terms = 0 if density is None and not self.moments else 1 + len(self.moments)
        self.sharp = np.zeros((terms, *crop.shape, channels), dtype=np.float32)

    def put_behind(self, slices: Sequence[SpreadSlice]) -> None:
        """Put the light of slices that are at about one depth where there is still room for it."""
        parts = [_Overlap.of(each, self.crop) for each in slices]
        parts = [part for part in parts if not part.place.is_empty]
        if not parts:
            return
        left, top = min(part.place.left for part in parts), min(part.place.top for part in parts)
        right = max(part.place.right for part in parts)
        bottom = max(part.place.bottom for part in parts)
        for start in range(top, bottom, ROWS):
            rows = Window(left, start, right - left, min(start + ROWS, bottom) - start)
            if len(parts) == 1:
                light = parts[0].rows(rows.top, rows.bottom)
                sharp = parts[0].sharp_rows(rows.top, rows.bottom)
                self._admit(light, rows, sharp)
            else:
                self._admit(self._sum(parts, rows), rows)
        if any(each.is_sharp for each in slices):
            self.up_to_sharp = self.total.copy()

    def _sum(self, parts: Sequence[_Overlap], rows: Window) -> np.ndarray:
        """The light of several parts in some rows, float32 (H, W, C)."""
        light = np.zeros((*rows.shape, self.total.shape[-1]), np.float32)
        for part in parts:
            first, end = max(rows.top, part.place.top), min(rows.bottom, part.place.bottom)
            if first < end:
                there = Window(part.place.left, first, part.place.width, end - first)
                light[there.slices_in(rows)] += part.rows(first, end)
        return light

    def _admit(self, light: np.ndarray, rows: Window, sharp: Sequence[np.ndarray] = ()) -> None:
        """Add the part of ``light``, which becomes that part, for which there is room.

        ``sharp`` is the light again, and its moments, if it is so.
        """
        place = rows.slices_in(Window(0, 0, *self.total.shape[1::-1]))
        np.maximum(light, 0, out=light)
        nearer, share = self.total[place], light[..., SHARE]
        admitted = (1 - nearer[..., SHARE]) / np.maximum(share, FAINTEST)
        np.clip(admitted, 0, 1, out=admitted)
        admitted[share <= FAINTEST] = 0
        for total, of_sharp in zip(self.sharp, sharp, strict=False):
            total[place] += of_sharp * admitted[..., None]
        light *= admitted[..., None]
        nearer += light

    def finished(self) -> FinePicture:
        """The picture. Where no light came it is 0 and counts nothing."""
        self._fill()
        colours = [i for i in range(self.total.shape[-1]) if i != SHARE]
        lit = self.total[..., SHARE] > FAINTEST
        picture = np.empty((*lit.shape, len(colours)), dtype=np.float32)
        for start in range(0, len(picture), ROWS):
            rows = slice(start, start + ROWS)
            covered = np.where(lit[rows], self.total[rows, :, SHARE], np.inf)
            for to, of in enumerate(colours):
                np.divide(self.total[rows, :, of], covered, out=picture[rows, :, to])
        if len(self.sharp) == 0:
            return FinePicture(picture, lit.astype(np.float32))
        return self._placed(picture, lit.astype(np.float32)[..., None], colours)

    def _fill(self) -> None:
        """Let what is behind what is sharp fill the subpixels, as far as something is there.

        What is sharp covers just what its samples say. What shows beside it is known less well: at
        an edge a little of it is missing, and more of the edge is not to show instead.
        """
        if self.up_to_sharp is None:
            return
        for start in range(0, len(self.total), ROWS):
            total = self.total[start : start + ROWS]
            behind = total - self.up_to_sharp[start : start + ROWS]
            share = np.maximum(behind[..., SHARE], FAINTEST)
            more = np.clip((1 - total[..., SHARE]) / share, 0, MOST_FILLED)
            total += behind * more[..., None]

    def _placed(self, picture: np.ndarray, lit: np.ndarray, colours: list[int]) -> FinePicture:
        """The picture with its weights and moments.

        What is sharp has its own moments. What is blurred has light all over its subpixels: it gets
        the moments of the samples that are not those of what is sharp.
        """
        scale = (1 / np.maximum(self.total[..., SHARE, None], FAINTEST)).astype(np.float32)
        sharp = self.sharp[0] * scale
        weight = lit * self._counts(sharp[..., SHARE])[..., None]
        if not self.moments:
            return FinePicture(picture, weight[..., 0])
        rest = np.maximum(1 - sharp[..., SHARE, None], 0)
        blurred = picture.copy()
        np.divide(picture - sharp[..., colours], rest, where=rest > FAINTEST_BLUR, out=blurred)
        blurred = _sharpened(blurred, rest > 0.5)
        picture = sharp[..., colours] + rest * blurred
        scale *= weight
        moments = np.empty((len(self.moments), *picture.shape[:2], len(colours) + 1), np.float32)
        for start in range(0, len(picture), ROWS):
            rows = slice(start, start + ROWS)
            for to, total, of_samples in zip(moments, self.sharp[1:], self.moments, strict=True):
                of_sharp = total[rows] * scale[rows]
                np.multiply(of_samples[rows], weight[rows, :, 0], out=to[rows, :, -1])
                left = to[rows, :, -1] - of_sharp[..., SHARE]
                for channel, of in enumerate(colours):
                    np.multiply(left, blurred[rows, :, channel], out=to[rows, :, channel])
                    to[rows, :, channel] += of_sharp[..., of]
        return FinePicture(picture, weight[..., 0], list(moments))

    def _counts(self, sharp: np.ndarray) -> np.ndarray:
        """What subpixels, of which a share is ``sharp``, (H, W), count in their pixels.

        Near what is sharp they count as densely as they were sampled, as do the samples themselves.
        Elsewhere their light comes from all around, and chance that is their own is but noise.
        """
        if self.density is None:
            return np.ones_like(sharp)
        near = scipy.ndimage.maximum_filter(sharp, 2 * self.subpixels + 1) > FAINTEST_BLUR
        return np.where(near, self.density, 1)


def _sharpened(picture: np.ndarray, known: np.ndarray) -> np.ndarray:
    """What a picture was before it was twice spread by a subpixel, where it is ``known``.

    Gathering spread it, and the film takes the mean of its filter over a subpixel. Beside something
    far brighter what is dark stays nearly as it is.
    """
    result = picture.copy()
    for axis in (0, 1):
        of, to, there = (np.moveaxis(each, axis, 0) for each in (picture, result, known))
        step = (of[1:] - of[:-1]) * of.dtype.type(SUBPIXEL_VARIANCE)
        most = np.minimum(of[1:], of[:-1]) * of.dtype.type(MOST_SHARPENED)
        np.clip(step, -most, most, out=step)
        step *= there[1:] & there[:-1]
        to[1:] += step
        to[:-1] -= step
    return result


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
    sharp: Sequence[np.ndarray]

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
        sharp = [
            of[needed[1], needed[0]] for of in (spread.light, *spread.moments) if spread.is_sharp
        ]
        while factor > 2 and light.size:
            light = _doubled(_doubled(light, 0), 1)
            factor //= 2
        return cls(light, factor, column, row, Window(across, down, width, height), sharp)

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

    def sharp_rows(self, start: int, end: int) -> list[np.ndarray]:
        """What is sharp in rows ``start`` to ``end`` of the crop: light, and its moments."""
        rows = slice(start - self.place.top + self.row, end - self.place.top + self.row)
        columns = slice(self.column, self.column + self.place.width)
        return [of[rows, columns] for of in self.sharp]


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
