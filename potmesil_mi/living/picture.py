"""What a living picture has: pictures at places of the focus, for several apertures, and depth.

It goes through JSON into a page and out of it again; what comes from a file is not trusted.
"""

from __future__ import annotations

import base64
import binascii
import dataclasses
import math
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .._validation import require_kind, require_number, require_positive, require_whole, shown
from .sweep import FocusRange

FORM = 1
"""The number of the form in which a page keeps a living picture."""

LARGEST_SIDE = 16384
"""The longest side of a picture that browsers show."""

JPEG_BEGINS = b"\xff\xd8\xff"


@dataclasses.dataclass(frozen=True)
class Level:
    """One aperture of a living picture.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``f_number``                  of the aperture
    ``places``                    where the focus is in each picture, ascending from 0, the nearest
                                  distance, to 1, the farthest, in equal steps of 1/distance
    ``pictures``                  a JPEG for each place
    ============================  ==========================================================
    """

    f_number: float
    places: tuple[float, ...]
    pictures: tuple[bytes, ...] = dataclasses.field(repr=False)


@dataclasses.dataclass(frozen=True)
class LivingPicture:
    """What a page lets one refocus, and how well: what :func:`living_picture` gives.

    ============================  ==========================================================
    Attribute                     Meaning
    ============================  ==========================================================
    ``title``                     what it is called; may be empty
    ``size``                      width and height in pixels
    ``focus_range``               nearest and farthest focus in scene units, ``.near`` and
                                  ``.far``, which may be ``inf``
    ``millimeters_per_unit``      size of a scene unit
    ``focal_length``              of the lens, in mm
    ``levels``                    the apertures, the widest first: ``.f_number``, and a JPEG in
                                  ``.pictures`` for each of ``.places``
    ``depth``                     uint8 (H, W): the place of what each pixel shows, 0 for the
                                  nearest focus and 255 for the farthest, in equal steps of 1/depth
    ``opened``                    place of the focus, 0 to 1, and number of the level with which it
                                  is first shown
    ``poster``                    JPEG of what is first shown
    ``worst``, ``median``         PSNR in dB, of 8 bits in sRGB, of what is shown against
                                  :func:`potmesil_mi.focus`, at ``measured`` pairs of focus and
                                  aperture
    ============================  ==========================================================
    """

    title: str
    size: tuple[int, int]
    focus_range: FocusRange
    millimeters_per_unit: float
    focal_length: float
    levels: tuple[Level, ...] = dataclasses.field(repr=False)
    depth: np.ndarray = dataclasses.field(repr=False)
    opened: tuple[float, int]
    poster: bytes = dataclasses.field(repr=False)
    worst: float
    median: float
    measured: int

    def to_dict(self) -> dict[str, Any]:
        """The picture as JSON has it."""
        # What is 1/inf is 0: JSON has no infinity.
        vergences = [1 / self.focus_range.near, 1 / self.focus_range.far]
        steps = np.diff(self.depth, axis=1, prepend=np.uint8(0))
        return {
            "form": FORM,
            "title": self.title,
            "size": [*self.size],
            "vergences": vergences,
            "millimeters_per_unit": self.millimeters_per_unit,
            "focal_length": self.focal_length,
            "opened": [*self.opened],
            "measured": [self.worst, self.median, self.measured],
            "depth": _text(zlib.compress(steps.tobytes(), 9)),
            "poster": _text(self.poster),
            "levels": [
                {
                    "f_number": level.f_number,
                    "places": [*level.places],
                    "pictures": [*map(_text, level.pictures)],
                }
                for level in self.levels
            ],
        }

    @classmethod
    def from_dict(cls, values: Any) -> LivingPicture:
        """The inverse of :meth:`to_dict`, for values that come from a file.

        Raises ``ValueError`` or ``TypeError`` that names what is missing or out of range.
        """
        require_kind("values", values, Mapping, "an object")
        if "form" not in values:
            raise ValueError("form: must be given")
        if values["form"] != FORM:
            raise ValueError(f"form={shown(values['form'])}: must be {FORM}")
        title = values.get("title")
        require_kind("title", title, str, "text")
        width, height = size = _several(values, "size", 2)
        for side in size:
            require_whole("size", side, 1, LARGEST_SIDE)
        near, far = _numbers(values, "vergences", 2, 0)
        if not near > far:
            raise ValueError(f"vergences={shown((near, far))}: must be of a nearer and a farther")
        for name in ("millimeters_per_unit", "focal_length"):
            require_positive(name, values.get(name))
        levels = tuple(_level(i, one) for i, one in enumerate(_several(values, "levels")))
        place, number = _several(values, "opened", 2)
        require_number("opened", place, 0, 1)
        require_whole("opened", number, 0, len(levels) - 1)
        worst, median, measured = _numbers(values, "measured", 3, 0)
        return cls(
            title,
            (width, height),
            FocusRange(1 / near, 1 / far if far else math.inf),
            float(values["millimeters_per_unit"]),
            float(values["focal_length"]),
            levels,
            _depth(values.get("depth"), (height, width)),
            (float(place), number),
            _jpeg("poster", values.get("poster")),
            worst,
            median,
            int(measured),
        )


def _level(i: int, values: Any) -> Level:
    name = f"levels[{i}]"
    require_kind(name, values, Mapping, "an object")
    require_positive(f"{name}.f_number", values.get("f_number"))
    places = _numbers(values, "places", None, 0, 1)
    if len(places) < 2 or (places[0], places[-1]) != (0, 1) or (np.diff(places) <= 0).any():
        raise ValueError(f"{name}.places={shown(places)}: must ascend from 0 to 1")
    pictures = _several(values, "pictures", len(places))
    found = tuple(_jpeg(f"{name}.pictures[{k}]", one) for k, one in enumerate(pictures))
    return Level(float(values["f_number"]), tuple(places), found)


def _several(values: Mapping[str, Any], name: str, count: int | None = None) -> Sequence[Any]:
    """A list of ``count``, or of one at least."""
    found = values.get(name)
    if not isinstance(found, list) or not found or count not in (None, len(found)):
        raise TypeError(f"{name}={shown(found)}: must be a list of {count or 'one at least'}")
    return found


def _numbers(
    values: Mapping[str, Any],
    name: str,
    count: int | None,
    least: float = -math.inf,
    most: float = math.inf,
) -> list[float]:
    found = _several(values, name, count)
    for one in found:
        require_number(name, one, least, most)
    return [float(one) for one in found]


def _text(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _data(name: str, text: Any) -> bytes:
    require_kind(name, text, str, "bytes in base64")
    try:
        return base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError):
        raise ValueError(f"{name}={shown(text)}: must be bytes in base64") from None


def _jpeg(name: str, text: Any) -> bytes:
    found = _data(name, text)
    if not found.startswith(JPEG_BEGINS):
        raise ValueError(f"{name}={shown(text)}: must be a JPEG in base64")
    return found


def _depth(text: Any, shape: tuple[int, int]) -> np.ndarray:
    """The map of places; no more is decompressed than it has pixels."""
    size = shape[0] * shape[1]
    try:
        steps = zlib.decompressobj().decompress(_data("depth", text), size + 1)
    except zlib.error:
        steps = b""
    if len(steps) != size:
        raise ValueError(f"depth={shown(text)}: must be {size} bytes, compressed, in base64")
    depth: np.ndarray = np.cumsum(np.frombuffer(steps, np.uint8).reshape(shape), 1, np.uint8)
    return depth
