"""Checks of what :func:`potmesil_mi.torch.focus` is given."""

from __future__ import annotations

from numbers import Real
from typing import Any

import torch

from .._validation import shown


def require_pictures(rgb: Any, depth: Any) -> None:
    """Raise ``TypeError`` or ``ValueError`` unless these are a batch of pictures with depth."""
    for name, tensor, channels in (("rgb", rgb, 3), ("depth", depth, 1)):
        shape = f"(B, {channels}, H, W)"
        if isinstance(tensor, (list, tuple)):
            raise TypeError(
                f"{name}=a {type(tensor).__name__} of {len(tensor)}: must be one tensor {shape}; "
                "pictures of several sizes are no batch, and take a call each"
            )
        if not isinstance(tensor, torch.Tensor):
            raise TypeError(f"{name}={shown(tensor)}: must be a tensor {shape}")
        if not tensor.is_floating_point():
            raise TypeError(f"{name}: has type {tensor.dtype}, must be floats")
        if tensor.ndim != 4 or tensor.shape[1] != channels or tensor.numel() == 0:
            raise ValueError(f"{name}: has shape {tuple(tensor.shape)}, must be {shape}")
    if rgb.shape[0] != depth.shape[0] or rgb.shape[2:] != depth.shape[2:]:
        raise ValueError(
            f"depth: has shape {tuple(depth.shape)}, must be {(len(rgb), 1, *rgb.shape[2:])}, as "
            f"rgb is {tuple(rgb.shape)}"
        )
    if rgb.device != depth.device:
        raise ValueError(f"depth: is on {depth.device}, must be on {rgb.device}, as rgb is")
    valid = depth.detach() > 0
    if not bool(valid.all()):
        i, _, row, column = (~valid).nonzero()[0].tolist()
        wrong = depth[i, 0, row, column].item()
        raise ValueError(
            f"depth: {int((~valid).sum())} of {valid.numel()} pixels are out of bounds, the first "
            f"in picture {i} at row {row}, column {column}: {wrong}; must be > 0 scene units, or "
            "inf where nothing is"
        )


def for_each_picture(name: str, value: Any, count: int) -> torch.Tensor:
    """A parameter of the lens as a tensor (count,). Raise where it is none, or of other pictures.

    Numbers that are no tensor are float64, so that they stay what they are.
    """
    allowed = f"a number, or a tensor of one or of {count}, as many as there are pictures"
    if isinstance(value, torch.Tensor):
        if value.dtype == torch.bool or value.is_complex():
            raise TypeError(f"{name}: has type {value.dtype}, must be {allowed}")
        if value.shape not in ((), (count,)):
            raise ValueError(f"{name}: has shape {tuple(value.shape)}, must be () or ({count},)")
        return value.expand(count)
    if isinstance(value, bool) or not isinstance(value, Real):
        raise TypeError(f"{name}={shown(value)}: must be {allowed}")
    return torch.full((count,), float(value), dtype=torch.float64)
