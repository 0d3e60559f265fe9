"""Make the pictures of docs/gallery.md again, by the commands that stand on that page.

python docs/make_gallery.py              # all of them: the better part of an hour on two slow cores
python docs/make_gallery.py terrace.jpg  # some of them

A block of commands is run from its first line to its last. What is needed on the way goes into
build/. `oiiotool` comes with OpenImageIO.
"""

from __future__ import annotations

import argparse
import itertools
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
PAGE = DOCS / "gallery.md"
PROGRAMS = ("potmesil", "oiiotool")


def blocks() -> list[list[list[str]]]:
    """The words of the commands on the page, block by block."""
    text = PAGE.read_text(encoding="utf-8")
    found = re.findall(r"^```bash\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return [[shlex.split(line) for line in block.splitlines()] for block in found]


def made_by(block: list[list[str]]) -> list[str]:
    """Names of the files of docs/ that a block of commands writes."""
    after_o = [
        file for command in block for option, file in itertools.pairwise(command) if option == "-o"
    ]
    return [Path(file).name for file in after_o if Path(file).parent == Path("docs")]


def program(name: str) -> str:
    """Where a program is: beside the Python that runs this, or in the PATH."""
    if name not in PROGRAMS:
        raise SystemExit(f"{name}: the page may call {' and '.join(PROGRAMS)} only")
    beside = shutil.which(name, path=str(Path(sys.executable).parent)) or shutil.which(name)
    if beside is None:
        raise SystemExit(f"{name}: is not installed")
    return beside


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    every = [name for block in blocks() for name in made_by(block)]
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(every)}")
    names = parser.parse_args(arguments).names or every
    for name in names:
        if name not in every:
            parser.error(f"NAME={name!r}: must be one of {', '.join(every)}")
    (ROOT / "build").mkdir(exist_ok=True)
    for block in blocks():
        if set(names) & set(made_by(block)):
            for first, *rest in block:
                print("$", shlex.join([first, *rest]), flush=True)
                subprocess.run([program(first), *rest], cwd=ROOT, check=True)  # noqa: S603


if __name__ == "__main__":
    main()
