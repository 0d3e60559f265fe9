"""What ``focus`` and ``point_samples`` share: an integrator around another one."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .._backend import require_vectorised_variant
from ..tracing.sampling import Sampling
from ..tracing.sensor import pick_sensor
from .derivatives import Wanted
from .settings import motion_from

if TYPE_CHECKING:
    from ..samples.point_samples import PointSamples
    from ..tracing.replay import Replay


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

    def form_attached(
        self, samples: PointSamples, rgb: mi.TensorXf, lens: Any, film: mi.Film
    ) -> mi.TensorXf:
        """RGB (A) that the film is to show, of samples with this ``rgb`` and through this ``lens``.

        It has derivatives in those of the two that have gradients enabled.
        """
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
        sensor = pick_sensor(scene, sensor)
        self.check_sensor(sensor)
        samples, film = self._sampled(scene, sensor, seed, spp), sensor.film()
        picture, extra = self.form(samples, film)
        tensor = self._put(film, *(mi.TensorXf(of.astype(np.float32)) for of in (picture, extra)))
        return tensor if develop else mi.TensorXf()

    def render_forward(
        self,
        scene: mi.Scene,
        params: Any,
        sensor: int | mi.Sensor = 0,
        seed: Any = 0,
        spp: int = 0,
    ) -> mi.TensorXf:
        """The derivative of the picture, for gradients that parameters of the scene have.

        ``params`` is what the nested integrator is given. Those of materials, textures and lights
        reach it by way of the radiance of samples, of which the nested integrator knows the
        derivative; those of the lens by way of the focus. AOVs count as constant. Raises
        ``NotImplementedError`` where there is no derivative, ``ValueError`` for a parameter of this
        integrator that stands in its way.
        """
        image, rgb, replay = self._attached(scene, sensor, seed, spp)
        if replay is not None:
            dr.set_grad(rgb, replay.forward(params))
        if not dr.grad_enabled(image):
            return dr.zeros(mi.TensorXf, image.shape)
        dr.forward_to(image)
        return dr.grad(image)

    def render_backward(
        self,
        scene: mi.Scene,
        params: Any,
        grad_in: mi.TensorXf,
        sensor: int | mi.Sensor = 0,
        seed: Any = 0,
        spp: int = 0,
    ) -> None:
        """Add to the gradients of the scene's parameters what that of the picture brings them.

        It is as :meth:`render_forward` has it the other way round.
        """
        image, rgb, replay = self._attached(scene, sensor, seed, spp)
        if not dr.grad_enabled(image):
            return
        dr.set_grad(image, grad_in)
        dr.enqueue(dr.ADMode.Backward, image)
        dr.traverse(dr.ADMode.Backward)
        if replay is not None:
            replay.backward(params, dr.grad(rgb))

    def check_differentiable(self, samples: PointSamples) -> None:
        """Raise ``ValueError`` that names a parameter with which there are no derivatives.

        ``samples`` are those of the picture.
        """
        if self.sampling.clamp is not None:
            raise ValueError(
                f"clamp={self.sampling.clamp}: must not be given where parameters of the scene "
                "have gradients, for what is clamped does not tell how bright it is"
            )

    def _attached(
        self, scene: mi.Scene, sensor: int | mi.Sensor, seed: Any, spp: int
    ) -> tuple[mi.TensorXf, mi.TensorXf, Replay | None]:
        """The picture with its derivatives in the radiance of samples, and in the lens.

        Returns it, that radiance, (N, 3), and the replay of the samples where parameters that it
        depends on have gradients enabled. The samples are taken anew, for the scene may have
        changed since its picture was rendered.
        """
        from ..tracing.replay import Replay

        sensor = pick_sensor(scene, sensor)
        self.check_sensor(sensor)
        wanted, film = Wanted.of(scene, sensor), sensor.film()
        samples, replay = self._sampled(scene, sensor, seed, spp), None
        if wanted:
            self.check_differentiable(samples)
        rgb = mi.TensorXf(samples.rgb)
        if wanted.scene:
            count = {"spp": spp, "seed": _whole(seed)}
            replay = Replay.of(scene, sensor, self.nested, samples, **count)
            dr.enable_grad(rgb)
        picture = self.form_attached(samples, rgb, wanted.attached(samples.lens), film)
        if dr.grad_enabled(rgb) and not dr.grad_enabled(picture):
            raise NotImplementedError(
                f"{self.plugin}: the picture has no derivatives in the radiance of samples"
            )
        extra = dr.zeros(mi.TensorXf, (*picture.shape[:2], len(self.aov_names())))
        return self._put(film, picture, extra), rgb, replay

    def _sampled(self, scene: mi.Scene, sensor: mi.Sensor, seed: Any, spp: int) -> PointSamples:
        """The samples of which the film shows a picture."""
        from ..tracing.hidden_surface import render_samples

        return render_samples(
            scene,
            sensor,
            self.nested,
            spp=spp,
            seed=_whole(seed),
            sampling=self.film_sampling(),
            motion=self.motion,
        )

    def _put(self, film: mi.Film, picture: mi.TensorXf, extra: mi.TensorXf) -> mi.TensorXf:
        """Put a picture and what is beside it into the film; returns what the film makes of it."""
        film.clear()
        film.prepare(self.aov_names())
        weight = dr.ones(mi.TensorXf, (*picture.shape[:2], 1))
        # Dr.Jit cannot join what has no channels.
        tensor = dr.concat([picture, weight, *([extra] if extra.shape[2] else [])], axis=2)
        film.put_block(mi.ImageBlock(tensor, film.crop_offset(), border=False))
        return film.develop()


def _whole(seed: Any) -> int:
    """A seed as Mitsuba gives it, a number or an array of one, as a Python number."""
    return int(np.array(seed).ravel()[0])


def stacked(planes: Mapping[str, np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
    """The channels of a picture of a ``shape``, (height, width, number of ``planes``)."""
    channels = [plane[..., None] for plane in planes.values()]
    return np.concatenate([np.empty((*shape, 0)), *channels], axis=-1)
