"""The picture through the lens with what hides what: the methods ``layered`` and ``lightfield``.

Samples are gathered to fragments; what the points of the lens see of them is found, and kept for
the next focus. A focus is then planned in slices of depth, and for each from near to far light is
splatted, convolved and composited.
"""

from __future__ import annotations

import numpy as np

from .._progress import track
from ..samples.raster import Window
from .composite import Compositor, SpreadSlice
from .convolve import spread
from .exposure import Exposure, Visibility
from .film import FinePicture
from .memo import Memo
from .slices import DepthSlice, plan
from .splat import SliceImages, splat
from .viewing import Viewing


def form(exposure: Exposure, memo: Memo, how: Visibility) -> FinePicture:
    """The picture of the crop window on subpixels, (height, width, 3 or 4).

    Subpixels that no light reaches are 0. What each counts in its pixel is how densely it was
    sampled, 1 on the average.
    """
    viewing, chosen = Viewing(exposure, memo, how), exposure.choices
    exposure, views = viewing.exposure, viewing.pyramid()
    if chosen is not None:
        views = views.of_tile(chosen.single)
    channels = views.finest.unoccluded.values.shape[1]
    groups = plan(
        views,
        exposure.lens,
        exposure.psf,
        exposure.blur,
        exposure.subpixels_per_mm,
        viewing.fineness,
        None if chosen is None else chosen.counts,
    )
    density, moments = (
        None if of is None else cropped(of, exposure.crop) for of in (views.density, views.moments)
    )
    compositor = Compositor(
        exposure.crop, channels, exposure.subpixels, density, moments, chosen is not None
    )
    begun: list[tuple[DepthSlice, SliceImages]] = []
    for group in track(groups, "Focusing"):
        images = [(each, splat(each, channels)) for each in group]
        # While Dr.Jit makes the images of this group, those of the group before it are spread.
        compositor.put_behind([_light_of(*each, channels) for each in begun])
        begun = images
    compositor.put_behind([_light_of(*each, channels) for each in begun])
    return compositor.finished()


def cropped(array: np.ndarray, crop: Window) -> np.ndarray:
    """The part of an array of the samples' window that is in the crop; 0 where it is beyond."""
    window = Window(0, 0, *array.shape[1::-1])
    cropped = np.zeros((*crop.shape, *array.shape[2:]), array.dtype)
    shared = crop.intersection(window)
    cropped[shared.slices_in(crop)] = array[shared.slices_in(window)]
    return cropped


def _light_of(depth_slice: DepthSlice, images: SliceImages, channels: int) -> SpreadSlice:
    """The light of a slice after its images were spread by their kernels and added up."""
    spread_ones = [
        (each.stack.image(index), kernel)
        for each in images.spread
        for index, kernel in enumerate(each.kernels)
    ]
    box, resolution = depth_slice.box, depth_slice.resolution
    if spread_ones:
        light = spread(*zip(*spread_ones, strict=True))
    else:
        light = np.zeros((*box.shape, channels), np.float32)
    moments = [stack.image(0).dense() for stack in images.moments]
    is_sharp = depth_slice.octaves[0] == 0
    return SpreadSlice(light, box.left, box.top, resolution, is_sharp, moments)
