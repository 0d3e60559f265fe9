"""Motion vectors of other programs."""

import numpy as np
import pytest

import potmesil_mi as pm

RIGHT_AND_DOWN = [3.0, 2.0, 0.0]


@pytest.mark.parametrize(
    ("convention", "vector"),
    [
        ("pixels", [3, 2]),
        # Before it was 3 to the left and 2 higher; y counts upwards.
        ("blender", [-3, 2, -3, 2]),
        ("forward", [3, -2]),
    ],
)
def test_each_convention_gives_pixels_to_the_right_and_downwards(convention, vector):
    vectors = np.tile(vector, (2, 5, 1))
    motion = pm.motion_vectors(vectors, convention)
    assert motion.dtype == np.float32
    np.testing.assert_array_equal(motion, np.tile(RIGHT_AND_DOWN, (10, 1)))
    half = pm.motion_vectors(vectors, convention, exposure=0.5)
    np.testing.assert_array_equal(half, motion / 2)


def test_what_is_not_finite_stands_still():
    motion = pm.motion_vectors([[1, np.nan], [np.inf, 2], [3, 4]])
    np.testing.assert_array_equal(motion, [[0, 0, 0], [0, 0, 0], [3, 4, 0]])


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (([[1, 2, 3]],), ValueError, r"channels=.*: have shape \(1, 3\), must be \(..., 2\)"),
        (([[1, 2]], "blender"), ValueError, r"must be \(..., 4\) for blender"),
        (([[1, 2]], "maya"), ValueError, "convention='maya': must be one of pixels, blender"),
    ],
)
def test_other_vectors_are_refused(arguments, error, message):
    with pytest.raises(error, match=message):
        pm.motion_vectors(*arguments)


def test_a_long_exposure_is_refused():
    with pytest.raises(ValueError, match="exposure=-1: must be 0 to 1000"):
        pm.motion_vectors([[1, 2]], exposure=-1)
