"""Files of pictures as channels and attributes, by OpenImageIO; nothing in them is trusted."""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from .._files import require_readable
from .._image import DESCRIPTION, attributes_described

MOST_CHANNELS = 1024
"""Channels of all parts of a file together, at most."""

MOST_PARTS = 256
"""Parts of a file, at most."""

ALWAYS_ALLOWED = 1 << 28
"""Bytes of memory that the channels of any file may take."""

MEMORY_PER_BYTE = 4096
"""The same for each byte of a file."""

LONGEST_TEXT = 300
"""Characters of what a library says of an error, at most."""

GAMMA = (".png", ".jpg", ".jpeg", ".bmp", ".gif", ".webp")
"""Names of files whose whole numbers are sRGB, and whose colours are not multiplied by alpha."""


@dataclasses.dataclass(frozen=True)
class PicturePart:
    """A part of a file, of which nothing has been unpacked.

    ``name`` is empty where it is the only one. ``box`` is (left, top, width, height) of its pixels,
    ``film`` that of the whole picture; ``channels`` are their names, ``kinds`` their types, such as
    ``half`` or ``uint16``.
    """

    number: int
    name: str
    box: tuple[int, int, int, int]
    film: tuple[int, int, int, int]
    channels: tuple[str, ...]
    kinds: tuple[str, ...]
    deep: bool
    attributes: dict[str, Any]

    @property
    def nbytes(self) -> int:
        """Memory in bytes of its channels as float32."""
        return self.box[2] * self.box[3] * len(self.channels) * 4


class PictureFile:
    """A file of a picture, whose headers have been read.

    Raises ``FileNotFoundError`` or another ``OSError`` where there is none, and ``ValueError`` for
    one that OpenImageIO cannot read, or whose pixels need more memory than its size justifies. Both
    name the file.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = require_readable(path)
        self.parts = self._parts()
        needed = sum(part.nbytes for part in self.parts if not part.deep)
        size = self.path.stat().st_size
        if needed > max(ALWAYS_ALLOWED, size * MEMORY_PER_BYTE):
            raise ValueError(
                f"{self.path}: its pixels would take {needed / 1e6:,.0f} MB, which a file of "
                f"{size:,} bytes does not justify"
            )
        if sum(len(part.channels) for part in self.parts) > MOST_CHANNELS:
            raise ValueError(f"{self.path}: has more than {MOST_CHANNELS} channels")

    @property
    def is_gamma(self) -> bool:
        """Whether its whole numbers are sRGB, and its alpha has not been multiplied with."""
        return self.path.suffix.lower() in GAMMA

    @contextlib.contextmanager
    def _opened(self) -> Iterator[Any]:
        import OpenImageIO as oiio

        how = oiio.ImageSpec()
        how.attribute("oiio:UnassociatedAlpha", 1)
        try:
            opened = oiio.ImageInput.open(str(self.path), how)
            if opened is None:
                said = first_line(oiio.geterror())
                raise ValueError(f"{self.path}: is not a picture that can be read: {said}")
            try:
                yield opened
            finally:
                opened.close()
        except UnicodeError as error:
            raise ValueError(f"{self.path}: has names that are no text: {error}") from error

    def _parts(self) -> list[PicturePart]:
        found: list[PicturePart] = []
        with self._opened() as opened:
            while opened.seek_subimage(len(found), 0):
                found.append(_part(len(found), opened.spec()))
                if len(found) > MOST_PARTS:
                    raise ValueError(f"{self.path}: has more than {MOST_PARTS} parts")
        return [dataclasses.replace(found[0], name="")] if len(found) == 1 else found

    def channels(self, part: PicturePart, names: Sequence[str]) -> np.ndarray:
        """Some channels of a part, (height, width, n): float32, or whole numbers as they are.

        Raises ``ValueError`` where they cannot be read.
        """
        index = [part.channels.index(name) for name in names]
        kinds = {part.kinds[i] for i in index}
        kind = kinds.pop() if len(kinds) == 1 else "float"
        wanted = kind if kind.startswith(("uint", "int")) else "float"
        first, last = min(index), max(index) + 1
        with self._opened() as opened:
            values = opened.read_image(part.number, 0, first, last, wanted)
            if values is None:
                said = first_line(opened.geterror())
                raise ValueError(f"{self.path}: is truncated or damaged: {said}")
        values = np.asarray(values).reshape(part.box[3], part.box[2], last - first)
        return values[..., [i - first for i in index]]


def _part(number: int, spec: Any) -> PicturePart:
    attributes = {attribute.name: attribute.value for attribute in spec.extra_attribs}
    kinds = [str(kind) for kind in spec.channelformats] or [str(spec.format)] * spec.nchannels
    return PicturePart(
        number,
        str(spec.getattribute("oiio:subimagename") or spec.getattribute("name") or ""),
        (spec.x, spec.y, spec.width, spec.height),
        (spec.full_x, spec.full_y, spec.full_width, spec.full_height),
        tuple(spec.channelnames),
        tuple(kinds),
        bool(spec.deep),
        {**attributes_described(attributes.get(DESCRIPTION)), **attributes},
    )


def first_line(text: str) -> str:
    """What a library says, in a line; it may say a lot, and nothing."""
    lines = text.strip().splitlines()
    return lines[0][:LONGEST_TEXT] if lines else "of an unknown form"
