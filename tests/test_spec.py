"""Families of specs: members of one's own, their texts, and what is said about wrong ones."""

import dataclasses
from typing import ClassVar

import numpy as np
import pytest

from potmesil_mi import Aperture, Diffraction, Disc, Fade, Filter, Polygon, Star
from potmesil_mi._spec import Spec, read, written


class Family(Spec, family="family"):
    pass


@dataclasses.dataclass(frozen=True)
class Member(Family):
    size: float
    count: int = 3
    open: bool = True
    sides: tuple[float, ...] = (1.0, 2.0)
    word: str = "a b"
    nothing: object = None
    hidden: object = dataclasses.field(default=None, metadata={"spec": False})

    name: ClassVar[str] = "member"


VALUES = [
    Member(0.1),
    Member(1e-300, -4, False, (3.0,), "x=y"),
    Member(np.float64(2.5), np.int64(7), sides=(np.float64(0.1), 1)),
]


@pytest.mark.parametrize("value", VALUES, ids=repr)
def test_texts_make_equal_members(value):
    described = Family.parse(value.describe())
    if len(value.sides) == 1:  # One of several values reads as a number.
        described = dataclasses.replace(described, sides=(described.sides,))
    assert described == value
    short = Family.parse(str(value))
    assert dataclasses.replace(short, sides=value.sides) == value


def test_a_description_has_all_parameters_and_a_short_text_those_that_differ():
    assert Member(2.0).describe() == "member:size=2.0,count=3,open=true,sides=1.0/2.0,word=a b"
    assert str(Member(2.0, 4)) == "member:size=2.0,count=4"


@pytest.mark.parametrize(
    ("value", "parameter"),
    [
        (Member(1.0, word="a,b=1"), "word='a,b=1'"),
        (Member(1.0, word="a,b"), "[a-z]+="),
        (Member(1.0, word="7"), "word='7'"),
        (Member(1.0, word=" x"), "word=' x'"),
        (Member(1.0, nothing=[1]), r"nothing=\[1\]"),
        (Member(1.0, hidden=3), "hidden=3"),
    ],
)
def test_what_a_text_cannot_tell_is_refused_and_not_lost(value, parameter):
    with pytest.raises(ValueError, match=f"^{parameter}.*: cannot be told in a text"):
        value.describe()
    assert str(value) == repr(value)


def test_the_families_are_what_derives_from_spec_itself():
    assert list(Aperture.members()) == ["disc", "polygon", "lommel", "image"]
    assert list(Filter.members()) == ["star", "diffraction", "defocus", "fade"]
    assert Family.members() == {"member": Member}


def test_a_member_is_itself():
    star = Star(5)
    assert Filter.parse(star) is star
    with pytest.raises(TypeError, match=r"^aperture=Star.*must be one of Disc\(\), Polygon\(\)"):
        Aperture.parse(star)


@pytest.mark.parametrize(
    ("family", "text", "message"),
    [
        (Aperture, "ring9", "^aperture='ring9': must be one of disc, polygon, lommel, image; a"),
        (Aperture, "polygon:sides=4", "^sides: not a parameter of the aperture polygon, which has"),
        (Aperture, "disc:radius=2", "^radius: not a parameter of the aperture disc, .* none$"),
        (Family, "member", "^family='member': needs size, as in member:size="),
        (Filter, "fade:amount", "^filter='fade:amount': must be a name, or name:parameter=value"),
    ],
)
def test_texts_that_are_wrong_are_named(family, text, message):
    with pytest.raises(ValueError, match=message):
        family.parse(text)


def test_a_name_in_a_file_asks_for_the_class_before_it_is_loaded():
    with pytest.raises(ValueError, match=r"must be defined, or its module imported, before the f"):
        Aperture.parse("ring9:inner=0.5", from_file=True)


def test_a_class_can_be_defined_anew_but_no_name_be_taken():
    def define(place):
        class Again(Family):
            name: ClassVar[str] = "again"
            __qualname__ = place

        return Again

    define("Again")
    newer = define("Again")
    try:
        assert Family.members()["again"] is newer
        with pytest.raises(ValueError, match=r"^name='again': is that of the family .*Again"):
            define("Other")
    finally:
        del Family._registered["again"]
    with pytest.raises(ValueError, match=r"^name='disc': is that of the aperture .*Disc already"):
        type("Mine", (Disc,), {"name": "disc"})


def test_in_a_notebook_a_class_can_be_renamed_and_keep_its_name():
    def define(place, module):
        return type(place, (Family,), {"name": "again", "__module__": module})

    define("First", "__main__")
    newer = define("Second", "__main__")
    try:
        assert Family.members()["again"] is newer
        with pytest.raises(ValueError, match=r"^name='again': is that of the family __main__.Se"):
            define("Third", "elsewhere")
    finally:
        del Family._registered["again"]
    with pytest.raises(ValueError, match=r"^name='disc': is that of the aperture"):
        type("Mine", (Disc,), {"name": "disc", "__module__": "__main__"})


def test_a_class_makes_only_what_is_of_that_class():
    assert Polygon.parse("polygon:blades=5") == Polygon(5)
    with pytest.raises(ValueError, match=r"^aperture='disc': must be one of polygon;"):
        Polygon.parse("disc")


@pytest.mark.parametrize("name", ["", "two words", "a:b", 3])
def test_a_name_that_no_text_can_begin_with_is_refused(name):
    with pytest.raises(ValueError, match=r"^name=.*must be a word"):
        type("Mine", (Family,), {"name": name})


def test_what_is_no_frozen_dataclass_or_has_no_name_has_no_text():
    class Nameless(Polygon):
        pass

    with pytest.raises(TypeError, match="Nameless: has no name"):
        Nameless().describe()
    type("Plain", (Family,), {"name": "plain"})
    try:
        with pytest.raises(TypeError, match=r"^Plain: must be a frozen dataclass"):
            Family.parse("plain")
    finally:
        del Family._registered["plain"]


def test_fields_that_no_text_tells_are_no_parameters():
    with pytest.raises(ValueError, match=r"^aperture: not a parameter of the filter diffraction"):
        Filter.parse("diffraction:aperture=disc")
    assert Filter.parse(Diffraction(scale=3.0).describe()) == Diffraction(scale=3.0)
    with pytest.raises(ValueError, match=r"^aperture=Polygon.*cannot be told"):
        Diffraction(aperture=Polygon(5)).describe()


@pytest.mark.parametrize("text", ["a:b=1", "a:b=1,c=0.5/2,d=true,e=x"])
def test_reading_and_writing_are_inverse(text):
    assert written(*read(text, "spec")).replace("0.5/2.0", "0.5/2") == text


def test_filters_describe_themselves():
    fade = Fade(0.5, (1, 0.9, 0.8))
    assert str(fade) == "fade:amount=0.5,color=1.0/0.9/0.8"
    assert Filter.parse(fade.describe()) == fade
