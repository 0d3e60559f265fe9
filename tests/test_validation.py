"""Checks of parameters name the parameter, its value and what is allowed."""

import math

import numpy as np
import pytest

from potmesil_mi._validation import require_choice, require_flag, require_number, require_whole


def test_a_choice_is_one_of_the_words():
    require_choice("film", "focal", ("focal", "focused"))
    with pytest.raises(ValueError, match=r"^film='fixed': must be one of focal, focused$"):
        require_choice("film", "fixed", ("focal", "focused"))
    for value in (None, 3, ["focal"]):
        with pytest.raises(TypeError, match=r"^film=.*: must be one of focal, focused$"):
            require_choice("film", value, iter(("focal", "focused")))


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan, 10**400, -(10**400)])
def test_a_number_is_finite_whatever_its_type(value):
    with pytest.raises(ValueError, match=f"^size={value}: must be finite"):
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
