"""How many samples a deep EXR says that it has, before any memory is taken for them.

OpenEXR reads a file whole and believes its header. Here only the headers, the tables of offsets and
the heads of the chunks are looked at, as the OpenEXR file layout has them
(https://openexr.com/en/latest/OpenEXRFileLayout.html).
"""

from __future__ import annotations

import dataclasses
import struct
from pathlib import Path
from typing import BinaryIO

MULTIPART = 0x1000
"""Bit of the version field: several parts, each with a header; an empty one ends them."""

DEFLATE_RATIO = 1032
"""Deflate, the compression of these files, never makes data smaller by a larger factor."""

MOST_PARTS = 16
"""Parts of a file that are looked at; this package writes one or two."""

LONGEST_NAME = 255
"""Most characters of the name of an attribute or of its type."""

BYTES_PER_PIXEL = 256
"""Memory that a pixel takes while its file is read, also without samples (71 were measured
in the library, with eleven channels, and this package's tables come on top)."""

BYTES_PER_FULL_PIXEL = 2816
"""The same for a pixel with samples, which has an array in each channel (2715 measured)."""

COPIES = 4
"""How often the samples are in memory while they are read: in the library, by pixel, joined."""

ALWAYS_ALLOWED = 1 << 28
"""Bytes of memory that any file may take."""

MEMORY_PER_BYTE = 4096
"""Bytes of memory that each byte of a file may take. A picture of one colour, whose samples
compress best, takes about 3700."""


@dataclasses.dataclass(frozen=True)
class Part:
    """The size of one part of a deep EXR.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``pixels``                    of its data window
    ``chunks``                    rows of pixels that are stored together
    ``unpacked``                  bytes of all its samples, not compressed
    ============================  ==========================================================
    """

    pixels: int
    chunks: int
    unpacked: int


def require_bounded(path: Path) -> None:
    """Raise ``ValueError`` unless the memory for a deep EXR goes with the file's own size.

    At most ``ALWAYS_ALLOWED``, or ``MEMORY_PER_BYTE`` times the size of the file. Raises
    ``ValueError``, too, for a file whose layout is not that of a deep EXR of scan lines, and
    ``OSError`` for one that cannot be read.
    """
    size, parts = path.stat().st_size, parts_of(path)
    needed = sum(
        part.pixels * BYTES_PER_PIXEL
        # A sample has twelve channels or less, of four bytes; no pixel with samples has less.
        + min(part.pixels, part.unpacked // 4) * BYTES_PER_FULL_PIXEL
        + part.unpacked * COPIES
        for part in parts
    )
    allowed = max(ALWAYS_ALLOWED, size * MEMORY_PER_BYTE)
    if needed > allowed:
        raise ValueError(
            f"its data window of {sum(part.pixels for part in parts):,} pixels, and "
            f"{sum(part.unpacked for part in parts):,} bytes of samples, would take "
            f"{needed / 1e6:,.0f} MB, which a file of {size:,} bytes does not justify"
        )


def parts_of(path: Path) -> list[Part]:
    """The sizes of the parts of a deep EXR, which its headers and its chunks say.

    Raises ``ValueError`` for another layout, ``OSError`` for a file that cannot be read.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        return _parts(file, size)


def _parts(file: BinaryIO, size: int) -> list[Part]:
    """The sizes of the parts of a file of so many bytes."""
    _, version = _numbers(file, "<II")
    headers: list[dict[str, bytes]] = []
    while len(headers) <= MOST_PARTS:
        header = _header(file, size)
        if header:
            headers.append(header)
        if not header or not version & MULTIPART:
            break
    if not 0 < len(headers) <= MOST_PARTS:
        raise ValueError(f"it has {len(headers)} parts, or more: must have 1 to {MOST_PARTS}")
    areas, counts = [], []
    for header in headers:
        left, top, right, bottom = struct.unpack("<4i", _attribute(header, "dataWindow", 16))
        width, height = right - left + 1, bottom - top + 1
        (chunks,) = struct.unpack("<i", _attribute(header, "chunkCount", 4))
        if width < 1 or height < 1 or not 0 < chunks <= height:
            raise ValueError(f"its data window has {width}x{height} pixels in {chunks} chunks")
        areas.append(width * height)
        counts.append(chunks)
    if file.tell() + 8 * sum(counts) > size:
        raise ValueError("is truncated or damaged")
    offsets = [_numbers(file, f"<{chunks}Q") for chunks in counts]
    return [
        Part(area, chunks, sum(_unpacked(file, start, version, size) for start in starts))
        for area, chunks, starts in zip(areas, counts, offsets, strict=True)
    ]


def _header(file: BinaryIO, size: int) -> dict[str, bytes]:
    """The attributes of a part, without those that are large; none where the headers end."""
    attributes = {}
    while name := _name(file):
        _name(file)
        (length,) = _numbers(file, "<i")
        start = file.tell()
        if not 0 <= length <= size - start:
            raise ValueError("is truncated or damaged")
        attributes[name] = file.read(min(length, 64))
        file.seek(start + length)
    return attributes


def _attribute(header: dict[str, bytes], name: str, length: int) -> bytes:
    """The bytes of an attribute of that length."""
    value = header.get(name, b"")
    if len(value) != length:
        raise ValueError(f"its header has no {name} of {length} bytes, as a deep EXR must")
    return value


def _unpacked(file: BinaryIO, start: int, version: int, size: int) -> int:
    """Bytes of the samples of a chunk."""
    file.seek(min(start + (4 if version & MULTIPART else 0), size))
    _, table, packed, unpacked = _numbers(file, "<iQQQ")
    if table > size or packed > size or unpacked > DEFLATE_RATIO * packed:
        raise ValueError("is truncated or damaged")
    return unpacked


def _numbers(file: BinaryIO, layout: str) -> tuple[int, ...]:
    data = file.read(struct.calcsize(layout))
    if len(data) < struct.calcsize(layout):
        raise ValueError("is truncated or damaged")
    return struct.unpack(layout, data)


def _name(file: BinaryIO) -> str:
    """A text that a zero byte ends."""
    start = file.tell()
    name, end, _ = file.read(LONGEST_NAME + 1).partition(b"\0")
    if not end:
        raise ValueError("is truncated or damaged")
    file.seek(start + len(name) + 1)
    return name.decode("latin-1")
