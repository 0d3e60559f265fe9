"""Sweeps of the focus from near to far, and which of their pictures the others can be made of.

A place of the focus is a share: 0 is the nearest distance, 1 the farthest, and equal steps between
are equal steps of 1/distance, and so of circles of confusion. A page shows what is between two of
its pictures as a blend of both, in sRGB: measured on discs of lamps, whose rims move, that errs by
1 to 2 dB less than a blend of linear light.
"""

from __future__ import annotations

import bisect
import itertools
import math
import os
from collections.abc import Sequence
from typing import BinaryIO, NamedTuple

import numpy as np

from .jpeg import Jpeg, smallest, squared_error

STEP = 1.4
"""Steps of a sweep: how far, at most, a circle of confusion grows from one picture to the next, as
a diameter in pixels."""

BLENDED = 0.5
"""Share of the squared error that is allowed which blends may have before compression."""

COMPRESSED = 0.95
"""The same share of what compression may add."""


class FocusRange(NamedTuple):
    """From where to where the focus goes, in scene units along the axis; ``far`` may be ``inf``."""

    near: float
    far: float

    def distance_at(self, place: float) -> float:
        """The distance at a place, 0 to 1."""
        if place in (0, 1):  # Not what rounding makes of the ends.
            return self.far if place else self.near
        return 1 / (1 / self.near + place * (1 / self.far - 1 / self.near))

    def place_of(self, distance: np.ndarray | float) -> np.ndarray:
        """The places of distances, 0 to 1; those beyond the ends have these."""
        with np.errstate(divide="ignore"):
            vergence = 1 / np.asarray(distance, np.float64)
        share = (vergence - 1 / self.near) / (1 / self.far - 1 / self.near)
        return np.clip(share, 0, 1)

    def places(self, pixels: float) -> list[float]:
        """Evenly spaced places, so that circles grow by ``STEP`` at most.

        From one end to the other they grow by so many ``pixels``.
        """
        steps = max(math.ceil(pixels / STEP), 1)
        return [i / steps for i in range(steps + 1)]


def blend(before: np.ndarray, after: np.ndarray, share: float) -> np.ndarray:
    """What a page shows between two pictures, uint8: so much of the one ``after``."""
    mixed = before + np.float32(share) * (after.astype(np.float32) - before)
    mixed += np.float32(0.5)
    return mixed.astype(np.uint8)


class Sweep:
    """Pictures through one aperture from near to far, uint8 (H, W, 3).

    They are kept in a ``file``, which others may share: there may be more than memory holds.
    """

    def __init__(self, f_number: float, size: tuple[int, int], file: BinaryIO) -> None:
        self.f_number = f_number
        self.places: list[float] = []
        self._size = size
        self._file = file
        self._begins: list[int] = []
        self._errors: dict[tuple[int, int], float] = {}

    def add(self, place: float, picture: np.ndarray) -> None:
        """Keep the picture of another place."""
        index = bisect.bisect(self.places, place)
        self.places.insert(index, place)
        self._begins.insert(index, self._file.seek(0, os.SEEK_END))
        self._errors.clear()
        self._file.write(picture.tobytes())

    def gaps(self, error: float) -> list[float]:
        """Places in the middle of two pictures that :meth:`chosen` takes with none between.

        What a blend of these errs by is not known yet.
        """
        kept = self.chosen(error)
        pairs = [(i, k) for i, k in itertools.pairwise(kept) if k == i + 1]
        return [(self.places[i] + self.places[k]) / 2 for i, k in pairs]

    def chosen(self, error: float) -> list[int]:
        """Those between which blends err by no more, as few as there may be: both ends, and more.

        ``error`` is a :func:`squared_error` of pictures before compression.
        """
        found, last = [0], len(self.places) - 1
        while found[-1] < last:
            until = found[-1] + 1
            while until < last and self._error_between(found[-1], until + 1) <= error:
                until += 1
            found.append(until)
        return found

    def compressed(self, allowed: float) -> Compressed:
        """The pictures that blends of err by about ``allowed`` at most, a squared error."""
        kept = self.chosen(BLENDED * allowed)
        jpegs = [smallest(self._picture(i), COMPRESSED * allowed) for i in kept]
        places = [self.places[i] for i in kept]
        errors = tuple(
            squared_error(_at(place, places, jpegs), self._picture(i))
            for i, place in enumerate(self.places)
        )
        return Compressed(self.f_number, tuple(places), tuple(one.data for one in jpegs), errors)

    def _picture(self, index: int) -> np.ndarray:
        shape = (*self._size, 3)
        count = math.prod(shape)
        self._file.seek(self._begins[index])
        return np.frombuffer(self._file.read(count), np.uint8).reshape(shape)

    def _error_between(self, first: int, last: int) -> float:
        """The largest error of blends of two pictures at the places between them."""
        if (first, last) not in self._errors:
            before, after = self._picture(first), self._picture(last)
            begin, end = self.places[first], self.places[last]
            self._errors[first, last] = max(
                squared_error(
                    blend(before, after, (self.places[i] - begin) / (end - begin)), self._picture(i)
                )
                for i in range(first + 1, last)
            )
        return self._errors[first, last]


class Compressed(NamedTuple):
    """What a page keeps of a sweep: pictures in JPEG at ``places``.

    ``errors`` are the squared errors of what it shows at every place of the sweep.
    """

    f_number: float
    places: tuple[float, ...]
    pictures: tuple[bytes, ...]
    errors: tuple[float, ...]


def _at(place: float, places: Sequence[float], jpegs: Sequence[Jpeg]) -> np.ndarray:
    """What a page shows at a place."""
    after = min(max(bisect.bisect_right(places, place), 1), len(places) - 1)
    first, last = places[after - 1], places[after]
    return blend(jpegs[after - 1].shown, jpegs[after].shown, (place - first) / (last - first))
