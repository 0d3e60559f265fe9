"""Numbers from torch to Dr.Jit and back: by DLPack, and without a copy where there need be none."""

from __future__ import annotations

from typing import Any

import torch

from .. import _backend as jit


def to_drjit(tensor: torch.Tensor) -> Any:
    """The numbers of a float32 tensor as a Dr.Jit array (N,), row by row, without gradients.

    A GPU's memory is shared. A CPU's is copied: Dr.Jit would compile each kernel for how the
    memory of torch happens to be aligned.
    """
    import drjit as dr

    flat = tensor.detach().contiguous().view(-1)
    if flat.is_cuda and dr.backend_v(jit.Float) == dr.JitBackend.CUDA:
        return jit.Float(jit.TensorXf(flat).array)
    return jit.from_numpy(jit.Float, flat.cpu().numpy())


def to_torch(array: Any, shape: tuple[int, ...], device: torch.device) -> torch.Tensor:
    """The numbers of a Dr.Jit array as a float32 tensor of a shape, on a device.

    Memory is shared where the array is on that device, so what is to stay is copied.
    """
    import drjit as dr

    return jit.TensorXf(dr.detach(array), shape).torch().to(device)


def channels_last(picture: torch.Tensor) -> torch.Tensor:
    """A picture (C, H, W) of torch as the focus stage has it: (H, W, C)."""
    return picture.permute(1, 2, 0)


def channels_first(picture: torch.Tensor) -> torch.Tensor:
    """A picture (H, W, C) of the focus stage as torch has it: (C, H, W)."""
    return picture.permute(2, 0, 1)
