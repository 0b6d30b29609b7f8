"""The compiled spline and its smoothing against those of scipy, whose import alone costs a start half as much again."""

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.linalg import solveh_banded

from hid2.kernels.spline import along_spline, quintic_spline, smooth_polyline
from netconvert.geometry import FloatArray


@pytest.fixture(params=[7, 30, 160])
def points(request: pytest.FixtureRequest) -> FloatArray:
    """Points a metre or so apart on a winding line, shaken by centimetres, far from the origin as in a city frame."""
    t = np.arange(request.param, dtype=np.float64)
    line = np.column_stack([1e4 + t, -2e3 + 8.0 * np.sin(t / 12.0)])
    return np.ascontiguousarray(line + np.random.default_rng(0).normal(0.0, 0.03, line.shape))


def test_smoothing_is_penalised_least_squares(points: FloatArray) -> None:
    """(W + strength D'D) x = W y with third differences D, weights W: solved by scipy's banded Cholesky."""
    strength, count = 300.0, len(points)
    third = np.diff(np.eye(count), n=3, axis=0)
    weight = np.ones(count)
    weight[[0, -1]] = 1e4
    matrix = np.diag(weight) + strength * third.T @ third
    band = np.array([np.append(np.diag(matrix, -k), np.zeros(k)) for k in range(4)])
    wanted = points[0] + solveh_banded(band, weight[:, None] * (points - points[0]), lower=True)
    assert np.abs(smooth_polyline(points, strength) - wanted).max() < 1e-9


def test_spline_is_the_interpolating_one_of_degree_five(points: FloatArray) -> None:
    """Not-a-knot ends; positions, and tangents from the derivative."""
    parameter, breaks, pieces = quintic_spline(points)
    wanted = make_interp_spline(parameter, points - points[0], k=5)
    s = np.linspace(0.0, float(parameter[-1]), 1000)
    xy, tangent, pace = along_spline(breaks, pieces, s)
    assert np.abs(xy - points[0] - wanted(s)).max() < 1e-9
    assert np.abs(tangent * pace[:, None] - wanted.derivative()(s)).max() < 1e-9
