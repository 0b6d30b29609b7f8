"""Equations of the paper's method, with its symbols, that no test of a module in tests/unit holds.

Cells, occupancy and dwell times are in netconvert/test_cells.py and hid2/occupancy/test_sigma.py; the conditions of
manoeuvres in hid2/policy; the three conflicts in hid2/conflicts/test_guard.py; s(t), d(t) and curvature in hid2/motion.
"""

import numpy as np
import pytest
import shapely
from hand_drawn import draw_two_lanes
from inserted import recorded, scene_on, sites_of

from hid2.insertion.requests import draw_requests
from hid2.motion.smoothing import smooth_motion
from hid2.occupancy.sigma import FREE, GENERATED, ORIGINAL
from hid2.params import Config, Request

DELTA = 0.1


def test_sigma_is_0_1_or_2_and_never_two_of_them() -> None:
    """Originals hold their cells against generated ones: a generated vehicle is placed on sigma = 0 only."""
    assert (FREE, ORIGINAL, GENERATED) == (0, 1, 2)
    scene = scene_on(draw_two_lanes(200.0), recorded(60.0, 0.0), recorded(100.0, 3.5))
    sigma = scene.occupancy.sigma[0]
    assert set(np.unique(sigma)) == {FREE, ORIGINAL}
    sites = sites_of(scene)
    config = Config(request=Request(left_turn=0, right_turn=0, lane_change=0, overtake=0))
    requests = draw_requests(config, np.random.default_rng(0), count=6, duration_s=10.9)
    placed = [start for one in requests for start in sites.propose(one)]
    assert len(placed) >= 3
    taken: set[int] = set()
    for start in placed:
        x, y = start.path.line.position(np.array([start.start_m]))[0].tolist()
        half_l, half_w = start.size.length_m / 2, 0.4 * start.size.width_m
        box = shapely.box(x - half_l, y - half_w, x + half_l, y + half_w)
        under = np.flatnonzero(shapely.intersects(scene.grid.polygons, box))
        assert np.all(sigma[under] == FREE)
        assert not taken & set(under.tolist())
        taken |= set(under.tolist())


def test_s_of_t_is_a_cubic_from_position_speed_and_acceleration() -> None:
    """Between steps s is the cubic with v and a at both ends: its increment is dt (v0 + v1) / 2 - dt^2 (a1 - a0) / 12.

    v = 8 + 0.6 t^2 (a = 1.2 t) is kept by a narrow filter inside; over 1 s from t = 2: 8 + 0.2 (3^3 - 2^3) = 11.8 m.
    Differences over two steps make of v what is 0.2 delta^2 = 0.002 m/s faster.
    """
    t = np.arange(51) * DELTA
    s = 5.0 + 8.0 * t + 0.2 * t**3
    motion = smooth_motion(s, filter_s=0.02, step_s=DELTA)
    assert motion.s[30] - motion.s[20] == pytest.approx(11.802, abs=1e-3)
    assert motion.a[20] == pytest.approx(2.4, abs=1e-2)
    step = 0.5 * DELTA * (motion.v[1:] + motion.v[:-1]) - DELTA**2 / 12.0 * np.diff(motion.a)
    assert np.diff(motion.s) == pytest.approx(step)
