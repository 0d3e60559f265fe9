"""Diffraction: how light spreads in the circle of confusion of a round aperture.

Section 2.4 of Potmesil & Chakravarty (1981), equations 12 to 19; numbers in brackets are the
paper's. The theory is Lommel's of 1885, as in Born & Wolf, "Principles of Optics", section 8.8;
the light within a circle is by Wolf, "Light distribution near focus in an error-free diffraction
image", Proc. R. Soc. A 204 (1951), and section 8.8.3 of the book.

The amplitude at the optical coordinates u (along the axis) and v (across it) is

    A(u, v) = 2 ∫₀¹ J₀(vρ) exp(-iuρ²/2) ρ dρ,   I(u, v) = |A|² I₀,

so u = 0 is the plane in focus, and v = |u| is the edge of the geometric shadow: rays go to
v < |u|, its inside. What the paper calls V₁ and V₂ in [13] and [14] are the book's U₁ and U₂.

Each function takes numbers or arrays, which broadcast, and gives float64. The series are in
:mod:`.lommel_series`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import j0, j1

from .._validation import require_whole, shown
from .lens_protocol import LensProtocol
from .lommel_series import each_once, lommel, pair_sums, wolf_sums

Region = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""A function of u and v that is right in one part of their plane."""

Argument = Literal["paper", "consistent"]
"""A reading of equations 15 to 18, see :func:`optical_coordinates`."""

ARGUMENTS: tuple[Argument, ...] = get_args(Argument)
"""The two readings of equations 15 to 18."""

FIRST_AIRY_ZERO = 3.8317059702075125
"""Optical radius v of the first dark ring of a point in focus: the first zero of J1."""

FIRST_AXIAL_ZERO = 4 * math.pi
"""Optical defocus u at which the middle of the pattern first is dark: from [19]."""

HIGHEST_ORDER = 100
"""Highest order of Lommel function: optics needs 2, and U_n of higher order soon overflows."""

MILLIMETERS_PER_NANOMETER = 1e-6
"""What a nanometre is in millimetres."""

SMALL = 4.0
"""Up to this u and v the integral itself is evaluated, for the sums would lose digits to 1/u."""

NODES, WEIGHTS = (array / 2 for array in np.polynomial.legendre.leggauss(16))
NODES += 0.5
"""Gauss-Legendre from 0 to 1: exact to rounding for J₀ and exp of arguments up to ``SMALL``."""


def optical_coordinates(
    lens: LensProtocol,
    depth: ArrayLike,
    radius_mm: ArrayLike,
    wavelength_nm: ArrayLike,
    argument: Argument = "consistent",
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
        raise ValueError(f"argument={shown(argument)}: must be one of {', '.join(ARGUMENTS)}")
    depths = _numbers("depth", depth, "> 0 scene units", lambda x: x > 0)
    radius = _numbers("radius_mm", radius_mm, ">= 0 mm and finite", _not_negative)
    wavelength = _numbers(
        "wavelength_nm", wavelength_nm, "> 0 nm and finite", lambda x: (x > 0) & np.isfinite(x)
    )
    lens = lens.plain()
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
    return lommel(int(n), u, v)


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
    return lommel(int(n), mirrored, v)


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
    even, odd = pair_sums(tau, v, 1, each_once)
    return np.square(2 / v) * (even[0] ** 2 + (tau * odd[0]) ** 2)


def _inside(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    tau = v / u
    even, odd = pair_sums(tau, v, 0, each_once)
    phase = (u + v * tau) / 2
    return np.square(2 / u) * (
        np.square(np.cos(phase) - even[0]) + np.square(np.sin(phase) - tau * odd[0])
    )


# ---------------------------------------------------------------- the energy


def _energy_near_axis(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    total = np.zeros_like(u)
    # Ten nodes would do; these are there already.
    for node, weight in zip(NODES, WEIGHTS, strict=True):
        total += weight * _near_axis(u, v * math.sqrt(node))
    return total * v * v / 4


def _energy_outside(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    q, _, _ = wolf_sums(u / v, v)
    return 1 - q


def _energy_inside(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    tau = v / u
    q, y1, y2 = wolf_sums(tau, v)
    phase = (u + v * tau) / 2
    return tau**2 * (1 + q) - 4 / u * (y1 * np.cos(phase) + y2 * np.sin(phase))


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
        raise TypeError(f"{name}={shown(value)}: must be a number {allowed}")
    values = values.astype(np.float64)
    _require(name, values, allowed, test(values))
    return values


def _require(name: str, values: np.ndarray, allowed: str, passed: np.ndarray) -> None:
    if not np.all(passed):
        raise ValueError(f"{name}={values[~passed].flat[0]}: must be {allowed}")
