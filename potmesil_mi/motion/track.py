"""Tracks: numbers that change from frame to frame, told by keys and by the ways between them."""

from __future__ import annotations

import bisect
import contextlib
import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal, get_args

import numpy as np

from .._units import MILLIMETERS, Length
from .._validation import require_choice, require_kind, require_number, shown

Easing = Literal["linear", "ease", "ease_in", "ease_out", "hold"]
"""How a value goes from a key to the next."""

EASINGS: tuple[Easing, ...] = get_args(Easing)
"""The easings by their names, the default first."""

Scale = Literal["linear", "reciprocal", "logarithmic"]
"""In what a value changes evenly: in itself, in 1 by it, or in its logarithm."""

SCALES: tuple[Scale, ...] = get_args(Scale)
"""The scales by their names, the default first."""

_EASED: dict[str, Callable[[float], float]] = {
    "linear": lambda t: t,
    "ease": lambda t: t * t * (3 - 2 * t),
    "ease_in": lambda t: t * t,
    "ease_out": lambda t: t * (2 - t),
    "hold": lambda t: math.floor(t),
}
"""Part of the way, 0 to 1, that is done after a part of the frames."""


@dataclasses.dataclass(frozen=True)
class Key:
    """The value at a frame, and how it goes on from there.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``frame``                     number of the frame, which may lie between two
    ``value``                     the value there
    ``easing``                    to the next key: ``linear`` (default); ``ease``, which begins
                                  and ends at rest (3t² - 2t³); ``ease_in`` (t²) and
                                  ``ease_out`` (2t - t²), which begin or end at rest;
                                  ``hold``, which stays and jumps at the next key
    ============================  ==========================================================

    Raises ``ValueError`` or ``TypeError`` that names the field.
    """

    frame: float
    value: float
    easing: Easing = "linear"

    def __post_init__(self) -> None:
        require_number("frame", self.frame)
        if not is_infinite(self.value):
            require_number("value", self.value)
        require_choice("easing", self.easing, EASINGS)


@dataclasses.dataclass(frozen=True)
class Track:
    """A number for every frame: that of the keys, and between them on the way.

    Before the first key it is that of the first, and behind the last that of the last. On the
    ``scale`` ``reciprocal`` 1 by the value changes evenly, as circles of confusion do with the
    focus distance, which may be ``inf``; on ``logarithmic`` its logarithm, as stops do with the
    f-number. Values are lengths in the ``unit``, if there is one. Raises ``ValueError`` or
    ``TypeError`` for keys whose frames do not ascend, and for values that the scale does not have.
    """

    keys: tuple[Key, ...]
    scale: Scale = "linear"
    unit: str | None = None

    def __post_init__(self) -> None:
        require_choice("scale", self.scale, SCALES)
        if self.unit is not None:
            require_choice("unit", self.unit, MILLIMETERS)
        require_kind("keys", self.keys, (tuple, list), "a tuple of Key")
        if not self.keys:
            raise ValueError(f"keys={shown(self.keys)}: there must be one at least")
        for i, key in enumerate(self.keys):
            require_kind(f"keys[{i}]", key, Key, "a Key")
            if i > 0 and not key.frame > self.keys[i - 1].frame:
                raise ValueError(
                    f"keys[{i}]: frame={key.frame:g}: must come after that of the key before, "
                    f"{self.keys[i - 1].frame:g}"
                )
            if self.scale != "reciprocal" or key.value != math.inf:
                require_number(f"keys[{i}]: value", key.value)
            if self.scale != "linear" and not key.value > 0:
                raise ValueError(f"keys[{i}]: value={key.value}: must be > 0")

    @classmethod
    def of(cls, value: Any, scale: Scale = "linear") -> Track:
        """The track of a number, or of a list of keys ``[frame, value]`` or with an easing.

        Raises ``TypeError`` for anything else, and what the constructor raises.
        """
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            return cls((_key(0, 0.0, value),), scale)
        if not is_list_of_keys(value):
            raise TypeError(
                f"{value!r}: must be a number, or a list of keys such as [[0, 1.5], [24, 3, "
                "'ease']]: frame, value and perhaps the easing to the next"
            )
        for i, key in enumerate(value):
            if not 2 <= len(key) <= 3:
                raise TypeError(f"keys[{i}]={shown(key)}: must be [frame, value] or with an easing")
        return cls(tuple(_key(i, *key) for i, key in enumerate(value)), scale)

    def at(self, frame: float) -> float:
        """The value at a frame."""
        require_number("frame", frame)
        keys = self.keys
        after = bisect.bisect_right([key.frame for key in keys], frame)
        if after == 0 or after == len(keys):
            return float(keys[max(after - 1, 0)].value)
        first, last = keys[after - 1], keys[after]
        part = _EASED[first.easing]((frame - first.frame) / (last.frame - first.frame))
        if part == 0:  # Not what rounding makes of it.
            return float(first.value)
        if self.scale == "reciprocal":
            inverse = _mix(1 / first.value, 1 / last.value, part)
            return 1 / inverse if inverse > 0 else math.inf
        if self.scale == "logarithmic":
            return math.exp(_mix(math.log(first.value), math.log(last.value), part))
        return _mix(first.value, last.value, part)


@dataclasses.dataclass(frozen=True)
class VectorTrack:
    """A point or a direction for every frame: a track for each of its three numbers."""

    x: Track
    y: Track
    z: Track

    def __post_init__(self) -> None:
        require_tracks(self, dict.fromkeys("xyz", Track), optional=False)

    @classmethod
    def of(cls, value: Any) -> VectorTrack:
        """That of three numbers, or of a list of keys ``[frame, [x, y, z]]`` or with an easing.

        Raises ``TypeError`` for anything else, and what :class:`Track` raises.
        """
        wrong = TypeError(
            f"{shown(value)}: must be three numbers, or a list of keys such as [[0, [0, 1, 5]], "
            "[24, [1, 1, 5], 'ease']]"
        )
        if not isinstance(value, list) or not value:
            raise wrong
        if not is_list_of_keys(value):
            if len(value) != 3:
                raise wrong
            return cls(*(Track.of(number) for number in value))
        for key in value:
            if not 2 <= len(key) <= 3 or not isinstance(key[1], list) or len(key[1]) != 3:
                raise wrong
        return cls(
            *(
                Track(
                    tuple(
                        _key(k, frame, point[i], *easing)
                        for k, (frame, point, *easing) in enumerate(value)
                    )
                )
                for i in range(3)
            )
        )

    def at(self, frame: float) -> np.ndarray:
        """The point or direction at a frame, float64 (3,)."""
        return np.array([track.at(frame) for track in (self.x, self.y, self.z)])


def values_at(values: Mapping[str, Any], frame: float) -> dict[str, Any]:
    """Values by their names at a frame: those of tracks, and others as they are.

    Of a track with a unit it is a text with that.
    """
    return {name: _value_at(value, frame) for name, value in values.items()}


def _value_at(value: Any, frame: float) -> Any:
    if not isinstance(value, Track):
        return value
    found = value.at(frame)
    return found if value.unit is None else str(Length(found, value.unit))


def tracks_of(
    values: Mapping[str, Any], kinds: Mapping[str, type[Track] | type[VectorTrack]]
) -> dict[str, Any]:
    """The tracks of a TOML table by their names, of which ``kinds`` has those that there are.

    Raises ``ValueError`` or ``TypeError`` that names what is unknown or wrong.
    """
    require_known(values, kinds)
    tracks: dict[str, Any] = {}
    for name, value in values.items():
        with named(name):
            tracks[name] = kinds[name].of(value)
    return tracks


def require_tracks(
    value: Any, kinds: Mapping[str, type[Track] | type[VectorTrack]], optional: bool = True
) -> None:
    """Raise ``TypeError`` for a field that is no track of its kind, nor ``None`` if it may be."""
    for name, kind in kinds.items():
        track = getattr(value, name)
        if not (optional and track is None):
            of = kind.__name__
            require_kind(name, track, kind, f"a {of}, as {of}.of gives")


def require_known(names: Mapping[str, Any], known: Iterable[str]) -> None:
    """Raise ``ValueError`` for one of the ``names``, of a table, that is not ``known``."""
    require_kind("values", names, Mapping, "a mapping, as the tables of a TOML file")
    known = tuple(known)
    for name in names:
        if name not in known:
            raise ValueError(f"{name}: unknown, must be one of {', '.join(known)}")


@contextlib.contextmanager
def at_frame(frame: float, what: str = "") -> Iterator[None]:
    """Errors of values within the block name the frame, and ``what`` there, first.

    Raises ``TypeError`` or ``ValueError`` for what is no number of a frame.
    """
    require_number("frame", frame)
    with named(f"frame {frame:g}{what}"):
        yield


@contextlib.contextmanager
def named(what: str) -> Iterator[None]:
    """Errors of values within the block name ``what`` first."""
    try:
        yield
    except (ValueError, TypeError) as error:
        raise type(error)(f"{what}: {error}") from error


def is_list_of_keys(value: Any) -> bool:
    """Whether a value is a list of lists, and not a number or several."""

    def is_list(one: Any) -> bool:
        return isinstance(one, Sequence) and not isinstance(one, str)

    return is_list(value) and len(value) > 0 and all(map(is_list, value))


def is_infinite(value: Any) -> bool:
    """Whether a value is ``inf``, as a focus distance may be."""
    return isinstance(value, (float, np.floating)) and value == math.inf


def _key(i: int, *parts: Any) -> Key:
    with named(f"keys[{i}]"):
        return Key(*parts)


def _mix(first: float, last: float, part: float) -> float:
    return first + (last - first) * part
