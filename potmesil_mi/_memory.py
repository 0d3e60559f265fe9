"""Memory: how much is free, and jobs that would take more refused before they begin.

What is free is the least of what the machine has, what the control group of the process may take
(version 1 and 2), and what ``ulimit -v`` leaves. ``POTMESIL_MAX_MEMORY``, such as ``4G``, takes its
place.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator
from pathlib import Path

VARIABLE = "POTMESIL_MAX_MEMORY"
"""Environment variable: the memory that a job may take, in place of what is found to be free."""

UNITS = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40}
"""What the letter after a number of bytes stands for."""

GROUPS = Path("/sys/fs/cgroup")
PROCESS = Path("/proc")


def require_memory(needed: float, what: str, remedy: str) -> None:
    """Raise ``MemoryError`` if a job needs more bytes than there are.

    ``what`` is the job, ``remedy`` what takes less. Where nothing tells what is free, nothing is
    refused.
    """
    free = free_memory()
    if free is not None and needed > free:
        raise MemoryError(
            f"{what} takes about {needed / 1e9:.1f} GB, and {free / 1e9:.1f} GB are free; {remedy} "
            f"(--max-memory or {VARIABLE} to try it nevertheless)"
        )


@contextlib.contextmanager
def limited_to(size: str | None) -> Iterator[None]:
    """Jobs in the block may take a ``size`` such as ``4G``; with ``None`` what they may anyway.

    Raises ``ValueError`` for what is no size.
    """
    if size is None:
        yield
        return
    size_in_bytes("max_memory", size)
    before = os.environ.get(VARIABLE)
    os.environ[VARIABLE] = size
    try:
        yield
    finally:
        if before is None:
            del os.environ[VARIABLE]
        else:
            os.environ[VARIABLE] = before


def free_memory() -> int | None:
    """Bytes that a job may take: what ``POTMESIL_MAX_MEMORY`` says, or are free; ``None``: unknown.

    Raises ``ValueError`` for a variable that is no size.
    """
    given = os.environ.get(VARIABLE)
    if given:
        return size_in_bytes(VARIABLE, given)
    found = [of for of in (_of_machine(), _of_group(), _of_limit()) if of is not None]
    return max(min(found), 0) if found else None


def size_in_bytes(name: str, text: str) -> int:
    """A size such as ``4G``, ``500 MB`` or ``1.5GiB`` in bytes; raises ``ValueError``."""
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?\s*", text, re.IGNORECASE)
    if not found or float(found[1]) <= 0:
        raise ValueError(f"{name}={text}: must be a size > 0 such as 4G or 500M")
    return int(float(found[1]) * UNITS[found[2].upper()])


def peak_memory() -> int:
    """The most bytes that the process has taken so far; 0 where that is not known."""
    return entry_in_bytes(PROCESS / "self" / "status", "VmHWM") or 0


def _of_machine() -> int | None:
    return entry_in_bytes(PROCESS / "meminfo", "MemAvailable")


def _of_limit() -> int | None:
    """What ``ulimit -v`` leaves of the address space."""
    try:
        import resource
    except ImportError:  # Windows has none.
        return None
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    used = entry_in_bytes(PROCESS / "self" / "status", "VmSize")
    return None if limit == resource.RLIM_INFINITY or used is None else limit - used


def _of_group() -> int | None:
    """What the control group may take: of all that it is in, the least."""
    try:
        lines = (PROCESS / "self" / "cgroup").read_text().splitlines()
    except OSError:
        return None
    left = []
    for _, controllers, path in (line.split(":", 2) for line in lines if line.count(":") >= 2):
        if controllers == "":
            names, root = ("memory.max", "memory.current", "inactive_file"), GROUPS
        elif "memory" in controllers.split(","):
            names = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
            root = GROUPS / "memory"
        else:
            continue
        own = root / path.lstrip("/")
        for folder in (own, *own.parents):
            left += _left_in(folder, *names)
            if folder == root:
                break
    return min(left, default=None)


def _left_in(folder: Path, limit: str, usage: str, cache: str) -> list[int]:
    try:
        most, used = (int((folder / name).read_text()) for name in (limit, usage))
        stat = (folder / "memory.stat").read_text()
    except (OSError, ValueError):  # There is none, or it is "max".
        return []
    found = re.search(rf"^{cache} (\d+)$", stat, re.MULTILINE)
    return [most - used + (int(found[1]) if found else 0)]


def entry_in_bytes(path: Path, name: str) -> int | None:
    """An entry in kB of a file of the system, such as ``VmRSS`` of ``status``, in bytes."""
    try:
        found = re.search(rf"^{name}:\s+(\d+) kB$", path.read_text(), re.MULTILINE)
    except OSError:
        return None
    return int(found[1]) << 10 if found else None
