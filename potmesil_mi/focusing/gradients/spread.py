"""Spreading with gradients: the transpose of a convolution is the correlation."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from ... import _backend as jit
from ..blocks import BlockImage
from ..convolve import spread, spread_back
from ..fragments import as_column
from .splat import SmoothImages


class _Spread(dr.CustomOp):
    """The light of images, each spread by its kernel: linear in the images.

    ``images``, which says how they are stored, has no gradients.
    """

    def eval(
        self, colours: jit.Float, alpha: jit.Float | None, images: SmoothImages
    ) -> tuple[jit.Float, jit.Float | None]:
        self.images, self.has_alpha = images, alpha is not None
        return self._spread(colours, alpha)

    def _spread(
        self, colours: jit.Float, alpha: jit.Float | None
    ) -> tuple[jit.Float, jit.Float | None]:
        stack = self.images.stack
        stored = stack.stored([colours] if alpha is None else [colours, alpha])
        blocks = [BlockImage(stack.box.shape, number, stored) for number in stack.number]
        light = spread(blocks, self.images.kernels)
        return as_column(light[..., :4]), as_column(light[..., 4]) if alpha is not None else None

    def forward(self) -> None:
        grads = self.grad_in("colours"), self.grad_in("alpha") if self.has_alpha else None
        self.set_grad_out(self._spread(*grads))

    def backward(self) -> None:
        colours, alpha = self.grad_out()
        stack = self.images.stack
        height, width = stack.box.shape
        parts = [np.array(colours).reshape(height, width, 4)]
        if self.has_alpha:
            parts.append(np.array(alpha).reshape(height, width, 1))
        found = spread_back(
            np.concatenate(parts, axis=2), self.images.kernels, stack.number, stack.block_count
        )
        self.set_grad_in("colours", as_column(found[..., :4]))
        if self.has_alpha:
            self.set_grad_in("alpha", as_column(found[..., 4]))

    def name(self) -> str:
        return "spread"


def light_of(images: SmoothImages) -> tuple[jit.Float, jit.Float | None]:
    """The light of images: RGB and share of the pixels of their box, interleaved, and alpha."""
    stack = images.stack
    result: Any = dr.custom(_Spread, stack.colours, stack.alpha, images)
    return result[0], result[1]
