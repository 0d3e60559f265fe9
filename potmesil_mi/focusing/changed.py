"""Samples of which the depth was changed, kept with the original ones."""

from __future__ import annotations

import dataclasses

from ..samples.point_samples import PointSamples
from .memo import Memo


@dataclasses.dataclass(frozen=True)
class Changed:
    """Samples with their depth changed, and what has been found out about them."""

    samples: PointSamples
    memo: Memo

    @property
    def nbytes(self) -> int:
        """Memory in bytes of the changed depth and of what is kept."""
        return self.samples.z.nbytes + self.memo.nbytes
