"""The parser of the command line: errors of a command are the command's, and tell what is near."""

from __future__ import annotations

import argparse
import difflib
from collections.abc import Sequence
from typing import Any, NoReturn

REFUSED = "unrecognized arguments"
"""How an error of arguments that no option takes begins, as argparse says it."""


OTHER_WORDS = {
    "--fstop": "--f-number",
    "--f-stop": "--f-number",
    "--focal": "--focal-length",
    "--focus": "--focus-distance",
    "--samples-per-pixel": "--spp",
    "--unit": "--units",
}
"""Options as others call them, and what they are here."""


class CommandParser(argparse.ArgumentParser):
    """A parser that takes no abbreviations, whose errors suggest what may have been meant."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **{**settings, "allow_abbrev": False})

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parse the arguments; of a command, what it does not know is its error."""
        found, unknown = super().parse_known_args(args, namespace)
        if unknown and not self._has_commands():
            self.error(f"{REFUSED}: {' '.join(unknown)}{self._suggestion(unknown)}")
        return found, unknown

    def error(self, message: str) -> NoReturn:
        """Say the usage in a line, what is wrong, and where there is help; exit with 2."""
        self.exit(
            2,
            f"{self.format_usage()}{self.prog}: error: {message}\n"
            f"`{self.prog} --help` shows all of it\n",
        )

    def format_usage(self) -> str:
        """The name alone: all the options of a command would fill the screen."""
        what = "COMMAND ..." if self._has_commands() else "[OPTIONS] " + self._names()
        return f"usage: {self.prog} {what.rstrip()}\n"

    def option_of(self, parameter: str) -> str | None:
        """The option that gives a parameter, if there is one."""
        for action in self._actions:
            if action.dest == parameter and action.option_strings:
                return action.option_strings[-1]
        return None

    def actions(self) -> list[argparse.Action]:
        """All that it takes."""
        return [*self._actions]

    def _has_commands(self) -> bool:
        return any(isinstance(one, argparse._SubParsersAction) for one in self._actions)

    def _names(self) -> str:
        names = (one.metavar or one.dest for one in self._actions if not one.option_strings)
        return " ".join(str(name) for name in names)

    def _suggestion(self, unknown: Sequence[str]) -> str:
        known = [text for one in self._actions for text in one.option_strings]
        for argument in unknown:
            name = argument.partition("=")[0]
            meant = OTHER_WORDS.get(name)
            near = meant if meant in known else nearest(name, known)
            if near:
                return f"; did you mean {near}?"
        return ""


def nearest(text: str, known: Sequence[str]) -> str | None:
    """What of the ``known`` a text is nearest to, if it is near to any."""
    found = difflib.get_close_matches(text, known, n=1)
    return found[0] if found else None
