"""Pictures of samples that move while they are exposed."""

import functools

import drjit as dr
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.evaluation.metrics import psnr
from scenes import synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")

WIDTH, HEIGHT, EACH = 32, 24, 4
METHODS = ("layered", "lightfield")


def pattern(x, y, z):
    """Colours of a surface, which go along with it."""
    waves = [np.sin(0.5 * x + 0.3 * y + z), np.cos(0.4 * x - 0.6 * y), np.sin(0.7 * y + 2 * z)]
    return 0.5 + 0.4 * np.stack(waves, axis=-1)


def exposure(motion=(0, 0, 0), *, time=0.0, edge=16.0, background=(0, 0, 0)):
    """A wall at 4 m, and before its right part a screen at 2 m, which moves by ``motion``.

    ``time`` is how far both have gone at once, as a part of their motion, and what is left is 0.
    """
    at = (np.arange(-12 * EACH, (WIDTH + 12) * EACH) + 0.5) / EACH
    x, y = (of.ravel() for of in np.meshgrid(at, at[: (HEIGHT + 24) * EACH]))
    dx, dy, _ = np.multiply(motion, time)
    there = x - dx >= edge
    bx, by, _ = np.multiply(background, time)
    count, covered = len(x), np.count_nonzero(there)
    layer = np.concatenate([there, np.zeros(covered)]).astype(np.uint8)
    z = np.concatenate([np.full(count, 4.0), np.full(covered, 2.0)])
    rgb = [pattern(x - bx, y - by, 4.0), pattern((x - dx)[there], (y - dy)[there], 2.0)]
    moves = [np.tile(background, (count, 1)), np.tile(motion, (covered, 1))]
    base = synthetic(1, size=(WIDTH, HEIGHT))
    return base.replace(
        x=np.concatenate([x, x[there]]),
        y=np.concatenate([y, y[there]]),
        rgb=np.concatenate(rgb),
        alpha=np.ones(len(z)),
        z=z,
        surface=np.where(z == 4, 1, 2),
        weight=np.full(len(z), 1 / EACH**2),
        layer=layer,
        motion=None if time else np.concatenate(moves),
        window=(-12, -12, WIDTH + 24, HEIGHT + 24),
    )


@functools.cache
def of_instants(focus_distance, moves):
    """The mean of instants of some moves, which several tests compare with."""
    return mean_of_instants(lens=lens(focus_distance), **dict(moves))


@functools.cache
def still(focus_distance, method):
    """The picture of things that stand still, which several tests compare with."""
    return np.array(pm.focus(exposure(), lens(focus_distance), method=method))


def mean_of_instants(count=8, method="layered", **moves):
    """The picture of an exposure as the mean of pictures of things that stand still.

    Of ``count`` instants, between which nothing moves by as much as a pixel.
    """
    lens = moves.pop("lens")
    times = (np.arange(count) + 0.5) / count - 0.5
    pictures = [
        np.array(pm.focus(exposure(time=time, **moves), lens, method=method)) for time in times
    ]
    return np.mean(pictures, axis=0, dtype=np.float64)


def lens(focus_distance, aperture_radius=0.05):
    return synthetic(1).lens.replace(focus_distance=focus_distance, aperture_radius=aperture_radius)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("focus_distance", [2.0, 4.0])
@pytest.mark.parametrize(
    "moves",
    [
        {"motion": (6, 0, 0)},
        {"motion": (-3, 5, 0)},
        {"motion": (0, 0, 0), "background": (7, 2, 0)},
        {"motion": (4, 0, 0), "background": (4, 0, 0)},
    ],
    ids=["screen", "diagonal", "wall", "both"],
)
def test_an_exposure_is_the_mean_of_its_instants(moves, focus_distance, method):
    through = lens(focus_distance)
    expected = of_instants(focus_distance, tuple(moves.items()))
    found = np.array(pm.focus(exposure(**moves), through, method=method))
    assert psnr(found, expected) > 36
    assert psnr(found, expected) > psnr(still(focus_distance, method), expected) + 6


def test_an_exposure_that_is_not_defocused_is_blurred_all_the_same():
    closed = lens(4.0, aperture_radius=0.0)
    expected = mean_of_instants(lens=closed, motion=(6, 0, 0))
    found = np.array(pm.focus(exposure((6, 0, 0)), closed))
    assert psnr(found, expected) > 36


def test_the_paper_spreads_samples_along_their_paths_and_knows_no_occlusion():
    # A wall alone, so that there is nothing to hide.
    through = lens(2.0)
    moves = {"edge": 1000.0, "background": (6, 0, 0)}
    expected = mean_of_instants(lens=through, method="paper", **moves)
    found = np.array(pm.focus(exposure(**moves), through, method="paper"))
    assert psnr(found, expected) > 40


def test_blur_of_motion_keeps_the_light_of_the_picture():
    through = lens(3.0)
    moves = {"edge": 1000.0, "background": (5, 3, 0)}
    still, blurred = exposure(edge=1000.0), exposure(**moves)
    dot = (np.hypot(still.x - 16, still.y - 12) < 3)[:, None]
    pictures = [
        np.array(pm.focus(of.replace(rgb=np.where(dot, np.ones(3), 0)), through))
        for of in (still, blurred)
    ]
    sums = [picture.sum(dtype=np.float64) for picture in pictures]
    assert sums[1] == pytest.approx(sums[0], rel=1e-4)
    assert pictures[1].max() < 0.95 * pictures[0].max()


def test_alpha_moves_with_what_it_is_of():
    through = lens(2.0)
    samples = exposure((6, 0, 0))
    samples = samples.replace(alpha=(samples.z == 2).astype(np.float32))
    alpha = np.array(pm.focus(samples, through, alpha=True))[..., 3]
    middle = alpha[HEIGHT // 2]
    # It rises over the six pixels that the edge crosses.
    expected = np.clip((np.arange(10, 22) - 12.5) / 6, 0, 1)
    np.testing.assert_allclose(middle[10:22], expected, atol=0.04)


def test_refocusing_an_exposure_does_not_find_out_again_what_is_seen():
    samples = exposure((6, 0, 0))
    session = pm.FocusSession(samples, "lightfield")
    session.focus(lens(2.0))
    kept = session.nbytes
    assert kept > 0
    session.focus(lens(2.0).replace(focus_distance=2.0))
    assert session.nbytes == kept


def test_the_parts_of_an_exposure_are_looked_at_by_their_own_lens_points():
    from potmesil_mi.focusing.lens_points import LensPoints

    samples, through = exposure(), lens(2.0)
    points = LensPoints.of(through.aperture, through, samples, 32, 1)
    parts = points.at_instants(4, 16)
    assert len(parts) == 4
    radii = [np.hypot(*part.points.T) for part in parts]
    for part, own in zip(parts, radii, strict=True):
        assert part.points.shape == (16, 2)
        assert abs(own.mean() - 2 / 3) < 0.06
        np.testing.assert_allclose(np.sort(part.times), (np.arange(16) + 0.5) / 16 - 0.5)
    every = np.concatenate([part.points for part in parts])
    np.testing.assert_allclose(every.mean(axis=0), 0, atol=0.05)


def test_many_instants_compile_no_more_than_few(variant_llvm):
    def operations(instants):
        """Those of the largest kernel of a first focus."""
        count = 300
        rng = np.random.default_rng(2)
        time = np.sort(rng.integers(instants, size=count) / instants).astype(np.float32)
        motion = rng.normal(0, 0.5, (count, 3)).astype(np.float32) * (1, 1, 0)
        samples = synthetic(count, time=time, motion=motion)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            pm.focus(samples)
            return max(kernel.get("operation_count", 0) for kernel in dr.kernel_history())

    assert operations(24) == operations(3)
