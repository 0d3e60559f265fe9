"""Images in mirrors and glass, and which points of the lens see them."""

from __future__ import annotations

import dataclasses
import math

import drjit as dr
import mitsuba as mi
import numpy as np

from .._backend import from_numpy
from ..samples.columns import VISIBILITY_POINTS, visibility_points
from ..samples.grouping import grouped
from .agreement import agreed, bits, packed, points_of, told
from .lens_rays import LensRays
from .passes import wavefronts
from .rays import PrimaryRays
from .virtual_depth import Visible
from .windows import Chain, meets_end

TOLERANCE = 4.0
"""How far rays of the lens may miss what they are aimed at, in pixels: only plane mirrors show all
of the lens the same image."""

FEW_POINTS = 4
"""So many of the points are tried first, others for each sample in turn. Where these agree in a
cell of the film, no more are tried."""

TRIED_IN_A_PIXEL = 256
"""So many are tried by all samples of a pixel elsewhere, others by each in turn, and ``FEW_POINTS``
by each at least."""

CLEAR_TURNS = 4
"""Behind each so many surfaces more that turn rays a quarter as many are tried: rays cost more
there, and each goes its own way, so that no rim shows."""

ALL = 2**VISIBILITY_POINTS - 1
"""``visibility`` of what all points of the lens see."""


@dataclasses.dataclass
class VirtualImage:
    """Images, as Dr.Jit arrays.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``point``                     where the image is, if it ``is_near``
    ``direction``                 unit direction of it from the pinhole
    ``is_near``                   whether it is nearer than infinity
    ``chain``                     how the rays of the pinhole get from there to their end
    ``tolerance``                 that of :func:`meets_end`
    ============================  ==========================================================
    """

    point: mi.Point3f
    direction: mi.Vector3f
    is_near: mi.Bool
    chain: Chain
    tolerance: mi.Float

    @classmethod
    def of(cls, ray: mi.Ray3f, visible: Visible, rays: PrimaryRays) -> VirtualImage:
        """The images that primary rays show."""
        is_near = dr.isfinite(visible.depth)
        distance = dr.select(is_near, rays.distance(ray, visible.depth), 0)
        tolerance = TOLERANCE / rays.sensor.camera().focal_length_pixels
        chain = Chain.of(visible)
        return cls(ray(distance), mi.Vector3f(ray.d), is_near, chain, mi.Float(tolerance))

    def seen_from(self, u: mi.Float, v: mi.Float, lens: LensRays, active: mi.Bool) -> mi.Bool:
        """Which images points of the lens see; (u, v) to the left and upwards, in scene units."""
        origin = lens.origin + u * lens.across[0] + v * lens.across[1]
        direction = dr.select(self.is_near, dr.normalize(self.point - origin), self.direction)
        ray = mi.Ray3f(origin, direction)
        return meets_end(lens.rays.scene, ray, self.chain, self.tolerance, active)


def visibility_of(
    image: VirtualImage,
    x: np.ndarray,
    y: np.ndarray,
    cell: np.ndarray,
    lens: LensRays,
    in_a_pixel: int = TRIED_IN_A_PIXEL,
) -> np.ndarray:
    """Which points of the lens see each image, uint64 (N,).

    ``x``, ``y``, (N,), are where the images are on the film in pixels, and ``cell``, (N,), is the
    number of the cell in which that is. Each image tries a few of the points. What images that the
    same surfaces show in a cell agree on is so for all of them. Other points are tried, too, as
    many ``in_a_pixel`` with a sample for each of the pinhole's, and what the rest sees is told by
    the images that the same surfaces show in the same pixel.
    """
    number, chain = np.arange(len(x), dtype=np.uint32), image.chain
    surfaces = mi.UInt64(chain.shape) << 32 | mi.UInt64(chain.lobes << 6 | chain.turns)
    kind, _ = grouped(np.array(surfaces))
    column, row = (np.floor(at - at.min()).astype(np.uint64) for at in (x, y))
    in_cell, in_pixel = (
        grouped(grouped(place)[0] * (int(kind.max()) + 1) + kind)[0]
        for place in (cell, row * (column.max() + 1) + column)
    )
    known = points_of(number, FEW_POINTS)
    seen = seen_by(image, known, lens)
    # Most cells see everything: that is soon said.
    clear = np.bincount(in_cell) * FEW_POINTS >= VISIBILITY_POINTS
    clear &= np.bincount(in_cell, seen != known) == 0
    rest = np.flatnonzero(~clear[in_cell])
    sure, sees = np.full_like(seen, ALL), np.full_like(seen, ALL)
    sure[rest], sees[rest] = agreed(seen[rest], known[rest], in_cell[rest])
    count = _counts(np.array(chain.turns), in_a_pixel / lens.rays.passes.spp)
    more = points_of(number, count) & ~(known | sure)
    known |= sure | more
    seen |= seen_by(image, more, lens) | sees
    # Others of their pixels tell the rest.
    wants = (np.bincount(in_pixel, known != ALL) > 0)[in_pixel]
    for each in np.unique(count[wants]):
        of = np.flatnonzero(wants & (count == each))
        seen[of] = told(seen[of], known[of], number[of], int(each), in_pixel[of])
    return seen


def _counts(turns: np.ndarray, wanted: float) -> np.ndarray:
    """How many points images try, int64 (N,), that so many ``turns`` show, uint32 (N,).

    ``wanted`` are as many as images behind a few turns are to try.
    """
    most = min(max(2 ** round(math.log2(wanted)), FEW_POINTS), VISIBILITY_POINTS)
    further = np.maximum(turns.astype(np.int64) - 1, 0) // CLEAR_TURNS
    return np.maximum(most >> (2 * further), FEW_POINTS)


def seen_by(image: VirtualImage, points: np.ndarray, lens: LensRays) -> np.ndarray:
    """Which of some ``points`` of the lens see each image, as bits, uint64 (N,) each."""
    u, v = (from_numpy(mi.Float, column) for column in visibility_points(lens.radius).T)
    seen = np.zeros(len(points), np.uint64)
    for part in wavefronts(len(points), VISIBILITY_POINTS):
        looks = bits(points[part])
        # Rays to the same image are next to each other: they go the same way.
        of, point = np.nonzero(looks)
        if len(of) == 0:
            continue
        there = dr.gather(VirtualImage, image, from_numpy(mi.UInt32, of + part.start))
        at = (dr.gather(mi.Float, along, from_numpy(mi.UInt32, point)) for along in (u, v))
        looks[of, point] = np.array(there.seen_from(*at, lens, mi.Bool(True)))
        seen[part] = packed(looks)
    return seen
