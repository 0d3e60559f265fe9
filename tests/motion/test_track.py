"""Numbers that change from frame to frame."""

import math

import numpy as np
import pytest

from potmesil_mi.motion.track import EASINGS, Key, Track


def test_a_number_is_the_same_in_all_frames():
    track = Track.of(2.8, "logarithmic")
    assert [track.at(frame) for frame in (-5, 0, 3.5, 1000)] == [2.8] * 4


def test_keys_are_met_and_the_ends_stay():
    track = Track.of([[10, 1], [20, 3.0, "ease"], [40, -1]])
    assert [track.at(frame) for frame in (0, 10, 15, 20, 40, 99)] == [1, 1, 2, 3, -1, -1]


@pytest.mark.parametrize(
    ("easing", "expected"),
    [
        ("linear", lambda t: t),
        ("ease", lambda t: 3 * t**2 - 2 * t**3),
        ("ease_in", lambda t: t**2),
        ("ease_out", lambda t: 1 - (1 - t) ** 2),
        ("hold", lambda t: 0 * t),
    ],
)
def test_easings_go_as_their_formulas_say(easing, expected):
    track = Track.of([[0, 5.0, easing], [8, 7.0]])
    t = np.arange(8) / 8
    np.testing.assert_allclose([track.at(8 * part) for part in t], 5 + 2 * expected(t), rtol=1e-12)
    assert track.at(8) == 7


@pytest.mark.parametrize("easing", EASINGS)
def test_no_easing_leaves_what_is_between_its_keys(easing):
    track = Track.of([[0, 1.0, easing], [1, 2.0]], "logarithmic")
    values = [track.at(frame) for frame in np.linspace(0, 1, 33)]
    assert values == sorted(values)
    assert (values[0], values[-1]) == (1, 2)


def test_focus_distances_change_evenly_in_their_inverse_up_to_infinity():
    track = Track.of([[0, 2.0], [4, math.inf]], "reciprocal")
    inverse = [1 / track.at(frame) for frame in range(5)]
    np.testing.assert_allclose(inverse, [0.5, 0.375, 0.25, 0.125, 0], rtol=1e-12)


def test_apertures_change_by_stops():
    track = Track.of([[0, 2.0], [3, 16.0]], "logarithmic")
    np.testing.assert_allclose([track.at(frame) for frame in range(4)], [2, 4, 8, 16])


@pytest.mark.parametrize(
    ("value", "scale", "error", "message"),
    [
        ("fast", "linear", TypeError, "'fast': must be a number, or a list of keys"),
        (True, "linear", TypeError, "True: must be a number"),
        ([], "linear", TypeError, "must be a number, or a list of keys"),
        ([1, 2], "linear", TypeError, "must be a number, or a list of keys"),
        ([[1]], "linear", TypeError, r"keys\[0\]=\[1\]: must be \[frame, value\]"),
        ([[0, 1], [0, 2]], "linear", ValueError, r"keys\[1\]: frame=0: must come after"),
        ([[0, 1], [math.nan, 2]], "linear", ValueError, r"keys\[1\]: frame=nan"),
        (
            [[0, 1, "fast"]],
            "linear",
            ValueError,
            r"keys\[0\]: easing='fast': must be one of",
        ),
        ([[0, "1"]], "linear", TypeError, r"keys\[0\]: value='1': must be a number"),
        ([[0, math.inf]], "linear", ValueError, r"keys\[0\]: value=inf"),
        ([[0, math.inf]], "logarithmic", ValueError, r"keys\[0\]: value=inf"),
        ([[0, -math.inf]], "reciprocal", ValueError, r"keys\[0\]: value=-inf"),
        ([[0, 0]], "reciprocal", ValueError, r"keys\[0\]: value=0: must be > 0"),
        (-1, "logarithmic", ValueError, r"keys\[0\]: value=-1: must be > 0"),
        (1, "cubic", ValueError, "scale='cubic': must be one of linear"),
    ],
)
def test_what_is_no_track_is_named(value, scale, error, message):
    with pytest.raises(error, match=message):
        Track.of(value, scale)


def test_a_track_has_a_key():
    with pytest.raises(ValueError, match=r"keys=\(\): there must be one"):
        Track(())
    assert Track((Key(0, 1.5),)).at(7) == 1.5
