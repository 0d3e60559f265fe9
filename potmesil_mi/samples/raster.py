"""Windows: rectangles of pixels of the film, and of the subpixels that pictures are formed on.

Pixel (i, j) of the film covers [i, i + 1] x [j, j + 1], from the top left corner of the whole film;
a window may begin before it and end behind it. Here stands once how positions become pixels, how
windows overlap, and where one lies in an array that covers another.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from .._validation import require_kind, require_whole, shown

FARTHEST = 1 << 24
"""Pixels from the film's corner from where on float32 no longer tells neighbours apart."""


class Window(NamedTuple):
    """A rectangle of whole pixels, or of subpixels, of the film.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``left``, ``top``             first column and first row
    ``width``, ``height``         columns and rows; a window without one is empty
    ============================  ==========================================================

    It equals the tuple of its four numbers. Nothing is checked here: :meth:`of` checks what comes
    from outside.
    """

    left: int
    top: int
    width: int
    height: int

    @classmethod
    def of(cls, values: Any, name: str = "window") -> Window:
        """The window of four whole numbers, of whatever type, as Python's numbers.

        Raises ``TypeError`` for other than whole numbers, ``ValueError`` for other than four of
        them, for less than one pixel, and for one farther from the film's corner than
        ``FARTHEST``; each says ``name``.
        """
        require_kind("name", name, str, "the name of the parameter")
        try:
            numbers = tuple(values)
        except TypeError:
            raise TypeError(
                f"{name}={shown(values)}: must be left, top, width and height"
            ) from None
        if len(numbers) != 4:
            raise ValueError(f"{name}={shown(values)}: must be left, top, width and height")
        for i, (number, least) in enumerate(
            zip(numbers, (-FARTHEST, -FARTHEST, 1, 1), strict=True)
        ):
            require_whole(f"{name}[{i}]", number, least, FARTHEST)
        return cls(*map(int, numbers))

    @property
    def right(self) -> int:
        """The first column behind the window."""
        return self.left + self.width

    @property
    def bottom(self) -> int:
        """The first row below the window."""
        return self.top + self.height

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns: the shape of an array with one element for each pixel."""
        return self.height, self.width

    @property
    def size(self) -> int:
        """How many pixels it has."""
        return self.width * self.height

    @property
    def is_empty(self) -> bool:
        """Whether it has no pixel."""
        return self.width <= 0 or self.height <= 0

    def grown(self, margin: int) -> Window:
        """The window and ``margin`` (>= 0) pixels around it."""
        return Window(
            self.left - margin, self.top - margin, self.width + 2 * margin, self.height + 2 * margin
        )

    def subdivided(self, n: int) -> Window:
        """The same rectangle in subpixels, ``n`` x ``n`` in a pixel: all four numbers times n."""
        return Window(self.left * n, self.top * n, self.width * n, self.height * n)

    def relative_to(self, outer: Window) -> Window:
        """The same rectangle, counted from the first pixel of ``outer``."""
        return Window(self.left - outer.left, self.top - outer.top, self.width, self.height)

    def intersection(self, other: Window) -> Window:
        """The pixels that lie in both; where there are none, an empty window, never a negative."""
        left, top = max(self.left, other.left), max(self.top, other.top)
        right = max(min(self.right, other.right), left)
        bottom = max(min(self.bottom, other.bottom), top)
        return Window(left, top, right - left, bottom - top)

    def covers(self, other: Window) -> bool:
        """Whether all pixels of ``other`` lie in this window."""
        return other.is_empty or self.intersection(other) == other

    def slices_in(self, outer: Window) -> tuple[slice, slice]:
        """Rows and columns of this window in an array that covers ``outer``, which covers it."""
        rows = slice(self.top - outer.top, self.bottom - outer.top)
        return rows, slice(self.left - outer.left, self.right - outer.left)

    def contains(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Which positions, or pixels, lie in the window: bool (N,).

        The first column and row belong to it, ``right`` and ``bottom`` do not.
        """
        inside = (x >= self.left) & (x < self.right)
        inside &= (y >= self.top) & (y < self.bottom)
        return inside

    def pixel_of(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Index of the pixel, row by row, of each position (x, y), int64 (N,).

        A position on an edge between pixels belongs to the one on its right or below it; on the
        window's last edge, and beyond the window, to the nearest pixel.
        """
        column = np.clip(np.floor(x).astype(np.int64) - self.left, 0, self.width - 1)
        row = np.clip(np.floor(y).astype(np.int64) - self.top, 0, self.height - 1)
        return row * self.width + column

    def shows(
        self, x: np.ndarray, y: np.ndarray, outer: Window, *, edges: bool = False
    ) -> np.ndarray:
        """Which positions belong to pixels of this window, as :meth:`pixel_of` of ``outer`` says.

        ``outer`` covers this window; what lies beyond its edges belongs to its border. With
        ``edges`` positions on the last edges of the window belong to it, too: the corners of
        pixels, which several share. Returns bool (N,).
        """
        inside = np.ones(len(x), dtype=bool)
        for at, first, end, outer_first, outer_end in (
            (x, self.left, self.right, outer.left, outer.right),
            (y, self.top, self.bottom, outer.top, outer.bottom),
        ):
            if first > outer_first:
                inside &= at >= first
            if end < outer_end:
                inside &= (at <= end) if edges else (at < end)
        return inside

    def pixels(self) -> tuple[np.ndarray, np.ndarray]:
        """Column and row of every pixel of the film in it, row by row, int64 (size,) each."""
        row, column = np.divmod(np.arange(self.size), self.width)
        return column + self.left, row + self.top

    def tiles(self, size: int) -> Iterator[Window]:
        """Windows of ``size`` x ``size`` pixels, smaller at the right and below, row by row.

        Each pixel lies in one of them. Raises ``ValueError`` for a size that is not > 0.
        """
        require_whole("size", size, 1, FARTHEST)
        for top in range(self.top, self.bottom, size):
            for left in range(self.left, self.right, size):
                yield self.intersection(Window(left, top, size, size))
