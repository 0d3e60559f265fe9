"""AOVs through the lens."""

import numpy as np
import pytest

import potmesil_mi as pm
from scenes import evenly_spread

pytestmark = pytest.mark.usefixtures("variant_llvm")

NAMES = ("al.R", "al.G", "al.B", "dd.T")


def samples_with(values):
    size = (12, 8)
    return evenly_spread(size, surface=np.ones(96 * 16), aovs=values, aov_names=NAMES)


@pytest.mark.parametrize("method", ["layered", pm.Equation20(tables=3)])
def test_aovs_are_blurred_as_colours_are(method):
    samples = samples_with(np.random.default_rng(1).uniform(0.5, 1, (96 * 16, 4)))
    lens = samples.lens.replace(f_number=0.5)
    found = pm.focus_aovs(samples, lens, method=method)
    assert tuple(found) == NAMES
    picture = np.array(pm.focus(samples.replace(rgb=samples.aovs[:, :3]), lens, method=method))
    colours = np.stack([found[name] for name in NAMES[:3]], axis=-1)
    np.testing.assert_allclose(colours, picture, atol=1e-5)
    assert np.ptp(picture) > 0.01


def test_values_of_any_sign_and_size_are_blurred_alike():
    """Colours are not, of which very bright ones are highlights."""
    values = np.random.default_rng(1).uniform(0.5, 1, (96 * 16, 4)) ** 40
    samples = samples_with(values)
    plain = pm.focus_aovs(samples)
    other = pm.focus_aovs(samples.replace(aovs=-1e6 * values))
    for name in NAMES:
        np.testing.assert_allclose(-1e-6 * other[name], plain[name], atol=1e-6)


def test_what_is_everywhere_the_same_stays_so_and_what_is_not_finite_is_0():
    values = np.tile([-3.0, 0.0, 1e30, np.nan], (96 * 16, 1))
    found = pm.focus_aovs(samples_with(values))
    for name, value in zip(NAMES, (-3.0, 0.0, 1e30, 0.0), strict=True):
        np.testing.assert_allclose(found[name], np.float32(value))


def test_samples_without_aovs_have_no_pictures_of_them():
    assert pm.focus_aovs(evenly_spread((4, 3))) == {}
