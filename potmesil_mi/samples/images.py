"""Pictures with depth, of any program, as columns of samples."""

from __future__ import annotations

import dataclasses
import math
import os
import warnings
from collections.abc import Callable, Mapping
from numbers import Real
from typing import Any, NamedTuple, cast

import numpy as np

from .._validation import require_choice, require_flag, require_kind, require_number, shown
from .._version import package_version
from .._warnings import FocusWarning
from ..optics.blur import widest_radius_per_vergence
from ..optics.camera import Camera
from ..optics.depth import (
    CLIPS,
    DEPTH_KINDS,
    Clip,
    DepthKind,
    camera_of,
    depth_from_ndc,
    depth_from_ray_length,
    depth_from_vergence,
    ndc_from_stored,
    require_planes,
)
from ..optics.lens import ThinLens
from ..optics.planarity import bending, verdict
from ..optics.usable import require_usable_together
from ..pictures.heic import picture_file
from ..pictures.picture import Frame, read_depth, read_picture
from ..pictures.programs import KnownDepth
from .attached import taken_from
from .columns import MOST_IDS
from .foreign_deep import DeepImage, columns_of_deep, is_deep, read_deep
from .image_layers import HIDDEN, Hidden, LayeredImage, with_layers
from .picture_optics import camera_and_lens, given_fov, require_fitting
from .provenance import file_name, widest_of

FARTHEST = 1e30
"""Depth in scene units of what is taken to be nearest where nothing is near."""

NEAREST = 1e-30
"""The least depth in scene units that single precision can use."""


@dataclasses.dataclass(frozen=True)
class Described:
    """What is said of a picture, beside its numbers: see :meth:`PointSamples.from_image`."""

    camera: Camera | float | None
    lens: ThinLens | Mapping[str, Any] | None
    surface: Any
    surfaces: Mapping[int, str] | None
    layer: str | None
    depth_channel: str | None
    depth_kind: DepthKind | None
    near: float | None
    far: float
    clip: Clip
    reverse: bool
    background: float | None
    depth_scale: float | None
    antialiased: bool
    hidden: Hidden

    def require_valid(self) -> None:
        """Raise ``ValueError`` or ``TypeError`` that names the parameter which is not."""
        if self.depth_kind is not None:
            require_choice("depth_kind", self.depth_kind, DEPTH_KINDS)
            _require_planes_of(self.depth_kind, self.near, self.far, self.clip, self.reverse)
        for name, given in (("layer", self.layer), ("depth_channel", self.depth_channel)):
            if given is not None:
                require_kind(name, given, str, "a name in the file")
        if self.lens is not None:
            kinds = (ThinLens, Mapping)
            require_kind("lens", self.lens, kinds, "a ThinLens, or parameters of one, for a file")
        require_choice("hidden", self.hidden, HIDDEN)
        require_flag("antialiased", self.antialiased)
        for name, value, least in (
            ("background", self.background, 0.0),
            ("depth_scale", self.depth_scale, NEAREST),
        ):
            if value is not None:
                require_number(name, value)
                if not value >= least:
                    raise ValueError(f"{name}={value}: must be >= {least:g} scene units")

    def known_of(self, frame: Frame) -> KnownDepth | None:
        """What is known of the depth of a picture, unless it is said to be of another kind."""
        known = frame.known
        other = known is not None and self.depth_kind not in (None, known.kind)
        return None if other else known


class SampledImage(NamedTuple):
    """A picture as samples: its camera, its lens, the names of its surfaces, and its columns.

    ``program`` is what wrote its depth, if that is known, and ``layers`` tells of which pixels
    samples are copies, where that is so.
    """

    camera: Camera
    lens: ThinLens
    surfaces: Mapping[int, str]
    columns: dict[str, Any]
    program: str | None = None
    layers: LayeredImage | None = None


def fields_of(rgb: Any, depth: Any, described: Described) -> dict[str, Any]:
    """A picture in a file, or in arrays, as the fields of samples; ``described`` says the rest."""
    attached = taken_from({"rgb": rgb, "depth": depth}, of=("rgb", "depth"))
    if attached and isinstance(rgb, (str, os.PathLike)):
        raise NotImplementedError(
            f"depth={shown(depth)}: has gradients enabled, but beside the file {rgb} it has no "
            "derivatives; give rgb as an array, too"
        )
    plain = {"rgb": rgb, "depth": depth} | {name: column for name, (_, column) in attached.items()}
    image = image_of(plain["rgb"], plain["depth"], described)
    provenance: dict[str, str | int | float] = {
        "version": package_version(),
        **widest_of(image.lens),
    }
    for name, given in (("picture", rgb), ("depth", depth)):
        if isinstance(given, (str, os.PathLike)):
            provenance[name] = file_name(given)
    if image.program is not None:
        provenance["program"] = image.program
    columns = image.columns
    if attached:
        from .attached_images import attached_columns  # It needs Dr.Jit.

        assert image.layers is not None
        kind, scale = described.depth_kind, described.depth_scale
        columns = columns | attached_columns(attached, image.layers, kind, scale)
    return {
        **columns,
        "camera": image.camera,
        "lens": image.lens,
        "surfaces": image.surfaces,
        "provenance": provenance,
    }


def image_of(rgb: Any, depth: Any, described: Described) -> SampledImage:
    """A picture in a file, or in arrays, of which ``described`` says the rest."""
    if isinstance(rgb, (str, os.PathLike)):
        return image_of_file(rgb, depth, described)
    layer, depth_channel = described.layer, described.depth_channel
    if layer is not None or depth_channel is not None:
        raise ValueError(
            f"layer={shown(layer)}, depth_channel={shown(depth_channel)}: must be None, since they "
            f"are names in a file and rgb={shown(rgb)} is none"
        )
    return image_of_arrays(rgb, depth, described)


def image_of_file(path: str | os.PathLike[str], depth: Any, described: Described) -> SampledImage:
    """A picture of any program in files.

    The parameters, and what is raised, are those of :meth:`PointSamples.from_image`; errors name
    the file.
    """
    described.require_valid()
    file, is_array = picture_file(path), _is_array(depth)
    of_depth = str(path) if depth is None or is_array else str(depth)
    names = {"layer": described.layer, "depth_channel": described.depth_channel}
    if depth is None and is_deep(file):
        if any(given is not None for given in (*names.values(), described.surface)):
            raise ValueError(
                f"{path}: is deep, of which layer, depth_channel and surface have no meaning"
            )
        return _image_of_deep(read_deep(file), str(path), described)
    picture = read_picture(file, np.asarray(depth) if is_array else depth, **names)
    camera, lens = camera_and_lens(picture.frame, str(path), described.camera, described.lens)
    if picture.frame.optics.formed:
        warnings.warn(
            f"{path}: has been formed through a lens, and what that has blurred is blurred again; "
            "keep the samples (--samples), or form it with --f-number inf",
            stacklevel=2,
        )
    known, values = described.known_of(picture.frame), picture.depth
    if known is not None and known.filtered:
        from .filtered_depth import unfiltered  # See with_layers.

        values = unfiltered(values, picture.rgb[..., 3] if picture.rgb.shape[2] == 4 else None)
    scale = described.depth_scale or 1
    described = _as_known(described, known, of_depth, lambda: bending(values * scale, camera))
    described = dataclasses.replace(described, camera=camera, lens=lens)
    if described.surface is None and picture.surface is not None:
        names_of = described.surfaces or picture.surfaces
        described = dataclasses.replace(described, surface=picture.surface, surfaces=names_of)
    try:
        image = image_of_arrays(picture.rgb, values, described)
        return image if known is None else image._replace(program=known.program)
    except ValueError as error:
        name = of_depth if str(error).startswith("depth") else path
        raise ValueError(f"{name}: {error}") from error


def _is_array(depth: Any) -> bool:
    """Whether a depth is one of numbers, and neither a file nor left out."""
    return depth is not None and not isinstance(depth, (str, os.PathLike))


def _as_known(
    described: Described, known: KnownDepth | None, name: str, bent: Callable[[], dict[str, float]]
) -> Described:
    """What is said of the depth in a file ``name``, and for the rest what is known of it.

    ``bent`` tells how planes are bent. Raises ``ValueError`` where nothing says which kind it is.
    """
    if described.depth_kind is None and known is None:
        raise ValueError(
            f"{name}: no file says whether its depth is along the axis (z) or the ray (distance); "
            f"{verdict(bent())}; depth_kind=None: must be one of {', '.join(DEPTH_KINDS)}"
        )
    if known is None:
        return described
    background = known.background if described.background is None else described.background
    near = described.near
    if near is None and known.near is not None:
        near = known.near
        warnings.warn(
            f"{name}: the depth of {known.program} is counted from the near plane of its sensor, "
            f"which no file says; taken for {near:g}, its default; near (--near) gives another",
            stacklevel=2,
        )
    kind = cast(DepthKind, known.kind)
    return dataclasses.replace(described, depth_kind=kind, background=background, near=near)


def _image_of_deep(image: DeepImage, name: str, described: Described) -> SampledImage:
    """A deep picture of another program, which knows of what is hidden by itself."""
    camera, lens = camera_and_lens(image.frame, name, described.camera, described.lens)
    known = described.known_of(image.frame)
    described = _as_known(described, known, name, lambda: {"z": math.nan})
    try:
        require_usable_together(camera, lens)
        z = _z(_scaled(image.depth, described), image.x, image.y, camera, described)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error
    radius = widest_radius_per_vergence(lens, camera, min(float(z.min()), FARTHEST))
    program = None if known is None else known.program
    return SampledImage(camera, lens, {1: "surface"}, columns_of_deep(image, z, radius), program)


def image_of_arrays(rgb: Any, depth: Any, described: Described) -> SampledImage:
    """A picture in arrays, in the order of its rows.

    The parameters, and what is raised, are those of :meth:`PointSamples.from_image`.
    """
    described.require_valid()
    rgb = np.asarray(rgb)
    if rgb.dtype.kind not in "f":
        raise TypeError(
            f"rgb={shown(rgb)}: has type {rgb.dtype}, must be floats, linear; a file of whole "
            "numbers is sRGB"
        )
    if rgb.ndim != 3 or rgb.shape[2] not in (3, 4) or rgb.size == 0:
        raise ValueError(
            f"rgb={shown(rgb)}: has shape {rgb.shape}, must be (height, width, 3 or 4)"
        )
    with np.errstate(over="ignore"):  # What is infinite then is refused.
        rgb = rgb.astype(np.float32, copy=False)
    if depth is None:
        raise ValueError("depth=None: must be the depth of the pixels of an array")
    if not _is_array(depth):
        depth = read_depth(depth)
    lens, surface, surfaces = described.lens, described.surface, described.surfaces
    if not isinstance(lens, ThinLens):
        raise TypeError(f"lens={shown(lens)}: must be a ThinLens, or rgb the name of a file")
    size, depth = rgb.shape[:2], np.asarray(depth)
    if depth.shape != size:
        raise ValueError(f"depth={shown(depth)}: has shape {depth.shape}, must have {size}, as rgb")
    depth = _scaled(depth, described)
    camera = _camera(described.camera, size)
    require_usable_together(camera, lens)
    x, y = np.meshgrid(*(np.arange(n) + 0.5 for n in size[::-1]))
    x, y = x + camera.crop_offset[0], y + camera.crop_offset[1]
    z = _z(depth, x, y, camera, described)
    ids = np.isfinite(z) if surface is None else np.asarray(surface)
    if ids.shape != size:
        raise ValueError(f"surface={shown(ids)}: has shape {ids.shape}, must have {size}, as rgb")
    if not np.issubdtype(ids.dtype, np.integer) and ids.dtype != bool:
        raise TypeError(f"surface={shown(ids)}: has type {ids.dtype}, must be whole numbers")
    if ids.min() < 0 or ids.max() > MOST_IDS:
        raise ValueError(f"surface: {ids.min()} to {ids.max()}: must be 0 to {MOST_IDS}")
    if surfaces is None:
        surfaces = {1: "surface"} if surface is None else {}
    valid = np.isfinite(rgb).all(axis=2)
    _require_each_pixel("rgb", rgb, valid, "finite")
    columns = {
        "x": x.ravel(),
        "y": y.ravel(),
        "rgb": rgb[..., :3].reshape(depth.size, 3),
        "alpha": rgb[..., 3].ravel() if rgb.shape[2] == 4 else np.isfinite(z).ravel(),
        "z": z.ravel(),
        "surface": ids.ravel(),
        "weight": np.ones(depth.size),
    }
    radius = widest_radius_per_vergence(lens, camera, min(float(z.min()), FARTHEST))
    layers = with_layers(columns, z, radius, described.antialiased, described.hidden)
    return SampledImage(camera, lens, surfaces, layers.columns, layers=layers)


def _scaled(depth: np.ndarray, described: Described) -> np.ndarray:
    """Depths as float64; whole numbers are codes, of which 0 says that nothing is known."""
    scale = described.depth_scale
    if depth.dtype.kind == "f":
        return depth.astype(np.float64) * (1 if scale is None else scale)
    if depth.dtype.kind not in "iu":
        raise TypeError(f"depth={shown(depth)}: has type {depth.dtype}, must be numbers")
    if described.depth_kind == "ndc":
        if depth.dtype.kind != "u" or scale is not None:
            raise ValueError(
                f"depth: {depth.dtype}, depth_scale={scale}: must be unsigned whole numbers "
                "without a scale, of all their bits, or floats, for an NDC depth"
            )
        return ndc_from_stored(depth / np.iinfo(depth.dtype).max, described.clip)
    if scale is None:
        raise ValueError(
            "depth_scale=None: must be what 1 of these whole numbers is in scene units, such as "
            "1/256 in KITTI and 0.001 in NYU"
        )
    if depth.dtype.itemsize == 1:
        warnings.warn(
            f"depth: has 8 bits, and so steps of {scale:g}, which show where things are blurred; "
            "16 bits or floats have none",
            FocusWarning,
            stacklevel=2,
        )
    values = depth.astype(np.float64) * scale
    return values if described.depth_kind == "inverse" else np.where(depth == 0, np.inf, values)


def _z(
    depth: np.ndarray, x: np.ndarray, y: np.ndarray, camera: Camera, described: Described
) -> np.ndarray:
    """The depths along the axis, > 0 and perhaps infinite, of those of any kind."""
    kind, background = described.depth_kind, described.background
    if kind is None:
        raise ValueError(
            f"depth_kind=None: must be one of {', '.join(DEPTH_KINDS)}; nothing in the numbers "
            f"says it, but {verdict(bending(depth, camera))}"
        )
    if kind == "ndc":
        assert described.near is not None
        _require_each_pixel("depth", depth, np.isfinite(depth), "finite")
        clip, reverse = described.clip, described.reverse
        z = depth_from_ndc(depth, described.near, described.far, clip=clip, reverse=reverse)
    elif kind == "inverse":
        valid = (depth >= 0) & np.isfinite(depth)
        _require_each_pixel("depth", depth, valid, ">= 0 and finite")
        z = depth_from_vergence(depth)
    else:
        if background == 0:
            depth = np.where((depth == 0) | np.isnan(depth), np.inf, depth)
        allowed = (
            f">= {NEAREST:g}, or inf where nothing was hit; background=0 says that nothing is "
            "where it is 0 or not a number"
        )
        _require_each_pixel("depth", depth, depth >= NEAREST, allowed)
        z = depth if kind == "z" else depth_from_ray_length(depth, x, y, camera)
        z = z + (described.near or 0)  # None of a depth along the axis.
    return np.where(z >= (background or math.inf), np.inf, z)


def _camera(camera: Camera | float | None, size: tuple[int, ...]) -> Camera:
    """The camera of a picture of a ``size``, height and width."""
    height, width = size
    if camera is None:
        raise ValueError("camera=None: must be a Camera, or the field of view in degrees")
    if isinstance(camera, Camera):
        return require_fitting(camera, (width, height))
    return camera_of(given_fov(camera), (width, height))


def _require_planes_of(
    depth_kind: DepthKind, near: float | None, far: float, clip: Clip, reverse: bool
) -> None:
    """Raise unless there are planes, and what is told of them, for NDC depth alone.

    A depth along the ray may be counted from a near plane.
    """
    require_choice("clip", clip, CLIPS)
    require_flag("reverse", reverse)
    if depth_kind == "ndc":
        if near is None:
            raise ValueError("near=None: must be the near plane, in scene units, of an NDC depth")
        require_planes(near, far)
        return
    if near is not None and depth_kind == "distance":
        require_number("near", near)
        if near < 0:
            raise ValueError(f"near={near}: must be >= 0 scene units")
        near = None
    require_kind("far", far, Real, "a number")
    if near is not None or far != math.inf or reverse or clip != "opengl":
        raise ValueError(
            f"near={shown(near)}, far={shown(far)}, clip={clip}, reverse={reverse}: must not be "
            f"given for depth_kind={depth_kind}, but for an NDC depth; near for a distance, too"
        )


def _require_each_pixel(name: str, values: np.ndarray, valid: np.ndarray, allowed: str) -> None:
    """Raise for a picture that is not valid everywhere, and tell where."""
    if valid.all():
        return
    first = tuple(np.argwhere(~valid)[0].tolist())
    where = f"row {first[0]}, column {first[1]}" if len(first) == 2 else f"sample {first[0]}"
    raise ValueError(
        f"{name}: {np.count_nonzero(~valid)} of {valid.size} pixels are out of bounds, the first "
        f"at {where}: {values[first]}; must be {allowed}"
    )
