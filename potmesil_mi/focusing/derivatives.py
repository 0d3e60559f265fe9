"""Whether derivatives of a picture are asked for, and whether there are any."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from .._validation import shown
from ..filters.base import FilterFunction
from ..optics.aperture import Aperture
from ..optics.attached import has_gradient
from ..optics.lens import ThinLens
from ..optics.psf import PointSpreadFunction, aperture_behind
from ..optics.telecentric import TelecentricLens
from ..samples.point_samples import PointSamples


def gradients_of(
    samples: PointSamples, lens: ThinLens | TelecentricLens, psf: PointSpreadFunction
) -> list[str]:
    """Names of what the picture is formed of that has gradients enabled."""
    parameters = lens.parameters().items()
    names = [name for name, value in parameters if has_gradient(value)]
    return [*samples.attached, *names, *_attached(psf), *_unknown(psf)]


def without_gradients(psf: PointSpreadFunction) -> PointSpreadFunction:
    """The same point-spread function, of plain numbers where it is an aperture."""
    return psf.without_gradients() if isinstance(psf, Aperture) else psf


def _attached(psf: PointSpreadFunction) -> list[str]:
    """Parameters of an aperture in which there are derivatives."""
    return list(psf.attached) if isinstance(psf, Aperture) else []


def _unknown(psf: PointSpreadFunction) -> list[str]:
    """Parameters that have gradients enabled, of a class that has no derivatives in them."""
    if not dataclasses.is_dataclass(psf):
        return []
    return [of.name for of in dataclasses.fields(psf) if has_gradient(getattr(psf, of.name))]


def require_derivatives(
    names: Sequence[str],
    samples: PointSamples,
    lens: ThinLens | TelecentricLens,
    psf: PointSpreadFunction,
    channels: Sequence[PointSpreadFunction],
    filters: Sequence[FilterFunction],
    *,
    by_tiles: bool,
) -> None:
    """Raise ``NotImplementedError`` that names what has no derivatives.

    ``names`` are those of what has gradients enabled.
    """
    refused: dict[str, Any] = {}
    for name in _unknown(psf):
        refused[f"psf={shown(psf)}"] = f"{name} of an aperture that is no DifferentiableAperture"
    if _attached(psf) and isinstance(lens, ThinLens) and lens.vignetting > 0:
        refused[f"vignetting={lens.vignetting}"] = "an aperture before which is a rim"
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
        refused["visibility"] = (
            "what is seen in mirrors and through panes (but if sampled with virtual_depth=false)"
        )
    for parameter, what in refused.items():
        raise NotImplementedError(
            f"{parameter}: {what} has no derivatives, and {', '.join(names)} has gradients enabled"
        )
