"""Blocks of images: those that have light are found, and stored."""

import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.focusing.blocks import BLOCK, BlockImage
from potmesil_mi.focusing.splat import ImageStack
from potmesil_mi.samples.raster import Window
from scenes import SCENES


def test_an_image_is_what_its_blocks_are():
    image = np.zeros((3 * BLOCK + 5, 2 * BLOCK, 4), np.float32)
    image[BLOCK + 2 : BLOCK + 4, -1] = 1, 2, 3, 4
    blocks = BlockImage.of(image)
    assert np.count_nonzero(blocks.number) == 1
    np.testing.assert_array_equal(blocks.dense(), image)
    window = Window(3, 5, 2 * BLOCK - 3, BLOCK)
    np.testing.assert_array_equal(blocks.part(window), image[5 : 5 + BLOCK, 3:])
    assert blocks.lit_in(window) == Window(BLOCK, BLOCK, BLOCK, 5)
    assert blocks.lit_in(Window(0, 0, BLOCK, 3 * BLOCK)).is_empty


@pytest.mark.parametrize(
    "of_lens",
    [{}, {"squeeze": 1.6}, {"aperture": pm.Polygon(5)}, {"f_number": 0.4}],
    ids=["disc", "squeezed", "polygon", "open"],
)
@pytest.mark.parametrize("name", ["thicket", "lamps"])
@pytest.mark.usefixtures("variant_llvm")
def test_no_light_falls_beside_the_blocks_that_are_stored(name, of_lens, monkeypatch):
    scene = mi.load_file(str(SCENES / f"{name}.xml"), optimize=False, res=192)
    samples = pm.render_samples(scene, spp=2)
    stacks = []
    start = ImageStack.start
    monkeypatch.setattr(ImageStack, "start", lambda self: (stacks.append(self), start(self)))
    lens = samples.lens.replace(**{"f_number": 1.4, **of_lens})
    for distance in np.quantile(samples.z, [0.02, 0.3, 0.8]):
        pm.focus(samples, lens.replace(focus_distance=float(distance)))
    assert len(stacks) > 5
    for stack in stacks:
        beside = np.asarray(stack.colours)[: BLOCK**2 * 4]
        assert not beside.any()
