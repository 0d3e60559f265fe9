"""Compositing: slices get what those before them have left."""

import numpy as np
import pytest

from potmesil_mi.focusing.composite import Compositor, SpreadSlice
from potmesil_mi.samples.raster import Window

CROP = Window(3, 2, 20, 14)


def flat(colour, share, *, left=0, top=0, size=(24, 20), resolution=1):
    """A slice of one colour that covers a share of every pixel."""
    height, width = size[1], size[0]
    light = np.broadcast_to([*(share * np.array(colour)), share], (height, width, 4))
    return SpreadSlice(light.astype(np.float32).copy(), left, top, resolution)


RED, GREEN = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)


def composited(*groups):
    compositor = Compositor(CROP, 4)
    for group in groups:
        compositor.put_behind(group)
    picture = compositor.finished()
    assert len(picture.moments) == 0
    return picture.picture, picture.weights


@pytest.mark.parametrize("share", [0.25, 0.5, 1.0])
def test_what_is_behind_gets_the_room_that_is_left(share):
    picture, weights = composited([flat(RED, share)], [flat(GREEN, 1.0)])
    np.testing.assert_allclose(picture, np.broadcast_to([share, 1 - share, 0], (14, 20, 3)))
    np.testing.assert_array_equal(weights, 1)


def test_slices_of_one_group_share_the_room():
    picture, _ = composited([flat(RED, 1.0), flat(GREEN, 1.0)])
    np.testing.assert_allclose(picture[..., :2], 0.5)


def test_where_nothing_arrives_the_picture_is_black_and_counts_nothing():
    picture, weights = composited([flat(RED, 1.0, left=13, size=(10, 20))])
    np.testing.assert_array_equal(picture[:, :10], 0)
    np.testing.assert_array_equal(weights, np.broadcast_to(np.arange(20) >= 10, (14, 20)))
    np.testing.assert_allclose(picture[:, 10:, 0], 1)


@pytest.mark.parametrize("resolution", [2, 4, 8])
def test_a_ramp_on_coarser_pixels_is_interpolated_in_its_place(resolution):
    columns = np.arange(-2, 40 // resolution + 4)
    middle = (columns + 0.5) * resolution
    light = np.zeros((20, len(columns), 4), dtype=np.float32)
    light[..., 0], light[..., 3] = middle, 1
    compositor = Compositor(CROP, 4)
    compositor.put_behind([SpreadSlice(light, -2, -2, resolution)])
    picture = compositor.finished().picture
    expected = np.arange(CROP.left, CROP.right) + 0.5
    np.testing.assert_allclose(picture[..., 0], np.broadcast_to(expected, (14, 20)), rtol=1e-5)


def test_a_slice_beside_the_picture_changes_nothing():
    alone = composited([flat(RED, 0.5)])
    both = composited([flat(GREEN, 1.0, left=40)], [flat(RED, 0.5)])
    for one, other in zip(alone, both, strict=True):
        np.testing.assert_array_equal(one, other)


def sharp(colour, share):
    return flat(colour, share)._replace(is_sharp=True)


def test_what_is_missing_behind_something_sharp_is_not_made_up_by_that():
    picture, weights = composited([sharp(RED, 0.25)], [flat(GREEN, 0.6)])
    np.testing.assert_allclose(picture[..., :2], np.broadcast_to([0.25, 0.75], (14, 20, 2)))
    np.testing.assert_array_equal(weights, 1)


@pytest.mark.parametrize("behind", [0.0, 0.01])
def test_where_next_to_nothing_is_behind_something_sharp_that_is_shown(behind):
    picture, _ = composited([sharp(RED, 0.5)], [flat(GREEN, behind)])
    share = 1.5 * behind
    np.testing.assert_allclose(picture[..., 1], share / (0.5 + share), rtol=1e-5, atol=1e-7)


def test_what_is_before_something_sharp_and_the_sharp_share_what_is_missing():
    picture, _ = composited([flat(GREEN, 0.3)], [sharp(RED, 0.6)])
    np.testing.assert_allclose(picture[..., 0], 2 / 3, rtol=1e-6)
