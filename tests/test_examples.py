"""The scenes that come with the package, by name, in Python and on the command line."""

import mitsuba as mi
import pytest

import potmesil_mi as pm
from potmesil_mi import cli
from potmesil_mi._examples import file_of
from scenes import SCENES


def test_every_scene_motion_and_recipe_is_an_example_with_a_sentence_about_it():
    scenes = [path.stem for path in SCENES.glob("*.xml")]
    others = [
        f"{folder}/{path.stem}"
        for folder in ("motions", "recipes")
        for path in SCENES.glob(f"{folder}/*.toml")
    ]
    assert others
    assert sorted(pm.examples()) == sorted(scenes + others)
    for name, sentence in pm.examples().items():
        assert sentence.endswith("."), name
        assert "\n" not in sentence
        assert 2 < len(sentence.split()) < 50, name


def test_an_example_is_the_file_of_the_folder():
    assert pm.example("terrace").samefile(SCENES / "terrace.xml")
    assert pm.example("motions/ball").samefile(SCENES / "motions" / "ball.toml")


@pytest.mark.parametrize(
    ("name", "alike"), [("terace", "terrace"), ("figure12", "figure11"), ("balls", "")]
)
def test_an_unknown_example_is_told_which_there_are_and_which_is_like_it(name, alike):
    with pytest.raises(ValueError, match=f"name='{name}': must be one of .*figure10") as caught:
        pm.example(name)
    assert ("did you mean" in str(caught.value)) is bool(alike)
    assert str(caught.value).endswith(f"did you mean {alike}?") or not alike


@pytest.mark.parametrize("name", ["../README", "terrace.xml", "", "fragments/paper"])
def test_a_path_is_no_name_of_an_example(name):
    with pytest.raises(ValueError, match="must be one of"):
        pm.example(name)


def test_other_names_of_files_stay_what_they_are():
    assert file_of("terrace.xml") == "terrace.xml"
    assert file_of("examples/example:terrace") == "examples/example:terrace"


SMALL = ["-D", "res=16", "-D", "spp=4"]
MOVING = ["render", "example:moving", "-D", "res=16", "-D", "height=16", "-D", "spp=4"]
PULL = ["animate", "example:figure11", "example:motions/pull"]


@pytest.mark.parametrize(
    ("arguments", "written"),
    [
        (["render", "example:figure11", *SMALL, "-o", "a.exr"], "a.exr"),
        ([*MOVING, "--motion", "example:motions/ball", "-o", "a.exr"], "a.exr"),
        ([*PULL, *SMALL, "--frames", "0-1", "-o", "{:02d}.exr"], "01.exr"),
    ],
    ids=["render", "motion", "animate"],
)
def test_commands_take_examples(variant_llvm, arguments, written, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(arguments) == 0
    assert mi.Bitmap(written).width() == 16


def test_compare_takes_an_example(variant_llvm, monkeypatch):
    from potmesil_mi.evaluation import comparison

    compared = []

    def instead(scene, sensor, **_):
        compared.extend([scene, sensor])
        raise ValueError("enough")

    monkeypatch.setattr(comparison, "compare", instead)
    assert cli.main(["compare", "example:figure11", *SMALL]) == 1
    assert len(compared) == 2


@pytest.mark.parametrize(
    "arguments",
    [
        ["render", "example:terace", "-o", "a.png"],
        ["compare", "example:terace"],
        ["animate", "example:terace", "example:motions/pull", "-o", "{}.png"],
    ],
    ids=lambda arguments: arguments[0],
)
def test_an_unknown_example_on_the_command_line_is_one_line_with_exit_code_1(arguments, capsys):
    assert cli.main(arguments) == 1
    message = capsys.readouterr().err
    assert message.startswith("potmesil: error: name='terace': must be one of ")
    assert message.endswith("did you mean terrace?\n")
