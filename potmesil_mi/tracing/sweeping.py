"""What comes into sight while things move: the same rays of the lens, at another time.

Shapes keep their places in Mitsuba's scene while its rays are traced. What one of them hides at the
middle of a part of an exposure, it may not hide at its ends: then the lens and what is hidden are
moved against it, by the inverse of its motion, and the ray between them is traced in the scene as
it is.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from .._backend import from_numpy
from .lens_rays import LensRays, Target

POINTS = 4
"""Points of the lens that look at each end of the time."""


class Ends(NamedTuple):
    """What has moved until one end of a part of an exposure: matrices of the world, (4, 4).

    ``shapes`` are by ids of surfaces, of those that move; ``camera`` is the camera's.
    """

    shapes: Mapping[int, np.ndarray]
    camera: np.ndarray


@dataclasses.dataclass(frozen=True)
class Sweep:
    """The motions of a part of an exposure.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``reach``                     pixels that anything moves to either side of where it is
    ``moves``                     whether the surface of each id moves
    ``ends``                      for each end of the time: the matrices of all surfaces, 12
                                  numbers each, their inverses, and that of the camera
    ============================  ==========================================================
    """

    reach: float
    moves: mi.Bool
    ends: list[tuple[mi.Float, mi.Float, np.ndarray]]

    @classmethod
    def of(cls, reach: float, count: int, ends: Sequence[Ends]) -> Sweep:
        """The sweep of surfaces with ids up to ``count``."""
        moves = np.zeros(count + 1, dtype=bool)
        tables = []
        for end in ends:
            matrices = np.tile(np.eye(4), (count + 1, 1, 1))
            for id_, matrix in end.shapes.items():
                matrices[id_], moves[id_] = matrix, True
            own, inverse = (
                from_numpy(mi.Float, of[:, :3].astype(np.float32).ravel())
                for of in (matrices, np.linalg.inv(matrices))
            )
            tables.append((own, inverse, end.camera))
        if any(not np.allclose(end.camera, np.eye(4), atol=1e-9) for end in ends):
            moves[:] = True
        return cls(reach, from_numpy(mi.Bool, moves), tables)

    def shows(
        self, lens: LensRays, target: Target, surface: mi.UInt32, hider: mi.UInt32
    ) -> mi.Bool:
        """Whether any point of the ``lens`` sees each target at an end, bool (N,).

        ``surface`` is that of the target, ``hider`` that which hides it from the pinhole.
        """
        sees = dr.zeros(mi.Bool, dr.width(target))
        moves = dr.gather(mi.Bool, self.moves, surface) | dr.gather(mi.Bool, self.moves, hider)
        which = dr.compress(moves)
        if dr.width(which) == 0:
            return sees
        target, surface, hider = (dr.gather(type(of), of, which) for of in (target, surface, hider))
        found = dr.zeros(mi.Bool, dr.width(which))
        for own, inverse, camera in self.ends:
            moved, there = self._moved(lens, target, surface, hider, own, inverse, camera)
            dr.eval(moved, there.origin, there.across, there.axis)
            found |= there.see(moved, dr.zeros(mi.UInt32, dr.width(which)), mi.UInt32(POINTS))
            dr.eval(found)
        dr.scatter(sees, found, which)
        return sees

    @staticmethod
    def _moved(
        lens: LensRays,
        target: Target,
        surface: mi.UInt32,
        hider: mi.UInt32,
        own: mi.Float,
        inverse: mi.Float,
        camera: np.ndarray,
    ) -> tuple[Target, LensRays]:
        """The targets and the lens as the hider of each would have them if it had not moved."""
        forth = [dr.gather(mi.Float, own, surface * 12 + k) for k in range(12)]
        back = [dr.gather(mi.Float, inverse, hider * 12 + k) for k in range(12)]
        own_camera = [mi.Float(float(number)) for number in camera[:3].ravel()]

        def point(of: mi.Point3f, first: list[mi.Float]) -> mi.Point3f:
            return mi.Point3f(_applied(back, _applied(first, of, 1), 1))

        def vector(of: mi.Vector3f, first: list[mi.Float]) -> mi.Vector3f:
            return mi.Vector3f(_applied(back, _applied(first, of, 0), 0))

        moved = Target(
            point=point(target.point, forth),
            normal=mi.Normal3f(vector(mi.Vector3f(target.normal), forth)),
            direction=vector(target.direction, forth),
            met=target.met,
            number=target.number,
        )
        left, up = (vector(of, own_camera) for of in lens.across)
        return moved, dataclasses.replace(
            lens,
            origin=point(lens.origin, own_camera),
            axis=vector(lens.axis, own_camera),
            across=(left, up),
        )


def _applied(matrix: Sequence[mi.Float], of: mi.Vector3f, shift: int) -> mi.Vector3f:
    """A vector, or a point with a ``shift`` of 1, moved by a matrix of 12 numbers."""
    x, y, z = of[0], of[1], of[2]
    return mi.Vector3f(
        *(
            dr.fma(a, x, dr.fma(b, y, dr.fma(c, z, shift * d)))
            for a, b, c, d in (matrix[:4], matrix[4:8], matrix[8:])
        )
    )
