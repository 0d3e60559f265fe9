"""The commands of ``potmesil`` and their parser.

What a command needs is imported when it runs, and its options are made when it is asked for, so
that ``--help`` and ``dof`` start at once and need no LLVM.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, NoReturn

from .._memory import limited_to
from .animate import animate, animate_options
from .commands import (
    against_thinlens,
    compare_options,
    dof,
    dof_options,
    focus_options,
    refocus,
    render,
    render_options,
)


def run(arguments: Sequence[str]) -> None:
    """Run the command that ``arguments`` ask for; its warnings are lines of standard error.

    Wrong usage ends in ``SystemExit(2)``.
    """
    with warnings.catch_warnings():
        warnings.showwarning = _show_warning
        options = _parser(arguments).parse_args(arguments)
        with limited_to(getattr(options, "max_memory", None)):
            options.command(options)


class _Command(NamedTuple):
    """A command: one line about it, what adds its options and what runs it."""

    summary: str
    add_options: Callable[[argparse.ArgumentParser], str]
    run: Callable[[argparse.Namespace], None]


COMMANDS = {
    "render": _Command("render a Mitsuba scene through the lens", render_options, render),
    "focus": _Command("form a picture from point samples", focus_options, refocus),
    "animate": _Command("form the frames of an animation", animate_options, animate),
    "compare": _Command(
        "compare a focused picture with a ray-traced one: error and time",
        compare_options,
        against_thinlens,
    ),
    "dof": _Command("print depths of field; by default the paper's Table 1", dof_options, dof),
}
"""The commands by their names, in the order of the help."""


def _parser(arguments: Sequence[str]) -> argparse.ArgumentParser:
    """The parser, with the options of those commands only that ``arguments`` name."""
    parser = argparse.ArgumentParser(
        prog="potmesil",
        description="Lens and aperture camera of Potmesil & Chakravarty (1981) for Mitsuba 3.",
    )
    parser.add_argument(
        "--version", action=_Version, nargs=0, help="show program's version number and exit"
    )
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for name, (summary, add_options, run) in COMMANDS.items():
        command = commands.add_parser(
            name,
            help=summary,
            description=f"{summary[0].upper()}{summary[1:]}.",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        command.set_defaults(command=run)
        if name in arguments:
            command.epilog = add_options(command)
    return parser


class _Version(argparse.Action):
    """Prints the version, which takes a while to look up, and ends the program."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        from .._version import installed_version

        print(installed_version())
        parser.exit()


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    print(f"potmesil: warning: {message}", file=sys.stderr)
