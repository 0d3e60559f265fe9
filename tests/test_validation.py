"""Checks of parameters name the parameter, its value and what is allowed."""

import math

import numpy as np
import pytest

from potmesil_mi._validation import (
    LONGEST_SHOWN,
    require_choice,
    require_flag,
    require_number,
    require_whole,
    shown,
)


def test_a_choice_is_one_of_the_words():
    require_choice("film", "focal", ("focal", "focused"))
    with pytest.raises(ValueError, match=r"^film='fixed': must be one of focal, focused$"):
        require_choice("film", "fixed", ("focal", "focused"))
    for value in (None, 3, ["focal"]):
        with pytest.raises(TypeError, match=r"^film=.*: must be one of focal, focused$"):
            require_choice("film", value, iter(("focal", "focused")))


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan, 10**400, -(10**400)])
def test_a_number_is_finite_whatever_its_type(value):
    with pytest.raises(ValueError, match=r"^size=(-?inf|nan|-?10+\.\.\.0+): must be finite"):
        require_number("size", value)


@pytest.mark.parametrize("value", [1, 1.5, np.float32(1.5), np.int64(2), 2])
def test_a_number_in_range_passes(value):
    require_number("size", value, 1, 2)


def test_a_flag_is_true_or_false_and_nothing_that_is_like_it():
    for value in (True, False, np.bool_(True)):
        require_flag("alpha", value)
    for value in (1, 0, None, "yes"):
        with pytest.raises(TypeError, match=r"^alpha=.*: must be True or False$"):
            require_flag("alpha", value)


def test_truth_is_no_number():
    with pytest.raises(TypeError, match="size=True"):
        require_number("size", True)
    with pytest.raises(TypeError, match=r"size=(np\.)?True"):
        require_whole("size", np.True_, 0, 1)


class Unspeakable:
    def __repr__(self):
        raise RuntimeError("no text")


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (2.0, "2.0"),
        (np.float32(0.5), "0.5"),
        (np.array(7), "7"),
        (np.ones((2, 1)), "array([[1.], [1.]])"),
        ("a\nb", r"'a\nb'"),
        pytest.param(10**5000, "an int of 16610 bits", id="int"),
    ],
)
def test_a_value_is_shown_as_it_is_written(value, text):
    assert shown(value) == text


@pytest.mark.parametrize(
    "value",
    [10**400, "long" * 999, b"long" * 999, [["long" * 99] * 9] * 9, np.eye(99), Unspeakable()],
    ids=["int", "text", "bytes", "lists", "array", "unspeakable"],
)
def test_whatever_is_shown_fits_on_a_line(value):
    text = shown(value)
    assert 5 < len(text) <= LONGEST_SHOWN
    assert "\n" not in text
