"""What files say of a picture that was formed of samples: by which lens, of what, and how."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from .._version import package_version
from ..optics.camera import Camera
from ..optics.lens import ThinLens
from ..optics.telecentric import TelecentricLens
from ..pictures.programs import FORMED
from .point_samples import PointSamples
from .standard import standard_attributes

ALONE = ("seed", "spp")
"""What of the provenance of the samples is said by itself, too."""


def attributes_of_formed(
    samples: PointSamples, method: object, lens: ThinLens | TelecentricLens | None = None
) -> dict[str, Any]:
    """The attributes of a picture that was formed of ``samples``.

    They are those of :func:`attributes_through`, with ``sample_count``, ``provenance`` (JSON), and
    ``seed`` and ``spp``, where the provenance has them. ``method`` is how it was formed, a method
    or its text; ``lens`` the one that it was formed through, by default the samples' own.
    """
    lens = samples.lens if lens is None else lens
    provenance = samples.provenance
    more: dict[str, Any] = {"sample_count": len(samples)}
    more |= {name: provenance[name] for name in ALONE if name in provenance}
    if provenance:
        more["provenance"] = json.dumps(dict(provenance))
    source = provenance.get("scene", provenance.get("picture"))
    return attributes_through(samples.camera, lens, method, source, **more)


def attributes_through(
    camera: Camera,
    lens: ThinLens | TelecentricLens,
    method: object,
    source: object = None,
    **more: str | int | float,
) -> dict[str, Any]:
    """The attributes of a picture that was formed through a lens by a ``method``.

    They are those of :func:`.standard.standard_attributes`; ``Software``, with the version, and
    ``ImageDescription``, a line that names the ``source``; and ``potmesil:`` with ``formed`` (1 for
    a lens that is open, which tells it from a sharp picture), ``focus_distance`` (scene units),
    ``f_number`` or ``half_angle`` (degrees), ``method``, and what ``more`` is said.
    """
    plain = lens.plain()
    if isinstance(plain, ThinLens):
        opening, name, width = plain.aperture_radius, "f_number", plain.f_number
    else:
        opening, name, width = plain.slope, "half_angle", plain.half_angle
    said = {"focus_distance": plain.focus_distance, name: width, "method": str(method), **more}
    return {
        **standard_attributes(camera, lens),
        FORMED: int(opening > 0),
        "Software": f"potmesil_mi {package_version()}",
        "ImageDescription": _line(said, source),
        **{f"potmesil:{name}": value for name, value in said.items()},
    }


def _line(said: Mapping[str, Any], source: object) -> str:
    """What is ``said`` of a picture in a line; ``source`` is the file that it comes from."""
    opening = f"f/{said['f_number']:g}" if "f_number" in said else f"{said['half_angle']:g} degrees"
    parts = [opening, f"focused at {said['focus_distance']:g}", said["method"]]
    if "sample_count" in said:
        of = "" if source is None else f" of {source}"
        parts.append(f"{said['sample_count']:,} samples{of}")
    return ", ".join([*parts, *(f"{name} {said[name]}" for name in ALONE if name in said)])
