"""What the lens sees of samples, as far as it stands still, and what of it has derivatives."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping

import drjit as dr
import numpy as np

from ... import _backend as jit
from ...samples.point_samples import PointSamples
from ..detail import Detail, along_axes, detail_degree
from ..fragments import SHARE, as_column, gathered, scatter_mode
from ..lens_points import LensPoints
from ..lens_view import leave_a_trace, within_rim
from ..locating import Raster, located_in
from ..moments import legendre
from ..visibility import visibility
from .edges import Edges
from .gathering import Gathering


@dataclasses.dataclass(frozen=True)
class Light:
    """What has derivatives of F fragments.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``values``                    (4 F,), RGB and share, interleaved
    ``alpha``                     (F,), or ``None``
    ``vergence``                  (F,), 1/z
    ``density``                   that of subpixels, before it was evened, where it has
                                  derivatives; else ``None``
    ``detail``                    their detail, a row for each, if it is known
    ============================  ==========================================================
    """

    values: jit.Float
    alpha: jit.Float | None
    vergence: jit.Float
    density: jit.Float | None
    detail: Detail | None


@dataclasses.dataclass(frozen=True)
class EdgeColumns:
    """Edges, see :class:`.edges.Edges`, of occluded fragments.

    ``lane`` is the pair of an occluded fragment and a lens point, ``along`` the change of what is
    seen for each subpixel of parallax by which the fragment moves before its occluder.
    """

    lane: jit.UInt32
    fragment: jit.UInt32
    occluder: jit.UInt32
    along: jit.Float

    def parallax(self, vergence: jit.Float, radius_per_vergence: jit.Float) -> jit.Float:
        """How far fragments and their occluders move before each other, (E,)."""
        own, its = (gathered(jit.Float, vergence, of) for of in (self.fragment, self.occluder))
        return radius_per_vergence * (own - its)


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
    ``plain``                     the light of the fragments, without gradients
    ============================  ==========================================================
    """

    gathering: Gathering
    unoccluded: np.ndarray
    occluded: np.ndarray
    seen: np.ndarray
    edges: EdgeColumns
    points: np.ndarray
    radius_per_vergence: float
    plain: Light

    @classmethod
    def of(
        cls,
        gathering: Gathering,
        samples: PointSamples,
        subpixels: int,
        radius_per_vergence: float,
        lens_points: LensPoints,
    ) -> SmoothView:
        """What the ``lens_points`` see of ``samples``, which are gathered."""
        fragments, found = gathering.fragments, Edges()
        points = lens_points.points
        coverable, seen = visibility(fragments, radius_per_vergence, points, edges=found)
        leave_a_trace(fragments, coverable, seen)
        if lens_points.has_rim:
            coverable, seen, brighter = within_rim(fragments, coverable, seen, lens_points)
            gathering = gathering.brightened(brighter)
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
            along *= lens_points.inside_rim(fragments, points)[fragment, point]
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
            _plain(gathering, samples, subpixels),
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
    def parallax(self) -> jit.Float:
        """That of the edges for the lens by which visibility was found."""
        radius = dr.opaque(jit.Float, self.radius_per_vergence)
        parallax = self.edges.parallax(self.plain.vergence, radius)
        dr.eval(parallax)
        return parallax

    def light(self, samples: PointSamples, subpixels: int) -> Light:
        """The light of the fragments, attached to what samples have gradients."""
        if not samples.attached:
            return self.plain
        sums = _Sums(self.gathering, samples, subpixels, samples.attached)
        return sums.light(self.plain)


class _Sums:
    """Sums over samples, and what they make of the fragments."""

    def __init__(
        self,
        gathering: Gathering,
        samples: PointSamples,
        subpixels: int,
        attached: Mapping[str, jit.Float],
    ) -> None:
        self.gathering, self.samples, self.subpixels = gathering, samples, subpixels
        self.attached = attached
        self.count = len(gathering.subpixel_of_sum)
        self.index = jit.from_numpy(jit.UInt32, gathering.sum_of_sample)
        self.source = jit.from_numpy(jit.UInt32, gathering.sum_of_fragment)
        # Not by dr.unravel: of an array that is used elsewhere it loses the gradients from there.
        first = dr.arange(jit.UInt32, len(samples)) * 3
        rgb = self._column("rgb")
        self.rgb = [gathered(jit.Float, rgb, first + channel) for channel in range(3)]
        self.weight = self._column("weight") * dr.opaque(jit.Float, subpixels**2)

    def _column(self, name: str) -> jit.Float:
        if name in self.attached:
            return self.attached[name]
        return as_column(getattr(self.samples, name))

    def _total(self, values: jit.Float | jit.Array4f) -> jit.Float:
        """The sums of what samples have."""
        size = self.count * (4 if isinstance(values, jit.Array4f) else 1)
        into = dr.zeros(jit.Float, size)
        mode = scatter_mode(len(self.samples) / self.count)
        dr.scatter_add(into, values, self.index, mode=mode)
        return into

    def _colours(self, weight: jit.Float) -> jit.Array4f:
        return jit.Array4f(*(weight * of for of in self.rgb), weight)

    def light(self, plain: Light) -> Light:
        """The light of the fragments; what has no gradients is that of ``plain``."""
        values = self._total(self._colours(self.weight))
        share = gathered(jit.Float, values, dr.arange(jit.UInt32, self.count) * 4 + SHARE)
        vergence, alpha = plain.vergence, plain.alpha
        if "z" in self.attached or "weight" in self.attached:
            of_sum = self._total(self.weight / self._column("z")) / share
            vergence = gathered(jit.Float, of_sum, self.source)
        scale, density = self._scale(share)
        if alpha is not None:
            of_sum = self._total(self.weight * self._column("alpha"))
            alpha = gathered(jit.Float, of_sum, self.source) * scale
        light = dr.ravel(gathered(jit.Array4f, values, self.source) * scale)
        detail = plain.detail
        if detail is not None and not self.attached.keys() <= {"z"}:
            detail = self.detail(detail.degree, light)
        return Light(light, alpha, vergence, density, detail)

    def _scale(self, share: jit.Float) -> tuple[jit.Float, jit.Float | None]:
        """By what fragments are evened, and the density of subpixels if it has gradients."""
        own = self.gathering
        scale = as_column(own.scale)
        if "weight" not in self.attached or own.density is None:
            return scale, None
        place = jit.from_numpy(jit.UInt32, own.subpixel_of_sum)
        density = dr.zeros(jit.Float, own.density.size)
        first = jit.from_numpy(jit.Bool, own.is_first)
        dr.scatter_add(density, share, place, first, mode=scatter_mode())
        there = gathered(jit.Float, density, dr.gather(jit.UInt32, place, self.source))
        return scale * (dr.detach(there) / there), density

    def detail(self, degree: int, values: jit.Float | None = None) -> Detail:
        """The detail of the fragments, whose light is given if it has gradients."""
        own, samples = self.gathering, self.samples
        raster = Raster.of(samples, self.subpixels)
        at = located_in(samples, self.subpixels, raster, slice(None))
        colours, alpha = [], []
        has_alpha = own.fragments.values.shape[1] > SHARE + 1
        for i, j in along_axes(degree):
            weight = self.weight * legendre(i, at.across) * legendre(j, at.down)
            colours.append(self._total(self._colours(weight)))
            if has_alpha:
                alpha.append(self._total(weight * self._column("alpha")))
            dr.eval(colours, alpha)
        return Detail(colours, alpha).evened(own.fragments, own.scale_of_subpixel, values)


def _plain(gathering: Gathering, samples: PointSamples, subpixels: int) -> Light:
    """The light of the fragments without gradients."""
    fragments = gathering.fragments
    values, degree, detail = fragments.values, detail_degree(samples, subpixels), None
    if degree > 0:
        detail = _Sums(gathering, samples, subpixels, {}).detail(degree)
    return Light(
        as_column(values[:, : SHARE + 1]),
        as_column(values[:, SHARE + 1]) if values.shape[1] > SHARE + 1 else None,
        as_column(fragments.vergence),
        None,
        detail,
    )
