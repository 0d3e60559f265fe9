"""The built-in ``thinlens`` that stands for a lens, and pictures that it renders."""

from __future__ import annotations

import dataclasses
import math

import mitsuba as mi
import numpy as np

from .._validation import require_kind, require_whole, shown
from ..optics.disc import Disc
from ..optics.lens import ThinLens
from ..samples.denoising import require_extra
from ..tracing.passes import sample_count, without_warnings
from ..tracing.sensor import is_orthographic, potmesil_sensor

FEATURES = {"type": "aov", "aovs": "albedo:albedo,normal:sh_normal"}
"""The integrator of what a denoiser goes by; another one in it gives the radiance."""

MOST_SPP = 1 << 24
"""Most samples a pixel."""

SAMPLERS = ("multijitter", "orthogonal", "ldsampler")
"""Mitsuba's samplers among which the best one for ``thinlens`` is looked for."""


def thinlens_sensor(
    sensor: mi.Sensor,
    lens: ThinLens | None = None,
    *,
    sampler: str = SAMPLERS[0],
    spp: int = 16,
) -> mi.Sensor:
    """The built-in ``thinlens`` exactly equivalent to ``lens`` at the place of ``sensor``.

    ``sensor`` is one that :func:`potmesil_mi.potmesil_sensor` takes, with its own lens by
    default; as for :func:`potmesil_mi.focus` its aperture and focus count, and the field of view
    stays the sensor's. Placement, clipping planes, shutter and medium stay too.
    The film is of RGB in single precision, with the size, crop window and reconstruction filter
    of the sensor's; ``sampler`` rounds ``spp`` up to a count that it can take. A closed aperture
    gives a ``perspective``. Raises ``ValueError`` for an orthographic sensor, and for one whose
    principal point is off the centre, which ``thinlens`` does not know.
    """
    if is_orthographic(sensor):
        raise ValueError(
            "sensor: is orthographic, must be perspective to be compared: thinlens has no parallel "
            "rays"
        )
    sensor = potmesil_sensor(sensor)
    lens = sensor.lens() if lens is None else lens
    require_kind("lens", lens, ThinLens, "a ThinLens")
    require_whole("spp", spp, 1, MOST_SPP)
    require_kind("sampler", sampler, str, f"the name of a sampler, such as {SAMPLERS[0]}")
    try:
        rounded = rounded_up(sampler, spp)
    except RuntimeError as error:
        raise ValueError(
            f"sampler={shown(sampler)}: must be the name of a sampler, such as {SAMPLERS[0]} "
            f"({error})"
        ) from error
    camera = sensor.camera()
    plain = lens.aperture == Disc() and lens.squeeze == 1 and lens.vignetting == 0
    if not plain and lens.plain().aperture_radius > 0:
        raise ValueError(
            f"aperture={lens.aperture!r}, squeeze={lens.squeeze}, vignetting={lens.vignetting}: "
            "must be a disc, 1 and 0 to be compared: thinlens knows no other"
        )
    if any(camera.principal_point_offset):
        raise ValueError(
            f"principal_point_offset={camera.principal_point_offset}: must be 0, thinlens has none"
        )
    equivalent = mi.load_dict(
        {
            **lens.in_units(sensor.lens().millimeters_per_unit).to_thinlens(),
            "fov": camera.x_fov,
            "to_world": mi.ScalarTransform4f(np.array(camera.to_world)),
            "near_clip": camera.near_clip,
            "far_clip": camera.far_clip,
            "shutter_open": camera.shutter_open,
            "shutter_close": camera.shutter_close,
            "film": _rgb_film(sensor.film()),
            "sampler": {"type": sampler, "sample_count": rounded},
        }
    )
    if sensor.get_medium() is not None:
        equivalent.set_medium(sensor.get_medium())
    return equivalent


@dataclasses.dataclass(frozen=True, eq=False)
class ThinlensRenderer:
    """Renders a scene with the ``thinlens`` that stands for a sensor.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``scene``, ``integrator``     what is rendered, and what gives the radiance
    ``sensor``                    a ``potmesil`` sensor
    ``seed``                      of all pictures; each is also told a number of its own
    ``denoise``                   whether pictures through the lens are denoised
    ``lens``                      the lens, ``None`` (default) for that of the sensor
    ============================  ==========================================================
    """

    scene: mi.Scene
    integrator: mi.Integrator
    sensor: mi.Sensor
    seed: int
    denoise: bool = False
    lens: ThinLens | None = None

    def through_lens(self, sampler: str, spp: int, number: int) -> np.ndarray:
        """Linear RGB, (height, width, 3), of ``spp`` samples a pixel of a sampler."""
        equivalent = thinlens_sensor(self.sensor, self.lens, sampler=sampler, spp=spp)
        if not self.denoise:
            return self._render(equivalent, self.seed + 1 + number)
        with_features = mi.load_dict({**FEATURES, "picture": self.integrator})
        channels = self._render(equivalent, self.seed + 1 + number, with_features)
        return denoised_picture(channels)

    def for_reference(self, spp: int, number: int) -> np.ndarray:
        """A picture that goes into the reference; its numbers are none of the others'."""
        equivalent = thinlens_sensor(self.sensor, self.lens, sampler=SAMPLERS[0], spp=spp)
        return self._render(equivalent, self.seed + 1001 + number)

    def pinhole(self, spp: int, number: int) -> np.ndarray:
        """The picture that is not focused at all."""
        closed = self.sensor.lens().replace(aperture_radius=0)
        return self._render(thinlens_sensor(self.sensor, closed, spp=spp), self.seed + number)

    def _render(
        self, sensor: mi.Sensor, seed: int, integrator: mi.Integrator | None = None
    ) -> np.ndarray:
        spp = sensor.sampler().sample_count()
        with without_warnings():
            picture = mi.render(
                self.scene,
                sensor=sensor,
                integrator=integrator or self.integrator,
                spp=spp,
                seed=seed % 2**32,
            )
        return np.array(picture)


def denoised_picture(channels: np.ndarray) -> np.ndarray:
    """Linear RGB, (H, W, 3), of a picture that an ``aov`` integrator with ``FEATURES`` renders.

    It is denoised by Intel's Open Image Denoise, as :meth:`potmesil_mi.PointSamples.denoised` are,
    by albedo and shading normal as the picture shows them. Raises ``ImportError`` without the extra
    ``denoise``.
    """
    parts = np.s_[..., :3], np.s_[..., -6:-3], np.s_[..., -3:]
    rgb, albedo, normal = (
        np.ascontiguousarray(np.nan_to_num(channels[part], posinf=0, neginf=0)) for part in parts
    )
    result = require_extra().denoise(rgb, np.clip(albedo, 0, 1), normal, hdr=True)
    return np.asarray(result)


def rounded_up(sampler: str, spp: float) -> int:
    """The samples a pixel that ``sampler`` takes where at least ``spp`` are asked for."""
    with without_warnings():
        return sample_count(mi.load_dict({"type": sampler, "sample_count": math.ceil(spp)}))


def rounded_down(sampler: str, spp: int) -> int:
    """The largest number up to ``spp`` that ``sampler`` does not round up."""
    return next(n for n in range(spp, 0, -1) if rounded_up(sampler, n) == n)


def _rgb_film(film: mi.Film) -> mi.Film:
    size, crop_size, crop_offset = film.size(), film.crop_size(), film.crop_offset()
    return mi.load_dict(
        {
            "type": "hdrfilm",
            "width": int(size.x),
            "height": int(size.y),
            "crop_width": int(crop_size.x),
            "crop_height": int(crop_size.y),
            "crop_offset_x": int(crop_offset.x),
            "crop_offset_y": int(crop_offset.y),
            "pixel_format": "rgb",
            "component_format": "float32",
            "sample_border": film.sample_border(),
            "rfilter": film.rfilter(),
        }
    )
