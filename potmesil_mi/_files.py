"""Files: whether they can be read or written, and written whole or not at all."""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import stat
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from ._validation import shown

TEMPORARY = ".{stem}.{process}{suffix}"
"""Name of a file until it is whole: that of the process stands in it."""


def require_suffix(path: Path, suffixes: Iterable[str]) -> Path:
    """The path, if its name ends in one of ``suffixes``; raises ``ValueError`` where not."""
    suffixes = tuple(suffixes)
    if path.suffix.lower() not in suffixes:
        raise ValueError(f"{path}: the name must end in one of {', '.join(suffixes)}")
    return path


def require_writable(path: str | os.PathLike[str], suffixes: Iterable[str]) -> Path:
    """The path, if a file of one of ``suffixes`` can be written there; missing folders are made.

    Raises ``ValueError`` for another suffix or a name that no file can have, ``IsADirectoryError``
    or another ``OSError`` that names it for a place where none can be made.
    """
    path = require_suffix(require_path(path), suffixes)
    try:
        target = _target(path)
        if target.is_dir():
            raise IsADirectoryError(f"{path}: is a folder, not a file")
        if target.exists() and not target.is_file():
            raise OSError(f"{path}: is not a file that can be replaced")
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=target.parent):
            pass
    except (FileExistsError, NotADirectoryError):
        raise NotADirectoryError(f"{path}: {path.parent} is in a file, not a folder") from None
    except OSError as error:
        if error.errno is None:
            raise
        raise type(error)(f"{path}: cannot write to {path.parent}: {error.strerror}") from None
    return path


def require_each_once(paths: Iterable[str]) -> None:
    """Raise ``ValueError`` for one of the names of files to be written that is there twice."""
    names = set()
    for path in paths:
        name = os.path.normpath(path)
        if name in names:
            raise ValueError(f"output={path!r}: must be given once")
        names.add(name)


def require_readable(path: str | os.PathLike[str]) -> Path:
    """The path, if there is a file that can be read from its end.

    Raises ``IsADirectoryError``, ``FileNotFoundError`` or another ``OSError`` that names it, and
    ``ValueError`` for a name that no file can have.
    """
    path = require_path(path)
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: there is no such file") from None
    except OSError as error:
        raise type(error)(f"{path}: {error.strerror}") from None
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(f"{path}: is a folder, not a file")
    if not stat.S_ISREG(mode):
        raise OSError(f"{path}: is not a file that can be read from its end")
    return path


def require_path(path: str | os.PathLike[str], name: str = "path") -> Path:
    """The path, which the parameter ``name`` gives.

    Raises ``TypeError`` for what is no path, ``ValueError`` for a name that no file can have.
    """
    if not isinstance(path, (str, os.PathLike)):
        raise TypeError(f"{name}={shown(path)}: must be the name of a file")
    if "\0" in os.fspath(path):
        raise ValueError(f"{os.fspath(path)!r}: is not the name of a file: it has a zero in it")
    if not os.fspath(path):
        raise ValueError(f"{name}={shown(path)}: must be the name of a file")
    return Path(path)


@contextlib.contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """A temporary name beside ``path``, which takes its place when the block has succeeded.

    A file that is there keeps its mode and, as far as that is allowed, its owner; of a symbolic
    link what it leads to is replaced. What killed programs have left of the file is removed. Errors
    name the ``path``.
    """
    target = _target(path)
    _remove_leftovers(target)
    names = {"stem": target.stem, "process": os.getpid(), "suffix": target.suffix}
    temporary = target.with_name(TEMPORARY.format(**names))
    try:
        yield temporary
        if not temporary.is_file():
            raise OSError(f"{path}: could not be written")
        _take_over(target, temporary)
        os.replace(temporary, target)
    except (OSError, RuntimeError) as error:  # OpenEXR raises the latter.
        kind, said = (
            (type(error), error.strerror) if isinstance(error, OSError) else (OSError, None)
        )
        text = str(error) if said is None else f"{path}: {said}"
        text = text.replace(str(temporary), str(path)).replace(temporary.name, path.name)
        raise kind(text if str(path) in text else f"{path}: {text}") from error
    finally:
        temporary.unlink(missing_ok=True)


def write_json(path: Path, value: Any) -> None:
    """Write a value as JSON that every program reads; what is infinite becomes ``"inf"``.

    Raises ``OSError`` where it cannot be written; then nothing is left behind.
    """
    text = json.dumps(in_json(value), indent=1, allow_nan=False)
    with written_whole(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def in_json(value: Any) -> Any:
    """A value of mappings, sequences, numbers and text as :func:`write_json` writes it."""
    if isinstance(value, Mapping):
        return {str(name): in_json(one) for name, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [in_json(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value


def _target(path: Path) -> Path:
    """What is to be replaced: where a symbolic link leads to."""
    return Path(os.path.realpath(path)) if path.is_symlink() else path


def _take_over(target: Path, temporary: Path) -> None:
    """Give a new file the mode and the owner of the one that it is to replace, if there is one."""
    try:
        old = target.stat()
    except OSError:
        return
    with contextlib.suppress(OSError, AttributeError):
        os.chown(temporary, old.st_uid, old.st_gid)
    with contextlib.suppress(OSError):
        temporary.chmod(stat.S_IMODE(old.st_mode))


def _remove_leftovers(target: Path) -> None:
    """Remove what is left of a file by processes of this machine that are no more."""
    process = re.compile(re.escape(f".{target.stem}.") + r"(\d+)" + re.escape(target.suffix))
    begin = f".{target.stem}."
    try:
        names = os.listdir(target.parent)
    except OSError:  # That nothing can be written there is said when it is.
        return
    # A stack may have many thousands of files in a folder, and this is done for each of them.
    for name in names:
        found = process.fullmatch(name) if name.startswith(begin) else None
        if found and not _is_running(int(found[1])):
            with contextlib.suppress(OSError):
                (target.parent / name).unlink()


def _is_running(process: int) -> bool:
    """Whether there is such a process; unknown, and so taken for granted, on Windows."""
    if os.name == "nt":
        return True
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True
    return True
