"""The widget of notebooks: its traits, and what it sends, without a notebook."""

import sys

import pytest

import potmesil_mi as pm
from potmesil_mi.viewer.extra import STATIC
from scenes import evenly_spread, still_life

pytest.importorskip("anywidget")
pytestmark = pytest.mark.usefixtures("variant_llvm")

SAMPLES = {"lens": pm.ThinLens(50.0, 0.25, 2.0, millimeters_per_unit=1000.0)}


@pytest.fixture
def widget():
    made = pm.interactive(evenly_spread((24, 16), 2, **SAMPLES))
    sent = []
    made.send = lambda message, buffers=None: sent.append((message, buffers))
    made.sent = sent
    yield made
    made.close()


def ask(widget, **changes):
    """As a comm does that has a message of a page."""
    content = {**widget.about["start"], "id": "1", **changes}
    widget._handle_msg(
        {"content": {"data": {"method": "custom", "content": content}}, "buffers": []}
    )
    return widget.sent[-1]


def test_a_page_is_told_what_there_is_and_gets_its_front_end(widget):
    state = widget.get_state()
    assert (state["about"]["width"], state["about"]["height"]) == (24, 16)
    assert state["_esm"] == (STATIC / "viewer.js").read_text(encoding="utf-8")
    assert state["_css"] == (STATIC / "viewer.css").read_text(encoding="utf-8")


def test_a_question_is_answered_by_a_message_and_a_picture(widget):
    message, (picture,) = ask(widget, at=[10, 10])
    assert message["kind"] == "picture"
    assert message["id"] == "1"
    assert picture.startswith(b"\xff\xd8")  # a JPEG
    assert widget.lens.focus_distance == message["focus_distance"]


def test_an_error_is_a_message_and_the_lens_stays(widget):
    before = widget.lens
    message, buffers = ask(widget, opening=-1)
    assert message["kind"] == "error"
    assert message["text"].startswith("opening=-1: must be")
    assert buffers is None
    assert widget.lens == before


def test_a_scene_is_sampled_first():
    widget = pm.interactive(still_life(), spp=2)
    assert "difference" in widget.about["overlays"]
    widget.close()


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"source": 5}, "source=5: must be PointSamples, or a scene"),
        ({"spp": 4}, "spp=4: must be left out, for it is of a scene"),
        ({"sampling": pm.Sampling()}, "sampling=.*must be left out"),
        ({"lens": pm.TelecentricLens(5.0, 2.0)}, "lens=TelecentricLens: must be a ThinLens"),
        ({"method": "sharp"}, "sharp"),
    ],
)
def test_what_cannot_be_shown_is_refused_by_name(parameters, text):
    samples = evenly_spread((24, 16), 2, **SAMPLES)
    with pytest.raises((ValueError, TypeError), match=text):
        pm.interactive(**{"source": samples, **parameters})


def test_without_the_extra_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "anywidget", None)
    with pytest.raises(ImportError, match=r"pip install 'potmesil_mi\[interactive\]'"):
        pm.interactive(evenly_spread((4, 4), 2))
