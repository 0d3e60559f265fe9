"""One picture through the lens, in Dr.Jit, attached to what has gradients."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import torch

from .. import _backend as jit
from ..focusing.film import ReconstructionFilter
from ..focusing.memo import Memo
from ..focusing.methods import Method
from ..focusing.session import form_picture
from ..optics.lens import ThinLens
from ..samples.circles import FOCUS
from ..samples.image_layers import Hidden
from ..samples.point_samples import PointSamples
from .exchange import channels_first, channels_last, to_drjit, to_torch

PARAMETERS = ("focus_distance", "f_number", "focal_length")
"""Those of a lens that are differentiable."""

NAMES = ("rgb", "depth", *PARAMETERS)
"""All that is differentiable, in the order in which it is given."""

_warned_of: set[str] = {FOCUS}
"""What users have been warned of: a network calls over and over, and each is told once. A focus
where nothing is, is no mistake on the way of an optimiser.
"""


@dataclasses.dataclass(frozen=True)
class Options:
    """How pictures are formed.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``fixed``                     parameters of :class:`potmesil_mi.ThinLens` that are not
                                  differentiated
    ``method``                    the method, with its options
    ``antialiased``, ``hidden``   how pictures become samples, see
                                  :meth:`potmesil_mi.PointSamples.from_image`
    ``rfilter``                   the film's reconstruction filter
    ============================  ==========================================================
    """

    fixed: Mapping[str, Any]
    method: Method
    antialiased: bool
    hidden: Hidden
    rfilter: ReconstructionFilter | None


@dataclasses.dataclass(frozen=True)
class Formed:
    """A picture, (H, W, 3), and by name the Dr.Jit arrays that it is attached to."""

    picture: Any
    leaves: Mapping[str, Any]

    def numbers(self, device: torch.device) -> torch.Tensor:
        """The picture, (3, H, W)."""
        return channels_first(to_torch(self.picture.array, self.picture.shape, device))

    def gradients(self, gradient: torch.Tensor) -> dict[str, torch.Tensor]:
        """By name the gradients of what it is attached to, for that of the picture, (3, H, W).

        They have the shapes that :func:`form` was given. The graph is kept, so one may ask again.
        """
        import drjit as dr

        for leaf in self.leaves.values():
            dr.clear_grad(leaf)
        if dr.grad_enabled(self.picture):
            numbers = to_drjit(channels_last(gradient))
            dr.set_grad(self.picture, jit.TensorXf(numbers, self.picture.shape))
            dr.enqueue(dr.ADMode.Backward, self.picture)
            dr.traverse(dr.ADMode.Backward, dr.ADFlag.ClearInterior | dr.ADFlag.ClearInput)
        height, width, channels = self.picture.shape
        shapes = {"rgb": (height, width, channels), "depth": (1, height, width)}
        found = {
            name: to_torch(dr.grad(leaf), shapes.get(name, ()), gradient.device)
            for name, leaf in self.leaves.items()
        }
        if "rgb" in found:
            found["rgb"] = channels_first(found["rgb"])
        return found


def form(
    rgb: torch.Tensor,
    depth: torch.Tensor,
    parameters: Mapping[str, float],
    attached: Sequence[str],
    options: Options,
) -> Formed:
    """The picture of ``rgb``, (3, H, W), and ``depth``, (1, H, W), attached to the ``attached``."""
    rgb, depth = channels_last(rgb), depth[0]
    leaves: dict[str, Any] = {}
    if attached:
        import drjit as dr

        _require_derivatives(attached)
        pictures = {"rgb": rgb, "depth": depth}
        for name in attached:
            if name in pictures:
                leaves[name] = to_drjit(pictures[name])
            else:
                leaves[name] = jit.Float(parameters[name])
        dr.enable_grad(leaves)
    given: dict[str, Any] = {**parameters, **options.fixed}
    plain = ThinLens(**given)
    samples = PointSamples.from_image(
        _image(rgb, leaves.get("rgb")),
        _image(depth, leaves.get("depth")),
        camera=plain.fov,
        lens=plain,
        depth_kind="z",
        antialiased=options.antialiased,
        hidden=options.hidden,
    )
    memo = Memo()
    memo.warned_of |= _warned_of
    lens = _attached_lens(plain, {name: leaves[name] for name in PARAMETERS if name in leaves})
    picture = form_picture(samples, lens, options.method, memo, None, options.rfilter, False, ())
    _warned_of.update(memo.warned_of)
    return Formed(picture, leaves)


def _attached_lens(lens: ThinLens, leaves: Mapping[str, Any]) -> ThinLens:
    """The lens with gradients.

    The camera's field of view follows the focal length, while samples stay in their pixels: then
    circles grow with the distance of the film in pixels as they do with the aperture.
    """
    if not leaves:
        return lens
    attached = lens.replace(**leaves)
    if "focal_length" in leaves:
        wider = attached.film_distance / lens.film_distance
        attached = attached.replace(aperture_radius=attached.aperture_radius * wider)
    return attached


def _image(image: torch.Tensor, leaf: Any) -> Any:
    """A picture or its depth as samples are made of it: a tensor of Dr.Jit for one of a leaf."""
    return image.cpu().numpy() if leaf is None else jit.TensorXf(leaf, tuple(image.shape))


def _require_derivatives(attached: Sequence[str]) -> None:
    """Raise ``RuntimeError`` while a variant is set that differentiates nothing."""
    import drjit as dr

    if not dr.is_diff_v(jit.Float):
        raise RuntimeError(
            f"{', '.join(attached)}: has requires_grad, but mi.variant() is {jit.variant()}, "
            "which has no derivatives; must be one such as llvm_ad_rgb"
        )
