"""The shutter: when light comes in while a picture is exposed, and how much of it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, Literal, get_args

from .._validation import require_choice, require_not_before, require_number, require_whole
from .track import require_known

Profile = Literal["box", "triangle"]
"""How a shutter opens and closes."""

PROFILES: tuple[Profile, ...] = get_args(Profile)
"""The profiles by their names, the default first."""

MOST_INSTANTS = 256
"""Most instants of an exposure."""


@dataclasses.dataclass(frozen=True)
class Shutter:
    """When a shutter is open, in frames after that of the picture, and how far.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``open``, ``close``           when it begins to open and when it has closed (default 0 and
                                  1); a shutter of 180 degrees is open for half a frame
    ``profile``                   ``box`` (default): wholly open all the time; ``triangle``:
                                  it opens evenly until the middle, and closes
    ``instants``                  how many times the scene is sampled during the exposure, 1 to
                                  256; by default as the longest path in the picture asks for.
                                  Between them surfaces are moved along their paths; shadows and
                                  reflections are only what they are at these instants
    ============================  ==========================================================

    Raises ``ValueError`` or ``TypeError`` that names the field.
    """

    open: float = 0.0
    close: float = 1.0
    profile: Profile = "box"
    instants: int | None = None

    def __post_init__(self) -> None:
        require_number("open", self.open)
        require_not_before("close", self.close, "open", float(self.open))
        require_choice("profile", self.profile, PROFILES)
        if self.instants is not None:
            require_whole("instants", self.instants, 1, MOST_INSTANTS)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Shutter:
        """The shutter of a TOML table. Raises ``ValueError`` or ``TypeError`` for a wrong one."""
        require_known(values, (field.name for field in dataclasses.fields(cls)))
        return cls(**values)

    def frame_when(self, light: float) -> float:
        """The frame, after that of the picture, when a part of the ``light``, 0 to 1, is in."""
        require_number("light", light, 0, 1)
        if self.profile == "triangle":
            half = math.sqrt(min(light, 1 - light) / 2)
            light = half if light < 0.5 else 1 - half
        return self.open + (self.close - self.open) * light
