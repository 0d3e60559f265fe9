"""TOML files, whose tables describe motions and animations."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from .._files import require_readable
from .._validation import shown
from .track import named

T = TypeVar("T")


def read_toml(path: str | os.PathLike[str], made: Callable[[Mapping[str, Any]], T]) -> T:
    """What is ``made`` of the tables of a TOML file.

    Raises ``OSError`` where it cannot be read, and ``ValueError`` or ``TypeError`` that names the
    file and what in it is wrong.
    """
    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib

    path = require_readable(path)
    name = os.fspath(path)
    with path.open("rb") as file:
        try:
            values = tomllib.load(file)
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise ValueError(f"{name}: is not TOML: {error}") from error
    with named(name):
        return made(values)


def table_of(values: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """The table of a name, empty where there is none. Raises ``TypeError`` for another value."""
    table = values.get(name, {})
    if not isinstance(table, Mapping):
        raise TypeError(f"{name}={shown(table)}: must be a table")
    return table
