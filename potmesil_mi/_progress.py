"""Progress of long jobs: a callback is told how far they are, by default a bar on a terminal."""

from __future__ import annotations

import contextlib
import contextvars
import html
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sized
from typing import TypeVar

T = TypeVar("T")

ProgressCallback = Callable[[str, "float | None"], None]
"""Takes what is being done, and the share of it that is done, 0 to 1; ``None``: not known."""

NOTEBOOK_STEP = 0.3
"""Seconds, at least, until a bar in a notebook is shown, and from one update to the next."""

_callback: contextvars.ContextVar[ProgressCallback | None] = contextvars.ContextVar(
    "potmesil_mi_progress", default=None
)


@contextlib.contextmanager
def progress(callback: ProgressCallback | None) -> Iterator[None]:
    """Tell ``callback`` how far long jobs within the block are, and show no bar.

    It is called with what is being done, such as ``"Sampling"``, and with the share of it that is
    done, from 0 to 1, or ``None`` where that is not known. What it raises ends the job and comes
    out of the function that was called. ``None`` for ``callback`` gives back the default: a bar
    on standard error if that is a terminal, and below the cell in a notebook. It holds for the
    thread it is called in::

        with pm.progress(lambda text, share: print(text, share)):
            samples = pm.render_samples(scene)
    """
    token = _callback.set(callback)
    try:
        yield
    finally:
        _callback.reset(token)


@contextlib.contextmanager
def reported() -> Iterator[ProgressCallback]:
    """What a job within the block is to tell how far it is: whoever listens, or nobody."""
    callback = _callback.get()
    if callback is not None:
        yield callback
    elif sys.stderr.isatty():
        with _bar() as show:
            yield show
    elif _is_notebook():
        with _bar_of_notebook() as show:
            yield show
    else:
        yield lambda text, share: None


@contextlib.contextmanager
def one_bar() -> Iterator[None]:
    """Let the jobs within the block have one bar, one after the other."""
    with reported() as report, progress(report):
        yield


@contextlib.contextmanager
def as_one(stages: Mapping[str, float]) -> Iterator[None]:
    """Report the jobs within the block as one, whose ``stages`` have such shares of its time.

    They come in their order; one that there is not takes no time. What is not among them moves
    nothing. The share that is done never falls, and is not known before the first stage.
    """
    total, begins, sum_before = sum(stages.values()), {}, 0.0
    for name, share in stages.items():
        begins[name] = sum_before
        sum_before += share
    done: float | None = None
    with reported() as report:

        def tell(text: str, share: float | None) -> None:
            nonlocal done
            if text in begins:
                reached = (begins[text] + (share or 0.0) * stages[text]) / total
                done = max(done or 0.0, reached)
            report(text, done)

        with progress(tell):
            yield


def track(steps: Iterable[T], description: str, total: float | None = None) -> Iterator[T]:
    """Yield from ``steps`` and report after each how many of ``total`` (their number) are done."""
    if total is None and isinstance(steps, Sized):
        total = len(steps)
    with reported() as report:
        report(description, 0.0 if total else None)
        for done, step in enumerate(steps, 1):
            yield step
            report(description, min(done / total, 1.0) if total else None)


@contextlib.contextmanager
def step_progress(
    report: ProgressCallback, text: str, done: int, count: int, within: bool = True
) -> Iterator[None]:
    """Tell ``report`` how far a job of ``count`` steps is, one of which the block is.

    ``text`` says which, and ``done`` steps are done. What is done ``within`` the step counts, if
    its jobs are one.
    """

    def tell(_: str, share: float | None) -> None:
        report(text, (done + (share or 0) * within) / count)

    tell("", 0)
    with progress(tell):
        yield
    report(text, (done + 1) / count)


@contextlib.contextmanager
def _bar() -> Iterator[ProgressCallback]:
    """A bar on standard error, which is gone at the end."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    # Without a thread of its own: the focus stage is quicker where it is the only one.
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, auto_refresh=False) as bar:
        task = bar.add_task("", total=None)

        def show(text: str, share: float | None) -> None:
            total = None if share is None else 1.0
            bar.update(task, description=text, completed=share or 0.0, total=total, refresh=True)

        yield show


def _is_notebook() -> bool:
    """Whether this runs in the kernel of a notebook."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return type(shell).__name__ == "ZMQInteractiveShell"


@contextlib.contextmanager
def _bar_of_notebook() -> Iterator[ProgressCallback]:
    """A bar below the cell, of jobs that take a while, which is gone at the end."""
    from IPython.display import HTML, display

    began = updated = time.monotonic()
    handle = None

    def show(text: str, share: float | None) -> None:
        nonlocal updated, handle
        now = time.monotonic()
        if now - updated < NOTEBOOK_STEP:
            return
        updated = now
        value, left = "", ""
        if share:
            value, left = f' value="{share:.3f}"', f", {(now - began) * (1 / share - 1):.0f} s left"
        bar = HTML(f"<progress{value}></progress> {html.escape(text)}{left}")
        if handle is None:
            handle = display(bar, display_id=True)
        else:
            handle.update(bar)

    try:
        yield show
    finally:
        if handle is not None:
            handle.update(HTML(""))
