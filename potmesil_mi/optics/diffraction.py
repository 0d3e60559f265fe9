"""Diffraction: how light spreads in the circle of confusion of a round aperture.

Section 2.4 of Potmesil & Chakravarty (1981), equations 12 to 19; numbers in brackets are the
paper's. The theory is Lommel's of 1885, as in Born & Wolf, "Principles of Optics", section 8.8;
the light within a circle is by Wolf, "Light distribution near focus in an error-free diffraction
image", Proc. R. Soc. A 204 (1951), and section 8.8.3 of the book.

The amplitude at the optical coordinates u (along the axis) and v (across it) is

    A(u, v) = 2 ∫₀¹ J₀(vρ) exp(-iuρ²/2) ρ dρ,   I(u, v) = |A|² I₀,

so u = 0 is the plane in focus, and v = |u| is the edge of the geometric shadow: rays go to
v < |u|, its inside. What the paper calls V₁ and V₂ in [13] and [14] are the book's U₁ and U₂.

Each function takes numbers or arrays, which broadcast, and gives float64. All sums over Bessel
functions are by recurrence over the order, of as many orders as matter: about 40 / |ln(v/u)|,
and near the shadow's edge, where that is more than v, v + 12 v^(1/3) + 40. So much is the work for
each point; the memory is that of a few arrays of the result's size. Nothing here needs a Mitsuba
variant.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaln, j0, j1, jv

from .._validation import require_whole

if TYPE_CHECKING:
    from .lens import ThinLens

Weights = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
Region = Callable[[np.ndarray, np.ndarray], np.ndarray]

FIRST_AIRY_ZERO = 3.8317059702075125
"""Optical radius v of the first dark ring of a point in focus: the first zero of J1."""

FIRST_AXIAL_ZERO = 4 * math.pi
"""Optical defocus u at which the middle of the pattern first is dark: from [19]."""

ARGUMENTS = ("paper", "consistent")
"""The two readings of equations 15 to 18, see :func:`optical_coordinates`."""

HIGHEST_ORDER = 100
"""Highest order of Lommel function: optics needs 2, and U_n of higher order soon overflows."""

MILLIMETERS_PER_NANOMETER = 1e-6

NATS = 40.0
"""Terms of a sum that are exp(-NATS) of the first ones, 4e-18, are left out."""

SMALL = 4.0
"""Up to this u and v the integral itself is evaluated, for the sums would lose digits to 1/u."""

NODES, WEIGHTS = (array / 2 for array in np.polynomial.legendre.leggauss(16))
NODES += 0.5
"""Gauss-Legendre from 0 to 1: exact to rounding for J₀ and exp of arguments up to ``SMALL``."""

BLOCK = 16
"""Orders of Bessel functions that are summed at once: even."""

CHUNK = 4096
"""Points that are summed at once: ``BLOCK`` times as many numbers stay in a processor's cache."""


def optical_coordinates(
    lens: ThinLens,
    depth: ArrayLike,
    radius_mm: ArrayLike,
    wavelength_nm: ArrayLike,
    argument: str = "consistent",
) -> tuple[Any, Any]:
    """The coordinates (u, v), both >= 0, of places on the film: equations 15 to 18.

    ``depth`` of the point is in scene units, > 0 (``inf`` is allowed), ``radius_mm`` is the
    distance on the film from the middle of its circle of confusion, ``wavelength_nm`` the
    wavelength in nanometres. Arrays broadcast, and u and v have the shape of all three together.
    With k = 2π/λ, the diameter D of the lens and the diameter C of equation 8's circle:

    ``consistent``
        v = k (D/2V) r and u = k (D/2V) C/2, so that v = u exactly on the circle's edge r = C/2,
        at any depth: also at and inside the focal length and at infinity, where C is finite.
        V is ``lens.film_distance``. That is V_u for a film at the focused image; then u is
        ``k (D/2)² |1/P - 1/U|``, as of a wave that converges to V_p and is caught at V_u. And it
        is F for the paper's film; then v = k r / (2n). Either way a point in focus has the Airy
        pattern of the aperture number V/D.
    ``paper``
        u = ``k (D/2F)² |V_u - V_p|`` and v = k (D/2F) r, as printed, for either film. The
        shadow's edge is then not on equation 8's circle but at V_p/F of its radius. Of a point at
        the focal length u is infinite.

    Raises ``ValueError`` that names the parameter, its value and what is allowed, also for a
    lens without an opening (``f_number`` inf), and ``TypeError`` for what is no number.
    """
    if argument not in ARGUMENTS:
        raise ValueError(f"argument={argument!r}: must be one of {', '.join(ARGUMENTS)}")
    depths = _numbers("depth", depth, "> 0 scene units", lambda x: x > 0)
    radius = _numbers("radius_mm", radius_mm, ">= 0 mm and finite", _not_negative)
    wavelength = _numbers(
        "wavelength_nm", wavelength_nm, "> 0 nm and finite", lambda x: (x > 0) & np.isfinite(x)
    )
    lens = type(lens)(**lens.to_dict())
    if not lens.lens_diameter > 0:
        raise ValueError(f"f_number={lens.f_number}: must be finite, a pinhole has no coordinates")
    reference = lens.focal_length if argument == "paper" else lens.film_distance
    wavenumber = 2 * math.pi / (wavelength * MILLIMETERS_PER_NANOMETER)
    per_mm = wavenumber * (lens.lens_diameter / (2 * reference))
    circle = np.abs(lens.circle_of_confusion(depths))
    if argument == "paper":
        # |V_u - V_p| is C |V_p| / D, which loses no digits near the focused plane.
        defocus = circle * np.abs(lens.image_distance(depths)) / lens.lens_diameter
        u = per_mm * (lens.lens_diameter / (2 * reference)) * defocus
    else:
        u = per_mm * (circle / 2)
    u, v = np.broadcast_arrays(u, per_mm * radius)
    return u.copy()[()], v.copy()[()]


def airy_intensity(v: ArrayLike) -> Any:
    """I/I₀ = [2 J₁(v)/v]² of a point in focus, at the optical radius ``v`` >= 0: equation 12."""
    v = _numbers("v", v, ">= 0 and finite", _not_negative)
    # Below this v the quotient is 1 to rounding, and 0/0 does not occur.
    v = np.maximum(v, 1e-9)
    return np.square(2 * j1(v) / v)[()]


def lommel_intensity(u: ArrayLike, v: ArrayLike) -> Any:
    """I(u, v)/I₀ of a point out of focus: equation 13, on both sides of the shadow's edge.

    Even in ``u``, which may be negative; ``v`` >= 0; both finite. At u = 0 it is
    :func:`airy_intensity`, at v = 0 equation 19, [sin(u/4) / (u/4)]². The
    error is about 1e-15 + 1e-16 u times the largest value over v, as of a phase of u/2 radians
    that was rounded.

    Outside the shadow, v >= u, [13] and [14] are summed as (2/v) Σ (iu/v)^m J_{m+1}(v), inside
    the other form of Born & Wolf, ``(2/u)² |exp(iφ) - V₀ - i V₁|²`` with φ = (u + v²/u)/2; where
    u and v are at most 4, the integral itself. Raises ``ValueError`` and ``TypeError`` that name
    the parameter.
    """
    u, v = _coordinates(u, v)
    return _by_region(u, v, (u <= SMALL) & (v <= SMALL), _near_axis, _inside, _outside)


def encircled_energy(u: ArrayLike, v: ArrayLike) -> Any:
    """Share of the light, 0 to 1, within the circle of optical radius ``v``: ∫₀^v I(u, x) x dx / 2.

    Even in ``u``, which may be negative; ``v`` >= 0; both finite. At u = 0 it is
    1 - J₀² - J₁², at v = u 1 - J₀(u) cos u - J₁(u) sin u. It grows with v to rounding. By
    Wolf's series with his

        Q_2s(v) = Σ_p (-1)^p [J_p J_{2s-p} + J_{p+1} J_{2s+1-p}],   p from 0 to 2s,

    which needs no double sum. For even n, c_n = Σ_p (-1)^p J_p J_{n-p} with p from 0 to n has the
    derivative -J₁ J_n - J₀ J_{n+1}, so it is (v/n) (J₀ J_{n+1} - J₁ J_n), and c_0 = J₀²; and
    Q_2s = c_2s - c_{2s+2} + 2 J₀ J_{2s+2}. Raises ``ValueError`` and ``TypeError`` that name the
    parameter.
    """
    u, v = _coordinates(u, v)
    small = (u <= SMALL) & (v <= 1)
    energy = _by_region(u, v, small, _energy_near_axis, _energy_inside, _energy_outside)
    return np.clip(energy, 0.0, 1.0)


def lommel_u(n: int, u: ArrayLike, v: ArrayLike) -> Any:
    """Lommel's function U_n(u, v) = Σ_s (-1)^s (u/v)^(n+2s) J_{n+2s}(v): equation 14.

    ``n`` is a whole number >= 0, ``u`` and ``v`` are >= 0 and finite; at v = 0 it is the limit.
    The series is summed where its terms do not cancel: u <= v, or n at least φ = (u + v²/u)/2.
    Elsewhere U_n is cos(φ - nπ/2) less the rest of the series of the generating function, which
    for n = 1 is U₁ = sin φ - V₁ and for n = 2 is U₂ = V₀ - cos φ. The error is about
    1e-15 (φ + 10 + n) times the largest of 1, U_n and U_{n+1}. Raises ``ValueError`` and
    ``TypeError`` that name the parameter.
    """
    require_whole("n", n, 0, HIGHEST_ORDER)
    u, v = _coordinates(u, v, negative=False)
    return _lommel(int(n), u, v)


def lommel_v(n: int, u: ArrayLike, v: ArrayLike) -> Any:
    """Lommel's function V_n(u, v) = Σ_s (-1)^s (v/u)^(n+2s) J_{n+2s}(v), Born & Wolf 8.8.

    ``n`` is a whole number >= 0, ``u`` is > 0 and such that v²/u is finite (at u = 0 there is no
    limit), ``v`` >= 0; both finite. It is U_n(v²/u, v): see :func:`lommel_u` for how it is
    computed, how exact it is and what is raised.
    """
    require_whole("n", n, 0, HIGHEST_ORDER)
    u, v = _coordinates(u, v, negative=False)
    _require("u", u, "> 0", u > 0)
    with np.errstate(over="ignore"):
        mirrored = v * (v / u)
    _require("u", u, "so large that v²/u is finite", np.isfinite(mirrored))
    return _lommel(int(n), mirrored, v)


# ---------------------------------------------------------------- the intensity


def _near_axis(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    real, imaginary = np.zeros_like(u), np.zeros_like(u)
    for node, weight in zip(NODES, WEIGHTS, strict=True):
        # With x = ρ², for J₀(v√x) is smooth in x.
        ring = weight * j0(v * math.sqrt(node))
        real += ring * np.cos(u * (node / 2))
        imaginary += ring * np.sin(u * (node / 2))
    return real**2 + imaginary**2


def _outside(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    tau = u / v
    even, odd = _pair_sums(tau, v, 1, _each_once)
    return np.square(2 / v) * (even[0] ** 2 + (tau * odd[0]) ** 2)


def _inside(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    tau = v / u
    even, odd = _pair_sums(tau, v, 0, _each_once)
    phase = (u + v * tau) / 2
    return np.square(2 / u) * (
        np.square(np.cos(phase) - even[0]) + np.square(np.sin(phase) - tau * odd[0])
    )


def _each_once(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.ones((1, len(s))), np.ones((1, len(s)))


# ---------------------------------------------------------------- the energy


def _energy_near_axis(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    total = np.zeros_like(u)
    # Ten nodes would do; these are there already.
    for node, weight in zip(NODES, WEIGHTS, strict=True):
        total += weight * _near_axis(u, v * math.sqrt(node))
    return total * v * v / 4


def _energy_outside(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    q, _, _ = _wolf_sums(u / v, v)
    return 1 - q


def _energy_inside(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    tau = v / u
    q, y1, y2 = _wolf_sums(tau, v)
    phase = (u + v * tau) / 2
    return tau**2 * (1 + q) - 4 / u * (y1 * np.cos(phase) + y2 * np.sin(phase))


def _wolf_sums(tau: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Σ (-1)^s τ^2s Q_2s(v) / (2s+1), and Y₁ and Y₂ = Σ (-1)^s (n+2s) τ^(n+2s) J_{n+2s}(v)."""
    even, odd = _pair_sums(tau, v, 2, _wolf_weights)
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


# ---------------------------------------------------------------- sums over Bessel functions


def _pair_sums(
    tau: np.ndarray, v: np.ndarray, first: int, weights: Any
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
    """:func:`_pair_sums` by J_{m+1} = (2m/v) J_m - J_{m-1}, ``blocks`` from the most down."""
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
    """:func:`_pair_sums` by Miller's recurrence J_{m-1} = (2m/v) J_m - J_{m+1} from far above v."""
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
    """The x of :func:`_pair_sums`, and x^s for the rows of a block, two rows a power."""
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


# ---------------------------------------------------------------- Lommel functions of any order


def _lommel(n: int, u: np.ndarray, v: np.ndarray) -> Any:
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
    return tau**n * _pair_sums(tau, v, n, _each_once)[0][0]


def _lommel_by_relation(n: int, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """U_n from U₁ = sin φ - V₁ or U₀ = cos φ - V₀ + J₀, and U_{n+2} = (u/v)^n J_n(v) - U_n."""
    tau = v / u
    phase = (u + v * tau) / 2
    even, odd = _pair_sums(tau, v, 0, _each_once)
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


# ---------------------------------------------------------------- arguments


def _by_region(
    u: np.ndarray,
    v: np.ndarray,
    small: np.ndarray,
    near_axis: Region,
    inside: Region,
    outside: Region,
) -> Any:
    """The function that is right for small u and v, inside the shadow and outside of it."""
    result = np.empty_like(u)
    shadow = v < u
    for where, values in (
        (small, near_axis),
        (~small & shadow, inside),
        (~small & ~shadow, outside),
    ):
        if where.any():
            result[where] = values(u[where], v[where])
    return result[()]


def _coordinates(
    u: ArrayLike, v: ArrayLike, negative: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """|u| and v, checked and of one shape."""
    if negative:
        u = np.abs(_numbers("u", u, "finite", np.isfinite))
    else:
        u = _numbers("u", u, ">= 0 and finite", _not_negative)
    u, v = np.broadcast_arrays(u, _numbers("v", v, ">= 0 and finite", _not_negative))
    return u, v


def _not_negative(values: np.ndarray) -> Any:
    return (values >= 0) & np.isfinite(values)


def _numbers(name: str, value: Any, allowed: str, test: Callable[[Any], Any]) -> np.ndarray:
    """``value`` as float64, all of whose elements pass ``test``."""
    values = np.asarray(value)
    if values.dtype.kind not in "fiu":
        raise TypeError(f"{name}={value!r}: must be a number {allowed}")
    values = values.astype(np.float64)
    _require(name, values, allowed, test(values))
    return values


def _require(name: str, values: np.ndarray, allowed: str, passed: np.ndarray) -> None:
    if not np.all(passed):
        raise ValueError(f"{name}={values[~passed].flat[0]}: must be {allowed}")
