"""Spreading with gradients: the transpose of a convolution is the correlation."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from ... import _backend as jit
from ...optics.convolution import correlations
from ..blocks import BlockImage
from ..convolve import spread, spread_back
from ..fragments import as_column
from .opening import parted
from .splat import SmoothImages


class _Spread(dr.CustomOp):
    """The light of images, each spread by its kernel: linear in the images, and in the kernels.

    ``images``, which says how images are stored, has no gradients. If kernels have some,
    ``numbers`` are those of all of them, and ``shapes`` their rows and columns.
    """

    def eval(
        self,
        colours: jit.Float,
        alpha: jit.Float | None,
        numbers: jit.Float | None,
        images: SmoothImages,
        shapes: list[tuple[int, int]] | None,
    ) -> tuple[jit.Float, jit.Float | None]:
        self.images, self.shapes, self.has_alpha = images, shapes, alpha is not None
        if shapes is not None:
            self.plain = self._blocks(colours, alpha)
        return self._light(spread(self._blocks(colours, alpha), images.kernels))

    def _blocks(self, colours: jit.Float, alpha: jit.Float | None) -> list[BlockImage]:
        """The images whose blocks are given."""
        stack = self.images.stack
        stored = stack.stored([colours] if alpha is None else [colours, alpha])
        return [BlockImage(stack.box.shape, number, stored) for number in stack.number]

    def _light(self, light: np.ndarray) -> tuple[jit.Float, jit.Float | None]:
        return as_column(light[..., :4]), as_column(light[..., 4]) if self.has_alpha else None

    def forward(self) -> None:
        grads = self.grad_in("colours"), self.grad_in("alpha") if self.has_alpha else None
        light = spread(self._blocks(*grads), self.images.kernels)
        if self.shapes is not None:
            light += spread(self.plain, parted(np.array(self.grad_in("numbers")), self.shapes))
        self.set_grad_out(self._light(light))

    def backward(self) -> None:
        colours, alpha = self.grad_out()
        stack = self.images.stack
        height, width = stack.box.shape
        parts = [np.array(colours).reshape(height, width, 4)]
        if self.has_alpha:
            parts.append(np.array(alpha).reshape(height, width, 1))
        light = np.concatenate(parts, axis=2)
        if self.shapes is not None:
            dense = (image.dense() for image in self.plain)
            of_kernels = correlations(light, dense, self.shapes)
            numbers = np.concatenate([kernel.ravel() for kernel in of_kernels])
            self.set_grad_in("numbers", as_column(numbers))
        found = spread_back(light, self.images.kernels, stack.number, stack.block_count)
        self.set_grad_in("colours", as_column(found[..., :4]))
        if self.has_alpha:
            self.set_grad_in("alpha", as_column(found[..., 4]))

    def name(self) -> str:
        return "spread"


def light_of(images: SmoothImages) -> tuple[jit.Float, jit.Float | None]:
    """The light of images: RGB and share of the pixels of their box, interleaved, and alpha."""
    stack, attached = images.stack, images.attached_kernels
    numbers, shapes = (None, None) if attached is None else (attached.values, attached.shapes)
    plain = images._replace(attached_kernels=None)
    result: Any = dr.custom(_Spread, stack.colours, stack.alpha, numbers, plain, shapes)
    return result[0], result[1]
