"""The scene that a command is given, how it says to focus it, and its point samples."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from .options import (
    given_denoise,
    given_lens,
    given_method,
    given_motion,
    given_picture,
    given_sampling,
    scene_with_lens,
)

if TYPE_CHECKING:
    import mitsuba as mi

    from ..animation.animation import Animation
    from ..filters.base import FilterFunction
    from ..focusing.methods import Method
    from ..motion.motion import Motion
    from ..samples.maps import MapName
    from ..samples.point_samples import PointSamples
    from ..tracing.sampling import Sampling


@dataclasses.dataclass(frozen=True)
class Opened:
    """A scene, and how its integrator and the options say that it is sampled and focused.

    ``not_kept`` are the errors of samples that were to be kept and could not be written.
    """

    scene: mi.Scene
    sensor: mi.Sensor
    sampling: Sampling
    denoise: bool
    method: Method
    filters: tuple[FilterFunction, ...]
    focus_aovs: bool
    motion: Motion | None
    not_kept: list[OSError] = dataclasses.field(default_factory=list)

    @classmethod
    def of(cls, options: argparse.Namespace, lens: Mapping[str, Any] | None = None) -> Opened:
        """That of the options; ``lens`` has what these do not say of the lens."""
        from ..plugins.settings import FocusSettings
        from ..samples.denoising import require_extra

        method = given_method(options)
        filters: tuple[FilterFunction, ...] = ()
        focus_aovs = False
        if options.denoise:
            require_extra()
        scene, sensor = scene_with_lens(options, lens)
        integrator = scene.integrator()
        if isinstance(integrator, FocusSettings):
            method, filters = given_method(options, integrator.method), integrator.filters
            focus_aovs = integrator.focus_aovs
        sampling, denoise = given_sampling(options, integrator), given_denoise(options, integrator)
        motion = given_motion(options, integrator)
        return cls(scene, sensor, sampling, denoise, method, filters, focus_aovs, motion)

    @property
    def film(self) -> mi.Film:
        """That of the sensor."""
        return self.sensor.film()

    @property
    def has_alpha(self) -> bool:
        """Whether the film shows coverage."""
        from ..plugins.settings import has_alpha

        return has_alpha(self.film)

    def sampling_for(self, maps: Sequence[MapName]) -> Sampling:
        """What ``maps`` need. Raises ``ValueError`` for AOVs where the integrator has none."""
        from ..tracing.aovs import Aovs
        from ..tracing.hidden_surface import nested_of

        if "aovs" in maps and not Aovs.of(nested_of(self.scene.integrator())).names:
            raise ValueError("maps=aovs: the integrator has none; put it into an aov")
        features = self.sampling.features or not {"albedo", "normal"}.isdisjoint(maps)
        return dataclasses.replace(self.sampling, features=features)

    def sampled(
        self,
        options: argparse.Namespace,
        sampling: Sampling,
        seed: int | None = None,
        motion: Motion | None = None,
    ) -> PointSamples:
        """The samples, kept where the options say; ``seed``, ``motion`` are theirs by default.

        That they cannot be kept is told by :meth:`require_kept`, when pictures have been formed.
        """
        from ..tracing.hidden_surface import render_samples

        if self.denoise:
            sampling = dataclasses.replace(sampling, features=True)
        samples = render_samples(
            self.scene,
            self.sensor,
            self.scene.integrator(),
            spp=options.spp,
            seed=options.seed if seed is None else seed,
            sampling=sampling,
            motion=motion or self.motion,
        )
        if options.samples:
            try:
                samples.save(options.samples)
            except OSError as error:
                self.not_kept.append(error)
        return samples.denoised() if self.denoise else samples

    def require_kept(self) -> None:
        """Raise ``OSError`` if samples could not be kept."""
        for error in self.not_kept:
            raise error


def samples_of_file(
    path: str, options: argparse.Namespace, animation: Animation | None = None
) -> PointSamples:
    """The samples in a file, or of a picture in it, with the lens of the options.

    They serve all lenses of an ``animation``.
    """
    from ..samples.files import holds_samples
    from ..samples.point_samples import PointSamples

    picture, lens = given_picture(options), given_lens(options)
    if holds_samples(path):
        if picture:
            raise ValueError(f"{', '.join(picture)}: is of a picture, but {path} holds samples")
        samples = PointSamples.load(path)
        return samples.replace(lens=samples.lens.replace(**lens))
    if animation is None:
        return PointSamples.from_image(path, lens=lens, **picture)
    samples = PointSamples.from_image(path, lens={**animation.first_lens(), **lens}, **picture)
    own: Any = samples.lens
    lenses: list[Any] = animation.lenses(own)
    widest = max(lenses, key=lambda of: float(of.lens_diameter))
    if widest.lens_diameter > own.lens_diameter:
        picture["camera"] = samples.camera
        samples = PointSamples.from_image(path, lens=widest, **picture).replace(lens=own)
    return samples
