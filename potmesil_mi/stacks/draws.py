"""Draws: values of a recipe that chance chooses, the same ones for the same seed.

Each value is drawn by a generator of its own, which the seed and the name of the value make. So it
does not depend on how many others there are, nor on the order in which they are drawn.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from .._units import Length, in_one_unit
from .._validation import require_number, shown
from ..motion.track import is_infinite

INTERVALS: dict[str, tuple[Callable[[float], float], Callable[[float], float]]] = {
    "uniform": (lambda x: x, lambda x: x),
    "log_uniform": (math.log, math.exp),
    "reciprocal_uniform": (lambda x: 1 / x, lambda x: 1 / x if x > 0 else math.inf),
}
"""Draws between two numbers: in what they are even, and the way back."""

CHOICE = "choice"

ALLOWED = (
    "a number or text; or a table with one of uniform, log_uniform, reciprocal_uniform = [least, "
    "most] and choice = [one, another, ...]"
)


@dataclasses.dataclass(frozen=True)
class Draw:
    """A value that chance chooses.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``kind``                      ``uniform``, ``log_uniform`` or ``reciprocal_uniform``: between
                                  two numbers, evenly in themselves, in the logarithm, in 1 by
                                  them; ``choice``: one of several
    ``values``                    the two numbers, the lesser first; or what is chosen from
    ``unit``                      of the two numbers; ``None``: what is drawn is a number, and else
                                  a text with this unit
    ============================  ==========================================================
    """

    kind: str
    values: tuple[Any, ...]
    unit: str | None = None

    @classmethod
    def of(cls, name: str, value: Any) -> Draw:
        """The draw that a value of a recipe is: what is no table is a choice of one.

        Raises ``TypeError`` or ``ValueError`` that begins with the ``name`` and the value.
        """
        wrong = f"{name}={shown(value)}: must be {ALLOWED}"
        if not isinstance(value, Mapping):
            if isinstance(value, bool) or not isinstance(value, (int, float, str)):
                raise TypeError(wrong)
            return cls(CHOICE, (value,))
        if len(value) != 1:
            raise ValueError(wrong)
        ((kind, values),) = value.items()
        if kind not in (*INTERVALS, CHOICE) or not isinstance(values, list) or not values:
            raise ValueError(wrong)
        if kind == CHOICE:
            if not all(isinstance(one, (int, float, str)) for one in values):
                raise TypeError(wrong)
            return cls(kind, tuple(values))
        if len(values) != 2:
            raise ValueError(wrong)
        values, unit = in_one_unit(f"{name}.{kind}", values)
        for i, end in enumerate(values):
            if not (is_infinite(end) and kind == "reciprocal_uniform"):
                require_number(f"{name}.{kind}[{i}]", end)
            if kind != "uniform" and not end > 0:
                raise ValueError(f"{name}.{kind}[{i}]={shown(end)}: must be > 0")
        if not values[0] <= values[1]:
            raise ValueError(f"{name}.{kind}={shown(values)}: must be the lesser number first")
        return cls(kind, tuple(map(float, values)), unit)

    def at(self, seed: int, name: str) -> Any:
        """The value of that ``name`` for a seed."""
        random = np.random.default_rng(seed_of(seed, name))
        if self.kind == CHOICE:
            return self.values[int(random.integers(len(self.values)))]
        there, back = INTERVALS[self.kind]
        first, last = map(there, self.values)
        low, high = self.values
        found = min(max(back(first + (last - first) * random.random()), low), high)
        return found if self.unit is None else str(Length(found, self.unit))


def seed_of(seed: int, name: str) -> int:
    """A seed for what has that ``name``, 0 to 2^32 - 1."""
    digest = hashlib.sha256(f"{seed}/{name}".encode()).digest()
    return int.from_bytes(digest[:4], "little")
