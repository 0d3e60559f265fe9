"""What the lens sees of samples, as far as it stands still, and what of it has derivatives."""

from __future__ import annotations

import dataclasses
import functools
from typing import NamedTuple

import drjit as dr
import numpy as np

from ... import _backend as jit
from ...samples.point_samples import PointSamples
from ..fragments import SHARE, as_column, scatter_mode
from ..lens_points import LensPoints
from ..lens_view import LEAST_SEEN
from ..visibility import visibility
from .edges import Edges
from .gathering import Gathering, gather


class EdgeColumns(NamedTuple):
    """Edges, see :class:`.edges.Edges`, of occluded fragments.

    ``lane`` is the pair of an occluded fragment and a lens point, ``along`` the change of what is
    seen for each subpixel of parallax by which the fragment moves before its occluder.
    """

    lane: jit.UInt32
    fragment: jit.UInt32
    occluder: jit.UInt32
    along: jit.Float


@dataclasses.dataclass(frozen=True)
class SmoothView:
    """Fragments, and what each lens point sees of them.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``gathering``                 the fragments, and of which samples they are
    ``unoccluded``                int64 (n,), those that all lens points see, and go on seeing
    ``occluded``                  int64 (m,), those of which some see nothing or not all, or will
    ``seen``                      uint8 (m, M), what each point sees of these, 0 to 255
    ``edges``                     where that changes as parallax does
    ``points``                    float64 (M, 2), the lens points
    ``radius_per_vergence``       of the lens that they are of, in subpixels
    ============================  ==========================================================
    """

    gathering: Gathering
    unoccluded: np.ndarray
    occluded: np.ndarray
    seen: np.ndarray
    edges: EdgeColumns
    points: np.ndarray
    radius_per_vergence: float

    @classmethod
    def of(
        cls,
        samples: PointSamples,
        subpixels: int,
        radius_per_vergence: float,
        lens_points: LensPoints,
        alpha: bool,
    ) -> SmoothView:
        """What the ``lens_points`` see of ``samples``."""
        gathering = gather(samples, subpixels, radius_per_vergence, alpha)
        fragments, found = gathering.fragments, Edges()
        points = lens_points.points
        coverable, seen = visibility(fragments, radius_per_vergence, points, None, found)
        first = fragments.gap_in_front[coverable] == 0
        seen[first, 0] = np.maximum(seen[first, 0], LEAST_SEEN)
        if lens_points.has_rim:
            inside = lens_points.inside_rim(fragments, points)
            inside[~inside.any(axis=1), 0] = True
            of_all = np.full(inside.shape, 255, np.uint8)
            of_all[coverable] = seen
            seen, coverable = of_all * inside, np.ones(len(fragments), dtype=bool)
            scale = len(points) / inside.sum(axis=1)
            gathering = gathering.scaled(scale.astype(np.float32))
        fragment, occluder, point, across, down = found.columns()
        has_edge = np.zeros(len(fragments), dtype=bool)
        has_edge[fragment] = True
        all_seen = np.ones(len(fragments), dtype=bool)
        some_seen = all_seen.copy()
        all_seen[coverable], some_seen[coverable] = seen.min(axis=1) == 255, seen.any(axis=1)
        unoccluded = all_seen & ~has_edge
        occluded = ~unoccluded & (some_seen | has_edge)
        row = np.cumsum(occluded) - 1
        along = across * points[point, 0] + down * points[point, 1]
        if lens_points.has_rim:
            along *= inside[fragment, point]
        return cls(
            gathering,
            np.flatnonzero(unoccluded),
            np.flatnonzero(occluded),
            np.ascontiguousarray(seen[occluded[coverable]]),
            EdgeColumns(
                jit.from_numpy(jit.UInt32, row[fragment] * len(points) + point),
                jit.from_numpy(jit.UInt32, fragment),
                jit.from_numpy(jit.UInt32, occluder),
                jit.from_numpy(jit.Float, along.astype(np.float32)),
            ),
            points,
            radius_per_vergence,
        )

    @property
    def nbytes(self) -> int:
        """Memory in bytes."""
        fragments = self.gathering.fragments
        columns = (self.gathering.sum_of_sample, self.seen, self.unoccluded, self.occluded)
        return 2 * (fragments.nbytes + sum(of.nbytes for of in columns)) + 16 * dr.width(
            self.edges.lane
        )

    @functools.cached_property
    def counts(self) -> np.ndarray:
        """How many fragments each bin has, int64 (bins,)."""
        return np.bincount(self.gathering.fragments.bin)

    @functools.cached_property
    def plain(self) -> Light:
        """The light of the fragments of samples that have no gradients."""
        fragments = self.gathering.fragments
        return Light(
            as_column(fragments.values[:, : SHARE + 1]),
            as_column(fragments.values[:, SHARE + 1]) if fragments.values.shape[1] > 4 else None,
            as_column(fragments.vergence),
            None,
        )

    def light(self, samples: PointSamples, subpixels: int) -> Light:
        """The light of the fragments, attached to what samples have gradients."""
        attached = samples.attached
        if not attached:
            return self.plain
        own = self.gathering
        area = dr.opaque(jit.Float, subpixels**2)
        count, sums = len(own.sum_of_sample), len(own.subpixel_of_sum)
        index = jit.from_numpy(jit.UInt32, own.sum_of_sample)

        def column(name: str) -> jit.Float:
            return attached[name] if name in attached else as_column(getattr(samples, name))

        def total(values: jit.Float | jit.Array4f) -> jit.Float:
            size = sums * (4 if isinstance(values, jit.Array4f) else 1)
            into = dr.zeros(jit.Float, size)
            dr.scatter_add(into, values, index, mode=scatter_mode(count / sums))
            return into

        weight = column("weight") * area
        rgb = dr.unravel(jit.Array3f, column("rgb"))
        values = total(jit.Array4f(*(weight * of for of in rgb), weight))
        alpha = total(weight * column("alpha")) if self.plain.alpha is not None else None
        share = dr.gather(jit.Float, values, dr.arange(jit.UInt32, sums) * 4 + SHARE)
        if "z" in attached or "weight" in attached:
            vergence = total(weight / column("z")) / share
        else:
            vergence = None
        source = jit.from_numpy(jit.UInt32, own.sum_of_fragment)
        scale, density = as_column(own.scale), None
        if "weight" in attached and not own.is_even:
            fragments = own.fragments
            place = jit.from_numpy(jit.UInt32, own.subpixel_of_sum)
            of_subpixel = dr.zeros(jit.Float, fragments.width * fragments.height)
            first = jit.from_numpy(jit.Bool, own.is_first)
            dr.scatter_add(of_subpixel, share, place, first, mode=scatter_mode())
            there = dr.gather(jit.Float, of_subpixel, dr.gather(jit.UInt32, place, source))
            scale *= dr.detach(there) / there
            density = of_subpixel
        light = dr.gather(jit.Array4f, values, source) * scale
        return Light(
            dr.ravel(light),
            None if alpha is None else dr.gather(jit.Float, alpha, source) * scale,
            self.plain.vergence if vergence is None else dr.gather(jit.Float, vergence, source),
            density,
        )


class Light(NamedTuple):
    """What has derivatives of F fragments.

    ``values`` are RGB and share, interleaved, ``alpha`` their alpha, ``vergence`` 1/z; ``density``
    is that of the subpixels, before it was evened, where it has derivatives.
    """

    values: jit.Float
    alpha: jit.Float | None
    vergence: jit.Float
    density: jit.Float | None
