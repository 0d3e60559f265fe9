"""Checks of parameters that several modules share."""

from __future__ import annotations

import math
from collections.abc import Iterable
from numbers import Real
from typing import Any

import numpy as np


def require_whole(name: str, value: Any, least: int, most: int) -> None:
    """Raise ``TypeError`` unless ``value`` is whole, ``ValueError`` unless it is in range."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{name}={value!r}: must be a whole number from {least} to {most}")
    if not least <= value <= most:
        raise ValueError(f"{name}={value}: must be {least} to {most}")


def require_number(name: str, value: Any, least: float = -math.inf, most: float = math.inf) -> None:
    """Raise ``TypeError`` unless ``value`` is a number, ``ValueError`` unless it is in range."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, Real):
        raise TypeError(f"{name}={value!r}: must be a number")
    try:
        number = float(value)
    except OverflowError:  # A whole number may be larger than any other.
        number = math.inf
    if not (least <= number <= most and math.isfinite(number)):
        allowed = f"{least:g} to {most:g}"
        if math.isinf(most):
            allowed = "finite" if math.isinf(least) else f">= {least:g} and finite"
        raise ValueError(f"{name}={value}: must be {allowed}")


def require_flag(name: str, value: Any) -> None:
    """Raise ``TypeError`` unless ``value`` is true or false."""
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{name}={value!r}: must be True or False")


def require_choice(name: str, value: Any, choices: Iterable[str]) -> None:
    """Raise ``TypeError`` unless ``value`` is text, ``ValueError`` unless it is a choice."""
    choices = tuple(choices)
    if not isinstance(value, str):
        raise TypeError(f"{name}={value!r}: must be one of {', '.join(choices)}")
    if value not in choices:
        raise ValueError(f"{name}={value!r}: must be one of {', '.join(choices)}")
