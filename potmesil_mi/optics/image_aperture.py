"""Any picture as the aperture."""

from __future__ import annotations

import base64
import binascii
import dataclasses
import functools
import math
import os
import zlib
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple, TypeVar

import numpy as np

from .._image import read_luminance
from .._spec import written
from .._validation import require_numbers, require_whole, shown
from .aperture import SHARP, points_of_map
from .arithmetic import on_host
from .attached import DifferentiableAperture
from .summed_area import interpolated, summed_area

LARGEST_SIDE = 4096
"""Most elements on a side of a picture that is an aperture."""

DESCRIBED_LEVELS = 65535
"""Largest level of an element in the text of such an aperture, in 16 bits."""

A = TypeVar("A", bound="ImageAperture")


class Overlap(NamedTuple):
    """What part of each of N elements, along an axis, lies in each of K pixels of a kernel.

    ``part`` is float64 (K, N), ``growth`` its derivative in the logarithm of the circle's radius.
    """

    part: np.ndarray
    growth: np.ndarray


@dataclasses.dataclass(frozen=True, eq=False)
class ImageAperture(DifferentiableAperture):
    """Any picture as the aperture.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``transmission_map``          what it lets through, (H, W), >= 0, brightest 1 (values are
                                  divided by the largest): rows from the top, as seen from
                                  behind the camera. Its larger side is the diameter of the
                                  aperture; what is outside the circle lets nothing through
    ============================  ==========================================================

    Two are equal if their pictures are, element by element. A text has 16 bits for each element,
    and so describes the nearest aperture of 65536 levels. Raises ``ValueError`` for a picture that
    is empty, not finite, negative or black, or of more than 4096 elements on a side.

    The picture may be a Dr.Jit tensor: if it has gradients enabled, pictures have derivatives in
    its elements, inside the circle.
    """

    transmission_map: np.ndarray

    name: ClassVar[str] = "image"
    finest: ClassVar[float] = 32

    def __post_init__(self) -> None:
        given = self.transmission_map
        values = np.array(require_numbers("transmission_map", on_host(given)), np.float64)
        if values.ndim != 2 or values.size == 0 or max(values.shape) > LARGEST_SIDE:
            raise ValueError(
                f"transmission_map={shown(on_host(given))}: has shape {values.shape}, "
                f"must be (H, W) of at most {LARGEST_SIDE}"
            )
        outside = outside_circle(values.shape)
        if not (np.isfinite(values).all() and (values >= 0).all() and values[~outside].any()):
            raise ValueError(
                "transmission_map: must be finite, >= 0, and in the circle somewhere more than 0"
            )
        values[outside] = 0
        values /= values.max()
        values += 0.0  # -0 to 0, for equal pictures to have equal bytes
        values.setflags(write=False)
        self._attach("transmission_map", given, values)

    @classmethod
    def load(cls: type[A], filename: str | os.PathLike[str]) -> A:
        """The luminance of a picture in a file that Mitsuba can read: PNG, JPEG, EXR, ..."""
        return cls(read_luminance(filename))

    @functools.cached_property
    def _integral(self) -> np.ndarray:
        height, width = self.transmission_map.shape
        return summed_area(self.transmission_map) * (2 / max(height, width)) ** 2

    def corner_area(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """See :meth:`Aperture.corner_area`; elements are uniform squares."""
        height, width = self.transmission_map.shape
        scale = max(height, width) / 2
        return interpolated(self._integral, x * scale + width / 2, y * scale + height / 2)

    def overlaps(
        self, radius: float, squeeze: float = 1.0, largest: tuple[int, int] | None = None
    ) -> tuple[Overlap, Overlap]:
        """Down and across, how kernels are made of the picture: ``down.part @ map @ across.part.T``

        is the kernel of a circle if the total of the map is 1. ``radius``, ``squeeze`` and
        ``largest`` are those of :meth:`Aperture.circle_kernel`; the point is in the middle of a
        pixel.
        """
        size = max(abs(radius), SHARP)
        height, width = self.transmission_map.shape
        found = []
        for axis, (elements, stretch) in enumerate(((width, squeeze), (height, 1.0))):
            reach = math.ceil(size / stretch)
            if largest is not None:
                reach = min(reach, largest[axis])
            edges = (np.arange(-reach, reach + 2) - 0.5) * (stretch / size * max(height, width) / 2)
            place = edges[:, None] + elements / 2 - np.arange(elements)
            part = np.diff(np.clip(place, 0, 1), axis=0)
            growth = np.diff(np.where((place > 0) & (place < 1), -edges[:, None], 0), axis=0)
            turned = slice(None, None, -1 if radius > 0 else 1)
            found.append(Overlap(part[turned], growth[turned]))
        across, down = found
        return down, across

    def points(self, count: int) -> np.ndarray:
        """See :meth:`Aperture.points`: as dense as what it lets through."""
        return points_of_map(self.transmission_map, count)

    def describe(self) -> str:
        """See :meth:`Aperture.describe`; 16 bits an element, compressed."""
        levels = np.rint(self.transmission_map * DESCRIBED_LEVELS).astype("<u2")
        data = base64.urlsafe_b64encode(zlib.compress(levels.tobytes())).decode().rstrip("=")
        height, width = levels.shape
        return written(self.name, {"width": width, "height": height, "data": data})

    @classmethod
    def of_parameters(cls: type[A], parameters: Mapping[str, Any], *, from_file: bool = False) -> A:
        """The aperture of ``filename``, or of the parameters that :meth:`describe` writes.

        A text from a file names no other file: a ``filename`` there is a ``ValueError``.
        """
        if parameters.keys() == {"width", "height", "data"}:
            return cls._described(**parameters)
        for key in parameters:
            if key != "filename":
                raise ValueError(
                    f"{key}: not a parameter of the {cls._family} {cls.name}, which has filename"
                )
        if not parameters:
            raise ValueError(f"filename: must be given for the {cls._family} {cls.name}")
        if from_file:
            raise ValueError(
                f"filename={shown(parameters['filename'])}: a file must not name another one as "
                f"the {cls._family}; only width, height and data are allowed there"
            )
        return cls.load(str(parameters["filename"]))

    @classmethod
    def _described(cls: type[A], width: Any, height: Any, data: Any) -> A:
        for name, value in (("width", width), ("height", height)):
            require_whole(name, value, 1, LARGEST_SIDE)
        size = width * height * 2
        text = str(data)
        try:
            packed = base64.b64decode(text + "=" * (-len(text) % 4), b"-_", validate=True)
            unpacking = zlib.decompressobj()
            # One more than is right tells a longer picture, and that is as far as it goes.
            levels = unpacking.decompress(packed, size + 1)
        except (binascii.Error, ValueError, zlib.error) as error:
            raise ValueError(f"data={text[:20]!r}...: is damaged: {error}") from error
        if len(levels) != size or not unpacking.eof:
            raise ValueError(
                f"data={text[:20]!r}...: must be {width} x {height} elements of 16 bits, "
                f"{size} bytes"
            )
        return cls(np.frombuffer(levels, "<u2").reshape(height, width) / DESCRIBED_LEVELS)

    def __str__(self) -> str:
        return repr(self)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, ImageAperture):
            return NotImplemented
        return np.array_equal(self.transmission_map, other.transmission_map)

    @functools.cached_property
    def _hash(self) -> int:
        return hash((self.transmission_map.shape, self.transmission_map.tobytes()))

    def __hash__(self) -> int:
        return self._hash

    def __repr__(self) -> str:
        return f"ImageAperture({'x'.join(map(str, self.transmission_map.shape[::-1]))})"


def outside_circle(shape: tuple[int, ...]) -> np.ndarray:
    """Which elements of a picture (H, W) lie outside the circle of an aperture, bool."""
    down, across = np.indices(shape) + 0.5
    height, width = shape
    return np.hypot(across - width / 2, down - height / 2) > max(height, width) / 2
