"""The scenes that come with the package, and what moves in them."""

from __future__ import annotations

import difflib
import os
import re
from pathlib import Path

PREFIX = "example:"
"""What stands before the name of an example where a file may be named, too."""

PATTERNS = ("*.xml", "motions/*.toml", "recipes/*.toml")
"""Which files of the folder are examples. Others are parts of them, such as textures."""

FIRST_COMMENT = {
    ".xml": re.compile(r"<!--(.*?)-->", re.DOTALL),
    ".toml": re.compile(r"((?:^#.*\n)+)", re.MULTILINE),
}
FIRST_SENTENCE = re.compile(r"(.*?\.)(?:\s|$)", re.DOTALL)


def examples() -> dict[str, str]:
    """The examples that come with the package: their names, and one sentence about each.

    Names of what moves, and of animations, begin with ``motions/``, of recipes of data sets with
    ``recipes/``; all others are scenes. The sentence is the first of the file's comment.
    """
    return {name: _summary(path) for name, path in _files().items()}


def example(name: str) -> Path:
    """The file of an example.

    ===========  ==========================================================================
    Parameter    Meaning
    ===========  ==========================================================================
    ``name``     one of :func:`potmesil_mi.examples`, such as ``terrace``, a scene beside the
                 textures that it uses, or ``motions/ball``, what moves in ``moving``
    ===========  ==========================================================================

    ``mi.load_file(str(pm.example("terrace")), optimize=False)`` loads a scene; on the command line
    ``example:terrace`` stands for it. Raises ``TypeError`` for what is no text, and ``ValueError``
    for a name that there is not, with the one that is most like it.
    """
    # Not before: it takes NumPy, which the options of a command do not.
    from ._validation import require_kind

    files = _files()
    require_kind("name", name, str, f"one of {', '.join(files)}")
    if name not in files:
        alike = difflib.get_close_matches(name, files, n=1)
        question = f"; did you mean {alike[0]}?" if alike else ""
        raise ValueError(f"name={name!r}: must be one of {', '.join(files)}{question}")
    return files[name]


def file_of(text: str) -> str:
    """The name of a file that ``text`` names, as such or as ``example:NAME``."""
    return os.fspath(example(text[len(PREFIX) :])) if text.startswith(PREFIX) else text


def _files() -> dict[str, Path]:
    """The file of each example, scenes first."""
    package = Path(__file__).parent
    folder = package / "scenes"
    if not folder.is_dir():  # A checkout has it beside the package.
        folder = package.parent / "scenes"
    return {
        path.relative_to(folder).with_suffix("").as_posix(): path
        for pattern in PATTERNS
        for path in sorted(folder.glob(pattern))
    }


def _summary(path: Path) -> str:
    """The first sentence of the first comment in a file, in one line."""
    comment = FIRST_COMMENT[path.suffix].search(path.read_text(encoding="utf-8"))
    text = " ".join(line.strip(" #") for line in (comment[1] if comment else "").splitlines())
    sentence = FIRST_SENTENCE.match(text.strip())
    return sentence[1] if sentence else text.strip()
