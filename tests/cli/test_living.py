"""``potmesil living``: pages of scenes, of samples and of pictures, and one page of several."""

import json
import re

import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi import cli
from potmesil_mi.living.page import read_pictures
from potmesil_mi.tracing import hidden_surface
from scenes import SCENES, behind_a_bar

pytestmark = pytest.mark.usefixtures("variant_llvm")


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    path = tmp_path_factory.mktemp("living") / "bar.samples"
    behind_a_bar().save(path)
    return str(path)


def living(folder, *arguments):
    return cli.main(["living", *arguments, "-o", str(folder / "page.html")])


def test_a_page_of_samples_is_that_of_python_and_says_how_well_it_shows_them(
    tmp_path, kept, capsys
):
    given = ["--f-numbers", "2.8", "f/1.4", "--near", "1m", "--far", "400cm", "--title", "A bar"]
    assert living(tmp_path, kept, *given, "--psnr", "36", "--max-bytes", "1M") == 0
    made = pm.living_picture(
        *(pm.PointSamples.load(kept), tmp_path / "python.html"),
        f_numbers=[1.4, 2.8],
        near=1.0,
        far=4.0,
        psnr=36.0,
        title="A bar",
    )
    assert (tmp_path / "page.html").read_bytes() == (tmp_path / "python.html").read_bytes()
    said = capsys.readouterr().err
    assert f"at f/1.4, f/2.8; {made.worst:.1f} dB at the worst of {made.measured} pairs" in said


def test_a_scene_is_sampled_for_the_widest_aperture(tmp_path, monkeypatch):
    asked = []
    render = hidden_surface.render_samples

    def noticed(*arguments, **options):
        asked.append(options["sampling"])
        return render(*arguments, **options)

    monkeypatch.setattr(hidden_surface, "render_samples", noticed)
    small = ["-D", "res=16", "-D", "spp=4", "--psnr", "25", "--f-numbers", "5.6", "2.8"]
    small += ["--f-number", "5.6"]
    assert living(tmp_path, str(SCENES / "figure11.xml"), *small) == 0
    assert asked[0].min_f_number == pytest.approx(2.8)
    assert asked[0].focus_range is None
    (found,) = read_pictures(tmp_path / "page.html")
    assert [level.f_number for level in found.levels] == [2.8, 5.6]
    assert found.size == (16, 16)
    assert found.focus_range.distance_at(found.opened[0]) == pytest.approx(550, rel=0.01)
    assert found.opened[1] == 1


def test_several_pages_become_one(tmp_path, kept, capsys):
    quick = ["--f-numbers", "4", "--psnr", "25"]
    assert living(tmp_path, kept, *quick) == 0
    one = str(tmp_path / "page.html")
    both = tmp_path / "both.html"
    capsys.readouterr()
    assert cli.main(["living", one, one, "-o", str(both), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["written"], told["made"]) == ([str(both)], "2 pictures")
    first, second = read_pictures(both)
    assert first.levels == second.levels
    np.testing.assert_array_equal(first.depth, second.depth)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--psnr", "90"], "--psnr=90.0: must be 20 to 60"),
        (["--max-bytes", "much"], "--max-bytes=much: must be a size"),
        (["--near", "5", "--far", "2"], "far=2: must be > near=5"),
        (["--spp", "4"], "spp=4: is for a scene, and"),
        (["other.html"], "other.html: must be left out, for"),
        (["--f-numbers", "0"], "f-numbers[0]=0.0: must be > 0"),
    ],
)
def test_what_does_not_fit_is_named(tmp_path, kept, capsys, more, message):
    assert living(tmp_path, kept, *more) == 1
    assert message in re.sub(r"--spp", "spp", capsys.readouterr().err)
    assert not list(tmp_path.iterdir())


def test_a_page_has_another_ending_than_a_picture(tmp_path, kept, capsys):
    assert cli.main(["living", kept, "-o", str(tmp_path / "page.png")]) == 1
    assert "must end in one of .html, .htm" in capsys.readouterr().err
