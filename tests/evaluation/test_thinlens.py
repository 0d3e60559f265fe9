import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.evaluation import compare, thinlens_sensor
from scenes import still_life


def test_thinlens_sensor_stands_where_the_sensor_stood(variant_llvm):
    film = {"crop_width": 12, "crop_height": 10, "crop_offset_x": 5, "crop_offset_y": 3}
    place = mi.ScalarTransform4f().look_at([0.2, 0.1, 0], [0, 0, 2.3], [0, 1, 0])
    sensor = {"type": "potmesil", "focal_length": 50.0, "frame_width": 40.0, "f_number": 0.5}
    sensor |= {"focus_distance": 2.0, "to_world": place, "near_clip": 0.5, "far_clip": 50.0}
    scene = still_life(film={**film, "rfilter": {"type": "gaussian"}}, sensor=sensor)
    sensor = scene.sensors()[0]
    closed = thinlens_sensor(sensor, sensor.lens().replace(aperture_radius=0), spp=4)
    seen = np.array(mi.render(scene, sensor=closed, spp=64, seed=3))
    expected = np.array(mi.render(scene, sensor=sensor, spp=64, seed=3))
    assert seen.shape == (10, 12, 3)
    np.testing.assert_allclose(seen, expected, atol=0.02)
    assert closed.near_clip() == pytest.approx(0.5)

    opened = thinlens_sensor(sensor, spp=4)
    assert "ThinLens" in opened.class_name()
    radius = mi.traverse(opened)["aperture_radius"][0]
    assert radius == pytest.approx(sensor.lens().aperture_radius)


def test_thinlens_sensor_keeps_the_field_of_view_of_the_samples(variant_llvm):
    sensor = still_life().sensors()[0]
    other = pm.ThinLens(85.0, 2.0, 2500.0, film="focused")  # in millimetres
    parameters = mi.traverse(thinlens_sensor(sensor, other))
    assert parameters["x_fov"][0] == pytest.approx(sensor.camera().x_fov, abs=1e-4)
    assert parameters["focus_distance"][0] == pytest.approx(2.5)
    assert parameters["aperture_radius"][0] == pytest.approx(85 / 4 / 1000)


def test_thinlens_sensor_takes_the_samples_that_its_sampler_can(variant_llvm, capfd):
    sensor = still_life().sensors()[0]
    assert thinlens_sensor(sensor, sampler="orthogonal", spp=10).sampler().sample_count() == 25
    assert thinlens_sensor(sensor, sampler="multijitter", spp=10).sampler().sample_count() == 12
    assert "rounding" not in capfd.readouterr().err


def test_a_principal_point_off_the_centre_has_no_thinlens(variant_llvm):
    lens = {"focal_length": 50.0, "frame_width": 40.0, "f_number": 2.0, "focus_distance": 2.0}
    sensor = {"type": "potmesil", **lens, "principal_point_offset_x": 0.1}
    with pytest.raises(ValueError, match=r"principal_point_offset=\(0\.1"):
        compare(still_life(sensor=sensor))
