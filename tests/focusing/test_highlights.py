"""Highlights, whose light shows the shape of the lens, and what is left without them."""

import numpy as np
import pytest

from potmesil_mi.focusing.fragments import SHARE
from potmesil_mi.focusing.gathering import gather
from potmesil_mi.focusing.highlights import is_highlight, parted
from scenes import evenly_spread

pytestmark = pytest.mark.usefixtures("variant_llvm")


def test_a_highlight_is_what_exceeds_its_surroundings_and_no_light_is_lost():
    samples = evenly_spread((40, 30), z=np.full(19200, 2.0))
    rgb = np.full_like(samples.rgb, 0.5)
    lamp = (abs(samples.x - 20.5) < 1.2) & (abs(samples.y - 14.5) < 0.4)
    rgb[lamp] = (300, 200, 0.1)
    fragments = gather(samples.replace(rgb=rgb), 1, 3.0, degree=2)
    bright = is_highlight(fragments)
    assert 0 < bright.sum() < 9
    rest, highlights = parted(fragments, bright)
    assert len(highlights) == bright.sum()
    together = rest.values.copy()
    together[bright] += highlights.values
    np.testing.assert_allclose(together, fragments.values, rtol=1e-6, atol=1e-6)
    assert (highlights.values >= 0).all()
    assert not highlights.values[:, SHARE].any()
    # What is left is no brighter than what is beside it, also where a colour is darker.
    assert rest.values[:, :SHARE].max() < 0.5 + 1e-5
    own = rest.moments[bright]
    colours = rest.values[bright, None, :SHARE] * own[..., SHARE, None]
    np.testing.assert_allclose(own[..., :SHARE], colours, atol=1e-5)
