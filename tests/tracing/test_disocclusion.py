import math

import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.samples.raster import Window
from potmesil_mi.tracing.disocclusion import (
    GROWTH,
    MOST_OVERSCAN,
    SMALL_WINDOW,
    disoccluded,
    overscan,
)
from scenes import synthetic

# ---------------------------------------------------------------- silhouettes


def step(width=160, height=12, near=1.0, far=4.0):
    """Depths of a near half plane, left, and a far one."""
    return np.where(np.arange(width) < width // 2, near, far) * np.ones((height, 1))


@pytest.mark.parametrize("parallax", [0.6, 1.0, 3.3, 10.0, 40.0])
def test_along_an_edge_a_band_as_wide_as_the_parallax_may_hide_something(parallax):
    z = step()
    marked = disoccluded(z, z, parallax / (1 - 1 / 4))
    assert (marked == marked[0]).all()
    band = np.flatnonzero(marked[0])
    assert band.max() == 79
    assert np.array_equal(band, np.arange(band.min(), 80)), "in one piece"
    # No less than the parallax, nor more than the next of the distances that are looked at.
    assert math.floor(parallax) <= len(band) <= GROWTH * (parallax + 2)


def test_the_band_turns_with_the_edge():
    z = step(height=160)
    marked = disoccluded(z, z, 10.0)
    np.testing.assert_array_equal(disoccluded(z.T, z.T, 10.0), marked.T)
    np.testing.assert_array_equal(disoccluded(z[:, ::-1], z[:, ::-1], 10.0), marked[:, ::-1])


def test_behind_a_flat_wall_the_lens_sees_nothing():
    z = np.full((12, 20), 3.0)
    assert not disoccluded(z, z, 1e4).any()


def test_the_sky_is_behind_everything_and_nothing_is_behind_the_sky():
    z = step(far=np.inf)
    marked = disoccluded(z, z, 5.0)
    assert marked[:, 75:80].all()
    assert not marked[:, 80:].any()
    sky = np.full((4, 5), np.inf)
    assert not disoccluded(sky, sky, 5.0).any()


def test_a_gentle_slope_hides_nothing():
    vergence = np.linspace(1, 0.25, 160) * np.ones((12, 1))
    # The circles of pixels so far apart differ by a fifth of the distance, or by four times it.
    assert not disoccluded(1 / vergence, 1 / vergence, 0.2 * 159 / 0.75).any()
    assert disoccluded(1 / vergence, 1 / vergence, 4 * 159 / 0.75).any()


def test_an_edge_within_a_pixel_counts():
    near, far = np.full((5, 5), 2.0), np.full((5, 5), 2.0)
    far[2, 2] = 4.0
    marked = disoccluded(near, far, 4 * 0.9)
    assert marked[2, 2]
    assert not disoccluded(near, far, 4 * 0.4).any()


# ---------------------------------------------------------------- overscan

CROP = Window(100, 80, 60, 40)
CAMERA = synthetic(1).camera


def probes(spacing=1.0, reach=100):
    left, top, width, height = CROP
    return (
        axis.ravel()
        for axis in np.meshgrid(
            np.arange(left - reach + spacing / 2, left + width + reach, spacing),
            np.arange(top - reach + spacing / 2, top + height + reach, spacing),
        )
    )


def lens_of(scale, focus_distance=4.0):
    """A lens of a given parallax, at any focus."""
    return pm.ThinLens(
        50.0,
        aperture_radius=scale / CAMERA.focal_length_pixels,
        focus_distance=focus_distance,
        millimeters_per_unit=1000.0,
    )


def margins(z, lens, spacing=1.0):
    x, y = probes(spacing)
    window = overscan(x, y, z(x, y), spacing, CROP, lens, CAMERA)
    left, top = CROP[0] - window[0], CROP[1] - window[1]
    return left, top, window[2] - CROP[2] - left, window[3] - CROP[3] - top


def test_overscan_is_nothing_where_all_is_in_focus():
    assert margins(lambda x, y: np.full_like(x, 4.0), lens_of(50.0)) == (0, 0, 0, 0)


def test_overscan_is_the_radius_of_the_circles_beyond_the_window():
    def sky_around(x, y):
        inside = (x > 100) & (x < 160) & (y > 80) & (y < 120)
        return np.where(inside, 4.0, np.inf)

    sides = margins(sky_around, lens_of(50.0))
    assert all(12 <= side <= 15 for side in sides), sides


def test_overscan_is_on_the_side_where_it_is_needed():
    def near_on_the_left(x, y):
        return np.where(x < 100, 1.0, 4.0)

    left, top, right, bottom = margins(near_on_the_left, lens_of(20.0))
    assert 15 <= left <= 17
    # Rounded like a circle of confusion: it reaches the corner from above, but not as far.
    assert 0 < top <= left
    assert 0 < bottom <= left
    assert right == 0


def test_overscan_allows_for_every_focus_within_the_scene():
    def two_depths(x, y):
        return np.where((x > 120) & (x < 140), 1.0, 4.0)

    # Focused on what is at 1, what is at 4 reaches as far.
    sides = margins(two_depths, lens_of(20.0))
    assert all(15 <= side <= 17 for side in sides), sides


def test_overscan_is_bounded():
    x, y = probes()
    window = overscan(x, y, np.full_like(x, 1.0), 1.0, CROP, lens_of(1e6), CAMERA)
    assert window[2] * window[3] <= max(MOST_OVERSCAN * CROP[2] * CROP[3], SMALL_WINDOW)
    assert window[2] > 2 * CROP[2]
    assert window[3] > 2 * CROP[3]
