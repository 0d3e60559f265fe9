"""How many samples a deep EXR says that it has, before any memory is taken for them.

OpenEXR reads a file whole and believes its header. Here only the headers, the tables of offsets and
the heads of the chunks are looked at, as the OpenEXR file layout has them
(https://openexr.com/en/latest/OpenEXRFileLayout.html).
"""

from __future__ import annotations

import dataclasses
import struct
import zlib
from pathlib import Path
from typing import BinaryIO

import numpy as np

from .aovs import MOST_AOVS

MULTIPART = 0x1000
"""Bit of the version field: several parts, each with a header; an empty one ends them."""

DEFLATE_RATIO = 1032
"""Deflate, the compression of these files, never makes data smaller by a larger factor."""

MOST_PARTS = 16
"""Parts of a file that are looked at; this package writes one or two."""

LONGEST_NAME = 255
"""Most characters of the name of an attribute or of its type."""

MOST_CHANNELS = 32 + MOST_AOVS
"""Channels of a part; this package writes ten to twenty beside AOVs."""

USUAL_CHANNELS = 12
"""Channels with which the following two numbers are enough; more take more, as many as they are."""

BYTES_PER_PIXEL = 256
"""Memory that a pixel takes while its file is read, also without samples (71 were measured
in the library, with eleven channels, and this package's tables come on top)."""

BYTES_PER_FULL_PIXEL = 2816
"""The same for a pixel with samples, which has an array in each channel (2715 measured)."""

COPIES = 4
"""How often the samples are in memory while they are read: in the library, by pixel, joined."""

BYTES_PER_NAME = 512
"""Memory for each text of a manifest and again for each id, beside the characters (670 were
measured for both)."""

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
    ``channels``                  of each sample
    ``names``                     bytes of memory for the names in its manifest of ids
    ============================  ==========================================================
    """

    pixels: int
    chunks: int
    unpacked: int
    channels: int
    names: int

    @property
    def memory(self) -> int:
        """Bytes of memory that the part takes while it is read."""
        # No pixel with samples has less than four bytes.
        full = min(self.pixels, self.unpacked // 4)
        pixels = self.pixels * BYTES_PER_PIXEL + full * BYTES_PER_FULL_PIXEL
        more = max(self.channels, USUAL_CHANNELS)
        return pixels * more // USUAL_CHANNELS + self.unpacked * COPIES + self.names


def require_bounded(path: Path) -> None:
    """Raise ``ValueError`` unless the memory for a deep EXR goes with the file's own size.

    At most ``ALWAYS_ALLOWED``, or ``MEMORY_PER_BYTE`` times the size of the file. Raises
    ``ValueError``, too, for a file whose layout is not that of a deep EXR of scan lines, and
    ``OSError`` for one that cannot be read.
    """
    size, parts = path.stat().st_size, parts_of(path)
    needed = sum(part.memory for part in parts)
    if needed > allowed_memory(size):
        raise ValueError(
            f"its data window of {sum(part.pixels for part in parts):,} pixels, "
            f"{sum(part.unpacked for part in parts):,} bytes of samples, and names of surfaces, "
            f"would take {needed / 1e6:,.0f} MB, which a file of {size:,} bytes does not justify"
        )


def allowed_memory(size: int) -> int:
    """Bytes of memory that a file of so many bytes may take."""
    return max(ALWAYS_ALLOWED, size * MEMORY_PER_BYTE)


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
    headers: list[_Header] = []
    while len(headers) <= MOST_PARTS:
        header = _header(file, size)
        if header.values:
            headers.append(header)
        if not header.values or not version & MULTIPART:
            break
    if not 0 < len(headers) <= MOST_PARTS:
        raise ValueError(f"it has {len(headers)} parts, or more: must have 1 to {MOST_PARTS}")
    areas, counts = [], []
    for i, header in enumerate(headers):
        if header.values.get("type") != b"deepscanline":
            raise ValueError(
                f"does not hold point samples: part {i} must be of type deepscanline, as in a deep "
                "EXR that PointSamples.save wrote"
            )
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
        Part(
            area,
            chunks,
            sum(_unpacked(file, start, version, size) for start in starts),
            header.channels,
            header.names,
        )
        for area, chunks, starts, header in zip(areas, counts, offsets, headers, strict=True)
    ]


@dataclasses.dataclass
class _Header:
    """The starts of a part's attributes, its channels, and the memory for its names."""

    values: dict[str, bytes] = dataclasses.field(default_factory=dict)
    channels: int = 0
    names: int = 0


def _header(file: BinaryIO, size: int) -> _Header:
    """What a part's header says; it has no values where the headers end."""
    header = _Header()
    while name := _name(file):
        kind = _name(file)
        (length,) = _numbers(file, "<i")
        start = file.tell()
        if not 0 <= length <= size - start or name in header.values:
            raise ValueError("is truncated or damaged")
        header.values[name] = file.read(min(length, 64))
        file.seek(start)
        if kind == "chlist":
            header.channels += _channels(file, start + length)
        elif kind == "idmanifest":
            header.names += _names(file.read(length), size)
        file.seek(start + length)
    return header


def _channels(file: BinaryIO, end: int) -> int:
    """How many channels are in a list of them that ends there."""
    count = 0
    while file.tell() < end and _name(file):
        file.seek(16, 1)
        count += 1
        if count > MOST_CHANNELS:
            raise ValueError(f"it has more than {MOST_CHANNELS} channels in a part")
    return count


def _names(value: bytes, size: int) -> int:
    """Bytes of memory for a manifest of ids, which names one group of them, in a file of ``size``.

    OpenEXR packs it, and in it a name only says how it goes on from the one before, and an id only
    which name it has. So a few bytes may become very many.
    """
    if len(value) < 8:
        raise ValueError("is truncated or damaged")
    (unpacked,), packed = struct.unpack_from("<Q", value), value[8:]
    if unpacked > DEFLATE_RATIO * len(packed):
        raise ValueError("is truncated or damaged")
    _require_names(unpacked * COPIES, size)
    try:
        data = zlib.decompressobj().decompress(packed, unpacked + 1)
    except zlib.error as error:
        raise ValueError("is truncated or damaged") from error
    if len(data) != unpacked:
        raise ValueError("is truncated or damaged")
    return unpacked * COPIES + _Manifest(data).memory(size)


def _require_names(needed: int, size: int) -> None:
    if needed > allowed_memory(size):
        raise ValueError(
            f"its names of surfaces would take {needed / 1e6:,.0f} MB or more, which a file of "
            f"{size:,} bytes does not justify"
        )


class _Manifest:
    """An unpacked manifest of ids, read from its start."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def memory(self, size: int) -> int:
        """Bytes of memory for its names by id; ``ValueError`` for too many for the file."""
        if self._number("<I") != 0:
            raise ValueError("its names of surfaces are not of version 0")
        lengths = self._lengths(size)
        needed = len(lengths) * BYTES_PER_NAME
        for i, length in enumerate(lengths):
            text = self._skip(length)
            if i:  # It starts with how many characters it has in common with the one before.
                head = 2 if lengths[i - 1] > 255 else 1
                common = int.from_bytes(text[:head], "big")
                if length < head or common > lengths[i - 1]:
                    raise ValueError("is truncated or damaged")
                lengths[i] = common + length - head
            needed += lengths[i]
        _require_names(needed, size)
        by_rank = self._by_rank(lengths)
        if self._number("<I") != 1:
            raise ValueError("its names of surfaces are not of one group of ids")
        for most in (len(self.data), 1):  # the channels with these ids, what an id stands for
            texts = self._lengths(size)
            if len(texts) > most:
                raise ValueError("its ids of surfaces stand for more than a name")
            self._skip(sum(texts))
            needed += len(texts) * BYTES_PER_NAME
        self._skip(1)
        for _ in range(2):
            self._skip(self._number("<I"))
        width = {0: 8, 1: 4}.get(self._number("<B"))
        for _ in range(self._number("<I")):
            if width is None:
                self._variable()
            else:
                self._skip(width)
            rank = self._variable() if texts else None
            if rank is not None and rank >= len(by_rank):
                raise ValueError("is truncated or damaged")
            needed += BYTES_PER_NAME + (0 if rank is None else int(by_rank[rank]) * COPIES)
            _require_names(needed, size)
        return needed

    def _by_rank(self, lengths: list[int]) -> np.ndarray:
        """Lengths of the texts in the order in which ids count them, a list of ranges."""
        count = self._number("<I")
        if count > len(lengths):
            raise ValueError("is truncated or damaged")
        fresh, order = np.ones(len(lengths), dtype=bool), []
        for _ in range(count):
            first, last = self._number("<I"), self._number("<I")
            if not first <= last < len(lengths):
                raise ValueError("is truncated or damaged")
            order.append(first + np.flatnonzero(fresh[first : last + 1]))
            fresh[first : last + 1] = False
        if fresh.any():
            raise ValueError("is truncated or damaged")
        sizes = np.array(lengths, dtype=np.int64)
        return sizes[np.concatenate(order)] if order else sizes

    def _lengths(self, size: int) -> list[int]:
        """The lengths with which a list of texts starts."""
        count = self._number("<I")
        if count > len(self.data) - self.at:
            raise ValueError("is truncated or damaged")
        _require_names(count * BYTES_PER_NAME, size)
        return [self._variable() for _ in range(count)]

    def _variable(self) -> int:
        """A number in bytes of seven bits each, the lowest first."""
        number = 0
        for shift in range(0, 64, 7):
            byte = self._number("<B")
            number |= (byte & 127) << shift
            if byte < 128:
                return number
        raise ValueError("is truncated or damaged")

    def _number(self, layout: str) -> int:
        (number,) = struct.unpack(layout, self._skip(struct.calcsize(layout)))
        return int(number)

    def _skip(self, count: int) -> bytes:
        """The first bytes of the next so many."""
        start, self.at = self.at, self.at + count
        if self.at > len(self.data):
            raise ValueError("is truncated or damaged")
        return self.data[start : min(self.at, start + 8)]


def _attribute(header: _Header, name: str, length: int) -> bytes:
    """The bytes of an attribute of that length."""
    value = header.values.get(name, b"")
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
