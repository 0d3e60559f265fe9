"""Living pictures: what is kept of a sweep shows what ``pm.focus`` forms, in few enough bytes."""

import io
import json
import re
import signal
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import potmesil_mi as pm
from potmesil_mi._image import in_srgb
from potmesil_mi.living.jpeg import encoded, smallest, squared_error
from potmesil_mi.living.lenses import apertures_of, focus_range, growth
from potmesil_mi.living.page import DATA, page_of, read_pictures
from potmesil_mi.living.sweep import FocusRange, Sweep, blend
from scenes import behind_a_bar, synthetic

F_NUMBERS = [0.7, 1.4]
DOCS = Path(__file__).parents[2] / "docs" / "extra"


@pytest.fixture(scope="module")
def samples():
    return behind_a_bar()


@pytest.fixture(scope="module")
def written(samples, tmp_path_factory):
    path = tmp_path_factory.mktemp("living") / "bar.html"
    title = "</script><b>Bar & lamps</b>"
    return path, pm.living_picture(samples, path, f_numbers=F_NUMBERS, title=title)


def focused(samples, f_number, distance):
    lens = samples.lens.replace(f_number=f_number, focus_distance=distance)
    return in_srgb(np.array(pm.focus(samples, lens)), "8")


def decoded(data):
    return np.array(Image.open(io.BytesIO(data)).convert("RGB"))


def shown(picture, level, place):
    """What the page shows, by decoders that the package does not use."""
    level = picture.levels[level]
    after = max(np.searchsorted(level.places, place), 1)
    first, last = level.places[after - 1], level.places[after]
    before, behind = (decoded(level.pictures[i]).astype(float) for i in (after - 1, after))
    share = (place - first) / (last - first)
    return np.floor((1 - share) * before + share * behind + 0.5)


def decibels(found, expected):
    return -10 * np.log10(np.mean(((found - expected.astype(float)) / 255) ** 2))


def test_what_is_shown_is_what_focus_forms_also_where_near_edges_cover_lamps(samples, written):
    _, picture = written
    assert picture.worst >= 40
    assert picture.median >= picture.worst
    lamps = np.s_[4:40, 16:72]
    for level, f_number in enumerate(F_NUMBERS):
        for place in np.random.default_rng(3).uniform(0, 1, 6):
            expected = focused(samples, f_number, picture.focus_range.distance_at(place))
            found = shown(picture, level, place)
            assert decibels(found, expected) >= 39
            assert decibels(found[lamps], expected[lamps]) >= 36


def test_few_pictures_are_kept_and_fewer_of_small_apertures(written):
    _, picture = written
    wide, narrow = (len(level.places) for level in picture.levels)
    assert 2 <= narrow < wide < 30
    assert picture.measured > wide + narrow


def test_the_page_opens_as_the_lens_is_and_knows_how_deep_things_are(samples, written):
    _, picture = written
    place, level = picture.opened
    assert level == 0
    assert picture.focus_range == (pytest.approx(0.8), pytest.approx(8.0))
    assert picture.focus_range.distance_at(place) == pytest.approx(2.0)
    assert decibels(decoded(picture.poster), focused(samples, 0.7, 2.0)) > 33
    distances = [picture.focus_range.distance_at(picture.depth[at] / 255) for at in
                 [(20, 28), (50, 58), (10, 80)]]  # fmt: skip
    assert distances == pytest.approx([0.8, 2.0, 8.0], rel=0.02)


def test_a_page_is_one_file_that_asks_nobody_for_anything(written):
    path, _ = written
    page = path.read_text(encoding="utf-8")
    assert not re.search(r"https?:|src=[\"'](?!data:)|href=[\"'](?!data:)|@import|url\(", page)
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page)[1]
    assert policy.startswith("default-src &#x27;none&#x27;; img-src data: blob:")
    assert "unsafe" not in policy
    assert "&lt;/script&gt;&lt;b&gt;Bar &amp; lamps" in page
    assert "<b>" not in page
    assert f"potmesil_mi {pm.__version__}" in page


def test_a_page_made_twice_is_the_same(samples, written, tmp_path):
    path, picture = written
    pm.living_picture(samples, tmp_path / "again.html", f_numbers=F_NUMBERS, title=picture.title)
    assert (tmp_path / "again.html").read_bytes() == path.read_bytes()


def test_pages_become_one_with_all_their_pictures(samples, written, tmp_path):
    path, picture = written
    other = tmp_path / "other.html"
    pm.living_picture(samples, other, f_numbers=[1.4], far=np.inf, title="Other")
    both = pm.living_page([path, other], tmp_path / "both.html", title="Two <pictures>")
    assert [one.title for one in both] == [picture.title, "Other"]
    page = (tmp_path / "both.html").read_text(encoding="utf-8")
    assert "<h1>Two &lt;pictures&gt;</h1>" in page
    found = read_pictures(tmp_path / "both.html")
    assert found[0].levels == picture.levels
    np.testing.assert_array_equal(found[0].depth, picture.depth)
    assert found[1].focus_range.far == np.inf
    assert page_of(found, "Two <pictures>") == page


def test_a_page_keeps_its_size_and_a_warning_says_what_that_costs(samples, tmp_path):
    path = tmp_path / "small.html"
    with pytest.warns(UserWarning, match=r"psnr=50: only .* dB .* max_bytes=60000"):
        made = pm.living_picture(samples, path, f_numbers=[1.4], psnr=50, max_bytes=60_000)
    assert 45_000 < path.stat().st_size <= 60_000
    assert 20 < made.worst < 50
    with pytest.raises(ValueError, match="max_bytes=20000: must be larger"):
        pm.living_picture(samples, path, f_numbers=[1.4], max_bytes=20_000)


def test_the_aim_is_kept_in_as_few_bytes_as_it_takes(samples, tmp_path):
    sizes = []
    for psnr in (34.0, 44.0):
        path = tmp_path / f"{psnr}.html"
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            made = pm.living_picture(samples, path, f_numbers=[1.4], psnr=psnr)
        assert psnr <= made.worst < psnr + 1.5
        sizes.append(path.stat().st_size)
    assert sizes[0] < 0.8 * sizes[1]


def test_apertures_are_the_lens_s_own_and_stops_until_all_is_sharp(samples):
    whole = focus_range(samples, samples.lens, None, None)
    found = apertures_of(samples, samples.lens, whole, None)
    assert found == [0.7, 1, 1.4, 2, 2.8, 4]
    assert growth(samples.lens.replace(f_number=4), samples.camera, whole) < 2
    wide = samples.lens.replace(f_number=0.1)
    assert apertures_of(samples, wide, whole, None) == [0.1, 1, 1.4, 2, 2.8, 4]
    assert apertures_of(samples, wide, whole, [4, 0.5, 4]) == [0.5, 4]


def test_the_focus_goes_from_what_is_nearest_to_what_is_farthest(samples):
    assert focus_range(samples, samples.lens, 1.0, None) == (1.0, pytest.approx(8.0))
    assert focus_range(samples, samples.lens, None, np.inf) == (pytest.approx(0.8), np.inf)
    long = samples.lens.replace(focal_length=500.0)
    assert focus_range(samples, long, None, None).near == 1.0
    wall = synthetic(40, size=(6, 4), z=np.full(40, 2.0))
    assert focus_range(wall, wall.lens, None, None) == pytest.approx((1.6, 2.5))


def test_nothing_is_left_of_a_page_that_was_interrupted(samples, tmp_path):
    def interrupt(text, share):
        if share and share > 0.5:
            signal.raise_signal(signal.SIGINT)

    (tmp_path / "page.html").write_text("old", encoding="utf-8")
    with pm.progress(interrupt), pytest.raises(KeyboardInterrupt):
        pm.living_picture(samples, tmp_path / "page.html", f_numbers=[2.0])
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]
    assert (tmp_path / "page.html").read_text(encoding="utf-8") == "old"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"form": 2}, "form=2: must be 1"),
        ({"size": [96, 10**9]}, "size=1000000000: must be 1 to 16384"),
        ({"size": [96, 63]}, "depth=.*: must be 6048 bytes"),
        ({"vergences": [1, 2]}, "vergences=.*: must be of a nearer and a farther"),
        ({"levels": []}, "levels=.*: must be a list of one at least"),
        ({"levels": [{"f_number": 2, "places": [0, 1], "pictures": ["", ""]}]}, "must be a JPEG"),
        ({"levels": [{"f_number": 2, "places": [0, 0], "pictures": [""]}]}, "must ascend from 0"),
        ({"opened": [0.5, 9]}, "opened=9: must be 0 to 1"),
        ({"poster": '"><script>'}, "poster=.*: must be bytes in base64"),
        ({"title": 3}, "title=3: must be text"),
    ],
)
def test_what_is_wrong_in_a_page_is_named(written, tmp_path, change, message):
    page = written[0].read_text(encoding="utf-8")
    values = json.loads(re.search(re.escape(DATA) + "(.*?)</script>", page, re.DOTALL)[1])
    path = tmp_path / "changed.html"
    text = json.dumps({**values, **change}).replace("<", "\\u003c")
    path.write_text(f"{DATA}{text}</script>", encoding="utf-8")
    with pytest.raises((ValueError, TypeError), match=rf"changed\.html: .*{message}"):
        pm.living_page([path], tmp_path / "new.html")
    assert not (tmp_path / "new.html").exists()


def test_a_page_without_pictures_is_refused(tmp_path):
    (tmp_path / "a.html").write_text("<p>nothing</p>", encoding="utf-8")
    with pytest.raises(ValueError, match=r"a\.html: must be a page with living pictures"):
        pm.living_page([tmp_path / "a.html"], tmp_path / "new.html")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"near": 3.0, "far": 2.0}, "far=2: must be > near=3"),
        ({"near": 0.02}, "focus_distance=0.02"),
        ({"f_numbers": []}, "f_numbers=.*: must be one at least"),
        ({"f_numbers": [2.0, 0.0]}, r"f_numbers\[1\]=0.0: must be > 0"),
        ({"psnr": 80.0}, "psnr=80.0: must be 20 to 60"),
    ],
)
def test_what_does_not_fit_is_named(samples, tmp_path, given, message):
    with pytest.raises(ValueError, match=message):
        pm.living_picture(samples, tmp_path / "page.html", **given)


def test_samples_of_another_camera_and_the_sky_alone_are_refused(tmp_path):
    sky = synthetic(40, size=(6, 4), z=np.full(40, np.inf))
    with pytest.raises(ValueError, match="near: must be given, for nothing is in sight"):
        pm.living_picture(sky, tmp_path / "page.html")


# ---------------------------------------------------------------- its parts


def test_places_are_equal_steps_of_vergence():
    focus_range = FocusRange(0.5, np.inf)
    assert focus_range.distance_at(0) == 0.5
    assert focus_range.distance_at(1) == np.inf
    assert focus_range.distance_at(0.75) == pytest.approx(2.0)
    np.testing.assert_allclose(
        focus_range.place_of(np.array([0.2, 0.5, 2, np.inf])), [0, 0, 0.75, 1]
    )
    assert len(focus_range.places(14.0)) == 11


def test_a_sweep_keeps_what_blends_do_not_show():
    """Grey that changes evenly is two pictures; one that jumps is a picture more on each side."""
    file = io.BytesIO()
    even, jumps = Sweep(1.0, (2, 3), file), Sweep(1.0, (2, 3), file)
    for i in range(9):
        even.add(i / 8, np.full((2, 3, 3), 10 + 20 * i, np.uint8))
        jumps.add(i / 8, np.full((2, 3, 3), 200 if i >= 4 else 10, np.uint8))
    assert even.chosen(1e-6) == [0, 8]
    assert jumps.chosen(1e-6) == [0, 3, 4, 8]
    assert jumps.gaps(1e-6) == [7 / 16]
    jumps.add(7 / 16, np.full((2, 3, 3), 105, np.uint8))
    assert jumps.gaps(1e-6) == []


def test_blends_round_once():
    before, after = np.array([[[0, 10, 255]]], np.uint8), np.array([[[255, 11, 254]]], np.uint8)
    np.testing.assert_array_equal(blend(before, after, 0.5), [[[128, 11, 255]]])
    np.testing.assert_array_equal(blend(before, after, 0.0), before)


def test_the_least_quality_that_suffices_is_taken():
    picture = np.random.default_rng(1).integers(0, 256, (16, 16, 3), np.uint8)
    rough, fine = smallest(picture, 1e-2), smallest(picture, 1e-3)
    assert squared_error(rough.shown, picture) <= 1e-2
    assert squared_error(fine.shown, picture) <= 1e-3
    assert len(rough.data) < len(fine.data) < len(encoded(picture, 98).data) + 1
    np.testing.assert_array_equal(decoded(fine.data), fine.shown)


@pytest.mark.parametrize("path", sorted(DOCS.rglob("*.html")), ids=lambda path: path.name)
def test_a_page_in_the_docs_has_the_script_and_the_style_of_now(path):
    """`potmesil living PAGE -o PAGE` puts its pictures into a page of today."""
    assert page_of(read_pictures(path)) == path.read_text(encoding="utf-8")
