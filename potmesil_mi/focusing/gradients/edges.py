"""Edges of what lens points see: how visibility changes where parallax changes.

From a lens point u the fragment f appears at x_f + p_f u, where p is its parallax, and the occluder
o at x_o + p_o u. If the light that is let through to f changes by g per subpixel there, what
is seen of f changes by g . u (dp_f - dp_o). So an edge belongs to two fragments, and what moves
both alike changes nothing.
"""

from __future__ import annotations

import drjit as dr
import numpy as np

from ... import _backend as jit
from ..lens_images import FromPoint, ImageFrame

LEAST_CHANGE = 2**-8
"""Change of visibility a subpixel below which there is no edge."""

NO_ONE = np.iinfo(np.uint32).max
"""Owner of subpixels that nothing covers."""


class Edges:
    """Edges, E of them, as they are found while visibility is.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``fragment``                  which fragment is seen more or less
    ``occluder``                  which fragment hides it there
    ``point``                     the lens point that sees it so
    ``across``, ``down``          change of what is seen, 1 for all, for each subpixel by which
                                  the fragment moves before its occluder
    ============================  ==========================================================
    """

    def __init__(self) -> None:
        self._found: list[tuple[np.ndarray, ...]] = []

    def begin(
        self, coverable: np.ndarray, covering: np.ndarray, first_point: int, size: int
    ) -> None:
        """See :class:`potmesil_mi.focusing.lens_images.EdgeFinder`."""
        self._coverable, self._covering = np.flatnonzero(coverable), np.flatnonzero(covering)
        self._first_point = first_point
        # Of several that cover a subpixel the farthest owns it: what is before it hides it, too.
        self._owner = dr.full(jit.UInt32, NO_ONE, size)

    def cover(self, fragment: jit.UInt32, place: jit.UInt32, active: jit.Bool) -> None:
        """See :class:`potmesil_mi.focusing.lens_images.EdgeFinder`."""
        mode = dr.ReduceMode.Direct
        dr.scatter_reduce(dr.ReduceOp.Min, self._owner, fragment, place, active, mode=mode)

    def look(self, looking: FromPoint, depth: jit.Float, frame: ImageFrame) -> None:
        """See :class:`potmesil_mi.focusing.lens_images.EdgeFinder`."""
        place = looking.place(frame)
        inside = looking.inside(frame) & (looking.x >= 1) & (looking.y >= 1)
        dr.eval(place)
        for is_down, step in ((False, 1), (True, frame.width)):
            stride = dr.opaque(jit.UInt32, step)
            before, beyond = (
                dr.gather(jit.Float, depth, at, inside) for at in (place - stride, place + stride)
            )
            change = (dr.exp(-beyond) - dr.exp(-before)) / 2
            owner = dr.gather(
                jit.UInt32,
                self._owner,
                dr.select(change < 0, place + stride, place - stride),
                inside,
            )
            there = inside & (dr.abs(change) > LEAST_CHANGE) & (owner != NO_ONE)
            dr.eval(there, change, owner)
            index = dr.compress(there)
            if dr.width(index) == 0:
                continue
            fragment, point, owner = (
                np.array(dr.gather(jit.UInt32, of, index))
                for of in (looking.fragment, looking.point, owner)
            )
            change = np.array(dr.gather(jit.Float, change, index))
            none = np.zeros_like(change)
            self._found.append(
                (
                    self._coverable[fragment],
                    self._covering[owner],
                    point + self._first_point,
                    none if is_down else change,
                    change if is_down else none,
                )
            )

    def columns(self) -> tuple[np.ndarray, ...]:
        """Fragment, occluder and point, int64 (E,), and the changes, float32 (E,)."""
        if not self._found:
            empty = np.empty(0, np.int64)
            return empty, empty, empty, np.empty(0, np.float32), np.empty(0, np.float32)
        return tuple(np.concatenate(of) for of in zip(*self._found, strict=True))
