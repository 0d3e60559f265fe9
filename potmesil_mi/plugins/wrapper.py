"""What ``focus`` and ``point_samples`` share: an integrator around another one."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NoReturn

import mitsuba as mi
import numpy as np

from .._backend import require_vectorised_variant
from ..tracing.sampling import Sampling
from ..tracing.sensor import pick_sensor
from .settings import motion_from

if TYPE_CHECKING:
    from ..samples.point_samples import PointSamples


class WrapperIntegrator(mi.CppADIntegrator):
    """Takes point samples with the one integrator nested in it.

    Raises ``ValueError`` unless exactly one is nested, ``TypeError`` if it does not sample rays,
    ``RuntimeError`` in scalar variants.
    """

    plugin: str
    """The name under which Mitsuba knows it."""

    def __init__(self, props: mi.Properties) -> None:
        from ..tracing.hidden_surface import WrappingIntegrator

        super().__init__(props)
        require_vectorised_variant(self.plugin)
        nested = [child for _, child in props.objects() if isinstance(child, mi.Integrator)]
        if len(nested) != 1:
            raise ValueError(
                f"{self.plugin}: needs exactly one nested integrator, {len(nested)} were given"
            )
        self.nested = nested[0]
        wrapping = isinstance(nested[0], WrappingIntegrator)
        if wrapping or not isinstance(self.nested, mi.SamplingIntegrator):
            raise TypeError(
                f"{self.plugin}: the nested integrator must be a sampling integrator, such as "
                f"path, not {self.nested.class_name()}"
            )
        names = [field.name for field in dataclasses.fields(Sampling)]
        self.sampling = Sampling(**{name: props[name] for name in names if name in props})
        self.motion = motion_from(props)

    def form(self, samples: PointSamples, film: mi.Film) -> tuple[np.ndarray, np.ndarray]:
        """What the film is to show: RGB (A), and the channels that ``aov_names`` names."""
        raise NotImplementedError

    def nested_aovs(self) -> tuple[str, ...]:
        """Names of the AOVs of the nested integrator that samples keep."""
        from ..tracing.aovs import Aovs

        return Aovs.of(self.nested).names

    def film_sampling(self) -> Sampling:
        """What is sampled where the film alone is asked for."""
        return self.sampling

    def check_sensor(self, sensor: mi.Sensor) -> None:
        """Raise ``TypeError`` for a sensor that cannot be used; any can by default."""

    def render(
        self,
        scene: mi.Scene,
        sensor: int | mi.Sensor = 0,
        seed: Any = 0,
        spp: int = 0,
        develop: bool = True,
        evaluate: bool = True,
    ) -> mi.TensorXf:
        """Take the samples, form the picture, and put it into the film as if rendered there."""
        from ..tracing.hidden_surface import render_samples

        sensor = pick_sensor(scene, sensor)
        self.check_sensor(sensor)
        samples = render_samples(
            scene,
            sensor,
            self.nested,
            spp=spp,
            seed=int(np.array(seed).ravel()[0]),
            sampling=self.film_sampling(),
            motion=self.motion,
        )
        film = sensor.film()
        picture, extra = self.form(samples, film)
        film.clear()
        film.prepare(self.aov_names())
        channels = [picture, np.ones_like(picture[..., :1]), extra]
        tensor = mi.TensorXf(np.concatenate(channels, axis=-1).astype(np.float32))
        film.put_block(mi.ImageBlock(tensor, film.crop_offset(), border=False))
        return film.develop() if develop else mi.TensorXf()

    def render_forward(self, *_: Any, **__: Any) -> NoReturn:
        """Not there yet: raises ``NotImplementedError``."""
        raise NotImplementedError(f"{self.plugin}: derivatives are not implemented yet")

    render_backward = render_forward


def stacked(planes: Mapping[str, np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
    """The channels of a picture of a ``shape``, (height, width, number of ``planes``)."""
    channels = [plane[..., None] for plane in planes.values()]
    return np.concatenate([np.empty((*shape, 0)), *channels], axis=-1)
