import warnings

import numpy as np
import pytest

import potmesil_mi as pm
from scenes import still_life, synthetic

pytestmark = [
    pytest.mark.usefixtures("variant_llvm"),
    pytest.mark.filterwarnings("error::potmesil_mi._warnings.FocusWarning"),
]


def blurred():
    return synthetic(4000, size=(40, 28), lens=synthetic(1).lens.replace(f_number=0.5))


def test_a_picture_that_is_meant_gives_no_warning():
    pm.focus(blurred())


def test_a_sharp_picture_is_told_and_once_for_the_samples():
    samples = blurred()
    lens = samples.lens.replace(f_number=22)
    with pytest.warns(pm.FocusWarning, match="everything is sharp: the largest circle"):
        pm.focus(samples, lens)
    pm.focus(samples, lens.replace(f_number=32))


def test_whoever_sweeps_over_all_distances_is_not_told_of_those_where_nothing_is():
    samples = blurred()
    far = [8.0, 9.0]
    assert len([*pm.focal_stack(samples, [*far, samples.lens.focus_distance])]) == 3
    with pytest.warns(pm.FocusWarning, match="no picture is focused on anything, the first at"):
        pm.focal_stack(samples, far)
    with pytest.warns(pm.FocusWarning, match="focus_distance=9: nothing is there"):
        pm.focus(samples, samples.lens.replace(focus_distance=9))


def test_samples_of_a_pinhole_without_a_lens_are_told():
    samples = pm.render_samples(still_life(spp=1), spp=1)
    pinhole = samples.replace(lens=samples.lens.replace(f_number=float("inf")))
    with pytest.warns(pm.FocusWarning, match="taken through a pinhole and none is given"):
        pm.focus(pinhole)
    pm.focus(pinhole, pinhole.lens)  # Given, it is meant.


@pytest.mark.parametrize("how", ["f_number", "radius"])
def test_a_wider_aperture_than_the_samples_serve_is_told(how):
    scene = still_life(spp=1)
    sensor = scene.sensors()[0]
    lens = {"f_number": 0.5} if how == "f_number" else {"aperture_radius": 0.05}
    samples = pm.render_samples(scene, pm.potmesil_sensor(sensor, focus_distance=3, **lens), spp=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for distance in (2.0, 4.0):
            pm.focus(samples, samples.lens.replace(focus_distance=distance))
    wider = {name: value * (0.5 if name == "f_number" else 2) for name, value in lens.items()}
    with pytest.warns(pm.FocusWarning, match="is wider than the lens that the samples were taken"):
        pm.focus(samples, samples.lens.replace(**wider))


def test_samples_for_the_widest_aperture_serve_it():
    sampling = pm.Sampling(min_f_number=0.25)
    samples = pm.render_samples(still_life(spp=1), spp=1, sampling=sampling)
    assert "widest_diameter" in samples.provenance
    pm.focus(samples, samples.lens.replace(f_number=0.3))


def test_an_aperture_that_no_lens_has_is_told_where_its_number_is_given():
    samples = blurred()
    with pytest.warns(pm.FocusWarning, match=r"f_number=0.05: is wider than f/0.5"):
        pm.focus(samples, samples.lens.replace(f_number=0.05))
    radius = samples.lens.replace(f_number=0.05).aperture_radius
    pm.focus(blurred(), samples.lens.replace(aperture_radius=radius))
    pm.focus(blurred(), samples.lens.replace(f_number=0.4))  # which blurs little of a large scene


def test_circles_wider_than_the_picture_are_told():
    samples = blurred()
    with pytest.warns(pm.FocusWarning, match="pixels, is wider than the picture. The scene is at"):
        pm.focus(samples, samples.lens.replace(aperture_radius=5.0))


def test_a_focal_length_in_metres_is_told():
    samples = blurred()
    with pytest.warns(pm.FocusWarning, match="everything is sharp.* focal length for 0.05 mm"):
        pm.focus(samples, samples.lens.replace(focal_length=0.05, f_number=2.8))


def test_a_lens_in_other_units_than_the_samples_is_looked_at_in_theirs():
    """The samples are in metres, and the lens in millimetres."""
    samples = blurred()
    same = samples.lens.in_units(1.0)
    pm.focus(samples, same)
    np.testing.assert_allclose(pm.circle_map(samples, same), pm.circle_map(samples), rtol=1e-5)
