"""The plan of a stack: which pictures there are to be, through what lens and in which files.

A plan is data, which goes through JSON. :class:`.forming.Forming` does one item after the other;
``form`` and ``write`` of it do one, which may as well be in another process, or on another machine,
that has the samples.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from .._files import in_json, require_writable
from ..optics.lens import ThinLens
from ..optics.telecentric import TYPE, TelecentricLens
from .foci import Lens
from .layouts import StackFiles

FORMAT = "potmesil stack"
"""What the file that tells of a stack says of its form."""


@dataclasses.dataclass(frozen=True)
class StackItem:
    """A picture that is to be: its number in the stack, and its lens."""

    index: int
    lens: Lens

    def to_dict(self) -> dict[str, Any]:
        """The item as JSON has it."""
        values: dict[str, Any] = in_json({"index": self.index, "lens": self.lens.to_dict()})
        return values

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> StackItem:
        """The inverse of :meth:`to_dict`."""
        told = {
            name: float(one) if one in ("inf", "-inf") else one
            for name, one in values["lens"].items()
        }
        kind = TelecentricLens if told.get("type") == TYPE else ThinLens
        return cls(values["index"], kind.from_dict(told))


@dataclasses.dataclass(frozen=True)
class StackPlan:
    """All pictures of a stack, and how they are formed.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``items``                     a :class:`StackItem` for each picture
    ``files``                     where they are written
    ``how``                       what the samples are of, in ``source``, and how pictures are
                                  formed, as it is told; where it changes pictures are made anew
    ``maps``                      which maps there are: ``depth``, ``circles``, ``normals``; and
                                  ``pinhole``, the picture of the pinhole
    ``extra``                     what else is told of the stack
    ============================  ==========================================================
    """

    items: Sequence[StackItem]
    files: StackFiles
    how: Mapping[str, Any]
    maps: frozenset[str] = frozenset()
    extra: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    @classmethod
    def of(cls, lenses: Iterable[Lens], files: StackFiles, **fields: Any) -> StackPlan:
        """The plan of pictures through ``lenses``, in order."""
        items = [StackItem(index, lens.plain()) for index, lens in enumerate(lenses)]
        return cls(items, files, **fields)

    def to_dict(self) -> dict[str, Any]:
        """The plan as JSON has it."""
        values: dict[str, Any] = in_json(
            {
                **{field.name: getattr(self, field.name) for field in dataclasses.fields(self)},
                "items": [item.to_dict() for item in self.items],
                "files": dataclasses.asdict(self.files),
                "maps": sorted(self.maps),
            }
        )
        return values

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> StackPlan:
        """The inverse of :meth:`to_dict`."""
        files = {**values["files"], "pictures": tuple(values["files"]["pictures"])}
        return cls(
            **{
                **values,
                "items": [StackItem.from_dict(one) for one in values["items"]],
                "files": StackFiles(**files),
                "maps": frozenset(values["maps"]),
            }
        )

    def paths(self, item: StackItem) -> list[Path]:
        """The files of an item, the one that tells of it last."""
        pictures, circles, described = self.files_of(item)
        return [*pictures, *([circles] if circles else []), described]

    def files_of(self, item: StackItem) -> tuple[list[Path], Path | None, Path]:
        """The pictures of an item, its map of circles if there is to be one, and what is told."""
        circles, described = (
            Path(pattern.format(item.index))
            for pattern in (self.files.circles, self.files.described)
        )
        pictures = self.files.frames().of(item.index)
        return pictures, circles if "circles" in self.maps else None, described

    def map_paths(self) -> dict[str, Path]:
        """The files of what there is once for all pictures, by the names of ``maps``."""
        names = ("depth", "normals", "pinhole")
        return {name: Path(getattr(self.files, name)) for name in names if name in self.maps}

    def told_of(self, item: StackItem) -> dict[str, Any]:
        """What says by which lens and how a picture is formed: if it changes, another is made."""
        told: dict[str, Any] = {**item.to_dict(), **in_json(self.how)}
        return told

    def is_done(self, item: StackItem) -> bool:
        """Whether an item is finished: all its files are there, and tell of this very picture."""
        paths = self.paths(item)
        if not all(path.is_file() for path in paths):
            return False
        there, asked = read_json(paths[-1]), self.told_of(item)
        return {name: there.get(name) for name in asked} == asked

    def to_do(self, chosen: Iterable[int], overwrite: bool = False) -> list[StackItem]:
        """Those of the ``chosen`` items, by their numbers, that are not done."""
        items = [self.items[index] for index in chosen]
        return items if overwrite else [item for item in items if not self.is_done(item)]

    @property
    def lacks_maps(self) -> bool:
        """Whether something of what there is once for all pictures is not there."""
        return not all(
            path.is_file() for path in (*self.map_paths().values(), Path(self.files.stack))
        )

    def check(self, sources: Iterable[str]) -> None:
        """Find out before the first picture that one cannot be written, or would replace a source.

        Another stack must not be in the folder, whose ``stack`` would be lost. Raises what
        :func:`potmesil_mi._files.require_writable` does, and ``ValueError``.
        """
        self.files.frames().check((item.index for item in self.items), sources)
        kept = {Path(source).resolve(): source for source in sources}
        own = [path for item in self.items for path in self.paths(item)[1:]]
        for path in [*own, *self.map_paths().values(), Path(self.files.stack)]:
            if path.resolve() in kept:
                raise ValueError(
                    f"{kept[path.resolve()]}: a file of the stack must not take its place"
                )
        for path in (*self.map_paths().values(), Path(self.files.stack)):
            require_writable(path, (path.suffix,))
        first = self.files.told(self.paths(self.items[0])[0])
        told = read_json(Path(self.files.stack))
        if told and told.get("format") != FORMAT:
            raise ValueError(
                f"{self.files.stack}: is not of a stack, and must not be lost; write the pictures "
                "to another folder"
            )
        others = told.get("pictures") or [{}]
        files = others[0].get("files", [first]) if isinstance(others[0], dict) else [first]
        if first not in files:
            raise ValueError(
                f"{self.files.stack}: is of other pictures, such as {files[0]}; write these to "
                "another folder"
            )


def read_json(path: Path) -> dict[str, Any]:
    """The object in a file of JSON; without anything in it where there is none."""
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return values if isinstance(values, dict) else {}
