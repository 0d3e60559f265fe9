"""AOVs through the lens: blurred as colours are."""

from __future__ import annotations

import numpy as np

from .._validation import require_kind
from ..optics.lens import ThinLens
from ..optics.telecentric import TelecentricLens
from ..samples.point_samples import PointSamples
from .api import focus
from .film import ReconstructionFilter
from .methods import Method, MethodName


def focus_aovs(
    samples: PointSamples,
    lens: ThinLens | TelecentricLens | None = None,
    *,
    method: Method | MethodName = "layered",
    rfilter: ReconstructionFilter | None = None,
) -> dict[str, np.ndarray]:
    """The AOVs of ``samples`` as ``lens`` blurs them, by their names, float32 (H, W) each.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``samples``                   point samples; without AOVs there are no pictures
    ``lens``                      as for :func:`potmesil_mi.focus`; the samples' own by default
    ``method``                    as for :func:`potmesil_mi.focus`, with its options
    ``rfilter``                   the film's reconstruction filter; box by default
    ============================  ==========================================================

    Each value is the mean of what the pixel shows, as its colour is: of ids there is no such thing,
    see :func:`potmesil_mi.aov_maps`. Values that are not finite count as 0. Every three AOVs take
    as long as a first focus. Raises what :func:`potmesil_mi.focus` raises.
    """
    require_kind("samples", samples, PointSamples, "PointSamples, as render_samples gives")
    pictures: dict[str, np.ndarray] = {}
    if samples.aovs is None:
        return pictures
    names, plain = samples.aov_names, samples.replace(aovs=None, aov_names=())
    for start in range(0, len(names), 3):
        here = names[start : start + 3]
        values = np.nan_to_num(samples.aovs[:, start : start + 3], posinf=0, neginf=0)
        values = np.pad(values, ((0, 0), (0, 3 - len(here)))).astype(np.float64)
        # From 1 to 2 nothing is a highlight, and nothing is negative, as colours are not.
        least, most = values.min(axis=0), values.max(axis=0)
        width = np.where(most > least, most - least, 1)
        as_colours = plain.replace(rgb=1 + (values - least) / width)
        picture = np.asarray(focus(as_colours, lens, method=method, rfilter=rfilter), np.float64)
        planes = ((picture - 1) * width + least).astype(np.float32)
        pictures |= {name: planes[..., i] for i, name in enumerate(here)}
    return pictures
