"""Progress of long jobs, shown where a person sits at a terminal."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sized
from typing import TypeVar

T = TypeVar("T")


def track(steps: Iterable[T], description: str, total: float | None = None) -> Iterator[T]:
    """Yield from ``steps``, with a progress bar on standard error if that is a terminal."""
    if not sys.stderr.isatty():
        yield from steps
        return
    from rich.console import Console
    from rich.progress import track as rich_track

    if total is None and isinstance(steps, Sized):
        total = len(steps)
    yield from rich_track(
        steps, description, total=total, console=Console(stderr=True), transient=True
    )
