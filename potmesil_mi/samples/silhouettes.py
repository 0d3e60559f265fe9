"""Silhouettes in pictures whose colours are antialiased and whose depth is not.

Where a near surface ends within a pixel, its colour is a mixture of two surfaces and its depth that
of one of them. Blurred as one, the light of a sharp edge is spread with the background, or that of
the background stays sharp: the halo around things in focus. So such a pixel becomes two samples,
one at each depth. Their colours are those of the surfaces beside, where pixels show one alone, and
their shares those with which the two make up the pixel's colour: the matting equation C = share F +
(1 - share) B (T. Porter & T. Duff, Compositing digital images, SIGGRAPH 1984) solved for its
share. Whatever the pixel has beyond that stays with the surface whose depth it has, so that both
together are the pixel again, exactly.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
import scipy.ndimage

from .around import Around

LEAST_STEP = 1.0
"""Pixels by which two surfaces beside each other move apart, seen through the lens, at least."""

AROUND = 3
"""Pixels to each side of a mixed one in which those are looked for that show one surface."""

BESIDE = 2.5
"""Pixels around a mixed one in which, where none shows one surface, that is looked for which shows
most of it."""

LEAST_SHARE = 0.02
"""What has less of a pixel has nothing of it."""

LEAST_CONTRAST = 1e-3
"""Part of their brightness by which two surfaces differ where their colours tell the shares."""

AT_ONCE = 1 << 16
"""Mixed pixels that are looked at in one step; it bounds the memory."""


@dataclasses.dataclass(frozen=True)
class Parts:
    """The pixels in which there are two surfaces, and what is of each: (n,), in pixels' order.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``pixel``                     index of the pixel, row by row
    ``share``                     how much of it is of the other surface, 0 to 1/2
    ``own``, ``other``            colours of that whose depth the pixel has, and of the
                                  other, (n, C)
    ``source``                    a pixel that shows the other surface: it has its depth
    ============================  ==========================================================
    """

    pixel: np.ndarray
    share: np.ndarray
    own: np.ndarray
    other: np.ndarray
    source: np.ndarray


def parts_of(colours: np.ndarray, parallax: np.ndarray) -> Parts:
    """The parts of the pixels in which a silhouette is.

    ``colours`` are (H, W, C), linear, not below 0. ``parallax``, (H, W), is by how many pixels what
    is there moves as one looks from the middle of the lens and then from its rim.
    """
    nearest, farthest = extremes(parallax, 3)
    mixed = nearest - farthest >= LEAST_STEP
    between = (nearest[mixed] + farthest[mixed]) / 2
    places = np.argwhere(mixed)
    found = [
        _parts_at(colours, parallax, mixed, places[part], between[part])
        for part in (slice(at, at + AT_ONCE) for at in range(0, max(len(places), 1), AT_ONCE))
    ]
    columns = zip(*(vars(of).values() for of in found), strict=True)
    return Parts(*(np.concatenate(column) for column in columns))


def near_silhouettes(parallax: np.ndarray) -> np.ndarray:
    """Where :func:`parts_of` looks for parts, bool (H, W), by the same parallax."""
    nearest, farthest = extremes(parallax, 3)
    return nearest - farthest >= LEAST_STEP


def extremes(values: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """The largest and the least in the square of a ``size`` around each pixel."""
    largest = scipy.ndimage.maximum_filter(values, size, mode="nearest")
    return largest, scipy.ndimage.minimum_filter(values, size, mode="nearest")


def _parts_at(
    colours: np.ndarray,
    parallax: np.ndarray,
    mixed: np.ndarray,
    places: np.ndarray,
    between: np.ndarray,
) -> Parts:
    """The parts of pixels at ``places``, (n, 2), with a parallax ``between`` those of the two."""
    row, column = places.T
    mixture = colours[row, column]
    near = parallax[row, column] >= between
    around = Around.of(row, column, mixed.shape, AROUND)
    same = (parallax[around.at] >= between) == near
    own, other = (
        _colour_of(colours, ~mixed, around, around.inside & which) for which in (same, ~same)
    )
    most_other = _most_unlike(colours, around, around.inside & ~same, own.colour)
    most_own = _most_unlike(colours, around, around.inside & same, other.colour, mixture)
    own_colour = np.where(own.is_pure[:, None], own.colour, most_own)
    other_colour = np.where(other.is_pure[:, None], other.colour, most_other)
    share = _shares(mixture, own_colour, other_colour, other.beside)
    kept = (share >= LEAST_SHARE) & (other.source >= 0)
    share, mixture = share[kept, None], mixture[kept]
    # No part may have more light than the whole.
    other_colour = np.minimum(other_colour[kept], mixture / share)
    own_colour = (mixture - share * other_colour) / (1 - share)
    pixel = (row * mixed.shape[1] + column)[kept]
    return Parts(pixel, share[:, 0], own_colour, other_colour, other.source[kept])


class _Colour(NamedTuple):
    """The colour of one side of silhouettes: (n, C), and (n,).

    ``is_pure`` is where pixels show nothing else; ``beside`` is the part of the eight pixels right
    beside that are on this side, and ``source`` the nearest pixel that is, -1 for none.
    """

    colour: np.ndarray
    is_pure: np.ndarray
    beside: np.ndarray
    source: np.ndarray


def _colour_of(colours: np.ndarray, pure: np.ndarray, around: Around, which: np.ndarray) -> _Colour:
    """That of a side which pixels ``around`` are on: the mean of the pure, or of those beside."""
    weight = which / around.apart**4
    alone = weight * pure[around.at]
    is_pure = alone.any(axis=0)
    weight = np.where(is_pure, alone, weight)
    total = np.einsum("mn,mnc->nc", weight, colours[around.at])
    right = around.apart[:, 0] < 2
    index = around.first(which)
    first = index, np.arange(which.shape[1])
    source = around.at[0][first] * colours.shape[1] + around.at[1][first]
    return _Colour(
        total / np.maximum(weight.sum(axis=0), 1e-30)[:, None],
        is_pure,
        which[right].sum(axis=0) / np.maximum(around.inside[right].sum(axis=0), 1),
        np.where(index >= 0, source, -1),
    )


def _most_unlike(
    colours: np.ndarray,
    around: Around,
    which: np.ndarray,
    than: np.ndarray,
    own: np.ndarray | None = None,
) -> np.ndarray:
    """Of the pixels right ``around`` the colour that is least like ``than``, (n, C).

    Thin things show so most of themselves. ``own`` is that of the pixels themselves.
    """
    best = np.zeros_like(than) if own is None else own
    most = np.full(len(than), -1.0) if own is None else _squares(own - than)
    for row, column, there, apart in zip(*around.at, which, around.apart[:, 0], strict=True):
        if apart <= BESIDE:
            colour = colours[row, column]
            unlike = np.where(there, _squares(colour - than), -1)
            better = unlike > most
            best = np.where(better[:, None], colour, best)
            most = np.maximum(most, unlike)
    return best


def _squares(vectors: np.ndarray) -> np.ndarray:
    return np.einsum("nc,nc->n", vectors, vectors)


def _shares(
    mixture: np.ndarray, own: np.ndarray, other: np.ndarray, beside: np.ndarray
) -> np.ndarray:
    """How much of each pixel is of the other surface, 0 to 1/2, (n,).

    The middle of the pixel shows its own surface, and so does at least half of it, where the
    silhouette is straight. Where the colours are alike, the part of the pixels ``beside`` that are
    of the other surface tells.
    """
    apart = other - own
    by_colour = np.einsum("nc,nc->n", mixture - own, apart) / np.maximum(_squares(apart), 1e-30)
    tells = _squares(apart) > LEAST_CONTRAST * _squares(other + own)
    # A straight silhouette has three of the eight beside it if it may have half of the pixel.
    most = np.minimum(beside * (4 / 3), 0.5)
    return np.clip(np.where(tells, by_colour, beside / 2), 0, most)
