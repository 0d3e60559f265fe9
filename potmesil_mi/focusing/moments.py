"""Moments: where in its subpixel the light of fragments is.

A film's reconstruction filter responds to where in a pixel light arrives. Over a subpixel its
response is nearly a polynomial; what that needs to know of many samples are their moments, the
sums of their light times Legendre polynomials of their places. The box filter needs none, but
circles as small as a subpixel respond to it, too.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

DEGREES = {1: 2}
"""Degree of the polynomials for so many subpixels on a side of a pixel."""

FINER_DEGREE = 1
"""Degree for more subpixels."""

NODES = 32
"""Places on a side of a subpixel at which a filter is asked for its response."""


def degree_for(subpixels: int) -> int:
    """The degree of the polynomials for ``subpixels`` on a side of a pixel."""
    return DEGREES.get(subpixels, FINER_DEGREE)


def orders(degree: int) -> list[tuple[int, int]]:
    """The orders (across, down) of the moments of a degree, without that of order 0."""
    return [(i - j, j) for i in range(1, degree + 1) for j in range(i + 1)]


def degree_with(moments: int) -> int:
    """The degree of which there are so many moments."""
    return next(n for n in itertools.count() if len(orders(n)) == moments)


def legendre(order: int, at: Any) -> Any:
    """Legendre polynomials of order 0 to 2 at places from -1 to 1; also of Dr.Jit arrays."""
    return (1.0, at, 1.5 * at * at - 0.5)[order]


def responses(
    response: Callable[[np.ndarray], np.ndarray], middles: np.ndarray, width: float, degree: int
) -> np.ndarray:
    """What the orders up to ``degree`` of subpixels count in a pixel, float64 (degree + 1, n).

    ``middles``, (n,), are where the subpixels of a ``width`` are from the pixel's centre, in
    pixels. The response over a subpixel is fitted by polynomials, with the least mean square error.
    """
    at, weight = np.polynomial.legendre.leggauss(NODES)
    there = response(middles[:, None] + at * width / 2)
    return np.stack(
        [there @ (weight * legendre(k, at)) * (2 * k + 1) / 2 for k in range(degree + 1)]
    )


def limited(taps: np.ndarray) -> np.ndarray:
    """Responses, (degree + 1, n), that fall to half their mean at the lowest in each subpixel.

    A product of two, for across and down, without the terms above the degree, may be negative where
    the filter is not: what is beside something very bright would be black. That of two of these is
    not.
    """
    at = np.linspace(-1, 1, NODES + 1)
    above = np.stack([legendre(k, at) * np.ones_like(at) for k in range(1, len(taps))])
    fall = -(taps[1:].T @ above).min(axis=-1)
    share = taps[0] / 2 / np.maximum(fall, np.finfo(float).tiny)
    return np.concatenate([taps[:1], taps[1:] * np.clip(share, 0, 1)])
