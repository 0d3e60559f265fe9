"""Traps of a focus that would leave a user with a picture of the wrong kind and no word."""

from __future__ import annotations

import warnings

from .._warnings import FocusWarning
from ..optics.lens import ThinLens
from ..optics.telecentric import TelecentricLens, is_open
from ..samples.circles import advice
from ..samples.depth_range import DepthRange
from ..samples.point_samples import PointSamples
from ..samples.provenance import is_wider
from .memo import Memo


def warn_of_traps(
    samples: PointSamples, lens: ThinLens | TelecentricLens, is_given: bool, memo: Memo, depth: int
) -> None:
    """Warn, once for each ``memo``, of what a picture of ``samples`` will show that few mean.

    The ``lens`` has lengths in the samples' units; ``is_given`` says that it is not merely their
    own. ``depth`` says for which of the callers the warning is, as ``stacklevel`` does.
    """
    lens = lens.plain()
    found = advice(DepthRange.of(samples), lens, samples.camera)
    if not (is_given or is_open(lens)):
        found["pinhole"] = (
            "lens: the samples were taken through a pinhole and none is given, so that everything "
            "is sharp; give one, such as samples.lens.replace(f_number=2.8, focus_distance=1.2)"
        )
    if is_wider(lens, samples.provenance):
        opening = (
            f"f_number={lens.f_number:.3g}"
            if isinstance(lens, ThinLens)
            else f"half_angle={lens.half_angle:.3g}"
        )
        found["wide"] = (
            f"{opening}: is wider than the lens that the samples were taken for, so that what it "
            "sees around near edges and beyond the border is missing; take them with that lens, or "
            "with Sampling(min_f_number=...), --min-f-number"
        )
    for kind, text in found.items():
        if kind not in memo.warned_of:
            memo.warned_of.add(kind)
            warnings.warn(text, FocusWarning, stacklevel=depth + 1)
