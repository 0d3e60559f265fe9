"""Sums over Bessel functions, of which Lommel's and Wolf's series are made.

All are by recurrence over the order, of as many orders as matter: about 40 / |ln(v/u)|, and near
the shadow's edge, where that is more than v, v + 12 v^(1/3) + 40. So much is the work for each
point; the memory is that of a few arrays of the result's size.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from scipy.special import gammaln, j0, j1, jv

Weights = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Factors of the terms of two sums, (K, S) each, for an array of S numbers of terms."""

NATS = 40.0
"""Terms of a sum that are exp(-NATS) of the first ones, 4e-18, are left out."""

BLOCK = 16
"""Orders of Bessel functions that are summed at once: even."""

CHUNK = 4096
"""Points that are summed at once: ``BLOCK`` times as many numbers stay in a processor's cache."""


def each_once(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The weights of a plain sum: every term counts once."""
    return np.ones((1, len(s))), np.ones((1, len(s)))


def wolf_sums(tau: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Σ (-1)^s τ^2s Q_2s(v) / (2s+1), and Y₁ and Y₂ = Σ (-1)^s (n+2s) τ^(n+2s) J_{n+2s}(v)."""
    even, odd = pair_sums(tau, v, 2, _wolf_weights)
    x = -(tau**2)
    first, second = j0(v), j1(v)
    # Over s, the terms c_2s and c_{2s+2} of neighbours are taken together.
    q = first**2 + 2 * first * even[0]
    q += v * (first * (x * odd[1] - odd[0]) - second * (x * even[2] - even[1]))
    return q, tau * (second + x * odd[2]), tau**2 * even[3]


def _wolf_weights(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    low = 1 / ((2 * s + 1) * (2 * s + 2))
    high = 1 / ((2 * s + 2) * (2 * s + 3))
    return np.array([1 / (2 * s + 1), low, high, 2 * s + 2]), np.array([low, high, 2 * s + 3])


def pair_sums(
    tau: np.ndarray, v: np.ndarray, first: int, weights: Weights
) -> tuple[np.ndarray, np.ndarray]:
    """Σ_s a_s x^s J_{first+2s}(v) and Σ_s b_s x^s J_{first+2s+1}(v) with x = -τ², 0 <= τ <= 1.

    ``weights`` gives a and b, (K, S) each, for an array of S values of s; so the results have the
    shapes (K, N). Points are taken in the order of how many terms they need, for these are many
    only near τ = 1.
    """
    most, least = weights(np.arange(BLOCK // 2))
    even, odd = np.empty((len(most), len(v))), np.empty((len(least), len(v)))
    with np.errstate(divide="ignore"):
        terms = first + 2 + NATS / np.abs(np.log(tau))
    tiny = v < 1e-8
    # Upwards the recurrence is stable only to the order v.
    upwards = ~tiny & (terms <= v)
    downwards = ~tiny & ~upwards
    orders = np.where(upwards, terms, v + 12 * np.cbrt(v) + 20)
    for wanted, sums in ((upwards, _sums_upwards), (downwards, _sums_downwards)):
        chosen = np.flatnonzero(wanted)
        if not len(chosen):
            continue
        blocks = np.ceil((orders[chosen] - first) / BLOCK).astype(np.int64)
        chosen, blocks = (part[np.argsort(-blocks, kind="stable")] for part in (chosen, blocks))
        for begin in range(0, len(chosen), CHUNK):
            part = chosen[begin : begin + CHUNK]
            even[:, part], odd[:, part] = sums(
                tau[part], v[part], first, weights, blocks[begin : begin + CHUNK]
            )
    if tiny.any():
        # J_m is (v/2)^m / m! to rounding, and all but the first term is lost in it.
        leading = (v[tiny] / 2) ** first / math.factorial(first)
        even[:, tiny] = most[:, :1] * leading
        odd[:, tiny] = least[:, :1] * (leading * v[tiny] / (2 * first + 2))
    return even, odd


def _sums_upwards(
    tau: np.ndarray, v: np.ndarray, first: int, weights: Weights, blocks: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """:func:`pair_sums` by J_{m+1} = (2m/v) J_m - J_{m-1}, ``blocks`` from the most down."""
    x, powers = _powers(tau)
    step, scale = x ** (BLOCK // 2), np.ones_like(v)
    per_order = 2 / v
    bessel = np.empty((BLOCK + 2, len(v)))
    bessel[BLOCK], bessel[BLOCK + 1] = j0(v), j1(v)
    for m in range(1, first + 1):
        following = per_order * m * bessel[BLOCK + 1] - bessel[BLOCK]
        bessel[BLOCK], bessel[BLOCK + 1] = bessel[BLOCK + 1], following
    even, odd = (np.zeros((len(part), len(v))) for part in weights(np.arange(1)))
    for block in range(blocks[0]):
        active = _count(blocks, block)
        bessel[:2, :active] = bessel[BLOCK:, :active]
        rows = list(bessel[:, :active])
        orders = np.arange(BLOCK) + (first + BLOCK * block + 1)
        factors = np.multiply.outer(orders, per_order[:active])
        for before, row, after, factor in zip(rows, rows[1:], rows[2:], factors, strict=False):
            np.multiply(factor, row, out=after)
            np.subtract(after, before, out=after)
        sums = _weighted(bessel[:, :active], powers[:, :active], weights, block)
        for total, part in zip((even, odd), sums, strict=True):
            part *= scale[:active]
            total[:, :active] += part
        scale[:active] *= step[:active]
    return even, odd


def _sums_downwards(
    tau: np.ndarray, v: np.ndarray, first: int, weights: Weights, blocks: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """:func:`pair_sums` by Miller's recurrence J_{m-1} = (2m/v) J_m - J_{m+1} from far above v."""
    x, powers = _powers(tau)
    step = x ** (BLOCK // 2)
    per_order = 2 / v
    bessel = np.zeros((BLOCK + 2, len(v)))
    bessel[0] = 1e-300  # of the order above the highest: what factor it is shows at the lowest
    even, odd = (np.zeros((len(part), len(v))) for part in weights(np.arange(1)))
    for block in range(blocks[0] - 1, -1, -1):
        active = _count(blocks, block)
        bessel[BLOCK:, :active] = bessel[:2, :active]
        rows = list(bessel[::-1, :active])
        orders = np.arange(BLOCK, 0, -1) + (first + BLOCK * block)
        factors = np.multiply.outer(orders, per_order[:active])
        for above, row, below, factor in zip(rows, rows[1:], rows[2:], factors, strict=False):
            np.multiply(factor, row, out=below)
            np.subtract(below, above, out=below)
        sums = _weighted(bessel[:, :active], powers[:, :active], weights, block)
        for total, part in zip((even, odd), sums, strict=True):
            total[:, :active] *= step[:active]
            total[:, :active] += part
    low, high = bessel[0], bessel[1]
    for m in range(first, 0, -1):
        low, high = per_order * m * low - high, low
    # J₀ and J₁ are never both near 0: the larger tells the factor without loss.
    zeroth = np.abs(low) > np.abs(high)
    factor = np.where(zeroth, j0(v), j1(v)) / np.where(zeroth, low, high)
    return even * factor, odd * factor


def _powers(tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The x of :func:`pair_sums`, and x^s for the rows of a block, two rows a power."""
    x = -(tau * tau)
    powers = np.ones((BLOCK, len(tau)))
    for row in range(2, BLOCK):
        np.multiply(powers[row - 2], x, out=powers[row])
    return x, powers


def _weighted(
    bessel: np.ndarray, powers: np.ndarray, weights: Weights, block: int
) -> Iterator[np.ndarray]:
    """The two sums over one block, without the power of its first row."""
    terms = bessel[:BLOCK] * powers
    half = BLOCK // 2
    for parity, part in enumerate(weights(np.arange(half * block, half * (block + 1)))):
        yield part @ terms[parity::2]


def _count(blocks: np.ndarray, block: int) -> int:
    """How many of the points, sorted by the blocks that they need, need this one."""
    return len(blocks) - int(np.searchsorted(blocks[::-1], block, side="right"))


def lommel(n: int, u: np.ndarray, v: np.ndarray) -> Any:
    """U_n(u, v) for u and v >= 0 of one shape; see :func:`.diffraction.lommel_u`."""
    shape = u.shape
    u, v = u.ravel(), v.ravel()
    result = np.empty_like(u)
    inside = u > v
    # The terms of the series have their peak at this order; where u <= v they fall from v on.
    peak = np.where(inside, (u + v * (v / np.where(inside, u, np.inf))) / 2, v)
    falling = n >= peak
    for where, values in (
        (falling, _lommel_of_falling_terms),
        (~falling & ~inside, _lommel_by_series),
        (~falling & inside, _lommel_by_relation),
    ):
        if where.any():
            result[where] = values(n, u[where], v[where])
    return result.reshape(shape)[()]


def _lommel_by_series(n: int, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    tau = u / v
    return tau**n * pair_sums(tau, v, n, each_once)[0][0]


def _lommel_by_relation(n: int, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """U_n from U₁ = sin φ - V₁ or U₀ = cos φ - V₀ + J₀, and U_{n+2} = (u/v)^n J_n(v) - U_n."""
    tau = v / u
    phase = (u + v * tau) / 2
    even, odd = pair_sums(tau, v, 0, each_once)
    result = np.sin(phase) - tau * odd[0] if n % 2 else np.cos(phase) - even[0] + j0(v)
    for m in range(n % 2, n, 2):
        result = _scaled_bessel(m, u, v) - result
    return result


def _lommel_of_falling_terms(n: int, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The series by its first term and the quotients u h_m of the next ones.

    h_m = J_m(v) / (v J_{m-1}(v)) is a continued fraction, and regular where u or v is 0.
    """
    pairs = 20 + math.ceil(6 * math.sqrt(n))
    h, total = np.zeros_like(u), np.ones_like(u)
    for m in range(n + 2 * pairs, n, -2):
        second = 1 / (2 * m - v * v * h)
        h = 1 / (2 * m - 2 - v * v * second)
        total = 1 - (u * h) * (u * second) * total
    return _scaled_bessel(n, u, v) * total


def _scaled_bessel(m: int, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(u/v)^m J_m(v), and its limit (u/2)^m / m! for v = 0."""
    result = np.empty_like(u)
    large = v > 2 * math.sqrt(m + 1)
    # In two factors, as the power may leave the range of float64 where the product does not.
    power = np.power(u[large] / v[large], m / 2)
    result[large] = power * jv(m, v[large]) * power
    # J_m may be 0 to float64 here, so it is its power series, of terms below 1/k!.
    u, square = u[~large], v[~large] ** 2 / 4
    term = np.exp(m * np.log(u / 2, where=u > 0, out=np.zeros_like(u)) - gammaln(m + 1))
    term = np.where(u > 0, term, float(m == 0))
    total = term.copy()
    for k in range(1, 20):
        term *= -square / (k * (m + k))
        total += term
    result[~large] = total
    return result
