import math

import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.optics.blur import radius_per_vergence, widest_radius_per_vergence
from scenes import synthetic

LENSES = {
    "film at F": pm.ThinLens(50.0, 2.0, 2.0, millimeters_per_unit=1000.0),
    "film at V_u": pm.ThinLens(50.0, 2.0, 2.0, millimeters_per_unit=1000.0, film="focused"),
    "of an aperture": pm.ThinLens(50.0, aperture_radius=0.1, focus_distance=300.0),
    "at infinity": pm.ThinLens(35.0, 1.4, millimeters_per_unit=10.0),
}


@pytest.mark.parametrize("name", LENSES)
def test_parallax_is_that_of_the_circle_of_confusion(name):
    lens, camera = LENSES[name], synthetic(1).camera
    z = np.array([0.7, 1.0, 5.0, 400.0, np.inf]) * 1000 / lens.millimeters_per_unit
    pixels_per_mm = camera.focal_length_pixels / lens.film_distance
    radius = lens.circle_of_confusion(z) / 2 * pixels_per_mm
    expected = radius_per_vergence(lens, camera) * (1 / z - 1 / lens.focus_distance)
    np.testing.assert_allclose(radius, expected, rtol=1e-12)


@pytest.mark.parametrize("name", LENSES)
def test_no_focus_beyond_the_nearest_depth_has_a_wider_parallax(name):
    lens, camera = LENSES[name], synthetic(1).camera
    nearest = 0.3 * 1000 / lens.millimeters_per_unit
    widest = widest_radius_per_vergence(lens, camera, nearest)
    for focus_distance in (*np.geomspace(nearest, 1000 * nearest, 30), np.inf):
        scale = radius_per_vergence(lens.replace(focus_distance=focus_distance), camera)
        assert scale <= widest * (1 + 1e-12)
    assert widest == pytest.approx(
        max(radius_per_vergence(lens.replace(focus_distance=u), camera) for u in (nearest, np.inf))
        if lens.focus_distance > nearest
        else radius_per_vergence(lens, camera)
    )


def test_what_is_nearer_than_the_lens_can_focus_gives_a_finite_parallax():
    lens, camera = LENSES["film at F"], synthetic(1).camera
    widest = widest_radius_per_vergence(lens, camera, 1e-6)
    at_infinity = radius_per_vergence(lens.replace(focus_distance=np.inf), camera)
    assert widest == pytest.approx(2 * at_infinity)
    pinhole = lens.replace(f_number=math.inf)
    assert widest_radius_per_vergence(pinhole, camera, 1e-6) == 0
