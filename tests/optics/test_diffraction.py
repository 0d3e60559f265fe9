"""Diffraction in the circle of confusion: equations 12-19 of the paper, Born & Wolf section 8.8."""

import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import j0, j1, jn_zeros, jv

from potmesil_mi import ThinLens
from potmesil_mi.optics.diffraction import (
    FIRST_AIRY_ZERO,
    FIRST_AXIAL_ZERO,
    HIGHEST_ORDER,
    airy_intensity,
    encircled_energy,
    lommel_intensity,
    lommel_u,
    lommel_v,
    optical_coordinates,
)

NODES, WEIGHTS = np.polynomial.legendre.leggauss(32)

DEFOCUS = [0.01, 0.3, 1.0, 3.99, 4.01, 4 * math.pi, 50.0, 200.0, 777.7, 2000.0]
"""Values of u, on both sides of where the method changes, and dark and bright on the axis."""

PHASES = st.floats(0, 300)


def panels(first, last, count):
    """Nodes and weights of Gauss and Legendre in so many equal parts of an interval."""
    edges, step = np.linspace(first, last, count, endpoint=False, retstep=True)
    nodes = edges[:, None] + step * (NODES + 1) / 2
    return nodes.ravel(), np.tile(WEIGHTS * step / 2, count)


def intensity_by_quadrature(u, v):
    """The integral over the aperture, with at most 15 radians of phase to 32 nodes."""
    rho, weights = panels(0, 1, int((u + v.max()) / 15) + 2)
    ring = 2 * weights * rho * np.exp(-0.5j * u * rho**2)
    return np.concatenate([abs(j0(part[:, None] * rho) @ ring) ** 2 for part in np.split(v, 10)])


def light_by_quadrature(u, v):
    """Light within each of the circles ``v``, sorted: the sum over the rings between them."""
    rings = []
    for inner, outer in zip([0, *v[:-1]], v, strict=True):
        x, weights = panels(inner, outer, int((outer - inner) / 4) + 1)
        rings.append(weights @ (lommel_intensity(u, x) * x / 2))
    return np.cumsum(rings)


def places(u):
    """A multiple of ten values of v from the axis to 2u, dense where u and v are nearly equal."""
    near = u + np.sqrt(u) * np.linspace(-1, 1, 31) ** 3
    beside = u * (1 + np.array([-1e-3, -1e-6, -1e-12, 1e-12, 1e-6, 1e-3]))
    even = np.linspace(0, 2 * u, 110) * (1 + 1e-3 * np.sin(np.arange(110)))
    return np.sort(np.abs(np.concatenate([near, beside, even, [1e-12, 1e-4, u / 7]])))


# ---------------------------------------------------------------- the intensity


@pytest.mark.parametrize("u", DEFOCUS)
def test_equation_13_is_the_integral_over_the_aperture(u):
    v = places(u)
    intensity = lommel_intensity(u, v)
    peak = max(intensity.max(), lommel_intensity(u, np.linspace(0, u, 2000)).max())
    np.testing.assert_allclose(intensity, intensity_by_quadrature(u, v), rtol=0, atol=1e-11 * peak)


def test_equation_13_is_the_integral_over_the_aperture_for_large_arguments():
    u = 1e4
    v = np.array([0.1, 77.7, 3e3, 9e3, 9990, 1e4 - 1, 1e4, 10003, 1.3e4, 2e4])
    peak = lommel_intensity(u, np.linspace(0, u, 2000)).max()
    error = lommel_intensity(u, v) - intensity_by_quadrature(u, v)
    assert np.abs(error).max() <= 1e-9 * peak  # what rounding leaves of the quadrature itself


def test_equation_12_is_airys_pattern():
    v = np.array([1e-300, 1e-9, 1e-3, 1.0, 2.5, 50.0, 1e4])
    np.testing.assert_allclose(airy_intensity(v), (2 * j1(v) / v) ** 2, rtol=1e-14)
    assert airy_intensity(0.0) == pytest.approx(1, rel=1e-15)
    assert j1(FIRST_AIRY_ZERO) == pytest.approx(0, abs=2e-16)
    assert jn_zeros(1, 1)[0] == pytest.approx(FIRST_AIRY_ZERO, abs=1e-14)
    assert airy_intensity(FIRST_AIRY_ZERO) < 1e-31


@pytest.mark.parametrize("u", [0.0, 1e-300, 1e-30, 1e-12, 1e-8])
def test_the_limit_of_no_defocus_is_airys_pattern(u):
    v = np.concatenate([[0, 1e-320, 1e-30, 1e-8, 3.99, 4, 4.01, 1e4], np.linspace(0, 40, 500)])
    np.testing.assert_allclose(lommel_intensity(u, v), airy_intensity(v), rtol=1e-12, atol=1e-15)
    energy = 1 - j0(v) ** 2 - j1(v) ** 2
    np.testing.assert_allclose(encircled_energy(u, v), energy, rtol=0, atol=3e-15)


def test_equation_19_on_the_axis():
    u = np.concatenate([np.geomspace(1e-12, 1e4, 500), [3.999, 4, 4.001]])
    axis = np.square(np.sin(u / 4) / (u / 4))
    np.testing.assert_allclose(lommel_intensity(u, 0), axis, rtol=0, atol=1e-15)
    np.testing.assert_allclose(lommel_intensity(u, 1e-12), axis, rtol=0, atol=1e-15)


def test_the_axis_is_first_dark_where_equation_19_says():
    assert lommel_intensity(FIRST_AXIAL_ZERO, 0) < 1e-31
    nearer = lommel_intensity(np.linspace(0, FIRST_AXIAL_ZERO, 1000), 0)
    assert np.all(np.diff(nearer) < 0)


def test_on_the_edge_of_the_shadow_the_intensity_has_a_closed_form():
    u = np.geomspace(1e-2, 1e4, 1000)
    closed = 1 - 2 * j0(u) * np.cos(u) + j0(u) ** 2
    np.testing.assert_allclose(lommel_intensity(u, u) * u**2, closed, rtol=1e-11, atol=1e-15)


@pytest.mark.parametrize("u", [1e-8, 1e-3, 3.9, 4.0, 4.1, 30.0, 2000.0, 1e4])
def test_nothing_jumps_where_the_series_changes_at_the_edge(u):
    v = np.array([np.nextafter(u, 0), u, np.nextafter(u, 2 * u)])
    for function in (lommel_intensity, encircled_energy):
        values = function(u, v)
        np.testing.assert_allclose(values, values[1], rtol=3e-11, atol=1e-15)


@pytest.mark.parametrize("function", [lommel_intensity, encircled_energy])
def test_nothing_jumps_where_the_method_changes_near_the_axis(function):
    for u, v in ((4.0, np.linspace(0, 4, 41)), (np.linspace(0, 4, 41), 4.0), (3.0, 1.0)):
        below = function(np.nextafter(u, 0), np.nextafter(v, 0))
        above = function(np.nextafter(u, 9), np.nextafter(v, 9))
        np.testing.assert_allclose(above, below, rtol=0, atol=2e-15)


@given(st.floats(-500, 500), PHASES)
def test_before_and_behind_the_focus_the_pattern_is_the_same(u, v):
    assert lommel_intensity(-u, v) == lommel_intensity(u, v)
    assert encircled_energy(-u, v) == encircled_energy(u, v)


# ---------------------------------------------------------------- the energy


@pytest.mark.parametrize("u", [0.0, *DEFOCUS])
def test_energy_is_the_integral_of_the_intensity(u):
    v = np.unique(np.concatenate([places(max(u, 10)), [1e-6, 0.999, 1, 1.001]]))
    np.testing.assert_allclose(
        encircled_energy(u, v), light_by_quadrature(u, v), rtol=0, atol=1e-12
    )


def test_energy_inside_the_shadow_has_a_closed_form():
    u = np.concatenate([[0], np.geomspace(1e-12, 1e4, 1000)])
    closed = 1 - j0(u) * np.cos(u) - j1(u) * np.sin(u)
    np.testing.assert_allclose(encircled_energy(u, u), closed, rtol=0, atol=2e-12)


@pytest.mark.parametrize(("u", "share"), [(50, 0.92056), (500, 0.97476)])
def test_energy_inside_the_shadow_in_numbers(u, share):
    assert round(encircled_energy(u, u), 5) == share


@pytest.mark.parametrize(("u", "v"), [(3.0, 8.0), (20.0, 20.0), (20.0, 31.0), (20.0, 13.0)])
def test_energy_is_wolfs_series_as_printed(u, v):
    """Born & Wolf 8.8.3, with the double sum that the module does without."""

    def q(s):
        p = np.arange(2 * s + 1)
        products = jv(p, v) * jv(2 * s - p, v) + jv(p + 1, v) * jv(2 * s + 1 - p, v)
        return np.sum((-1.0) ** p * products)

    s = np.arange(40)
    tau = min(u, v) / max(u, v)
    wolf = sum((-1) ** i * tau ** (2 * i) * q(i) / (2 * i + 1) for i in s)
    if v >= u:
        share = 1 - wolf
    else:
        y1, y2 = (np.sum((-1.0) ** s * m * tau**m * jv(m, v)) for m in (1 + 2 * s, 2 + 2 * s))
        phase = (u + v * v / u) / 2
        share = tau**2 * (1 + wolf) - 4 / u * (y1 * math.cos(phase) + y2 * math.sin(phase))
    assert encircled_energy(u, v) == pytest.approx(share, abs=1e-13)


@pytest.mark.parametrize("u", [0.0, 1e-8, 1.0, 30.0, 1000.0])
def test_all_light_is_within_a_large_circle(u):
    """What is left beyond v falls off as 2/(πv)."""
    v = np.geomspace(1e4, 1e7, 30) * (1 + u)
    beyond = 1 - encircled_energy(u, v)
    np.testing.assert_allclose(beyond * v, 2 / math.pi, rtol=2e-3)


@pytest.mark.parametrize("u", [0.0, 1e-8, 1e-3, 1.0, 5.0, 4 * math.pi, 200.0, 1e4])
def test_energy_grows_from_zero_to_one(u):
    v = np.concatenate(
        [[0, 1e-300, 1e-20], np.linspace(1e-9, 6, 9001), np.linspace(6, 2 * u + 99, 9001)]
    )
    energy = encircled_energy(u, v)
    assert energy[0] == 0
    assert np.diff(energy).min() >= -4e-15
    assert energy.min() == 0
    assert 0.99 < energy.max() <= 1
    # Near the axis it is known to nearly all digits, however small it is.
    if u < 4:
        near = v[(v > 0) & (v < 1e-3)]
        expected = lommel_intensity(u, 0) * near**2 / 4
        np.testing.assert_allclose(encircled_energy(u, near), expected, rtol=1e-6)


# ---------------------------------------------------------------- Lommel functions


@pytest.mark.parametrize("n", [0, 1, 2, 3, 8])
def test_equation_14_the_lommel_functions_as_series(n):
    u, v = np.meshgrid(np.array([0, 1e-9, 0.3, 2, 7, 12.0]), np.array([0.1, 1, 4, 9, 15.0]))
    orders = n + 2 * np.arange(60)[:, None, None]
    series = np.sum((-1.0) ** np.arange(60)[:, None, None] * (u / v) ** orders * jv(orders, v), 0)
    cancels = 1e-15 * np.exp(np.maximum(u - v, 0) / 2)  # digits that the naive sum has lost
    assert np.all(np.abs(lommel_u(n, u, v) - series) <= 1e-14 + 10 * cancels)
    u = np.maximum(u, 2)
    series = np.sum((-1.0) ** np.arange(60)[:, None, None] * (v / u) ** orders * jv(orders, v), 0)
    error = np.abs(lommel_v(n, u, v) - series)
    assert np.all(error <= (1e-14 + 1e-14 * np.exp(v * v / u / 2)) * np.maximum(np.abs(series), 1))


@given(st.floats(0.1, 1e3), st.floats(0, 1e3))
def test_u_and_v_are_parts_of_one_generating_function(u, v):
    """U₁ + V₁ = sin φ and V₀ - U₂ = cos φ, of which one side or the other is summed."""
    phase = (u + v * v / u) / 2
    tolerance = 1e-13 + 3e-16 * phase
    assert lommel_u(1, u, v) + lommel_v(1, u, v) == pytest.approx(math.sin(phase), abs=tolerance)
    assert lommel_v(0, u, v) - lommel_u(2, u, v) == pytest.approx(math.cos(phase), abs=tolerance)


@given(st.integers(0, 40), st.floats(0, 100), st.floats(0.1, 100))
def test_neighbouring_lommel_functions_add_up_to_one_term(n, u, v):
    """U_n + U_{n+2} = (u/v)^n J_n(v), whichever way each of them is computed."""
    both = lommel_u(n, u, v), lommel_u(n + 2, u, v)
    scale = max(1, *np.abs(both), abs(lommel_u(n + 1, u, v)))
    assert sum(both) == pytest.approx((u / v) ** n * jv(n, v), abs=3e-13 * scale)


@given(st.floats(1e-3, 300), PHASES)
def test_the_intensity_is_that_of_the_lommel_functions(u, v):
    """Equation 13, of which no digits are lost for large u; and the book's other form."""
    phase = (u + v * v / u) / 2
    factor = (2 / u) ** 2
    intensity = lommel_intensity(u, v)
    tolerance = 1e-14 * (1 + factor)
    by_u = factor * (lommel_u(1, u, v) ** 2 + lommel_u(2, u, v) ** 2)
    assert intensity == pytest.approx(by_u, abs=tolerance * (1 + u))
    if v < u:
        v0, v1 = lommel_v(0, u, v), lommel_v(1, u, v)
        by_v = 1 + v0**2 + v1**2 - 2 * v0 * math.cos(phase) - 2 * v1 * math.sin(phase)
        assert intensity == pytest.approx(factor * by_v, abs=tolerance * (1 + u))


def test_lommel_functions_on_the_axis_and_in_focus():
    u = np.array([0, 1e-320, 1e-9, 1, 5, 300.0])
    for n, limit in enumerate([np.cos(u / 2), np.sin(u / 2), 2 * np.sin(u / 4) ** 2]):
        np.testing.assert_allclose(lommel_u(n, u, 0), limit, rtol=1e-13, atol=1e-13)
        # Small ones to all digits: no cosine is subtracted from 1.
        np.testing.assert_allclose(lommel_u(n, u[:4], 0), limit[:4], rtol=1e-14)
    assert lommel_u(50, 1e-3, 0) == pytest.approx(5e-4**50 / math.factorial(50), rel=1e-12)
    v = np.array([0, 1e-9, 1, 5, 300.0])
    np.testing.assert_allclose(lommel_u(0, 0, v), j0(v), rtol=1e-13)
    np.testing.assert_array_equal(lommel_u(3, 0, v), 0)
    np.testing.assert_array_equal(lommel_v(0, 5, 0), 1)
    np.testing.assert_array_equal(lommel_v(2, 5, 0), 0)


def test_on_the_edge_of_the_shadow_lommel_functions_have_closed_forms():
    u = np.array([1e-3, 1, 4, 60, 1e4])
    for function in (lommel_u, lommel_v):
        np.testing.assert_allclose(function(0, u, u), (j0(u) + np.cos(u)) / 2, atol=1e-12)
        np.testing.assert_allclose(function(1, u, u), np.sin(u) / 2, rtol=1e-11, atol=1e-12)


# ---------------------------------------------------------------- arrays


def test_arrays_broadcast_and_numbers_give_numbers():
    u, v = np.array([[0.0], [3], [50]]), np.array([0.0, 2, 3, 49, 50, 400])
    functions = (
        lommel_intensity,
        encircled_energy,
        lambda u, v: lommel_u(1, np.abs(u), v),
        lambda u, v: lommel_v(1, np.abs(u) + 1, v),
        lambda u, v: airy_intensity(v) + 0 * u,
    )
    for function in functions:
        values = function(u, v)
        assert values.shape == (3, 6)
        assert values.dtype == np.float64
        one_by_one = [[function(float(a), float(b)) for b in v] for a in u[:, 0]]
        np.testing.assert_allclose(values, one_by_one, rtol=0, atol=1e-15)
        assert isinstance(function(3, 2), float)
        assert function(np.zeros((2, 0)), 1.0).shape == (2, 0)


def test_order_and_number_of_points_change_nothing_but_the_last_digit():
    """Points are sorted and taken in chunks, by how many terms each needs."""
    rng = np.random.default_rng(1981)
    u, v = rng.uniform(0, 300, (2, 10_001))
    order = rng.permutation(len(u))
    for function in (lommel_intensity, encircled_energy):
        values = function(u, v)
        np.testing.assert_allclose(function(u[order], v[order]), values[order], atol=1e-15)
        np.testing.assert_allclose(function(u[::500], v[::500]), values[::500], atol=1e-15)


# ---------------------------------------------------------------- optical coordinates

BOTH_FILMS = pytest.mark.parametrize("film", ["focal", "focused"])
DEPTHS = np.array([20.0, 50.0, 50.001, 300.0, 999.0, 1000.0, 1001.0, 1e5, math.inf])
"""Inside, at and beyond the focal length, before and behind the focused plane."""


@BOTH_FILMS
@pytest.mark.parametrize("focused", [1000.0, 120.0, math.inf])
def test_consistent_coordinates_are_equal_on_the_edge_of_the_circle(film, focused):
    lens = ThinLens(50, 2.8, focused, film=film)
    edge = np.abs(lens.circle_of_confusion(DEPTHS)) / 2
    u, v = optical_coordinates(lens, DEPTHS, edge, 550)
    assert np.all(np.isfinite(u))
    np.testing.assert_allclose(u, v, rtol=1e-15)
    assert np.all((u > 0) == (lens.circle_of_confusion(DEPTHS) != 0))


@BOTH_FILMS
def test_in_focus_the_pattern_is_that_of_the_aperture_number(film):
    """The first dark ring is at 1.22 λN, with the number N that the film sees."""
    lens = ThinLens(50, 4, 300, film=film)
    number = {"focal": 4, "focused": 4 * 300 / 250}[film]
    u, v = optical_coordinates(lens, 300, 1.2196698912665046 * 550e-6 * number, 550)
    assert u == 0
    assert v == pytest.approx(FIRST_AIRY_ZERO, rel=1e-12)


def test_consistent_coordinates_are_those_of_the_wave_on_the_focused_film():
    """A wave that converges to V_p differs on the film, at V_u, by k (D/2)² (1/V_p - 1/V_u)."""
    lens = ThinLens(50, 2, 400, film="focused")
    u, v = optical_coordinates(lens, DEPTHS, 0.01, 500)
    k = 2 * math.pi / 500e-6
    image = lens.image_distance(np.array([20.0, 50.001, 300, 999, math.inf]))
    wave = k * 12.5**2 * np.abs(1 / image - 1 / lens.image_distance())
    np.testing.assert_allclose(u[[0, 2, 3, 4, -1]], wave, rtol=1e-9)
    np.testing.assert_allclose(v, k * 12.5 / lens.image_distance() * 0.01, rtol=1e-12)


@BOTH_FILMS
def test_equations_15_to_18_as_the_paper_prints_them(film):
    lens = ThinLens(50, 2.8, 1000, film=film)
    depth, radius, wavelength = np.array([[20.0], [300], [999], [2000]]), np.array([0, 0.02]), 633
    u, v = optical_coordinates(lens, depth, radius, wavelength, argument="paper")
    assert u.shape == v.shape == (4, 2)
    k, slope = 2 * math.pi / 633e-6, 50 / 2.8 / (2 * 50)
    z = np.abs(lens.image_distance() - lens.image_distance(depth))
    np.testing.assert_allclose(u, np.broadcast_to(k * slope**2 * z, (4, 2)), rtol=1e-9)
    np.testing.assert_allclose(v, np.broadcast_to(k * slope * radius, (4, 2)), rtol=1e-12)


def test_the_paper_has_the_edge_of_the_shadow_beside_its_circle():
    lens = ThinLens(50, 2.8, 1000)
    edge = np.abs(lens.circle_of_confusion(DEPTHS)) / 2
    u, v = optical_coordinates(lens, DEPTHS, edge, 550, "paper")
    assert u[1] == math.inf  # a point at the focal length
    defocused = (DEPTHS != 1000) & (DEPTHS != 50)
    ratio = np.abs(lens.image_distance(DEPTHS[defocused])) / 50
    np.testing.assert_allclose(u[defocused] / v[defocused], ratio, rtol=1e-12)
    assert u[DEPTHS == 1000] == 0


@pytest.mark.parametrize("argument", ["paper", "consistent"])
def test_coordinates_do_not_depend_on_the_unit_of_the_scene(argument):
    in_mm = ThinLens(50, 4, 1000)
    in_m = ThinLens(50, 4, 1, millimeters_per_unit=1000)
    for one, other in zip(
        optical_coordinates(in_mm, 700.0, 0.1, 550, argument),
        optical_coordinates(in_m, 0.7, 0.1, 550, argument),
        strict=True,
    ):
        assert isinstance(one, float)
        assert one == pytest.approx(other, rel=1e-12)


def test_the_circle_of_a_defocused_point_has_nearly_all_its_light():
    """The paper cuts the pattern off at the circle: what that loses is what the edge has beyond."""
    lens = ThinLens(55, 5.6, 550)
    edge = abs(lens.circle_of_confusion(290.0)) / 2
    u, v = optical_coordinates(lens, 290.0, np.array([0.8, 1, 1.2]) * edge, 550)
    np.testing.assert_allclose(encircled_energy(u, v), [0.64, 0.975, 1], atol=0.02)


# ---------------------------------------------------------------- what is refused

LENS = ThinLens(50, 4, 1000)
REFUSED = {
    "v_negative": (lambda: lommel_intensity(1, -0.5), "v=-0.5: must be >= 0 and finite"),
    "one_of_many": (lambda: lommel_intensity(1, np.array([1.0, -2])), "v=-2.0: "),
    "v_nan": (lambda: encircled_energy(1, math.nan), "v=nan: "),
    "v_inf": (lambda: encircled_energy(1, math.inf), "v=inf: "),
    "u_nan": (lambda: lommel_intensity(math.nan, 1), "u=nan: must be finite"),
    "u_inf": (lambda: lommel_intensity(-math.inf, 1), "u=-inf: must be finite"),
    "airy_negative": (lambda: airy_intensity(-1), "v=-1.0: "),
    "n_negative": (lambda: lommel_u(-1, 1, 1), f"n=-1: must be 0 to {HIGHEST_ORDER}"),
    "n_large": (lambda: lommel_v(HIGHEST_ORDER + 1, 1, 1), "n="),
    "lommel_u_negative": (lambda: lommel_u(1, -1, 1), "u=-1.0: must be >= 0"),
    "lommel_v_in_focus": (lambda: lommel_v(1, 0, 1), "u=0.0: must be > 0"),
    "lommel_v_beyond_float": (lambda: lommel_v(1, 1e-300, 1e10), "u=1e-300: .*finite"),
    "depth_0": (lambda: optical_coordinates(LENS, 0, 1, 550), "depth=0.0: must be > 0"),
    "depth_nan": (lambda: optical_coordinates(LENS, math.nan, 1, 550), "depth=nan: "),
    "radius": (lambda: optical_coordinates(LENS, 1, -1, 550), "radius_mm=-1.0: must be >= 0 mm"),
    "wavelength_0": (lambda: optical_coordinates(LENS, 1, 1, 0), "wavelength_nm=0.0: .*> 0 nm"),
    "wavelength_inf": (lambda: optical_coordinates(LENS, 1, 1, math.inf), "wavelength_nm=inf: "),
    "argument": (
        lambda: optical_coordinates(LENS, 1, 1, 550, "exact"),
        "argument='exact': must be one of paper, consistent",
    ),
    "pinhole": (
        lambda: optical_coordinates(LENS.replace(f_number=math.inf), 1, 1, 550),
        "f_number=inf: must be finite",
    ),
}


@pytest.mark.parametrize(("call", "text"), REFUSED.values(), ids=REFUSED)
def test_bad_values_are_refused_by_name_and_value(call, text):
    with pytest.raises(ValueError, match="^" + text):
        call()


@pytest.mark.parametrize("value", ["1", True, None, 1j], ids=str)
def test_what_is_no_number_is_refused(value):
    for name, call in {
        "u": lambda: lommel_intensity(value, 1),
        "v": lambda: encircled_energy(1, value),
        "n": lambda: lommel_u(value, 1, 1),
        "wavelength_nm": lambda: optical_coordinates(LENS, 1, 1, value),
    }.items():
        with pytest.raises(TypeError, match=re.escape(f"{name}={value!r}: must be a")):
            call()


@pytest.mark.parametrize("n", [1.0, 0.5, np.float64(2)])
def test_an_order_that_is_not_whole_is_refused(n):
    with pytest.raises(TypeError, match=re.escape(f"n={float(n)}: must be a whole number")):
        lommel_v(n, 1, 1)
