"""The judge of states: each limit is found a little beyond it, and not a little inside it."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hand_drawn import draw_lane, draw_road

from hid2.agents import BoxSize, Track
from hid2.judge.findings import Bounds, Quantity
from hid2.judge.states import contacts_at_end, judge, of_boxes, sustained_headway
from hid2.measures.lane_matching import flatten_lanes
from hid2.occupancy.agent_states import AgentStates, agent_states
from hid2.occupancy.traffic import Traffic
from netconvert.lane_graph import LaneGraph

CAR = BoxSize(4.5, 1.9)
STEPS = 60


def _along(
    name: str, s: Any, *, y: float = 0.0, heading: float = 0.0, first: int = 0, kind: str = "vehicle",
    size: BoxSize = CAR) -> Track:  # fmt: skip
    """A box that is at x = s (T,) m, y at the steps from `first` on; velocity by differences, heading as it is told."""
    x = np.asarray(s, dtype=np.float64)
    speed = np.gradient(x, 0.1) if x.size > 1 else np.zeros(1)
    flat = np.zeros(x.size)
    return Track(
        name, kind, 1, first + np.arange(x.size), np.column_stack([x, flat + y]), flat + heading,
        np.column_stack([speed, flat]), size,
    )  # fmt: skip


def _at(
    name: str, x: float, speed: float, *, y: float = 0.0, aside: float = 0.0, steps: int = STEPS, **more: Any
) -> Track:
    """The same at constant speed, moving aside evenly."""
    time = 0.1 * np.arange(steps)
    track = _along(name, x + speed * time, y=y, **more)
    position = track.position + np.column_stack([np.zeros(steps), aside * time])
    heading = np.full(steps, np.arctan2(aside, speed)) if aside else track.heading
    return replace(track, position=position, heading=heading, velocity=np.tile([speed, aside], (steps, 1)))


def _circle(name: str, radius: float, speed: float) -> Track:
    angle = speed / radius * 0.1 * np.arange(STEPS)
    return Track(
        name, "vehicle", 1, np.arange(STEPS), radius * np.column_stack([np.sin(angle), 1 - np.cos(angle)]),
        (angle + np.pi) % (2 * np.pi) - np.pi, speed * np.column_stack([np.cos(angle), np.sin(angle)]), CAR,
    )  # fmt: skip


def states_on(graph: LaneGraph, *tracks: Track) -> AgentStates:
    return agent_states(tracks, flatten_lanes(graph), num_steps=STEPS, step_s=0.1)


def judged(*tracks: Track) -> list[tuple[str, Quantity, str | None]]:
    """(track, quantity, other) of each finding on two lanes of 200 m at y = 0 and y = 3.5."""
    graph = draw_road()
    return [(one.track_id, one.quantity, one.other) for one in judge(states_on(graph, *tracks), Bounds())]


def test_quiet_driving_has_no_finding() -> None:
    assert judged(_at("a", 60.0, 10.0), _at("gen_0", 20.0, 10.0), _at("gen_1", 10.0, 12.0, y=3.5)) == []


@pytest.mark.parametrize(("radius", "speed", "found"), [
    (40.0, 10.0, set()),  # 2.5 m/s2 across, .25 rad/s
    (15.0, 9.5, {"lateral_accel"}),  # 6 m/s2 across, .63 rad/s
    (5.0, 4.9, {"yaw_rate"}),  # 4.8 m/s2 across, .98 rad/s; a curvature of 0.2, which 10 % more would break
    (4.0, 3.0, {"curvature"}),  # 2.25 m/s2 across, .75 rad/s, 0.25 1/m
])  # fmt: skip
def test_curves(radius: float, speed: float, found: set[str]) -> None:
    """Motion alone: the map is far away, and ground everywhere. Jerk on a circle: v w^2, at most 4.7 m/s3 here."""
    ring = np.array([(-500.0, -500.0), (500.0, -500.0), (500.0, 500.0), (-500.0, 500.0), (-500.0, -500.0)])
    graph = LaneGraph({}, drivable_areas=(ring,))
    seen = judge(states_on(graph, _circle("gen_0", radius, speed)), Bounds())
    assert {one.quantity.value for one in seen} == found


@pytest.mark.parametrize(
    ("degrees", "inside", "found"), [(50, False, 0), (70, False, 1), (70, True, 0), (100, True, 1)]
)
def test_heading_against_the_lane(degrees: float, inside: bool, found: int) -> None:
    """A box that stands across its lane: 60 degrees are the limit outside of intersections, 90 in them."""
    ring = np.array([(-50.0, -50.0), (350.0, -50.0), (350.0, 50.0), (-50.0, 50.0), (-50.0, -50.0)])
    graph = LaneGraph({1: draw_lane(1, [(0.0, 0.0), (300.0, 0.0)], is_intersection=inside)}, drivable_areas=(ring,))
    stands = _at("gen_0", 50.0, 0.0, heading=np.radians(degrees))
    seen = judge(states_on(graph, stands), Bounds())
    assert [one.quantity for one in seen] == [Quantity.AGAINST_LANE] * found
    assert all(one.value == pytest.approx(degrees) for one in seen)


def test_driving_against_the_lane_is_found_and_heading_against_one_that_leads_up_the_map() -> None:
    """Turned round, and in reverse. The lane at 90 degrees, the box that stands on it at 20: 70 degrees apart."""
    ring = np.array([(-50.0, -50.0), (150.0, -50.0), (150.0, 350.0), (-50.0, 350.0), (-50.0, -50.0)])
    graph = LaneGraph({1: draw_lane(1, [(50.0, -40.0), (50.0, 300.0)])}, drivable_areas=(ring,))
    (seen,) = judge(states_on(graph, _at("gen_0", 50.0, 0.0, heading=np.radians(20.0))), Bounds())
    assert (seen.quantity, seen.value) == (Quantity.AGAINST_LANE, pytest.approx(70.0))
    for heading in (np.pi, 0.0):
        seen = judged(_at("gen_0", 200.0, -10.0, heading=heading))
        assert Quantity.AGAINST_LANE in {one[1] for one in seen}


@pytest.mark.parametrize(("aside", "found"), [(1.95, 0), (1.85, 1)])
def test_boxes_that_share_ground(aside: float, found: int) -> None:
    """Side by side, 1.9 m wide both: 0.05 m between them, and 0.05 m of each other."""
    seen = judged(_at("a", 20.0, 10.0), _at("gen_0", 20.0, 10.0, y=aside))
    assert seen.count(("gen_0", Quantity.OVERLAP, "a")) == found


def test_every_box_that_is_met_is_told_and_recorded_ones_among_themselves_are_not() -> None:
    through = judged(_at("a", 40.0, 0.0), _at("b", 40.5, 0.0), _at("c", 55.0, 0.0), _at("gen_0", 20.0, 10.0))
    assert {one[2] for one in through if one[1] is Quantity.OVERLAP} == {"a", "b", "c"}
    assert {one[0] for one in through} == {"gen_0"}


def test_overlap_between_two_steps_is_found() -> None:
    """A box of 0.6 m leaps over a standing car within a step: from y = -2 to +2, and at y = 0 half way.

    step 0   x         y = -2       half the car is 0.95 m wide, half the box 0.3 m: clear at both steps
    half    [x]        y =  0
    step 1   x         y = +2
    """
    leap = _at("gen_0", 20.0, 0.0, y=-2.0, steps=2, size=BoxSize(0.6, 0.6))
    leap = replace(leap, position=np.array([[20.0, -2.0], [20.0, 2.0]]))
    states = states_on(draw_road(), _at("a", 20.0, 0.0), leap)
    assert [one.step for one in of_boxes(states, 1, np.array([0]), spare_m=0.0)] == [0]
    gone = states_on(draw_road(), _at("a", 20.0, 0.0, steps=1), leap)
    assert list(of_boxes(gone, 1, np.array([0]), spare_m=0.0)) == []
    turned = replace(_at("a", 20.0, 0.0, steps=2), heading=np.array([0.0, np.pi]))  # round within a step: never across
    for y, shared_m2 in ((3.0, []), (1.8, [0.45])):  # 1.1 m apart, or 0.1 m of each other; across 0.2 or 1.4 m
        states = states_on(draw_road(), turned, _at("gen_0", 20.0, 0.0, y=y, steps=2))
        assert [one.value for one in of_boxes(states, 1, np.array([0]), spare_m=0.0)] == pytest.approx(shared_m2)


def test_spare_widens_the_own_box() -> None:
    """1.95 m apart sideways, 1.9 m wide both: 0.05 m between; 0.06 m more closes it."""
    states = states_on(draw_road(), _at("a", 20.0, 0.0), _at("gen_0", 20.0, 0.0, y=1.95))
    assert list(of_boxes(states, 1, np.array([0]), spare_m=0.04)) == []
    assert len(list(of_boxes(states, 1, np.array([0]), spare_m=0.06))) == 1


@pytest.mark.parametrize("kind", ["vehicle", "cyclist"])
@pytest.mark.parametrize(("gap", "found"), [(15.6, 0), (14.6, 1)])
def test_time_to_collision_with_a_leader_of_any_type(kind: str, gap: float, found: int) -> None:
    """2 m/s faster than what is ahead, for 5.9 s: 11.8 m of the gap go, 3.8 m are left, 1.9 s, or 2.8 m, 1.4 s.

    Places along a path are looked at every half a metre: a gap is told too small by as much at most.
    """
    leader = _at("a", 20.0 + gap + 4.5, 8.0, kind=kind, size=CAR)
    seen = judged(leader, _at("gen_0", 20.0, 10.0))
    assert len([one for one in seen if one[1] is Quantity.TTC_LEADER]) == found


def test_every_leader_on_the_path_is_told() -> None:
    """At the end a at 8 m/s is 2.8 m ahead, 1.4 s; b at 4 m/s, which it has passed through, 2.1 m, .35 s.

    Before, when a is the nearer one on the lane, its TTC is 1.6 s and more.
    """
    seen = judged(_at("a", 39.1, 8.0), _at("b", 62.0, 4.0), _at("gen_0", 20.0, 10.0))
    assert {one[2] for one in seen if one[1] is Quantity.TTC_LEADER} == {"a", "b"}


def test_leader_in_the_lane_that_is_left_counts_until_it_is_left() -> None:
    """A car at 10 m/s moves out at 1 m/s behind one that stands 30 m ahead.

    Boxes overlap across the lane until it is 1.9 m aside, at 1.9 s; by then the gap is 30 - 4.5 - 19 = 6.5 m: 0.65 s.
    From 45 m the gap is 21.5 m then: 2.15 s.
    """
    leaves = _at("gen_0", 20.0, 10.0, aside=0.6, steps=STEPS)
    assert ("gen_0", Quantity.TTC_LEADER, "a") in judged(_at("a", 50.0, 0.0), leaves)
    assert ("gen_0", Quantity.TTC_LEADER, "a") not in judged(_at("a", 85.0, 0.0), leaves)


def test_leader_that_rolls_back_is_met_as_if_it_stood() -> None:
    """10 m/s towards a car 50 m ahead that comes back at 0.5 m/s all the time, for 3.9 s: 4.5 m of the gap are left."""
    seen = judged(_at("a", 50.0, -0.5, heading=0.0, steps=40), _at("gen_0", 0.0, 10.0, steps=40))
    assert ("gen_0", Quantity.TTC_LEADER, "a") in seen


@pytest.mark.parametrize("kind", ["vehicle", "motorcyclist", "cyclist"])
@pytest.mark.parametrize(("ahead", "found"), [(45.7, 1), (70.0, 0)])
def test_recorded_follower_that_will_not_brake(ahead: float, found: int, kind: str) -> None:
    """One of a car's length at 10 m/s comes up behind one at 2 m/s, for 3.9 s: 45.7 - 4.5 - 31.2 = 10 m, 1.25 s."""
    follows = _at("a", 0.0, 10.0, steps=40, kind=kind)
    seen = judged(follows, _at("gen_0", ahead, 2.0, steps=40))
    assert seen.count(("gen_0", Quantity.TTC_FOLLOWER, "a")) == found
    assert judged(follows, _at("b", ahead, 2.0, steps=40)) == []  # recorded ones among themselves


@pytest.mark.parametrize(("ahead", "found"), [(24.0, ["end_contact", "end_ttc"]), (30.0, ["end_contact"]), (90.0, [])])
def test_oncoming_vehicle_after_the_last_step(ahead: float, found: list[str]) -> None:
    """Both at 10 m/s, 4.5 m long: (24 - 4.5) m / 20 m/s = 0.975 s, then 1.275 s, which braking does not avoid."""
    own = _at("gen_0", 20.0, 10.0)
    comes = _at("a", own.position[-1, 0] + ahead + 59.0, -10.0)
    assert sorted(one[1].value for one in judged(comes, own) if one[1].startswith("end")) == found


def test_contact_after_the_end_that_braking_avoids_is_no_finding() -> None:
    """10 m/s towards something that stands across the lane: in 3 s 10 + 20 - 3 * 2^2 / 2 = 24 m are driven.

    From centre to centre 2.25 m + 0.95 m more: 27.2 m.
    """
    own = _at("gen_0", 20.0, 10.0)
    for ahead, found in ((27.5, 0), (26.9, 1)):
        stands = _at("a", own.position[-1, 0] + ahead, 0.0, heading=np.pi / 2)
        assert [one[1] for one in judged(stands, own)].count(Quantity.END_CONTACT) == found


@pytest.mark.parametrize("degrees", [0.0, 90.0, 200.0])
def test_vehicle_that_comes_from_behind_after_the_end_brakes_itself(degrees: float) -> None:
    """10 m behind a car of 4.5 m at 10 m/s comes one at 14 m/s: 5.5 m / 4 m/s = 1.375 s, whichever way they head."""
    forward = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    here = Traffic(
        ("own", "behind"), np.array([[0.0 * forward], [-10.0 * forward]]), np.full((2, 1), np.radians(degrees)),
        np.array([[10.0 * forward], [14.0 * forward]]), np.ones((2, 1), dtype=np.bool_), np.full(2, 4.5),
        np.full(2, 1.9),
    )  # fmt: skip
    assert list(contacts_at_end(here, Bounds(), step_s=0.1)) == []


def test_headway_counts_above_three_metres_a_second() -> None:
    """1 m behind a car, of whose length .2 s of the way count: (1 + .8) m / 4 m/s = .45 s for 1 s; at 3 m/s none."""
    gap_m = np.full(12, 1.0)
    assert sustained_headway(gap_m, 4.5, np.full(12, 4.0), 0.1) == (pytest.approx(0.45), 9)
    assert sustained_headway(gap_m, 4.5, np.full(12, 3.0), 0.1)[0] == np.inf


@pytest.mark.parametrize(("follower", "leader"), [("a", "gen_0"), ("gen_0", "a"), ("gen_0", "gen_1")])
@pytest.mark.parametrize(("gap", "found"), [(3.0, 1), (6.0, 0)])
def test_headway_of_a_follower(follower: str, leader: str, gap: float, found: int) -> None:
    """At 10 m/s, front to front 4.5 m + 3 m is 0.75 s, 4.5 m + 6 m is 1.05 s; 0.8 s is the limit."""
    noted = judged(*sorted([_at(follower, 20.0, 10.0), _at(leader, 24.5 + gap, 10.0)], key=lambda one: one.track_id))
    assert noted == [("gen_0", Quantity.FOLLOWER_HEADWAY, leader if follower == "gen_0" else follower)] * found


@pytest.mark.parametrize(("gap", "found"), [(40.0, 1), (60.0, 0)])
def test_recorded_follower_that_would_have_to_brake_and_does_not(gap: float, found: int) -> None:
    """15 m/s behind 5 m/s for 1.9 s: 10^2 / (2 * 21) = 2.4 m/s2 would do at the end; of 60 m 10^2 / (2 * 41) = 1.2."""
    noted = judged(_at("a", 20.0, 15.0, steps=20), _at("gen_0", 24.5 + gap, 5.0, steps=20))
    assert noted == [("gen_0", Quantity.FOLLOWER_BRAKING, "a")] * found


def test_follower_that_kept_as_little_in_the_recording_is_exempt() -> None:
    """For 3 s it follows a recorded one at 0.7 s, which turns off; then an inserted one at 0.75 s."""
    recorded = _at("b", 27.0, 10.0, steps=30)
    later = _at("gen_0", 27.5 + 30.0, 10.0, steps=30, first=30)
    assert judged(_at("a", 20.0, 10.0), recorded, later) == []
