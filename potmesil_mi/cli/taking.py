"""The scene or file that a command is given, how to focus it, and its point samples."""

from __future__ import annotations

import argparse
import dataclasses
import difflib
import math
import re
import shlex
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from .._warnings import FocusWarning
from .given import (
    chooses_focus,
    given_denoise,
    given_lens,
    given_method,
    given_motion,
    given_picture,
    given_sampling,
    unit_of,
    with_chosen_focus,
)
from .options import SAMPLING_OPTIONS, VARIANTS
from .report import Report

if TYPE_CHECKING:
    import mitsuba as mi

    from ..filters.base import FilterFunction
    from ..focusing.methods import Method
    from ..motion.motion import Motion
    from ..optics.lens import ThinLens
    from ..optics.telecentric import TelecentricLens
    from ..samples.maps import MapName
    from ..samples.point_samples import PointSamples
    from ..tracing.sampling import Sampling


SCENE = ".xml"
"""How names of scenes end."""

OPENINGS = {"f_number", "aperture_radius"}
"""Two parameters of which one says how wide the aperture is."""

ORTHOGRAPHIC_PINHOLE = {"half_angle": 0.0, "focus_distance": 1.0}
"""The lens of an orthographic sensor that has all in focus, wherever it is focused."""

PROBES = 4
"""Most samples a pixel that are taken to find out how deep a scene is."""


def scene_with_lens(
    options: argparse.Namespace,
    otherwise: Mapping[str, Any] | None = None,
    pinholes: bool = False,
) -> tuple[mi.Scene, mi.Sensor]:
    """The scene, and its sensor with the lens of the options.

    Where these do not say it, the lens has the parameters ``otherwise``. Raises ``ValueError``
    where nothing says how wide its aperture is, unless ``pinholes`` may stay what they are.
    """
    from ..tracing.sensor import (
        has_lens,
        is_orthographic,
        pick_sensor,
        potmesil_sensor,
        stated_focus_distance,
    )

    scene = _load(options)
    if scene.integrator() is None:
        raise ValueError(f"{options.scene}: has no integrator")
    sensor = pick_sensor(scene, options.sensor)
    orthographic, has_own = is_orthographic(sensor), has_lens(sensor)
    given, lens = given_lens(options, unit_of(sensor), orthographic), dict(otherwise or {})
    if pinholes and not has_own:
        lens.update(ORTHOGRAPHIC_PINHOLE if orthographic else {"f_number": math.inf})
    if not given.keys().isdisjoint(OPENINGS):
        lens = {name: value for name, value in lens.items() if name not in OPENINGS}
    lens.update(given)
    chooses = chooses_focus(options)
    told = chooses or "focus_distance" in lens or stated_focus_distance(sensor) is not None
    if orthographic:
        if not (has_own or (told and "half_angle" in lens)):
            raise ValueError(
                f"{options.scene}: its sensor is orthographic and has no lens; describe one with "
                "--half-angle and --focus-distance"
            )
        anywhere = {"focus_distance": 1.0}
    else:
        _require_opening(options, has_own, lens)
        anywhere = {}
    if chooses:
        samples = probed(scene, potmesil_sensor(sensor, **{**lens, **anywhere}))
        lens["focus_distance"] = with_chosen_focus(options, samples).lens.focus_distance
    elif not (told or has_own or lens.get("f_number") == math.inf):
        warnings.warn(
            "focus_distance: is not given, so that the lens is focused at infinity; "
            "--focus-distance, --focus-at X,Y or --focus-on NAME say where else",
            FocusWarning,
            stacklevel=1,
        )
    return scene, potmesil_sensor(sensor, **lens)


def _load(options: argparse.Namespace) -> mi.Scene:
    """The scene of the options. Raises ``OSError`` or ``ValueError`` for a file that is none."""
    from .._files import require_readable
    from .._image import PICTURES
    from ..samples.files import holds_samples

    path = require_readable(options.scene)
    samples = holds_samples(path)
    if samples or path.suffix.lower() in PICTURES:
        what = "samples" if samples else "a picture"
        raise ValueError(
            f"{path}: holds {what}, and a scene is needed; `potmesil focus` forms pictures of it"
        )
    set_variant(options.variant)
    import mitsuba as mi

    try:
        # Optimised loading merges meshes of one material, and with them their ids and names.
        return mi.load_file(options.scene, optimize=False, **dict(options.define))
    except RuntimeError as error:
        why = str(error)
        _require_parameters(path, options.define, why)
        missing = re.search(r"undefined parameter: \$(\w+)", why)
        if missing:
            raise ValueError(
                f"{path}: ${missing[1]} has no value; -D {missing[1]}=... gives it"
            ) from None
        raise


def _require_parameters(path: Path, given: Iterable[tuple[str, str]], why: str) -> None:
    """Raise ``ValueError`` for a parameter that a scene does not have, ``why`` it is not loaded."""
    unused = [key for key, _ in given if re.search(rf"^\s*- \${re.escape(key)}=", why, re.M)]
    if unused:
        there = dict.fromkeys(_parameters_in(path, set()))
        near = difflib.get_close_matches(unused[0], there, n=1)
        meant = f"did you mean {near[0]}?" if near else f"it has {', '.join(there) or 'none'}"
        raise ValueError(f"define={unused[0]}: the scene has no ${unused[0]}; {meant}") from None


def _parameters_in(path: Path, seen: set[Path]) -> Iterator[str]:
    """The names of the parameters of a scene in its file and those that it includes."""
    if path in seen or not path.is_file():
        return
    seen.add(path)
    text = path.read_text("utf-8", errors="replace")
    yield from re.findall(r"\$(\w+)", text)
    for name in re.findall(r"<include\s+filename=\"([^\"]+)\"", text):
        yield from _parameters_in(path.parent / name, seen)


def _require_opening(options: argparse.Namespace, has_lens: bool, lens: Mapping[str, Any]) -> None:
    """Raise ``ValueError`` unless a perspective camera gets a thin lens of some aperture."""
    if "half_angle" in lens:
        raise ValueError(
            f"half_angle={lens['half_angle']}: is for an orthographic sensor, which the scene "
            f"{options.scene} does not have"
        )
    if not has_lens and lens.keys().isdisjoint(OPENINGS):
        raise ValueError(
            f"{options.scene}: its sensor has no lens; describe one with --f-number (or "
            "--aperture-radius) and --focus-distance"
        )


def probed(scene: mi.Scene, sensor: mi.Sensor, spp: int = 0) -> PointSamples:
    """A few samples of what a pinhole sees, which tell where things are.

    They are ``spp`` a pixel; with 0 up to ``PROBES``, as many as the sampler has.
    """
    from ..tracing.hidden_surface import render_samples
    from ..tracing.sampling import Sampling

    few = spp or min(int(sensor.sampler().sample_count()), PROBES)
    sampling = Sampling(layers=1, overscan=0, refine=0)
    return render_samples(scene, sensor, spp=few, sampling=sampling)


def set_variant(names: str | None) -> None:
    """Set the first that works of Mitsuba's variants, which are those of the option."""
    import mitsuba as mi

    mi.set_variant(*(VARIANTS if names is None else names.split(",")))


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
        sampling = given_sampling(options, integrator, unit_of(sensor))
        denoise = given_denoise(options, integrator)
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

    if path.lower().endswith(SCENE):
        raise ValueError(f"{path}: is a scene; `potmesil render --samples` takes its samples")
    if holds_samples(path):
        samples = PointSamples.load(path)
        picture = given_picture(options)
        if picture:
            raise ValueError(f"{', '.join(picture)}: is of a picture, but {path} holds samples")
        unit = getattr(samples.lens, "millimeters_per_unit", None)
        lens = given_lens(options, unit, samples.camera.projection == "orthographic")
        return with_chosen_focus(options, samples.replace(lens=samples.lens.replace(**lens)))
    picture, lens = given_picture(options), given_lens(options)
    if several is not None:
        lens = {**several.first_lens(), **lens}
    if chooses_focus(options):
        lens["focus_distance"] = math.inf
    samples = with_chosen_focus(options, PointSamples.from_image(path, lens=lens, **picture))
    if several is None:
        return samples
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


def shows_coverage(path: str, samples: PointSamples) -> bool:
    """Whether pictures of the ``samples`` of a file get alpha, which films of scenes ask for.

    Samples do not, and a picture of another program does where it has some.
    """
    from ..samples.files import holds_samples

    return not holds_samples(path) and bool((samples.alpha < 1).any())


def tell_done(
    report: Report, what: str, done: int, count: int, old: Sequence[Path], sources: Sequence[str]
) -> None:
    """Tell that ``done`` of ``count`` things are there already, and warn of ``old`` files of them.

    These are older than one of the ``sources`` that they are made of.
    """
    report.line(f"{done} of {count} {what} are there already and stay")
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


def begun_with_file(options: argparse.Namespace) -> Method:
    """The method by which samples in a file are focused, in the variant of the options.

    Raises ``ValueError`` for options that say what is sampled.
    """
    require_no_scene_options(options)
    method = given_method(options)
    if options.variant is not None:
        set_variant(options.variant)
    return method
