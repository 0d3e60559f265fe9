"""The Mitsuba plugins, one to a file, and their registration.

Plugin classes derive from types of the variant that is set, so their modules are loaded anew
for each variant.
"""

from __future__ import annotations

import importlib
import sys

import mitsuba as mi

PLUGINS = {
    "potmesil": ("sensor", "PotmesilSensor"),
    "point_samples": ("integrator", "PointSamplesIntegrator"),
    "focus": ("integrator", "FocusIntegrator"),
}
"""Plugin name (and module): what it is to Mitsuba, and its class."""


def register() -> None:
    """Register every plugin with the variant that is set."""
    for name, (kind, class_name) in PLUGINS.items():
        module_name = f"{__name__}.{name}"
        if module_name in sys.modules:
            module = importlib.reload(sys.modules[module_name])
        else:
            module = importlib.import_module(module_name)
        getattr(mi, f"register_{kind}")(name, getattr(module, class_name))
