"""Whether derivatives of a picture are asked for, and whether there are any."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .._validation import shown
from ..filters.base import FilterFunction
from ..optics.arithmetic import is_drjit
from ..optics.lens import ThinLens
from ..optics.psf import PointSpreadFunction, aperture_behind
from ..optics.telecentric import TelecentricLens
from ..samples.point_samples import PointSamples


def has_gradients(samples: PointSamples, lens: ThinLens | TelecentricLens) -> bool:
    """Whether something of which the picture is formed has gradients enabled."""
    return bool(samples.attached or _attached_parameters(lens))


def _attached_parameters(lens: ThinLens | TelecentricLens) -> list[str]:
    parameters = {name: value for name, value in lens.parameters().items() if is_drjit(value)}
    if not parameters:
        return []
    import drjit as dr

    return [name for name, value in parameters.items() if dr.grad_enabled(value)]


def require_derivatives(
    samples: PointSamples,
    lens: ThinLens | TelecentricLens,
    channels: Sequence[PointSpreadFunction],
    filters: Sequence[FilterFunction],
    *,
    by_tiles: bool,
) -> None:
    """Raise ``NotImplementedError`` that names what has no derivatives."""
    names = [*samples.attached, *_attached_parameters(lens)]
    refused: dict[str, Any] = {}
    if isinstance(lens, TelecentricLens):
        refused[f"lens={shown(lens)}"] = "a telecentric lens"
    if len(channels) > 1 or aperture_behind(channels[0]).diffracts:
        refused[f"psf={shown(channels[0])}"] = "diffraction"
    if by_tiles:
        refused["tiles"] = "a picture that is formed tile by tile"
    if filters:
        refused[f"filters={shown(list(map(str, filters)))}"] = "a filter"
    if samples.moves:
        refused["samples"] = "what moves during an exposure"
    if samples.lattice > 0:
        refused[f"lattice={samples.lattice}"] = "samples on a lattice"
    if samples.visibility is not None and samples.visibility.any():
        refused["visibility"] = "what is seen in mirrors and through panes"
    for parameter, what in refused.items():
        raise NotImplementedError(
            f"{parameter}: {what} has no derivatives, and {', '.join(names)} has gradients enabled"
        )
