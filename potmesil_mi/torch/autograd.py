"""The focus stage as a function that torch differentiates once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch

from .forming import NAMES, PARAMETERS, Formed, Options, form

NO_SECOND = (
    "potmesil_mi.torch.focus: has no second derivatives (double backward), which create_graph=True "
    "asks for; detach its gradients before they are differentiated"
)


class Focus(torch.autograd.Function):
    """Pictures (B, 3, H, W) of ``NAMES``: (B, 3, H, W), (B, 1, H, W), and parameters (B,).

    The graph of Dr.Jit is kept with the saved tensors, so torch gives it up when it gives up these:
    after a backward that is not to retain it. Where hooks, as of checkpoints, bring the tensors
    back without it, pictures are formed again.
    """

    @staticmethod
    def forward(
        ctx: Any, options: Options, attached: Sequence[str], *tensors: torch.Tensor
    ) -> torch.Tensor:
        """The pictures, attached to what the names in ``attached`` say."""
        formed = _form_each(options, attached, tensors)
        if attached:
            keeper = torch.empty(0)
            keeper.formed = formed
            ctx.options, ctx.attached = options, attached
            ctx.save_for_backward(keeper, *tensors)
        return torch.stack([of.numbers(tensors[0].device) for of in formed])

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        """The gradients of all that was given, for that of the pictures."""
        keeper, *tensors = ctx.saved_tensors
        formed = getattr(keeper, "formed", None)
        if formed is None:
            formed = _form_each(ctx.options, ctx.attached, tensors)
        each = [of.gradients(own) for of, own in zip(formed, gradient, strict=True)]
        gradients: list[torch.Tensor | None] = []
        for name, tensor in zip(NAMES, tensors, strict=True):
            if name in ctx.attached:
                own = torch.stack([found[name] for found in each])
                gradients.append(own.to(tensor.device, tensor.dtype))
            else:
                gradients.append(None)
        if torch.is_grad_enabled():  # What create_graph=True asks for.
            gradients = _differentiated_once(tensors, gradients)
        return None, None, *gradients


class _Once(torch.autograd.Function):
    """The last ``count`` of some tensors, which depend on all, and cannot be differentiated."""

    @staticmethod
    def forward(ctx: Any, count: int, *tensors: torch.Tensor) -> tuple[torch.Tensor, ...]:
        return tensors[-count:]

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> None:
        raise NotImplementedError(NO_SECOND)


def _differentiated_once(
    tensors: Sequence[torch.Tensor], gradients: Sequence[torch.Tensor | None]
) -> list[torch.Tensor | None]:
    """The gradients, whose own are refused by name, and not taken for zero."""
    there = [gradient for gradient in gradients if gradient is not None]
    refusing = iter(_Once.apply(len(there), *tensors, *there))
    return [None if gradient is None else next(refusing) for gradient in gradients]


def _form_each(
    options: Options, attached: Sequence[str], tensors: Sequence[torch.Tensor]
) -> list[Formed]:
    """The pictures of a batch. Raises ``ValueError`` that says of which one it is."""
    rgb, depth, *parameters = (tensor.detach() for tensor in tensors)
    pictures = []
    for i, (image, its_depth, *numbers) in enumerate(zip(rgb, depth, *parameters, strict=True)):
        lens = {name: float(n) for name, n in zip(PARAMETERS, numbers, strict=True)}
        try:
            pictures.append(form(image, its_depth, lens, attached, options))
        except ValueError as error:
            if len(rgb) == 1:
                raise
            raise ValueError(f"picture {i} of the batch: {error}") from error
    return pictures
