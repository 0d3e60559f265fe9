"""Sensor ``potmesil``: a pinhole that knows the lens its samples will be focused with."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .._files import require_path
from .._validation import require_number, require_vector, shown
from ..optics.aperture import Aperture
from ..optics.camera import Camera, horizontal_fov, orientation
from ..optics.disc import Disc
from ..optics.image_aperture import ImageAperture
from ..optics.lens import FILMS, ThinLens
from ..optics.spectrum import SPECTRUM
from ..optics.usable import require_usable_view
from .derivatives import LENS_PARAMETERS
from .projective import CLIPPING, ProjectiveSensor, number_from

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
    **CLIPPING,
    "principal_point_offset_x": 0.0,
    "principal_point_offset_y": 0.0,
}
"""Parameters of the projection and their defaults, as in ``perspective``."""

OPENINGS = ("f_number", "aperture_radius")
"""Two numbers for one thing: one is given, the other follows from the lens."""

DIFFERENTIABLE = {
    **dict.fromkeys(
        ("x_fov", "principal_point_offset_x", "principal_point_offset_y", "to_world"),
        mi.ParamFlags.Differentiable | mi.ParamFlags.Discontinuous,
    ),
    **dict.fromkeys(LENS_PARAMETERS, mi.ParamFlags.Differentiable),
}
"""Exposed parameters that rays, or pictures through the lens, can be differentiated in."""

LENS_DEFAULTS = {
    "focus_distance": math.inf,
    "millimeters_per_unit": 1000.0,
    "squeeze": 1.0,
    "vignetting": 0.0,
}
"""Parameters of the lens that have a default of their own in a scene, which is one in metres."""


class PotmesilSensor(ProjectiveSensor):
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

    ``mi.traverse`` exposes the numbers of the lens, the clipping planes, the principal point and
    ``to_world``, and as ``thinlens`` does ``aperture_radius`` and ``x_fov``, the horizontal field
    of view in degrees. ``f_number`` and ``aperture_radius`` are there whichever was given: setting
    one sets the other, and the one that was given or set last stays as the lens is focused. Setting
    ``x_fov`` sets ``frame_width``; focal length, aperture and focus stay. Setting both of such a
    pair to what does not agree is an error.

    ``x_fov``, the principal point and ``to_world`` are differentiable by integrators that see the
    pinhole; ``focus_distance``, ``f_number`` and ``aperture_radius`` by ``focus``. In scalar
    variants Mitsuba cannot set the numbers of a Python plugin. Bad values raise ``ValueError``. An
    update of the parameters does so, too, and then the sensor and its parameters stay as they were.

    ``sample_direction`` and ``projection_transform`` are those of ``perspective``, for ``ptracer``
    and for the projective integrators (``direct_projective``, ``prb_projective``). Where the
    principal point is off the middle, ``perspective`` gives no importance to a part of its frame;
    this sensor gives it to all.
    """

    plugin = "potmesil"

    m_lens: ThinLens

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        if any(name in props for name in ("origin", "pan", "tilt", "swing")):
            self._place(props)
        self._expose(
            **{name: number_from(props, name, to) for name, to in PROJECTION_PARAMETERS.items()}
        )
        self.m_lens = self._lens_from(props)
        names = self.m_lens.parameters().keys() - {"film", "aperture"}
        self.m_lens_parameters = sorted(names.union(OPENINGS))
        self._expose(
            **{name: getattr(self.m_lens, name) for name in self.m_lens_parameters},
            x_fov=self.m_lens.fov,
        )
        self._update()
        self._keep()

    def _place(self, props: mi.Properties) -> None:
        """``to_world`` from the position and the angles of the paper's camera."""
        if "to_world" in props:
            raise ValueError("to_world: cannot be combined with origin, pan, tilt, swing")
        angles = {name: number_from(props, name, 0.0) for name in ("pan", "tilt", "swing")}
        for name, angle in angles.items():
            require_number(name, angle)
        origin = require_vector(
            "origin", np.array(props.get("origin", mi.ScalarPoint3f(0))).ravel()
        )
        to_world = np.eye(4)
        to_world[:3, :3] = orientation(*angles.values())
        to_world[:3, 3] = origin
        self.m_to_world = type(self.world_transform())(to_world)

    def _lens_from(self, props: mi.Properties) -> ThinLens:
        """The lens, with a field of view turned into the millimetres that it stands for."""
        optional = ("focal_length", "frame_width", "f_number", "aperture_radius")
        numbers = {name: number_from(props, name) for name in optional if name in props}
        for name, default in LENS_DEFAULTS.items():
            numbers[name] = number_from(props, name, default)
        film = props.get("image_distance", "focal")
        if film not in FILMS:
            raise ValueError(f"image_distance={shown(film)}: must be one of {', '.join(FILMS)}")
        aperture = _aperture(props)
        width, height = self.film().size()
        axis = props.get("fov_axis", "x")
        fov = horizontal_fov(number_from(props, "fov", 40.0), axis, width / height)
        if "fov" not in props:
            numbers.setdefault("focal_length", DEFAULT_FOCAL_LENGTH)
            return ThinLens(**numbers, film=film, aperture=aperture)
        return ThinLens.of_field_of_view(fov, **numbers, film=film, aperture=aperture)

    def _changed_lens(self) -> ThinLens:
        """The lens with what has been changed of the exposed numbers.

        Raises ``ValueError`` for two numbers of one thing that do not agree.
        """
        numbers = self._changes(self.m_lens_parameters)
        beside = {}
        if all(name in numbers for name in OPENINGS):
            follows = next(name for name in OPENINGS if name not in self.m_lens.parameters())
            beside[follows] = numbers.pop(follows)
        lens = self.m_lens.replace(**numbers)
        fov = self._value("x_fov")
        if self._differs("x_fov", self.m_lens.fov):
            if not 0 < fov < 180:
                raise ValueError(f"x_fov={fov}: must be > 0 and < 180 degrees")
            if "frame_width" in numbers:
                beside["x_fov"] = fov
            else:
                half = math.tan(math.radians(fov) / 2)
                lens = lens.replace(frame_width=2 * half * lens.film_distance)
        for name, told in beside.items():
            true = lens.fov if name == "x_fov" else getattr(lens, name)
            if not math.isclose(told, true, rel_tol=1e-5):
                raise ValueError(
                    f"{name}={told}: must be {true} beside the other parameters of the lens that "
                    "have been set, or be left alone"
                )
        return lens

    def _update(self) -> None:
        """What follows from the parameters: the lens, checked, and the projection."""
        self.m_lens = self._changed_lens()
        require_usable_view(self.m_lens)
        for name in self.m_lens_parameters:
            self._follow(name, getattr(self.m_lens, name))
        self._follow("x_fov", self.m_lens.fov)
        self._require_clipping()
        for axis in "xy":
            offset = self._value(f"principal_point_offset_{axis}")
            if not math.isfinite(offset):
                raise ValueError(f"principal_point_offset_{axis}={offset}: must be finite")
        matrix = self._matrix()
        scale = np.linalg.norm(matrix[:3, :3], axis=0)
        if not np.allclose(scale, 1, atol=1e-3):
            raise ValueError(f"to_world: must not scale, but scales its axes by {scale}")

        film = self.film()
        crop_size = mi.ScalarVector2f(film.crop_size())
        self._set_projection(
            mi.perspective_projection(
                film.size(),
                film.crop_size(),
                film.crop_offset(),
                self.m_x_fov,
                self.m_near_clip,
                self.m_far_clip,
            )
        )
        self.m_principal_point = mi.Vector2f(
            self.m_principal_point_offset_x * film.size().x / crop_size.x,
            self.m_principal_point_offset_y * film.size().y / crop_size.y,
        )

    def traverse(self, callback: mi.TraversalCallback) -> None:
        """Expose the lens, the projection and the placement to ``mi.traverse``."""
        super().traverse(callback)
        for name in (*self.m_lens_parameters, "x_fov", *PROJECTION_PARAMETERS, "to_world"):
            flags = DIFFERENTIABLE.get(name, mi.ParamFlags.NonDifferentiable)
            callback.put(name, getattr(self, f"m_{name}"), flags)

    def camera(self) -> Camera:
        """The pinhole that takes the samples."""
        return self._camera_of(
            x_fov=self.m_lens.fov,
            to_world=tuple(map(tuple, self._matrix().tolist())),
            near_clip=self.near_clip(),
            far_clip=self.far_clip(),
            principal_point_offset=(
                self._value("principal_point_offset_x"),
                self._value("principal_point_offset_y"),
            ),
        )

    def sample_ray(
        self,
        time: mi.Float,
        sample1: mi.Float,
        sample2: mi.Point2f,
        sample3: mi.Point2f,
        active: mi.Bool = True,
    ) -> tuple[mi.Ray3f, mi.Spectrum]:
        """A ray through the pinhole; ``sample2`` is the position in the crop window, 0 to 1."""
        ray, weight = self._ray_of(time, sample1, active)
        position = mi.Point2f(sample2) + self.m_principal_point
        near_point = self.m_sample_to_camera @ mi.Point3f(position.x, position.y, 0)
        direction = dr.normalize(mi.Vector3f(near_point))

        to_world = self.world_transform()
        inv_z = dr.rcp(direction.z)
        near_t = self.m_near_clip * inv_z
        far_t = self.m_far_clip * inv_z
        ray.d = to_world @ direction
        ray.o = to_world @ mi.Point3f(0, 0, 0) + ray.d * near_t
        ray.maxt = far_t - near_t
        return ray, weight

    def sample_direction(
        self, it: mi.Interaction3f, sample: mi.Point2f, active: mi.Bool = True
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """The direction from ``it.p`` to the pinhole, and the importance of what is seen there.

        ``uv`` of the direction is the place in pixels of the crop window. Its ``pdf`` is 1 where
        the point is in the crop window and between the clipping planes, else 0, as its weight.
        """
        to_world = self.world_transform()
        point = to_world.inverse() @ it.p
        on_film = self.m_camera_to_sample @ point
        place = mi.Point2f(on_film.x, on_film.y) - self.m_principal_point
        inside = (place.x >= 0) & (place.x <= 1) & (place.y >= 0) & (place.y <= 1)
        ahead = (point.z >= self.m_near_clip) & (point.z <= self.m_far_clip)
        active = active & inside & ahead  # not in place, for the mask is the caller's

        direction = mi.DirectionSample3f()
        direction.p = to_world @ mi.Point3f(0, 0, 0)
        direction.n = mi.Normal3f(to_world @ mi.Vector3f(0, 0, 1))
        direction.uv = place * mi.ScalarVector2f(self.film().crop_size())
        direction.time = mi.Float(0)
        direction.delta = mi.Bool(False)
        direction.dist = dr.maximum(dr.norm(point), 1e-30)  # what is divided by is not 0
        direction.d = (direction.p - it.p) / direction.dist
        direction.pdf = dr.select(active, mi.Float(1), mi.Float(0))

        # Importance is even over the window, whose area is taken at distance 1.
        corners = [self.m_sample_to_camera @ mi.Point3f(c, c, 0) for c in (0, 1)]
        first, last = (corner / corner.z for corner in corners)
        area = dr.abs((last.x - first.x) * (last.y - first.y))
        depth = dr.select(active, point.z, mi.Float(1))
        importance = direction.dist / (area * depth**3)
        return direction, mi.Spectrum(dr.select(active, importance, mi.Float(0)))

    def to_string(self) -> str:
        """Text for the log and for ``print``.

        It begins with the name of ``perspective``'s class: by that Mitsuba's projective integrators
        know that they may ask for the projection of a pinhole.
        """
        return (
            f"PerspectiveCamera[\n  plugin = {self.plugin},\n  lens = {self.m_lens},\n"
            f"  x_fov = {self.m_lens.fov},\n"
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
            raise ValueError(
                f"{parameter}={shown(props[parameter])}: must be given for the aperture "
                f"{aperture} alone, not for aperture={shown(name)}"
            )
        parameters[field] = props[parameter]
    if name == ImageAperture.name:
        if not parameters:
            raise ValueError("aperture_image: must name a picture for the aperture image")
        require_path(parameters["filename"], "aperture_image")
        parameters["filename"] = str(mi.file_resolver().resolve(parameters["filename"]))
    wavelengths = parameters.get("wavelengths", SPECTRUM)
    if isinstance(wavelengths, str) and wavelengths != SPECTRUM:
        parameters["wavelengths"] = _numbers("wavelengths", wavelengths)
    if not parameters:
        return Aperture.parse(name)
    try:
        return Aperture.member(name).of_parameters(parameters)
    except (ValueError, TypeError) as error:
        raise type(error)(_in_scenes(str(error))) from error


def _in_scenes(message: str) -> str:
    """An error of an aperture, with the name that its parameter has in a scene."""
    for parameter, (_, field) in APERTURE_PARAMETERS.items():
        if message.startswith(f"{field}="):
            return parameter + message.removeprefix(field)
    return message


def _numbers(name: str, text: str) -> tuple[float, ...]:
    numbers = text.replace(",", " ").split()
    try:
        return tuple(float(number) for number in numbers or [text])
    except ValueError as error:
        raise ValueError(f"{name}={shown(text)}: must be numbers, or {SPECTRUM}") from error
