"""What is said of how a scene was sampled: see ``provenance`` of :class:`PointSamples`."""

from __future__ import annotations

import dataclasses

import mitsuba as mi

from .._version import package_version
from ..samples.provenance import as_provenance
from .passes import Passes
from .sampling import Sampling

OTHERWISE = {"volumetricpath": "volpath"}
"""Integrators whose classes are not called what their plugins are."""


def provenance_of(
    integrator: mi.Integrator, passes: Passes, sampling: Sampling
) -> dict[str, str | int | float]:
    """Programs, ``integrator``, ``seed``, ``spp``, and what of the ``sampling`` is not default."""
    said = {
        "version": package_version(),
        "mitsuba": mi.__version__,
        "variant": mi.variant(),
        "integrator": plugin_name(integrator),
        "seed": passes.seed,
        "spp": passes.spp,
        "pattern": sampling.pattern,
        "refine": sampling.refine,
    }
    for field in dataclasses.fields(Sampling):
        value = getattr(sampling, field.name)
        if value != field.default:
            said[field.name] = value
    return {name: as_provenance(value) for name, value in said.items()}


def plugin_name(integrator: mi.Integrator) -> str:
    """The name by which a scene asks for an integrator, which only its class or module tells."""
    kind = type(integrator)
    if kind.__module__.startswith("mitsuba.python."):
        return kind.__module__.rpartition(".")[2]
    name = str(integrator.class_name()) if kind.__module__ == "mitsuba" else kind.__name__
    name = name.removesuffix("Impl").removesuffix("Integrator").lower()
    return OTHERWISE.get(name, name)
