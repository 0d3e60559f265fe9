"""The film: pixels from subpixels, by its reconstruction filter."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from .. import _backend as jit
from .convolve import ROWS
from .moments import degree_for, degree_with, orders, responses


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
    """

    picture: np.ndarray
    weights: np.ndarray
    moments: Sequence[np.ndarray] = ()


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
    if subpixels == 1 and (rfilter is None or rfilter.is_box_filter()):
        return fine.picture
    radius, response = _response(rfilter)
    margin = max(0, math.ceil((radius - 0.5) * subpixels))
    middles = (np.arange(-margin, subpixels + margin) + 0.5) / subpixels - 0.5
    degree = degree_with(len(fine.moments))
    if degree > 0:
        taps = responses(response, middles, 1 / subpixels, degree)
    else:
        taps = response(middles)[None]
    weights = fine.weights[..., None]
    light = np.concatenate([fine.picture * weights, weights], axis=-1)
    every = dict(zip([(0, 0), *orders(degree)], [light, *fine.moments], strict=True))
    height, width, channels = light.shape
    total = np.zeros((height // subpixels, width // subpixels, channels), light.dtype)
    for j in range(degree + 1):
        across = np.zeros((height, width // subpixels, channels), light.dtype)
        for start in range(0, height, ROWS):
            rows = slice(start, start + ROWS)
            for i in range(degree + 1 - j):
                _add_filtered(across[rows], every[i, j][rows], 1, taps[i], subpixels)
        _add_filtered(total, across, 0, taps[j], subpixels)
    weight = total[..., -1:]
    return total[..., :-1] / np.where(weight == 0, 1, weight)


def _add_filtered(
    total: np.ndarray, values: np.ndarray, axis: int, taps: np.ndarray, subpixels: int
) -> None:
    """Add pixels from subpixels along an axis, of which each counts what the taps say."""
    margin = (len(taps) - subpixels) // 2
    values, total = np.moveaxis(values, axis, 0), np.moveaxis(total, axis, 0)
    count = len(total)
    for start, tap in enumerate(taps.tolist(), -margin):
        # Pixels whose subpixel there is one of the picture's.
        first = max(0, -(start // subpixels))
        last = min(count, count - start // subpixels)
        if tap != 0 and first < last:
            there = values[start + first * subpixels : start + last * subpixels : subpixels]
            total[first:last] += there * values.dtype.type(tap)


def _response(
    rfilter: ReconstructionFilter | None,
) -> tuple[float, Callable[[np.ndarray], np.ndarray]]:
    """Radius in pixels and response of a filter."""
    if rfilter is None or rfilter.is_box_filter():
        return 0.5, np.ones_like

    def response(x: np.ndarray) -> np.ndarray:
        return np.array(rfilter.eval(jit.Float(x.ravel())), dtype=np.float64).reshape(x.shape)

    return rfilter.radius(), response
