"""Pictures of phones, HEIF or HEIC, with the depth that they hold; by ``pillow_heif``.

The depth is a picture of its own, coarser than the colours, whose codes stand for disparity, one
over distance, or for distance in metres (ISO/IEC 23008-2, depth representation information).
"""

from __future__ import annotations

import functools
import io
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .programs import DEPTH_IN_METERS
from .reading import PictureFile, PicturePart, first_line

BOX = b"ftyp"
"""What stands at the fifth byte of such a file."""

HDR_TRANSFERS = {16: "PQ", 18: "HLG"}
"""Transfer characteristics (ISO/IEC 23091-2) whose whole numbers are not like those of sRGB."""

EXIF = {0x829D: "FNumber", 0x920A: "Exif:FocalLength", 0xA405: "Exif:FocalLengthIn35mmFilm"}
"""Tags of EXIF and the names that OpenImageIO gives them."""

EXIF_FOLDER = 0x8769
"""The tag that says where those are."""

JUMP = 0.05
"""Part by which disparities beside each other differ that belong to two surfaces."""


def is_heic(path: str | os.PathLike[str]) -> bool:
    """Whether a file begins as one of HEIF does; ``False`` for one that cannot be opened."""
    try:
        with open(path, "rb") as file:
            return file.read(8)[4:] == BOX
    except OSError:
        return False


def picture_file(path: str | os.PathLike[str]) -> PictureFile:
    """A file of a picture of any kind, whose headers have been read.

    Raises what :class:`PictureFile` raises.
    """
    return HeicFile(path) if is_heic(path) else PictureFile(path)


class HeicFile(PictureFile):
    """A picture of a phone: colours, and where it has one a part ``depth`` of the same size.

    Raises ``ValueError`` for one that cannot be read or has the brightness of HDR, and
    ``ModuleNotFoundError`` where ``pillow_heif`` is missing; they name the file.
    """

    _picture: Any

    @property
    def is_gamma(self) -> bool:
        """Whether its whole numbers are sRGB: they are made so."""
        return True

    def _parts(self) -> list[PicturePart]:
        try:
            import pillow_heif
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(
                f"{self.path}: HEIC needs pillow_heif: pip install 'potmesil_mi[heic]'"
            ) from error
        try:
            self._picture = pillow_heif.open_heif(self.path)
            info, size = self._picture.info, self._picture.size
        except Exception as error:  # Whatever a parser makes of a damaged file.
            said = first_line(str(error))
            raise ValueError(f"{self.path}: is not a picture that can be read: {said}") from error
        transfer = (info.get("nclx_profile") or {}).get("transfer_characteristics")
        if transfer in HDR_TRANSFERS:
            raise ValueError(
                f"{self.path}: has the brightness of {HDR_TRANSFERS[transfer]}, must be of sRGB or "
                "a profile; convert it to EXR"
            )
        box = (0, 0, *size)
        names = tuple("RGBA"[: 4 if self._picture.has_alpha else 3])
        parts = [PicturePart(0, "", box, box, names, ("uint8",) * len(names), False, self._exif())]
        depths = info.get("depth_images") or []
        if depths:
            known = _decoded(np.zeros((1, 1), np.uint8), depths[0].info.get("metadata")) is not None
            attributes = {DEPTH_IN_METERS: 1} if known else {}
            kind = "float" if known else "uint8"
            parts.append(PicturePart(1, "depth", box, box, ("Z",), (kind,), False, attributes))
        return parts

    def _exif(self) -> dict[str, float]:
        """The numbers of the lens that EXIF has."""
        from PIL import Image

        found = Image.Exif()
        try:
            found.load(self._picture.info.get("exif") or b"")
            tags = found.get_ifd(EXIF_FOLDER)
            return {name: float(tags[tag]) for tag, name in EXIF.items() if tag in tags}
        except Exception:  # Whatever a parser makes of it; it is asked for instead.
            return {}

    def channels(self, part: PicturePart, names: Sequence[str]) -> np.ndarray:
        """Those of the colours in sRGB, uint8, or the depth, (height, width, n).

        A depth of which nothing says what its codes stand for is these codes.
        """
        try:
            colours = self._in_srgb
            if part.number == 0:
                return colours[..., [part.channels.index(name) for name in names]]
            image = self._picture.info["depth_images"][0]
            codes = np.asarray(image)
            codes = codes[..., 0] if codes.ndim == 3 else codes
        except Exception as error:
            said = first_line(str(error))
            raise ValueError(f"{self.path}: is truncated or damaged: {said}") from error
        disparity = _decoded(codes, image.info.get("metadata"))
        values = _enlarged(codes if disparity is None else disparity, colours, self.path)
        if disparity is None:
            return values[..., None]
        with np.errstate(divide="ignore"):
            return (1 / values)[..., None]

    @functools.cached_property
    def _in_srgb(self) -> np.ndarray:
        """The colours, from the file's profile, made once; what is beyond sRGB is clipped."""
        from PIL import Image, ImageCms

        picture: Image.Image = self._picture.to_pillow()
        profile = self._picture.info.get("icc_profile")
        if profile:
            source = ImageCms.ImageCmsProfile(io.BytesIO(profile))
            srgb = ImageCms.createProfile("sRGB")
            converted = ImageCms.profileToProfile(picture, source, srgb)
            assert converted is not None
            picture = converted
        return np.asarray(picture)


def _decoded(codes: np.ndarray, metadata: Mapping[str, Any] | None) -> np.ndarray | None:
    """Disparity in 1/m, float32, of whole numbers; ``None`` where nothing says what they are.

    Type 0 has 1/z from 1/z_far to 1/z_near, type 1 disparity from d_min to d_max, type 2 has z from
    z_near to z_far; the fourth, with a table, is not known here.
    """
    metadata = metadata or {}
    part = codes.astype(np.float32) / np.float32(np.iinfo(codes.dtype).max)
    near, far = metadata.get("z_near"), metadata.get("z_far")
    least, most = metadata.get("d_min"), metadata.get("d_max")
    kind = metadata.get("representation_type")
    if kind in (0, 2) and near and far and 0 < near < far:
        if kind == 2:
            return 1 / (near + part * (far - near))
        least, most = 1 / far, 1 / near
    elif kind != 1:
        return None
    if least is None or most is None or not 0 <= least < most < np.inf:
        return None
    return (least + part * (most - least)).astype(np.float32)


def _enlarged(values: np.ndarray, colours: np.ndarray, path: object) -> np.ndarray:
    """Values of a coarser picture for each pixel of one that shows the same.

    They are linear between their four neighbours, or where these belong to two surfaces that of the
    neighbour which has the pixel's colour, in the picture made coarser. Raises ``ValueError`` if it
    has other proportions.
    """
    (height, width), (high, wide) = values.shape, colours.shape[:2]
    if abs(width * high - height * wide) > max(wide, high):
        raise ValueError(
            f"{path}: its depth has {width}x{height} pixels, must have the proportions of "
            f"{wide}x{high}"
        )
    if (width, height) == (wide, high):
        return values
    y, x = ((np.arange(n) + 0.5) * of / n - 0.5 for n, of in ((high, height), (wide, width)))
    top, left = (
        np.clip(np.floor(at).astype(int), 0, max(of - 2, 0)) for at, of in ((y, height), (x, width))
    )
    below, right = np.minimum(top + 1, height - 1), np.minimum(left + 1, width - 1)
    down = np.clip(y - top, 0, 1).astype(np.float32)[:, None]
    along = np.clip(x - left, 0, 1).astype(np.float32)[None, :]
    corners = [(row, column) for row in (top, below) for column in (left, right)]
    four = [values[np.ix_(*corner)] for corner in corners]
    linear = (four[0] * (1 - along) + four[1] * along) * (1 - down)
    linear += (four[2] * (1 - along) + four[3] * along) * down
    least, most = np.minimum.reduce(four), np.maximum.reduce(four)
    edge = np.nonzero(most - least > JUMP * most)
    coarse = _coarser(colours, (height, width))
    own = colours[edge][:, :3].astype(np.float32)
    off = [
        np.abs(coarse[rows[edge[0]], columns[edge[1]]] - own).sum(axis=1)
        for rows, columns in corners
    ]
    chosen = np.argmin(off, axis=0)
    linear[edge] = np.choose(chosen, [of[edge] for of in four])
    return linear.astype(values.dtype)


def _coarser(colours: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """The means of what each pixel of a coarser picture covers, float32 (height, width, 3)."""
    from PIL import Image

    picture = Image.fromarray(np.ascontiguousarray(colours[..., :3]))
    return np.asarray(picture.resize(size[::-1], Image.Resampling.BOX), np.float32)
