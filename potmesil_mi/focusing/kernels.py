"""Tables by which squares of light are spread: arrays (H, W), their middle the square's own.

Where a short row of weights does, along both axes one after the other, the table is that row (n,).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np
import scipy.optimize
import scipy.signal

from ..optics.psf import Aperture, disc_table

SQUARE, LINEAR = 1 / 12, 1 / 6
"""Variance along an axis of a square, and of what is shared linearly by the squares around it."""

MIDDLE = (0.5, 0.5)

CELL_ROW = 4 / 3
"""Variance in squares up to which a cell is spread by a row."""

FITTED_ROW = 0.5
"""Variance in squares up to which a row stands for the table of a circle."""

FITTED_FINER, FITTED_REACH = 8, 2
"""So much finer is the table to which a row is fitted, of so many squares on each side."""


@functools.lru_cache(maxsize=256)
def cell_table(radius: float) -> np.ndarray:
    """What spreads a lens point's share over its cell: of a disc's variance, but smoother.

    It is a disc spread by an equal one, whose spectrum has no ripples to make rings of the points.
    """
    variance = radius**2 / 4
    if variance < CELL_ROW:
        return _row(variance)
    half = disc_table(2 * math.sqrt(variance / 2 - SQUARE))
    table = scipy.signal.convolve2d(half, half)
    table.setflags(write=False)
    return table


@functools.lru_cache(maxsize=256)
def circle_table(
    aperture: Aperture,
    radius: float,
    squeeze: float,
    smeared: float,
    largest: tuple[int, int] | None,
) -> np.ndarray:
    """The table of an aperture's circles of a signed radius in squares, see :func:`without`."""

    def scaled(finer: float) -> np.ndarray:
        most = None if largest is None else (round(largest[0] * finer), round(largest[1] * finer))
        return aperture.circle_table(radius * finer, squeeze, MIDDLE, most)

    across, down = aperture.variances
    table = without(smeared, scaled, radius**2 * (across / squeeze**2 + down) / 2)
    table.setflags(write=False)
    return table


def without(
    smeared: float, table: Callable[[float], np.ndarray], variance: float | None = None
) -> np.ndarray:
    """A table that spreads squares as the point-spread function spreads points.

    ``table(s)`` gives the integrals over squares, for a distribution s times as large: they
    smear it by a square, as gathering samples by square has done already. So, and for what
    else has ``smeared`` it, a variance along an axis, the distribution, whose ``variance`` is
    measured if it is not given, is made smaller. Of what is hardly larger than a square the
    variance tells too little: there a row is fitted.
    """
    if variance is None:
        kernel = table(1.0)
        # Of a few squares a table does not tell it: ask for it on squares a 16th as large.
        small = max(kernel.shape) <= 11
        variance = _variance(table(16.0)) / 256 if small else _variance(kernel) - SQUARE
    left = max(variance - smeared, 0)
    if left < FITTED_ROW:
        return _fitted_row(table(FITTED_FINER))
    return table(math.sqrt((left - SQUARE) / variance))


def _row(variance: float) -> np.ndarray:
    """A row of a variance, nearly a normal distribution."""
    row = np.ones(1)
    times = math.ceil(3 * variance)
    for _ in range(times):
        share = variance / times / 2
        row = np.convolve(row, [share, 1 - 2 * share, share])
    return row


def _fitted_row(fine: np.ndarray) -> np.ndarray:
    """The row, nowhere negative, that spreads pictures most like a distribution.

    ``fine`` is the table of the distribution on squares ``FITTED_FINER`` times as fine. The row
    has the least mean square error where the power of what is in a picture falls off as
    1/f^2, as it does in pictures of edges, gathered by square.
    """
    frequency = np.linspace(0.005, 2, 400)[:, None]  # a square
    transform = np.zeros(len(frequency))
    for share in (fine.sum(axis=0), fine.sum(axis=1)):
        place = (np.arange(len(share)) - len(share) // 2) / FITTED_FINER
        transform += np.cos(2 * np.pi * frequency * place) @ share / 2
    transform /= np.sinc(frequency[:, 0] / FITTED_FINER)
    amplitude = np.sinc(frequency) / frequency
    steps = 1 + np.arange(FITTED_REACH)
    response = 2 * np.cos(2 * np.pi * frequency * steps) - 2
    fitted, _ = scipy.optimize.nnls(response * amplitude, (transform - 1) * amplitude[:, 0])
    fitted = np.trim_zeros(fitted, "b")
    return np.concatenate([fitted[::-1], [1 - 2 * fitted.sum()], fitted])


def _variance(table: np.ndarray) -> float:
    """Mean variance along rows and columns."""
    rows, columns = (np.arange(n) - n // 2 for n in table.shape)
    return float((table.sum(axis=1) @ rows**2 + table.sum(axis=0) @ columns**2) / 2)
