"""The version of the package."""

from __future__ import annotations

import functools

UNKNOWN = "unknown"
"""What stands for it where the package has been copied and not installed."""


@functools.cache
def package_version() -> str:
    """The version that is installed. What looks it up takes a while to import."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("potmesil_mi")
    except PackageNotFoundError:
        return UNKNOWN
