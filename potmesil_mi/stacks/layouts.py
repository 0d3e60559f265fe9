"""Layouts: by what names and in which form the files of a stack are written.

``plain`` is our own. ``fod500`` is that of the data set of DefocusNet (Maximov, Galim and
Leal-Taixé, "Focus on Defocus", CVPR 2020), as the readers in these repositories of GitHub have it:
``dvl-tum/defocus-net`` (``source/util_func.py``), ``fuy34/DFV`` (``dataloader/FoD500.py``) and
``sleekEagle/defocus_camind`` (``source/dataloaders/focalblender.py``). They list one folder, sort
names that end in ``All.tif`` and ``Dpt.exr`` (the last ``Aif.tif``, too), take the first six
characters for the number of the stack, and read the depth as the channel R of an EXR in half
precision that has R, G and B, in metres.
"""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from .._files import require_suffix
from .._image import PICTURES, write_maps, write_picture
from ..animation.frames import PLACE, FrameFiles

LayoutName = Literal["plain", "fod500"]
"""How files are named; see the head of this module."""

LAYOUTS: tuple[LayoutName, ...] = get_args(LayoutName)
"""The layouts by their names, the default first."""

STACK = "stack.json"
"""Name of the file that describes a stack, of ``plain``."""

NUMBER = re.compile(r"\d{6}")
"""How names of a stack begin in ``fod500``."""

TIFF = ".tif"
WIDEST = 2
"""Digits of the number of a picture in ``fod500``, at least."""


@dataclasses.dataclass(frozen=True)
class StackFiles:
    """The files of a stack.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``pictures``                  patterns of the pictures, with a place for the number such as
                                  ``{:04d}``
    ``circles``, ``described``    patterns of the maps of circles, and of what is told of each
                                  picture
    ``stack``                     what is told of all of them
    ``depth``, ``normals``,       maps of what the pinhole sees, and its picture, all in focus
    ``pinhole``
    ``layout``                    by whose names; in ``fod500`` depth is in metres in R, G and B,
                                  and in half precision, in place of scene units in ``Z``, and
                                  pictures have no alpha
    ``form``                      how :func:`potmesil_mi._image.write_picture` keeps pictures
    ============================  ==========================================================
    """

    pictures: tuple[str, ...]
    circles: str
    described: str
    stack: str
    depth: str
    normals: str
    pinhole: str
    layout: LayoutName = "plain"
    form: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def frames(self) -> FrameFiles:
        """The files of the pictures by their numbers."""
        form: Any = self.form
        return FrameFiles(self.pictures, **form)

    @property
    def folder(self) -> Path:
        """Where ``stack`` is, from where on the files are told in it."""
        return Path(self.stack).parent

    def told(self, path: str | Path) -> str:
        """How the files tell of a ``path``: from the folder of ``stack`` on, with slashes."""
        return Path(os.path.relpath(path, self.folder)).as_posix()


def plain_files(patterns: Sequence[str], form: Mapping[str, Any] | None = None) -> StackFiles:
    """Files by the names ``patterns`` of the pictures, such as ``out/{:04d}.exr``.

    What is told of each picture is beside that of the first pattern, and what there is of all of
    them in the first folder whose name has no number. Raises ``ValueError`` for other patterns.
    """
    if not patterns:
        raise ValueError("output: must be given, such as out/{:04d}.exr")
    FrameFiles(patterns)  # raises for patterns that are none
    first = Path(patterns[0])
    require_suffix(first, PICTURES)
    folder = first.parent
    while PLACE.search(str(folder)):
        folder = folder.parent
    for pattern in patterns:
        if not Path(pattern).is_relative_to(folder):
            raise ValueError(f"output={pattern!r}: must be in {folder}, where {STACK} will be")
    return StackFiles(
        tuple(patterns),
        circles=str(first.with_suffix(".coc.exr")),
        described=str(first.with_suffix(".json")),
        form=form or {},
        **shared_files(folder),
    )


def shared_files(folder: Path, own: Path | None = None) -> dict[str, Any]:
    """The files of all pictures in a ``folder``, and ``stack`` in its ``own`` if it has one."""
    return {
        "stack": str((own or folder) / STACK),
        "depth": str(folder / "depth.exr"),
        "normals": str(folder / "normals.exr"),
        "pinhole": str(folder / "pinhole.exr"),
    }


def fod500_files(output: str, count: int) -> StackFiles:
    """Files of the stack whose names begin with ``output``, such as ``fod/000012``.

    Raises ``ValueError`` unless that ends in a folder and a number of six digits.
    """
    if not NUMBER.fullmatch(Path(output).name):
        raise ValueError(
            f"output={output!r}: must end in a number of six digits for the layout fod500, such as "
            "fod/000012"
        )
    number = f"{output}_{{:0{max(WIDEST, len(str(count - 1)))}d}}"
    return StackFiles(
        (f"{number}All{TIFF}",),
        circles=f"{number}Coc.exr",
        described=f"{number}.json",
        stack=f"{output}.json",
        depth=f"{output}Dpt.exr",
        normals=f"{output}Nrm.exr",
        pinhole=f"{output}Aif{TIFF}",
        layout="fod500",
        form={"bit_depth": "8"},
    )


def write_formed(image: np.ndarray, index: int, files: StackFiles, said: dict[str, Any]) -> None:
    """Write the picture of that number."""
    files.frames().write(index, image[..., :3] if files.layout == "fod500" else image, said)


def write_pinhole(image: np.ndarray, files: StackFiles, said: dict[str, Any]) -> None:
    """Write the picture of the pinhole, (H, W, 3)."""
    form: Any = files.form if files.layout == "fod500" else {}
    write_picture(image, files.pinhole, said, **form)


def write_depth(
    depth: np.ndarray, files: StackFiles, said: dict[str, Any], millimeters_per_unit: float
) -> None:
    """Write the map of depths, (H, W) in scene units."""
    if files.layout == "fod500":
        metres = depth * np.float32(millimeters_per_unit / 1000)
        write_maps(dict.fromkeys("RGB", metres), files.depth, said, half=True)
    else:
        write_maps({"Z": depth}, files.depth, said)
