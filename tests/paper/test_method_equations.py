"""The equations of the paper's method, one test each, in the paper's order and with its symbols.

Arc lengths, N_l, centres and links of cells, and the Frenet frame are worked by hand in tests/unit/netconvert.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import shapely
from hand_drawn import draw_lane, draw_two_lanes
from inserted import CAR, DRIVER, nobody, recorded, scene_on

from hid2.agents import Policy, Track
from hid2.conflicts.guard import Braking, Guard, transition_rejected
from hid2.conflicts.stop_lines import StopLines
from hid2.drivers.driver import LaneOffset, usual_driver
from hid2.insertion.requests import draw_requests
from hid2.insertion.sites import InsertionSites
from hid2.insertion.spread import Spread
from hid2.insertion.surroundings import Surroundings
from hid2.judge.findings import MotionProfile
from hid2.kernels.trajectory import derivatives_of_motion
from hid2.motion.lane_change_path import lateral_share
from hid2.motion.reference_line import TABLE_STEP_M, build_reference_line
from hid2.motion.route import DrivenPath
from hid2.motion.smoothing import Motion, smooth_motion, trajectory
from hid2.occupancy.sigma import FREE, GENERATED, ORIGINAL, cell_boxes, dwell_steps, original_occupancy
from hid2.occupancy.traffic import Traffic, traffic_of
from hid2.params import Config, LaneChange, Limits, Overtake, Request, Turn
from hid2.policy.decision import Observation, decide
from hid2.policy.lane_change import OPEN as NO_GAP
from hid2.policy.lane_change import Gap, LaneOption
from hid2.policy.observation import Inserted, lane_options
from hid2.policy.overtake import Stage, enter_reason
from hid2.policy.roads import f_left, f_right, road_speeds
from hid2.reasons import Reason
from hid2.scene import Scene, build_scene
from netconvert.cells import Cell, build_cell_grid
from netconvert.lane_graph import LaneGraph, TurnType

DELTA_S, DELTA = 4.0, 0.1
NOBODY = nobody()


def _scene(*tracks: Track) -> Scene:
    """Lane 1 (right, y = 0) and lane 2 (left, y = 3.5), 200 m along +x."""
    return scene_on(draw_two_lanes(200.0), *tracks)


def _box(x: float, y: float, *, length_m: float = 4.5) -> Traffic:
    """A box that stands, of exactly this size (a recorded one is taken for 4.5 m at least)."""
    return Traffic(
        ids=("b",), position=np.tile([x, y], (1, 110, 1)), heading=np.zeros((1, 110)), velocity=np.zeros((1, 110, 2)),
        present=np.ones((1, 110), dtype=bool), length_m=np.array([length_m]), width_m=np.array([1.9]),
    )  # fmt: skip


# Lane gridification and occupancy -------------------------------------------------------------------------------------


def test_sigma_is_0_1_or_2_and_never_two_of_them() -> None:
    """Originals hold their cells against generated ones: a generated vehicle is placed on sigma = 0 only."""
    assert (FREE, ORIGINAL, GENERATED) == (0, 1, 2)
    scene = _scene(recorded(60.0, 0.0), recorded(100.0, 3.5))
    sigma = scene.occupancy.sigma[0]
    assert set(np.unique(sigma)) == {FREE, ORIGINAL}
    here = Surroundings(scene)
    guard = Guard(scene, NOBODY, here.stop_lines)
    sites = InsertionSites(here, guard, np.random.default_rng(0), 0, Spread.of((0, 0)))
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


def test_original_occupancy_follows_the_recorded_trajectory() -> None:
    """10 m/s from x = 2.5: in cell floor(x / 4) at every step, which is known for all steps beforehand."""
    grid = build_cell_grid(draw_two_lanes(200.0))
    found = original_occupancy(cell_boxes(grid), traffic_of([recorded(2.5, 0.0, 10.0)], 110, step_s=DELTA))
    cells = [grid.cells[row] for row in found.cell[0]]
    assert cells == [Cell(1, int((2.5 + k) / DELTA_S)) for k in range(110)]


# Agent policy: lane change --------------------------------------------------------------------------------------------


def test_policies_are_those_of_the_paper() -> None:
    assert {p.value for p in Policy} == {"straight", "left_turn", "right_turn", "lane_change", "overtake"}


@pytest.mark.parametrize("k", [-3, -2, -1, 0, 1, 2, 3])
def test_lane_change_needs_sigma_0_in_cells_j_minus_1_to_j_plus_1_of_the_target_lane(k: int) -> None:
    """The agent is in cell j = 10 of lane 1 (40 .. 44 m); somebody of 3 m stands in cell j + k of lane 2.

    lane 2    |    |    | -1 |  0 | +1 |    |    |
    lane 1                   | ag |
    """
    scene = _scene()
    (option, _), *_ = lane_options(
        scene, scene.paths.along((1,)), CAR, s=42.0, sides=("left",),
        inserted=Inserted(0, _box(42.0 + DELTA_S * k, 3.5, length_m=3.0), NOBODY), speed_mps=10.0, desired_mps=10.0,
    )  # fmt: skip
    assert option.target == Cell(2, 10)
    assert option.cells_free is (abs(k) > 1)


OPTION = LaneOption("left", Cell(2, 10), True, NO_GAP, NO_GAP, 150.0, 150.0)
SEEN: dict[str, Any] = {
    "time_s": 2.0, "next_cell": Cell(1, 11), "lane_turn": TurnType.STRAIGHT, "speed_mps": 10.0,
    "driver": usual_driver(10.0), "request": Policy.LANE_CHANGE, "trigger_s": 2.0, "stage": Stage.WAITING,
    "leader": None, "options": (OPTION,),
}  # fmt: skip


def _decide(**changes: Any) -> Any:
    return decide(
        Observation(**{**SEEN, **changes}),
        lane_change=LaneChange(min_remaining_m=25.0),
        overtake=Overtake(return_gap_m=5.0),
    )


def test_next_cell_is_g_l_prime_j_when_feasible_else_g_l_j_plus_1() -> None:
    blocked = LaneOption("left", Cell(2, 10), False, NO_GAP, NO_GAP, 150.0, 150.0)
    assert _decide().target == Cell(2, 10)
    assert _decide(options=(blocked,)).target == Cell(1, 11)


def test_trigger_holds_from_t_trigger_on() -> None:
    """t >= t_trigger."""
    assert _decide(time_s=1.99).policy is Policy.STRAIGHT
    assert _decide(time_s=2.0).policy is Policy.LANE_CHANGE
    assert _decide(time_s=5.0).policy is Policy.LANE_CHANGE


def test_remaining_length_of_the_target_lane_exceeds_a_threshold() -> None:
    """25 m are asked for: 24 m are too few."""
    short = LaneOption("left", Cell(2, 44), True, NO_GAP, NO_GAP, 24.0, 24.0)
    assert _decide(options=(short,)).reason == "lane_ends"


# Agent policy: overtaking ---------------------------------------------------------------------------------------------

FREE_LANE = LaneOption("left", Cell(2, 10), True, NO_GAP, NO_GAP, 150.0, 100.0)


def _enter(leader: Gap, **lane: Any) -> Reason | None:
    params = Overtake(d_obs_m=40.0, safe_front_m=6.0, safe_rear_m=8.0, d_overtake_m=40.0)
    return enter_reason(replace(FREE_LANE, **lane), leader=leader, desired_mps=12.0, params=params)


@pytest.mark.parametrize(("gap", "evaluated"), [(4.0, True), (40.0, True), (41.0, False)])
def test_overtake_is_evaluated_for_a_leader_within_d_obs(gap: float, evaluated: bool) -> None:
    """k <= d_obs / delta s = 10 cells."""
    assert (_enter(Gap(gap, 5.0, "1")) is None) is evaluated


def test_overtake_needs_safe_gaps_ahead_and_behind() -> None:
    leader = Gap(20.0, 5.0, "1")
    for ahead, behind, reason in ((6.0, 8.0, None), (5.9, 8.0, "front_gap"), (6.0, 7.9, "rear_gap")):
        assert _enter(leader, front=Gap(ahead, 12.0), rear=Gap(behind, 12.0)) == reason


def test_overtake_needs_a_corridor_of_m_cells() -> None:
    """m * 4 m >= 40 m: ten cells do, nine do not."""
    leader = Gap(20.0, 5.0, "1")
    for m, reason in ((10, None), (9, "corridor_short")):
        assert _enter(leader, corridor_m=m * DELTA_S) == reason


def test_overtake_enters_passes_and_returns_ahead_of_where_it_left() -> None:
    """Enter at g_{l',j}; pass; return at g_{l,j+k'} once the leader is behind, k' > k."""
    leader = Gap(20.0, 5.0, "1")
    enter = _decide(request=Policy.OVERTAKE, leader=leader, driver=usual_driver(12.0))
    assert (enter.policy, enter.target) == (Policy.OVERTAKE, Cell(2, 10))
    back = LaneOption("right", Cell(1, 25), True, NO_GAP, NO_GAP, 100.0, 100.0)
    passing = {"request": Policy.OVERTAKE, "stage": Stage.PASS, "options": (back,)}
    assert _decide(**passing, passed_gap_m=-2.0).policy is Policy.STRAIGHT
    assert _decide(**passing, passed_gap_m=6.0).target == Cell(1, 25)


# Agent policy: straight, left turn and right turn ---------------------------------------------------------------------


def test_speed_on_a_straight_lane_stays() -> None:
    """v(t + dt) ~ v(t)."""
    line = build_reference_line(np.array([[0.0, 0.0], [200.0, 0.0]]), step_m=1.0, min_radius_m=5.0, max_offset_m=0.6)
    road = road_speeds(line, [(0.0, 200.0, TurnType.STRAIGHT)], turn=Turn(), limits=Limits())
    speed = road.desired(11.0, lateral_accel_mps2=1.8, accel_mps2=1.8)
    assert np.ptp(speed) == pytest.approx(0.0)


def test_f_left_is_below_f_right_is_at_most_1_with_its_trough_early_to_mid_turn() -> None:
    """v = v_0 f(alpha), f_right(alpha) > f_left(alpha); 1 at the entrance and the exit."""
    alpha, turn = np.linspace(0.0, 1.0, 201), Turn()
    left, right = f_left(alpha, turn), f_right(alpha, turn)
    assert np.all(left[1:-1] < right[1:-1])
    assert np.all(right <= 1.0)
    assert left[[0, -1]] == pytest.approx([1.0, 1.0])
    assert 0.1 <= alpha[np.argmin(left)] <= 0.6


def test_v_0_is_set_at_the_entrance_by_the_lateral_acceleration_and_f_decides_from_there() -> None:
    """v = v_0 f(alpha) on the whole turn; v^2 kappa reaches a_y at one point of it and never exceeds it."""
    angle = np.radians(np.arange(0.0, 91.0, 3.0))
    corner = np.column_stack([30 + 12 * np.sin(angle), 12 - 12 * np.cos(angle)])
    points = np.concatenate([[[0.0, 0.0]], corner, [[42.0, 42.0]]])
    line = build_reference_line(points, step_m=1.0, min_radius_m=5.0, max_offset_m=0.6)
    start, end = 25.0, 54.0
    road = road_speeds(line, [(start, end, TurnType.LEFT)], turn=Turn(), limits=Limits())
    inside = slice(int(start / TABLE_STEP_M), int(end / TABLE_STEP_M) + 1)
    v = road.cap(1.8)[inside]
    alpha = (np.arange(inside.start, inside.stop) * TABLE_STEP_M - start) / (end - start)
    assert v / v[0] == pytest.approx(f_left(alpha, Turn()))
    lateral = v**2 * np.abs(line.table_curvature[inside])
    assert lateral.max() == pytest.approx(1.8)
    assert (lateral < 0.95 * 1.8).mean() > 0.5


# Trajectory generation ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("speed", "steps"), [(10.0, 4), (12.0, 4), (13.4, 3), (1.0, 40), (40.1, 1)])
def test_dwell_time_n_i(speed: float, steps: int) -> None:
    """n_i = ceil(delta s / v_i / delta): at 12 m/s 0.333 s, 4 steps of 0.1 s."""
    assert dwell_steps(cell_m=DELTA_S, speed_mps=speed, step_s=DELTA) == steps


def test_vehicle_at_constant_speed_is_in_the_next_cell_after_n_i_steps() -> None:
    steps = dwell_steps(cell_m=DELTA_S, speed_mps=9.0, step_s=DELTA)
    assert steps is not None
    assert 9.0 * DELTA * (steps - 1) < DELTA_S <= 9.0 * DELTA * steps


def test_conflict_1_sigma_1_rejects_the_transition() -> None:
    assert [transition_rejected(sigma) for sigma in (FREE, ORIGINAL, GENERATED)] == [False, True, False]


def _braking(scene: Scene, path: DrivenPath, others: list[Any], fleet: Any, **more: Any) -> Braking:
    """What a vehicle in row 0 at s = 40 m and 10 m/s has to do."""
    guard = Guard(scene, NOBODY, StopLines(scene))
    return guard.braking(
        guard.obstacles(path, CAR, others), own=0, step=0, fleet=np.array(fleet), state=(fleet[0][0], fleet[0][1], 0.0),
        desired_mps=10.0, road=np.full(path.line.table_xy.shape[0], np.inf), driver=DRIVER, **more,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("own_executing", "other_executing", "other_s", "brakes"),
    [
        (0.0, 1.0, 30.0, True),  # the other is executing, if farther
        (1.0, 0.0, 50.0, False),  # the own one is executing, if farther
        (0.0, 0.0, 50.0, True),  # both pending: the other is closer
        (0.0, 0.0, 30.0, False),  # the own one is closer
    ],
)
def test_conflict_2_executing_before_pending_closer_before_farther(
    own_executing: float, other_executing: float, other_s: float, brakes: bool
) -> None:
    """Two roads cross at right angles, at 80 m of both. The own vehicle comes from 40 m at 10 m/s, there in 4 s.

    So is the other: from 30 m at 50 / 4 = 12.5 m/s, or from 50 m at 30 / 4 = 7.5 m/s.
    """
    ring = np.array([(-20.0, -90.0), (220.0, -90.0), (220.0, 130.0), (-20.0, 130.0), (-20.0, -90.0)])
    lanes = {1: draw_lane(1, [(0, 0), (200, 0)]), 2: draw_lane(2, [(80, -80), (80, 120)])}
    grid = build_cell_grid(LaneGraph(lanes, drivable_areas=(ring,)))
    scene = build_scene(grid, (), config=Config(), num_steps=110, last_observed_step=49, step_s=0.1)
    fleet = [[40.0, 10.0, 0.0, own_executing, 1.0], [other_s, (80.0 - other_s) / 4.0, 0.0, other_executing, 1.0]]
    found = _braking(scene, scene.paths.along((1,)), [(1, scene.paths.along((2,)), CAR)], fleet)
    assert (found.decel_mps2 > 0.0) is brakes


def test_conflict_3_predicted_collision_changes_the_timing() -> None:
    """Somebody recorded crosses x = 80 at 8 m/s and is there after 4 s, as 10 m/s from x = 40 would be."""
    scene = _scene(recorded(80.0, -32.0, 8.0, heading=math.pi / 2))
    found = _braking(scene, scene.paths.along((1,)), [], [[40.0, 10.0, 0.0, 0.0, 1.0]], horizon_s=6.0)
    assert found.decel_mps2 > 0.0
    assert found.conflict_s is None


# Trajectory smoothing -------------------------------------------------------------------------------------------------


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


def test_d_of_t_is_piecewise_cubic_with_continuous_acceleration() -> None:
    """d(t) = b0 + b1 t + b2 t2 + b3 t3 between its knots, here in eighths: fourth differences vanish inside.

    With ramps of a quarter the jerk is 256 / 3 D / T^3 in the outer eighths and 0 between.
    """
    lateral_m, duration = 3.5, 4.0
    for eighth, share in enumerate((256 / 3, 256 / 3, 0, 0, 0, 0, 256 / 3, 256 / 3)):
        tau = eighth / 8 + np.linspace(0.01, 0.11, 12)
        d = lateral_m * lateral_share(tau, 0.25)
        step = float(tau[1] - tau[0]) * duration
        assert np.abs(np.diff(d, 4)).max() < 1e-9
        assert abs(np.diff(d, 3)[0]) / step**3 == pytest.approx(share * lateral_m / duration**3, rel=1e-6, abs=1e-6)


def test_curvature_of_a_trajectory_is_the_cross_product_over_speed_cubed() -> None:
    """kappa = |x' y'' - y' x''| / (x'^2 + y'^2)^1.5 of a motion on a circle of 20 m is 1 / 20."""
    angle = np.radians(np.arange(0.0, 181.0, 3.0))
    line = build_reference_line(
        20.0 * np.column_stack([np.sin(angle), 1 - np.cos(angle)]), step_m=1.0, min_radius_m=5.0, max_offset_m=0.6
    )
    motion = Motion(s=5.0 + 0.8 * np.arange(60), v=np.full(60, 8.0), a=np.zeros(60), step_s=0.1)
    middle = LaneOffset(np.array([0.0, 100.0]), np.zeros(2), np.zeros(2))
    position = trajectory(line, motion, middle).position
    first = np.gradient(position, DELTA, axis=0)
    second = np.gradient(first, DELTA, axis=0)
    kappa = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / np.hypot(*first.T) ** 3
    assert kappa[3:-3] == pytest.approx(np.full(54, 0.05), rel=0.03)


def test_curvature_stays_below_1_over_r_min() -> None:
    """A turn of 90 degrees drawn with only two kinks of 45, as coarse maps have it."""
    turn = np.array([[0.0, 0.0], [20.0, 0.0], [26.0, 6.0], [26.0, 26.0]])
    line = build_reference_line(turn, step_m=1.0, min_radius_m=5.0, max_offset_m=0.6)
    assert np.abs(line.table_curvature).max() <= 1.0 / 5.0


def test_lateral_acceleration_is_curvature_times_speed_squared() -> None:
    """R = 20 m at 8 m/s: 0.05 * 64 = 3.2 m/s2, below a_y,max = 4.89."""
    angle = 8.0 / 20.0 * DELTA * np.arange(40)
    velocity = 8.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    profile = MotionProfile(*derivatives_of_motion(velocity, angle, DELTA))
    assert profile.lateral_accel_mps2[1:-1] == pytest.approx(np.full(38, 3.2), rel=2e-3)
    assert Limits().lateral_accel_mps2 == 4.89
