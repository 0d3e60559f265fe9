"""Samples of an orthographic camera, as a thin lens forms their picture.

The change of depth is that of :mod:`potmesil_mi.optics.telecentric`. What is found out about the
changed samples is kept with the original ones.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .._validation import shown
from ..filters.base import FilterFunction
from ..optics.psf import PointSpreadFunction, aperture_behind
from ..optics.telecentric import ThinLensPicture
from ..samples.point_samples import PointSamples
from .changed import Changed
from .memo import Memo


def changed(
    samples: PointSamples, picture: ThinLensPicture, memo: Memo
) -> tuple[PointSamples, Memo]:
    """The samples that the thin lens of ``picture`` is before, and a memo of their own.

    ``memo`` is that of the original samples, and keeps both.
    """

    def make() -> Changed:
        depth = picture.depth(samples.z)
        motion = samples.motion
        if motion is not None:
            near, far = (picture.depth(samples.z + side * motion[:, 2]) for side in (-0.5, 0.5))
            with np.errstate(invalid="ignore"):
                deeper = np.where(np.isfinite(near), far - near, 0)
            motion = np.column_stack([motion[:, :2], deeper])
        perspective = samples.replace(
            z=depth, motion=motion, camera=picture.camera, lens=picture.lens
        )
        return Changed(perspective, Memo(memo.max_bytes))

    kept = memo.get(("telecentric", picture.reference), make)
    return kept.samples, kept.memo


def require_usable(psf: PointSpreadFunction, filters: Sequence[FilterFunction]) -> None:
    """Raise ``ValueError`` for what asks for the focal length that a telecentric lens has not."""
    if aperture_behind(psf).diffracts:
        raise ValueError(f"psf={shown(psf)}: must not diffract with a TelecentricLens")
    for each in filters:
        if getattr(each, "needs_focal_length", False):
            raise ValueError(
                f"filters: {each} needs a focal length, which a TelecentricLens has not"
            )
