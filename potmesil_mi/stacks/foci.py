"""Which lenses the pictures of a focal stack have: distances, apertures, or a table of them."""

from __future__ import annotations

import csv
import dataclasses
import math
import os
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .._files import require_readable, require_suffix
from .._units import Length, f_number_of, length_of
from .._validation import require_kind, require_number, require_positive, require_whole, shown
from .._warnings import FocusWarning
from ..motion.toml import read_toml
from ..motion.track import is_infinite, named, require_known
from ..optics.lens import AnyLensChanges, ThinLens
from ..optics.lens_checks import IN_MILLIMETERS, IN_SCENE_UNITS
from ..optics.telecentric import TelecentricLens, require_lens
from ..samples.circles import FOCUS, advice, in_units_of
from ..samples.depth_range import DepthRange
from ..samples.point_samples import PointSamples

Lens = ThinLens | TelecentricLens
Changes = Mapping[str, Any]

MOST_PICTURES = 1_000_000
"""Most pictures of a stack."""

CLOSEST = 2.0
"""The nearest distance that is focused on unless it is asked for, in focal lengths: life size."""

TABLES = (".csv", ".toml")
"""Suffixes of the files that :func:`read_table` reads."""

OPENING = ("focus_distance", "f_number", "aperture_radius", "half_angle")
"""Parameters that say how a lens is focused and opened."""

LENGTHS = (*IN_MILLIMETERS, *IN_SCENE_UNITS)
"""Columns of a table that may have a unit."""

TEXTS = ("film", "aperture")
"""Columns of a table that are no numbers."""


@dataclasses.dataclass(frozen=True)
class Foci:
    """Which lenses a stack has, whatever the lens at hand is.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``distances``                 focused distances in scene units, or texts with a unit such as
                                  ``29cm``, in this order; ``inf`` is allowed for a thin lens
    ``near``, ``far``, ``count``  in their place so many distances from ``near`` to ``far``, at
                                  equal steps of the circle of confusion: in 1/U for a thin lens,
                                  where ``far`` may be ``inf``, in U for a telecentric one
    ``f_numbers``                 apertures, with each of which all distances are focused on;
                                  not of a telecentric lens
    ``table``                     in the place of all these the lenses themselves, in order: a
                                  lens each, or what it has in place of the parameters of the
                                  lens at hand
    ============================  ==========================================================

    Without distances the lens at hand stays focused as it is. Raises ``ValueError`` or
    ``TypeError`` that names the field.
    """

    distances: Sequence[float | str] | None = None
    near: float | str | None = None
    far: float | str | None = None
    count: int | None = None
    f_numbers: Sequence[float | str] | None = None
    table: Sequence[Lens | Changes] | None = None

    def __post_init__(self) -> None:
        evenly = {name: getattr(self, name) for name in ("near", "far", "count")}
        given = [name for name, value in evenly.items() if value is not None]
        for name in ("distances", "f_numbers", "table"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _several(name, getattr(self, name)))
        if self.table is not None:
            for name in ("distances", *given, "f_numbers"):
                if getattr(self, name, None) is not None:
                    both = f"{name}={shown(getattr(self, name))}", f"lenses={shown(self.table)}"
                    raise ValueError(f"{both[0]}: must not be given with {both[1]}, which say it")
            for i, one in enumerate(self.table):
                allowed = "a lens, or a mapping of its parameters"
                require_kind(f"lenses[{i}]", one, (ThinLens, TelecentricLens, Mapping), allowed)
            return
        if given and self.distances is not None:
            both = f"{given[0]}={shown(evenly[given[0]])}", f"distances={shown(self.distances)}"
            raise ValueError(f"{both[0]}: must not be given with {both[1]}")
        if given and len(given) < len(evenly):
            missing = next(name for name in evenly if name not in given)
            raise ValueError(f"{missing}: must be given with {', '.join(given)}")
        if given:
            self._require_even()
        elif self.distances is None and self.f_numbers is None:
            raise ValueError(
                "distances: must be given; or near, far and count; or f_numbers; or lenses"
            )
        for i, distance in enumerate(self.distances or ()):
            _require_length(f"distances[{i}]", distance)
        for i, f_number in enumerate(self.f_numbers or ()):
            number = _f_number(f"f_numbers[{i}]", f_number)
            if not is_infinite(number):
                require_positive(f"f_numbers[{i}]", number)
        if len(self) > MOST_PICTURES:
            raise ValueError(f"count: {len(self)} pictures: must be {MOST_PICTURES} at most")

    def _require_even(self) -> None:
        require_whole("count", self.count, 2, MOST_PICTURES)
        near, far = (
            _require_length("near", self.near, infinite=False),
            _require_length("far", self.far),
        )
        if near.unit != far.unit and None in (near.unit, far.unit) and far.number != math.inf:
            return  # Which is the nearer turns out when the size of a scene unit is known.
        if not near.in_units(1.0) < far.in_units(1.0):
            raise ValueError(f"far={shown(self.far)}: must be > near={shown(self.near)}")

    def __len__(self) -> int:
        if self.table is not None:
            return len(self.table)
        return len(self.distances or "1") * (self.count or 1) * len(self.f_numbers or "1")

    def first_lens(self) -> dict[str, Any]:
        """How the first lens is focused and opened, as far as that is told of all of them.

        Its other parameters do not matter to the sensor, whose field of view all pictures have. A
        half-angle is the widest, for samples serve that of the sensor.
        """
        if self.table is not None:
            rows = [one.parameters() if isinstance(one, Lens) else one for one in self.table]
            # What one of them lacks is to be the lens's own.
            told = [name for name in OPENING if all(name in row for row in rows)]
            first = {name: rows[0][name] for name in told}
            if "half_angle" in first:
                first["half_angle"] = max(row["half_angle"] for row in rows)
            return first
        focused = self.near if self.distances is None else self.distances[0]
        f_number = self.f_numbers[0] if self.f_numbers else None
        changes = {"focus_distance": focused, "f_number": f_number}
        return {
            name: value if isinstance(value, str) else float(value)
            for name, value in changes.items()
            if value is not None
        }

    def in_numbers(self, millimeters_per_unit: float | None) -> Foci:
        """The same with numbers in place of texts, in scene units of so many millimetres.

        The table stays. Raises ``ValueError`` for a text with a unit where the size of a scene unit
        is not known, ``None``.
        """
        unit, distances, f_numbers = millimeters_per_unit, self.distances, self.f_numbers
        if distances is not None:
            distances = [length_of(f"distances[{i}]", u, unit) for i, u in enumerate(distances)]
        if f_numbers is not None:
            f_numbers = [_f_number(f"f_numbers[{i}]", n) for i, n in enumerate(f_numbers)]
        ends = {name: length_of(name, getattr(self, name), unit) for name in ("near", "far")}
        return dataclasses.replace(self, distances=distances, f_numbers=f_numbers, **ends)

    def lenses(self, lens: Lens) -> list[Lens]:
        """All lenses, of the ``lens`` at hand. Raises what its ``replace`` does, with the place."""
        require_lens(lens)
        if self.table is not None:
            return [_lens_of(i, lens, one) for i, one in enumerate(self.table)]
        unit = float(lens.millimeters_per_unit) if isinstance(lens, ThinLens) else None
        return self.in_numbers(unit)._lenses(lens)

    def _lenses(self, lens: Lens) -> list[Lens]:
        """All lenses, of distances and f-numbers that are numbers."""
        if self.f_numbers is not None and isinstance(lens, TelecentricLens):
            raise ValueError("f_numbers: must be None for a TelecentricLens, which has none")
        found: list[Lens] = []
        distances: Sequence[Any] | None = self.distances
        if self.count is not None:
            for name in ("near", "far"):
                _replaced(lens, "focus_distance", name, getattr(self, name))
            distances = equal_circles(lens, self.near, self.far, self.count)
        opened = [lens]
        if self.f_numbers is not None:
            opened = [
                _replaced(lens, "f_number", f"f_numbers[{i}]", one)
                for i, one in enumerate(self.f_numbers)
            ]
        for one in opened:
            if distances is None:
                found.append(one)
            else:
                found += [
                    _replaced(one, "focus_distance", f"distances[{i}]", distance)
                    for i, distance in enumerate(distances)
                ]
        return found


def warn_of_no_focus(samples: PointSamples, lenses: Sequence[Lens], depth: int = 1) -> None:
    """Warn where none of the ``lenses`` is focused on anything that ``samples`` see.

    ``depth`` says for which of the callers the warning is, as ``stacklevel`` does.
    """
    depths, first = DepthRange.of(samples), None
    for lens in lenses:
        text = advice(depths, in_units_of(samples, lens), samples.camera).get(FOCUS)
        if text is None:
            return
        first = first or text
    if first is not None:
        warnings.warn(
            f"no picture is focused on anything, the first at {first}", FocusWarning, depth + 1
        )


def closest_focus(lens: ThinLens) -> float:
    """The nearest distance that a lens is focused on unless it is asked for, in scene units."""
    return CLOSEST * float(lens.focal_length) / float(lens.millimeters_per_unit)


def equal_circles(lens: Lens, near: Any, far: Any, count: int) -> list[float]:
    """Distances between which circles of confusion grow by equal steps, of which both ends are.

    They are ends that the lens can be focused on.
    """
    if isinstance(lens, TelecentricLens):
        return np.linspace(float(near), float(far), count).tolist()
    inverse = np.linspace(1 / float(near), 1 / float(far), count).tolist()
    between = [1 / one for one in inverse[1:-1]]
    return [float(near), *between, float(far)]  # Not what rounding makes of the ends.


def read_table(path: str | os.PathLike[str]) -> list[dict[str, Any]]:
    """The rows of a table of lenses, each the parameters that a lens has.

    A ``.csv`` has their names in its first line, and an empty field for what a lens has not; a
    ``.toml`` a table ``[[lenses]]`` for each. Raises ``OSError`` where it cannot be read and
    ``ValueError`` or ``TypeError`` that names the file, the row and what is wrong there.
    """
    path = require_suffix(require_readable(path), TABLES)
    if path.suffix.lower() == ".toml":
        return read_toml(path, _tables)
    with named(str(path)):
        return _rows(path)


def _tables(values: Changes) -> list[dict[str, Any]]:
    require_known(values, ("lenses",))
    tables = values.get("lenses")
    if not isinstance(tables, list) or not tables or not all(map(_is_table, tables)):
        raise TypeError(f"lenses={shown(tables)}: must be tables, [[lenses]], one at least")
    return [dict(one) for one in tables]


def _is_table(value: Any) -> bool:
    return isinstance(value, Mapping)


def _rows(path: Path) -> list[dict[str, Any]]:
    with path.open(encoding="utf-8-sig", newline="") as file:
        reader = csv.reader(file)
        names = [name.strip() for name in next(reader, [])]
        with named("line 1"):
            _require_columns(names)
        rows = []
        for fields in reader:
            if not any(field.strip() for field in fields):
                continue
            with named(f"line {reader.line_num}"):
                if len(fields) != len(names):
                    raise ValueError(f"has {len(fields)} fields, must have {len(names)}")
                pairs = zip(names, (field.strip() for field in fields), strict=True)
                rows.append({name: _value(name, text) for name, text in pairs if text})
    if not rows:
        raise ValueError("must have names of parameters in its first line, and a row at least")
    return rows


def _require_columns(names: Sequence[str]) -> None:
    """Raise ``ValueError`` for one of the names that is no parameter of a lens."""
    for name in names:
        if name and not {";", "\t"}.isdisjoint(name):
            raise ValueError(f"{shown(name)}: must be names with commas between")
    require_known(dict.fromkeys(filter(None, names)), AnyLensChanges.__annotations__)


def _value(name: str, text: str) -> float | str:
    if name in TEXTS:
        return text
    if name in LENGTHS:
        length = _require_length(name, text)
        return length.number if length.unit is None else text
    if name == "f_number":
        return _f_number(name, text)
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{name}={shown(text)}: must be a number") from None


def _f_number(name: str, value: Any) -> Any:
    """The f-number that a text says; what is no text is one. Raises ``ValueError``."""
    if not isinstance(value, str):
        return value
    try:
        return f_number_of(value)
    except ValueError as error:
        raise ValueError(f"{name}={error}") from None


def _require_length(name: str, value: Any, infinite: bool = True) -> Length:
    """The length that a number or a text is. Raises ``TypeError`` or ``ValueError``."""
    if isinstance(value, str):
        try:
            length = Length.of(value)
        except ValueError as error:
            raise ValueError(f"{name}={error}") from None
    else:
        if not (infinite and is_infinite(value)):
            require_number(name, value)
        length = Length(float(value), None)
    if not (infinite and length.number == math.inf):
        require_number(name, length.number)
    return length


def _lens_of(i: int, lens: Lens, one: Lens | Changes) -> Lens:
    with named(f"lenses[{i}]"):
        if not isinstance(one, Mapping):
            return one
        changes: Any = one
        if not all(isinstance(name, str) for name in changes):
            raise TypeError(f"{shown(one)}: must have names of parameters")
        return lens.replace(**changes)


def _replaced(lens: Lens, name: str, place: str, value: Any) -> Lens:
    """A lens with another focus distance or f-number, which errors tell the place of."""
    changes: Any = {name: float(value)}
    with named(place):
        return lens.replace(**changes)


def _several(name: str, values: Any) -> tuple[Any, ...]:
    """The values as a tuple of one at least."""
    name = "lenses" if name == "table" else name
    if isinstance(values, (str, bytes, Mapping)) or not isinstance(values, Iterable):
        raise TypeError(f"{name}={shown(values)}: must be several, in a list")
    found = tuple(values.tolist() if isinstance(values, np.ndarray) else values)
    if not found:
        raise ValueError(f"{name}={shown(values)}: must be one at least")
    return found
