"""Wavefronts of bounded size, and the random sequence of each."""

import mitsuba as mi
import numpy as np
import pytest

from potmesil_mi.tracing import passes
from potmesil_mi.tracing.buffers import Traced
from potmesil_mi.tracing.passes import Passes, wavefronts

pytestmark = pytest.mark.usefixtures("variant_llvm")


def sampler(count=4):
    return mi.load_dict({"type": "independent", "sample_count": count})


def numbers(passes, count=6):
    passes.begin(count)
    return np.array(passes.sampler.next_1d())


@pytest.mark.parametrize(("count", "rays"), [(10, 1), (10, 3), (7, 100), (0, 5), (64, 16)])
def test_wavefronts_cover_all_and_are_bounded(monkeypatch, count, rays):
    monkeypatch.setattr(passes, "WAVEFRONT", 16)
    parts = wavefronts(count, rays)
    assert [i for part in parts for i in range(part.start, part.stop)] == list(range(count))
    for part in parts:
        assert 0 < part.stop - part.start <= max(1, 16 // rays)


def test_every_pass_has_random_numbers_of_its_own_and_they_repeat():
    first, second = Passes(sampler(), 0, 3), Passes(sampler(), 0, 3)
    sequence = [numbers(first) for _ in range(3)]
    assert not np.array_equal(sequence[0], sequence[1])
    assert not np.array_equal(sequence[1], sequence[2])
    np.testing.assert_array_equal(sequence, [numbers(second) for _ in range(3)])
    assert not np.array_equal(sequence[0], numbers(Passes(sampler(), 0, 4)))


def test_the_first_pass_has_the_numbers_of_the_seed():
    own = sampler()
    own.seed(3, 6)
    np.testing.assert_array_equal(numbers(Passes(sampler(), 0, 3)), np.array(own.next_1d()))


def test_the_sensors_sampler_is_left_alone_and_counts_are_rounded_up():
    own = mi.load_dict({"type": "multijitter", "sample_count": 4})
    assert Passes(own, 0, 0).spp == 4
    assert Passes(own, 7, 0).spp >= 7
    assert own.sample_count() == 4


def test_points_are_the_mean_of_their_paths(monkeypatch):
    x = np.arange(5, dtype=np.float32)
    y = 10 * x

    def trace(position):
        grey = position.x + run.sampler.next_1d()
        return Traced(mi.Color3f(grey), mi.Float(1) + 0 * grey, position.y, mi.UInt32(position.x))

    for wavefront in (1 << 10, 2 * 1000):
        monkeypatch.setattr(passes, "WAVEFRONT", wavefront)
        run = Passes(sampler(), 1000, 0)
        shown = run.averaged(x, y, trace, "Test")
        np.testing.assert_allclose(shown.rgb, np.stack([x + 0.5] * 3, axis=1), atol=0.05)
        np.testing.assert_array_equal(shown.alpha, 1)
        np.testing.assert_array_equal(shown.z, y)
        np.testing.assert_array_equal(shown.surface, x)
