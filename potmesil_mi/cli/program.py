"""The commands of ``potmesil`` and their parser.

What a command needs is imported when it runs, and its options are made when it is asked for, so
that ``--help`` and ``dof`` start at once and need no LLVM.
"""

from __future__ import annotations

import argparse
import contextlib
import re
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, NoReturn

from .._memory import limited_to
from .._progress import as_one, progress
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
from .dataset import dataset, dataset_options
from .info import info, info_options
from .live import live, live_options
from .living import living, living_options
from .options import add_talk
from .parser import CommandParser, nearest
from .stack import stack, stack_options

SAMPLING = {
    "Exposing": 0.05,
    "Sampling": 0.6,
    "Veils": 0.05,
    "Windows": 0.1,
    "Hidden surfaces": 0.1,
    "Reflections": 0.05,
}
"""What takes samples of a scene, in order, and about which share of the time it takes."""

FOCUSING = {"Denoising": 0.2, "Focusing": 0.1}
"""The same of what forms a picture of them."""


class _Command(NamedTuple):
    """A command: one line about it, what adds its options and what runs it.

    ``stages`` are those of the jobs that are shown as one, and their shares of the time.
    """

    summary: str
    add_options: Callable[[argparse.ArgumentParser], str]
    run: Callable[[argparse.Namespace], None]
    stages: Mapping[str, float] = {}
    talks: bool = True
    """Whether it says what it has done."""


SHELLS = ("bash", "zsh", "tcsh")
"""Shells that can complete commands."""

FILES = {"scene", "samples", "output", "source", "animation", "map", "motion", "depth"}
"""Parameters of commands that are files."""

COMPLETION_EXAMPLES = """
examples:
  potmesil completion bash > potmesil.bash   # which ~/.bashrc is to source
  potmesil completion zsh > _potmesil        # into a folder of $fpath
"""


def completion_options(command: argparse.ArgumentParser) -> str:
    """Add the options of ``potmesil completion``; returns the examples."""
    command.add_argument("shell", choices=SHELLS, help="the shell that is to complete")
    return COMPLETION_EXAMPLES


def completion(options: argparse.Namespace) -> None:
    """``potmesil completion``: a script for the shell."""
    import shtab

    parser, commands = _parsers(tuple(COMMANDS))
    for command in commands.values():
        for action in command.actions():
            if action.dest in FILES:
                action.complete = shtab.FILE  # type: ignore[attr-defined]
    print(shtab.complete(parser, shell=options.shell))


COMMANDS = {
    "render": _Command(
        "render a Mitsuba scene through the lens", render_options, render, SAMPLING | FOCUSING
    ),
    "focus": _Command("form a picture from point samples", focus_options, refocus, FOCUSING),
    "animate": _Command("form the frames of an animation", animate_options, animate),
    "stack": _Command("form pictures at many distances or apertures", stack_options, stack),
    "dataset": _Command("form the stacks of a data set", dataset_options, dataset),
    "living": _Command(
        "write a page with a picture that one refocuses", living_options, living, SAMPLING
    ),
    "info": _Command(
        "tell what a scene, samples or a picture have, and what a lens makes sharp",
        info_options,
        info,
        SAMPLING,
    ),
    "live": _Command("show a picture that one refocuses, in a browser", live_options, live),
    "compare": _Command(
        "compare a focused picture with a ray-traced one: error and time",
        compare_options,
        against_thinlens,
    ),
    "dof": _Command("print depths of field; by default the paper's Table 1", dof_options, dof),
    "completion": _Command(
        "print what lets a shell complete commands and options",
        completion_options,
        completion,
        talks=False,
    ),
}
"""The commands by their names, in the order of the help."""


def run(arguments: Sequence[str]) -> None:
    """Run the command that ``arguments`` ask for; its warnings are lines of standard error.

    Wrong usage ends in ``SystemExit(2)``.
    """
    with warnings.catch_warnings():
        warnings.showwarning = _show_warning
        parser, commands = _parsers(arguments)
        options = parser.parse_args(arguments)
        command = commands[options.command]
        stages = COMMANDS[options.command].stages
        with limited_to(getattr(options, "max_memory", None)), contextlib.ExitStack() as stack:
            if getattr(options, "quiet", False):
                stack.enter_context(progress(lambda text, share: None))
            elif stages:
                stack.enter_context(as_one(stages))
            stack.enter_context(_errors_of(command, options))
            COMMANDS[options.command].run(options)


def _parsers(arguments: Sequence[str]) -> tuple[CommandParser, dict[str, CommandParser]]:
    """The parser and those of commands, with the options of those that ``arguments`` name."""
    parser = CommandParser(
        prog="potmesil",
        description="Lens and aperture camera of Potmesil & Chakravarty (1981) for Mitsuba 3.",
    )
    parser.add_argument(
        "--version", action=_Version, nargs=0, help="show program's version number and exit"
    )
    named = next((argument for argument in arguments if not argument.startswith("-")), None)
    if named is not None and named not in COMMANDS:
        near = nearest(named, tuple(COMMANDS))
        meant = f"; did you mean {near}?" if near else ""
        parser.error(f"{named!r}: must be one of the commands {', '.join(COMMANDS)}{meant}")
    commands = parser.add_subparsers(
        title="commands", required=True, metavar="COMMAND", dest="command"
    )
    found = {}
    for name, about in COMMANDS.items():
        command = commands.add_parser(
            name,
            help=about.summary,
            description=f"{about.summary[0].upper()}{about.summary[1:]}.",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        if name in arguments:
            command.epilog = about.add_options(command)
            if about.talks:
                add_talk(command)
        found[name] = command
    return parser, found


@contextlib.contextmanager
def _errors_of(command: CommandParser, options: argparse.Namespace) -> Iterator[None]:
    """Let errors of a parameter within the block speak of the option that gave it."""
    try:
        yield
    except (ValueError, TypeError) as error:
        found = re.match(r"(\w+)(?=(?:\[\d+\])?[=:])", str(error))
        option = command.option_of(found[1]) if found else None
        given = getattr(options, found[1], None) if found else None
        is_given = not (given is None or given is False or given == [])
        if found is None or option is None or not (is_given or ": must be given" in str(error)):
            raise
        raise type(error)(f"{option}{str(error)[found.end() :]}") from error


class _Version(argparse.Action):
    """Prints the version and ends the program."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        from .._version import package_version

        print(package_version())
        parser.exit()


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    print(f"potmesil: warning: {message}", file=sys.stderr)
