"""Plans: what is to be done, as data, and what is done."""

import json
import math

import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi._image import read_srgb
from potmesil_mi.optics.blur import Blur
from potmesil_mi.samples.maps import circle_map
from potmesil_mi.stacks.foci import Foci
from potmesil_mi.stacks.forming import Forming
from potmesil_mi.stacks.layouts import plain_files
from potmesil_mi.stacks.plan import StackPlan
from scenes import evenly_spread

HOW = {"source": "some.samples", "method": "paper"}


def plan_in(folder, lens, distances=(1.5, math.inf), **fields):
    files = plain_files([str(folder / "{:02d}.png")])
    return StackPlan.of(Foci(distances).lenses(lens), files, **{"how": HOW, **fields})


@pytest.fixture(scope="module")
def samples():
    return evenly_spread((32, 24), 2).replace(provenance={"seed": 3, "spp": 4})


@pytest.fixture
def forming(samples, variant_llvm):
    return Forming(pm.FocusSession(samples, "paper"))


def test_a_plan_goes_through_json_unchanged(tmp_path):
    for lens in (pm.ThinLens(50.0, 2.0, 9e9), pm.TelecentricLens(2.0, 1.0)):
        distances = (100.0, math.inf) if isinstance(lens, pm.ThinLens) else (1.0, 2.0)
        plan = plan_in(tmp_path, lens, distances, maps=frozenset({"depth"}))
        text = json.dumps(plan.to_dict(), allow_nan=False)
        assert StackPlan.from_dict(json.loads(text)) == plan


def test_what_is_done_is_not_to_be_done_until_it_is_asked_for_otherwise(tmp_path, forming, samples):
    plan = plan_in(tmp_path, samples.lens)
    assert plan.to_do([0, 1]) == plan.items
    forming.do(plan, plan.items[:1])
    assert plan.to_do([0, 1]) == plan.items[1:]
    assert plan.to_do([0, 1], overwrite=True) == plan.items
    other = plan_in(tmp_path, samples.lens.replace(f_number=4.0))
    assert other.to_do([0]) == other.items[:1]
    assert plan_in(tmp_path, samples.lens, how={**HOW, "seed": 1}).to_do([0]) != []
    (tmp_path / "00.png").unlink()
    assert plan.to_do([0]) == plan.items[:1]


def test_maps_that_are_not_there_are_lacked_and_made(tmp_path, forming, samples):
    plan = plan_in(tmp_path, samples.lens, maps=frozenset({"depth", "pinhole"}))
    forming.do(plan, [])
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "depth.exr", "pinhole.exr", "stack.json",
    ]  # fmt: skip
    assert not plan.lacks_maps
    (tmp_path / "depth.exr").unlink()
    assert plan.lacks_maps


def test_what_is_told_of_a_picture_is_that_of_its_lens_and_camera(tmp_path, forming, samples):
    plan = plan_in(tmp_path, samples.lens, (2.0, math.inf), maps=frozenset({"circles"}))
    forming.do(plan, plan.items)
    told = json.loads((tmp_path / "stack.json").read_text())
    first, last = told["pictures"]
    alone = json.loads((tmp_path / "01.json").read_text())
    about = {name: value for name, value in told.items() if name != "pictures"}
    assert alone == {**about, **last, "format": "potmesil picture"}
    assert (last["focus_distance"], last["focus_distance_m"]) == ("inf", "inf")
    assert told["samples"]["provenance"] == {"seed": 3, "spp": 4}
    assert told["source"] == "some.samples"
    camera, lens = samples.camera, samples.lens
    focal = camera.focal_length_pixels
    assert told["camera"]["intrinsics"] == {"fx": focal, "fy": focal, "cx": 16, "cy": 12}
    assert told["camera"]["image_size"] == [32, 24]
    assert first["f_number"] == 2.0
    assert first["aperture_diameter_mm"] == 25.0
    # A point that is seen at a slope of 1 is a focal length from the middle of the film.
    assert first["pixel_pitch_mm"] * focal == pytest.approx(lens.film_distance)
    circles, depth = first["circle_of_confusion"], np.array([1.2, 4.0])
    expected = 2 * Blur.of(lens.replace(focus_distance=2.0), camera).radius(1 / depth)
    np.testing.assert_allclose(circles["scale"] * (1 / depth - 1 / 2.0), expected)
    largest = np.abs(circle_map(samples, lens.replace(focus_distance=2.0))).max()
    assert circles["largest_pixels"] >= largest * (1 - 1e-6)
    assert read_srgb(tmp_path / "00.png").shape == (24, 32, 3)


def test_what_cannot_be_written_is_raised_or_told_and_the_rest_is_made(
    tmp_path, forming, samples, monkeypatch
):
    plan = plan_in(tmp_path, samples.lens, (1.5, 2.0, 3.0))
    write, failures = Forming.write, []

    def fails(self, plan, item, picture):
        if item.index == 1:
            raise OSError("no room")
        write(self, plan, item, picture)

    monkeypatch.setattr(Forming, "write", fails)
    forming.do(plan, plan.items, lambda what, error: failures.append((what, str(error))))
    assert failures == [(str(tmp_path / "01.png"), "no room")]
    assert plan.to_do(range(3)) == [plan.items[1]]
    with pytest.raises(OSError, match="no room"):
        forming.do(plan, plan.items)


def test_a_picture_whose_writing_was_stopped_is_not_done(tmp_path, forming, samples, monkeypatch):
    """Not even where what is told of the one before it would be right of it."""
    plan, other = (plan_in(tmp_path, samples.lens, (distance,)) for distance in (1.5, 3.0))
    forming.do(plan, plan.items)

    def stopped(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("potmesil_mi.stacks.forming.write_json", stopped)
    with pytest.raises(KeyboardInterrupt):
        forming.write(other, other.items[0], np.zeros((24, 32, 3)))
    assert plan.to_do([0]) == plan.items


def test_two_stacks_are_not_in_one_folder(tmp_path, forming, samples):
    plan = plan_in(tmp_path, samples.lens)
    forming.do(plan, plan.items[:1])
    plan.check([])
    files = plain_files([str(tmp_path / "other_{}.exr")])
    with pytest.raises(ValueError, match=r"stack.json: is of other pictures, such as 00.png"):
        StackPlan.of([samples.lens], files, how=HOW).check([])


def test_no_file_of_a_stack_takes_the_place_of_a_source(tmp_path, samples):
    plan = plan_in(tmp_path, samples.lens, maps=frozenset({"depth"}))
    for name in ("01.png", "01.json", "depth.exr", "stack.json"):
        with pytest.raises(ValueError, match=f"{name}: a .* must not take its place"):
            plan.check([str(tmp_path / name)])
