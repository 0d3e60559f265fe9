"""Maps beside a picture, and what its file says of camera and lens."""

import math

import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pytest

import potmesil_mi as pm
from potmesil_mi._image import write_picture
from potmesil_mi.cli import main
from potmesil_mi.samples.maps import circle_map, depth_map, maps_of, surface_map
from potmesil_mi.samples.standard import standard_attributes
from scenes import synthetic

pytestmark = pytest.mark.usefixtures("variant_llvm")


def in_middles():
    """Samples of which some are in the middles of pixels, and some hidden ones."""
    x, y = np.meshgrid(np.arange(6) + 0.5, np.arange(4) + 0.5)
    columns = {
        "x": np.concatenate([x.ravel(), x.ravel() + 0.3, x.ravel()]),
        "y": np.concatenate([y.ravel()] * 3),
        "z": np.repeat([2.0, 3.0, 9.0], 24),
        "surface": np.repeat([5, 6, 7], 24),
        "layer": np.repeat([0, 0, 1], 24).astype(np.uint8),
    }
    return synthetic(72, size=(6, 4)).replace(**columns)


def test_maps_are_of_what_is_in_the_middles_of_pixels():
    samples = in_middles()
    np.testing.assert_array_equal(depth_map(samples), np.full((4, 6), 2.0))
    np.testing.assert_array_equal(surface_map(samples), np.full((4, 6), 5))
    assert np.isinf(depth_map(samples.chosen(samples.x > 3))[:, :3]).all()


@pytest.mark.parametrize("film", ["focal", "focused"])
def test_the_map_of_circles_is_theirs_of_the_lens_and_signed(film):
    samples = in_middles()
    lens = samples.lens.replace(focus_distance=2.5, film=film)
    pixels_per_mm = samples.camera.film_size[0] / (
        2 * math.tan(math.radians(samples.camera.x_fov / 2)) * lens.film_distance
    )
    diameter = lens.circle_of_confusion(2.0) * pixels_per_mm
    np.testing.assert_allclose(circle_map(samples, lens), diameter, rtol=1e-4)


def test_a_picture_says_what_the_standard_has_attributes_for(tmp_path):
    lens = pm.ThinLens.of_field_of_view(
        40.0, f_number=2.8, focus_distance=1.5, millimeters_per_unit=1000.0
    )
    to_world = np.eye(4)
    to_world[:3, 3] = (1, 2, 3)
    camera = pm.Camera((8, 4), (0, 0), (8, 4), 40.0, tuple(map(tuple, to_world.tolist())))
    write_picture(np.ones((4, 8, 3)), tmp_path / "a.exr", standard_attributes(camera, lens))
    with OpenEXR.File(str(tmp_path / "a.exr")) as file:
        header = dict(file.header())
    assert header["aperture"] == pytest.approx(2.8)
    assert header["focus"] == pytest.approx(1.5)
    assert header["nominalFocalLength"] == pytest.approx(lens.focal_length)
    assert header["screenWindowWidth"] == pytest.approx(2 * math.tan(math.radians(20)))
    np.testing.assert_allclose(header["sensorOverallDimensions"], (36, 18))
    # A point before the camera, to its right and up, as rows: x right, y up, z forward.
    point = np.array([1 - 0.5, 2 + 0.25, 3 + 4, 1]) @ header["worldToCamera"]
    np.testing.assert_allclose(point, (0.5, 0.25, 4, 1), atol=1e-6)
    write_picture(np.ones((4, 8, 4)), tmp_path / "a.png", standard_attributes(camera, lens))
    spec = oiio.ImageInput.open(str(tmp_path / "a.png")).spec()
    assert float(spec.getattribute("focus")) == pytest.approx(1.5)


def test_a_picture_with_its_maps_is_read_again_as_it_is(tmp_path):
    """What this package writes it refocuses without an option."""
    samples = in_middles().replace(alpha=np.ones(72))
    pinhole = samples.lens.replace(f_number=math.inf)
    rgb = np.array(pm.focus(samples, pinhole))
    said = standard_attributes(samples.camera, samples.lens)
    path = tmp_path / "a.exr"
    write_picture(rgb, path, said, maps_of(samples, ("depth", "coc", "id")))
    found = pm.PointSamples.from_image(path)
    np.testing.assert_allclose(found.rgb, rgb.reshape(-1, 3), atol=1e-6)
    np.testing.assert_allclose(found.z, 2.0)
    assert found.lens.f_number == pytest.approx(samples.lens.f_number)
    assert found.lens.focus_distance == pytest.approx(samples.lens.focus_distance)
    assert found.camera.x_fov == pytest.approx(samples.camera.x_fov)


@pytest.mark.filterwarnings("always:.*formed through a lens")
@pytest.mark.parametrize("f_number", ["0.5", "inf"])
def test_a_picture_that_is_blurred_already_warns_when_it_is_focused(tmp_path, capsys, f_number):
    stored, path = tmp_path / "a.samples", str(tmp_path / "a.exr")
    in_middles().save(stored)
    formed = ["focus", str(stored), "--f-number", f_number, "-o", path, "--maps", "depth"]
    assert main(formed) == 0
    again = ["focus", path, "--f-number", "1", "-o", str(tmp_path / "b.exr")]
    assert main(again) == 0
    assert ("formed through a lens" in capsys.readouterr().err) == (f_number == "0.5")


def test_focus_writes_maps_into_an_exr_and_only_there(tmp_path, capsys):
    stored = tmp_path / "a.samples"
    in_middles().save(stored)
    path = tmp_path / "a.exr"
    assert main(["focus", str(stored), "-o", str(path), "--maps", "depth", "id"]) == 0
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        assert {"R", "G", "B", "Z", "id"} <= set(channels)
        np.testing.assert_array_equal(channels["Z"].pixels, np.full((4, 6), 2.0, np.float32))
    assert main(["focus", str(stored), "-o", str(tmp_path / "a.png"), "--maps", "coc"]) == 1
    assert "only an EXR" in capsys.readouterr().err
