"""What a viewer is opened with: samples, or a scene whose samples are taken then."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from .._validation import shown
from ..filters.base import FilterFunction, as_filters
from ..focusing.methods import Method, MethodName
from ..optics.lens import ThinLens
from ..optics.telecentric import require_lens
from ..samples.point_samples import PointSamples
from ..stacks.foci import Lens
from .view import Viewer

if TYPE_CHECKING:
    import mitsuba as mi

    from ..tracing.sampling import Sampling

LEFT_OUT = {"sensor": 0, "spp": 0, "seed": 0, "sampling": None}
"""Parameters that are for a scene alone, and what they are where nothing is said."""


def view_of(
    source: PointSamples | mi.Scene,
    lens: Lens | None,
    method: Method | MethodName,
    filters: Sequence[FilterFunction | str],
    of_scene: dict[str, Any],
) -> Viewer:
    """The view of ``source``; ``of_scene`` has the parameters that are for a scene alone."""
    method, filters = Method.parse(method), as_filters(filters)
    if isinstance(source, PointSamples):
        for name, otherwise in LEFT_OUT.items():
            value = of_scene[name]
            if not (value is otherwise or (type(value) is int and value == otherwise)):
                raise ValueError(f"{name}={shown(value)}: must be left out, for it is of a scene")
        return Viewer(source, lens, method, filters=filters)
    import mitsuba as mi

    if not isinstance(source, mi.Scene):
        raise TypeError(
            f"source={shown(source)}: must be PointSamples, or a scene, as mi.load_file gives"
        )
    return _view_of_scene(source, lens, method, filters, **of_scene)


def _view_of_scene(
    scene: mi.Scene,
    lens: Lens | None,
    method: Method | MethodName,
    filters: Sequence[FilterFunction | str],
    sensor: int | mi.Sensor,
    spp: int,
    seed: int,
    sampling: Sampling | None,
) -> Viewer:
    from ..optics.telecentric import is_open
    from ..tracing.hidden_surface import render_samples
    from .beside import Beside

    taking = _sensor_of(scene, sensor, lens)
    if not is_open(taking.lens()):
        raise ValueError(
            "lens: must be given, for the scene's sensor has none; such as "
            "pm.ThinLens(50, 2.8, focus_distance=1.5, millimeters_per_unit=1000)"
        )
    samples = render_samples(scene, taking, spp=spp, seed=seed, sampling=sampling)
    is_still = not samples.moves and samples.camera.projection == "perspective"
    return Viewer(
        samples,
        method=method,
        rfilter=taking.film().rfilter(),
        filters=filters,
        beside=Beside(scene, taking, seed) if is_still else None,
    )


def _sensor_of(scene: mi.Scene, sensor: int | mi.Sensor, lens: Lens | None) -> mi.Sensor:
    """The sensor of a scene with a ``lens`` in the place of its own; its field of view stays."""
    from ..tracing.sensor import LensSensor, is_orthographic, pick_sensor, potmesil_sensor

    picked = pick_sensor(scene, sensor)
    if lens is None:
        return potmesil_sensor(picked)
    require_lens(lens)
    changes: Any = lens.plain().parameters()
    if isinstance(lens, ThinLens) and not is_orthographic(picked):
        del changes["frame_width"]
        if isinstance(picked, LensSensor):
            slope = 2 * math.tan(math.radians(picked.camera().x_fov) / 2)
            changes["frame_width"] = slope * float(lens.plain().film_distance)
    return potmesil_sensor(picked, **changes)
