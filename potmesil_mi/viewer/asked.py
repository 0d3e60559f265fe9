"""What a page asks for: read from what it sends, of which nothing is trusted."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal, get_args

from .._validation import require_choice, require_flag, require_kind, require_number, require_whole
from ..focusing.methods import MethodName

Overlay = Literal["none", "depth", "circles", "sharp", "difference"]
"""What is shown in the place of the picture, or in it."""

OVERLAYS: tuple[Overlay, ...] = get_args(Overlay)

METHODS: tuple[MethodName, ...] = get_args(MethodName)

OWN, DISC, POLYGON = "own", "disc", "polygon"
SHAPES = (OWN, DISC, POLYGON)
"""Shapes of the aperture: that of the lens at hand, or one of these."""

BLADES = (3, 12)
"""Fewest and most blades that a page offers."""

STOPS = 6.0
"""Stops by which a picture is shown lighter or darker, at most."""

LONGEST_ID = 80
"""Characters of what a page calls a question by."""


@dataclasses.dataclass(frozen=True)
class Asked:
    """A lens and how its picture is to be shown.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``id``                        text by which the page knows the answer
    ``focus_distance``            scene units along the axis, or ``inf``
    ``at``                        in its place a pixel (x, y) of the picture, to focus on what
                                  it shows; ``None`` for none
    ``opening``                   f-number, aperture radius or half-angle, as the lens has it
    ``shape``, ``blades``         of the aperture
    ``method``                    name of the method; ``own`` for the one at hand
    ``exposure``                  stops by which the picture is shown lighter
    ``overlay``                   what is shown of it
    ``small``                     whether a small picture will do
    ============================  ==========================================================
    """

    id: str
    focus_distance: float
    at: tuple[float, float] | None
    opening: float
    shape: str
    blades: int
    method: str
    exposure: float
    overlay: Overlay
    small: bool

    @classmethod
    def of(cls, message: Any) -> Asked:
        """What a ``message`` asks for.

        Raises ``TypeError`` or ``ValueError`` that names what is missing, unknown or not allowed.
        """
        require_kind("message", message, Mapping, "an object with the fields of a question")
        names = [field.name for field in dataclasses.fields(cls)]
        for name in names:
            if name not in message:
                raise ValueError(f"message: must have {name}")
        for name in message:
            if name not in names:
                raise ValueError(f"message={str(name)[:40]!r}: must have {', '.join(names)} alone")
        asked = dict(message)
        require_kind("id", asked["id"], str, "text")
        asked["id"] = asked["id"][:LONGEST_ID]
        asked["focus_distance"] = _distance(asked["focus_distance"])
        asked["at"] = _place(asked["at"])
        require_number("opening", asked["opening"], 0)
        require_choice("shape", asked["shape"], SHAPES)
        require_whole("blades", asked["blades"], *BLADES)
        require_choice("method", asked["method"], (OWN, *METHODS))
        require_number("exposure", asked["exposure"], -STOPS, STOPS)
        require_choice("overlay", asked["overlay"], OVERLAYS)
        require_flag("small", asked["small"])
        return cls(**asked)


def _distance(value: Any) -> float:
    """A distance; what is infinite is a text in JSON."""
    if value == "inf":
        return math.inf
    require_number("focus_distance", value)
    return float(value)


def _place(value: Any) -> tuple[float, float] | None:
    if value is None:
        return None
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != 2:
        raise TypeError("at: must be two numbers, x and y in pixels of the picture")
    for name, number in zip(("at[0]", "at[1]"), value, strict=True):
        require_number(name, number)
    return float(value[0]), float(value[1])
