"""Equations of the paper's method, with its symbols, that no test of a module in tests/unit holds.

Cells, occupancy and dwell times are in netconvert/test_cells.py and hid2/occupancy/test_sigma.py; the conditions of
manoeuvres in hid2/policy; the three conflicts in hid2/conflicts/test_guard.py; s(t), d(t) and curvature in hid2/motion.
"""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import shapely
from gap_view import VIEW
from hand_drawn import draw_two_lanes
from inserted import recorded, scene_on, sites_of

from hid2.insertion.requests import draw_requests
from hid2.judge.findings import MotionProfile
from hid2.occupancy.sigma import FREE, GENERATED, ORIGINAL
from hid2.params import Config, LaneChange, Limits, Request, Turn
from hid2.policies import Policy
from hid2.policy.roads import f_left, f_right
from hid2.policy.rules import rule_reason
from hid2.reasons import Reason
from netconvert.geometry import differences

DELTA = 0.1


def test_policies_are_those_of_the_paper() -> None:
    assert {p.value for p in Policy} == {"straight", "left_turn", "right_turn", "lane_change", "overtake"}


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


def test_remaining_length_of_the_target_lane_is_not_below_a_threshold() -> None:
    """25 m are asked for by the paper's rule: 24 m are too few."""
    view = replace(VIEW, remaining_m=25.0)
    params = LaneChange(rule="paper", min_remaining_m=25.0)
    assert rule_reason(view, params) is None
    assert rule_reason(replace(view, remaining_m=24.0), params) == Reason.LANE_ENDS


def test_f_left_is_below_f_right_is_at_most_1_with_its_trough_early_to_mid_turn() -> None:
    """v = v_0 f(alpha), f_right(alpha) > f_left(alpha); 1 at the entrance and the exit."""
    alpha, turn = np.linspace(0.0, 1.0, 201), Turn()
    left, right = f_left(alpha, turn), f_right(alpha, turn)
    assert np.all(left[1:-1] < right[1:-1])
    assert np.all(right <= 1.0)
    assert left[[0, -1]] == pytest.approx([1.0, 1.0])
    assert 0.1 <= alpha[np.argmin(left)] <= 0.6


def test_lateral_acceleration_is_curvature_times_speed_squared() -> None:
    """R = 20 m at 8 m/s: 0.05 * 64 = 3.2 m/s2, below a_y,max = 4.89."""
    angle = 8.0 / 20.0 * DELTA * np.arange(40)
    velocity = 8.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    profile = MotionProfile.of(velocity, angle, partial(differences, step=DELTA))
    assert profile.lateral_accel_mps2[1:-1] == pytest.approx(np.full(38, 3.2), rel=2e-3)
    assert Limits().lateral_accel_mps2 == 4.89
