"""The command line: ``potmesil render``, ``focus``, ``animate``, ``compare`` and ``dof``."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from types import FrameType
from typing import NoReturn

TRACEBACK = "POTMESIL_TRACEBACK"
"""Environment variable: if it is set, errors end in Python's traceback instead of in a line."""

BROKEN_PIPE = 141
"""The exit code of what ends by the signal that there is for it."""

ENDING = ("SIGTERM", "SIGHUP")
"""Signals that ask the program to end."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code: 0, 1 for an error, 130 for Ctrl-C,
    141 where nobody reads what it prints.

    Wrong usage ends in ``SystemExit(2)``, a signal that asks the program to end in one of 128 and
    its number, after what was being written has been removed.
    """
    try:
        with _ended_by_signals():
            # Not before: Ctrl-C ends the program in order while this is imported, too.
            from .program import run

            run(sys.argv[1:] if arguments is None else [*arguments])
        sys.stdout.flush()
    except BrokenPipeError:
        # Whoever reads what is printed has had enough; Python must not say so at its end, either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except KeyboardInterrupt:
        print("potmesil: interrupted", file=sys.stderr)
        return 130
    except Exception as error:
        if os.environ.get(TRACEBACK):
            raise
        print(f"potmesil: error: {_in_a_line(error)}", file=sys.stderr)
        return 1
    return 0


def _in_a_line(error: Exception) -> str:
    """What an error says; one that nobody expected says by its type what it is."""
    expected = (ValueError, TypeError, OSError, RuntimeError, ImportError)
    text = " ".join(str(error).split())
    if isinstance(error, MemoryError):
        return f"there is not enough memory: {text or 'for more'}"
    if isinstance(error, expected) and text:
        return str(error)
    return f"{type(error).__name__}: {text} (unexpected; {TRACEBACK}=1 shows where)"


@contextlib.contextmanager
def _ended_by_signals() -> Iterator[None]:
    """Signals that ask the program to end do so as an exception, which lets it tidy up."""

    def end(number: int, _: FrameType | None) -> NoReturn:
        raise SystemExit(128 + number)

    before = {}
    if threading.current_thread() is threading.main_thread():
        numbers = [getattr(signal, name) for name in ENDING if hasattr(signal, name)]
        before = {number: signal.signal(number, end) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
