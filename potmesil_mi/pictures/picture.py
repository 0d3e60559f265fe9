"""A picture with depth, read from files of any program."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from .._image import linear_from_srgb
from .._validation import shown
from .channels import CRYPTOMATTE, Channel, colours_of, depth_of, every_channel, ids_of
from .heic import picture_file
from .programs import KnownDepth, Optics, depth_known, optics_of
from .reading import PictureFile, PicturePart

NUMPY = ".npy"
"""How files of NumPy end, in which a depth may be."""

NEARLY = 1e-3
"""By how much a ratio may differ from 1 and still be it."""

MOST_NAMES = 1 << 20
"""Characters of a manifest of names, at most."""


@dataclasses.dataclass(frozen=True)
class Frame:
    """Where a picture is, and what is known of what took it.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``size``                      (width, height) in pixels
    ``crop_offset``               where in the whole picture it is: left, top
    ``film_size``                 of the whole picture: width, height
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
        cls,
        part: PicturePart,
        attributes: Mapping[str, Any],
        known: KnownDepth | None,
        path: object,
    ) -> Frame:
        """That of a part of the file ``path``, without what is beyond its display window.

        Raises ``ValueError`` for a part that is all beyond it, for pixels that are not square and
        for a picture that lies on its side.
        """
        for name, usual in (("PixelAspectRatio", 1), ("Orientation", 1)):
            value = attributes.get(name, usual)
            if isinstance(value, (int, float)) and abs(value - usual) > NEARLY:
                raise ValueError(f"{path}: its {name} is {value:g}, must be {usual}")
        film = part.film
        inside = _shared(part.box, film)
        if inside is None:
            raise ValueError(
                f"{path}: its data window {part.box} must lie in its display window {film}"
            )
        left, top, width, height = inside
        optics = optics_of(attributes, known, film[2:])
        offset = left - film[0], top - film[1]
        return cls((width, height), offset, (film[2], film[3]), optics, known)

    def rows_and_columns(self, part: PicturePart, path: object) -> tuple[slice, slice]:
        """Those of a ``part`` of the file ``path`` that are in the picture.

        Raises ``ValueError`` if it has not all of them.
        """
        left = self.crop_offset[0] + part.film[0] - part.box[0]
        top = self.crop_offset[1] + part.film[1] - part.box[1]
        (width, height), (_, _, wide, high) = self.size, part.box
        if left < 0 or top < 0 or left + width > wide or top + height > high:
            raise ValueError(
                f"{path}: its data window {part.box} does not cover {width}x{height} pixels at "
                f"{self.crop_offset} of the picture"
            )
        return slice(top, top + height), slice(left, left + width)


def _shared(
    box: tuple[int, int, int, int], film: tuple[int, int, int, int]
) -> tuple[int, int, int, int] | None:
    """What two boxes (left, top, width, height) have in common, if anything."""
    left, top = max(box[0], film[0]), max(box[1], film[1])
    right = min(box[0] + box[2], film[0] + film[2])
    bottom = min(box[1] + box[3], film[1] + film[3])
    return (left, top, right - left, bottom - top) if left < right and top < bottom else None


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
    depth: np.ndarray | str | os.PathLike[str] | None = None,
    *,
    layer: str | None = None,
    depth_channel: str | None = None,
) -> Picture:
    """Read the picture in a file, and its depth from the same, from another or from an array.

    ``layer`` is the name of that of the colours, ``depth_channel`` of the channel of depth. Raises
    what :class:`PictureFile` raises, and ``ValueError`` that names the channels there are where
    none, or several, may be meant.
    """
    colours = colours_of(file, layer)
    part, known = colours[0].part, None
    attributes = dict(part.attributes)
    of_depth, ids = None, None
    if depth is None:
        of_depth, ids = depth_of(file, depth_channel, need=True), ids_of(file)
        assert of_depth is not None
        attributes = {**of_depth.part.attributes, **attributes}
        others = [of.name for of in every_channel(file)]
        known = depth_known(attributes, of_depth.name, others)
    frame = Frame.of(part, attributes, known, file.path)
    rgb = _linear(file, colours)[frame.rows_and_columns(part, file.path)]
    surface: np.ndarray | None = None
    surfaces: dict[int, str] = {}
    if of_depth is not None:
        values = file.channels(of_depth.part, [of_depth.name])[..., 0]
        values = values[frame.rows_and_columns(of_depth.part, file.path)]
    elif isinstance(depth, np.ndarray):
        values = depth
    else:
        assert depth is not None
        values = read_depth(depth, depth_channel, frame)
    if ids is not None:
        surface, surfaces = _surfaces(file, ids)
        surface = surface[frame.rows_and_columns(ids.part, file.path)]
    if values.shape != rgb.shape[:2]:
        of_depth_file = file.path if depth is None or isinstance(depth, np.ndarray) else depth
        raise ValueError(
            f"{of_depth_file}: depth={shown(values)}: has shape {values.shape}, must have "
            f"{rgb.shape[:2]}, as the colours of {file.path}"
        )
    return Picture(rgb, values, frame, surface, surfaces)


def read_depth(
    path: str | os.PathLike[str], channel: str | None = None, frame: Frame | None = None
) -> np.ndarray:
    """The depth in a file, (H, W), as it is there: a picture of any kind, or ``.npy``.

    Of one that covers the ``frame`` of a picture of the same film, what is in that. Raises as
    :func:`read_picture` does.
    """
    if os.fspath(path).lower().endswith(NUMPY):
        return _from_numpy(path)
    file = picture_file(path)
    found = depth_of(file, channel, need=False)
    if found is None:
        every = every_channel(file)
        red = [of for of in every if of.name.lower() in ("r", "y")]
        if len(red) != 1:
            names = ", ".join(of.full_name for of in every)
            raise ValueError(f"{file.path}: say depth_channel, one of {names}")
        found = red[0]
    values = file.channels(found.part, [found.name])[..., 0]
    if frame is not None and found.part.film[2:] == frame.film_size:
        values = values[frame.rows_and_columns(found.part, path)]
    return values


def _from_numpy(path: str | os.PathLike[str]) -> np.ndarray:
    try:
        values = np.load(path, mmap_mode="r", allow_pickle=False)
        if values.ndim == 3 and 1 in (values.shape[0], values.shape[2]):
            values = values.squeeze(axis=2 if values.shape[2] == 1 else 0)
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
    if values.shape[2] < 3:
        values = np.concatenate([np.repeat(values[..., :1], 3, axis=2), values[..., 1:]], axis=2)
    if whole:
        values[..., :3] = linear_from_srgb(values[..., :3])
    separate = file.is_gamma or bool(colours[0].part.attributes.get("oiio:UnassociatedAlpha"))
    if separate and values.shape[2] == 4:
        values[..., :3] *= values[..., 3:]
    return values


def _surfaces(file: PictureFile, ids: Channel) -> tuple[np.ndarray, dict[int, str]]:
    """The ids of pixels, uint32 (H, W), and their names."""
    values = file.channels(ids.part, [ids.name])[..., 0]
    if not CRYPTOMATTE.search(ids.name):
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
