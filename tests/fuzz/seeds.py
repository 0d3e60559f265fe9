"""Small sound files of every kind that is read, from which broken ones are made."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from heic import representation, write_heic
from picture_files import write_deep, write_exr, write_image

import potmesil_mi as pm
from scenes import synthetic

SIZE = (24, 16)
LENS = {"f_number": 0.5, "focus_distance": 2.0, "millimeters_per_unit": 1000.0}
OF_PICTURES = {"camera": 40.0, "lens": LENS, "depth_kind": "z", "background": 1e9}


@dataclasses.dataclass(frozen=True)
class Seed:
    """A file, and how it is loaded from the path of a broken copy."""

    path: Path
    load: Callable[[Path], pm.PointSamples]


def seeds(folder: Path) -> list[Seed]:
    """Those of samples, flat and deep pictures, and depths; they are written into ``folder``."""
    rgb, z = _picture()
    colours = {name: rgb[..., i] for i, name in enumerate("RGB")}
    codes = np.round(255 * rgb).astype(np.uint8)
    np.save(folder / "z.npy", z)
    made = [
        Seed(path, pm.PointSamples.load)
        for path in (
            _samples(folder / "samples.exr"),
            _samples(folder / "hidden.samples", layer=np.arange(200) % 3),
            _samples(folder / "time.samples", **_moving(200)),
        )
    ]
    flat = {"cameraAperture": 36.0, "cameraFNumber": 2.0, "cameraFov": 40.0}
    deep = [[[(0.3, 0.3, 0.3, 0.6, 1.0, 3.0), (0, 0.8, 0, 1, 6, 6)]] * SIZE[0]] * SIZE[1]
    made += [
        Seed(path, _of_picture)
        for path in (
            write_exr(folder / "flat.exr", {**colours, "Z": z}, **flat),
            write_exr(folder / "parts.exr", colours, {"V.Depth.Z": z}),
            write_deep(folder / "deep.exr", deep, ("R", "G", "B", "A", "Z", "ZBack")),
        )
    ]
    for path in (write_image(folder / "a.png", codes), write_image(folder / "a.tif", codes)):
        made.append(Seed(path, lambda path: _of_picture(path, folder / "z.npy")))
    jpeg = write_image(folder / "a.jpg", codes)
    made.append(Seed(jpeg, lambda path: _of_picture(path, folder / "z.npy")))
    made.append(Seed(folder / "z.npy", lambda path: _of_picture(folder / "flat.exr", path)))
    phone = write_heic(
        folder / "a.heic", codes, codes[::2, ::2, 0], representation(1, least=0.2, most=2.0)
    )
    made.append(Seed(phone, _of_picture))
    return made


def _of_picture(path: Path, depth: Path | None = None) -> pm.PointSamples:
    return pm.PointSamples.from_image(path, depth, **OF_PICTURES)


def _picture() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    z = np.full(SIZE[::-1], 6, np.float32)
    z[6:14, 8:16] = 2
    return rng.uniform(0.1, 1, (*SIZE[::-1], 3)).astype(np.float32), z


def _samples(path: Path, **columns: np.ndarray) -> Path:
    # Fewer than are wanted with each of the columns would not tell much.
    lens = pm.ThinLens(50.0, 2.0, 2.0, millimeters_per_unit=1000.0, aperture=pm.Polygon(6))
    columns = {name: of.astype(np.uint8) if name == "layer" else of for name, of in columns.items()}
    synthetic(200, size=(10, 8), lens=lens, **columns).save(path)
    return path


def _moving(count: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(4)
    time = np.sort(rng.uniform(0, 1, count)).astype(np.float32)
    return {"time": time, "motion": rng.normal(0, 0.1, (count, 3)).astype(np.float32)}


HOSTILE = (
    "NaN", "Infinity", "-1", "0", "1e308", "-1e308", "1e-320", "9" * 400, '"text"', "null", "true",
    "[]", "{}", "[" * 2000, '{"type": "image", "filename": "/etc/passwd"}', '"\\u0000"', "1.5e",
)  # fmt: skip
"""What stands in the place of a value in JSON."""


def broken(data: bytes, rng: np.random.Generator) -> bytes:
    """A file made worse: cut off, with bytes changed, taken out or repeated, or hostile JSON."""
    kind = rng.integers(6)
    if kind == 0:
        return data[: rng.integers(len(data))]
    if kind == 1:
        start = int(rng.integers(len(data)))
        return data[:start] + data[start + int(rng.integers(1, 64)) :]
    if kind == 2:
        start, many = int(rng.integers(len(data))), int(rng.integers(1, 5))
        return data[:start] + data[start : start + 64] * many + data[start:]
    if kind == 3:
        worse = _with_hostile_json(data, rng)
        if worse is not None:
            return worse
    changed = bytearray(data)
    head = min(1200, len(data)) if kind < 5 else len(data)
    for _ in range(int(rng.integers(1, 9))):
        at = int(rng.integers(head))
        if rng.random() < 0.3:  # A number of 4 bytes: a size, or a count.
            number = int(rng.choice([0, 1, -1, 1 << 30, (1 << 31) - 1, -(1 << 31)]))
            changed[at : at + 4] = (number & 0xFFFFFFFF).to_bytes(4, "little")
        else:
            changed[at] = int(rng.integers(256))
    return bytes(changed)


def _with_hostile_json(data: bytes, rng: np.random.Generator) -> bytes | None:
    """A value of a JSON object in the file is another, with the length that goes before it."""
    starts = [at for at in range(len(data) - 1) if data[at : at + 2] == b'{"']
    if not starts:
        return None
    start = starts[int(rng.integers(len(starts)))]
    colons = [at for at in range(start, min(start + 4000, len(data))) if data[at] == ord(":")]
    if not colons:
        return None
    at = colons[int(rng.integers(len(colons)))] + 1
    end = min((e for e in (data.find(c, at) for c in (b",", b"}")) if e >= 0), default=at)
    value = HOSTILE[int(rng.integers(len(HOSTILE)))].encode()
    worse = bytearray(data[:at] + value + data[end:])
    # OpenEXR says the length of an attribute's text before it.
    if start >= 4:
        length = int.from_bytes(data[start - 4 : start], "little")
        if 0 < length < 1 << 20:
            longer = max(length + len(value) - (end - at), 0)
            worse[start - 4 : start] = longer.to_bytes(4, "little")
    return bytes(worse)


def is_sound(samples: pm.PointSamples, forms: bool = True) -> bool:
    """Whether what was loaded is sound, and a picture that it ``forms`` is of finite numbers."""
    if not (np.isfinite(samples.rgb).all() and (samples.z > 0).all()):
        return False
    if not forms:
        return True
    picture = np.asarray(pm.focus(samples))
    return bool(np.isfinite(picture).all()) and math.prod(picture.shape) > 0
