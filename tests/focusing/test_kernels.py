"""What kernels are fitted by."""

import numpy as np
import pytest
import scipy.optimize

from potmesil_mi.focusing.kernels import _non_negative_least_squares


@pytest.mark.parametrize("columns", [1, 2, 3])
def test_least_squares_without_negative_coefficients_are_those_of_scipy(columns):
    rng = np.random.default_rng(columns)
    zeros = 0
    for _ in range(50):
        matrix, target = rng.normal(size=(20, columns)), rng.normal(size=20)
        expected, _ = scipy.optimize.nnls(matrix, target)
        found = _non_negative_least_squares(matrix, target)
        np.testing.assert_allclose(found, expected, atol=1e-12)
        zeros += (found == 0).any()
    assert 10 < zeros < 50
