import typing

import numpy as np
import pytest

import potmesil_mi as pm
from potmesil_mi.tracing.sampling import PATTERNS, Pattern


def test_every_pattern_that_types_allow_is_taken():
    assert typing.get_args(Pattern) == PATTERNS
    assert [pm.Sampling(pattern).pattern for pattern in PATTERNS] == list(PATTERNS)


@pytest.mark.parametrize(
    ("sampling", "text"),
    [
        ({"pattern": "hexagonal"}, "pattern='hexagonal'.*sampler, uniform, adaptive"),
        ({"threshold": -0.1}, "threshold=-0.1"),
        ({"threshold": "low"}, "threshold='low'"),
        ({"threshold": np.nan}, "threshold=nan"),
        ({"subdivisions": 9}, "subdivisions=9"),
        ({"subdivisions": 1.5}, r"subdivisions=1\.5"),
        ({"layers": 0}, "layers=0.*1 to 16"),
        ({"layers": 17}, "layers=17"),
        ({"layers": 1.5}, r"layers=1\.5"),
        ({"overscan": -1}, "overscan=-1"),
        ({"overscan": 2.5}, r"overscan=2\.5"),
        ({"min_f_number": 0}, "min_f_number=0"),
        ({"min_f_number": np.nan}, "min_f_number=nan"),
        ({"min_f_number": "wide"}, "min_f_number='wide'"),
        ({"virtual_depth": 1}, "virtual_depth=1"),
        ({"features": 1}, "features=1"),
    ],
)
def test_a_bad_pattern_is_named(sampling, text):
    with pytest.raises((ValueError, TypeError), match=text):
        pm.Sampling(**sampling)
