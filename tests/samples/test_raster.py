"""Windows: their numbers, overlaps, pixels of positions, tiles."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from potmesil_mi.samples.raster import FARTHEST, Window

WINDOWS = st.builds(
    Window, st.integers(-9, 9), st.integers(-9, 9), st.integers(0, 9), st.integers(0, 9)
)
FILLED = WINDOWS.filter(lambda window: not window.is_empty)
OUTER = Window(-30, -30, 60, 60)


def pixels(window):
    """The pixels of a window, one by one."""
    return {
        (x, y)
        for x in range(window.left, window.left + window.width)
        for y in range(window.top, window.top + window.height)
    }


def test_a_window_is_its_four_numbers():
    window = Window.of(np.array([-3, 2, 20, 14]))
    assert window == (-3, 2, 20, 14)
    assert all(type(number) is int for number in window)
    left, top, width, height = window
    assert (window.right, window.bottom) == (left + width, top + height)
    assert window.shape == (14, 20)
    assert window.size == len(pixels(window)) == 280


@pytest.mark.parametrize(
    ("values", "error", "text"),
    [
        ((0, 0, 0, 14), ValueError, r"^halo\[2\]=0"),
        ((FARTHEST + 1, 0, 1, 14), ValueError, r"^halo\[0\]="),
        ((0, 0, 20), ValueError, r"^halo=\(0, 0, 20\): must be left, top, width and height"),
        ((0.0, 0, 20, 14), TypeError, r"^halo\[0\]=0.0: must be a whole number"),
        (20, TypeError, "^halo=20: must be left"),
        (None, TypeError, "^halo=None: must be left"),
    ],
)
def test_a_bad_window_is_named(values, error, text):
    with pytest.raises(error, match=text):
        Window.of(values, "halo")


@given(WINDOWS, WINDOWS)
def test_an_intersection_has_the_pixels_of_both(one, other):
    both = one.intersection(other)
    assert pixels(both) == pixels(one) & pixels(other)
    assert both.width >= 0
    assert both.height >= 0
    assert both.is_empty == (not pixels(both))
    assert one.covers(other) == (pixels(other) <= pixels(one))


@given(WINDOWS, st.integers(0, 4))
def test_a_grown_window_covers_what_is_within_the_margin(window, margin):
    grown = window.grown(margin)
    assert grown.covers(window)
    assert grown.shape == (window.height + 2 * margin, window.width + 2 * margin)
    assert grown.relative_to(window)[:2] == (-margin, -margin)


@given(FILLED, st.integers(1, 5))
def test_subpixels_of_a_window_cover_it(window, n):
    fine = window.subdivided(n)
    assert pixels(window) == {(x // n, y // n) for x, y in pixels(fine)}
    assert fine.size == n * n * window.size


@given(WINDOWS)
def test_slices_find_a_window_in_an_array(window):
    array = np.zeros(OUTER.shape, dtype=bool)
    array[window.slices_in(OUTER)] = True
    y, x = np.nonzero(array)
    assert pixels(window) == set(zip((x - 30).tolist(), (y - 30).tolist(), strict=True))


@given(FILLED, st.lists(st.tuples(st.floats(-20, 20, width=32), st.floats(-20, 20, width=32))))
def test_a_position_belongs_to_the_nearest_pixel_of_the_window(window, positions):
    x, y = np.array(positions, dtype=np.float32).reshape(-1, 2).T
    index = window.pixel_of(x, y)
    assert index.dtype == np.int64
    columns, rows = window.pixels()
    for i, (a, b) in enumerate(positions):
        column = min(max(int(np.floor(a)), window.left), window.right - 1)
        row = min(max(int(np.floor(b)), window.top), window.bottom - 1)
        assert (columns[index[i]], rows[index[i]]) == (column, row)
    np.testing.assert_array_equal(
        window.contains(x, y),
        [(int(np.floor(a)), int(np.floor(b))) in pixels(window) for a, b in positions],
    )


@given(FILLED, st.lists(st.tuples(st.floats(-40, 40, width=32), st.floats(-40, 40, width=32))))
def test_a_part_shows_what_belongs_to_its_pixels(window, positions):
    x, y = np.array(positions, dtype=np.float32).reshape(-1, 2).T
    whole = np.arange(OUTER.size).reshape(OUTER.shape)
    own = np.isin(OUTER.pixel_of(x, y), whole[window.slices_in(OUTER)])
    np.testing.assert_array_equal(window.shows(x, y, OUTER), own)


def test_positions_on_its_last_edges_are_shown_where_corners_are_shared():
    window, at = Window(0, 0, 4, 4), np.array([0.0, 4.0, 4.5, -0.5])
    two = np.full(4, 2.0)
    assert window.shows(at, two, OUTER).tolist() == [True, False, False, False]
    assert window.shows(at, two, OUTER, edges=True).tolist() == [True, True, False, False]
    assert window.shows(two, at, OUTER, edges=True).tolist() == [True, True, False, False]
    # What lies beyond the outer window belongs to its border.
    assert window.shows(at, two, window).all()


@given(FILLED, st.integers(1, 12))
def test_tiles_cover_each_pixel_once(window, size):
    tiles = list(window.tiles(size))
    assert sum(tile.size for tile in tiles) == window.size
    assert set().union(*map(pixels, tiles)) == pixels(window)
    assert all(max(tile.shape) <= size for tile in tiles)


def test_a_bad_size_of_tiles_is_named():
    with pytest.raises(ValueError, match="size=0: must be 1 to"):
        next(Window(0, 0, 4, 4).tiles(0))
