"""What ``focus`` and ``point_samples`` share: an integrator around another one."""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi
import numpy as np

from ..hidden_surface import Sampling


def nested_integrator(props: mi.Properties, plugin: str) -> mi.SamplingIntegrator:
    """The one integrator in ``props``; ``ValueError`` for none or several."""
    nested = [child for _, child in props.objects() if isinstance(child, mi.Integrator)]
    if len(nested) != 1:
        raise ValueError(f"{plugin}: needs exactly one nested integrator, {len(nested)} were given")
    if not isinstance(nested[0], mi.SamplingIntegrator):
        raise TypeError(f"{plugin}: {nested[0].class_name()} is not a sampling integrator")
    return nested[0]


def sampling_parameters(props: mi.Properties) -> Sampling:
    """The sampling pattern that ``props`` ask for."""
    return Sampling(
        **{name: props[name] for name in ("pattern", "threshold", "subdivisions") if name in props}
    )


def put_picture(
    film: mi.Film,
    picture: np.ndarray,
    extra: np.ndarray,
    aovs: Sequence[str],
    develop: bool,
) -> mi.TensorXf:
    """Put a picture into the film as if it had been rendered.

    ``picture``, (height, width, 3 or 4), is RGB with alpha if the film has it; ``extra``, with
    the channels that ``aovs`` names, follows the weight, which is 1. Returns what the film makes
    of it, or an empty tensor where ``develop`` is False.
    """
    film.clear()
    film.prepare(list(aovs))
    weight = np.ones_like(picture[..., :1])
    tensor = np.concatenate([picture, weight, extra], axis=-1).astype(np.float32)
    film.put_block(mi.ImageBlock(mi.TensorXf(tensor), film.crop_offset(), border=False))
    return film.develop() if develop else mi.TensorXf()
