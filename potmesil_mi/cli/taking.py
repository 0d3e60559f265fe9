"""The scene that a command is given, how it says to focus it, and its point samples."""

from __future__ import annotations

import argparse
import dataclasses
import shlex
import sys
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from .options import (
    SAMPLING_OPTIONS,
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

    from ..filters.base import FilterFunction
    from ..focusing.methods import Method
    from ..motion.motion import Motion
    from ..optics.lens import ThinLens
    from ..optics.telecentric import TelecentricLens
    from ..samples.point_samples import PointSamples
    from ..tracing.sampling import Sampling


SCENE = ".xml"
"""How names of scenes end."""

SCENE_OPTIONS = ("define", "sensor", "spp", "seed", "samples")
"""Options that say what is sampled, with ``SAMPLING_OPTIONS``; they are false where not given."""


class Lenses(Protocol):
    """Several lenses of the same samples, as an animation and a stack have them."""

    def first_lens(self) -> dict[str, Any]:
        """The parameters that the first of them has in place of those of the lens at hand."""

    def lenses(self, lens: ThinLens | TelecentricLens) -> Sequence[ThinLens | TelecentricLens]:
        """What becomes of the ``lens`` at hand."""


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
    motion: Motion | None
    not_kept: list[OSError] = dataclasses.field(default_factory=list)

    @classmethod
    def of(cls, options: argparse.Namespace, lens: Mapping[str, Any] | None = None) -> Opened:
        """That of the options; ``lens`` has what these do not say of the lens."""
        from ..plugins.settings import FocusSettings
        from ..samples.denoising import require_extra

        method = given_method(options)
        filters: tuple[FilterFunction, ...] = ()
        if options.denoise:
            require_extra()
        scene, sensor = scene_with_lens(options, lens)
        integrator = scene.integrator()
        if isinstance(integrator, FocusSettings):
            method, filters = given_method(options, integrator.method), integrator.filters
        sampling, denoise = given_sampling(options, integrator), given_denoise(options, integrator)
        motion = given_motion(options, integrator)
        return cls(scene, sensor, sampling, denoise, method, filters, motion)

    @property
    def film(self) -> mi.Film:
        """That of the sensor."""
        return self.sensor.film()

    @property
    def has_alpha(self) -> bool:
        """Whether the film shows coverage."""
        from ..plugins.settings import has_alpha

        return has_alpha(self.film)

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
        samples = samples.replace(provenance={**samples.provenance, **source_of(options)})
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


def source_of(options: argparse.Namespace) -> dict[str, str]:
    """What the options say of the scene that is sampled, for its provenance."""
    from ..samples.provenance import file_name, shown

    source = {"scene": file_name(options.scene)}
    if options.define:
        # Of files there are the names alone, as of the scene.
        values = {key: file_name(value) if Path(value).is_absolute() else value
                  for key, value in options.define}  # fmt: skip
        source["define"] = shown(shlex.join(f"{key}={value}" for key, value in values.items()))
    if getattr(options, "motion", None):
        source["motion"] = file_name(options.motion)
    return source


def samples_of_file(
    path: str, options: argparse.Namespace, several: Lenses | None = None
) -> PointSamples:
    """The samples in a file, or of a picture in it, with the lens of the options.

    They serve all lenses of ``several``.
    """
    from ..samples.files import holds_samples
    from ..samples.point_samples import PointSamples

    picture, lens = given_picture(options), given_lens(options)
    if holds_samples(path):
        if picture:
            raise ValueError(f"{', '.join(picture)}: is of a picture, but {path} holds samples")
        samples = PointSamples.load(path)
        return samples.replace(lens=samples.lens.replace(**lens))
    if several is None:
        return PointSamples.from_image(path, lens=lens, **picture)
    samples = PointSamples.from_image(path, lens={**several.first_lens(), **lens}, **picture)
    own: Any = samples.lens
    lenses: Sequence[Any] = several.lenses(own)
    widest = max(lenses, key=lambda of: float(of.lens_diameter))
    if widest.lens_diameter > own.lens_diameter:
        picture["camera"] = samples.camera
        samples = PointSamples.from_image(path, lens=widest, **picture).replace(lens=own)
    return samples


def sampling_for(
    lens: ThinLens | TelecentricLens,
    lenses: Iterable[ThinLens | TelecentricLens],
    sampling: Sampling,
) -> Sampling:
    """What to sample by a ``lens`` so that all ``lenses`` are served.

    What ``sampling`` says of it stays.
    """
    from ..optics.lens import ThinLens

    thin = [one for one in lenses if isinstance(one, ThinLens)]
    if not thin or not isinstance(lens, ThinLens):
        return sampling
    changes: dict[str, Any] = {}
    if sampling.min_f_number is None:
        # The diameter is what counts, whatever focal length it is told by.
        widest = max(float(one.lens_diameter) for one in thin)
        if widest > float(lens.lens_diameter):
            changes["min_f_number"] = float(lens.focal_length) / widest
    if sampling.focus_range is None:
        distances = [float(one.focus_distance) for one in thin]
        changes["focus_range"] = (min(distances), max(distances))
    return dataclasses.replace(sampling, **changes)


def tell_done(
    what: str, done: int, count: int, old: Sequence[Path], sources: Sequence[str]
) -> None:
    """Tell that ``done`` of ``count`` things are there already, and warn of ``old`` files of them.

    These are older than one of the ``sources`` that they are made of.
    """
    print(f"potmesil: {done} of {count} {what} are there already and stay", file=sys.stderr)
    if old:
        warnings.warn(
            f"{len(old)} files of {what}, such as {old[0]}, are older than "
            f"{' or '.join(sources)}: --overwrite makes them anew",
            stacklevel=1,
        )


def require_no_scene_options(options: argparse.Namespace) -> None:
    """Raise ``ValueError`` for an option that says what is sampled, where samples are given."""
    of_scene = {name: getattr(options, name) or None for name in SCENE_OPTIONS}
    of_scene.update((name, getattr(options, name)) for name in SAMPLING_OPTIONS)
    for name, value in of_scene.items():
        if value is not None:
            raise ValueError(
                f"{name}={value}: is for a scene, and {options.scene} has its samples already"
            )
