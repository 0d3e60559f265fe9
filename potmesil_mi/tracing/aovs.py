"""AOVs: values that an integrator has of a ray beside its radiance, as Mitsuba's ``aov`` does.

They are of what the ray meets first: all the samples that a ray is parted into, by veils, panes and
mirrors, have the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import drjit as dr
import mitsuba as mi

from ..samples.aovs import DISTANCE, require_aov_names

OF_NESTED = ("R", "G", "B", "A")
"""Last names of the first AOVs of an ``aov`` that has the radiance from a nested integrator."""


class Aovs(NamedTuple):
    """The AOVs of an integrator that samples keep: all but what their radiance and alpha are.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``names``                     their names, K
    ``start``                     how many come before them, which are not kept
    ============================  ==========================================================
    """

    names: tuple[str, ...]
    start: int

    @classmethod
    def of(cls, integrator: mi.SamplingIntegrator) -> Aovs:
        """Those of ``integrator``. Raises ``ValueError`` for too many and for equal names."""
        names = list(integrator.aov_names())
        first = names[0].rpartition(".")[0] if names else ""
        nested = names[: len(OF_NESTED)] == [f"{first}.{last}" for last in OF_NESTED]
        start = len(OF_NESTED) if nested else 0
        return cls(require_aov_names(names[start:]), start)

    def of_ray(self, values: Sequence[mi.Float], start: mi.Float | float) -> mi.ArrayXf | None:
        """What is kept of the ``values`` of rays that begin at ``start``; ``None`` for nothing.

        Distances are those from where the whole rays begin.
        """
        if not self.names:
            return None
        kept = []
        for name, value in zip(self.names, values[self.start :], strict=True):
            if name.endswith(DISTANCE):  # 0 where nothing is met.
                value = dr.select(value > 0, value + start, value)
            kept.append(value)
        return mi.ArrayXf(kept)
