import math
import sys

import mitsuba as mi
import numpy as np
import pytest

from potmesil_mi import cli
from potmesil_mi.evaluation import metrics
from scenes import SCENES

FIGURE = str(SCENES / "figure11.xml")


@pytest.fixture
def noise():
    return np.random.default_rng(0).uniform(0.2, 0.8, (32, 40, 3)).astype(np.float32)


@pytest.mark.parametrize("offset", [0.1, -0.01])
def test_psnr_of_a_constant_offset_is_its_square(noise, offset):
    expected = -20 * math.log10(abs(offset))
    assert metrics.psnr(noise + offset, noise) == pytest.approx(expected, abs=1e-3)
    assert metrics.mean_square(noise, noise + offset) == pytest.approx(offset**2, rel=1e-4)


def test_equal_pictures_have_no_error(noise):
    assert metrics.psnr(noise, noise) == math.inf
    assert metrics.ssim(noise, noise) == pytest.approx(1, abs=1e-12)
    assert metrics.flip(noise, noise) == 0


def test_what_a_screen_clips_does_not_count(noise):
    brighter = noise.copy()
    noise[:4], brighter[:4] = 1, 50
    noise[4:8], brighter[4:8] = 0, -1
    assert metrics.psnr(brighter, noise) == math.inf
    assert metrics.flip(brighter, noise) == 0


def test_ssim_of_constant_pictures_is_its_luminance_term():
    a, b = (np.full((16, 16, 3), value) for value in (0.2, 0.6))
    x, y, c1 = metrics.srgb(0.2), metrics.srgb(0.6), 0.01**2
    expected = (2 * x * y + c1) / (x**2 + y**2 + c1)
    assert metrics.ssim(a, b) == pytest.approx(expected, rel=1e-6)


def test_flip_grows_with_the_error_up_to_that_of_black_and_white(noise):
    black = np.zeros((32, 32, 3))
    near, far = (metrics.flip(noise + offset, noise) for offset in (0.02, 0.2))
    assert 0 < near < far < metrics.flip(black + 1, black) < 1
    # Seen from farther away, noise is blurred.
    other = np.clip(noise + np.random.default_rng(1).normal(0, 0.1, noise.shape), 0, 1)
    close, distant = (metrics.flip(other, noise, pixels_per_degree=ppd) for ppd in (20, 200))
    assert distant < close / 2


def test_srgb_is_the_standards(variant_llvm):
    linear = np.linspace(-0.1, 1.1, 60, dtype=np.float32).reshape(4, 5, 3)
    inside = np.clip(linear, 0, 1)
    expected = np.array(mi.Bitmap(inside).convert(srgb_gamma=True))
    np.testing.assert_allclose(metrics.srgb(linear), expected, atol=1e-5)


def test_alpha_and_mitsubas_tensors_may_be_measured(variant_llvm, noise):
    with_alpha = mi.TensorXf(np.dstack([noise, np.ones(noise.shape[:2], np.float32)]))
    assert metrics.psnr(with_alpha, noise) == math.inf
    assert metrics.ssim(with_alpha, mi.TensorXf(noise)) == pytest.approx(1)


@pytest.mark.parametrize(
    ("metric", "a", "b", "text"),
    [
        ("psnr", (8, 8, 3), (8, 9, 3), "8x8 pixels.*9x8"),
        ("psnr", (8, 8), (8, 8), r"picture: has shape \(8, 8\)"),
        ("flip", (8, 8, 3), (8, 8, 1), "reference: has shape"),
        ("psnr", (0, 8, 3), (0, 8, 3), "shape"),
        ("ssim", (10, 20, 3), (10, 20, 3), "20x10 pixels.*11x11"),
    ],
)
def test_pictures_that_cannot_be_compared_are_named(metric, a, b, text):
    with pytest.raises(ValueError, match=text):
        getattr(metrics, metric)(np.zeros(a), np.zeros(b))


def test_pixels_per_degree_are_positive(noise):
    with pytest.raises(ValueError, match="pixels_per_degree=0"):
        metrics.flip(noise, noise, pixels_per_degree=0)


@pytest.mark.parametrize(
    ("module", "package"), [("skimage.metrics", "scikit-image"), ("flip_evaluator", "flip-")]
)
def test_a_missing_extra_says_how_to_install_it(monkeypatch, capsys, module, package):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match=rf"{package}.*'potmesil_mi\[compare\]'"):
        metrics.require_extra()
    assert cli.main(["compare", FIGURE]) == 1
    assert "pip install 'potmesil_mi[compare]'" in capsys.readouterr().err


def test_what_pictures_have_in_common_is_told_apart_from_their_noise(noise):
    """A bias of 0.02 under noise of 0.1, judged by references with noise of their own."""
    random = np.random.default_rng(7)
    truth = np.full((64, 64, 3), 0.5)

    def noisy(mean):
        return mean + 0.1 * random.normal(size=truth.shape)

    references = noisy(truth), noisy(truth)
    bias, error = metrics.mean_product((noisy(truth + 0.02), noisy(truth + 0.02)), references)
    assert error < 2e-4
    assert bias == pytest.approx(0.02**2, abs=3 * error)
    none, error = metrics.mean_product((noisy(truth), noisy(truth)), references)
    assert abs(none) < 3 * error
