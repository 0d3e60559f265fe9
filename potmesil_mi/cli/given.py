"""What the options of a command say, as the parameters that they stand for."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import math
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from .._units import MILLIMETERS, Length
from .._warnings import FocusWarning
from .options import LENS_OPTIONS, METHOD_OPTIONS, PICTURE_OPTIONS, SAMPLING_OPTIONS

if TYPE_CHECKING:
    import mitsuba as mi

    from .._image import PictureForm
    from ..focusing.methods import Method
    from ..motion.motion import Motion
    from ..samples.point_samples import PointSamples
    from ..tracing.sampling import Sampling


def unit_of(sensor: mi.Sensor) -> float:
    """Millimetres in a scene unit: what a sensor says, and a metre where it says nothing."""
    from ..tracing.sensor import LensSensor

    lens = sensor.lens() if isinstance(sensor, LensSensor) else None
    return float(getattr(lens, "millimeters_per_unit", MILLIMETERS["m"]))


def given_lens(
    options: argparse.Namespace,
    millimeters_per_unit: float | None = None,
    telecentric: bool = False,
) -> dict[str, Any]:
    """Parameters of the lens that the options give, lengths in scene units.

    These are of ``millimeters_per_unit`` unless the options say it; ``None``: nothing does, nor
    does a ``telecentric`` lens, which has no such parameter.
    """
    lens, stated = _given(options, LENS_OPTIONS), stated_unit(options)
    if telecentric:
        lens.pop("millimeters_per_unit", None)
        millimeters_per_unit = stated
    elif stated is not None:
        lens["millimeters_per_unit"] = millimeters_per_unit = stated
    if chooses_focus(options) and "focus_distance" in lens:
        raise ValueError(
            "focus_distance: must not be given beside focus_at or focus_on, which choose it"
        )
    return in_units(lens, millimeters_per_unit)


def stated_unit(options: argparse.Namespace) -> float | None:
    """Millimetres in a scene unit, where the options say it. Raises ``ValueError`` for both."""
    stated: float | None = options.millimeters_per_unit
    if options.units is None:
        return stated
    if stated is not None:
        raise ValueError(
            f"units={options.units}: must not be given beside millimeters_per_unit={stated:g}"
        )
    return MILLIMETERS[options.units]


def given_form(options: argparse.Namespace) -> PictureForm:
    """How the options say that the numbers of pictures are kept."""
    from .._image import PictureForm

    return PictureForm(**_given(options, PictureForm.__annotations__))  # type: ignore[typeddict-item]


def given_picture(options: argparse.Namespace) -> dict[str, Any]:
    """Parameters of ``PointSamples.from_image`` that the options give."""
    return in_units(_given(options, PICTURE_OPTIONS), stated_unit(options))


def in_units(values: Mapping[str, Any], millimeters_per_unit: float | None) -> dict[str, Any]:
    """The values with lengths, or lists of them, as numbers in scene units.

    Raises ``ValueError`` for one with a unit where the size of a scene unit is not known.
    """
    return {name: _plain(name, value, millimeters_per_unit) for name, value in values.items()}


def _plain(name: str, value: Any, millimeters_per_unit: float | None) -> Any:
    if isinstance(value, list):
        return [_plain(name, one, millimeters_per_unit) for one in value]
    if not isinstance(value, Length):
        return value
    if value.unit is not None and millimeters_per_unit is None:
        raise ValueError(
            f"{name}={value}: needs the size of a scene unit; it must be said by --units"
        )
    return value.in_units(millimeters_per_unit or 1.0)


def with_units(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values with lengths, or lists of them, as texts where they have a unit, else as numbers.

    So a lens takes them, which knows the size of a scene unit.
    """
    return {name: _with_unit(value) for name, value in values.items()}


def _with_unit(value: Any) -> Any:
    if isinstance(value, list):
        return [_with_unit(one) for one in value]
    if not isinstance(value, Length):
        return value
    return value.number if value.unit is None else str(value)


def chooses_focus(options: argparse.Namespace) -> bool:
    """Whether the options choose a focus by what is seen. Raises ``ValueError`` for both ways."""
    ways = [name for name in ("focus_at", "focus_on") if getattr(options, name) is not None]
    if len(ways) > 1:
        raise ValueError(f"focus_on={options.focus_on}: must not be given beside focus_at")
    return bool(ways)


def with_chosen_focus(options: argparse.Namespace, samples: PointSamples) -> PointSamples:
    """The samples with their lens focused on what the options choose, if they choose anything."""
    from ..samples.choosing import focus_distance_at, focus_distance_of

    if not chooses_focus(options):
        return samples
    if options.focus_on is not None:
        with renamed("name", "focus_on"):
            distance = focus_distance_of(samples, options.focus_on)
    else:
        sides = zip(options.focus_at, samples.camera.film_size, strict=True)
        x, y = (value * side if share else value for (value, share), side in sides)
        with renamed("x", "focus_at: x"):
            distance = focus_distance_at(samples, x, y)
        if math.isinf(distance):
            hint = "; shares of the picture have a %, such as 50%,50%" if max(x, y) < 1 else ""
            warnings.warn(
                f"focus_at: x={x:g}, y={y:g}: nothing is there, so that the lens is focused at "
                f"infinity{hint}",
                FocusWarning,
                stacklevel=1,
            )
    return samples.replace(lens=samples.lens.replace(focus_distance=distance))


@contextlib.contextmanager
def renamed(parameter: str, option: str) -> Iterator[None]:
    """Let a ``ValueError`` of a parameter within the block speak of the option."""
    try:
        yield
    except ValueError as error:
        raise ValueError(re.sub(rf"^{parameter}\b", option, str(error))) from None


def given_sampling(
    options: argparse.Namespace, integrator: mi.Integrator, millimeters_per_unit: float
) -> Sampling:
    """What the options say of the sampling, and for the rest what the integrator says.

    Lengths with a unit are in scene units of so many millimetres then.
    """
    from ..tracing.sampling import Sampling

    sampling = getattr(integrator, "sampling", Sampling())
    given = _given(options, SAMPLING_OPTIONS)
    if given.get("focus_range") is not None:
        given["focus_range"] = range_of(given["focus_range"], millimeters_per_unit)
    return dataclasses.replace(sampling, **given)


def range_of(text: str, millimeters_per_unit: float) -> str | tuple[float, ...]:
    """Both ends of a range such as ``0.8m/3m`` in scene units; other text as it is."""
    try:
        return tuple(Length.of(end).in_units(millimeters_per_unit) for end in text.split("/"))
    except ValueError:
        return text


def given_denoise(options: argparse.Namespace, integrator: mi.Integrator) -> bool:
    """Whether samples are denoised: what the option says, and without it the integrator."""
    if options.denoise is None:
        return bool(getattr(integrator, "denoise", False))
    return bool(options.denoise)


def given_motion(options: argparse.Namespace, integrator: mi.Integrator) -> Motion | None:
    """What moves: what the option says, and without it the integrator."""
    from ..motion.motion import Motion

    path = getattr(options, "motion", None)
    return getattr(integrator, "motion", None) if path is None else Motion.load(path)


def given_method(options: argparse.Namespace, said: Method | None = None) -> Method:
    """The method that the options describe, and for the rest ``said``, by the scene.

    Raises ``ValueError`` or ``TypeError`` that names the parameter.
    """
    from .._spec import read
    from ..focusing.methods import method_of

    given = _given(options, METHOD_OPTIONS)
    if said is None or "method" not in given:
        return method_of(given.pop("method", said or "layered"), **given)
    # Another method has those parameters of the scene's that both have, unless its text tells them.
    _, told = read(given["method"], "method")
    names = METHOD_OPTIONS.keys() - {"method", *told}
    kept = {name: getattr(said, name, None) for name in names}
    return method_of(**{**kept, **given})


def _given(options: argparse.Namespace, names: Iterable[str]) -> dict[str, Any]:
    values = {name: getattr(options, name) for name in names}
    return {name: value for name, value in values.items() if value is not None}
