"""The extra ``interactive``: libraries that a viewer needs and the rest of the package does not."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

STATIC = Path(__file__).parent / "static"
"""What a browser gets: one front end for the widget and for ``potmesil live``."""


def require_extra(name: str) -> ModuleType:
    """The module of that name. Raises ``ImportError`` that says how it is installed."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ImportError(
            f"{name} cannot be imported ({error}); the viewer needs it: "
            "pip install 'potmesil_mi[interactive]'"
        ) from None
