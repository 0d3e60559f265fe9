"""In which parameters of a scene a picture through a lens is to be differentiated."""

from __future__ import annotations

import dataclasses
from typing import Any

import drjit as dr
import mitsuba as mi

from ..optics.lens import ThinLens
from ..tracing.sensor import potmesil_sensor

LENS_PARAMETERS = ("focus_distance", "f_number", "aperture_radius")
"""Parameters of a sensor in which pictures have derivatives, by way of the lens."""


@dataclasses.dataclass(frozen=True)
class Wanted:
    """The parameters of a scene that have gradients enabled.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``lens``                      those of the sensor's lens, with their values
    ``scene``                     names of those that the radiance of samples depends on
    ============================  ==========================================================
    """

    lens: dict[str, Any]
    scene: list[str]

    @classmethod
    def of(cls, scene: mi.Scene, sensor: mi.Sensor) -> Wanted:
        """Those of ``scene`` as ``sensor`` sees it.

        Raises ``NotImplementedError`` for one in which pictures have no derivative: what moves,
        turns or changes its shape changes the depths of samples, and which of them there are.
        """
        parameters, names = mi.traverse(scene), []
        for name, value in parameters:
            node = parameters.properties[name][2]
            if isinstance(node, mi.Sensor) or not dr.grad_enabled(value):
                continue
            if isinstance(node, mi.Shape) and parameters.flags(name) & mi.ParamFlags.Discontinuous:
                raise NotImplementedError(
                    f"{name}: has gradients enabled, but pictures through a lens have no "
                    "derivative in where shapes are; detach it, as by dr.detach"
                )
            names.append(name)
        return cls(_of_lens(sensor), names)

    def __bool__(self) -> bool:
        return bool(self.lens or self.scene)

    def attached(self, lens: Any) -> Any:
        """The ``lens`` with the parameters that have gradients."""
        return lens.replace(**self.lens) if self.lens else lens


def _of_lens(sensor: mi.Sensor) -> dict[str, Any]:
    """The parameters of a sensor's lens that have gradients enabled."""
    enabled = {
        name: value
        for name, value in mi.traverse(sensor)
        if "." not in name and dr.grad_enabled(value)
    }
    if not enabled:
        return enabled
    lens = potmesil_sensor(sensor).lens()
    for name in enabled:
        if not (isinstance(lens, ThinLens) and name in LENS_PARAMETERS):
            raise NotImplementedError(
                f"{name}: has gradients enabled, but pictures through a lens have no derivative in "
                f"where the camera is and what it sees; of a sensor with a thin lens they have it "
                f"in {', '.join(LENS_PARAMETERS)}"
            )
    if "focus_distance" in enabled and lens.film != "focal":
        raise NotImplementedError(
            "focus_distance: has gradients enabled, but with image_distance=focused the field of "
            "view depends on it, in which pictures have no derivative; image_distance=focal has one"
        )
    return enabled
