"""Run the notebooks of this folder and keep what they show.

python notebooks/execute.py             # all of them, after a change
python notebooks/execute.py apertures   # one of them
python notebooks/execute.py --check     # write nothing; tell where what is kept is something else

A cell that fails or warns is an error. What is kept has no times and no places of this machine in
it, drawings as PNG and pictures as JPEG. A check compares texts word by word and numbers to one per
cent, pictures to ``LEAST_PSNR``, for other processors round otherwise.
"""

from __future__ import annotations

import argparse
import base64
import io
import math
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import nbformat
import numpy as np
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from PIL import Image

FOLDER = Path(__file__).resolve().parent

METADATA = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}

LEAST_PSNR = 35.0
"""Decibels between a picture that is kept and the one that an execution shows."""

MOST_OFF = 0.01
"""Part of a number by which another processor may change it."""

COLORS, GOOD_ENOUGH, QUALITY = 64, 42.0, 88
"""A drawing is what so many colours show with so many decibels; the rest are JPEGs of a quality."""

LARGEST = 1_500_000
"""Bytes of a notebook, at most."""

IN_HTML = re.compile(r"data:image/(\w+);base64, ?([\w+/=\s]+)")
NUMBER = re.compile(r"-?\d[\d,]*\.?\d*(?:e[-+]?\d+)?")


class Failed(Exception):
    """A notebook that does not run as it should."""


def executed(path: Path) -> nbformat.NotebookNode:
    """The notebook with the outputs that its cells have now, as they are kept."""
    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs, cell.execution_count = [], None
    # Looking for fonts for the first time, matplotlib says so on stderr: it is to be over by then.
    import matplotlib.font_manager  # noqa: F401

    where = {"metadata": {"path": str(path.parent)}}
    client = NotebookClient(
        notebook,
        timeout=300,
        record_timing=False,
        coalesce_streams=True,  # Into how many parts a text comes is chance.
        resources=where,
    )
    try:
        client.execute()
    except CellExecutionError as error:
        raise Failed(f"{path.name}: {error}") from error
    notebook.metadata = nbformat.from_dict(METADATA)
    for cell in notebook.cells:
        cell.metadata = nbformat.NotebookNode()
        if cell.cell_type == "code":
            cell.outputs = [tidy(output) for output in cell.outputs if not is_spent_bar(output)]
            warned = [output.text for output in cell.outputs if output.get("name") == "stderr"]
            if warned:
                raise Failed(f"{path.name}: a cell warns: {''.join(warned)}")
    return notebook


def is_spent_bar(output: Any) -> bool:
    """Whether this is a bar of progress that is over, of which nothing is seen."""
    return output.get("data", {}).get("text/html") == ""


def tidy(output: Any) -> Any:
    """An output as it is kept: its picture small, and nothing else beside it."""
    data = output.get("data", {})
    if "image/png" in data:
        kind, coded = kept_picture(base64.b64decode(data["image/png"]))
        output.data = nbformat.from_dict({kind: coded})
        output.metadata = nbformat.NotebookNode()
    return output


def kept_picture(png: bytes) -> tuple[str, str]:
    """The type and the base64 text of a picture that a figure was drawn as."""
    picture = Image.open(io.BytesIO(png)).convert("RGBA")
    page = Image.new("RGBA", picture.size, "white")
    picture = Image.alpha_composite(page, picture).convert("RGB")
    few = picture.quantize(COLORS, dither=Image.Dither.NONE)
    file = io.BytesIO()
    if psnr(np.asarray(few.convert("RGB")), np.asarray(picture)) >= GOOD_ENOUGH:
        few.save(file, "PNG", optimize=True)
        kind = "image/png"
    else:
        picture.save(file, "JPEG", quality=QUALITY, optimize=True)
        kind = "image/jpeg"
    return kind, base64.b64encode(file.getvalue()).decode("ascii")


def psnr(one: np.ndarray, other: np.ndarray) -> float:
    """Decibels between two pictures of 8 bits; ``inf`` if they are equal, 0 if not of one size."""
    if one.shape != other.shape:
        return 0.0
    error = np.mean((one.astype(np.float64) - other) ** 2)
    return math.inf if error == 0 else float(10 * np.log10(255**2 / error))


def differences(kept: nbformat.NotebookNode, now: nbformat.NotebookNode) -> Iterator[str]:
    """Sentences on where what is kept of a notebook is not what it shows now."""
    for number, (old, new) in enumerate(zip(kept.cells, now.cells, strict=True)):
        if old.cell_type != "code":
            continue
        if old.execution_count != new.execution_count:
            yield f"cell {number}: was run as {old.execution_count}, not {new.execution_count}"
        if len(old.outputs) != len(new.outputs):
            yield f"cell {number}: {len(old.outputs)} outputs are kept, of {len(new.outputs)}"
            continue
        for before, after in zip(old.outputs, new.outputs, strict=True):
            yield from (f"cell {number}: {said}" for said in differs(before, after))


def differs(before: Any, after: Any) -> Iterator[str]:
    """Sentences on where one output is not another."""
    texts, pictures = parts_of(before)
    new_texts, new_pictures = parts_of(after)
    if len(pictures) != len(new_pictures):
        yield f"{len(pictures)} pictures are kept, of {len(new_pictures)}"
    for old, new in zip(pictures, new_pictures, strict=False):
        if (found := psnr(old, new)) < LEAST_PSNR:
            yield f"the picture kept is at {found:.1f} dB of that of now"
    if texts != new_texts and not alike(texts, new_texts):
        yield f"kept is {texts!r}, now it is {new_texts!r}"


def parts_of(output: Any) -> tuple[str, list[np.ndarray]]:
    """The text of an output, without its pictures, and these."""
    text, coded = output.output_type + output.get("name", "") + output.get("text", ""), []
    for kind, data in sorted(output.get("data", {}).items()):
        if kind.startswith("image/"):
            coded.append(data)
            text += "picture"
        else:
            coded += [match[2] for match in IN_HTML.finditer(data)]
            text += kind + IN_HTML.sub("picture", data)
    read = [Image.open(io.BytesIO(base64.b64decode(each))).convert("RGB") for each in coded]
    return text, [np.asarray(each) for each in read]


def alike(one: str, other: str) -> bool:
    """Whether texts are equal but for the last digits of their numbers."""
    # The sign of a zero moves what stands beside it.
    words, others = ("".join(NUMBER.sub("#", text).split()) for text in (one, other))
    if words != others:
        return False
    pairs = zip(NUMBER.findall(one), NUMBER.findall(other), strict=True)
    numbers = ([float(text.replace(",", "")) for text in pair] for pair in pairs)
    return all(math.isclose(a, b, rel_tol=MOST_OFF, abs_tol=1e-9) for a, b in numbers)


def main(arguments: list[str] | None = None) -> int:
    """The command; returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    names = [path.stem for path in sorted(FOLDER.glob("*.ipynb"))]
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(names)}")
    parser.add_argument("--check", action="store_true", help="write nothing, compare")
    options = parser.parse_args(arguments)
    for name in options.names:
        if name not in names:
            parser.error(f"NAME={name!r}: must be one of {', '.join(names)}")
    wrong = []
    for name in options.names or names:
        path = FOLDER / f"{name}.ipynb"
        kept = nbformat.read(path, as_version=4)
        try:
            now = executed(path)
        except Failed as error:
            wrong.append(str(error))
            continue
        if options.check:
            wrong += [f"{path.name}: {said}" for said in differences(kept, now)]
        else:
            text = nbformat.writes(now) + "\n"
            if len(text) > LARGEST:
                wrong.append(f"{path.name}: {len(text):,} bytes, of {LARGEST:,} at most")
            path.write_text(text, encoding="utf-8")
            print(f"{path.name}: {len(text):,} bytes")
    for line in wrong:
        print(line, file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
