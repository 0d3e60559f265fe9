"""The film: pixels from subpixels, by its reconstruction filter."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import numpy as np

from .. import _backend as jit


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


def reconstruct(
    fine: np.ndarray,
    weights: np.ndarray,
    subpixels: int,
    rfilter: ReconstructionFilter | None = None,
) -> np.ndarray:
    """Pixels (h, w, C) of a film from ``subpixels`` x ``subpixels`` values in each, (H, W, C).

    A pixel is the mean of the subpixels under its filter (box by default), each weighted by
    ``weights``, float (H, W). Where all weights are 0 it is 0.
    """
    if subpixels == 1 and (rfilter is None or rfilter.is_box_filter()):
        return fine
    radius, response = _response(rfilter)
    margin = max(0, math.ceil((radius - 0.5) * subpixels))
    taps = response((np.arange(-margin, subpixels + margin) + 0.5) / subpixels - 0.5).tolist()

    def filtered(values: np.ndarray) -> np.ndarray:
        for axis in (0, 1):
            values = np.moveaxis(values, axis, 0)
            padded = np.pad(values, [(margin, margin)] + [(0, 0)] * (values.ndim - 1))
            stop = len(values)
            values = sum(
                tap * padded[start : start + stop : subpixels] for start, tap in enumerate(taps)
            )
            values = np.moveaxis(values, 0, axis)
        return values

    weights = weights[..., None]
    total = filtered(weights)
    return filtered(fine * weights) / np.where(total == 0, 1, total)


def _response(
    rfilter: ReconstructionFilter | None,
) -> tuple[float, Callable[[np.ndarray], np.ndarray]]:
    """Radius in pixels and response of a filter."""
    if rfilter is None or rfilter.is_box_filter():
        return 0.5, np.ones_like
    return rfilter.radius(), lambda x: np.array(rfilter.eval(jit.Float(x)), dtype=np.float64)
