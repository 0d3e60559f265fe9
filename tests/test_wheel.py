"""What a user gets who has no checkout: the wheel, and what it promises on its pages.

The wheel is built of the sdist, and that of a copy of the checkout, without a network. Command
lines are run as they stand, on what is installed of it: those of its own page each in a shell, all
others in one process, because most of the time of each is the start and the compiling of kernels.
"""

import glob
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tarfile
import threading
import zipfile
from pathlib import Path

import pytest
import yaml
from pages import blocks, command_lines

import potmesil_mi as pm
from potmesil_mi.cli import main
from potmesil_mi.cli.program import COMMANDS

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent
COPIED_NOTEBOOKS = ROOT / "docs" / "notebooks"
"""Where a build of the docs has copies of the notebooks."""

SECONDS = 300
"""That a command line may take: far more than any takes."""

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

NOT_OF_THE_SOURCE = shutil.ignore_patterns(
    *(".git", ".venv", ".hypothesis", ".*_cache", "__pycache__", "*.egg-info"),
    *("build", "dist", "output", "_build", "generated"),
)


def run(arguments, **options):
    """Run a program that is expected to succeed; returns what it printed."""
    result = subprocess.run(
        arguments, capture_output=True, text=True, timeout=SECONDS, check=False, **options
    )
    assert result.returncode == 0, f"{arguments}\n{result.stdout[-2000:]}{result.stderr[-3000:]}"
    return result.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The sdist, and the wheel that is built of what is in it."""
    folder = tmp_path_factory.mktemp("built")
    shutil.copytree(ROOT, folder / "checkout", ignore=NOT_OF_THE_SOURCE)
    make = "import sys; from setuptools import build_meta; build_meta.build_sdist(sys.argv[1])"
    run([sys.executable, "-c", make, str(folder)], cwd=folder / "checkout")
    (sdist,) = folder.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        archive.extractall(folder / "unpacked", filter="data")
    (source,) = (folder / "unpacked").iterdir()
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    run([*pip, "wheel", "--no-build-isolation", "--no-deps", "-w", str(folder), str(source)])
    (wheel,) = folder.glob("*.whl")
    return source, wheel


@pytest.fixture(scope="module")
def installed(built, tmp_path_factory):
    """The environment of programs that find the wheel's package, and not the checkout's."""
    target = tmp_path_factory.mktemp("installed")
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    run([*pip, "install", "--no-deps", "--target", str(target), str(built[1])])
    path = f"{target / 'bin'}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PYTHONPATH": str(target), "PATH": path}
    for name in ("PYTEST_ADDOPTS", "PYTHONDONTWRITEBYTECODE"):
        environment.pop(name, None)
    return target, environment


RUN_LINES = """
import json, os, sys
from potmesil_mi.cli import main

answers = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)  # What commands print goes where their errors go.
for request in sys.stdin:
    folder, words = json.loads(request)
    os.chdir(folder)
    print(main(words), file=answers, flush=True)
"""


def needs_no_file(words):
    """Whether a command line begins with an example, so that it makes the same in every folder."""
    return words[1].startswith("example:")


def copy_outputs(line, source, folder):
    for pattern in outputs_of(line):
        for name in glob.glob(pattern, root_dir=source):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            copy = shutil.copytree if (source / name).is_dir() else shutil.copy
            copy(source / name, folder / name)


@pytest.fixture(scope="module")
def one_process(installed, tmp_path_factory):
    """A function that runs a command line, in a process that runs all that it is given.

    What is made of an example is made once, and copied where the same line stands elsewhere.
    """
    folder = tmp_path_factory.mktemp("process")
    printed = folder / "printed"
    with (
        printed.open("w") as file,
        subprocess.Popen(
            [sys.executable, "-c", RUN_LINES],
            env=installed[1],
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=file,
            text=True,
        ) as process,
    ):
        made_in = {}

        def run_line(line, folder):
            words = shlex.split(line, comments=True)[1:]
            if made_in.setdefault(tuple(words), folder) != folder and needs_no_file(words):
                copy_outputs(line, made_in[tuple(words)], folder)
                return
            watch = threading.Timer(SECONDS, process.kill)
            watch.start()
            print(json.dumps([str(folder), words]), file=process.stdin, flush=True)
            answer = process.stdout.readline()
            watch.cancel()
            assert answer == "0\n", f"{line}\n{printed.read_text()[-3000:]}"

        yield run_line


# ---------------------------------------------------------------- what is in it


def names_in(folder, *patterns):
    found = {path for pattern in patterns for path in (ROOT / folder).rglob(pattern)}
    return {
        path.relative_to(ROOT).as_posix()
        for path in found
        if path.is_file()
        and not {"__pycache__", "_build", "generated"} & {*path.parts}
        and path.parent != COPIED_NOTEBOOKS
    }


def test_the_wheel_has_every_module_and_every_scene_and_no_test(built):
    names = set(zipfile.ZipFile(built[1]).namelist())
    expected = names_in("potmesil_mi", "*.py", "*.pyi", "py.typed")
    expected |= names_in("potmesil_mi", "*.js", "*.css", "*.html", "*.svg")
    expected |= {f"potmesil_mi/{name}" for name in names_in("scenes", "*.*")}
    mine = {name for name in names if ".dist-info/" not in name}
    assert mine == expected


def test_the_sdist_has_what_its_tests_need(built):
    for folder in ("tests", "scenes", "notebooks", "benchmarks", "docs"):
        missing = {name for name in names_in(folder, "*.*") if not (built[0] / name).is_file()}
        assert not missing
    for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "CITATION.cff", "setup.sh"):
        assert (built[0] / name).is_file(), name


def test_the_installed_package_finds_its_scenes_and_its_version(installed, tmp_path):
    target, environment = installed
    code = "import potmesil_mi as pm; print(pm.__version__, pm.example('terrace'))"
    printed = run([sys.executable, "-W", "error", "-c", code], env=environment, cwd=tmp_path)
    version, example = printed.strip().split(" ", 1)
    assert version == PROJECT["version"]
    assert Path(example) == target / "potmesil_mi" / "scenes" / "terrace.xml"


# ---------------------------------------------------------------- what it says of itself


def test_the_page_of_the_package_needs_no_file_beside_it():
    """Package indexes show it alone: pictures and links within a repository lead nowhere."""
    text = (ROOT / PROJECT["readme"]).read_text(encoding="utf-8")
    assert "![" not in text
    assert all(
        target.startswith(("https:", "#")) for target in re.findall(r"\]\(([^)\s]+)\)", text)
    )


def test_the_citation_names_the_version_and_the_paper():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["cff-version"] == "1.2.0"
    assert {"message", "title", "authors"} <= citation.keys()
    assert citation["version"] == PROJECT["version"] == pm.__version__
    assert [author["name"] for author in citation["authors"]] == [
        author["name"] for author in PROJECT["authors"]
    ]
    (paper,) = citation["references"]
    assert paper["doi"] == "10.1145/800224.806818"
    assert (ROOT / "README.md").read_text(encoding="utf-8").count(paper["doi"])


# ---------------------------------------------------------------- command lines


def lines_of_page(page):
    return [line for _, text in blocks(ROOT / page, "bash") for line in command_lines(text)]


def lines_of_help(command, capsys):
    with pytest.raises(SystemExit):
        main([command, "--help"])
    _, examples, text = capsys.readouterr().out.partition("\nexamples:\n")
    assert examples, command
    return command_lines(text)


def outputs_of(line):
    """What a command line says that it writes, as patterns of names of files."""
    words = shlex.split(line, comments=True)
    named = [
        words[i + 1]
        for i, word in enumerate(words)
        if word in ("-o", "--output", "--samples") and words[1] != "compare"
    ]
    return [re.sub(r"{.*?}", "*", name) for name in named]


def run_as_they_stand(lines, run_line, folder):
    assert lines
    for line in lines:
        run_line(line, folder)
        missing = [name for name in outputs_of(line) if not glob.glob(name, root_dir=folder)]
        assert not missing, line


def test_command_lines_of_the_packages_page_run_as_they_stand(installed, tmp_path, capsys):
    def run_in_shell(line, folder):
        run(["bash", "-c", line], env=installed[1], cwd=folder)

    lines = lines_of_page(PROJECT["readme"]) + lines_of_help("completion", capsys)
    run_as_they_stand(lines, run_in_shell, tmp_path)


def test_command_lines_of_the_repositorys_page_run_as_they_stand(one_process, tmp_path):
    run_as_they_stand(lines_of_page("README.md"), one_process, tmp_path)


@pytest.mark.parametrize("command", [name for name in COMMANDS if name != "completion"])
def test_examples_of_the_help_run_as_they_stand(command, one_process, tmp_path, capsys):
    run_as_they_stand(lines_of_help(command, capsys), one_process, tmp_path)
