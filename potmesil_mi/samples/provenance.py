"""Provenance: how samples were made, as names and values that files keep."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from typing import Any

from .._validation import require_kind, require_number, require_whole

Provenance = Mapping[str, str | int | float]
"""How samples were made: see :func:`checked_provenance`."""

NAME = re.compile(r"[a-z_][a-z0-9_.]{0,63}")
"""What names look like."""

MOST_ENTRIES = 64
"""Names, at most."""

LONGEST_TEXT = 1024
"""Characters of a value, at most."""

MOST_WHOLE = (1 << 63) - 1
"""The largest whole number."""


def checked_provenance(values: Any) -> dict[str, str | int | float]:
    """A copy of a ``provenance``.

    Raises ``TypeError`` or ``ValueError`` that names the entry unless it is a mapping of at most
    ``MOST_ENTRIES`` names like ``NAME`` to printable texts, whole or finite numbers.
    """
    require_kind("provenance", values, Mapping, "a mapping, of names to texts and numbers")
    if len(values) > MOST_ENTRIES:
        raise ValueError(f"provenance: has {len(values)} names, must have at most {MOST_ENTRIES}")
    for name, value in values.items():
        if not isinstance(name, str) or not NAME.fullmatch(name):
            raise ValueError(
                f"provenance: the name {str(name)[:80]!r}: must be at most 64 of a-z, 0-9, _ and "
                "., and not begin with one of 0-9 or ."
            )
        of = f"provenance[{name!r}]"
        if isinstance(value, str):
            if len(value) > LONGEST_TEXT or not value.isprintable():
                raise ValueError(
                    f"{of}={value[:80]!r}: must be at most {LONGEST_TEXT} characters, all printable"
                )
        elif isinstance(value, int):
            require_whole(of, value, -MOST_WHOLE, MOST_WHOLE)
        else:
            require_kind(of, value, float, "text or a number")
            require_number(of, value)
    return dict(values)


def as_provenance(value: object) -> str | int | float:
    """A setting as a value of a provenance.

    Flags are 0 or 1, several numbers have / between, and of other things there is the text.
    """
    if isinstance(value, float):
        return value
    if isinstance(value, int):
        return int(value)
    return shown("/".join(map(str, value)) if isinstance(value, tuple) else str(value))


def file_name(path: str | os.PathLike[str]) -> str:
    """The name of a file as a value of a provenance, without its folders, which tell of people."""
    return shown(os.path.basename(os.fspath(path)))


def shown(text: str) -> str:
    """A text in which ? stands for what is not printable, and dots for what is too much."""
    text = "".join(one if one.isprintable() else "?" for one in text)
    return text if len(text) <= LONGEST_TEXT else text[: LONGEST_TEXT - 3] + "..."
