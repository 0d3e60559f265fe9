"""``potmesil dataset``: stacks by a recipe, in parts and again, with what fails told."""

import json

import mitsuba as mi
import numpy as np
import pytest
from cli.test_stack import pictures_in

import potmesil_mi as pm
from potmesil_mi import cli
from potmesil_mi.tracing import hidden_surface
from scenes import SCENES

pytestmark = pytest.mark.usefixtures("variant_llvm")

RECIPE = f"""
seed = 7
[[scenes]]
path = "{(SCENES / "figure11.xml").as_posix()}"
define = {{ res = 16 }}
[sampling]
spp = 2
refine = 0
[cameras]
count = 2
pan = {{ uniform = [-3, 3] }}
move = [5, 0, 0]
[apertures]
count = 2
f_number = {{ log_uniform = [2, 8] }}
[foci]
count = 2
distance = {{ reciprocal_uniform = [300, 2000] }}
"""


@pytest.fixture
def recipe(tmp_path):
    path = tmp_path / "recipe.toml"
    path.write_text(RECIPE, encoding="utf-8")
    return path


def dataset(folder, recipe, *more):
    return cli.main(["dataset", str(recipe), "-o", str(folder), *more])


def texts_in(folder):
    return {path.relative_to(folder): path.read_text() for path in folder.rglob("*.json")}


def test_a_scene_is_sampled_once_for_each_camera_and_again_for_none(
    tmp_path, recipe, monkeypatch, capsys
):
    taken = []
    render = hidden_surface.render_samples

    def counted(*arguments, **options):
        taken.append((render(*arguments, **options), options))
        return taken[-1][0]

    monkeypatch.setattr(hidden_surface, "render_samples", counted)
    folder = tmp_path / "data"
    assert dataset(folder, recipe) == 0
    assert len(taken) == 2
    index = json.loads((folder / "dataset.json").read_text())
    for view, (samples, options) in zip(index["views"], taken, strict=True):
        assert options["seed"] == view["seed"]
        lens = samples.lens
        f_numbers = [stack["changes"]["f_number"] for stack in view["stacks"]]
        if min(f_numbers) < lens.f_number:
            assert options["sampling"].min_f_number == pytest.approx(min(f_numbers))
        to_world = np.array(samples.camera.to_world)
        np.testing.assert_allclose(to_world[:3, 3], [5, 0, 0], atol=1e-5)
        turn = np.degrees(np.arctan2(to_world[0, 2], -to_world[2, 2]))
        assert turn == pytest.approx(view["turn"]["pan"], abs=1e-4)
        for stack in view["stacks"]:
            told = json.loads((folder / stack["stack"]).read_text())
            np.testing.assert_allclose(told["camera"]["camera_to_world"], to_world)
            own = (folder / stack["stack"]).parent
            assert sorted(pictures_in(own)) == ["0000.exr", "0001.exr"]
            assert (own / told["maps"]["depth"]).is_file()
            assert (own / told["pictures"][1]["circles"]).is_file()
    chosen = lens.replace(
        focus_distance=told["pictures"][0]["focus_distance"], f_number=f_numbers[-1]
    )
    rfilter = mi.load_file(str(SCENES / "figure11.xml"), res=16).sensors()[0].film().rfilter()
    expected = np.array(pm.focus(samples, chosen, rfilter=rfilter))
    np.testing.assert_allclose(pictures_in(own)["0000.exr"], expected, rtol=1e-4, atol=1e-5)
    assert dataset(folder, recipe) == 0
    assert len(taken) == 2
    assert "8 of 8 pictures are there already and stay" in capsys.readouterr().err


def test_parts_in_any_order_make_what_one_run_makes(tmp_path, recipe):
    assert dataset(tmp_path / "whole", recipe) == 0
    for shard in ("2/3", "1/3", "3/3"):
        assert dataset(tmp_path / "parts", recipe, "--shard", shard) == 0
    assert texts_in(tmp_path / "parts") == texts_in(tmp_path / "whole")
    assert len(texts_in(tmp_path / "whole")) == 1 + 2 * 2 * (1 + 2)


def test_what_fails_is_told_at_the_end_and_the_rest_is_made(tmp_path, recipe, capsys):
    text = RECIPE.replace("[sampling]", '[[scenes]]\npath = "absent.xml"\n[sampling]')
    recipe.write_text(text.replace("count = 2\npan", "count = 1\npan"), encoding="utf-8")
    assert dataset(tmp_path / "data", recipe) == 1
    told = capsys.readouterr().err
    assert "potmesil: absent, sensor 0, camera 0: " in told
    assert "1 pictures or cameras could not be made" in told
    assert len(list((tmp_path / "data" / "figure11").rglob("000?.exr"))) == 4
    distance = "distance = { reciprocal_uniform = [300, 2000] }"
    recipe.write_text(
        RECIPE.replace(distance, "distance = { choice = [10, 900] }").replace(
            "count = 2\npan", "count = 1\npan"
        ),
        encoding="utf-8",
    )
    assert dataset(tmp_path / "other", recipe) == 1
    assert "[foci]: distances[" in capsys.readouterr().err


def test_the_layout_of_defocusnet_has_one_folder(tmp_path, recipe):
    text = RECIPE.replace("count = 2\npan", "count = 1\npan")
    recipe.write_text('layout = "fod500"\nmaps = ["depth"]\n' + text, encoding="utf-8")
    assert dataset(tmp_path / "data", recipe) == 0
    names = sorted(path.name for path in (tmp_path / "data").iterdir())
    assert [name for name in names if not name.endswith(".json")] == [
        "000000Dpt.exr", "000000_00All.tif", "000000_01All.tif",
        "000001Dpt.exr", "000001_00All.tif", "000001_01All.tif",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("refine = 0", "refine = -1", "[sampling].refine=-1"),
        ("refine = 0", "refined = 0", "[sampling].refined: unknown"),
        ("spp = 2", "spp = -2", "[sampling].spp=-2"),
        ("[2, 8]", "[-2, 8]", "[apertures].f_number.log_uniform[0]=-2"),
        ("seed = 7", "seed = ", "is not TOML"),
    ],
)
def test_what_is_wrong_is_told_with_the_recipe_and_the_key(
    tmp_path, recipe, capsys, before, after, message
):
    recipe.write_text(RECIPE.replace(before, after), encoding="utf-8")
    assert dataset(tmp_path / "data", recipe) == 1
    told = capsys.readouterr().err
    assert "recipe.toml: " in told
    assert message in told
    assert not (tmp_path / "data").exists()


def test_a_scene_in_centimetres_says_so_and_lengths_have_units(tmp_path, recipe, capsys):
    text = RECIPE.replace("define =", 'units = "cm"\ndefine =').replace("[300, 2000]", "[30, 200]")
    text = text.replace("move = [5, 0, 0]", 'move = ["50mm", 0, 0]').replace("count = 2\n", "")
    with_units = text.replace("[30, 200]", '["30cm", "2m"]')
    told = []
    for name, written in (("a", text), ("b", with_units)):
        recipe.write_text(written, encoding="utf-8")
        assert dataset(tmp_path / name, recipe) == 0
        (path,) = (tmp_path / name).rglob("stack.json")
        told.append(json.loads(path.read_text()))
    for one in told:
        lens = one["pictures"][0]["lens"]
        assert lens["millimeters_per_unit"] == 10
        assert one["camera"]["camera_to_world"][0][3] == pytest.approx(5, abs=1e-5)
    distances = [one["pictures"][0]["focus_distance"] for one in told]
    assert distances[0] == pytest.approx(distances[1])
    assert "0cm" not in capsys.readouterr().err
