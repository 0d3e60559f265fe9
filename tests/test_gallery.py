"""The gallery: every picture of the docs has commands on that page, and these can be run."""

import importlib.util
import re
from pathlib import Path

import pytest

from potmesil_mi._image import PICTURES
from potmesil_mi.cli.program import _parsers

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
SUFFIXES = (*PICTURES, ".mp4", ".gif", ".webp")


@pytest.fixture(scope="module")
def gallery():
    spec = importlib.util.spec_from_file_location("make_gallery", DOCS / "make_gallery.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def commands(gallery):
    return [command for block in gallery.blocks() for command in block]


def test_every_picture_of_the_docs_is_made_by_a_command(gallery):
    kept = {
        path.name
        for path in DOCS.rglob("*")
        if path.suffix in SUFFIXES and "_build" not in path.relative_to(DOCS).parts
    }
    made = [name for block in gallery.blocks() for name in gallery.made_by(block)]
    assert sorted(made) == sorted(kept)


def test_drawings_are_text():
    for path in DOCS.glob("*.svg"):
        assert "<image" not in path.read_text(encoding="utf-8")


def test_each_command_names_a_program_that_is_there(gallery):
    for program in {command[0] for command in commands(gallery)}:
        assert Path(gallery.program(program)).is_file()
    with pytest.raises(SystemExit, match="the page may call"):
        gallery.program("rm")


def test_files_of_the_commands_are_there_or_made_before(gallery):
    for block in gallery.blocks():
        made = []
        for command in block:
            named = [word for word in command if re.match(r"(scenes|docs|build)/", word)]
            named += [word.partition("=")[2] for word in command if word.startswith("image:")]
            for word in named:
                if word.startswith("build/") and word not in made:
                    before = command[command.index(word) - 1]
                    numbered = re.sub(r"_\d+\.", "_{:02d}.", word)
                    assert before in ("-o", "--samples") or numbered in made, word
                    made.append(word)
                assert word.startswith(("build/", "docs/")) or (ROOT / word).is_file(), word


def parse(arguments):
    """What the command line makes of arguments, before it does anything."""
    parser, _ = _parsers(arguments)
    return parser.parse_args(arguments)


def test_each_command_of_the_package_parses(gallery):
    own = [command[1:] for command in commands(gallery) if command[0] == "potmesil"]
    assert len(own) >= 6
    for arguments in own:
        assert parse(arguments).output
    with pytest.raises(SystemExit):
        parse(["focus", "a.samples", "--no-such-option"])


def test_an_unknown_picture_is_refused(gallery, capsys):
    with pytest.raises(SystemExit):
        gallery.main(["sunset.jpg"])
    assert "must be one of candles.jpg" in capsys.readouterr().err
