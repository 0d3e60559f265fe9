"""Lengths and f-numbers as people write them: ``1.2m``, ``290mm``, ``f/2.8``."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

MILLIMETERS = {"m": 1000.0, "cm": 10.0, "mm": 1.0, "in": 25.4}
"""Units of length, in millimetres."""

NUMBER = r"([-+]?(?:\d+\.?\d*(?:e[-+]?\d+)?|\.\d+(?:e[-+]?\d+)?|inf|infinity|nan))"
"""A number as Python reads it; what it may be is checked where it is used."""

LENGTH = re.compile(rf"\s*{NUMBER}\s*({'|'.join(MILLIMETERS)})?\s*", re.IGNORECASE)

LONGEST = 60
"""Characters of a text that an error shows."""

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
                f"{text[:LONGEST]!r}: must be a length, such as 1.2, 1.2m or 290mm (units are "
                f"{', '.join(MILLIMETERS)}){_without_comma(text)}"
            )
        return cls(float(found[1]), found[2].lower() if found[2] else None)

    def __str__(self) -> str:
        return f"{self.number!r}{self.unit or ''}"

    def in_units(self, millimeters_per_unit: float) -> float:
        """The length in units of so many millimetres; without a unit it is in those already."""
        if self.unit is None:
            return self.number
        return self.number * MILLIMETERS[self.unit] / millimeters_per_unit


def f_number_of(text: str) -> float:
    """The f-number that a text such as ``2.8`` or ``f/2.8`` says; raises ``ValueError``."""
    found = F_NUMBER.fullmatch(text)
    if not found:
        raise ValueError(
            f"{text[:LONGEST]!r}: must be an f-number, such as 2.8 or f/2.8{_without_comma(text)}"
        )
    return float(found[1])


def length_of(name: str, value: Any, millimeters_per_unit: float | None) -> Any:
    """A length in units of so many millimetres; what is no text is in those already.

    Raises ``ValueError`` that begins with the ``name`` for text that is no length, and for one
    with a unit where nothing knows the size of a scene unit, ``None``.
    """
    if not isinstance(value, str):
        return value
    try:
        length = Length.of(value)
    except ValueError as error:
        raise ValueError(f"{name}={error}") from None
    if millimeters_per_unit is None and length.unit is not None:
        raise ValueError(
            f"{name}={value[:LONGEST]!r}: must have no unit, for a scene unit has no size"
        )
    return length.in_units(millimeters_per_unit or 1.0)


def in_one_unit(name: str, values: Sequence[Any]) -> tuple[list[Any], str | None]:
    """Values as numbers, and their unit if they are texts with one, which ``inf`` needs not have.

    Values without any text are left as they are. Raises ``ValueError`` that begins with the
    ``name`` for text that is no length, and where one has a unit and another has none.
    """
    if not any(isinstance(value, str) for value in values):
        return [*values], None
    lengths = []
    for value in values:
        try:
            lengths.append(Length.of(value) if isinstance(value, str) else Length(value, None))
        except ValueError as error:
            raise ValueError(f"{name}={error}") from None
    units = {length.unit for length in lengths if length.number != math.inf}
    if len(units) > 1 and None in units:
        raise ValueError(f"{name}={[*map(str, values)]}: must all have a unit, or none")
    if units <= {None}:
        return [length.number for length in lengths], None
    return [length.in_units(1.0) for length in lengths], "mm"


def _without_comma(text: str) -> str:
    """What helps whoever writes 1,2 for 1.2, or several with commas between."""
    return "; decimals have a point, and several have spaces between" if "," in text else ""


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
