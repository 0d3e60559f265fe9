import numpy as np
import pytest

from potmesil_mi.evaluation.search import Search
from potmesil_mi.evaluation.timing import Measured


class Points:
    """A sampler whose error is 1/spp^1.5 and which takes 0.1 s and 0.01 s a sample."""

    def __init__(self, counts):
        self.counts = counts

    def rounded_up(self, spp):
        return next((n for n in self.counts if n >= spp), self.counts[-1] * 2)

    def search(self, error, start, most=1000):
        def measure(spp):
            return Measured(np.full((1, 1, 3), spp**-0.75), spp, 0.0, 0.1 + 0.01 * spp)

        return Search(measure, self.rounded_up, np.zeros((1, 1, 3))).run(error, start, most)


@pytest.mark.parametrize("start", [4, 25, 150, 600])
@pytest.mark.parametrize("counts", [range(1, 1001), [n * n for n in (2, 3, 5, 7, 11, 13, 17, 31)]])
def test_the_search_finds_the_samples_of_an_error(start, counts):
    search = Points(list(counts)).search(60**-1.5, start)
    assert search.needed.bound == ""
    assert search.needed.spp == pytest.approx(60, rel=1e-3)
    assert search.needed.seconds == pytest.approx(0.7, rel=0.02)
    assert search.reached.spp in ((60, 61) if 60 in counts else (49,))


def test_the_search_keeps_to_its_bounds():
    counts = list(range(4, 1001))
    more = Points(counts).search(1e-9, 4, most=100)
    assert (more.needed.spp, more.needed.bound, more.reached) == (64, ">", None)
    fewer = Points(counts).search(0.9, 64)
    assert (fewer.needed.spp, fewer.needed.bound, fewer.reached.spp) == (4, "<=", 4)
    assert fewer.rank < more.rank
