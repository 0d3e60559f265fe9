"""AOVs of samples: their names, files of them, maps, and what merging makes of them."""

import numpy as np
import OpenEXR
import pytest

import potmesil_mi as pm
from potmesil_mi._image import write_picture
from potmesil_mi.samples.aovs import LONGEST_AOV_NAME, MOST_AOVS
from potmesil_mi.samples.maps import maps_of
from scenes import synthetic

NAMES = ("dd.T", "nn.X", "si.I")


def with_aovs(count=300, names=NAMES, **fields):
    values = np.random.default_rng(3).uniform(-5, 5, (count, len(names)))
    return synthetic(count, **{"aovs": values, "aov_names": names, **fields})


def by_place(samples):
    """The AOVs in an order that files keep."""
    return samples.aovs[np.lexsort((samples.y, samples.x))]


@pytest.mark.parametrize(
    ("fields", "error", "text"),
    [
        ({"aov_names": ()}, ValueError, "aov_names=.*: has 0 names, must have 3"),
        ({"aovs": None}, ValueError, "aov_names=.*: has 3 names, must have 0"),
        ({"aovs": np.zeros((300, 2))}, ValueError, "aov_names=.*: has 3 names, must have 2"),
        ({"aovs": np.zeros(300)}, ValueError, r"aovs=.*: has shape \(300,\), must have \(300, 1\)"),
        ({"aovs": np.zeros((300, 0))}, ValueError, r"aovs=.*: has shape \(300, 0\), must have"),
        ({"aov_names": ("a", "b", "b")}, ValueError, "aov_names=.*: 'b' is there twice"),
        ({"aov_names": "abc"}, TypeError, "aov_names='abc': must be a sequence of names"),
        ({"aov_names": ("a", "b", 3)}, TypeError, "aov_names=.*: 3 must be text"),
        ({"aov_names": ("a", "b", "\ud800")}, ValueError, "aov_names=.*must be printable"),
    ],
)
def test_each_aov_has_a_name_of_its_own(fields, error, text):
    with pytest.raises(error, match=text):
        with_aovs(**fields)


def test_samples_have_no_aovs_unless_they_are_given():
    assert synthetic(5).aovs is None
    assert synthetic(5).aov_names == ()
    assert with_aovs().replace(aovs=None, aov_names=()).aovs is None


@pytest.mark.parametrize("ending", ["exr", "samples"])
def test_files_keep_as_many_aovs_as_samples_may_have(tmp_path, ending):
    names = tuple(f"{i}.é".ljust(LONGEST_AOV_NAME - 1, "x") for i in range(MOST_AOVS))
    samples = with_aovs(50, names, layer=np.arange(50) % 2)
    samples.save(tmp_path / f"a.{ending}")
    found = pm.PointSamples.load(tmp_path / f"a.{ending}")
    assert found.aov_names == names
    np.testing.assert_array_equal(by_place(found), by_place(samples))


def test_other_programs_find_aovs_in_channels_of_their_names(tmp_path):
    with_aovs().save(tmp_path / "a.exr")
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        assert {"aov.dd.T", "aov.nn.X", "aov.si.I"} <= set(file.channels())


def test_a_deep_exr_without_the_channel_of_an_aov_is_refused(tmp_path):
    path = tmp_path / "a.exr"
    with_aovs().save(path)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        header = {n: v for n, v in file.header().items() if n not in ("channels", "name")}
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    del channels["aov.nn.X"]
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))
    with pytest.raises(ValueError, match=r"it has no channel aov\.nn\.X"):
        pm.PointSamples.load(path)


def test_merged_samples_have_the_mean_of_values_and_one_of_the_ids():
    ids = np.array([5.0, 900.0, 70.0, 8.0])
    samples = synthetic(
        4,
        x=[3.1, 3.2, 3.3, 7.5],
        y=[2.1] * 4,
        z=[2.0] * 4,
        surface=[1] * 4,
        weight=[1.0, 2.0, 1.0, 1.0],
        aovs=np.stack([ids, ids], axis=1),
        aov_names=("dd.T", "si.I"),
    )
    merged = samples.merge(tolerance=1.0)
    assert len(merged) == 2
    many, one = np.argsort(merged.x)
    assert merged.aovs[many, 0] == pytest.approx((5 + 2 * 900 + 70) / 4)
    assert merged.aovs[many, 1] in ids[:3]
    np.testing.assert_array_equal(merged.aovs[one], [8, 8])


def in_and_beside_middles():
    """In each of 4 x 3 pixels a visible sample in the middle, one beside it, and a hidden one."""
    x, y = (of.ravel() + 0.5 for of in np.meshgrid(np.arange(4), np.arange(3)))
    place = np.arange(12.0)
    values = np.stack([np.concatenate([place, place + 100, place + 200])] * 2, axis=1)
    return synthetic(
        36,
        size=(4, 3),
        x=np.concatenate([x, x + 0.2, x]),
        y=np.tile(y, 3),
        layer=np.repeat([0, 0, 1], 12),
        z=np.full(36, 2.0),
        aovs=values * [1, -1],
        aov_names=("dd.T", "si.I"),
        albedo=np.tile([0.1, 0.2, 0.3], (36, 1)),
        normal=np.tile([0.0, 0.6, 0.8], (36, 1)),
    )


def test_maps_of_aovs_are_those_of_one_sample_in_the_middle():
    samples = in_and_beside_middles()
    maps = pm.aov_maps(samples)
    assert list(maps) == ["dd.T", "si.I"]
    np.testing.assert_array_equal(maps["dd.T"], np.arange(12).reshape(3, 4))
    np.testing.assert_array_equal(maps["si.I"], -maps["dd.T"])
    there = pm.aov_maps(samples.chosen(samples.x > 2))
    np.testing.assert_array_equal(there["dd.T"][:, :2], 0)
    assert pm.aov_maps(synthetic(5)) == {}


def test_maps_in_files_say_that_aovs_are_not_focused(tmp_path):
    samples = in_and_beside_middles()
    maps = maps_of(samples, ("depth", "aovs", "normal", "albedo"))
    normal, albedo = ["N.X", "N.Y", "N.Z"], ["albedo.R", "albedo.G", "albedo.B"]
    assert list(maps) == ["Z", "unfocused.dd.T", "unfocused.si.I", *normal, *albedo]
    np.testing.assert_array_equal(maps["N.Z"], np.full((3, 4), np.float32(0.8)))
    with pytest.raises(ValueError, match="aovs: the samples have none"):
        maps_of(synthetic(5), ("aovs",))
    with pytest.raises(ValueError, match="normal: the samples have none"):
        maps_of(synthetic(5), ("normal",))
    # The colours and the depth are still told from all of these.
    write_picture(np.ones((3, 4, 3)), tmp_path / "a.exr", {}, maps)
    lens = {"f_number": 2.0, "focus_distance": 2.0, "millimeters_per_unit": 1000.0}
    found = pm.PointSamples.from_image(tmp_path / "a.exr", camera=40.0, lens=lens, depth_kind="z")
    np.testing.assert_array_equal(found.rgb, 1)
    np.testing.assert_array_equal(found.z, 2)
