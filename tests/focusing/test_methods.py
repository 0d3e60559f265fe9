"""Methods: one family of dataclasses and of texts, open to a user's own."""

import dataclasses
import math
from typing import ClassVar

import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.focusing import methods
from potmesil_mi.focusing.methods import method_of
from scenes import overscanned, pinhole_mean, synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")


@pytest.mark.parametrize(
    ("text", "method"),
    [
        ("layered", pm.Layered()),
        ("layered:lens_points=64", pm.Layered(lens_points=64)),
        ("lightfield:squares=3", pm.LightField(squares=3)),
        ("paper:tables=20,inverse_square=false", pm.Equation20(20, inverse_square=False)),
    ],
)
def test_a_text_describes_a_method_and_a_method_has_that_text(text, method):
    assert pm.Method.parse(text) == method
    assert str(method) == text
    assert pm.Method.parse(method.describe()) == method


def test_options_given_beside_a_method_replace_its_own():
    assert method_of("layered", lens_points=9, squares=2) == pm.Layered(9, 2)
    assert method_of(pm.Layered(lens_points=9), squares=2) == pm.Layered(9, 2)
    assert method_of("paper", tables=5, inverse_square=False) == pm.Equation20(5, False)


def test_options_of_other_methods_are_checked_and_then_ignored():
    assert method_of("layered", tables=5) == pm.Layered()
    with pytest.raises(ValueError, match="tables=1"):
        method_of("layered", tables=1)
    with pytest.raises(TypeError, match="inverse_square='no'"):
        method_of("layered", inverse_square="no")


@pytest.mark.parametrize(
    ("make", "error", "text"),
    [
        (lambda: pm.Layered(lens_points=0), ValueError, "lens_points=0"),
        (lambda: pm.LightField(squares=17), ValueError, "squares=17"),
        (lambda: pm.Equation20(tables=2.5), TypeError, r"tables=2\.5"),
        (lambda: pm.Method.parse("layered:lens_point=3"), ValueError, "lens_point: not"),
        (lambda: pm.Method.parse("nearest"), ValueError, "method='nearest'.*layered"),
    ],
)
def test_a_bad_method_is_named(make, error, text):
    with pytest.raises(error, match=text):
        make()


@pytest.fixture
def own_method():
    """A class that is a member of the family for the time of a test."""

    @dataclasses.dataclass(frozen=True)
    class Pinhole(pm.Method):
        """A method of one's own: the pinhole's picture times a gain."""

        gain: float = 1.0
        name: ClassVar[str] = "test_pinhole"

        def form(self, exposure, memo):
            crop, samples = exposure.crop, exposure.samples.visible()
            pixel = samples.pixel()
            total = np.bincount(pixel, samples.weight, samples.window.size)
            columns = [*samples.rgb.T] + ([samples.alpha] if exposure.alpha else [])
            sums = [np.bincount(pixel, samples.weight * c, samples.window.size) for c in columns]
            picture = self.gain * np.stack(sums, axis=-1) / np.maximum(total, 1e-9)[:, None]
            height, width = samples.window.shape
            rows = slice(crop.top, crop.bottom), slice(crop.left, crop.right)
            return picture.reshape(height, width, -1)[rows], total.reshape(height, width)[rows]

    yield Pinhole
    del pm.Method._registered[Pinhole.name]


def test_a_method_of_ones_own_forms_pictures(own_method):
    samples = overscanned()
    closed = samples.lens.replace(f_number=np.inf)
    expected = 2 * np.array(pm.focus(samples, closed))
    sampled = np.isfinite(pinhole_mean(samples))
    assert sampled.mean() > 0.9
    for method in (own_method(2.0), "test_pinhole:gain=2"):
        # Where there is no sample this one has nothing to show.
        image = np.array(pm.focus(samples, method=method))
        np.testing.assert_allclose(image[sampled], expected[sampled], atol=1e-5)
        session = pm.FocusSession(samples, method)
        assert np.array(session.focus(alpha=True)).shape == (*expected.shape[:2], 4)


def test_the_paper_refuses_vignetting_before_anything_is_formed():
    samples = synthetic()
    with pytest.raises(ValueError, match=r"vignetting=0\.5"):
        pm.focus(samples, samples.lens.replace(vignetting=0.5), method="paper")


def test_methods_look_closer_where_much_is_hidden():
    """A crowded scene is seen from more points on a finer raster."""
    samples = overscanned(20_000)
    crowd = samples.replace(layer=(np.arange(len(samples)) % 4 == 3).astype(np.uint8))
    few = samples.replace(layer=(np.arange(len(samples)) % 8 == 7).astype(np.uint8))
    psf = crowd.lens.aperture
    for method, squares, points in (
        (pm.Layered(), (1, 2), (32, 64)),
        (pm.LightField(), (2, 4), (128, 192)),
    ):
        both = few, crowd
        assert tuple(method.default_squares(each, psf) for each in both) == squares
        assert tuple(method.points_for(each) for each in both) == points


def test_lightfield_looks_no_closer_than_memory_and_samples_allow(monkeypatch):
    """Crowded or not, many samples are seen as usual, and no subpixel is without a sample."""
    samples = overscanned(20_000)
    crowd = samples.replace(layer=(np.arange(len(samples)) % 4 == 3).astype(np.uint8))
    psf, method = crowd.lens.aperture, pm.LightField()
    few = crowd.chosen(np.arange(len(crowd)) % 4 < 2).replace(
        layer=(np.arange(len(crowd) // 2) % 4 == 3).astype(np.uint8)
    )
    assert few.is_crowded
    assert few.spp < 16
    assert method.default_squares(few, psf) == math.isqrt(few.spp)
    monkeypatch.setattr(methods, "MAX_FINE_SAMPLES", len(crowd))
    assert (method.default_squares(crowd, psf), method.points_for(crowd)) == (4, 192)
    monkeypatch.setattr(methods, "MAX_FINE_SAMPLES", len(crowd) - 1)
    assert (method.default_squares(crowd, psf), method.points_for(crowd)) == (2, 128)


def test_layered_looks_closer_where_samples_are_many():
    """From 64 a pixel on, and from 256, of what the pinhole sees: hidden ones do not count."""
    window = overscanned().window
    squares = []
    for spp, without_hidden in ((55, 1), (75, 1), (300, 2)):
        samples = overscanned(spp * window.width * window.height).replace(layer=None)
        psf = samples.lens.aperture
        squares.append(pm.Layered().default_squares(samples, psf))
        hidden = samples.replace(layer=(np.arange(len(samples)) % 6 == 5).astype(np.uint8))
        assert samples.spp == pytest.approx(spp, rel=0.1)
        assert samples.hidden_to_visible == 0
        assert hidden.hidden_to_visible == pytest.approx(1 / 5, rel=0.01)
        assert pm.Layered().default_squares(hidden, psf) == without_hidden
    assert squares == [1, 2, 4]
