"""Filters over windows."""

import numpy as np
from scipy.signal import upfirdn

from torchpi.operators.filters import decimate, filter_matrix, interpolate

FACTOR, TAPS = 4, np.random.default_rng(0).standard_normal(33)


def test_interpolation_matches_scipy() -> None:
    x = np.random.default_rng(1).standard_normal((50, 3))
    y = np.empty((FACTOR * 42, 3))
    interpolate(x, TAPS, FACTOR, y)
    np.testing.assert_allclose(y, upfirdn(TAPS, x, up=FACTOR, axis=0)[32 : 32 + len(y)], atol=1e-12)


def test_decimation_matches_scipy() -> None:
    x = np.random.default_rng(1).standard_normal((32 + 4 * 20, 3))
    y = np.empty((20, 3))
    decimate(x, TAPS, FACTOR, y)
    np.testing.assert_allclose(y, upfirdn(TAPS, x, down=FACTOR, axis=0)[8:28], atol=1e-12)


def test_a_matrix_of_filters_equals_the_sum_of_its_convolutions() -> None:
    random = np.random.default_rng(2)
    x, taps, y = random.standard_normal((60, 2)), random.standard_normal((9, 3, 2)), np.empty((52, 3))
    filter_matrix(x, taps, y)
    alone = [sum(np.convolve(x[:, i], taps[:, o, i], "valid") for i in range(2)) for o in range(3)]
    np.testing.assert_allclose(y, np.stack(alone, 1), atol=1e-12)
