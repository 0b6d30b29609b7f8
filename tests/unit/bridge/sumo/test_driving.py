"""Observe, decide, act, step: small roads, a few vehicles, SUMO at the wheel."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hand_drawn import draw_crossing, draw_lane, draw_two_lanes
from inserted import CAR, DRIVER, driven, nobody, recorded, scene_on, start_on
from simulated import PARAMETERS, drive

from bridge.sumo.fleet import Fleet
from bridge.sumo.flow_driving import NEAR_M, FlowDriving
from bridge.sumo.simulation import Simulation
from hid2.agents import BoxSize, Policy, Track
from hid2.conflicts.guard import Guard
from hid2.conflicts.stop_lines import StopLines
from hid2.insertion.finalise import ExportedVehicle, finalise, traffic_of_exported
from hid2.insertion.rollout import World
from hid2.params import Config, LaneChange
from hid2.policy.overtake import Stage
from hid2.policy.roads import Roads
from hid2.reasons import Reason
from hid2.scene import Scene
from hid2.vehicle import DrivenVehicle
from netconvert.lane_graph import LaneGraph
from netconvert.net_xml import net_bytes

UP = np.pi / 2


def _gaps(vehicle: DrivenVehicle, other: Track) -> np.ndarray:
    """Bumper gaps to a recorded one ahead on the x axis, m, by step."""
    return other.position[:, 0] - np.array(vehicle.s) - 0.5 * (CAR.length_m + other.size.length_m)


@pytest.mark.parametrize("seed", [0, 1, 3])
def test_vehicles_that_were_too_far_apart_to_look_at_each_other_do_so_when_they_come_near(seed: int) -> None:
    """Both are 153 m before a crossing at 14.5 m/s, and no vehicle enters meanwhile."""
    ends = [(0.0, 0.0), (160.0, 0.0), (180.0, 0.0), (300.0, 0.0)]
    ways = ends, [(170.0, x - 170.0) for x, _ in ends]
    lanes = [
        draw_lane(n, way[k : k + 2], successors=(n + 1,) if k < 2 else (), is_intersection=k == 1)
        for k, n, way in [(n % 3, n, ways[n // 3]) for n in range(6)]
    ]
    scene, driver = scene_on(LaneGraph({one.lane_id: one for one in lanes})), replace(DRIVER, desired_mps=14.5)
    starts = [start_on(scene, route, 17.0, 14.5, number=route[0], driver=driver) for route in ((0, 1, 2), (3, 4, 5))]
    with Simulation(net_bytes(scene.grid), seed=seed, step_s=0.1, parameters=PARAMETERS) as simulation:
        fleet = Fleet(scene, starts, nobody(scene.future.num_steps), Roads(scene), StopLines(scene), near_m=NEAR_M)
        first, second = FlowDriving(fleet, simulation, checked=False).run()
    assert first.limited["conflict"] + second.limited["conflict"] > 0
    apart_m = np.maximum(np.abs(np.array(first.s) - 170.0), np.abs(np.array(second.s) - 170.0))
    assert apart_m.min() > 0.5 * (CAR.length_m + CAR.width_m)


# Way of a vehicle -----------------------------------------------------------------------------------------------------


def test_nothing_follows_a_stored_trajectory() -> None:
    """The same start behind the same leader: another car-following model drives another motion, so does another seed
    of SUMO's; the same model and seed drive the same one.
    """
    scene = scene_on(draw_two_lanes(), recorded(75.0, 0.0, 6.0))

    def speeds(**how: Any) -> np.ndarray:
        (one,) = drive(scene, start_on(scene, (1,), 40.0, 10.0), **how).fleet.vehicles
        return np.array(one.v)

    eidm = speeds()
    assert np.array_equal(eidm, speeds())
    assert np.abs(eidm - speeds(model="Krauss")).max() > 0.2
    assert np.abs(eidm - speeds(model="IDM")).max() > 0.1
    assert not np.array_equal(eidm, speeds(seed=7))


def test_vehicle_that_reaches_the_end_of_the_map_has_left() -> None:
    scene = scene_on(draw_two_lanes(120.0))
    (one,) = drive(scene, start_on(scene, (1,), 60.0, 10.0)).fleet.vehicles
    assert one.left_at == len(one.s)
    assert 50 < one.left_at < 70


def _forks(length_m: float = 300.0) -> LaneGraph:
    """Lane 1 along the x axis; at x = 100 lane 2 goes straight on and lane 3 bears left."""
    ring = np.array([(-20.0, -60.0), (length_m + 20.0, -60.0), (length_m + 20.0, 60.0), (-20.0, 60.0), (-20.0, -60.0)])
    bends = [(100.0 + x, x**2 / 100.0) for x in np.linspace(0.0, 60.0, 40)]
    lanes = {
        1: draw_lane(1, [(0.0, 0.0), (100.0, 0.0)], successors=(2, 3)),
        2: draw_lane(2, [(100.0, 0.0), (length_m, 0.0)]),
        3: draw_lane(3, bends),
    }
    return LaneGraph(lanes, drivable_areas=(ring,))


def _oncoming() -> Track:
    """From step 30 on at 10 m/s against the traffic of lane 2, where who drives at 9 m/s meets it at x = 123."""
    return recorded(220.0, 0.0, 10.0, heading=np.pi, first=30)


def test_conflict_that_no_timing_solves_is_answered_by_another_way_at_the_next_split() -> None:
    """Case 3: its own lane is taken by an oncoming one, whom braking does not avoid."""
    scene = scene_on(_forks(), _oncoming())
    (one,) = drive(scene, start_on(scene, (1, 2), 40.0, 9.0)).fleet.vehicles
    assert one.rerouted_at is not None
    assert [segment.lane_id for segment in one.path.segments] == [1, 3]
    assert one.left_at is None
    assert np.diff(one.s) == pytest.approx(0.1 * np.array(one.v[1:]), abs=0.02)
    assert isinstance(finalise(scene, one, []), ExportedVehicle)


# Whom SUMO sees -------------------------------------------------------------------------------------------------------


def test_agents_that_are_not_shown_need_not_be_there() -> None:
    """All recorded agents in SUMO, or only those that have to be shown: the same motion, to the last bit.

    One behind, one that parks beside, and one that crosses before any vehicle is near draw no random numbers.
    """
    leader, behind, parked = recorded(85.0, 0.0, 6.0), recorded(5.0, 0.0, name="b"), recorded(140.0, 3.5, name="p")
    scene = scene_on(draw_two_lanes(), leader, behind, parked, recorded(250.0, -20.0, 10.0, heading=UP, name="c"))
    ways = [
        drive(scene, start_on(scene, (1,), 40.0, 10.0), start_on(scene, (2,), 60.0, 8.0, number=1), checked=checked)
        for checked in (True, False)
    ]
    first, second = ([vehicle.s for vehicle in way.fleet.vehicles] for way in ways)
    assert first == second
    assert (ways[0].replay_errors.states, ways[1].replay_errors.states) == (440, 0)


@pytest.mark.parametrize(("y", "is_seen"), [(2.3, False), (-1.5, True)])
def test_only_who_reaches_into_the_driving_width_is_shown(y: float, is_seen: bool) -> None:
    """Somebody stands at x = 95, both are 1.9 m wide: 1.5 m aside they share 0.4 m, 2.3 m aside they do not touch."""
    scene = scene_on(draw_two_lanes(), recorded(95.0, y))
    (one,) = drive(scene, start_on(scene, (1,), 40.0, 10.0)).fleet.vehicles
    assert (one.s[-1] < 95.0 - 4.5) is is_seen
    assert (min(one.v) < 0.5) is is_seen


def test_who_crosses_is_the_guards_business_not_sumos() -> None:
    """It crosses x = 90 at 8 m/s after 5 s, as the vehicle would: timing is adjusted, the cause is told."""
    crossing = recorded(90.0, -40.0, 8.0, heading=UP)
    scene = scene_on(draw_two_lanes(), crossing)
    (one,) = drive(scene, start_on(scene, (1,), 40.0, 10.0)).fleet.vehicles
    assert one.limited["conflict"] > 3
    exported = finalise(scene, one, [])
    assert isinstance(exported, ExportedVehicle), exported


@pytest.mark.parametrize("kept", [True, False])
def test_other_inserted_vehicles_are_followed_too_and_it_is_told_for_whom(kept: bool) -> None:
    """Those of rounds before, which drive as they drove, and those of the same round, which are told."""
    scene = scene_on(draw_two_lanes())
    first = start_on(scene, (1,), 80.0, 5.0, driver=replace(DRIVER, desired_mps=5.0), number=1)
    ahead = finalise(scene, driven(first, np.full(110, 5.0)), [])
    assert isinstance(ahead, ExportedVehicle)
    starts, others = ([], traffic_of_exported([ahead], scene)) if kept else ([first], None)
    one, *rest = drive(scene, start_on(scene, (1,), 40.0, 10.0), *starts, kept=others).fleet.vehicles
    s = np.array(rest[0].s) if rest else ahead.motion.s
    assert (s - np.array(one.s) - 4.5).min() > 1.0
    assert np.mean(one.v[-10:]) < 6.5
    assert set(one.waited_for) == {other.vehicle_id for other in rest}
    assert all(steps > 5 for steps in one.waited_for.values())  # half a second
    assert not any(other.waited_for for other in rest)


# Lane changes ---------------------------------------------------------------------------------------------------------


def test_leader_is_shown_also_while_another_vehicle_drives_beside_it() -> None:
    """Behind one at 4 m/s, with another one in the lane beside: SUMO brakes, not the guard late."""
    other = recorded(70.0, 0.07, 4.0)
    scene, slower, faster = (
        scene_on(draw_two_lanes(400.0), other),
        *(replace(DRIVER, desired_mps=v) for v in (4.0, 12.0)),
    )
    starts = start_on(scene, (1,), 20.0, 12.0, driver=faster), start_on(scene, (2,), 70.0, 4.0, number=1, driver=slower)
    follower = drive(scene, *starts).fleet.vehicles[0]
    assert not follower.limited
    assert _gaps(follower, other).min() > 5.0


@pytest.mark.parametrize("first", [0, 12])
def test_rollout_and_drive_ask_from_the_same_step_on(first: int) -> None:
    """Trigger times at multiples of a step are sums of steps."""
    scene = scene_on(draw_two_lanes(400.0))
    start = start_on(scene, (1,), 40.0, 10.0, policy=Policy.LANE_CHANGE, trigger_s=first * 0.1)
    world = World(scene, Roads(scene), Guard(scene, nobody(), StopLines(scene)))
    live, foreseen = drive(scene, start).fleet.vehicles[0], world.roll_manoeuvre(start)[0]
    assert [one.requested_step for one in live.shifts] == [one.requested_step for one in foreseen.shifts]


def test_lane_change_is_asked_for_at_the_trigger_and_carried_out() -> None:
    scene = scene_on(draw_two_lanes())
    (one,) = drive(scene, start_on(scene, (1,), 40.0, 10.0, policy=Policy.LANE_CHANGE, trigger_s=2.0)).fleet.vehicles
    (shift,) = one.shifts
    assert (shift.requested_step, shift.side, shift.source_lane, shift.target_lane) == (20, "left", 1, 2)
    assert one.stage is Stage.DONE
    assert [(look.step, look.rule, look.sumo) for look in one.gaps] == [(20, None, True)]
    assert one.path.line.position(np.array([one.s[-1]]))[0, 1] == pytest.approx(3.5, abs=0.1)


def test_who_slows_down_on_the_way_across_does_not_take_longer_for_it() -> None:
    """5 s as wanted are 5.5 s from end to end: half way, at 1.75 m, after 2.75 s, at 6 as at 10 m/s.

    By the length driven it would be a second later.
    """
    scene = scene_on(draw_two_lanes())
    desired = np.where(np.arange(110) < 25, 10.0, 6.0)
    start = start_on(scene, (1,), 40.0, 10.0, policy=Policy.LANE_CHANGE, trigger_s=2.0, desired=desired)
    (one,) = drive(scene, start).fleet.vehicles
    assert np.array(one.v)[47] < 8.0
    y = one.path.line.position(np.array(one.s))[:, 1]
    assert [y[20], y[47], y[48], y[76]] == pytest.approx([0.0, 1.7, 1.8, 3.5], abs=0.15)


def test_vehicle_is_where_sumo_has_it_also_behind_a_lane_change() -> None:
    """Lane 2 begins 6 m before lane 1 and ends 6 m behind it: cells that face each other at 60 m are 2.4 m apart.

        -6 |-------------- 2 --------------| 206
            0 |----------- 1 -----------| 200

    SUMO falls back by so much as it changes lanes; the vehicle drives slower for a while, and is there in the end (the
    way across is .16 m longer than the lane).
    """
    ring = np.array([(-20.0, -3.0), (220.0, -3.0), (220.0, 7.0), (-20.0, 7.0), (-20.0, -3.0)])
    right, left = draw_lane(1, [(0.0, 0.0), (200.0, 0.0)], left=2), draw_lane(2, [(-6.0, 3.5), (206.0, 3.5)], right=1)
    scene, fronts = scene_on(LaneGraph({1: right, 2: left}, drivable_areas=(ring,))), []

    def watch(simulation: Simulation) -> None:
        read = simulation.vehicle_ids

        def and_note() -> frozenset[str]:
            fronts.append(simulation.poses(["v0_0"])[0])
            return read()

        simulation.vehicle_ids = and_note  # type: ignore[method-assign]

    start = start_on(scene, (1,), 40.0, 10.0, policy=Policy.LANE_CHANGE, trigger_s=2.0)
    (one,) = drive(scene, start, patch=watch).fleet.vehicles
    own = np.array(one.s) - np.array(one.jumped_m)
    assert max(one.jumped_m) == pytest.approx(2.4, abs=0.3)
    assert one.jumped_m[-1] == 0.0
    assert np.diff(one.s) == pytest.approx(0.1 * np.array(one.v[1:]), rel=0.06, abs=0.01)
    seen = np.array([pose[0] for pose in fronts if pose is not None])
    assert one.path.line.position(own + 2.25)[:, 0] == pytest.approx(seen, abs=0.2)


EASY = Config(lane_change=LaneChange(time_gap_front_s=0.0, time_gap_rear_s=0.0, min_gap_m=0.0, braking_mps2=9.0))


def test_change_that_sumo_refuses_is_its_answer_and_is_asked_for_again() -> None:
    """On lane 2 one comes at 14 m/s from 5.5 m behind the bumper: hid2's rule is told to allow it, SUMO does not.

    Once it has passed, the change comes about.
    """
    scene = scene_on(draw_two_lanes(), config=EASY)
    fast = start_on(scene, (2,), 30.0, 14.0, number=1, driver=replace(DRIVER, desired_mps=14.0))
    own = start_on(scene, (1,), 40.0, 9.0, policy=Policy.LANE_CHANGE, driver=replace(DRIVER, desired_mps=9.0))
    one, _ = drive(scene, own, fast).fleet.vehicles
    answers = [look.sumo for look in one.gaps if look.rule is None]
    assert answers[0] is False
    assert answers[-1] is True
    assert answers.count(True) == len(one.shifts) == 1
    assert one.shifts[0].requested_step > 5


def test_refusal_leaves_the_vehicle_on_its_way() -> None:
    """A SUMO that never changes lanes: asked again at each step until the request is given up after 6 s."""

    def refuse(simulation: Simulation) -> None:
        simulation.change_lane = lambda *_, **__: None  # type: ignore[method-assign]

    scene = scene_on(draw_two_lanes())
    start = start_on(scene, (1,), 40.0, 10.0, policy=Policy.LANE_CHANGE, trigger_s=1.0)
    (one,) = drive(scene, start, patch=refuse).fleet.vehicles
    assert one.shifts == []
    assert one.reason == Reason.SUMO_REFUSES
    assert {look.sumo for look in one.gaps if look.rule is None} == {False}
    assert len(one.gaps) > 20
    assert one.stage is Stage.ABORTED
    assert one.path is start.path
    assert len(one.s) == 110


def test_overtake_enters_passes_and_returns() -> None:
    """A recorded one at 3 m/s 30 m ahead, nobody else on 400 m: out, past and back within 10.9 s at 14 m/s."""
    scene = scene_on(draw_two_lanes(400.0), recorded(75.0, 0.0, 3.0, name="slow"))
    fast = replace(DRIVER, desired_mps=14.0, lane_change_s=4.0)
    start = start_on(scene, (1,), 40.0, 13.0, policy=Policy.OVERTAKE, driver=fast)
    (one,) = drive(scene, start).fleet.vehicles
    assert [shift.side for shift in one.shifts] == ["left", "right"]
    assert one.overtaken_id == "slow"
    assert one.policies[Policy.OVERTAKE] >= 2


# Limits of hid2's -----------------------------------------------------------------------------------------------------


def _bend(radius_m: float, *, is_intersection: bool) -> LaneGraph:
    """60 m straight on, 90 degrees to the left, 120 m on."""
    angle = np.linspace(0.0, UP, 40)
    arc = np.array([60.0, 0.0]) + radius_m * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
    lanes = {
        1: draw_lane(1, [(0.0, 0.0), (60.0, 0.0)], successors=(2,)),
        2: draw_lane(2, arc, successors=(3,), is_intersection=is_intersection),
        3: draw_lane(3, [arc[-1], arc[-1] + [0.0, 120.0]]),
    }
    return LaneGraph(lanes)


@pytest.mark.parametrize(("is_intersection", "cause"), [(True, "turn"), (False, "curve")])
def test_bends_and_turns_limit_the_speed_and_say_so(is_intersection: bool, cause: str) -> None:
    """Radius 15 m and 2 m/s2: sqrt(30) = 5.5 m/s at most at the sharpest place."""
    scene = scene_on(_bend(15.0, is_intersection=is_intersection))
    (one,) = drive(scene, start_on(scene, (1, 2, 3), 20.0, 10.0)).fleet.vehicles
    assert one.limited[cause] > 10
    assert set(one.limited) <= {"turn", "curve"}
    s, v = np.array(one.s), np.array(one.v)
    inside = (s > 64.0) & (s < 80.0)
    assert v[inside].max() < 6.3


def test_vehicle_stops_at_a_red_entrance_and_goes_on_when_it_opens() -> None:
    """Cross traffic at 3.5 and 4.5 s: red until 3 s after it. The line is 60 - 2.25 - 1 = 56.75 m."""
    flow = (recorded(70.0, -45.0, 10.0, heading=UP, name="a"), recorded(70.0, -35.0, 10.0, heading=UP, name="b"))
    scene = scene_on(draw_crossing(end_m=250.0, zebra=True), *flow)
    (one,) = drive(scene, start_on(scene, (1, 2, 3), 15.0, 9.0)).fleet.vehicles
    s, v = np.array(one.s), np.array(one.v)
    assert one.limited["signal"] > 20
    assert s[50] < 57.3
    assert v[40:80].min() < 2.0
    assert s[-1] > s[75] + 2.0


def test_vehicle_joins_the_recorded_queue_and_goes_with_it() -> None:
    """Somebody stands at 50 m until 8 s and then drives off at up to 6 m/s: it stops behind, and follows."""
    steps = np.arange(110)
    x = 50.0 + np.concatenate([np.zeros(80), np.cumsum(0.1 * np.clip(0.2 * np.arange(30), 0.0, 6.0))])
    queue = Track("q", "vehicle", 2, steps, np.column_stack([x, 0.0 * x]), 0.0 * x, np.zeros((110, 2)), CAR)
    scene = scene_on(draw_crossing(end_m=250.0, zebra=True), queue)
    (one,) = drive(scene, start_on(scene, (1, 2, 3), 5.0, 9.0)).fleet.vehicles
    gap = _gaps(one, queue)
    assert gap.min() > 0.5
    assert min(one.v[60:90]) < 0.5
    assert gap[75] < 6.0
    assert one.v[-1] > 0.5


def test_pedestrian_on_the_crossing_is_let_across() -> None:
    """The walker is on the vehicle's way (|y| < 2) from 3 to 6.2 s; at 10 m/s from 65 m the crossing comes at 3.5 s."""
    walker = recorded(101.5, -6.0, 1.3, heading=UP, kind="pedestrian", size=BoxSize(0.6, 0.6))
    scene = scene_on(draw_crossing(end_m=250.0, zebra=True), walker)
    (one,) = drive(scene, start_on(scene, (1, 2, 3), 62.0, 9.0)).fleet.vehicles
    s = np.array(one.s)
    on_the_way = np.abs(walker.position[:, 1]) < 1.5
    assert one.limited["crossing"] > 5
    assert s[on_the_way].max() < 100.0 - 2.0
    assert s[-1] > 103.0


# Edges and insertion --------------------------------------------------------------------------------------------------


def _cut_road() -> Scene:
    """Two lanes of 100 m, then lane 3 of 20 m on from lane 1; edges 1#0 .. 1#24 hold a cell of both lanes."""
    lanes = {
        1: draw_lane(1, [(0.0, 0.0), (100.0, 0.0)], left=2, successors=(3,)),
        2: draw_lane(2, [(0.0, 3.5), (100.0, 3.5)], right=1),
        3: draw_lane(3, [(100.0, 0.0), (120.0, 0.0)]),
    }
    return scene_on(LaneGraph(lanes))


@pytest.mark.parametrize("s0", [10.0, 21.75, 99.0])
def test_vehicle_is_inserted_with_its_box_where_it_starts(s0: float) -> None:
    """Centre at s0, so the front bumper at s0 + 2.25 m, which may already be on the next cell or lane."""
    scene = _cut_road()
    poses: list[Any] = []

    def watch(simulation: Simulation) -> None:
        read = simulation.vehicle_ids

        def first() -> frozenset[str]:
            if not poses:
                poses.append((simulation.poses(["v0_0"])[0], simulation.speed("v0_0")))
            return read()

        simulation.vehicle_ids = first  # type: ignore[method-assign]

    drive(scene, start_on(scene, (1, 3), s0, 7.0), patch=watch)
    pose, speed = poses[0]
    assert pose == pytest.approx((s0 + 2.25, 0.0, 90.0), abs=0.01)
    assert speed == pytest.approx(7.0)


# Vehicles that enter during the scene ---------------------------------------------------------------------------------


def test_vehicle_begins_at_its_start_and_at_its_step_and_moves_by_sumos_speed() -> None:
    """At step 0 or 30, of 110: its first state is its start, and it is driven by SUMO from then on."""
    scene = scene_on(draw_two_lanes())
    starts = start_on(scene, (1,), 100.0, 7.0), start_on(scene, (1,), 3.0, 7.0, number=1, step=30)
    for one, s0, steps in zip(drive(scene, *starts).fleet.vehicles, (100.0, 3.0), (110, 80), strict=True):
        assert (one.s[0], one.v[0], len(one.s)) == (s0, 7.0, steps)
        assert np.diff(one.s) == pytest.approx(0.1 * np.array(one.v[1:]), abs=0.002)
        assert np.mean(one.v[-20:]) == pytest.approx(DRIVER.desired_mps, abs=0.5)
        assert dict(one.limited) == {}
        assert one.policies == {Policy.STRAIGHT: steps - 1}  # decided at every step behind the start


@pytest.mark.parametrize("checked", [True, False])
def test_vehicle_that_enters_follows_who_was_recorded_ahead_of_it(checked: bool) -> None:
    """A leader at 4 m/s, 15.5 m ahead of it at step 30, bumper to bumper; all are replayed, or those who matter."""
    leader = recorded(11.0, 0.0, 4.0)
    scene = scene_on(draw_two_lanes(), leader)
    (one,) = drive(scene, start_on(scene, (1,), 3.0, 6.0, step=30), checked=checked).fleet.vehicles
    gaps = leader.position[30:, 0] - np.array(one.s) - CAR.length_m
    assert gaps[0] == pytest.approx(15.5)
    assert gaps.min() > 1.5
    assert one.v[-1] == pytest.approx(4.0, abs=0.7)


def test_nobody_enters_where_another_one_is() -> None:
    """One that stands behind somebody recorded has not left the edge of the map when the next one is due."""
    scene = scene_on(draw_two_lanes(), recorded(12.0, 0.0))
    first, later = drive(
        scene, start_on(scene, (1,), 4.0, 0.0), start_on(scene, (1,), 3.0, 7.0, number=1, step=30)
    ).fleet.vehicles
    assert later.not_inserted is Reason.NO_ROOM_AT_EDGE
    assert later.s == []
    assert len(first.s) == 110
    assert finalise(scene, later, []) is Reason.NO_ROOM_AT_EDGE
