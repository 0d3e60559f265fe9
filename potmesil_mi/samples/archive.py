"""Point samples as archives of compressed columns, which end in ``.samples``.

They are ZIP files whose entries are stored as they are, each with its checksum. Five are JSON
texts: ``camera.json``, ``lens.json`` and ``samples.json`` as in deep EXR, ``window.json``, the
pixels of the film that were sampled, and ``surfaces.json``, the names of ids. Each of the others
is a column, named after its field in ``Columns``, of every sample in turn, bit for bit and in the
same order; ``columns.json`` tells their types, little endian, and shapes, as NumPy does.

A column is cut in frames of ``FRAME`` samples (the last may have fewer), one right after the other.
Each is a frame of Blosc 1 (https://github.com/Blosc/c-blosc): bits of equal weight stand
together, where they are mostly equal, and LZ4 packs them, or Zstandard where it makes less.

What is in a file is not trusted: nothing in it is executed, and memory is taken only as its size
justifies.
"""

from __future__ import annotations

import json
import math
import struct
import zipfile
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numcodecs import blosc

from .._validation import require_whole, shown
from .columns import COLUMNS, Columns, is_optional, shape_of
from .header import TEXTS, Header, json_object
from .raster import Window

VERSION = 1
"""Of the files that are written."""

FRAME = 1 << 18
"""Samples of a column that are packed together."""

LEVEL = 1
"""Compression level. Higher ones pack noise no better, and RGB worse."""

ZSTD_COLUMNS = ("x", "z", "weight")
"""Columns of which Zstandard makes less than LZ4, in hardly more time."""

MOST_RATIO = 255
"""No frame is smaller by a larger factor: LZ4 cannot, and Zstandard is not used where it does."""

FRAME_HEADER = struct.Struct("<3xBIII")
"""Of a frame of Blosc: bytes of a sample, bytes unpacked, bytes of a block, bytes packed."""

MOST_SAMPLES = 1 << 40
"""More than any memory holds."""

MOST_ID = (1 << 32) - 1
"""Largest id of a surface."""

TEXT = "{}.json"
"""Names of the entries that are JSON."""


# ---------------------------------------------------------------- writing


def write(path: Path, header: Header, columns: Columns) -> None:
    """Write samples to an archive."""
    _require_surfaces(header.surfaces)
    texts = {
        **header.texts(VERSION),
        "window": json.dumps(header.window._asdict()),
        "surfaces": json.dumps({str(surface): name for surface, name in header.surfaces.items()}),
        "columns": json.dumps(_schema(columns.present(), len(columns), len(header.aov_names))),
    }
    with ThreadPoolExecutor() as pool, zipfile.ZipFile(path, "w") as archive:
        packed = {
            field.name: [
                pool.submit(_pack, field.name, rows[start : start + FRAME])
                for start in range(0, len(columns), FRAME)
            ]
            for field in columns.present()
            for rows in [_little_endian(getattr(columns, field.name))]
        }
        for name, text in texts.items():
            archive.writestr(zipfile.ZipInfo(TEXT.format(name)), text)
        for name, futures in packed.items():
            frames = [future.result() for future in futures]
            entry = zipfile.ZipInfo(name)
            entry.file_size = sum(map(len, frames))
            with archive.open(entry, "w") as file:
                for frame in frames:
                    file.write(frame)


def _schema(fields: list[Any], count: int, aovs: int) -> dict[str, Any]:
    """Types and shapes of columns of ``count`` samples, by their names, for JSON."""
    return {
        field.name: {
            "dtype": np.dtype(field.metadata["dtype"]).newbyteorder("<").str,
            "shape": list(shape_of(field, count, aovs)),
        }
        for field in fields
    }


def _little_endian(column: np.ndarray) -> np.ndarray:
    return column.astype(column.dtype.newbyteorder("<"), copy=False)


def _pack(name: str, rows: np.ndarray) -> bytes:
    """A frame of some samples of the column of a ``name``."""
    # One void value for each sample: the bits of all its channels are parted.
    whole = rows.view(np.dtype((np.void, rows[0].nbytes)))
    packed: bytes
    if name in ZSTD_COLUMNS:
        packed = blosc.compress(whole, b"zstd", LEVEL, blosc.BITSHUFFLE)
        if whole.nbytes <= MOST_RATIO * len(packed):
            return packed
    packed = blosc.compress(whole, b"lz4", LEVEL, blosc.BITSHUFFLE)
    return packed


# ---------------------------------------------------------------- reading


def read(path: Path) -> tuple[Header, Columns]:
    """What :func:`write` wrote. See ``files.read``; errors do not name the file.

    Raises ``ValueError`` for a file that is no archive of samples, is truncated or damaged, or
    whose columns are not those of ``Columns``, and whatever ``zipfile`` makes of it.
    """
    if not zipfile.is_zipfile(path):
        raise ValueError("is not an archive of samples, or is truncated")
    with zipfile.ZipFile(path) as archive, ThreadPoolExecutor() as pool:
        entries = _entries(archive, path.stat().st_size)
        header = _header(archive, entries)
        columns: dict[str, np.ndarray] = {}
        jobs: list[Future[Any]] = []
        described = _described(archive, entries, len(header.aov_names))
        for name, (dtype, shape) in described.items():
            packed = archive.read(entries.pop(name))
            if math.prod(shape) * dtype.itemsize > MOST_RATIO * len(packed):
                raise ValueError(f"is truncated or damaged: its column {name} is too short")
            columns[name] = np.empty(shape, dtype)
            jobs += _unpack(packed, columns[name], pool)
        if entries:
            raise ValueError(f"holds {next(iter(entries))[:80]!r}, which is not of this version")
        for job in jobs:
            job.result()
    return header, Columns(**columns)


def _entries(archive: zipfile.ZipFile, size: int) -> dict[str, zipfile.ZipInfo]:
    """The entries by their names, of an archive of ``size`` bytes; all of them are stored."""
    entries: dict[str, zipfile.ZipInfo] = {}
    for entry in archive.infolist():
        packed = entry.compress_type != zipfile.ZIP_STORED or entry.file_size != entry.compress_size
        if packed or entry.file_size > size or entry.filename in entries:
            raise ValueError(
                f"is damaged: its entry {entry.filename[:80]!r} is not stored once, as is"
            )
        entries[entry.filename] = entry
    return entries


def _object(
    archive: zipfile.ZipFile, entries: dict[str, zipfile.ZipInfo], name: str
) -> dict[str, Any]:
    return json_object(_text(archive, entries, name), TEXT.format(name))


def _text(archive: zipfile.ZipFile, entries: dict[str, zipfile.ZipInfo], name: str) -> str:
    """A JSON text, whose entry is taken out of ``entries``."""
    name = TEXT.format(name)
    if name not in entries:
        raise ValueError(f"does not hold point samples: it has no {name}")
    try:
        return archive.read(entries.pop(name)).decode()
    except UnicodeDecodeError as error:
        raise ValueError(f"{name}: is not text: {error}") from error


def _header(archive: zipfile.ZipFile, entries: dict[str, zipfile.ZipInfo]) -> Header:
    texts = {name: _text(archive, entries, name) for name in TEXTS}
    window = _object(archive, entries, "window")
    if window.keys() != set(Window._fields):
        raise ValueError(f"window.json: must be a JSON object with {', '.join(Window._fields)}")
    surfaces = {}
    for surface, name in _object(archive, entries, "surfaces").items():
        if not surface.isdecimal() or len(surface) > len(str(MOST_ID)):
            raise ValueError(f"surfaces.json: id {surface[:80]!r}: must be 0 to {MOST_ID}")
        surfaces[int(surface)] = name
    _require_surfaces(surfaces)
    in_order = [window[name] for name in Window._fields]
    return Header.parse(texts, TEXT, VERSION, Window.of(in_order), surfaces)[0]


def _require_surfaces(surfaces: Mapping[int, str]) -> None:
    """Raise ``TypeError`` or ``ValueError`` unless they are names of ids of 32 bits."""
    for surface, name in surfaces.items():
        require_whole("surfaces: id", surface, 0, MOST_ID)
        if not isinstance(name, str):
            raise TypeError(f"surfaces[{surface}]={shown(name)}: must be text")


def _described(
    archive: zipfile.ZipFile, entries: dict[str, zipfile.ZipInfo], aovs: int
) -> dict[str, tuple[np.dtype[Any], tuple[int, ...]]]:
    """Type and shape of the columns that there are, by their names: see :func:`_schema`.

    They must be what ``Columns`` has, with so many ``aovs``, and be there.
    """
    said = _object(archive, entries, "columns")
    try:
        count = said["x"]["shape"][0]
    except (LookupError, TypeError):
        raise ValueError("columns.json: must have the shape of x") from None
    require_whole("columns.json: number of samples", count, 1, MOST_SAMPLES)
    fields = [field for field in COLUMNS if field.name in said or not is_optional(field)]
    expected = _schema(fields, count, aovs)
    for name in {**expected, **said}:
        if name not in said or said[name] != expected.get(name):
            raise ValueError(
                f"columns.json: {name}: is {str(said.get(name))[:80]}, must be {expected.get(name)}"
            )
        if name not in entries:
            raise ValueError(f"is damaged: it has no column {name}")
    return {
        name: (np.dtype(about["dtype"]), tuple(about["shape"])) for name, about in expected.items()
    }


def _unpack(packed: bytes, rows: np.ndarray, pool: ThreadPoolExecutor) -> list[Future[Any]]:
    """Start to fill the rows of a column with what its frames hold.

    Raises ``ValueError`` for frames that are not of such rows, before one is unpacked.
    """
    jobs, rest = [], memoryview(packed)
    parts = [rows[start : start + FRAME] for start in range(0, len(rows), FRAME)]
    for part in parts:
        if len(rest) < FRAME_HEADER.size:
            raise ValueError("is truncated or damaged")
        width, unpacked, _, length = FRAME_HEADER.unpack_from(rest)
        frame, rest = rest[:length], rest[length:]
        # The library knows where a frame ends by its header alone.
        if len(frame) != length or unpacked != part.nbytes or width != part[0].nbytes:
            raise ValueError("is truncated or damaged")
        jobs.append((frame, part))
    if rest:
        raise ValueError("is damaged: a column is longer than its samples")
    return [pool.submit(blosc.decompress, frame, part) for frame, part in jobs]
