"""What ``focus`` and ``point_samples`` share: an integrator around another one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NoReturn

import mitsuba as mi
import numpy as np

from ..hidden_surface import Sampling, render_samples
from ..samples import PointSamples
from ..scene import require_vectorised_variant


class WrapperIntegrator(mi.CppADIntegrator):
    """Takes point samples with the one integrator nested in it.

    Raises ``ValueError`` unless exactly one is nested, ``TypeError`` if it does not sample rays,
    ``RuntimeError`` in scalar variants.
    """

    plugin: str

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        require_vectorised_variant(self.plugin)
        nested = [child for _, child in props.objects() if isinstance(child, mi.Integrator)]
        if len(nested) != 1:
            raise ValueError(
                f"{self.plugin}: needs exactly one nested integrator, {len(nested)} were given"
            )
        self.nested = nested[0]
        if not isinstance(self.nested, mi.SamplingIntegrator) or hasattr(self.nested, "nested"):
            raise TypeError(
                f"{self.plugin}: the nested integrator must be a sampling integrator, such as "
                f"path, not {self.nested.class_name()}"
            )
        names = ("pattern", "threshold", "subdivisions")
        self.sampling = Sampling(**{name: props[name] for name in names if name in props})

    def samples(self, scene: mi.Scene, sensor: mi.Sensor, seed: Any, spp: int) -> PointSamples:
        """The point samples of one rendering."""
        seed = int(np.array(seed).ravel()[0])
        return render_samples(
            scene, sensor, self.nested, spp=spp, seed=seed, sampling=self.sampling
        )

    def put_picture(
        self,
        film: mi.Film,
        picture: np.ndarray,
        extra: np.ndarray | None = None,
        aovs: Sequence[str] = (),
        develop: bool = True,
    ) -> mi.TensorXf:
        """Put a picture into the film as if it had been rendered.

        ``picture``, (height, width, 3 or 4), is RGB with alpha if the film has it; ``extra``,
        with the channels that ``aovs`` names, follows the weight, which is 1. Returns what the
        film makes of it, or an empty tensor where ``develop`` is False.
        """
        film.clear()
        film.prepare(list(aovs))
        channels = [picture, np.ones_like(picture[..., :1])]
        if extra is not None:
            channels.append(extra)
        tensor = mi.TensorXf(np.concatenate(channels, axis=-1).astype(np.float32))
        film.put_block(mi.ImageBlock(tensor, film.crop_offset(), border=False))
        return film.develop() if develop else mi.TensorXf()

    def render_forward(self, *_: Any, **__: Any) -> NoReturn:
        """Not there yet: raises ``NotImplementedError``."""
        raise NotImplementedError(f"{self.plugin}: derivatives are not implemented yet")

    render_backward = render_forward
