import math

import numpy as np
import pytest

from potmesil_mi.optics.disocclusion import GROWTH, disoccluded

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


def test_pixels_without_samples_show_nothing():
    full = step()
    nearest, farthest = np.full(full.shape, np.inf), np.zeros(full.shape)
    assert not disoccluded(nearest, farthest, 20.0).any()
    nearest[::3, ::3] = farthest[::3, ::3] = full[::3, ::3]
    marked = disoccluded(nearest, farthest, 20.0)
    assert marked.any()
    assert not (marked & ~disoccluded(full, full, 20.0)).any()
    assert not marked[np.isinf(nearest)].any()
