"""A picture with depth, read from files of any program."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from .channels import (
    CRYPTOMATTE,
    Channel,
    colours_of,
    depth_of,
    every_channel,
    ids_of,
    require_one_window,
)
from .programs import KnownDepth, Optics, depth_known, optics_of
from .reading import Part, PictureFile

NUMPY = ".npy"
"""How files of NumPy end, in which a depth may be."""

MOST_NAMES = 1 << 20
"""Characters of a manifest of names, at most."""


@dataclasses.dataclass(frozen=True)
class Frame:
    """Where a picture is, and what is known of what took it.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``size``                      (width, height) in pixels
    ``crop_offset``, ``film_size``  where in the whole picture it is, and how large that is
    ``optics``                    what the file says of the camera and its lens
    ``known``                     what the program that wrote it makes of depth; ``None`` where
                                  that is not known
    ============================  ==========================================================
    """

    size: tuple[int, int]
    crop_offset: tuple[int, int]
    film_size: tuple[int, int]
    optics: Optics
    known: KnownDepth | None

    @classmethod
    def of(
        cls, part: Part, attributes: Mapping[str, Any], known: KnownDepth | None, path: object
    ) -> Frame:
        """That of a part of the file ``path``, which must not go beyond its display window."""
        (left, top, width, height), film = part.box, part.film
        offset = left - film[0], top - film[1]
        if min(offset) < 0 or offset[0] + width > film[2] or offset[1] + height > film[3]:
            raise ValueError(
                f"{path}: its data window {part.box} must lie in its display window {film}"
            )
        optics = optics_of(attributes, known)
        return cls((width, height), offset, (film[2], film[3]), optics, known)


@dataclasses.dataclass(frozen=True)
class Picture:
    """A picture and its depth, as files have them.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``rgb``                       float32 (H, W, 3 or 4), linear, multiplied by alpha
    ``depth``                     (H, W), as it is in the file: floats, or whole numbers
    ``frame``                     where it is, and what took it
    ``surface``, ``surfaces``     ids, uint32 (H, W), and their names
    ============================  ==========================================================
    """

    rgb: np.ndarray
    depth: np.ndarray
    frame: Frame
    surface: np.ndarray | None
    surfaces: Mapping[int, str]


def read_picture(
    file: PictureFile,
    depth: str | os.PathLike[str] | None = None,
    *,
    layer: str | None = None,
    depth_channel: str | None = None,
) -> Picture:
    """Read the picture in a file, and its depth from the same or from another.

    ``layer`` is the name of that of the colours, ``depth_channel`` of the channel of depth. Raises
    what :class:`PictureFile` raises, and ``ValueError`` that names the channels there are where
    none, or several, may be meant.
    """
    colours = colours_of(file, layer)
    rgb = _linear(file, colours)
    attributes = dict(colours[0].part.attributes)
    known, surface = None, None
    surfaces: dict[int, str] = {}
    if depth is None:
        channel = depth_of(file, depth_channel, need=True)
        assert channel is not None
        ids = ids_of(file)
        require_one_window([colours[0], channel, ids], file.path)
        attributes = {**channel.part.attributes, **attributes}
        others = [of.name for of in every_channel(file)]
        known = depth_known(attributes, channel.name, others)
        values = file.channels(channel.part, [channel.name])[..., 0]
        if ids is not None:
            surface, surfaces = _surfaces(file, ids)
    else:
        values = read_depth(depth, depth_channel)
    if values.shape != rgb.shape[:2]:
        raise ValueError(
            f"{depth or file.path}: its depth has {values.shape[1]}x{values.shape[0]} pixels, must "
            f"have {rgb.shape[1]}x{rgb.shape[0]}, as the colours"
        )
    frame = Frame.of(colours[0].part, attributes, known, file.path)
    return Picture(rgb, values, frame, surface, surfaces)


def read_depth(path: str | os.PathLike[str], channel: str | None = None) -> np.ndarray:
    """The depth in a file, (H, W), as it is there: a picture of any kind, or ``.npy``.

    Raises as :func:`read_picture` does.
    """
    if os.fspath(path).lower().endswith(NUMPY):
        return _from_numpy(path)
    file = PictureFile(path)
    found = depth_of(file, channel, need=False)
    if found is None:
        every = every_channel(file)
        red = [of for of in every if of.name.lower() in ("r", "y")]
        if not red or (channel is None and len(every) > 3 and len(red) != 1):
            names = ", ".join(of.full_name for of in every)
            raise ValueError(f"{file.path}: say depth_channel, one of {names}")
        found = red[0]
    return file.channels(found.part, [found.name])[..., 0]


def _from_numpy(path: str | os.PathLike[str]) -> np.ndarray:
    try:
        values = np.load(path, mmap_mode="r", allow_pickle=False)
        if values.ndim == 3 and 1 in values.shape:
            values = values.squeeze()
        if values.ndim != 2 or values.dtype.kind not in "fui":
            raise ValueError(f"is {values.dtype} {values.shape}, must be numbers, (H, W)")
        return np.array(values)
    except FileNotFoundError as error:
        raise FileNotFoundError(f"{path}: there is no such file") from error
    except Exception as error:  # Whatever a parser makes of a damaged header.
        raise ValueError(f"{path}: is not an array of NumPy: {error}") from error


def _linear(file: PictureFile, colours: list[Channel]) -> np.ndarray:
    """Colours, linear and multiplied by alpha, (H, W, 3 or 4)."""
    values = file.channels(colours[0].part, [channel.name for channel in colours])
    whole = np.issubdtype(values.dtype, np.integer)
    if whole:
        values = values / np.float32(np.iinfo(values.dtype).max)
    values = values.astype(np.float32, copy=False)
    if values.shape[2] == 1:
        values = np.repeat(values, 3, axis=2)
    if whole:
        rgb = values[..., :3]
        values[..., :3] = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        if file.is_gamma and values.shape[2] == 4:
            values[..., :3] *= values[..., 3:]
    return values


def _surfaces(file: PictureFile, ids: Channel) -> tuple[np.ndarray, dict[int, str]]:
    """The ids of pixels, uint32 (H, W), and their names."""
    values = file.channels(ids.part, [ids.name])[..., 0]
    match = CRYPTOMATTE.match(ids.name)
    if match is None:
        return values.astype(np.uint32), {}
    # A Cryptomatte keeps the bits of whole numbers as a float's.
    surface = np.ascontiguousarray(values, np.float32).view(np.uint32)
    names: dict[int, str] = {}
    for name, text in ids.part.attributes.items():
        if name.startswith("cryptomatte/") and name.endswith("/manifest"):
            names |= _manifest(text)
    there = {int(id_) for id_ in np.unique(surface)}
    return surface, {id_: name for id_, name in names.items() if id_ in there}


def _manifest(text: Any) -> dict[int, str]:
    """The names of ids in the JSON of a Cryptomatte; none of what is not of that form."""
    if not isinstance(text, str) or len(text) > MOST_NAMES:
        return {}
    try:
        values = json.loads(text)
        return {int(str(id_), 16): str(name) for name, id_ in values.items()}
    except (ValueError, RecursionError, AttributeError):
        return {}
