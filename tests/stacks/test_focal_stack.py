"""Focal stacks: the pictures that focus gives, one after the other."""

import numpy as np
import pytest

import potmesil_mi as pm
from scenes import evenly_spread

pytestmark = pytest.mark.usefixtures("variant_llvm")

DISTANCES = [1.5, 2.5, 4.0]


@pytest.fixture(scope="module")
def samples():
    return evenly_spread((32, 24), 2)


def test_pictures_are_those_of_focus_and_are_formed_when_they_are_asked_for(samples, monkeypatch):
    formed = []
    form = pm.FocusSession.focus

    def counted(session, lens, **options):
        formed.append(lens.focus_distance)
        return form(session, lens, **options)

    monkeypatch.setattr(pm.FocusSession, "focus", counted)
    stack = pm.focal_stack(samples, DISTANCES)
    assert len(stack) == 3
    assert formed == []
    pictures = iter(stack)
    first = np.array(next(pictures))
    assert formed == [1.5]
    others = [np.array(one) for one in pictures]
    assert formed == DISTANCES
    for picture, distance in zip([first, *others], DISTANCES, strict=True):
        expected = np.array(pm.focus(samples, samples.lens.replace(focus_distance=distance)))
        np.testing.assert_allclose(picture, expected, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(np.array(stack[-1]), others[-1], rtol=1e-5, atol=1e-6)


def test_a_session_has_its_method_and_what_it_found_out_serves_all(samples):
    session = pm.FocusSession(samples, pm.Equation20(tables=5))
    stack = pm.focal_stack(session, near=1.0, far=4.0, count=2, f_numbers=[2.0, 4.0], alpha=True)
    assert [lens.f_number for lens in stack.lenses] == [2, 2, 4, 4]
    assert np.array(stack[0]).shape == (24, 32, 4)
    assert stack.session is session
    with pytest.raises(ValueError, match="method='paper': must be None for a session"):
        pm.focal_stack(session, DISTANCES, method="paper")


def test_progress_counts_the_pictures(samples):
    told = []
    with pm.progress(lambda text, share: told.append((text, share))):
        for _ in pm.focal_stack(samples, DISTANCES, method="paper"):
            pass
    assert told[0] == ("Picture 0", 0)
    assert told[-1] == ("Picture 2", 1)
    shares = [share for _, share in told]
    assert shares == sorted(shares)


def test_a_lens_of_the_other_kind_is_refused_before_the_first_picture(samples):
    with pytest.raises(ValueError, match=r"lenses\[1\]: lens=TelecentricLens: must be a ThinLens"):
        pm.focal_stack(samples, lenses=[samples.lens, pm.TelecentricLens(1.0, 2.0)])
