"""Light of fragments that is spread along their paths."""

import dataclasses

import numpy as np
import pytest

from potmesil_mi.focusing.gathering import gather
from potmesil_mi.focusing.smearing import samples_along_paths, smeared
from scenes import synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")

SIZE = (24, 18)


def fragments(count=40, *, motion, seed=0, **fields):
    """Fragments of samples in the middle of a window, all of which move by ``motion``."""
    rng = np.random.default_rng(seed)
    samples = synthetic(
        count,
        size=SIZE,
        seed=seed,
        x=rng.uniform(9, 15, count),
        y=rng.uniform(7, 11, count),
        **fields,
    )
    found = gather(samples, 1, 3.0, alpha=True)
    return dataclasses.replace(found, motion=np.tile(np.float32(motion), (len(found), 1)))


def image(of):
    """Light by subpixel."""
    result = np.zeros((SIZE[1], SIZE[0], of.values.shape[1]))
    np.add.at(result, (of.y, of.x), of.values)
    return result


@pytest.mark.parametrize("motion", [(0, 0, 0), (3.3, 0, 0), (-2.1, 5.2, 0.01), (0.2, -0.4, 0)])
def test_smearing_keeps_light_and_share(motion):
    still = fragments(motion=motion)
    expected = still.values.sum(axis=0, dtype=np.float64)
    moved = smeared([still])
    np.testing.assert_allclose(moved.values.sum(axis=0, dtype=np.float64), expected, rtol=1e-5)


def test_what_stands_still_stays_where_it_is():
    still = fragments(motion=(0, 0, 0))
    np.testing.assert_allclose(image(smeared([still])), image(still), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("motion", [(4, 0, 0), (0, 4, 0), (6.5, 2.25, 0), (-3.7, 5.9, 0)])
def test_light_is_spread_evenly_along_the_path(motion):
    one = fragments(1, motion=motion)
    found = image(smeared([one]))[..., 3] / one.values[0, 3]
    row, column = np.mgrid[: SIZE[1], : SIZE[0]]
    at = np.array([(found * column).sum() - one.x[0], (found * row).sum() - one.y[0]])
    np.testing.assert_allclose(at, 0, atol=1e-5)
    # The variance of a box of that length along each axis, and of what lies between subpixels.
    for axis, length in ((column - one.x[0], motion[0]), (row - one.y[0], motion[1])):
        variance = (found * axis**2).sum()
        assert length**2 / 12 - 1e-4 <= variance <= length**2 / 12 + 0.26
    if motion in ((4, 0, 0), (0, 4, 0)):
        np.testing.assert_allclose(np.sort(found[found > 0]), [0.125, 0.125, 0.25, 0.25, 0.25])


def test_depth_changes_along_the_path():
    one = fragments(1, motion=(8, 0, 0.02), z=np.full(1, 2.0))
    moved = smeared([dataclasses.replace(one, bin_width=1e-4)])
    order = np.argsort(moved.x)
    expected = 0.5 + 0.02 * np.clip((moved.x[order] - one.x[0]) / 8, -0.5, 0.5)
    np.testing.assert_allclose(moved.vergence[order], expected, atol=1e-6)


def test_parts_of_an_exposure_become_one_and_depths_stay_apart():
    near, far = (fragments(30, motion=(0, 0, 0), seed=1, z=np.full(30, z)) for z in (1.0, 4.0))
    far = dataclasses.replace(far, vergence_min=near.vergence_min, bin_width=near.bin_width)
    bins = ((far.vergence - near.vergence_min) / near.bin_width).astype(np.int32)
    low = bins.min()
    near, far = (
        dataclasses.replace(of, bin=(own - low).astype(np.int32), vergence_min=0.25)
        for of, own in ((near, near.bin), (far, bins))
    )
    together = smeared([near, far, near])
    np.testing.assert_allclose(image(together), 2 * image(near) + image(far), rtol=1e-5)
    assert set(np.round(together.vergence, 5)) == {1.0, 0.25}


def test_light_that_leaves_the_window_is_lost():
    one = fragments(1, motion=(100, 0, 0))
    assert 0.1 < smeared([one]).values[:, 3].sum() / one.values[0, 3] < 0.3


def test_samples_are_spread_along_their_paths():
    samples = synthetic(50, motion=np.tile([5.5, -2.0, 0.1], (50, 1)))
    spread = samples_along_paths(samples)
    assert len(spread) == 6 * 50
    assert spread.motion is None
    assert spread.weight.sum() == pytest.approx(samples.weight.sum(), rel=1e-6)
    first = spread.surface == spread.surface
    np.testing.assert_allclose(
        np.bincount(np.arange(300) // 6, spread.x[first]) / 6, samples.x, rtol=1e-5
    )
    assert samples_along_paths(synthetic(5)) is not None
