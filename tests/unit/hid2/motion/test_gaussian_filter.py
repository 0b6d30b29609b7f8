"""The filter of the smoothed speed."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from hid2.motion.smoothing import _gaussian_filter


@pytest.mark.parametrize(("count", "deviation"), [(50, 0.4), (110, 4.0), (12, 5.0), (30, 0.1)])
def test_gaussian_filter_is_that_of_scipy(count: int, deviation: float) -> None:
    """Also where the signal is shorter than the filter reaches, and where that is less than a step."""
    values = np.random.default_rng(0).normal(10.0, 3.0, count)
    expected = gaussian_filter1d(values, deviation, truncate=3.0)
    np.testing.assert_allclose(_gaussian_filter(values, deviation), expected, rtol=0.0, atol=1e-12)
