"""Lengths and f-numbers as people write them: ``1.2m``, ``290mm``, ``f/2.8``."""

from __future__ import annotations

import math
import re
from typing import NamedTuple

MILLIMETERS = {"m": 1000.0, "cm": 10.0, "mm": 1.0, "in": 25.4}
"""Units of length, in millimetres."""

NUMBER = r"([-+]?(?:\d+\.?\d*(?:e[-+]?\d+)?|\.\d+(?:e[-+]?\d+)?|inf|infinity|nan))"
"""A number as Python reads it; what it may be is checked where it is used."""

LENGTH = re.compile(rf"\s*{NUMBER}\s*({'|'.join(MILLIMETERS)})?\s*", re.IGNORECASE)

F_NUMBER = re.compile(rf"\s*(?:f\s*/\s*)?{NUMBER}\s*", re.IGNORECASE)


class Length(NamedTuple):
    """A length: a number, and the ``unit`` that was written behind it, if any."""

    number: float
    unit: str | None

    @classmethod
    def of(cls, text: str) -> Length:
        """The length that a text says. Raises ``ValueError`` for any other text."""
        found = LENGTH.fullmatch(text)
        if not found:
            raise ValueError(
                f"{text!r}: must be a length, such as 1.2, 1.2m or 290mm (units are "
                f"{', '.join(MILLIMETERS)})"
            )
        return cls(float(found[1]), found[2].lower() if found[2] else None)

    def in_units(self, millimeters_per_unit: float) -> float:
        """The length in units of so many millimetres; without a unit it is in those already."""
        if self.unit is None:
            return self.number
        return self.number * MILLIMETERS[self.unit] / millimeters_per_unit


def f_number_of(text: str) -> float:
    """The f-number that a text such as ``2.8`` or ``f/2.8`` says; raises ``ValueError``."""
    found = F_NUMBER.fullmatch(text)
    if not found:
        raise ValueError(f"{text!r}: must be an f-number, such as 2.8 or f/2.8")
    return float(found[1])


def length_text(length: float, millimeters_per_unit: float) -> str:
    """A length in scene units for people: with its unit where a scene unit is one, else in mm."""
    for unit, size in MILLIMETERS.items():
        if abs(millimeters_per_unit / size - 1) < 1e-9:
            return f"{length:.4g} {unit}"
    return f"{length:.4g} ({length * millimeters_per_unit:.4g} mm)"


def said_length(value: float | None, unit: float | None) -> str:
    """A length in words, of scene units of so many millimetres; ``None`` where nothing is known."""
    if value is None:
        return "-"
    if math.isinf(value):
        return "infinity"
    return f"{value:.4g}" if unit is None else length_text(value, unit)
