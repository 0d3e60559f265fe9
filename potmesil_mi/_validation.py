"""Checks of parameters that several modules share."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Iterable
from numbers import Real
from typing import Any

import numpy as np

LONGEST_SHOWN = 80
"""Characters of a value that an error shows."""


class _Shortened(reprlib.Repr):
    """``repr`` on one line of bounded length, whatever it is given."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel = 3
        self.maxstring = self.maxother = LONGEST_SHOWN

    def repr_int(self, x: int, level: int) -> str:
        # Python refuses to write numbers of more than 4300 digits.
        long = x.bit_length() > 10_000
        return f"an int of {x.bit_length()} bits" if long else super().repr_int(x, level)

    def repr_ndarray(self, x: np.ndarray, level: int) -> str:
        with np.printoptions(threshold=8, edgeitems=2):
            return self.repr_instance(x, level)


def shown(value: Any) -> str:
    """A value as an error shows it: its ``repr``, on one line and no longer than can be read."""
    if isinstance(value, (np.generic, np.ndarray)) and value.ndim == 0:
        value = value.item()
    text = " ".join(_Shortened().repr(value).split())
    if len(text) <= LONGEST_SHOWN:
        return text
    half = (LONGEST_SHOWN - 3) // 2
    return f"{text[:half]}...{text[-half:]}"


def require_whole(name: str, value: Any, least: int, most: int) -> None:
    """Raise ``TypeError`` unless ``value`` is whole, ``ValueError`` unless it is in range."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{name}={shown(value)}: must be a whole number from {least} to {most}")
    if not least <= value <= most:
        raise ValueError(f"{name}={shown(value)}: must be {least} to {most}")


def require_number(name: str, value: Any, least: float = -math.inf, most: float = math.inf) -> None:
    """Raise ``TypeError`` unless ``value`` is a number, ``ValueError`` unless it is in range."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, Real):
        raise TypeError(f"{name}={shown(value)}: must be a number")
    try:
        number = float(value)
    except OverflowError:  # A whole number may be larger than any other.
        number = math.inf
    if not (least <= number <= most and math.isfinite(number)):
        allowed = f"{least:g} to {most:g}"
        if math.isinf(most):
            allowed = "finite" if math.isinf(least) else f">= {least:g} and finite"
        raise ValueError(f"{name}={shown(value)}: must be {allowed}")


def require_positive(name: str, value: Any, unit: str = "") -> None:
    """Raise unless ``value`` is a finite number > 0, of ``unit``."""
    require_number(name, value)
    if not value > 0:
        raise ValueError(f"{name}={shown(value)}: must be > 0{unit and f' {unit}'}")


def require_field_of_view(name: str, value: Any) -> None:
    """Raise unless ``value`` is a number > 0 and < 180, of degrees."""
    require_number(name, value)
    if not 0 < value < 180:
        raise ValueError(f"{name}={shown(value)}: must be > 0 and < 180 degrees")


def require_not_before(name: str, value: Any, first: str, begin: float) -> None:
    """Raise unless ``value`` is a number that is no less than ``begin``, the value of ``first``."""
    require_number(name, value)
    if value < begin:
        raise ValueError(f"{name}={shown(value)}: must be >= {begin:g}, which is {first}")


def require_kind(name: str, value: Any, kinds: type | tuple[type, ...], allowed: str) -> None:
    """Raise ``TypeError`` unless ``value`` is of one of the ``kinds``."""
    if not isinstance(value, kinds):
        raise TypeError(f"{name}={shown(value)}: must be {allowed}")


def require_numbers(name: str, values: Any) -> np.ndarray:
    """The array of ``values``, of any shape. Raise ``TypeError`` unless all are numbers."""
    try:
        array = np.asarray(values)
    except ValueError:  # Lists of unequal lengths.
        array = np.empty(0, object)
    if array.dtype.kind not in "biuf":
        raise TypeError(f"{name}={shown(values)}: must be numbers")
    return array


def require_vector(name: str, values: Any) -> np.ndarray:
    """The three ``values``, float64 (3,). Raise unless they are finite numbers."""
    vector = require_numbers(name, values).astype(np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f"{name}={shown(values)}: must be three finite numbers")
    return vector


def require_flag(name: str, value: Any) -> None:
    """Raise ``TypeError`` unless ``value`` is true or false."""
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{name}={shown(value)}: must be True or False")


def require_choice(name: str, value: Any, choices: Iterable[str]) -> None:
    """Raise ``TypeError`` unless ``value`` is text, ``ValueError`` unless it is a choice."""
    choices = tuple(choices)
    if not isinstance(value, str):
        raise TypeError(f"{name}={shown(value)}: must be one of {', '.join(choices)}")
    if value not in choices:
        raise ValueError(f"{name}={shown(value)}: must be one of {', '.join(choices)}")
