"""Candidates for events: rolled out on a road, and as the judge finds them in their rollouts."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hand_drawn import draw_road
from inserted import CAR, recorded, scene_on

from hid2.agents import Policy, Track
from hid2.conflicts.guard import Guard
from hid2.drivers.driver import draw_driver
from hid2.insertion.event_objective import Objective
from hid2.insertion.event_places import Places
from hid2.insertion.event_starts import EventStarts, track_of
from hid2.insertion.event_targets import target_of
from hid2.insertion.events import scene_for
from hid2.insertion.starts import Site
from hid2.insertion.surroundings import Surroundings
from hid2.occupancy.traffic import traffic_of
from hid2.params import Config, Drivers, Event, LaneChange
from hid2.reasons import Reason
from hid2.scene import Scene
from hid2.vehicle import VehicleRequest


def scene_of(*tracks: Track, **drivers: float) -> Scene:
    """Two lanes of 400 m: lane 1 at y = 0, lane 2 at y = 3.5 m."""
    return scene_on(draw_road(lanes=2, length_m=400.0), *tracks, config=Config(drivers=Drivers(**drivers)))


def _starts(scene: Scene, *kept: Track, **asked: object) -> EventStarts:
    event = Event.model_validate({"kind": "lead", "target": "r", "at_s": (4.0, 4.0), **asked})
    here, scene = Surroundings(scene), scene_for(scene, event)
    target = target_of(scene, 0)
    assert target is not None
    policy = {"cut_in": Policy.LANE_CHANGE, "overtake": Policy.OVERTAKE}.get(event.kind, Policy.STRAIGHT)
    guard = Guard(scene, traffic_of(kept, scene.future.num_steps, step_s=0.1), here.stop_lines)
    return EventStarts(
        scene, here.roads, here.meetings, guard, np.random.default_rng(0), 0,
        objective=Objective(scene, event, target, scene.states), request=VehicleRequest(0, policy, 0.0, size=CAR),
        places=list(Places(here.routes, event, target, 4.5).all()),
    )  # fmt: skip


@pytest.mark.parametrize(("kind", "sign"), [("lead", 1.0), ("follow", -1.0)])
def test_candidates_have_the_gap_asked_for_in_their_rollouts(kind: str, sign: float) -> None:
    """A target at 8 m/s from 150 m: about 4 s they are 6 to 14 m away, bumper to bumper; the best come first."""
    found = _starts(scene_of(recorded(150.0, 0.0, 8.0)), kind=kind, gap_m=(6.0, 14.0)).draw(60)
    assert found
    for one in found:
        gaps = [
            sign * (float(track_of(one.rolled).position[step, 0]) - 150.0 - 0.8 * step) - 4.5 for step in range(35, 46)
        ]
        assert min(gaps) <= 14.0
        assert max(gaps) >= 6.0
        assert one.rolled.start.request.policy is Policy.STRAIGHT
    assert [one.cost for one in found] == sorted(one.cost for one in found)


def test_vehicle_of_an_event_before_that_alone_is_in_the_way_is_told() -> None:
    """5.5 m behind one that leaves at 20 m/s: at 8 m/s it was inside that 1.5 s ago, as inside a recorded one."""
    target, other = recorded(250.0, 0.0, 8.0), recorded(60.0, 0.0, 20.0, name="e")
    for starts, reason in (
        (_starts(scene_of(target), other), Reason.MEETS_GENERATED),
        (_starts(scene_of(target, other)), Reason.NO_SITE),
        (_starts(scene_of(target, other), other), Reason.NO_SITE),
    ):
        driver = draw_driver(starts.scene.config, starts.rng, lane_speed_mps=8.0)
        assert starts.make(starts.request, Site(starts.places[0].offer, 50.0), driver=driver) is reason


def test_a_narrow_band_is_come_to_from_the_nearest_that_is_found() -> None:
    """Behind a target at 10 m/s: of 119 in 150 that come about at random 2 have a TTC below 10 s, 8.5 and 9.2 s."""
    starts = _starts(scene_of(recorded(100.0, 0.0, 10.0)), kind="follow", ttc_s=(8.0, 8.6))
    starts.rng = np.random.default_rng(1)  # 12 of 150, and none where all are drawn at random
    assert sum(len(starts.draw(50)) for _ in range(3)) >= 6


def test_cut_ins_change_to_the_lane_of_the_target_and_are_told_when() -> None:
    """From lane 2 to the right; over the line, at y = 1.75 m, at 4 s more or less, and the trigger before that.

    The motion of two paths is one for the last word: one state a step, over the change of lanes, and no jump.
    """
    found = _starts(scene_of(recorded(100.0, 0.0, 8.0)), kind="cut_in").draw(60)
    assert found
    for one in found:
        y = track_of(one.rolled).position[:, 1]
        crossing_s = 0.1 * int(np.argmax(y < 1.75))
        assert one.rolled.start.sides == ("right",)
        assert 3.4 - 1e-9 <= crossing_s <= 4.6 + 1e-9
        assert 1.0 <= crossing_s - one.rolled.start.request.trigger_s <= 4.0
    driven = found[0].as_driven()
    assert len(driven.s) == len(driven.v) == 110
    assert np.diff(driven.s) == pytest.approx(0.1 * np.array(driven.v[1:]), abs=0.1)


def test_a_leader_that_is_to_brake_wishes_less_from_the_moment_on() -> None:
    """A target at 6 m/s, 2 m/s2 from about 4 s on: within a fifth in the rollout, and not before: it is steady."""
    scene = scene_of(recorded(100.0, 0.0, 6.0), wander_sd_mps=0.0)
    found = _starts(scene, brakes_mps2=2.0, gap_m=(4.0, 40.0), speed_difference_mps=(-6.0, 10.0)).draw(200)
    assert found
    for one in found:
        speed = np.hypot(*track_of(one.rolled).velocity.T)
        assert 1.6 <= -np.diff(speed).min() / 0.1 <= 2.4
        assert -np.diff(speed[:33]).min() / 0.1 < 1.5


@pytest.mark.parametrize(("kind", "left"), [("cut_in", False), ("lead", True)])
def test_no_candidate_changes_lanes_where_the_configured_rule_never_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, left: bool
) -> None:
    """By the paper's rule each kind has candidates beside a target at 5 m/s; those that change no lane are left."""
    (tmp_path / "refusing_rule.py").write_text("def never(view):\n    return False\n")
    monkeypatch.syspath_prepend(tmp_path)
    usual = scene_of(recorded(150.0, 0.0, 5.0))
    rule = LaneChange(rule="refusing_rule:never")
    starts = _starts(replace(usual, config=usual.config.model_copy(update={"lane_change": rule})), kind=kind)
    assert bool(starts.draw(30)) == left
    assert (starts.refusals[Reason.RULE_REFUSES] == 0) == left


def test_none_begins_where_others_stand_and_the_reason_is_counted() -> None:
    """Ahead of a target there are others all the way, 8 m apart: no box with 2 m to both sides fits between."""
    row = [recorded(60.0 + 8.0 * number, 0.0, 8.0, name=f"o{number}") for number in range(42)]
    starts = _starts(scene_of(recorded(52.0, 0.0, 8.0), *row))
    assert starts.draw(30) == []
    assert (starts.rolls, starts.refusals) == (0, Counter({Reason.NO_SITE: 20}))
