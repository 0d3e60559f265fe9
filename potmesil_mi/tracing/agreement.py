"""What images in mirrors and glass tell of each other: which points of the lens see them.

Points of the lens are bits of uint64, as in the column ``visibility``.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator

import numpy as np
import scipy.optimize

from ..optics.disc import lens_points
from ..samples.columns import VISIBILITY_POINTS
from .lens_rays import TURN

AROUND = 0.4
"""So near each other, in radii of the lens, are points of which one is told by the others: twice as
far as the next one is."""

LEAST_TRIES = 4
"""By so many tries, at least, it is told."""

KEYS_AT_ONCE = 1 << 12
"""So many groups of images are looked at together: memory is bounded."""


def points_of(number: np.ndarray, count: int | np.ndarray) -> np.ndarray:
    """The points of the lens that images of a ``number`` try, uint64 (N,).

    They are the point of the image's ``number``, uint32 (N,), modulo 64, and others evenly apart,
    ``count`` of them, a power of two, or one for each image.
    """
    every = np.zeros(VISIBILITY_POINTS + 1, np.uint64)
    for step in (1 << power for power in range(VISIBILITY_POINTS.bit_length())):
        every[step] = sum(1 << point for point in range(0, VISIBILITY_POINTS, step))
    stride = VISIBILITY_POINTS // np.asarray(count)
    return every[stride] << (number % stride).astype(np.uint64)


def agreed(seen: np.ndarray, tried: np.ndarray, key: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of which points of the lens images need not try: all with the same ``key`` agree.

    Returns these points, and those among them that see the images, uint64 (N,) each. ``seen`` are
    those of the points that an image has ``tried``, uint64 (N,), that see it. Where all that the
    images have tried around a point see, it does, too, and so it is where none does.
    """
    points = lens_points(VISIBILITY_POINTS)
    apart = np.linalg.norm(points[:, None] - points, axis=-1)
    near = (apart <= AROUND).astype(np.float32)
    sure, sees = np.empty_like(seen), np.empty_like(seen)
    for rows, begins, group in _groups(key):
        tries, found = (
            np.add.reduceat(bits(of[rows]), begins, axis=0, dtype=np.float32) @ near
            for of in (tried, seen)
        )
        agree = (tries >= LEAST_TRIES) & ((found == tries) | (found == 0))
        sure[rows], sees[rows] = (packed(of)[group] for of in (agree, agree & (found > 0)))
    return sure, sees


def told(
    seen: np.ndarray, known: np.ndarray, number: np.ndarray, count: int, key: np.ndarray
) -> np.ndarray:
    """Which points of the lens see images, uint64 (N,), for each of which some are ``known``.

    Those are ``count`` by the image's ``number``, see :func:`points_of`, or more; ``seen`` are
    those of them that see it. What those with the same ``key`` have seen by a point that is not
    known of an image is true of as large a part of them. What is known of none of them is as at
    the next one of its own points.
    """
    result, stride = np.empty_like(seen), VISIBILITY_POINTS // count
    for rows, begins, group in _groups(key):
        sees, knows = bits(seen[rows]), bits(known[rows])
        tries, found = (
            np.add.reduceat(of, begins, axis=0, dtype=np.float32) for of in (knows, sees)
        )
        part, any_tries = (found / np.maximum(tries, 1))[group], (tries > 0)[group]
        # Each image has a threshold of its own for each point, without a pattern.
        turn = np.arange(len(rows), dtype=np.uint32)[:, None]
        turn = turn + np.arange(VISIBILITY_POINTS, dtype=np.uint32) * np.uint32(stride)
        turn *= np.uint32(TURN)
        by_others = part > (turn >> 8).astype(np.float32) * np.float32(2**-24)
        nearest = np.take_along_axis(sees, _nearest(stride)[number[rows] % stride], axis=1)
        result[rows] = packed(np.where(knows, sees, np.where(any_tries, by_others, nearest)))
    return result


def bits(numbers: np.ndarray) -> np.ndarray:
    """The bits of numbers, uint64 (N,): bool (N, 64)."""
    numbers = np.ascontiguousarray(numbers).astype("<u8")[:, None]
    return np.unpackbits(numbers.view(np.uint8), axis=1, bitorder="little").view(bool)


def packed(values: np.ndarray) -> np.ndarray:
    """The numbers, uint64 (N,), of bits, bool (N, 64)."""
    return np.packbits(values, axis=1, bitorder="little").view("<u8").ravel()


def _groups(key: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Elements of a few groups of the same ``key`` at a time.

    Their indices, group after group, where among these each group begins, and the group of each.
    """
    order = np.argsort(key, kind="stable")
    begins = np.flatnonzero(np.diff(key[order], prepend=-1))
    ends = np.append(begins[1:], len(order))
    for first in range(0, len(begins), KEYS_AT_ONCE):
        some = slice(first, first + KEYS_AT_ONCE)
        rows = order[begins[first] : ends[some][-1]]
        group = np.repeat(np.arange(len(begins[some])), ends[some] - begins[some])
        yield rows, begins[some] - begins[first], group


@functools.cache
def _nearest(stride: int) -> np.ndarray:
    """The point of the lens next to each of which every ``stride``-th is tried, int (stride, 64).

    A row is for those from one of the first ``stride`` points on. Each of them is next to as many.
    """
    points = lens_points(VISIBILITY_POINTS)
    nearest = np.empty((stride, VISIBILITY_POINTS), np.int64)
    for first in range(stride):
        chosen = np.repeat(np.arange(first, VISIBILITY_POINTS, stride), stride)
        apart = ((points[:, None] - points[chosen]) ** 2).sum(axis=-1)
        point, place = scipy.optimize.linear_sum_assignment(apart)
        nearest[first, point] = chosen[place]
    return nearest
