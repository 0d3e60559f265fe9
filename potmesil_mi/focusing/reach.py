"""Depths within reach: what is so near that a lens would spread it over many frames.

Of a sample whose circle of confusion is ``MOST_FRAMES`` frames wide, all of the picture gets less
than a hundred-thousandth of its light a pixel, and a surface of such samples that fills the frame
of the pinhole covers a quarter of a hundredth of the lens. Nearer ones are as if they were there:
time and memory stay bounded, and so does what their distance costs all the others in resolution of
depth. Where the lens is focused on something so near, what is far away is moved instead.
"""

from __future__ import annotations

import math
import sys
from typing import NamedTuple

import drjit as dr
import numpy as np

from ..optics.blur import Blur
from ..samples.point_samples import PointSamples
from .changed import Changed
from .memo import Memo

MOST_FRAMES = 8
"""Parallax between the nearest and the farthest, seen from the middle of the lens and from its rim,
at most, in diagonals of the window."""


class _Ends(NamedTuple):
    """The vergences of the farthest and of the nearest sample."""

    farthest: float
    nearest: float

    @classmethod
    def of(cls, samples: PointSamples) -> _Ends:
        return cls(1 / float(samples.z.max()), 1 / float(samples.z.min()))

    @property
    def nbytes(self) -> int:
        return sys.getsizeof(self)


def within_reach(samples: PointSamples, blur: Blur, memo: Memo) -> tuple[PointSamples, Memo]:
    """The samples with what is out of reach moved, and a memo of their own, which ``memo`` keeps.

    ``blur`` is that of the lens in pixels. Mostly nothing is, and they are given back as they are.
    """
    if blur.radius_per_vergence == 0:
        return samples, memo
    reach = MOST_FRAMES * math.hypot(samples.window.width, samples.window.height)
    most = reach / blur.radius_per_vergence
    farthest, nearest = memo.get("ends of vergence", lambda: _Ends.of(samples))
    focused = blur.focused_vergence
    if nearest - farthest <= most and farthest <= focused + most:
        return samples, memo
    if farthest > focused + most:  # All of them are out of reach.
        farthest = nearest = focused + most
    elif focused <= farthest + most:
        nearest = farthest + most
    else:
        nearest = min(nearest, focused + most / 2)
        farthest = nearest - most

    def make() -> Changed:
        z = np.clip(
            samples.z, np.float32(1 / nearest), np.float32(1 / farthest if farthest else np.inf)
        )
        motion = samples.motion
        if motion is not None:
            motion = motion.copy()
            motion[z != samples.z, 2] = 0
        return Changed(samples.replace(z=z, motion=motion), Memo(memo.max_bytes))

    kept = memo.get(("within reach", nearest, farthest), make)
    if "z" not in samples.attached:
        return kept.samples, kept.memo
    # What is kept has none of the gradients, which are those of one call.
    nearest_z, farthest_z = float(kept.samples.z.min()), float(kept.samples.z.max())
    z = dr.clip(samples.attached["z"], nearest_z, farthest_z)
    return kept.samples.replace(z=z), kept.memo
