"""The docs: every public name has its entry, programs run, links lead somewhere."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from pages import blocks

import potmesil_mi as pm

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
HOWTOS = [page for page in sorted((DOCS / "howto").glob("*.md")) if page.stem != "index"]
HOWTOS += [DOCS / "install.md"]
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted(DOCS.glob("*.md")),
    *sorted((DOCS / "howto").glob("*.md")),
]


def name_of(page):
    return str(page.relative_to(ROOT))


# ---------------------------------------------------------------- reference


def entries():
    text = (DOCS / "reference" / "index.rst").read_text(encoding="utf-8")
    return re.findall(r"^   potmesil_mi\.(\w+)$", text, re.MULTILINE)


def test_every_public_name_has_one_entry_in_the_reference():
    assert sorted(entries()) == sorted(pm.__all__)


@pytest.mark.parametrize("name", pm.__all__)
def test_every_public_name_has_a_docstring(name):
    assert getattr(pm, name).__doc__


def test_every_wing_is_among_the_modules():
    text = (DOCS / "reference" / "modules.rst").read_text(encoding="utf-8")
    wings = {
        f"potmesil_mi.{path.parent.name}" for path in (ROOT / "potmesil_mi").glob("*/__init__.py")
    }
    assert wings <= set(text.split())


# ---------------------------------------------------------------- programs


@pytest.mark.slow
@pytest.mark.parametrize("page", HOWTOS, ids=lambda page: page.stem)
def test_the_howto_runs_from_top_to_bottom(page, tmp_path):
    programs = blocks(page, "python")
    assert programs
    if "import torch" in page.read_text(encoding="utf-8"):
        pytest.importorskip("torch")
    lines = []
    for first, program in programs:  # Lines are numbered as on the page, for tracebacks.
        lines += [""] * (first - len(lines)) + program.splitlines()
    script = tmp_path / f"howto_{page.stem}.py"  # No program is to be imported for a library.
    script.write_text("\n".join(lines), encoding="utf-8")
    run = subprocess.run(
        [sys.executable, "-W", "error", script],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr[-3000:]


def commands():
    """(page, command, option) of every ``potmesil`` on the pages."""
    for page in PAGES:
        for _, text in blocks(page, "bash"):
            for line in text.splitlines():
                words = line.split("#")[0].split()
                for name in ("potmesil", ".venv/bin/potmesil"):
                    if name in words:
                        command, *rest = words[words.index(name) + 1 :]
                        yield name_of(page), command, [w for w in rest if w.startswith("-")]


def test_options_of_commands_on_the_pages_exist(capsys):
    from potmesil_mi.cli import main

    found = list(commands())
    assert len(found) > 5
    wrong = []
    for command in {command for _, command, _ in found if not command.startswith("-")}:
        with pytest.raises(SystemExit):
            main([command, "--help"])
        known = set(re.findall(r"(?<![\w-])--?[A-Za-z][\w-]*", capsys.readouterr().out))
        wrong += [
            f"{page}: {command} {option}"
            for page, of, options in found
            for option in options
            if of == command and option not in known
        ]
    assert not wrong


# ---------------------------------------------------------------- links


def slug(heading):
    """The anchor of a heading, as GitHub and MyST make it."""
    text = re.sub(r"[^\w\- ]", "", heading.strip().lower())
    return text.replace(" ", "-")


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_within_the_repository_lead_somewhere(page):
    text = page.read_text(encoding="utf-8")
    prose = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    wrong = []
    for target in re.findall(r"\]\(([^)\s]+)\)", prose):
        if re.match(r"[a-z]+:", target):
            continue
        place, _, anchor = target.partition("#")
        file = page.parent / place if place else page
        if not file.exists():
            wrong.append(target)
        elif anchor and file.suffix == ".md":
            headings = re.findall(r"^#+ (.*)$", file.read_text(encoding="utf-8"), re.MULTILINE)
            if anchor not in map(slug, headings):
                wrong.append(target)
    assert not wrong


@pytest.mark.parametrize("page", [DOCS / "architecture.md", ROOT / "CONTRIBUTING.md"], ids=name_of)
def test_modules_named_on_the_page_exist(page):
    text = page.read_text(encoding="utf-8")
    named = re.findall(r"`((?:[a-z_0-9]+/)+[a-z_0-9]*(?:\.py)?|[a-z_0-9]+\.py)`", text)
    assert named
    places = [ROOT, ROOT / "potmesil_mi", *(ROOT / "potmesil_mi").iterdir(), ROOT / "tests"]
    assert [name for name in named if not any((place / name).exists() for place in places)] == []


def test_the_line_that_decides_what_a_lens_point_sees_is_three_steps_from_the_readme():
    """README, then docs/architecture.md, then the module, which quotes the line that it has."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    architecture = (DOCS / "architecture.md").read_text(encoding="utf-8")
    module = (ROOT / "potmesil_mi" / "focusing" / "visibility.py").read_text(encoding="utf-8")
    assert "](docs/architecture.md)" in readme
    assert "](../potmesil_mi/focusing/visibility.py)" in architecture
    head, _, code = module.partition("from __future__")
    quoted = [line for line in re.findall(r"``([^`]+)``", head) if "=" in line]
    assert quoted
    assert all(line in code for line in quoted)
