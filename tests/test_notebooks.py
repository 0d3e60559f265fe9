import subprocess
import sys
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parent.parent / "notebooks").glob("*.ipynb"))

RUN = """
import sys, nbformat
import matplotlib.font_manager  # It says so on stderr where it first looks for fonts.
from nbclient import NotebookClient
notebook = nbformat.read(sys.argv[1], as_version=4)
NotebookClient(notebook, timeout=300, resources={"metadata": {"path": sys.argv[2]}}).execute()
outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
warnings = [output.text for output in outputs if output.get("name") == "stderr"]
sys.exit("".join(warnings) or None)
"""


def test_there_are_notebooks():
    assert NOTEBOOKS


@pytest.mark.longest
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_notebook_runs_from_the_first_cell_to_the_last(notebook):
    run = subprocess.run(
        [sys.executable, "-c", RUN, str(notebook), str(notebook.parent)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr[-3000:]


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_notebook_is_kept_without_outputs(notebook):
    import nbformat

    cells = nbformat.read(notebook, as_version=4).cells
    assert not any(cell.get("outputs") for cell in cells)
