"""Pictures of HEIF with a depth, as phones write them: pillow_heif writes none."""

from __future__ import annotations

import io
import math
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pillow_heif
from PIL import Image

FULL = 4
"""Bytes of version and flags, with which some boxes begin."""


def write_heic(path: Path, rgb: np.ndarray, codes: np.ndarray, of_codes: bytes, **saved) -> Path:
    """A picture (H, W, 3) with depth (h, w), both uint8; ``of_codes`` is :func:`representation`."""
    file = pillow_heif.from_pillow(Image.fromarray(rgb))
    file.add_from_pillow(Image.fromarray(codes))
    buffer = io.BytesIO()
    file.save(buffer, quality=-1, chroma=444, **saved)
    path.write_bytes(_with_depth(buffer.getvalue(), of_codes))
    return path


def representation(
    kind: int,
    near: float | None = None,
    far: float | None = None,
    least: float | None = None,
    most: float | None = None,
) -> bytes:
    """The depth representation information of ISO/IEC 23008-2, in its message and its length."""
    given = [near, far, least, most]
    bits = "".join(str(int(value is not None)) for value in given)
    bits += ("1", "010", "011", "00100")[kind]
    bits += "1" if least is not None or most is not None else ""
    for value in given:
        if value is not None:
            mantissa, exponent = math.frexp(value)
            fraction = round((mantissa * 2 - 1) * (1 << 20))
            bits += f"0{exponent - 1 + 31:07b}{20 - 1:05b}{fraction:020b}"
    bits += "1"
    payload = int(bits.ljust(-(-len(bits) // 8) * 8, "0"), 2).to_bytes(-(-len(bits) // 8), "big")
    message = bytes([0x4E, 0x01, 177, len(payload)]) + payload
    return struct.pack(">II", len(message) + 4, len(message)) + message


def _boxes(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = 0
    while at < len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        yield kind, data[at + 8 : at + size]
        at += size


def _box(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I4s", len(content) + 8, kind) + content


def _with_depth(data: bytes, of_codes: bytes) -> bytes:
    """The file, of whose two pictures the second is the depth of the first."""
    whole = dict(_boxes(data))
    meta = dict(_boxes(whole[b"meta"][FULL:]))
    properties = dict(_boxes(meta[b"iprp"]))
    auxiliary = bytes(FULL) + b"urn:mpeg:hevc:2015:auxid:2\0" + of_codes
    number = len(list(_boxes(properties[b"ipco"]))) + 1
    properties[b"ipco"] += _box(b"auxC", auxiliary)
    # Of each item: its id, how many properties, and these; bit 7 says that one must be known.
    of_items = bytearray(properties[b"ipma"])
    second = FULL + 4
    second += 3 + of_items[second + 2]
    of_items[second + 2] += 1
    (of_depth,) = struct.unpack_from(">H", of_items, second)
    properties[b"ipma"] = bytes(of_items) + bytes([number | 0x80])
    meta[b"iprp"] = b"".join(_box(*of) for of in properties.items())
    meta[b"iref"] = meta.get(b"iref", bytes(FULL)) + _box(
        b"auxl", struct.pack(">HHH", of_depth, 1, 1)
    )
    longer = len(_box(b"meta", bytes(FULL) + b"".join(_box(*of) for of in meta.items())))
    longer -= len(whole[b"meta"]) + 8
    places = bytearray(meta[b"iloc"])
    at = FULL + 4
    for _ in range(
        struct.unpack_from(">H", places, FULL + 2)[0]
    ):  # id, file, where it begins, one extent of 8 bytes
        (begins,) = struct.unpack_from(">I", places, at + 4)
        struct.pack_into(">I", places, at + 4, begins + longer)
        at += 4 + 4 + 2 + 8
    meta[b"iloc"] = bytes(places)
    whole[b"meta"] = bytes(FULL) + b"".join(_box(*of) for of in meta.items())
    return b"".join(_box(*of) for of in whole.items())
