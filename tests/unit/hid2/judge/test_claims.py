"""Claims: what is told of a vehicle is seen in its states at the time told, or it is a finding."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hand_drawn import draw_lane, draw_road

from hid2.agents import BoxSize, Track
from hid2.judge.claims import FIGURES, Claim, EventClaim, event_step, judge_claims, manoeuvres
from hid2.judge.events import crossing_steps
from hid2.judge.findings import Quantity
from hid2.measures.lane_matching import flatten_lanes
from hid2.measures.manoeuvres import ManeuverKind
from hid2.occupancy.agent_states import AgentStates, agent_states
from netconvert.lane_graph import LaneGraph

STEPS = 110
TIME = 0.1 * np.arange(STEPS)


def _drive(name: str, x: float, v: float, y: np.ndarray | float = 0.0, *, heading: float = 0.0) -> Track:
    """A car of 4.5 m x 1.9 m along x at v m/s, at y (T,) m, turned by a heading about the origin."""
    position = np.column_stack([x + v * TIME, np.broadcast_to(y, STEPS)])
    velocity = np.gradient(position, 0.1, axis=0)
    own = np.arctan2(velocity[:, 1], velocity[:, 0]) if v else np.zeros(STEPS)
    turn = np.array([[math.cos(heading), -math.sin(heading)], [math.sin(heading), math.cos(heading)]])
    return Track(
        name, "vehicle", 1, np.arange(STEPS), position @ turn.T, own + heading, velocity @ turn.T, BoxSize(4.5, 1.9)
    )


def _across(at_s: float, *, start: float = 0.0, to: float = 3.5, lasting_s: float = 4.0) -> np.ndarray:
    """Lateral place (T,) m: from one lane to another, half way at a time."""
    share = np.clip((TIME - at_s) / lasting_s + 0.5, 0.0, 1.0)
    return start + (to - start) * (3 * share**2 - 2 * share**3)


def states(*tracks: Track) -> AgentStates:
    """Two lanes of 200 m at y = 0 (lane 1) and y = 3.5 (lane 2)."""
    return agent_states(tracks, flatten_lanes(draw_road()), num_steps=STEPS, step_s=0.1)


@pytest.mark.parametrize(("at_s", "found"), [(5.0, 0), (5.4, 0), (5.6, 1), (2.0, 1)])
def test_lane_change_is_claimed_at_its_crossing(at_s: float, found: int) -> None:
    """The centre is between the lanes, at y = 1.75, after 5 s; half a second is allowed."""
    scene = states(_drive("gen_0", 20.0, 10.0, _across(5.0)))
    seen = judge_claims(scene, [Claim("gen_0", ManeuverKind.LANE_CHANGE, at_s)], [])
    assert len(seen) == found
    assert all(one.value == pytest.approx(abs(at_s - 5.0), abs=0.02) for one in seen)


def test_manoeuvre_of_another_kind_or_of_none_and_event_with_a_track_that_is_not_there_are_not_seen() -> None:
    scene = states(_drive("gen_0", 20.0, 10.0))
    (one,) = judge_claims(scene, [Claim("gen_0", ManeuverKind.LANE_CHANGE, 5.0)], [])
    assert (one.track_id, one.step, one.value, one.limit) == ("gen_0", 50, math.inf, 0.5)
    (found,) = judge_claims(scene, [], [EventClaim("lead", "gen_0", "t", 4.0, ahead=True)])
    assert found.value == math.inf


def test_manoeuvres_are_those_of_inserted_vehicles() -> None:
    changing = _across(5.0)
    scene = states(_drive("a", 120.0, 10.0, changing), _drive("gen_0", 20.0, 10.0, changing))
    assert [one.track_id for one in manoeuvres(scene)] == ["gen_0"]


def _cut_in(target_y: np.ndarray | float, own_y: np.ndarray | float, *, ahead_m: float = 15.0):
    return (
        _drive("t", 20.0, 10.0, target_y),
        _drive("gen_0", 20.0 + ahead_m, 10.0, own_y),
        EventClaim("cut_in", "gen_0", "t", 5.0, ahead=True),
    )


def test_cut_in_comes_from_beside_into_the_lane_of_the_target_ahead_of_it() -> None:
    target, own, claim = _cut_in(0.0, _across(5.0, start=3.5, to=0.0))
    assert event_step(states(target, own), claim) == pytest.approx(50, abs=1)
    assert judge_claims(states(target, own), [], [claim]) == []
    assert event_step(states(target, own), claim._replace(ahead=False)) is None
    behind = _cut_in(0.0, _across(5.0, start=3.5, to=0.0), ahead_m=-15.0)
    for target, own, claim in (behind, _cut_in(0.0, _across(5.0))):  # or out of its lane
        assert event_step(states(target, own), claim) is None


def test_figures_that_are_told_are_those_of_the_states() -> None:
    """15 m between centres at 10 m/s along the road: the gap that is told is off by 2 m, and there is no TTC.

    Where all are told as not there, the five that there are are wrong.
    """
    target, own, claim = _cut_in(0.0, _across(5.0, start=3.5, to=0.0))
    scene, gap_m = states(target, own), 15.0 - own.size.length_m
    across_mps = float(np.hypot(10.0, np.gradient(own.position[:, 1], 0.1)[50])) - 10.0
    speed = np.hypot(10.0, np.gradient(own.position[:, 1], 0.1))
    told = {
        "gap_m": gap_m, "speed_difference_mps": across_mps, "min_ttc_s": None, "ttc_at_s": None, "headway_s": 1.5,
        "brakes_mps2": float(-np.gradient(speed[50:81], 0.1).min()), "pet_s": None, "drac_mps2": 0.0,
    }  # fmt: skip
    assert told.keys() == FIGURES.keys()
    assert judge_claims(scene, [], [claim._replace(figures=told)]) == []
    silent = judge_claims(scene, [], [claim._replace(figures=dict.fromkeys(told))])
    assert [one.quantity for one in silent] == [FIGURES[name] for name, value in told.items() if value is not None]
    wrong = claim._replace(figures=told | {"gap_m": gap_m - 2.0, "min_ttc_s": 1.6})
    gap, ttc = judge_claims(scene, [], [wrong])
    assert (gap.quantity, gap.value, gap.step) == (Quantity.CLAIMED_GAP, pytest.approx(2.0, abs=0.05), 50)
    assert (ttc.quantity, ttc.value, ttc.other) == (Quantity.CLAIMED_TTC, math.inf, "t")


def test_vehicle_that_is_in_the_lane_all_the_time_cuts_into_nothing() -> None:
    """The target comes into the vehicle's lane; or the vehicle changes to a lane that the target comes to later."""
    for target_y, own_y in ((_across(5.0, start=3.5, to=0.0), 0.0), (_across(8.0), _across(3.0))):
        target, own, claim = _cut_in(target_y, own_y)
        (found,) = judge_claims(states(target, own), [], [claim])
        assert (found.track_id, found.other, found.value) == ("gen_0", "t", math.inf)


def test_change_of_lanes_far_ahead_of_the_target_is_no_cut_in() -> None:
    """At 10 m/s 1.8 s are 18 m: 22 m between centres leave 17.5 m, 23 m leave 18.5 m.

    Behind a vehicle at 4 m/s along the road 4.7 s are 28 m: 60 and 64 m ahead at first leave 25.5 and 29.5 m at 5 s.
    A target that is stated to stand drives all the same.
    """
    for ahead_m, is_seen in ((22.0, True), (23.0, False)):
        target, own, claim = _cut_in(0.0, _across(5.0, start=3.5, to=0.0), ahead_m=ahead_m)
        target = replace(target, velocity=0.0 * target.velocity)
        assert (event_step(states(target, own), claim) is not None) is is_seen
    for begins_m, is_seen in ((60.0, True), (64.0, False)):
        slow = _drive("gen_0", 20.0 + begins_m, 4.0, _across(5.0, start=3.5, to=0.0))
        assert (event_step(states(_drive("t", 20.0, 10.0), slow), claim) is not None) is is_seen


def test_target_that_changes_itself_is_cut_in_where_it_is_at_that_moment() -> None:
    """The vehicle comes in at 3 s, 15 m ahead. A target that leaves that lane at 8 s was there, one at 4 s was not."""
    target, own, claim = _cut_in(_across(8.0), _across(3.0, start=3.5, to=0.0))
    assert event_step(states(target, own), claim) == pytest.approx(30, abs=1)
    target, own, claim = _cut_in(_across(4.0), _across(3.0, start=3.5, to=0.0))
    assert event_step(states(target, own), claim) is None


def test_overtake_is_seen_from_its_way_back() -> None:
    """At 16 m/s past one at 4 m/s: out at 2 s, level after 30 / 12 = 2.5 s, back at 7 s."""
    y = _across(2.0, lasting_s=3.0) + _across(7.0, to=-3.5, lasting_s=3.0)
    slow, own = _drive("t", 50.0, 4.0), _drive("gen_0", 20.0, 16.0, y)
    claim = EventClaim("overtake", "gen_0", "t", 7.0, ahead=True)
    assert event_step(states(slow, own), claim) == pytest.approx(70, abs=1)
    passes = _drive("gen_0", 20.0, 16.0, _across(2.0, lasting_s=3.0))
    assert event_step(states(slow, passes), claim) is None


@pytest.mark.parametrize(("kind", "ahead"), [("lead", True), ("follow", False)])
def test_lead_and_follow_are_seen_on_the_path_that_the_rear_one_drives(kind: str, ahead: bool) -> None:
    claim = EventClaim(kind, "gen_0", "t", 4.0, ahead=ahead)
    x = 40.0 if ahead else 5.0
    target = _drive("t", 20.0, 10.0)
    assert event_step(states(target, _drive("gen_0", x, 10.0)), claim) == 40
    other = claim._replace(kind="follow" if ahead else "lead")
    assert event_step(states(target, _drive("gen_0", x, 10.0)), other) is None
    assert event_step(states(target, _drive("gen_0", x, 10.0, 3.5)), claim) is None
    assert event_step(states(target, _drive("gen_0", 45.0 - x, 10.0)), claim) is None


def test_crossing_is_seen_in_the_order_that_is_claimed() -> None:
    """From the south, 20 m before the crossing at 10 m/s: there at step 20. From the west, 40 m before: at step 40."""
    south = replace(_drive("gen_0", -20.0, 10.0, heading=math.pi / 2), track_id="gen_0")
    south = replace(south, position=south.position + np.array([60.0, 0.0]))
    target = _drive("t", 20.0, 10.0)
    scene = states(target, south)
    assert crossing_steps(scene, 1, 0) == (pytest.approx(20, abs=1), pytest.approx(40, abs=1))
    assert event_step(scene, EventClaim("cross", "gen_0", "t", 2.0, ahead=True)) == pytest.approx(20, abs=1)
    assert event_step(scene, EventClaim("cross", "gen_0", "t", 2.0, ahead=False)) is None


def test_paths_that_cut_each_other_where_they_join_are_a_merge() -> None:
    """Lanes 1 from the west and 2 from the south lead to 3. The vehicle comes to y = .5 m, then drives on along it.

    It is at the beginning of lane 3 at 4 s, the target at 8 s.
    """
    graph = [
        draw_lane(1, [(0.0, 0.0), (100.0, 0.0)], successors=(3,)),
        draw_lane(2, [(100.0, -60.0), (100.0, 0.0)], successors=(3,)),
        draw_lane(3, [(100.0, 0.0), (300.0, 0.0)]),
    ]  # fmt: skip
    way = 10.0 * TIME - 40.0
    xy = np.column_stack([100.0 + np.maximum(way - 0.5, 0.0), np.minimum(way, 0.5)])
    own = replace(_drive("gen_0", 0.0, 10.0), position=xy, heading=np.where(way < 0.5, np.pi / 2, 0.0))
    lanes = flatten_lanes(LaneGraph({one.lane_id: one for one in graph}))
    scene = agent_states([_drive("t", 20.0, 10.0), own], lanes, num_steps=STEPS, step_s=0.1)
    assert crossing_steps(scene, 1, 0) == (pytest.approx(40, abs=1), pytest.approx(80, abs=1))
    assert event_step(scene, EventClaim("cross", "gen_0", "t", 4.0, ahead=True)) is None
    merge = EventClaim("merge", "gen_0", "t", 4.0, ahead=True)
    assert event_step(scene, merge) == pytest.approx(40, abs=2)
    assert judge_claims(scene, [], [merge]) == []
    assert [one.value for one in judge_claims(scene, [], [merge._replace(ahead=False)])] == [math.inf]


@pytest.mark.parametrize("lacks", ["t", "gen_0"])
def test_event_in_a_gap_of_a_track_is_not_seen(lacks: str) -> None:
    """Without states from 3.5 to 4.5 s there is none to measure at 4 s, though its place is interpolated."""
    seen = np.abs(TIME - 4.0) > 0.55
    every = [_drive("t", 20.0, 10.0), _drive("gen_0", 40.0, 10.0)]
    broken = [
        replace(
            one, timesteps=one.timesteps[seen], position=one.position[seen], heading=one.heading[seen],
            velocity=one.velocity[seen],
        ) if one.track_id == lacks else one
        for one in every
    ]  # fmt: skip
    claim = EventClaim("lead", "gen_0", "t", 4.0, ahead=True)
    assert event_step(states(*every), claim) == 40
    (found,) = judge_claims(states(*broken), [], [claim])
    assert found.value == math.inf
