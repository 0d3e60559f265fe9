"""``potmesil stack``: pictures at many distances, of scenes and of samples, in parts and again."""

import json
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi import cli
from potmesil_mi.samples.maps import circle_map, depth_map, normal_map
from potmesil_mi.stacks.forming import Forming
from potmesil_mi.tracing import hidden_surface
from scenes import SCENES, evenly_spread

pytestmark = pytest.mark.usefixtures("variant_llvm")

FIGURE = str(SCENES / "figure11.xml")
SMALL = ["-D", "res=24", "-D", "spp=4"]
FOCI = ["--near", "1.5", "--far", "4", "--count", "3"]


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    path = tmp_path_factory.mktemp("stack") / "kept.samples"
    evenly_spread((32, 24), 2).save(path)
    return str(path)


def stack(folder, source, *more):
    return cli.main(["stack", source, "-o", str(folder / "{:02d}.exr"), *more])


def channels_of(path):
    import OpenImageIO as oiio

    image = oiio.ImageInput.open(str(path))
    names, pixels = image.spec().channelnames, image.read_image("float")
    image.close()
    return dict(zip(names, np.moveaxis(np.atleast_3d(pixels), 2, 0), strict=True))


def pictures_in(folder):
    found = {path.name: channels_of(path) for path in sorted(folder.glob("*.exr"))}
    return {name: np.stack([of[c] for c in "RGB"], 2) for name, of in found.items() if "R" in of}


def test_pictures_and_maps_of_samples_are_those_that_python_gives(tmp_path, kept):
    more = ["--depth-map", "--circle-map", "--pinhole"]
    assert stack(tmp_path, kept, *FOCI, "--f-numbers", "2", "4", *more) == 0
    samples = pm.PointSamples.load(kept)
    pictures = pm.focal_stack(samples, near=1.5, far=4.0, count=3, f_numbers=[2.0, 4.0])
    found = pictures_in(tmp_path)
    for i, picture in enumerate(pictures):
        np.testing.assert_allclose(found[f"{i:02d}.exr"], np.array(picture), rtol=1e-5, atol=1e-6)
    circles = channels_of(tmp_path / "04.coc.exr")
    assert list(circles) == ["coc"]
    np.testing.assert_allclose(circles["coc"], circle_map(samples, pictures.lenses[4]), rtol=1e-6)
    np.testing.assert_array_equal(channels_of(tmp_path / "depth.exr")["Z"], depth_map(samples))
    sharp = np.array(pm.focus(samples, samples.lens.replace(aperture_radius=0.0)))
    np.testing.assert_allclose(found["pinhole.exr"], sharp, rtol=1e-5, atol=1e-6)
    told = json.loads((tmp_path / "stack.json").read_text())
    assert [one["f_number"] for one in told["pictures"]] == [2, 2, 2, 4, 4, 4]
    assert [one["focus_distance"] for one in told["pictures"]] == [
        lens.focus_distance for lens in pictures.lenses
    ]
    assert told["maps"] == {"depth": "depth.exr", "pinhole": "pinhole.exr"}


def test_a_scene_is_sampled_once_for_the_widest_aperture_and_all_distances(tmp_path, monkeypatch):
    asked, taken = [], []
    render = hidden_surface.render_samples

    def counted(*arguments, **options):
        asked.append(options["sampling"])
        taken.append(render(*arguments, **options))
        return taken[-1]

    monkeypatch.setattr(hidden_surface, "render_samples", counted)
    more = ["--distances", "290", "2000", "--f-numbers", "5.6", "2.8", "--normals", "--seed", "5"]
    assert stack(tmp_path, FIGURE, *SMALL, *more) == 0
    assert len(asked) == 1
    assert asked[0].min_f_number == pytest.approx(2.8)
    assert asked[0].focus_range == (290, 2000)
    rfilter = mi.load_file(FIGURE).sensors()[0].film().rfilter()
    lens = taken[0].lens.replace(f_number=2.8, focus_distance=290)
    expected = np.array(pm.focus(taken[0], lens, rfilter=rfilter))
    np.testing.assert_allclose(pictures_in(tmp_path)["02.exr"], expected, rtol=1e-5, atol=1e-6)
    normals = channels_of(tmp_path / "normals.exr")
    found = np.stack([normals[f"normal.{axis}"] for axis in "XYZ"], 2)
    np.testing.assert_allclose(found, normal_map(taken[0]), atol=1e-6)
    told = json.loads((tmp_path / "stack.json").read_text())
    assert told["samples"]["provenance"]["seed"] == 5
    assert (told["source"], told["define"]) == ("figure11.xml", "res=24 spp=4")


def test_a_stack_that_was_interrupted_goes_on(tmp_path, kept, monkeypatch, capsys):
    assert stack(tmp_path / "whole", kept, *FOCI) == 0
    form = Forming.form

    def interrupted(self, item):
        if item.index == 2:
            raise KeyboardInterrupt
        return form(self, item)

    monkeypatch.setattr(Forming, "form", interrupted)
    assert stack(tmp_path / "parts", kept, *FOCI) == 130
    assert sorted(pictures_in(tmp_path / "parts")) == ["00.exr", "01.exr"]
    monkeypatch.setattr(Forming, "form", form)
    before = (tmp_path / "parts" / "00.exr").stat().st_mtime_ns
    capsys.readouterr()
    assert stack(tmp_path / "parts", kept, *FOCI) == 0
    assert "2 of 3 pictures are there already and stay" in capsys.readouterr().err
    assert (tmp_path / "parts" / "00.exr").stat().st_mtime_ns == before
    found, expected = (pictures_in(tmp_path / name) for name in ("parts", "whole"))
    assert found.keys() == expected.keys()
    for name, picture in expected.items():
        np.testing.assert_allclose(found[name], picture, rtol=1e-5, atol=1e-6)


def test_pictures_of_other_lenses_are_made_anew(tmp_path, kept, capsys):
    assert stack(tmp_path, kept, "--distances", "1.5", "2") == 0
    assert stack(tmp_path, kept, "--distances", "1.5", "3") == 0
    assert "1 of 2 pictures are there" in capsys.readouterr().err
    assert json.loads((tmp_path / "01.json").read_text())["focus_distance"] == 3
    (tmp_path / "stack.json").unlink()
    assert stack(tmp_path, kept, "--distances", "1.5", "3") == 0
    assert (tmp_path / "stack.json").is_file()


def test_shards_make_what_one_run_makes(tmp_path, kept):
    assert stack(tmp_path / "whole", kept, *FOCI, "--circle-map") == 0
    for shard in ("2/2", "1/2"):
        assert stack(tmp_path / "parts", kept, *FOCI, "--circle-map", "--shard", shard) == 0
    whole, parts = (
        {path.name: path.read_bytes() for path in (tmp_path / name).glob("*.json")}
        for name in ("whole", "parts")
    )
    assert whole == parts
    assert len(whole) == 4
    assert sorted(pictures_in(tmp_path / "parts")) == sorted(pictures_in(tmp_path / "whole"))


def test_a_table_says_each_lens(tmp_path, kept):
    table = tmp_path / "lenses.csv"
    table.write_text("focus_distance,f_number,aperture\n1.5,4,polygon:blades=6\ninf,,\n", "utf-8")
    assert stack(tmp_path, kept, "--lenses", str(table)) == 0
    first, last = json.loads((tmp_path / "stack.json").read_text())["pictures"]
    assert first["lens"]["aperture"].startswith("polygon:blades=6")
    assert (last["focus_distance"], last["f_number"]) == ("inf", 2.0)


def test_a_picture_of_another_program_has_a_stack_too(tmp_path):
    picture = Path(__file__).parent.parent / "data" / "blender.exr"
    options = ["--frame-width", "36", "--near", "2.2", "--far", "14", "--count", "2"]
    assert stack(tmp_path, str(picture), *options, "--f-numbers", "8", "0.5") == 0
    lens = {"f_number": 0.5, "focus_distance": 14.0, "frame_width": 36.0}
    expected = np.array(pm.focus(pm.PointSamples.from_image(picture, lens=lens)))
    np.testing.assert_allclose(pictures_in(tmp_path)["03.exr"], expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ([], "distances: must be given"),
        (["--near", "1", "--count", "3"], "--far: must be given with near, count"),
        (["--distances", "0.01"], "distances[0]: focus_distance=0.01"),
        (["--distances", "2", "--spp", "4"], "spp=4: is for a scene, and"),
        (["--distances", "2", "--shard", "4/3"], "shard='4/3'"),
        (["--distances", "2", "--layout", "fod500"], "must end in a number of six digits"),
        (["--distances", "2", "--normals"], "normal: the samples have none"),
        (["--lenses", "absent.csv"], "absent.csv: there is no such file"),
    ],
)
def test_what_does_not_fit_is_named_before_the_first_picture(tmp_path, kept, capsys, more, message):
    assert stack(tmp_path, kept, *more) == 1
    assert message in capsys.readouterr().err
    assert not list(tmp_path.glob("*.exr"))


def test_ends_with_units_need_no_other_word_where_samples_know_theirs(tmp_path, kept):
    """The samples are of a scene in metres."""
    ends = ["--near", "150cm", "--far", "4000mm", "--count", "2"]
    assert stack(tmp_path / "a", kept, *ends) == 0
    assert stack(tmp_path / "b", kept, "--distances", "150cm", "4", "--units", "m") == 0
    (tmp_path / "lenses.csv").write_text("focus_distance,f_number\n1.5m,f/2.8\n4,2.8\n")
    assert stack(tmp_path / "c", kept, "--lenses", str(tmp_path / "lenses.csv")) == 0
    for name in "abc":
        told = json.loads((tmp_path / name / "stack.json").read_text())
        distances = [picture["focus_distance"] for picture in told["pictures"]]
        assert distances == pytest.approx([1.5, 4.0])


@pytest.mark.filterwarnings("always::potmesil_mi._warnings.FocusWarning")
def test_a_stack_that_is_focused_on_nothing_is_told(tmp_path, kept, capsys):
    assert stack(tmp_path / "a", kept, "--distances", "100", "900") == 0
    said = capsys.readouterr().err
    assert "no picture is focused on anything, the first at focus_distance=100: nothing" in said
    assert stack(tmp_path / "b", kept, "--distances", "2.5", "900") == 0
    assert "nothing is there" not in capsys.readouterr().err


def test_what_another_program_calls_stack_json_stays(tmp_path, kept, capsys):
    (tmp_path / "stack.json").write_text('{"layers": 3}')
    assert stack(tmp_path, kept, *FOCI) == 1
    assert "stack.json: is not of a stack, and must not be lost" in capsys.readouterr().err
    assert (tmp_path / "stack.json").read_text() == '{"layers": 3}'


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--near", "4", "--far", "1.5", "--count", "3"], "--far=1.5: must be > near=4"),
        (["--near", "4m", "--far", "1.5", "--count", "3"], "--far=1.5: must be > near=4"),
        (["--distances", "2", "-o", "{folder}/./{{:02d}}.exr"], "must be given once"),
        ([], "--distances: must be given"),
        (["--distances", "2", "nan"], "--distances[1]=nan: must be finite"),
        (["--distances", "2", "--f-numbers", "f/0"], "--f-numbers[0]=0.0: must be > 0"),
    ],
)
def test_what_is_the_wrong_way_round_or_missing_is_told_by_its_option(
    tmp_path, kept, capsys, more, message
):
    more = [text.format(folder=tmp_path) for text in more]
    assert stack(tmp_path, kept, *more) == 1
    assert message in capsys.readouterr().err
    assert not list(tmp_path.glob("*.exr"))
