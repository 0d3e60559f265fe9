"""Tables of the circle of confusion: closed-form areas, unit sums, and what is where."""

import itertools
import math

import numpy as np
import pytest
import scipy.integrate
from hypothesis import given
from hypothesis import strategies as st

from potmesil_mi import Disc, ThinLens
from potmesil_mi.optics.aperture import SHARP
from potmesil_mi.optics.disc import disc_corner_area

COORDINATES = st.floats(-1.5, 1.5)
OFFSETS = st.tuples(st.floats(0, 1), st.floats(0, 1))
RADII = [1e-6, 1e-3, 0.3, 0.5, 1.0, 1.5, 7.3, 100.0]
LENS = ThinLens(50, 2, 1000)


def disc_table(radius, offset=(0.0, 0.0), largest=None, depth=600.0):
    """The table of a circle with a radius of `radius` squares."""
    pixels_per_mm = 2 * radius / abs(LENS.circle_of_confusion(depth))
    return Disc().table(LENS, depth, pixels_per_mm, offset, largest)


# ---------------------------------------------------------------- areas of the disc


@given(COORDINATES, COORDINATES)
def test_corner_area_agrees_with_quadrature(x, y):
    def chord(angle):
        """Length of the disc's column at sin(angle) above y, times d sin(angle)/d angle."""
        half = math.cos(angle)
        return max(min(y, half) + half, 0.0) * half

    stop = math.asin(min(max(x, -1.0), 1.0))
    kink = math.acos(min(abs(y), 1.0))
    points = sorted({-math.pi / 2, *(k for k in (-kink, kink) if k < stop), stop})
    area = sum(
        scipy.integrate.quad(chord, a, b, epsabs=1e-13)[0] for a, b in itertools.pairwise(points)
    )
    assert disc_corner_area(x, y) == pytest.approx(area, abs=1e-10)


@given(COORDINATES, COORDINATES)
def test_corner_area_has_the_symmetries_of_the_disc(x, y):
    area = disc_corner_area(x, y)
    assert disc_corner_area(y, x) == pytest.approx(area, abs=1e-14)
    assert area + disc_corner_area(-x, y) == pytest.approx(disc_corner_area(1, y), abs=1e-14)
    assert area + disc_corner_area(x, -y) == pytest.approx(disc_corner_area(x, 1), abs=1e-14)


@pytest.mark.parametrize(
    ("x", "y", "area"),
    [
        (1, 1, math.pi),
        (math.inf, math.inf, math.pi),
        (0, 1, math.pi / 2),
        (5, 0, math.pi / 2),
        (0, 0, math.pi / 4),
        (-1, 1, 0),
        (0.5, -1, 0),
        (-math.inf, 0.3, 0),
        (-0.8, -0.8, 0),
        (math.sqrt(0.5), math.sqrt(0.5), 3 * math.pi / 4 + 0.5 - (math.pi / 4 - 0.5)),
    ],
)
def test_corner_area_at_known_places(x, y, area):
    # At 45 degrees on the circle: pi, less two segments of pi/4 - 1/2.
    assert disc_corner_area(x, y) == pytest.approx(area, abs=1e-14)


def test_corner_area_is_continuous_where_the_corner_leaves_the_disc():
    angle = np.linspace(0, 2 * np.pi, 1000)
    x, y = np.cos(angle), np.sin(angle)
    inside, outside = (disc_corner_area(x * s, y * s) for s in (1 - 1e-9, 1 + 1e-9))
    np.testing.assert_allclose(inside, outside, atol=1e-7)


# ---------------------------------------------------------------- tables


@pytest.mark.parametrize("radius", RADII)
@given(OFFSETS)
def test_tables_sum_to_one_with_no_negative_share(radius, offset):
    table = disc_table(radius, offset)
    assert table.sum() == pytest.approx(1, abs=1e-6)
    assert table.min() >= 0


@pytest.mark.parametrize("radius", RADII)
def test_tables_are_square_and_odd_and_reach_as_far_as_the_circle(radius):
    table = disc_table(radius, (0.3, 0.6))
    reach = len(table) // 2
    assert radius - 1e-9 <= reach <= radius + 1 + 1e-9
    assert table.shape == (2 * reach + 1, 2 * reach + 1)
    assert table.dtype == np.float64


def test_table_agrees_with_counting_points_in_the_circle():
    radius, offset, fine = 2.3, (0.3, 0.8), 200
    table = disc_table(radius, offset)
    reach = len(table) // 2
    points = (np.arange(len(table) * fine) + 0.5) / fine - reach
    inside = np.hypot(points[None, :] - offset[0], points[:, None] - offset[1]) < radius
    counted = inside.reshape(len(table), fine, len(table), fine).sum((1, 3)) / inside.sum()
    np.testing.assert_allclose(table, counted, atol=1e-4)


@pytest.mark.parametrize("radius", [SHARP, 0.01, 0.2])
def test_a_circle_inside_its_square_stays_there(radius):
    table = disc_table(radius, (0.3, 0.75))
    assert table.shape == (3, 3)
    assert table[1, 1] == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize(
    "lens", [LENS, LENS.replace(f_number=math.inf)], ids=["focused", "pinhole"]
)
def test_a_sharp_point_is_a_tiny_circle(lens):
    depth = 1000 if lens is LENS else 20
    table = Disc().table(lens, depth, 14.0, (0.5, 0.5))
    np.testing.assert_allclose(table, [[0, 0, 0], [0, 1, 0], [0, 0, 0]], atol=1e-9)


@pytest.mark.parametrize(
    ("offset", "shared"),
    [
        ((0, 0), [[1, 1, 0], [1, 1, 0], [0, 0, 0]]),
        ((1, 0), [[0, 1, 1], [0, 1, 1], [0, 0, 0]]),
        ((0, 1), [[0, 0, 0], [1, 1, 0], [1, 1, 0]]),
        ((0.5, 0), [[0, 2, 0], [0, 2, 0], [0, 0, 0]]),
        ((0, 0.5), [[0, 0, 0], [2, 2, 0], [0, 0, 0]]),
        ((1, 0.5), [[0, 0, 0], [0, 2, 2], [0, 0, 0]]),
    ],
)
@pytest.mark.parametrize("radius", [1e-3, 0.4])
def test_points_on_corners_and_edges_are_shared(radius, offset, shared):
    """Rows are y, downwards; columns are x."""
    np.testing.assert_allclose(disc_table(radius, offset), np.array(shared) / 4, atol=1e-9)


@pytest.mark.parametrize("radius", [0.3, 1.0, 7.3])
@given(OFFSETS)
def test_mirrored_positions_have_mirrored_tables(radius, offset):
    x, y = offset
    table = disc_table(radius, offset)
    np.testing.assert_allclose(disc_table(radius, (1 - x, y)), table[:, ::-1], atol=1e-12)
    np.testing.assert_allclose(disc_table(radius, (x, 1 - y)), table[::-1], atol=1e-12)
    np.testing.assert_allclose(disc_table(radius, (y, x)), table.T, atol=1e-12)


@pytest.mark.parametrize("largest", [0, 1, 5, 8, 9])
def test_largest_cuts_and_leaves_the_middle_as_it_was(largest):
    whole = disc_table(7.3, (0.2, 0.9))
    cut = disc_table(7.3, (0.2, 0.9), (largest, largest))
    reach = min(largest, 8)
    assert cut.shape == (2 * reach + 1, 2 * reach + 1)
    middle = slice(8 - reach, 8 + reach + 1)
    np.testing.assert_array_equal(cut, whole[middle, middle])


@pytest.mark.parametrize(
    ("radius", "offset", "tolerance"),
    [(7.3, (0.5, 0.5), 1e-12), (7.3, (0.1, 0.8), 0.02), (100.0, (0.1, 0.8), 1e-3)],
)
def test_the_centroid_of_a_table_is_the_point(radius, offset, tolerance):
    """Squares the edge crosses count at their centres: exact by symmetry, else the less the
    larger the circle is."""
    table = disc_table(radius, offset)
    centres = np.arange(len(table)) - len(table) // 2 + 0.5
    centroid = table.sum(0) @ centres, table.sum(1) @ centres
    np.testing.assert_allclose(centroid, offset, atol=tolerance)


def test_the_circle_has_the_diameter_of_equation_8():
    """The variance of a disc along an axis is C^2/16; the squares add 1/12."""
    lens, pixels_per_mm = ThinLens(50, 2, 1000), 40.0
    circle = 50 / 2 * (50 * 1000 / 950) * (1 / 300 - 1 / 1000) * pixels_per_mm
    table = Disc().table(lens, 300, pixels_per_mm, (0.5, 0.5))
    x = np.arange(len(table)) - len(table) // 2
    assert table.sum(0) @ x**2 == pytest.approx(circle**2 / 16 + 1 / 12, rel=1e-4)


def test_before_and_beyond_the_focused_plane_equal_circles_have_equal_tables():
    near, far = 1 / (1 / 1000 + 1 / 3000), 1 / (1 / 1000 - 1 / 3000)
    tables = [Disc().table(LENS, depth, 14.0, (0.3, 0.6)) for depth in (near, far)]
    np.testing.assert_allclose(tables[0], tables[1], atol=1e-12)


def test_infinite_depth_has_the_limiting_circle():
    limit = Disc().table(LENS, math.inf, 14.0, (0.5, 0.5))
    np.testing.assert_allclose(limit, Disc().table(LENS, 1e12, 14.0, (0.5, 0.5)), atol=1e-9)
    assert len(limit) == 2 * math.ceil(50**2 / (2 * 950) * 14 / 2) + 1


def test_a_table_is_cut_to_the_columns_and_rows_of_its_grid():
    whole = disc_table(7.3, (0.2, 0.9))
    cut = disc_table(7.3, (0.2, 0.9), (3, 5))
    assert cut.shape == (11, 7)
    np.testing.assert_array_equal(cut, whole[3:14, 5:12])
