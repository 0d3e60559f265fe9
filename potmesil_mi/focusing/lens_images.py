"""Images of lens points: where in them the points see fragments."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple, Protocol

import drjit as dr
import numpy as np

from .. import _backend as jit
from ..samples.raster import Window


class ImageFrame(NamedTuple):
    """Subpixels of a lens point's image: the ``window`` and a ``margin`` around it.

    They are counted from the first of the frame of the whole picture, of which the window may be a
    tile. If it ``is_narrow`` there are fragments beyond it; a tile then is the whole picture.
    """

    window: Window
    margin: int
    is_narrow: bool

    @property
    def width(self) -> int:
        """Columns of an image."""
        return self.window.width + 2 * self.margin

    @property
    def height(self) -> int:
        """Rows of an image."""
        return self.window.height + 2 * self.margin

    @property
    def size(self) -> int:
        """Subpixels of an image."""
        return self.width * self.height


@dataclasses.dataclass(frozen=True)
class FromPoint:
    """Fragments, points (u, v) of the lens, and where (x, y) in the frame these see those."""

    fragment: jit.UInt32
    point: jit.UInt32
    u: jit.Float
    v: jit.Float
    x: jit.Float
    y: jit.Float

    def inside(self, frame: ImageFrame) -> jit.Bool:
        """Which are in the frame with the subpixels right of and below them."""
        if not frame.is_narrow:
            return jit.Bool(True)
        right, below = (dr.opaque(jit.Float, of - 2) for of in (frame.width, frame.height))
        return (self.x >= 0) & (self.y >= 0) & (self.x < right) & (self.y < below)

    def place(self, frame: ImageFrame) -> jit.UInt32:
        """Index in images of all points, one after the other."""
        left, top = (dr.opaque(jit.UInt32, of) for of in frame.window[:2])
        row = (jit.UInt32(self.y) - top) * dr.opaque(jit.UInt32, frame.width)
        row += jit.UInt32(self.x) - left
        return self.point * dr.opaque(jit.UInt32, frame.size) + row


class EdgeFinder(Protocol):
    """What is told of the images of lens points while these are made, to find the edges in them."""

    def begin(
        self, coverable: np.ndarray, covering: np.ndarray, first_point: int, size: int
    ) -> None:
        """Images of ``size`` subpixels in all, of points from ``first_point`` on, are begun.

        ``coverable`` and ``covering``, bool (N,), are the fragments that are looked for and those
        that cover them.
        """
        ...

    def cover(self, fragment: jit.UInt32, place: jit.UInt32, active: jit.Bool) -> None:
        """Fragments, by their numbers among the ``covering``, cover subpixels."""
        ...

    def look(self, looking: FromPoint, depth: jit.Float, frame: ImageFrame) -> None:
        """Fragments are looked for behind what has that optical ``depth``."""
        ...
