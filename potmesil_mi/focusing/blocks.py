"""Images of depth slices, of which only the blocks that may have light are stored.

Most of a slice is empty, and of its images even more: each has the light of similar circles.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ..samples.raster import Window

BLOCK = 16
"""Pixels on a side of a block."""


@dataclasses.dataclass(frozen=True, eq=False)
class BlockImage:
    """An image (H, W, C) in blocks.

    ``number``, (h, w), tells which of the stored blocks is where, and is 0 where there is no light.
    ``channels`` are the stored blocks, float32 (n, ``BLOCK``, ``BLOCK``, c) each: those of one
    array follow those of the one before.
    """

    shape: tuple[int, int]
    number: np.ndarray
    channels: Sequence[np.ndarray]

    @classmethod
    def of(cls, image: np.ndarray) -> BlockImage:
        """The blocks of an image, float32 (H, W, C)."""
        height, width, channels = image.shape
        down, across = (-(-size // BLOCK) for size in (height, width))
        padded = np.zeros((down * BLOCK, across * BLOCK, channels), np.float32)
        padded[:height, :width] = image
        blocks = in_blocks(padded)
        number = numbered(np.asarray(blocks.any(axis=(2, 3, 4))))
        stored = np.concatenate([np.zeros_like(blocks[:1, 0]), blocks[number > 0]])
        return cls((height, width), number, [stored])

    @property
    def channel_count(self) -> int:
        """C, the number of all channels."""
        return sum(of.shape[-1] for of in self.channels)

    def lit_in(self, window: Window) -> Window:
        """The part of a window of the image with all blocks that may have light; empty if none."""
        top, left = window.top // BLOCK, window.left // BLOCK
        down, across = np.nonzero(self.number[_blocks_of(window)])
        if len(down) == 0:
            return window._replace(width=0, height=0)
        first, last = (left + int(across.min())), (left + int(across.max()))
        upper, lower = top + int(down[0]), top + int(down[-1])
        lit = Window(first, upper, last - first + 1, lower - upper + 1)
        return lit.subdivided(BLOCK).intersection(window)

    def part(self, window: Window) -> np.ndarray:
        """What is in a window of the image, float32 (H, W, C)."""
        place = _blocks_of(window)
        number = self.number[place]
        down, across = number.shape
        image = np.zeros((down * BLOCK, across * BLOCK, self.channel_count), np.float32)
        lit = np.nonzero(number)
        first = 0
        for of in self.channels:
            end = first + of.shape[-1]
            in_blocks(image)[..., first:end][lit] = of[number[lit]]
            first = end
        top, left = window.top - place[0].start * BLOCK, window.left - place[1].start * BLOCK
        return image[top : top + window.height, left : left + window.width]

    def dense(self) -> np.ndarray:
        """The whole image, float32 (H, W, C)."""
        return self.part(Window(0, 0, *self.shape[::-1]))


def numbered(lit: np.ndarray) -> np.ndarray:
    """Numbers from 1 on of the blocks that are ``lit``, bool of any shape; uint32, 0 for others."""
    number = np.zeros(lit.shape, np.uint32)
    number[lit] = np.arange(1, np.count_nonzero(lit) + 1, dtype=np.uint32)
    return number


def _blocks_of(window: Window) -> tuple[slice, slice]:
    """The rows and columns of the blocks that cover a window."""
    return (
        slice(window.top // BLOCK, -(-window.bottom // BLOCK)),
        slice(window.left // BLOCK, -(-window.right // BLOCK)),
    )


def in_blocks(image: np.ndarray) -> np.ndarray:
    """The pixels of an image (h ``BLOCK``, w ``BLOCK``, C), which has them, by block.

    (h, w, ``BLOCK``, ``BLOCK``, C).
    """
    height, width, channels = image.shape
    parts = image.reshape(height // BLOCK, BLOCK, width // BLOCK, BLOCK, channels)
    return parts.swapaxes(1, 2)
