"""The Mitsuba plugins, one to a file, and their registration.

Plugin classes derive from types of the variant that is set, so their modules are loaded anew
for each variant. They import the two stages, and SciPy with them, when they are used: whoever
sets a variant waits for the modules that they import at once.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType

from .. import _llvm

PLUGINS = {
    "potmesil": ("sensor", "PotmesilSensor"),
    "potmesil_orthographic": ("sensor", "PotmesilOrthographicSensor"),
    "point_samples": ("integrator", "PointSamplesIntegrator"),
    "focus": ("integrator", "FocusIntegrator"),
}
"""Plugin name (and module): what it is to Mitsuba, and its class."""

FOLLOWER = "_potmesil_mi_follower"
"""Attribute of ``mitsuba.detail``: what is called when the variant changes."""


def follow_variants() -> None:
    """Register every plugin with Mitsuba's variant, now if one is set and whenever it changes.

    Should this package have been loaded anew, what was called before no longer is.
    """
    import mitsuba as mi

    # Mitsuba outlives this module, and so it is what remembers.
    if (earlier := getattr(mi.detail, FOLLOWER, None)) is not None:
        mi.detail.remove_variant_callback(earlier)
    mi.detail.add_variant_callback(_follow_variant)
    setattr(mi.detail, FOLLOWER, _follow_variant)
    if mi.variant() is not None:
        register()


def register() -> None:
    """Register every plugin with the variant that is set."""
    import mitsuba as mi

    for shared in ("projective", "wrapper"):
        _load(shared)
    for name, (kind, class_name) in PLUGINS.items():
        getattr(mi, f"register_{kind}")(name, getattr(_load(name), class_name))


def _follow_variant(old: str | None, new: str) -> None:
    _llvm.check_llvm(new, old)
    register()


def _load(name: str) -> ModuleType:
    module_name = f"{__name__}.{name}"
    if module_name in sys.modules:
        return importlib.reload(sys.modules[module_name])
    return importlib.import_module(module_name)
