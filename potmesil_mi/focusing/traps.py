"""Traps of a focus that would leave a user with a sharp picture and no word, as warnings."""

from __future__ import annotations

import warnings

from ..optics.lens import ThinLens
from ..optics.telecentric import TelecentricLens, is_open
from ..samples.circles import DepthRange, advice
from ..samples.point_samples import PointSamples
from .memo import Memo

PINHOLE = "pinhole"
DEPTHS = "depths"


def warn_of_traps(
    samples: PointSamples, given: ThinLens | TelecentricLens | None, memo: Memo, depth: int
) -> None:
    """Warn, once for each ``memo``, of what a picture of ``samples`` will show that few mean.

    ``given`` is the lens, ``None`` for the samples' own. ``depth`` says for which of the callers
    the warning is, as ``stacklevel`` does.
    """
    lens = samples.lens if given is None else given
    found = advice(memo.get(DEPTHS, lambda: DepthRange.of(samples)), lens, samples.camera)
    if given is None and not is_open(lens):
        found[PINHOLE] = (
            "lens: the samples were taken through a pinhole and none is given, so that everything "
            "is sharp; give one, such as samples.lens.replace(f_number=2.8, focus_distance=1.2)"
        )
    for kind, text in found.items():
        if kind not in memo.warned_of:
            memo.warned_of.add(kind)
            warnings.warn(text, stacklevel=depth + 1)
