"""Notebooks are kept with what they show, and show it still; notebooks/execute.py sees to both."""

import base64
import importlib.util
import io
import re
import subprocess
import sys
from pathlib import Path

import nbformat
import numpy as np
import pytest

ROOT = Path(__file__).parent.parent
FOLDER = ROOT / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
PROGRAM = FOLDER / "execute.py"

every_notebook = pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)


@pytest.fixture(scope="module")
def execute():
    spec = importlib.util.spec_from_file_location("execute_notebooks", PROGRAM)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def outputs(path):
    cells = nbformat.read(path, as_version=4).cells
    return [output for cell in cells for output in cell.get("outputs", [])]


def test_there_are_notebooks():
    assert len(NOTEBOOKS) == 7


@pytest.mark.longest
@every_notebook
def test_the_notebook_runs_without_a_warning_and_shows_what_is_kept(notebook):
    run = subprocess.run(
        [sys.executable, PROGRAM, "--check", notebook.stem],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr[-3000:]


@pytest.mark.parametrize("page", ["README.md", "docs/notebooks.md", "docs/manual.md"])
def test_the_page_leads_to_every_notebook(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    assert [path.name for path in NOTEBOOKS if f"notebooks/{path.name})" not in text] == []


# ---------------------------------------------------------------- what is kept


@every_notebook
def test_every_cell_was_run_in_order_and_some_show_pictures(notebook, execute):
    cells = [c for c in nbformat.read(notebook, as_version=4).cells if c.cell_type == "code"]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    pictures = [p for output in outputs(notebook) for p in execute.parts_of(output)[1]]
    assert len(pictures) >= 5


@every_notebook
def test_the_notebook_is_small(notebook, execute):
    assert notebook.stat().st_size <= execute.LARGEST


@every_notebook
def test_nothing_of_a_machine_or_a_time_is_kept(notebook, execute):
    kept = nbformat.read(notebook, as_version=4)
    assert kept.metadata == execute.METADATA
    assert not any(cell.metadata for cell in kept.cells)
    assert not any(output.get("metadata") for output in outputs(notebook))
    text = "".join(execute.parts_of(output)[0] for output in outputs(notebook))
    assert not re.search(r"/work/|/home/|/tmp/|/root/| at 0x|<progress|\d s left", text)


@every_notebook
def test_no_cell_failed_or_warned_and_no_bar_is_left(notebook, execute):
    for output in outputs(notebook):
        assert output.output_type != "error"
        assert output.get("name") != "stderr"
        assert not execute.is_spent_bar(output)


@every_notebook
def test_links_of_the_notebook_lead_somewhere(notebook):
    cells = nbformat.read(notebook, as_version=4).cells
    prose = "".join(cell.source for cell in cells if cell.cell_type == "markdown")
    links = [to for to in re.findall(r"\]\(([^)\s]+)\)", prose) if not re.match("[a-z]+:|#", to)]
    assert [to for to in links if not (notebook.parent / to).exists()] == []


# ---------------------------------------------------------------- what a check finds


def png(array):
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(array.astype(np.uint8)).save(file, "PNG")
    return base64.b64encode(file.getvalue()).decode()


def a_notebook(text="3 candles, 12.00 m", array=None):
    """One with a text and a picture."""
    array = np.full((32, 32, 3), 100) if array is None else array
    cell = nbformat.v4.new_code_cell("show()", execution_count=1)
    cell.outputs = [
        nbformat.v4.new_output("stream", name="stdout", text=text),
        nbformat.v4.new_output("display_data", data={"image/png": png(array)}),
    ]
    return nbformat.v4.new_notebook(cells=[cell])


def test_what_is_the_same_does_not_differ(execute):
    assert list(execute.differences(a_notebook(), a_notebook())) == []


def test_noise_and_last_digits_do_not_count(execute):
    noisy = 100 + np.random.default_rng(0).integers(-3, 4, (32, 32, 3))
    assert list(execute.differences(a_notebook(), a_notebook("3 candles, 12.01 m", noisy))) == []


@pytest.mark.parametrize("text", ["4 candles, 12.00 m", "3 lamps, 12.00 m", "3 candles, 12.3 m"])
def test_another_text_counts(execute, text):
    (said,) = execute.differences(a_notebook(), a_notebook(text))
    assert text in said


def test_another_picture_counts(execute):
    other = np.full((32, 32, 3), 100)
    other[:8, :8] = 140
    (said,) = execute.differences(a_notebook(), a_notebook(array=other))
    assert "dB" in said
    (said,) = execute.differences(a_notebook(), a_notebook(array=other[:, :31]))
    assert said.startswith("cell 0: the picture kept is at 0.0 dB")


def test_a_picture_within_html_counts(execute):
    def shown(level):
        html = f'<img src="data:image/png;base64,{png(np.full((8, 8, 3), level))}"> 8×8'
        return nbformat.v4.new_output("execute_result", data={"text/html": html})

    assert list(execute.differs(shown(100), shown(101))) == []
    (said,) = execute.differs(shown(100), shown(200))
    assert "dB" in said


def test_an_output_that_is_missing_counts(execute):
    without = a_notebook()
    del without.cells[0].outputs[0]
    (said,) = execute.differences(without, a_notebook())
    assert said == "cell 0: 1 outputs are kept, of 2"


def test_drawings_are_kept_exactly_and_pictures_small(execute):
    drawing = np.full((64, 64, 3), 255)
    drawing[30] = [31, 119, 180]
    kind, coded = execute.kept_picture(base64.b64decode(png(drawing)))
    assert kind == "image/png"
    output = nbformat.v4.new_output("display_data", data={kind: coded})
    np.testing.assert_array_equal(execute.parts_of(output)[1][0], drawing)
    y, x = np.mgrid[:128, :128]
    smooth = np.stack([x, y, x + y], axis=-1) * 255 / 256
    smooth = smooth + np.random.default_rng(0).normal(0, 4, smooth.shape)
    kind, coded = execute.kept_picture(base64.b64decode(png(smooth.clip(0, 255))))
    assert kind == "image/jpeg"
    assert len(coded) < 128 * 128


def test_a_cell_that_warns_is_an_error(execute, tmp_path):
    notebook = nbformat.v4.new_notebook(
        cells=[nbformat.v4.new_code_cell("import sys; print('careful', file=sys.stderr)")]
    )
    path = tmp_path / "warns.ipynb"
    nbformat.write(notebook, path)
    with pytest.raises(execute.Failed, match=r"warns.ipynb: a cell warns: careful"):
        execute.executed(path)


def test_what_a_bar_leaves_behind_is_taken_away(execute, tmp_path):
    source = "from IPython.display import HTML, display\ndisplay(HTML(''))\nprint('done')"
    cell = nbformat.v4.new_code_cell(source, metadata={"scrolled": True})
    path = tmp_path / "bar.ipynb"
    nbformat.write(nbformat.v4.new_notebook(cells=[cell]), path)
    (run,) = execute.executed(path).cells
    assert [output.text for output in run.outputs] == ["done\n"]
    assert not run.metadata


def test_an_unknown_name_is_refused(execute, capsys):
    with pytest.raises(SystemExit):
        execute.main(["sixth_steps"])
    assert "must be one of apertures, " in capsys.readouterr().err
