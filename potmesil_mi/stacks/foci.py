"""Which lenses the pictures of a focal stack have: distances, apertures, or a table of them."""

from __future__ import annotations

import csv
import dataclasses
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .._files import require_readable, require_suffix
from .._validation import require_kind, require_number, require_positive, require_whole
from ..motion.toml import read_toml
from ..motion.track import is_infinite, named, require_known
from ..optics.lens import ThinLens
from ..optics.telecentric import TelecentricLens, require_lens

Lens = ThinLens | TelecentricLens
Changes = Mapping[str, Any]

MOST_PICTURES = 1_000_000
"""Most pictures of a stack."""

TABLES = (".csv", ".toml")
"""Suffixes of the files that :func:`read_table` reads."""

OPENING = ("focus_distance", "f_number", "aperture_radius", "half_angle")
"""Parameters that say how a lens is focused and opened."""

TEXTS = ("film", "aperture")
"""Columns of a table that are no numbers."""


@dataclasses.dataclass(frozen=True)
class Foci:
    """Which lenses a stack has, whatever the lens at hand is.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``distances``                 focused distances in scene units, in this order; ``inf`` is
                                  allowed for a thin lens
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

    distances: Sequence[float] | None = None
    near: float | None = None
    far: float | None = None
    count: int | None = None
    f_numbers: Sequence[float] | None = None
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
                    raise ValueError(f"{name}: must not be given with lenses, which say it")
            for i, one in enumerate(self.table):
                allowed = "a lens, or a mapping of its parameters"
                require_kind(f"lenses[{i}]", one, (ThinLens, TelecentricLens, Mapping), allowed)
            return
        if given and self.distances is not None:
            raise ValueError(f"{given[0]}={evenly[given[0]]}: must not be given with distances")
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
            if not is_infinite(distance):
                require_number(f"distances[{i}]", distance)
        for i, f_number in enumerate(self.f_numbers or ()):
            if not is_infinite(f_number):
                require_positive(f"f_numbers[{i}]", f_number)
        if len(self) > MOST_PICTURES:
            raise ValueError(f"count: {len(self)} pictures: must be {MOST_PICTURES} at most")

    def _require_even(self) -> None:
        require_whole("count", self.count, 2, MOST_PICTURES)
        require_number("near", self.near)
        if not is_infinite(self.far):
            require_number("far", self.far)
        if not float(self.near or 0) < float(self.far or 0):
            raise ValueError(f"far={self.far}: must be > near={self.near}")

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
        return {name: float(value) for name, value in changes.items() if value is not None}

    def lenses(self, lens: Lens) -> list[Lens]:
        """All lenses, of the ``lens`` at hand. Raises what its ``replace`` does, with the place."""
        require_lens(lens)
        if self.table is not None:
            return [_lens_of(i, lens, one) for i, one in enumerate(self.table)]
        if self.f_numbers is not None and isinstance(lens, TelecentricLens):
            raise ValueError("f_numbers: must be None for a TelecentricLens, which has none")
        found: list[Lens] = []
        distances: Sequence[float] | None = self.distances
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
        raise TypeError(f"lenses={tables!r}: must be tables, [[lenses]], one at least")
    return [dict(one) for one in tables]


def _is_table(value: Any) -> bool:
    return isinstance(value, Mapping)


def _rows(path: Path) -> list[dict[str, Any]]:
    with path.open(encoding="utf-8-sig", newline="") as file:
        reader = csv.reader(file)
        names = [name.strip() for name in next(reader, [])]
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


def _value(name: str, text: str) -> float | str:
    if name in TEXTS:
        return text
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{name}={text!r}: must be a number") from None


def _lens_of(i: int, lens: Lens, one: Lens | Changes) -> Lens:
    with named(f"lenses[{i}]"):
        if not isinstance(one, Mapping):
            return one
        changes: Any = one
        if not all(isinstance(name, str) for name in changes):
            raise TypeError(f"{one!r}: must have names of parameters")
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
        raise TypeError(f"{name}={values!r}: must be several, in a list")
    found = tuple(values.tolist() if isinstance(values, np.ndarray) else values)
    if not found:
        raise ValueError(f"{name}: must be one at least")
    return found
