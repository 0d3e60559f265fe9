"""Detail: where in their subpixels the light of fragments is.

It is told by moments, see :mod:`.moments`, along each axis, and matters for circles hardly larger
than a subpixel, see :mod:`.small_circles`. It stays on the device.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import drjit as dr
import numpy as np

from .. import _backend as jit
from ..samples.point_samples import PointSamples
from .fragments import SHARE, Fragments, among_few, as_column, scatter_mode

DEGREES = {1: 2, 2: 1, 3: 1}
"""Degree of the moments for so many subpixels on a side of a pixel; of more, none are needed."""

NO_DETAIL = -1
"""``Fragments.detail`` of those that are even."""


FEW = 1 << 12
"""Samples that mostly tell whether all are in the middles of pixels."""


def detail_degree(samples: PointSamples, subpixels: int) -> int:
    """The degree of the moments for so many ``subpixels`` on a side of a pixel; 0 for none.

    Samples of a picture stand for their whole pixels, in whose middles they are.
    """
    degree = DEGREES.get(subpixels, 0)
    for part in (slice(FEW), slice(None)):
        if degree == 0 or (samples.x[part] % 1 != 0.5).any():
            return degree
    return 0


def along_axes(degree: int) -> list[tuple[int, int]]:
    """The orders (across, down) of the moments up to a degree: those across, then those down."""
    each = range(1, degree + 1)
    return [(order, 0) for order in each] + [(0, order) for order in each]


@dataclasses.dataclass(frozen=True)
class Detail:
    """Moments of the light of fragments, whose ``detail`` are numbers of rows of this table.

    ``colours`` are RGB and share, interleaved, a column for each of :func:`along_axes`, ``alpha``
    that of alpha, empty unless it was asked for.
    """

    colours: list[jit.Float]
    alpha: list[jit.Float]

    @classmethod
    def of(cls, moments: np.ndarray) -> Detail:
        """The table of moments (N, D, 4 or 5)."""
        terms = list(moments.swapaxes(0, 1))
        return cls(
            [as_column(of[:, : SHARE + 1]) for of in terms],
            [as_column(of[:, SHARE + 1]) for of in terms if of.shape[1] > SHARE + 1],
        )

    def __len__(self) -> int:
        return len(self.colours[0]) // (SHARE + 1)

    @property
    def degree(self) -> int:
        """The degree of the moments."""
        return len(self.colours) // 2

    @property
    def nbytes(self) -> int:
        """Memory in bytes."""
        return 4 * sum(map(len, (*self.colours, *self.alpha)))

    def and_others(self, *others: Detail) -> Detail:
        """The rows of this table, then those of ``others``."""
        tables = [of for of in (self, *others) if len(of)] or [self]
        if len(tables) == 1:
            return tables[0]
        colours, alpha = (
            [dr.concat(of) for of in zip(*columns, strict=True)]
            for columns in ([of.colours for of in tables], [of.alpha for of in tables])
        )
        return Detail(colours, alpha)

    def evened(
        self, fragments: Fragments, scale: np.ndarray | None, values: jit.Float | None = None
    ) -> Detail:
        """The detail of each of the ``fragments``, in their order.

        It is multiplied by ``scale``, (height * width,), of their subpixels. What chance adds to
        one side of a subpixel is no detail: of all light, the part that the moments of what the
        pinhole sees have of its share is taken away. ``values`` are RGB and share of the fragments
        where they have gradients.
        """
        assert fragments.detail is not None
        row = jit.from_numpy(jit.Int32, fragments.detail)
        subpixel = jit.from_numpy(jit.UInt32, fragments.subpixel)
        known, row = row != NO_DETAIL, jit.UInt32(row)
        times = jit.Float(1)
        if scale is not None:
            times = dr.gather(jit.Float, as_column(scale.astype(np.float32)), subpixel)
        first = jit.from_numpy(jit.Bool, fragments.first) & known
        if values is None:
            values = as_column(fragments.values[:, : SHARE + 1])
        # dr.unravel would, of an array that is used elsewhere, lose the gradients from there.
        own = dr.gather(jit.Array4f, values, dr.arange(jit.UInt32, len(fragments)))
        colours, alpha = [], []
        for term, column in enumerate(self.colours):
            moment = dr.gather(jit.Array4f, column, row, known) * times
            of_share = dr.zeros(jit.Float, among_few(fragments.width * fragments.height))
            dr.scatter_add(of_share, moment[SHARE], subpixel, first, mode=scatter_mode())
            dr.eval(moment, of_share)
            shift = dr.gather(jit.Float, of_share, subpixel, known)
            colours.append(dr.ravel(moment - own * shift))
            if self.alpha:
                of = dr.gather(jit.Float, self.alpha[term], row, known) * times
                alpha.append(of - as_column(fragments.values[:, SHARE + 1]) * shift)
            dr.eval(colours, alpha)
        return Detail(colours, alpha)


def joined(parts: Sequence[tuple[Fragments, Detail | None]]) -> tuple[Fragments, Detail | None]:
    """Fragments of several parts, not in order, and the table of the detail of them all."""
    fragments, tables = [], []
    rows = 0
    for some, table in parts:
        row = np.full(len(some), NO_DETAIL, np.int32)
        if table is not None and some.detail is not None:
            row = some.detail + np.int32(rows)
            tables.append(table)
            rows += len(table)
        fragments.append(dataclasses.replace(some, detail=row))
    together = fragments[0].and_others(*fragments[1:])
    if not tables:
        return dataclasses.replace(together, detail=None), None
    return together, tables[0].and_others(*tables[1:])
