"""The Mitsuba plugins, one to a file, and their registration.

Plugin classes derive from types of the variant that is set, so their modules are loaded anew
for each variant.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType

import mitsuba as mi

PLUGINS = {
    "potmesil": ("sensor", "PotmesilSensor"),
    "point_samples": ("integrator", "PointSamplesIntegrator"),
    "focus": ("integrator", "FocusIntegrator"),
}
"""Plugin name (and module): what it is to Mitsuba, and its class."""


def register() -> None:
    """Register every plugin with the variant that is set."""
    _load("wrapper")
    for name, (kind, class_name) in PLUGINS.items():
        getattr(mi, f"register_{kind}")(name, getattr(_load(name), class_name))


def _load(name: str) -> ModuleType:
    module_name = f"{__name__}.{name}"
    if module_name in sys.modules:
        return importlib.reload(sys.modules[module_name])
    return importlib.import_module(module_name)
