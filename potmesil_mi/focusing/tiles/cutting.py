"""Where tiles are, and how far around them samples are needed."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

from ..._validation import require_whole, shown
from ...samples.point_samples import PointSamples
from ...samples.raster import Window
from ..choices import Choices
from ..film import ReconstructionFilter

MOST_ON_A_SIDE = 1024
"""Most tiles beside each other."""

BESIDE = 2
"""Pixels around what a film's filter reaches that a pixel depends on, besides its own."""


class Grid(NamedTuple):
    """How many tiles a picture is formed by: ``columns`` of them, and ``rows``."""

    columns: int
    rows: int

    @classmethod
    def of(cls, values: object, crop: Window) -> Grid:
        """The grid of two whole numbers >= 1, of tiles of a ``crop`` of a pixel at least.

        Raises ``TypeError`` or ``ValueError`` that names ``tiles``.
        """
        try:
            numbers = tuple(values)  # type: ignore[arg-type, var-annotated]
        except TypeError:
            raise TypeError(f"tiles={shown(values)}: must be columns and rows, as (2, 2)") from None
        if len(numbers) != 2:
            raise ValueError(f"tiles={shown(values)}: must be columns and rows, as (2, 2)")
        for i, (number, pixels) in enumerate(zip(numbers, (crop.width, crop.height), strict=True)):
            require_whole(f"tiles[{i}]", number, 1, min(MOST_ON_A_SIDE, pixels))
        return cls(*map(int, numbers))


@dataclasses.dataclass(frozen=True)
class Tile:
    """A tile: windows of the film, in pixels.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``core``                      what it shows of the picture
    ``own``                       what it counts: the core, and what of the samples' window is
                                  beyond the picture there
    ``crop``                      what is formed: the core, and what pixels at its edge depend on
    ``sampled``                   of what samples are needed
    ============================  ==========================================================
    """

    core: Window
    own: Window
    crop: Window
    sampled: Window


def tiles_of(
    grid: Grid,
    samples: PointSamples,
    choices: Sequence[Choices],
    rfilter: ReconstructionFilter | None,
) -> list[Tile]:
    """The tiles of a picture, row by row."""
    radius = 0.5 if rfilter is None else rfilter.radius()
    crop, window = samples.crop_window, samples.window
    margin = math.ceil(radius) + BESIDE
    halo = max(chosen.halo for chosen in choices)
    alignment = max(chosen.alignment for chosen in choices)  # Powers of 2.
    across = _edges(crop.left, crop.width, grid.columns)
    down = _edges(crop.top, crop.height, grid.rows)
    # Their own parts fill the window.
    beyond = _edges_of_own(across, window.left, window.right)
    above = _edges_of_own(down, window.top, window.bottom)
    tiles = []
    for row in range(grid.rows):
        for column in range(grid.columns):
            core = _between(across, down, column, row)
            own = _between(beyond, above, column, row)
            formed = core.grown(margin).intersection(crop)
            sampled = covering(own, formed).grown(halo).intersection(window)
            # What coarser pixels there are begins where it does in the whole picture.
            left, top = (
                first - (first - start) % alignment
                for first, start in zip(sampled[:2], window[:2], strict=True)
            )
            sampled = Window(left, top, sampled.right - left, sampled.bottom - top)
            tiles.append(Tile(core, own, formed, sampled))
    return tiles


def _edges(first: int, size: int, count: int) -> list[int]:
    """Where ``count`` parts of about one size begin, and where the last of them ends."""
    return [first + size * i // count for i in range(count + 1)]


def _edges_of_own(edges: Sequence[int], first: int, end: int) -> list[int]:
    """The same of parts that reach from ``first`` to ``end``."""
    return [first, *edges[1:-1], end]


def _between(across: Sequence[int], down: Sequence[int], column: int, row: int) -> Window:
    """The window of a column and a row between edges."""
    left, right, top, bottom = across[column], across[column + 1], down[row], down[row + 1]
    return Window(left, top, right - left, bottom - top)


def covering(one: Window, other: Window) -> Window:
    """The least window that covers two."""
    left, top = min(one.left, other.left), min(one.top, other.top)
    right, bottom = max(one.right, other.right), max(one.bottom, other.bottom)
    return Window(left, top, right - left, bottom - top)
