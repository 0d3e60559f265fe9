"""What a file of samples says of them as a whole, in whatever format the file is.

Camera, lens and the rest are JSON. It is not trusted: it is data of a known form and names no other
file.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from typing import Any

from .._validation import require_whole
from ..optics.aperture import Aperture
from ..optics.camera import Camera
from ..optics.lens import ThinLens
from ..optics.telecentric import TYPE, TelecentricLens
from ..optics.usable import require_magnitude, require_usable_together
from .columns import require_visibility_radius
from .provenance import Provenance, checked_provenance
from .raster import Window

LONGEST_JSON = 1 << 26
"""Most characters of a camera or a lens. An aperture of 4096 x 4096 elements may be as long."""

TEXTS = ("camera", "lens", "samples")
"""What a file has as JSON texts."""


@dataclasses.dataclass(frozen=True)
class Header:
    """What a file says of its samples as a whole.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``camera``, ``lens``          the pinhole that took them, the lens that came with it
    ``window``                    pixels of the film that were sampled
    ``surfaces``                  name of every surface id
    ``lattice``                   positions are multiples of 1/lattice pixels; 0 for any
    ``visibility_radius``         half-widths of the lens of which samples have visibility, or
                                  ``None``
    ``provenance``                how the samples were made
    ============================  ==========================================================

    Raises ``ValueError`` or ``TypeError`` that names the field for a crop window that goes beyond
    ``window``, and where :func:`.usable.require_usable_together` does.
    """

    camera: Camera
    lens: ThinLens | TelecentricLens
    window: Window
    surfaces: Mapping[int, str]
    lattice: int
    visibility_radius: Sequence[float] | None = None
    provenance: Provenance = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        require_whole("lattice", self.lattice, 0, 1 << 16)
        for half_width in self.visibility_radius or ():
            require_magnitude("visibility_radius", half_width)
        crop = Window(*self.camera.crop_offset, *self.camera.crop_size)
        if not self.window.covers(crop):
            raise ValueError(
                f"crop window {tuple(crop)}: must lie in the window {tuple(self.window)} that was "
                "sampled"
            )
        require_usable_together(self.camera, self.lens)

    def texts(self, version: int) -> dict[str, str]:
        """``camera``, ``lens`` and ``samples`` as JSON, for a file of that version."""
        about: dict[str, Any] = {"version": version, "lattice": self.lattice}
        if self.visibility_radius is not None:
            about["visibility_radius"] = list(self.visibility_radius)
        if self.provenance:
            about["provenance"] = dict(self.provenance)
        values = {"camera": self.camera.to_dict(), "lens": self.lens.to_dict(), "samples": about}
        return {name: json.dumps(value) for name, value in values.items()}

    @classmethod
    def parse(
        cls,
        texts: Mapping[str, Any],
        names: str,
        latest: int,
        window: Window,
        surfaces: Mapping[int, str],
    ) -> tuple[Header, int]:
        """The header of what :meth:`texts` gave, and the version of the file, 1 to ``latest``.

        ``names`` is what the file calls the texts, with {} for each one's name. Raises
        ``ValueError`` or ``TypeError`` that says these and what is wrong.
        """
        values = {name: json_object(texts[name], names.format(name)) for name in TEXTS}
        about = values["samples"]
        radius = about.pop("visibility_radius", None)
        provenance = checked_provenance(about.pop("provenance", {}))
        if about.keys() != {"version", "lattice"}:
            name = names.format("samples")
            raise ValueError(f"{name}: must be a JSON object with lattice, version")
        if radius is not None:
            require_visibility_radius(radius, True)
        version = about["version"]
        if isinstance(version, bool) or version not in range(1, latest + 1):
            earlier = ", ".join(map(str, range(1, latest)))
            raise ValueError(
                f"version {version}: must be {earlier + ' or ' if earlier else ''}{latest}"
            )
        header = cls(
            Camera.from_dict(values["camera"]),
            lens_of_header(values["lens"]),
            window,
            surfaces,
            about["lattice"],
            None if radius is None else (float(radius[0]), float(radius[1])),
            provenance,
        )
        return header, version


def json_object(text: Any, name: str) -> dict[str, Any]:
    """The JSON object that a text is; ``ValueError`` that says its ``name`` for anything else."""
    if not isinstance(text, str) or len(text) > LONGEST_JSON:
        raise ValueError(f"{name}: must be text of at most {LONGEST_JSON} characters")
    try:
        values = json.loads(text, parse_constant=_infinity)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{name}: is not JSON: {error}") from error
    if not isinstance(values, dict):
        raise ValueError(f"{name}: must be a JSON object")
    return values


def _infinity(text: str) -> float:
    """What JSON has no word for and Python writes; NaN is nowhere a value."""
    if text == "NaN":
        raise ValueError("NaN is not a number that is allowed")
    return float(text)


def lens_of_header(values: dict[str, Any]) -> ThinLens | TelecentricLens:
    """The lens of a header, whose aperture names no file."""
    for name, value in values.items():
        if not isinstance(value, (str, int, float)) or isinstance(value, bool):
            raise ValueError(f"{name}={str(value)[:80]}: must be a number or text")
    if "aperture" in values:
        values = {**values, "aperture": Aperture.parse(values["aperture"], from_file=True)}
    kind = values.get("type")
    if kind is None:
        return ThinLens.from_dict(values)
    if kind != TYPE:
        raise ValueError(f"type={kind!r}: must be {TYPE}, or not be there for a thin lens")
    return TelecentricLens.from_dict(values)
