"""Layouts of files: their names, and what readers of other programs find in them."""

import json
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

import potmesil_mi as pm
from potmesil_mi._image import srgb_from_linear
from potmesil_mi.samples.maps import depth_map
from potmesil_mi.stacks.foci import Foci
from potmesil_mi.stacks.forming import Forming
from potmesil_mi.stacks.layouts import fod500_files, plain_files
from potmesil_mi.stacks.plan import StackPlan
from scenes import evenly_spread

MAPS = frozenset({"depth", "circles", "pinhole"})


def read_8_bit(path):
    import OpenImageIO as oiio

    image = oiio.ImageInput.open(str(path))
    assert str(image.spec().format) == "uint8"
    pixels = image.read_image("uint8")
    image.close()
    return pixels


def read_depth(path):
    """As the readers of the layout do: the bytes of R, in the half precision of the file."""
    file = OpenEXR.InputFile(str(path))
    window = file.header()["dataWindow"]
    size = window.max.y - window.min.y + 1, window.max.x - window.min.x + 1
    red, _, _ = file.channels("RGB")
    return np.frombuffer(red, np.float16).reshape(size)


def listed(folder, ending):
    """As the readers do: sorted names that end so."""
    return sorted(path.name for path in folder.iterdir() if path.name[-7:] == ending)


def test_files_of_the_layout_plain_are_beside_the_pictures(tmp_path):
    files = plain_files([str(tmp_path / "{:03d}/a.exr"), str(tmp_path / "{:03d}/a.png")])
    assert files.folder == tmp_path
    assert Path(files.depth) == tmp_path / "depth.exr"
    lenses = Foci([100.0, 200.0]).lenses(pm.ThinLens(50.0, 2.0))
    plan = StackPlan.of(lenses, files, how={}, maps=MAPS)
    told = [files.told(path) for path in plan.paths(plan.items[1])]
    assert told == ["001/a.exr", "001/a.png", "001/a.coc.exr", "001/a.json"]


@pytest.mark.parametrize(
    ("patterns", "message"),
    [
        (["a.exr"], "must have one place for the number"),
        (["{}.samples"], "must end in one of"),
        (["a/{}.exr", "b/{}.png"], "must be in a, where stack.json will be"),
    ],
)
def test_names_that_cannot_be_are_refused(patterns, message):
    with pytest.raises(ValueError, match=message):
        plain_files(patterns)
    with pytest.raises(ValueError, match="must end in a number of six digits"):
        fod500_files("fod/12", 5)


@pytest.mark.usefixtures("variant_llvm")
def test_readers_of_defocusnet_s_data_find_pictures_and_depth_in_metres(tmp_path):
    samples = evenly_spread((32, 24), 2).replace(
        lens=pm.ThinLens(5.0, 2.0, 20.0, millimeters_per_unit=100.0)
    )
    forming = Forming(pm.FocusSession(samples))
    distances = [10.0, 20.0, 50.0]
    for number in (0, 1):
        files = fod500_files(str(tmp_path / f"{number:06d}"), len(distances))
        lenses = Foci(distances).lenses(samples.lens)
        plan = StackPlan.of(lenses, files, how={"source": "x"}, maps=MAPS)
        forming.do(plan, plan.items)
    pictures, depths = listed(tmp_path, "All.tif"), listed(tmp_path, "Dpt.exr")
    assert (len(pictures), len(depths)) == (6, 2)
    assert [int(name[:6]) for name in pictures] == [0, 0, 0, 1, 1, 1]
    assert len(listed(tmp_path, "Aif.tif")) == 2
    found = read_8_bit(tmp_path / pictures[1 * 3 + 2])
    linear = np.array(pm.focus(samples, lenses[2]))
    np.testing.assert_allclose(found, srgb_from_linear(linear.clip(0, 1)) * 255, atol=0.51)
    metres = read_depth(tmp_path / depths[1])
    np.testing.assert_allclose(metres, depth_map(samples) / 10, rtol=1e-3)
    told = json.loads((tmp_path / "000001.json").read_text())
    assert told["pictures"][2]["focus_distance_m"] == 5.0
    assert told["depth"]["kind"].startswith("z along the axis, metres")
