"""Replay: the rays of point samples again, for derivatives of their radiance.

The picture is linear in the radiance of its samples, and what that depends on is the business of an
integrator that knows derivatives, such as ``prb``. It is given a sensor whose film has one pixel
for each sample, so that the derivatives of a film are those of samples. The ray of a pixel is the
sample's: of what the pinhole sees the whole ray, of what is hidden the rest of it, from just before
the surface that is seen.

What lies on no ray of the pinhole, or has only a part of the light of a ray, cannot be replayed
so. It counts as constant, and a warning says how much light that is.
"""

from __future__ import annotations

import dataclasses
import functools
import warnings
from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .._backend import from_numpy
from .._progress import track
from ..samples.columns import TWINS, Columns
from ..samples.point_samples import PointSamples
from .aovs import Aovs
from .clearance import clearance
from .onward import may_pass_straight
from .passes import Passes, wavefronts
from .rays import PrimaryRays, begin_at
from .sensor import potmesil_sensor
from .transmission import VeilKinds, veil_kinds

FILM_WIDTH = 1024
"""Columns of the film that has a pixel for each sample."""

SIGNIFICANT = 3
"""Bits of the number of its rows that may be set, from the first on: a kernel is compiled for each
size, and the number of samples changes a little from one rendering to the next."""

COLOURS = 3
"""Colours of a sample."""

LABEL = "Replaying"
"""What is said of the progress."""


@dataclasses.dataclass(frozen=True)
class Replay:
    """Derivatives of the radiance of samples in the parameters of their scene.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``integrator``                what gave the radiance, with derivatives of its own
    ``samples``                   the samples
    ``rays``                      the primary rays that they lie on
    ``which``                     int (n,), the samples that are replayed; others are constant
    ============================  ==========================================================
    """

    integrator: mi.SamplingIntegrator
    samples: PointSamples
    rays: PrimaryRays
    which: np.ndarray

    @classmethod
    def of(
        cls,
        scene: mi.Scene,
        sensor: mi.Sensor,
        integrator: mi.SamplingIntegrator,
        samples: PointSamples,
        *,
        spp: int = 0,
        seed: int = 0,
    ) -> Replay:
        """The replay of ``samples`` that :func:`potmesil_mi.render_samples` took with these.

        With the sampler ``independent`` the first pass of primary rays has the random numbers that
        it had for the same ``seed``. Raises ``ValueError`` for samples of an exposure, and where a
        medium parts the light of rays; ``TypeError`` for an integrator that samples silhouettes.
        Warns where samples cannot be replayed.
        """
        if isinstance(integrator, mi.ad.integrators.common.PSIntegrator):
            raise TypeError(
                f"integrator={type(integrator).__name__}: must not look for silhouettes on a film, "
                "as projective integrators do; prb has the same derivatives in materials and lights"
            )
        if samples.moves:
            raise ValueError(
                "motion: must be None where a scene's parameters have gradients, for what moves is "
                "sampled in scenes that are no longer there"
            )
        sensor = potmesil_sensor(sensor)
        whole = is_whole(samples)
        if not whole.all() and veil_kinds(scene, sensor, integrator).media:
            raise ValueError(
                "virtual_depth=True: must be false where a scene's parameters have gradients and a "
                "participating medium parts the light of rays"
            )
        if not whole.all() and may_pass_straight(scene):
            # Hidden samples may be seen past panes, and are replayed without these.
            whole &= samples.layer == 0
        which = np.flatnonzero(whole)
        _warn_of_constant(samples, which)
        passes = Passes(sensor.sampler(), spp, seed)
        nothing = mi.UInt32(0), False, VeilKinds(False, False), False, Aovs.of(integrator)
        rays = PrimaryRays(scene, sensor, integrator, passes, samples.crop_window, *nothing)
        return cls(integrator, samples, rays, which)

    def backward(self, params: Any, grad: mi.TensorXf) -> None:
        """Add to the gradients of the scene's parameters what those of the radiance bring them.

        ``params`` is as in Mitsuba's ``render_backward``; ``grad`` has shape (N, 3).
        """
        radiance = np.array(grad)
        for part, sensor, seed in self._sensors():
            height, width = (int(n) for n in reversed(sensor.film().crop_size()))
            own = radiance[part] / self.paths
            if mi.is_monochromatic:
                own = own.sum(axis=1, keepdims=True)
            channels = own.shape[1] + len(self.integrator.aov_names())
            image = np.zeros((height * width, channels), np.float32)
            image[: len(own) * self.paths, : own.shape[1]] = np.repeat(own, self.paths, axis=0)
            tensor = mi.TensorXf(image.reshape(height, width, channels))
            self.integrator.render_backward(
                self.rays.scene, params, tensor, sensor=sensor, seed=seed, spp=1
            )

    def forward(self, params: Any) -> mi.TensorXf:
        """The derivative of the radiance, (N, 3), for gradients that the parameters have."""
        result = np.zeros((len(self.samples), COLOURS), np.float32)
        given = gradients_of(self.rays.scene)
        for part, sensor, seed in self._sensors():
            restore(given)  # Some integrators clear them as they go.
            image = self.integrator.render_forward(
                self.rays.scene, params, sensor=sensor, seed=seed, spp=1
            )
            pixels = np.array(image).reshape(-1, image.shape[2])[: len(part) * self.paths]
            own = pixels[:, : 1 if mi.is_monochromatic else COLOURS]
            result[part] = own.reshape(len(part), self.paths, -1).mean(axis=1)
        restore(given)
        return mi.TensorXf(result)

    @property
    def paths(self) -> int:
        """Paths of each sample, of which its radiance is the mean."""
        return 1 if self.samples.lattice == 0 else self.rays.passes.spp

    def _sensors(self) -> Iterator[tuple[np.ndarray, mi.Sensor, int]]:
        """Parts of the samples that are replayed, int (n,), a sensor for each, and a seed."""
        parts = wavefronts(len(self.which), self.paths)
        for number, part in enumerate(track(parts, LABEL)):
            which, seed = self.which[part], self.rays.passes.seed_of(number)
            x, y = self.samples.x[which], self.samples.y[which]
            start = _starts(self.rays, self.samples, which)
            yield which, _sensor(self.rays, x, y, start, self.paths), seed


def is_whole(samples: Columns) -> np.ndarray:
    """Which samples, bool (N,), have all the light of their rays, or of the rest of them.

    Where glass or a veil has parted the light of a ray, several visible samples lie on it.
    """
    whole = samples.layer < TWINS
    visible = np.flatnonzero(samples.layer == 0)
    x, y = (column[visible].view(np.uint32).astype(np.uint64) for column in (samples.x, samples.y))
    ray = x << 32 | y
    order = np.argsort(ray)
    same = np.diff(ray[order]) == 0
    whole[visible[order[1:][same]]] = whole[visible[order[:-1][same]]] = False
    return whole


def gradients_of(scene: mi.Scene) -> list[tuple[Any, Any]]:
    """The scene's parameters that have gradients enabled, and their gradients."""
    return [(value, dr.grad(value)) for _, value in mi.traverse(scene) if dr.grad_enabled(value)]


def restore(gradients: list[tuple[Any, Any]]) -> None:
    """Give parameters the gradients that :func:`gradients_of` found."""
    for value, grad in gradients:
        dr.set_grad(value, grad)


def _warn_of_constant(samples: PointSamples, which: np.ndarray) -> None:
    """Warn where not all of the samples, but ``which``, int (n,), can be replayed."""
    if len(which) == len(samples):
        return
    light = samples.rgb.sum(axis=1) * samples.weight
    share = 1 - light[which].sum() / max(light.sum(), np.finfo(np.float32).tiny)
    warnings.warn(
        f"radiance: {len(samples) - len(which)} of {len(samples)} samples, {share:.0%} of the "
        "light, are seen in mirrors, through glass or past half-transparent things by other rays "
        "than the pinhole's, and count as constant in materials and lights; virtual_depth=false "
        "takes none of these",
        UserWarning,
        stacklevel=3,
    )


def _starts(rays: PrimaryRays, samples: Columns, which: np.ndarray) -> np.ndarray:
    """How far along their rays the samples ``which`` begin, float32 (n,), in scene units.

    What is visible begins there. What is behind everything begins beyond the scene.
    """
    start = np.zeros(len(which), np.float32)
    hidden = np.flatnonzero(samples.layer[which] > 0)
    if len(hidden) == 0:
        return start
    of = which[hidden]
    depth = samples.z[of]
    if samples.through is not None:
        depth = np.where(samples.through[of] > 0, samples.through[of], depth)
    x, y = samples.x[of], samples.y[of]
    position = mi.Point2f(from_numpy(mi.Float, x), from_numpy(mi.Float, y))
    ray, z = rays.begun_at(position, 0.0), from_numpy(mi.Float, depth)
    distance = rays.distance(ray, dr.select(dr.isfinite(z), z, 1))
    # Half as far before a surface as other rays begin behind the one before it.
    before = distance - clearance(ray(distance), distance) / 2
    bounds = rays.scene.bbox()
    beyond = dr.norm(bounds.center() - ray.o) + dr.norm(bounds.extents())
    start[hidden] = np.array(dr.maximum(dr.select(dr.isfinite(z), before, beyond), 0))
    return start


def _rows(pixels: int) -> int:
    """Rows of a film for so many pixels, or somewhat more."""
    rows = -(-pixels // FILM_WIDTH)
    step = 1 << max(0, rows.bit_length() - SIGNIFICANT)
    return -(-rows // step) * step


def _sensor(
    rays: PrimaryRays, x: np.ndarray, y: np.ndarray, start: np.ndarray, paths: int
) -> mi.Sensor:
    """The sensor whose film has ``paths`` pixels for each sample."""
    film = {"type": "hdrfilm", "width": FILM_WIDTH, "height": _rows(len(x) * paths)}
    colours = "luminance" if mi.is_monochromatic else "rgb"
    pixels = {"pixel_format": colours, "component_format": "float32", "rfilter": {"type": "box"}}
    props = mi.Properties("replay")
    props["film"] = mi.load_dict({**film, **pixels})
    props["sampler"] = mi.load_dict({"type": "independent", "sample_count": 1})
    props["shutter_open"] = rays.sensor.shutter_open()
    props["shutter_close"] = rays.sensor.shutter_open() + rays.sensor.shutter_open_time()
    sensor = _sensor_class(mi.variant())(props, rays, x, y, start, paths)
    if rays.sensor.get_medium() is not None:
        sensor.set_medium(rays.sensor.get_medium())
    return sensor


@functools.cache
def _sensor_class(variant: str) -> Any:
    """The class of sensors of a variant, whose types it derives from."""

    class ReplaySensor(mi.Sensor):
        """Its rays are those of samples, in their order, whatever place on the film is asked for.

        Integrators ask for the pixels of a film row by row. Where one sample ends and the next
        begins cannot be told from a rounded place.
        """

        def __init__(
            self,
            props: mi.Properties,
            rays: PrimaryRays,
            x: np.ndarray,
            y: np.ndarray,
            start: np.ndarray,
            paths: int,
        ) -> None:
            super().__init__(props)
            self.m_needs_sample_3 = False
            self.rays, self.paths = rays, paths
            self.columns = tuple(from_numpy(mi.Float, column) for column in (x, y, start))
            self.last = dr.opaque(mi.UInt32, len(x) - 1)

        def sample_ray(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[Any, Any]:
            """The ray of the sample that a lane stands for."""
            ray, weight = self.sample_ray_differential(time, sample1, sample2, sample3, active)
            return mi.Ray3f(ray), weight

        def sample_ray_differential(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[Any, Any]:
            """The same, with its neighbours."""
            lane = dr.arange(mi.UInt32, dr.width(sample2))
            sample = dr.minimum(lane // dr.opaque(mi.UInt32, self.paths), self.last)
            x, y, start = (dr.gather(mi.Float, column, sample) for column in self.columns)
            ray, weight = self.rays.through(mi.Point2f(x, y), mi.Float(sample1), mi.Float(time))
            begin_at(ray, start)
            return ray, weight

        def to_string(self) -> str:
            """Text for the log."""
            return f"ReplaySensor[samples = {dr.width(self.columns)}]"

    return ReplaySensor
