"""Files of samples: which formats there are, and what goes for all of them.

A name that ends in ``.exr`` is a deep EXR, for other programs to read, one in ``.samples`` an
archive of compressed columns, which is many times as fast.
"""

from __future__ import annotations

import os
from pathlib import Path
from types import ModuleType

import numpy as np

from .._files import require_readable, require_writable, written_whole
from .aovs import require_named
from .columns import Columns, require_visibility_radius
from .header import Header

ARCHIVE = ".samples"
"""How names of archives end: see ``archive.py``."""

HEADER_BYTES = 1 << 20
"""Bytes of a file in which the attributes of samples are, if it has any."""

ENDINGS = (".exr", ARCHIVE)
"""How names of files of samples end."""


def write(path: str | os.PathLike[str], header: Header, columns: Columns) -> None:
    """Write samples in the format that the name stands for, by its ending, one of ``ENDINGS``.

    Raises ``ValueError`` for another name and ``OSError`` where it cannot be written; then
    nothing is left behind.
    """
    path = require_writable(path, ENDINGS)
    with written_whole(path) as temporary:
        _format(path).write(temporary, header, columns)


def holds_samples(path: str | os.PathLike[str]) -> bool:
    """Whether a file is taken for samples, and not for a picture of another program.

    That is so of archives, of what is no file, and of EXR files with the attributes of samples.
    """
    path = Path(path)
    if path.suffix.lower() == ARCHIVE:
        return True
    try:
        require_readable(path)
    except (OSError, ValueError):  # It is said when it is read.
        return True
    if path.suffix.lower() != ENDINGS[0]:
        return False
    from .deep_exr import ATTRIBUTE

    with path.open("rb") as file:
        return ATTRIBUTE.format("samples").encode() in file.read(HEADER_BYTES)


def read(path: str | os.PathLike[str]) -> tuple[Header, Columns]:
    """What :func:`write` wrote. A name of another ending is taken for a deep EXR.

    Raises ``OSError`` where there is no file or it cannot be read, and ``ValueError`` for one
    that is not of its format, is truncated or damaged, needs more memory than its size justifies,
    does not hold the samples of this package, or holds samples of which no picture can be formed.
    Each names the file.
    """
    path = require_readable(path)
    try:
        header, columns = _format(path).read(path)
        _require_usable(header, columns)
    except OSError as error:
        raise type(error)(f"{path}: {error.strerror or error}") from error
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    except Exception as error:  # Whatever a library, a parser or a check makes of a damaged file.
        what = str(error) or type(error).__name__
        raise ValueError(f"{path}: is damaged or not of this version: {what}") from error
    return header, columns


def _format(path: Path) -> ModuleType:
    """The module that reads and writes files of a name."""
    # Each needs a library of its own, which takes a while to import.
    if path.suffix.lower() == ARCHIVE:
        from . import archive

        return archive
    from . import deep_exr

    return deep_exr


def _require_usable(header: Header, columns: Columns) -> None:
    """Raise ``ValueError`` for samples of which no picture can be formed."""
    require_visibility_radius(header.visibility_radius, columns.visibility is not None)
    require_named(header.aov_names, columns.aovs)
    if not columns.all_valid:
        raise ValueError(
            f"is damaged: {np.count_nonzero(~columns.is_valid())} of {len(columns)} samples have "
            "radiance, alpha, position or weight not finite, depth or weight not > 0, through "
            "not finite or < 0, albedo not 0 to 1, or a normal longer than 1"
        )
