"""The film: pixels from subpixels, by its reconstruction filter."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import drjit as dr
import numpy as np

from .. import _backend as jit
from ..samples.raster import Window
from .moments import NODES, degree_for, degree_with, limited, orders, responses


@runtime_checkable
class ReconstructionFilter(Protocol):
    """What the film asks of a filter; Mitsuba's ``mi.ReconstructionFilter`` has it."""

    def is_box_filter(self) -> bool:
        """Whether it is the mean over the pixel."""
        ...

    def radius(self) -> float:
        """Its radius in pixels."""
        ...

    def eval(self, x: Any, /) -> Any:
        """Its response at the distances ``x``, in pixels, from the pixel's centre."""
        ...


NODES_OF_TABLE = 1 << 16
"""Steps of a filter's table: between them it errs less than a float of single precision."""


@dataclasses.dataclass(frozen=True, eq=False)
class TabulatedFilter:
    """A reconstruction filter as a table, which another process may have; Mitsuba's cannot go.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``box``                       whether it is the mean over the pixel
    ``extent``                    its radius in pixels
    ``values``                    its response at equal steps from 0 to the radius
    ============================  ==========================================================
    """

    box: bool
    extent: float
    values: np.ndarray

    @classmethod
    def of(cls, rfilter: ReconstructionFilter) -> TabulatedFilter:
        """The table of a filter."""
        radius, response = _response(rfilter)
        return cls(
            rfilter.is_box_filter(), radius, response(np.linspace(0, radius, NODES_OF_TABLE + 1))
        )

    def is_box_filter(self) -> bool:
        """Whether it is the mean over the pixel."""
        return self.box

    def radius(self) -> float:
        """Its radius in pixels."""
        return self.extent

    def eval(self, x: Any, /) -> np.ndarray:
        """Its response at the distances ``x``, in pixels, from the pixel's centre."""
        steps = np.linspace(0, self.extent, len(self.values))
        return np.interp(np.abs(np.array(x)), steps, self.values, right=0.0)


class FinePicture(NamedTuple):
    """A picture in subpixels, before the film's reconstruction filter.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``picture``                   float (H, W, C), the mean light of each subpixel
    ``weights``                   float (H, W), what each counts in its pixel
    ``moments``                   for each of :func:`potmesil_mi.focusing.moments.orders`, of
                                  some degree, float (H, W, C + 1), those of the light, and
                                  last of the weights: they tell where in a subpixel these are
    ============================  ==========================================================

    The arrays are NumPy's or Dr.Jit's tensors.
    """

    picture: Any
    weights: Any
    moments: Sequence[Any] = ()


def degree_of(rfilter: ReconstructionFilter | None, subpixels: int) -> int:
    """The degree of the moments from which a filter makes pixels; 0 for a box, the default."""
    return 0 if rfilter is None or rfilter.is_box_filter() else degree_for(subpixels)


def reconstruct(
    fine: FinePicture, subpixels: int, rfilter: ReconstructionFilter | None = None
) -> np.ndarray:
    """Pixels (h, w, C) of a film from ``subpixels`` x ``subpixels`` values in each.

    A pixel is the mean of the light under its filter (box by default), as its weights tell. Where
    all weights are 0 it is 0.
    """
    if _is_finished(subpixels, rfilter):
        return np.asarray(fine.picture)
    height, width, colours = fine.picture.shape
    pixels = np.array(interleaved(reconstruct_channels(fine, subpixels, rfilter)))
    return pixels.reshape(height // subpixels, width // subpixels, colours)


def _is_finished(subpixels: int, rfilter: ReconstructionFilter | None) -> bool:
    """Whether subpixels are pixels, of which each is its own mean."""
    return subpixels == 1 and (rfilter is None or rfilter.is_box_filter())


def reconstruct_channels(
    fine: FinePicture, subpixels: int, rfilter: ReconstructionFilter | None = None
) -> list[jit.Float]:
    """The channels of what :func:`reconstruct` makes, as Dr.Jit arrays, which keep gradients."""
    height, width, colours = fine.picture.shape
    if _is_finished(subpixels, rfilter):
        place = dr.arange(jit.UInt32, height * width)
        return values_at(on_device(fine.picture), place, colours)
    radius, response = _response(rfilter)
    margin = max(0, math.ceil((radius - 0.5) * subpixels))
    middles = (np.arange(-margin, subpixels + margin) + 0.5) / subpixels - 0.5
    degree = degree_with(len(fine.moments))
    if degree > 0:
        taps = responses(response, middles, 1 / subpixels, degree)
    else:
        taps = response(middles)[None]
    light = [_light(fine), *map(on_device, fine.moments)]
    shape = fine.picture.shape
    picture = _filtered_twice(light, taps, subpixels, shape)
    if degree > 0 and response(np.linspace(-radius, radius, NODES)).min() >= 0:
        least = _filtered_twice(light, limited(taps), subpixels, shape)
        picture = [dr.maximum(of, low / 2) for of, low in zip(picture, least, strict=True)]
    return picture


def _filtered_twice(
    light: Sequence[jit.Float], taps: np.ndarray, subpixels: int, shape: tuple[int, ...]
) -> list[jit.Float]:
    """The colours of the pixels: light and its moments, filtered across and down, over its weight.

    ``shape`` is that of the light without its weight. Where all weights are 0 the colours are 0.
    """
    height, width, colours = shape
    degree = len(taps) - 1
    every = dict(zip([(0, 0), *orders(degree)], light, strict=True))
    across = []
    for j in range(degree + 1):
        terms = [every[i, j] for i in range(degree + 1 - j)]
        filtered = _filtered(terms, taps, 1, (height, width), subpixels, colours + 1)
        across.append(interleaved(filtered))
    dr.eval(across)
    narrow = height, width // subpixels
    *sums, weight = _filtered(across, taps, 0, narrow, subpixels, colours + 1)
    weight = dr.select(weight == 0, 1, weight)
    return [of / weight for of in sums]


def on_device(image: Any) -> jit.Float:
    """The values of an image, one after the other, as a Dr.Jit array."""
    return image.array if dr.is_tensor_v(image) else jit.from_numpy(jit.Float, image.ravel())


def rows_and_columns(place: jit.UInt32, width: int) -> tuple[jit.UInt32, jit.UInt32]:
    """Row and column of each ``place`` in an image of that ``width``."""
    columns = dr.opaque(jit.UInt32, width)
    row = place // columns
    return row, place - row * columns


def places_of_crop(crop: Window, box: Window) -> tuple[jit.UInt32, jit.Bool]:
    """Where each subpixel of a ``crop``, row by row, is in an image of a ``box``, and if it is."""
    row, column = rows_and_columns(dr.arange(jit.UInt32, crop.size), crop.width)
    x = jit.Int32(column) + dr.opaque(jit.Int32, crop.left - box.left)
    y = jit.Int32(row) + dr.opaque(jit.Int32, crop.top - box.top)
    width, height = dr.opaque(jit.Int32, box.width), dr.opaque(jit.Int32, box.height)
    inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
    return jit.UInt32(dr.select(inside, y * width + x, 0)), inside


def values_at(image: jit.Float, place: jit.UInt32, channels: int) -> list[jit.Float]:
    """The values of an image of so many channels, which follow each other, at each ``place``."""
    if channels == 4:
        return list(dr.gather(jit.Array4f, image, place))
    return [dr.gather(jit.Float, image, place * channels + c) for c in range(channels)]


def interleaved(values: Sequence[jit.Float]) -> jit.Float:
    """An image of the ``values`` of its channels: those of a place follow each other."""
    if len(values) == 4:
        return dr.ravel(jit.Array4f(*values))
    # A channel is put there after the other: what is not evaluated would be computed for each.
    dr.eval(values)
    size, channels = dr.width(values), len(values)
    image, place = dr.empty(jit.Float, size * channels), dr.arange(jit.UInt32, size) * channels
    for channel, value in enumerate(values):
        dr.scatter(image, value, place + channel)
    return image


def _light(fine: FinePicture) -> jit.Float:
    """The light of a picture as its weights tell, and these as the last channel."""
    height, width, channels = fine.picture.shape
    place = dr.arange(jit.UInt32, height * width)
    weight = dr.gather(jit.Float, on_device(fine.weights), place)
    colours = values_at(on_device(fine.picture), place, channels)
    light = interleaved([*(of * weight for of in colours), weight])
    dr.eval(light)
    return light


def _filtered(
    images: Sequence[jit.Float],
    taps: np.ndarray,
    axis: int,
    shape: tuple[int, int],
    subpixels: int,
    channels: int,
) -> list[jit.Float]:
    """The sum of images of a ``shape``, filtered along an axis, each channel of it.

    Each pixel along the axis has ``subpixels``, and each image its own row of ``taps``.
    """
    height, width = shape
    columns = width // subpixels if axis == 1 else width
    rows = height // subpixels if axis == 0 else height
    row, column = rows_and_columns(dr.arange(jit.UInt32, rows * columns), columns)
    count = dr.opaque(jit.Int32, shape[axis])
    first = jit.Int32(column if axis == 1 else row) * subpixels
    total = [jit.Float(0)] * channels
    for start, of_images in enumerate(taps.T, -((taps.shape[1] - subpixels) // 2)):
        at = first + start
        inside = (at >= 0) & (at < count)
        there = jit.UInt32(dr.clip(at, 0, count - 1))
        place = (row, there) if axis == 1 else (there, column)
        place = place[0] * dr.opaque(jit.UInt32, width) + place[1]
        for image, tap in zip(images, of_images.tolist(), strict=False):
            share = dr.select(inside, dr.opaque(jit.Float, tap), 0)
            values = values_at(image, place, channels)
            total = [dr.fma(of, share, sum_) for of, sum_ in zip(values, total, strict=True)]
    return total


def _response(
    rfilter: ReconstructionFilter | None,
) -> tuple[float, Callable[[np.ndarray], np.ndarray]]:
    """Radius in pixels and response of a filter."""
    if rfilter is None or rfilter.is_box_filter():
        return 0.5, np.ones_like

    def response(x: np.ndarray) -> np.ndarray:
        return np.array(
            rfilter.eval(jit.from_numpy(jit.Float, x.ravel())), dtype=np.float64
        ).reshape(x.shape)

    return rfilter.radius(), response
