"""How samples were made: what may be said of it, that it is kept, and what pictures say."""

import json
import math

import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pytest

import potmesil_mi as pm
from potmesil_mi._image import write_picture
from potmesil_mi._version import package_version
from potmesil_mi.samples.formed import attributes_of_formed
from potmesil_mi.samples.header import Header
from potmesil_mi.samples.provenance import (
    LONGEST_TEXT,
    MOST_ENTRIES,
    as_provenance,
    checked_provenance,
    file_name,
)
from scenes import synthetic

SAID = {"version": "0.1.0", "scene": "a.xml", "seed": (1 << 32) - 1, "spp": 4, "refine": 0.25}


@pytest.mark.parametrize(
    "wrong",
    [
        [("seed", 1)],
        {"Seed": 1},
        {"": 1},
        {"7up": 1},
        {"a" * 65: 1},
        {1: 1},
        {f"n{i}": i for i in range(MOST_ENTRIES + 1)},
        {"seed": None},
        {"seed": True},
        {"seed": [1]},
        {"seed": 1 << 63},
        {"refine": math.nan},
        {"refine": math.inf},
        {"scene": "a\nb"},
        {"scene": "a\udc80"},
        {"scene": "a" * (LONGEST_TEXT + 1)},
    ],
)
def test_what_is_no_provenance_is_refused_by_name(wrong):
    with pytest.raises((TypeError, ValueError), match="provenance"):
        synthetic(50).replace(provenance=wrong)


def test_what_is_allowed_is_copied():
    own = {"a" * 64: "a" * LONGEST_TEXT, "_a.b9": -(1 << 62), "c": 1e300}
    found = checked_provenance(own)
    assert found == own
    assert found is not own


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (False, 0),
        (3, 3),
        (0.25, 0.25),
        ((0.8, 3.0), "0.8/3.0"),
        ("a\nb", "a?b"),
        ("a" * 2000, "a" * (LONGEST_TEXT - 3) + "..."),
    ],
)
def test_settings_are_values_that_are_allowed(value, expected):
    assert as_provenance(value) == expected
    assert checked_provenance({"value": as_provenance(value)})["value"] == expected


def test_of_files_only_the_name_is_told():
    assert file_name("/home/me/b\udc80.xml") == "b?.xml"


def test_all_that_is_made_of_samples_says_how_they_were_made():
    samples = synthetic(400).replace(provenance=SAID)
    left, top, _, _ = samples.crop_window
    for made in (
        samples.replace(weight=2 * samples.weight),
        samples.crop(pm.Window(left, top, 8, 8)),
        samples.merge(),
        samples.visible(),
        samples.chosen(slice(0, 9)),
    ):
        assert made.provenance == SAID


@pytest.mark.parametrize("name", ["a.samples", "a.exr"])
def test_files_of_samples_keep_it(tmp_path, name):
    synthetic(100).replace(provenance=SAID).save(tmp_path / name)
    assert pm.PointSamples.load(tmp_path / name).provenance == SAID
    synthetic(100).save(tmp_path / name)
    assert pm.PointSamples.load(tmp_path / name).provenance == {}


def test_a_header_is_as_it_was_before_where_nothing_is_said_and_is_not_trusted():
    samples = synthetic(50)
    header = Header(samples.camera, samples.lens, samples.window, {}, 0)
    texts = header.texts(1)
    assert json.loads(texts["samples"]) == {"version": 1, "lattice": 0}
    for wrong in ({"Seed": 1}, {"seed": math.inf}, {"seed": {}}, []):
        texts["samples"] = json.dumps({"version": 1, "lattice": 0, "provenance": wrong})
        with pytest.raises((TypeError, ValueError), match="provenance"):
            Header.parse(texts, "{}", 1, samples.window, {})


def test_samples_of_a_picture_name_its_files_and_the_program(tmp_path):
    samples = synthetic(50)
    said = {**attributes_of_formed(samples, "layered"), "potmesil:formed": 0}
    maps = {"Z": np.full((14, 20), 2.0)}
    write_picture(np.ones((14, 20, 3)), tmp_path / "a.exr", said, maps)
    np.save(tmp_path / "z.npy", maps["Z"])
    found = pm.PointSamples.from_image(tmp_path / "a.exr").provenance
    assert found == {"version": package_version(), "picture": "a.exr", "program": "potmesil_mi"}
    found = pm.PointSamples.from_image(tmp_path / "a.exr", tmp_path / "z.npy", depth_kind="z")
    assert found.provenance["depth"] == "z.npy"
    assert "program" not in found.provenance


# ---------------------------------------------------------------- pictures


def attributes_of(path):
    spec = oiio.ImageInput.open(str(path)).spec()
    return {attribute.name: attribute.value for attribute in spec.extra_attribs}


def test_a_picture_says_of_what_and_by_what_it_was_formed(tmp_path):
    samples = synthetic(50).replace(provenance=SAID)
    lens = samples.lens.replace(focus_distance=math.inf, f_number=2)
    said = attributes_of_formed(samples, pm.Layered(lens_points=64), lens)
    write_picture(np.ones((14, 20, 3)), tmp_path / "a.exr", said)
    with OpenEXR.File(str(tmp_path / "a.exr")) as file:
        header = dict(file.header())
    assert header["Software"] == f"potmesil_mi {package_version()}"
    assert header["potmesil:focus_distance"] == math.inf
    assert header["potmesil:f_number"] == 2
    assert header["potmesil:method"] == "layered:lens_points=64"
    assert header["potmesil:sample_count"] == len(samples)
    assert header["potmesil:spp"] == 4
    assert int(header["potmesil:seed"]) == SAID["seed"]
    assert json.loads(header["potmesil:provenance"]) == SAID
    write_picture(np.ones((14, 20, 3)), tmp_path / "a.png", said)
    found = attributes_of(tmp_path / "a.png")
    assert found["Software"] == header["Software"]
    assert json.loads(found["potmesil:provenance"]) == SAID
    assert float(found["potmesil:focus_distance"]) == math.inf


def test_a_jpeg_says_it_in_a_line(tmp_path):
    samples = synthetic(50).replace(provenance=SAID)
    said = attributes_of_formed(samples, "layered", samples.lens.replace(f_number=2))
    write_picture(np.ones((14, 20, 3)), tmp_path / "a.jpg", said)
    found = attributes_of(tmp_path / "a.jpg")
    assert found["Software"] == f"potmesil_mi {package_version()}"
    line = found["ImageDescription"]
    assert line.startswith("f/2, focused at ")
    assert line.endswith(f", layered, 50 samples of a.xml, seed {SAID['seed']}, spp 4")
    assert len(found) < 12
