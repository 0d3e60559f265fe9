"""What the headers of programs' pictures say of the camera and the lens, and which depth they keep.

============  =================================================  ===============================
Program       Camera and lens                                    Depth
============  =================================================  ===============================
Blender       ``Lens`` (mm), with stamps; a unit is a metre      ``Depth.Z`` along the axis, 1e10
                                                                 where nothing is
Mitsuba       none                                               ``.T`` along the ray, 0 where
                                                                 nothing is, filtered as colours;
                                                                 it begins at ``near_clip``, 0.01
                                                                 by default
V-Ray         ``cameraAperture`` and ``cameraFocalLength``       ``Z`` along the axis
              (mm), ``cameraFov`` (degrees), ``cameraFNumber``,
              ``cameraTargetDistance``
Redshift      ``rs/camera/fov``, ``FStop``,                      not known
              ``DOFFocusDistance``
RenderMan,    ``worldToCamera`` and ``worldToNDC``               not known
Houdini,
Arnold
potmesil_mi   the attributes of OpenEXR, ``potmesil:lens``       ``Z`` along the axis
phones        EXIF: ``FocalLength`` and that for 35 mm,          HEIC: disparity or metres, along
              ``FNumber``; a unit is a metre                     the axis
any           those of OpenEXR: ``focus`` (m), ``aperture``,     not known
              ``nominalFocalLength``, ``pinholeFocalLength``
              (mm), ``sensorOverallDimensions`` (mm),
              ``screenWindowWidth`` = 2 tan(fov/2); EXIF's
              ``FNumber``, ``FocalLength``
============  =================================================  ===============================

Whether a depth is along the axis or the ray is in no header: it is known by the program alone.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from .._image import OWN_LENS

METER = 1000.0
"""Millimetres of a scene unit where that is a metre."""

FULL_FRAME = math.hypot(36, 24)
"""Diagonal in millimetres of the film that EXIF's 35 mm focal length is for (CIPA DCG-001)."""

FORMED = "potmesil:formed"
"""Attribute of a picture of this package: 1 if it was formed through a lens that is open."""

DEPTH_IN_METERS = "heif:depth_in_meters"
"""Attribute of a part whose depth is in metres along the axis."""


class KnownDepth(NamedTuple):
    """What is known of the depth that a program writes.

    ``background`` is the z from which on nothing was hit; with ``filtered`` the depth of a
    pixel is a mean, in which what was not hit is 0. ``near`` is the plane from which on it is
    counted, by the program's default; no file says it.
    """

    program: str
    kind: str
    background: float | None = None
    filtered: bool = False
    near: float | None = None


BLENDER = KnownDepth("Blender", "z", background=1e10)
MITSUBA = KnownDepth("Mitsuba", "distance", filtered=True, near=0.01)
VRAY = KnownDepth("V-Ray", "z")
OWN = KnownDepth("potmesil_mi", "z")
HEIC = KnownDepth("HEIC", "z")


@dataclasses.dataclass(frozen=True)
class Optics:
    """What is known of a camera and its lens; ``None`` for the rest.

    ``x_fov`` is in degrees, ``focal_length`` and ``frame_width`` in millimetres, ``focus_distance``
    in scene units or, ``focus_meters``, in metres; ``principal_point_offset`` is by how much
    the middle of the film is off the axis, right and down, in widths of the film, ``own_lens`` the
    JSON of this package; ``formed`` says that the picture has gone through that lens.
    """

    x_fov: float | None = None
    focal_length: float | None = None
    frame_width: float | None = None
    f_number: float | None = None
    focus_distance: float | None = None
    focus_meters: float | None = None
    millimeters_per_unit: float | None = None
    principal_point_offset: tuple[float, float] = (0.0, 0.0)
    own_lens: str | None = None
    formed: bool | None = None

    def __or__(self, other: Optics) -> Optics:
        """These, and for what they do not say the other's."""
        mine = {name: of for name, of in vars(self).items() if of is not None}
        if not any(self.principal_point_offset):
            del mine["principal_point_offset"]
        return dataclasses.replace(other, **mine)


def depth_known(
    attributes: Mapping[str, Any], channel: str, others: Iterable[str]
) -> KnownDepth | None:
    """What is known of a channel of depth by the program that wrote it, if that is known."""
    if OWN_LENS in attributes:
        return OWN
    if DEPTH_IN_METERS in attributes:
        return HEIC
    head, _, last = channel.rpartition(".")
    layer = head.rpartition(".")[0]
    written = str(attributes.get("generatedBy", "")) + str(attributes.get("Software", ""))
    if "mitsuba" in written.lower() and last == "T":
        return MITSUBA
    combined = f"{layer}.Combined.R".lstrip(".")
    if channel.endswith("Depth.Z") and any(other == combined for other in others):
        return BLENDER
    if "blender" in written.lower() and channel == "Z":
        return BLENDER
    if "cameraFNumber" in attributes and "cameraFov" in attributes and channel.endswith("Z"):
        return VRAY
    return None


def optics_of(
    attributes: Mapping[str, Any], known: KnownDepth | None, size: tuple[int, int]
) -> Optics:
    """What the attributes say of a picture of a ``size``, width and height.

    Numbers that make no sense are as if they were not there.
    """
    number = _Numbers(attributes)
    found = Optics(
        x_fov=number.between("cameraFov", 0, 180) or number.between("rs/camera/fov", 0, 180),
        focal_length=number.positive("cameraFocalLength") or number.positive("CameraFocalLength"),
        frame_width=number.positive("cameraAperture"),
        f_number=number.positive("cameraFNumber") or number.positive("rs/camera/FStop"),
        focus_distance=number.positive("cameraTargetDistance")
        or number.positive("rs/camera/DOFFocusDistance"),
    )
    if known is BLENDER:
        found |= Optics(focal_length=number.positive("Lens"), millimeters_per_unit=METER)
    elif known is HEIC:
        found |= Optics(millimeters_per_unit=METER)
    window = number.positive("screenWindowWidth")
    standard = Optics(
        x_fov=_fov_of_matrices(attributes) or _fov(window if window != 1 else None),
        focal_length=number.positive("pinholeFocalLength")
        or number.positive("nominalFocalLength")
        or number.positive("FocalLength")
        or number.positive("Exif:FocalLength"),
        frame_width=number.positive("sensorOverallDimensions"),
        f_number=number.positive("FNumber") or number.positive("aperture"),
        focus_meters=number.positive("focus"),
        principal_point_offset=_offset(attributes, window),
        own_lens=own if isinstance(own := attributes.get(OWN_LENS), str) else None,
        millimeters_per_unit=number.positive("potmesil:millimeters_per_unit"),
        formed=number.positive(FORMED) is not None or None,
    )
    full_frame = number.positive("Exif:FocalLengthIn35mmFilm")
    if full_frame and standard.focal_length and not standard.frame_width:
        diagonal = FULL_FRAME * standard.focal_length / full_frame
        width = diagonal * size[0] / math.hypot(*size)
        standard = dataclasses.replace(standard, frame_width=width)
    return found | standard


class _Numbers:
    """Attributes as numbers > 0; the first of several."""

    def __init__(self, attributes: Mapping[str, Any]) -> None:
        self.attributes = attributes

    def positive(self, name: str) -> float | None:
        return self.between(name, 0, math.inf)

    def between(self, name: str, least: float, most: float) -> float | None:
        value = self.attributes.get(name)
        if isinstance(value, (tuple, list)) and value:
            value = value[0]
        try:
            number = float(value)  # type: ignore[arg-type]
        except (TypeError, ValueError):
            return None
        return number if least < number <= most else None


def _fov(window: float | None) -> float | None:
    """The field of view, in degrees, of a window of that width at distance 1."""
    return None if window is None else 2 * math.degrees(math.atan(window / 2))


def _fov_of_matrices(attributes: Mapping[str, Any]) -> float | None:
    """That of what is left of ``worldToNDC`` without ``worldToCamera``; both act on rows."""
    matrices = [attributes.get(name) for name in ("worldToCamera", "worldToNDC")]
    try:
        view, ndc = (np.array(of, dtype=np.float64).reshape(4, 4) for of in matrices)
        projection = np.linalg.inv(view) @ ndc
    except (TypeError, ValueError, np.linalg.LinAlgError):
        return None
    w = projection[2, 3]
    if not np.isfinite(projection).all() or abs(w) < 1e-9 or abs(projection[0, 0]) < 1e-9:
        return None
    slope = abs(w / projection[0, 0])
    # NDC are 0 to 1 over the display window, as the standard has it, or -1 to 1.
    middle = projection[2, 0] / w
    return 2 * math.degrees(math.atan(slope / 2 if abs(middle - 0.5) < 0.25 else slope))


def _offset(attributes: Mapping[str, Any], window: float | None) -> tuple[float, float]:
    """By how much the middle of the film is off the axis, right and down, in widths of it.

    ``screenWindowCenter`` is in the plane at distance 1, as is the width of the ``window``.
    """
    center = attributes.get("screenWindowCenter")
    if window is None or not isinstance(center, (tuple, list)) or len(center) != 2:
        return 0.0, 0.0
    across, up = (float(of) for of in center)
    if not (math.isfinite(across) and math.isfinite(up)):
        return 0.0, 0.0
    return across / window, -up / window
