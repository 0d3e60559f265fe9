"""Sensor ``potmesil``: a pinhole that knows the lens its samples will be focused with."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..optics.aperture import Aperture
from ..optics.camera import Camera, horizontal_fov, orientation
from ..optics.disc import Disc
from ..optics.image_aperture import ImageAperture
from ..optics.lens import FILMS, ThinLens
from ..optics.spectrum import SPECTRUM

DEFAULT_FOCAL_LENGTH = 50.0
"""Focal length in mm where neither that nor a field of view is given."""

APERTURE_PARAMETERS = {
    "blades": ("polygon", "blades"),
    "blade_rotation": ("polygon", "rotation"),
    "blade_curvature": ("polygon", "curvature"),
    "wavelengths": ("lommel", "wavelengths"),
    "truncated": ("lommel", "truncated"),
    "argument": ("lommel", "argument"),
    "aperture_image": ("image", "filename"),
}
"""Parameters of apertures: of which, and their names there."""

PROJECTION_PARAMETERS = {
    "near_clip": 1e-2,
    "far_clip": 1e4,
    "principal_point_offset_x": 0.0,
    "principal_point_offset_y": 0.0,
}
"""Parameters of the projection and their defaults, as in ``perspective``."""

LENS_DEFAULTS = {
    "focus_distance": math.inf,
    "millimeters_per_unit": 1000.0,
    "squeeze": 1.0,
    "vignetting": 0.0,
}
"""Parameters of the lens that have a default of their own in a scene, which is one in metres."""


class PotmesilSensor(mi.Sensor):
    r"""Pinhole camera with a lens description (Potmesil & Chakravarty 1981, section 2).

    Any integrator sees the pinhole: its rays are those of ``perspective`` with the same field
    of view. The integrators ``focus`` and ``point_samples`` also read the lens.

    .. pluginparameters::

     * - focal_length
       - |float|
       - Focal length F of the lens in millimetres. (Default: 50, or what ``fov`` and
         ``frame_width`` ask for)
     * - f_number
       - |float|
       - Aperture number n = F/D. Exactly one of ``f_number`` and ``aperture_radius`` is needed.
     * - aperture_radius
       - |float|
       - Radius of the aperture in scene units, as in ``thinlens``.
     * - focus_distance
       - |float|
       - Distance U to the focused plane in scene units along the axis; ``inf`` is allowed.
         (Default: inf)
     * - frame_width
       - |float|
       - Width of the film in millimetres. (Default: 36, or what ``fov`` and ``focal_length``
         ask for)
     * - fov, fov_axis
       - |float|, |string|
       - Field of view in degrees in place of ``focal_length`` or ``frame_width``, and the axis
         it is along: ``x``, ``y``, ``diagonal``, ``smaller``, ``larger``. (Default axis: x)
     * - millimeters_per_unit
       - |float|
       - Size of a scene unit in millimetres. (Default: 1000, a scene in metres)
     * - image_distance
       - |string|
       - Where the film is: ``focal``, fixed at F as in the paper, or ``focused``, at the image
         of the focused plane as in a real camera. (Default: focal)
     * - aperture
       - |string|
       - Shape of the aperture: ``disc``, ``polygon``, ``image``, or ``lommel``, a disc with
         diffraction; or text such as ``polygon:blades=5``, see
         :func:`potmesil_mi.aperture_of`. (Default: disc)
     * - blades, blade_rotation, blade_curvature
       - |int|, |float|, |float|
       - ``polygon``: number of blades, 3 to 64; degrees by which it is turned anticlockwise, as
         seen from behind the camera, from a corner at the top; curvature of the blades, from 0,
         straight, to 1, the circle. (Default: 6, 0, 0)
     * - wavelengths, truncated, argument
       - |string|, |bool|, |string|
       - ``lommel``: in nm, of red, green and blue, or one for all, or ``spectrum``; whether the
         pattern ends at the circle of confusion; ``consistent`` or ``paper``, see
         :class:`potmesil_mi.Lommel`. (Default: 610, 550, 465; false; consistent)
     * - aperture_image
       - |string|
       - ``image``: file of the picture that is the aperture.
     * - squeeze
       - |float|
       - Of an anamorphic lens: highlights are so many times as tall as wide. (Default: 1)
     * - vignetting
       - |float|
       - Mechanical vignetting, 0 to 0.9: shift of the rim against the aperture, seen from a
         corner of the frame, as a share of its diameter. (Default: 0)
     * - to_world
       - |transform|
       - Camera-to-world transformation without scale, as in ``perspective``.
     * - origin, pan, tilt, swing
       - |point|, |float|
       - In place of ``to_world``: position of the lens, and angles in degrees applied in this
         order: pan about the world's y axis (positive to the right), tilt about the camera's
         x axis (positive upwards), swing about the line of sight (positive clockwise). With all
         angles 0 the camera looks along +z, with +y up. (Default: 0)
     * - near_clip, far_clip
       - |float|
       - Clipping planes in scene units. (Default: 0.01 and 10000)
     * - principal_point_offset_x, principal_point_offset_y
       - |float|
       - Offset of the principal point as a share of the film size. (Default: 0)
     * - shutter_open, shutter_close, film, sampler, srf
       - |float|, |film|, |sampler|, |spectrum|
       - As in ``perspective``.

    ``mi.traverse`` exposes ``focal_length``, ``f_number`` or ``aperture_radius``,
    ``focus_distance``, ``frame_width``, ``millimeters_per_unit``, the clipping planes, the
    principal point and ``to_world``; only the last two are differentiable. In scalar variants
    Mitsuba cannot set the numbers of a Python plugin. Bad values raise ``ValueError``; after an
    update of the parameters too. ``ptracer`` needs a sensor that can be sampled from the scene,
    which this one cannot.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.m_needs_sample_3 = False
        if not self.id():  # mi.traverse names an object without an id by its address
            self.set_id("potmesil")

        if any(name in props for name in ("origin", "pan", "tilt", "swing")):
            self._place(props)
        for name, default in PROJECTION_PARAMETERS.items():
            setattr(self, f"m_{name}", mi.Float(_number(props, name, default)))

        lens = self._lens_from(props)
        self.m_lens_parameters = [
            name for name in lens.parameters() if name not in ("film", "aperture")
        ]
        for name in self.m_lens_parameters:
            setattr(self, f"m_{name}", mi.Float(getattr(lens, name)))
        self.m_lens = lens
        self._update()

    def _place(self, props: mi.Properties) -> None:
        """``to_world`` from the position and the angles of the paper's camera."""
        if "to_world" in props:
            raise ValueError("to_world: cannot be combined with origin, pan, tilt, swing")
        angles = [_number(props, angle, 0.0) for angle in ("pan", "tilt", "swing")]
        origin = np.array(props.get("origin", mi.ScalarPoint3f(0))).ravel()
        if not np.isfinite([*origin, *angles]).all():
            raise ValueError("origin, pan, tilt, swing: must be finite")
        to_world = np.eye(4)
        to_world[:3, :3] = orientation(*angles)
        to_world[:3, 3] = origin
        self.m_to_world = type(self.world_transform())(to_world)

    def _lens_from(self, props: mi.Properties) -> ThinLens:
        """The lens, with a field of view turned into the millimetres that it stands for."""
        optional = ("focal_length", "frame_width", "f_number", "aperture_radius")
        numbers = {name: _number(props, name) for name in optional if name in props}
        for name, default in LENS_DEFAULTS.items():
            numbers[name] = _number(props, name, default)
        film = props.get("image_distance", "focal")
        if film not in FILMS:
            raise ValueError(f"image_distance={film!r}: must be one of {', '.join(FILMS)}")
        aperture = _aperture(props)
        width, height = self.film().size()
        axis = props.get("fov_axis", "x")
        fov = horizontal_fov(_number(props, "fov", 40.0), axis, width / height)
        if "fov" not in props:
            numbers.setdefault("focal_length", DEFAULT_FOCAL_LENGTH)
            return ThinLens(**numbers, film=film, aperture=aperture)
        if "focal_length" in numbers and "frame_width" in numbers:
            raise ValueError(
                f"fov={props['fov']}: cannot be combined with both focal_length and frame_width"
            )
        return ThinLens.of_field_of_view(fov, **numbers, film=film, aperture=aperture)

    def _update(self) -> None:
        """What follows from the parameters: the lens, checked, and the projection."""
        # Only what was changed is taken from the single-precision parameters.
        values = {name: _item(getattr(self, f"m_{name}")) for name in self.m_lens_parameters}
        changes: dict[str, Any] = {
            name: value
            for name, value in values.items()
            if value != _item(mi.Float(getattr(self.m_lens, name)))
        }
        self.m_lens = self.m_lens.replace(**changes)
        near, far = _item(self.m_near_clip), _item(self.m_far_clip)
        if not 0 < near < math.inf:
            raise ValueError(f"near_clip={near}: must be > 0 and finite")
        if not near < far < math.inf:
            raise ValueError(f"far_clip={far}: must be beyond near_clip={near} and finite")
        for axis in "xy":
            offset = _item(getattr(self, f"m_principal_point_offset_{axis}"))
            if not math.isfinite(offset):
                raise ValueError(f"principal_point_offset_{axis}={offset}: must be finite")
        matrix = self._matrix()
        scale = np.linalg.norm(matrix[:3, :3], axis=0)
        if not np.allclose(scale, 1, atol=1e-3):
            raise ValueError(f"to_world: must not scale, but scales its axes by {scale}")

        film = self.film()
        crop_size = mi.ScalarVector2f(film.crop_size())
        self.m_sample_to_camera = mi.perspective_projection(
            film.size(),
            film.crop_size(),
            film.crop_offset(),
            mi.Float(self.m_lens.fov),
            self.m_near_clip,
            self.m_far_clip,
        ).inverse()
        self.m_principal_point = mi.Vector2f(
            self.m_principal_point_offset_x * film.size().x / crop_size.x,
            self.m_principal_point_offset_y * film.size().y / crop_size.y,
        )

    def _matrix(self) -> np.ndarray:
        """The camera-to-world matrix, shape (4, 4)."""
        return np.array(self.m_to_world.matrix, dtype=np.float64).reshape(4, 4)

    def traverse(self, callback: mi.TraversalCallback) -> None:
        """Expose the lens, the projection and the placement to ``mi.traverse``."""
        super().traverse(callback)
        for name in (*self.m_lens_parameters, *PROJECTION_PARAMETERS, "to_world"):
            flags = mi.ParamFlags.Differentiable | mi.ParamFlags.Discontinuous
            if name not in ("principal_point_offset_x", "principal_point_offset_y", "to_world"):
                flags = mi.ParamFlags.NonDifferentiable
            callback.put(name, getattr(self, f"m_{name}"), flags)

    def parameters_changed(self, keys: list[str]) -> None:
        """Check the parameters again and follow them."""
        super().parameters_changed(keys)
        self._update()

    def lens(self) -> ThinLens:
        """The lens that the parameters describe."""
        return self.m_lens

    def camera(self) -> Camera:
        """The pinhole that takes the samples."""
        film = self.film()
        size, crop_offset, crop_size = film.size(), film.crop_offset(), film.crop_size()
        return Camera(
            film_size=(int(size.x), int(size.y)),
            crop_offset=(int(crop_offset.x), int(crop_offset.y)),
            crop_size=(int(crop_size.x), int(crop_size.y)),
            x_fov=self.m_lens.fov,
            to_world=tuple(map(tuple, self._matrix().tolist())),
            near_clip=self.near_clip(),
            far_clip=self.far_clip(),
            principal_point_offset=(
                _item(self.m_principal_point_offset_x),
                _item(self.m_principal_point_offset_y),
            ),
            shutter_open=self.shutter_open(),
            shutter_close=self.shutter_open() + self.shutter_open_time(),
        )

    def near_clip(self) -> float:
        """Nearest depth that is rendered, in scene units."""
        return _item(self.m_near_clip)

    def far_clip(self) -> float:
        """Farthest depth that is rendered, in scene units."""
        return _item(self.m_far_clip)

    def focus_distance(self) -> float:
        """Distance to the focused plane in scene units."""
        return self.m_lens.focus_distance

    def sample_ray(
        self,
        time: mi.Float,
        sample1: mi.Float,
        sample2: mi.Point2f,
        sample3: mi.Point2f,
        active: mi.Bool = True,
    ) -> tuple[mi.Ray3f, mi.Spectrum]:
        """A ray through the pinhole; ``sample2`` is the position in the crop window, 0 to 1."""
        wavelengths, weight = self.sample_wavelengths(
            dr.zeros(mi.SurfaceInteraction3f), sample1, active
        )
        position = mi.Point2f(sample2) + self.m_principal_point
        near_point = self.m_sample_to_camera @ mi.Point3f(position.x, position.y, 0)
        direction = dr.normalize(mi.Vector3f(near_point))

        to_world = self.world_transform()
        inv_z = dr.rcp(direction.z)
        near_t = self.m_near_clip * inv_z
        far_t = self.m_far_clip * inv_z
        ray = dr.zeros(mi.Ray3f)
        ray.time = time
        ray.wavelengths = wavelengths
        ray.d = to_world @ direction
        ray.o = to_world @ mi.Point3f(0, 0, 0) + ray.d * near_t
        ray.maxt = far_t - near_t
        return ray, weight

    def bbox(self) -> mi.BoundingBox3f:
        """The pinhole's position."""
        return mi.ScalarBoundingBox3f(mi.ScalarPoint3f(self._matrix()[:3, 3]))

    def to_string(self) -> str:
        """Text for the log and for ``print``."""
        return (
            f"PotmesilSensor[\n  lens = {self.m_lens},\n  x_fov = {self.m_lens.fov},\n"
            f"  near_clip = {self.near_clip()},\n  far_clip = {self.far_clip()},\n"
            f"  film = {self.film()},\n  to_world = {self._matrix().tolist()}\n]"
        )


def _aperture(props: mi.Properties) -> Aperture:
    """The aperture that the parameters describe."""
    name = props.get("aperture", Disc.name)
    parameters: dict[str, Any] = {}
    for parameter, (aperture, field) in APERTURE_PARAMETERS.items():
        if parameter not in props:
            continue
        if name != aperture:
            raise ValueError(f"{parameter}: is for the aperture {aperture}, not for {name}")
        parameters[field] = props[parameter]
    if name == ImageAperture.name:
        if not parameters:
            raise ValueError("aperture_image: must name a picture for the aperture image")
        parameters["filename"] = str(mi.file_resolver().resolve(parameters["filename"]))
    wavelengths = parameters.get("wavelengths", SPECTRUM)
    if isinstance(wavelengths, str) and wavelengths != SPECTRUM:
        parameters["wavelengths"] = _numbers("wavelengths", wavelengths)
    if not parameters:
        return Aperture.parse(name)
    return Aperture.member(name).of_parameters(parameters)


def _numbers(name: str, text: str) -> tuple[float, ...]:
    try:
        return tuple(float(number) for number in text.replace(",", " ").split())
    except ValueError as error:
        raise ValueError(f"{name}={text!r}: must be numbers, or {SPECTRUM}") from error


def _number(props: mi.Properties, name: str, default: float | None = None) -> float:
    value = props[name] if default is None else props.get(name, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError(f"{name}={value!r}: must be a number")
    return float(value)


def _item(value: Any) -> float:
    """A one-element Dr.Jit array, or a number in scalar variants, as a Python number."""
    return float(value if isinstance(value, (int, float)) else value[0])
