"""The objective of an event: what the judge sees of it in states, and how far that is from the middle."""

from dataclasses import replace

import numpy as np
import pytest
from hand_drawn import draw_road
from inserted import recorded, scene_on

from hid2.agents import BoxSize, Track
from hid2.insertion.event_objective import Objective
from hid2.insertion.event_targets import target_of
from hid2.insertion.finalise import as_written
from hid2.params import Event

ROAD = draw_road(lanes=2, length_m=400.0)


def _objective(*others: Track, **asked: object) -> Objective:
    """Of a target at 8 m/s from 100 m on lane 1, which is 4.5 m long."""
    scene = scene_on(ROAD, recorded(100.0, 0.0, 8.0), *others)
    target = target_of(scene, 0)
    assert target is not None
    return Objective(scene, Event.model_validate({"kind": "lead", "target": "r", **asked}), target, scene.states)


def test_a_leader_is_seen_at_the_step_nearest_to_the_middle_of_what_is_asked() -> None:
    """At 6 m/s from 118.5 m the gap is 14 m at first, and 2 m/s less: 10 m, the middle of 8 to 12, at 2 s."""
    objective = _objective(at_s=(1.0, 3.0), gap_m=(8.0, 12.0), speed_difference_mps=(-3.0, -1.0))
    seen = objective.seen(recorded(118.5, 0.0, 6.0, name="e"))
    assert seen is not None
    assert (seen.at_step, seen.order) == (20, 1)
    assert seen.measures.gap_m == pytest.approx(10.0)
    assert seen.measures.speed_difference_mps == pytest.approx(-2.0)
    assert objective.cost(seen) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("x", "y", "is_seen"), [(109.0, 0.0, False), (109.0, 3.5, True), (130.0, 0.0, True)])
def test_a_leader_is_the_next_vehicle_ahead(x: float, y: float, is_seen: bool) -> None:
    """14 m ahead of the target: with another one between no leader, with one beside, or farther ahead, it is one."""
    objective = _objective(recorded(x, y, 8.0, name="b"), at_s=(3.0, 3.0), gap_m=(10.0, 18.0))
    assert (objective.seen(recorded(118.5, 0.0, 8.0, name="e")) is not None) is is_seen


def test_gap_is_that_to_the_box_that_the_target_has() -> None:
    """18.5 m from centre to centre, 2.25 m and 2 m of them boxes; what keeps clear of the target takes it for 4.5 m."""
    scene = scene_on(ROAD, recorded(100.0, 0.0, 8.0, size=BoxSize(4.0, 1.8)))
    target = target_of(scene, 0)
    assert target is not None
    event = Event.model_validate({"kind": "lead", "target": "r", "at_s": (3.0, 3.0), "gap_m": (10.0, 18.0)})
    seen = Objective(scene, event, target, as_written(scene, [])).seen(recorded(118.5, 0.0, 8.0, name="e"))
    assert seen is not None
    assert seen.measures.gap_m == pytest.approx(14.25)


@pytest.mark.parametrize(("gap_m", "cost"), [((10.0, 18.0), 0.0), ((12.0, 20.0), 0.5), ((14.0, 22.0), 1.0)])
def test_cost_is_the_distance_from_the_middle_over_half_of_the_band(gap_m: tuple[float, float], cost: float) -> None:
    """A gap of 14 m at the target's speed: in the middle of 10 to 18, half way to the end of 12 to 20."""
    objective = _objective(at_s=(3.0, 3.0), gap_m=(0.0, 28.0))
    seen = objective.seen(recorded(118.5, 0.0, 8.0, name="e"))
    assert seen is not None
    asked = replace(objective, event=objective.event.model_copy(update={"gap_m": gap_m}))
    assert asked.cost(seen) == pytest.approx(cost, abs=1e-6)


@pytest.mark.parametrize("track", [
    recorded(118.5, 3.5, 8.0, name="e"), recorded(81.5, 0.0, 8.0, name="e"), recorded(160.0, 0.0, 8.0, name="e"),
    recorded(118.5, 0.0, 15.0, name="e"), recorded(118.5, 0.0, 8.0, first=109, name="e"),
], ids=["beside", "behind", "too far", "too fast", "too late, for a step"])  # fmt: skip
def test_what_does_not_lead_as_asked_is_not_seen(track: Track) -> None:
    assert _objective(at_s=(1.0, 2.0)).seen(track) is None


def test_a_leader_that_does_not_brake_as_asked_costs_more_than_one_that_does() -> None:
    """Asked 2 m/s2, within a fifth: braking with 2 m/s2 costs nothing, with 1.6 it is at the end of what counts."""
    objective = _objective(at_s=(2.0, 2.0), gap_m=(0.0, 28.0), speed_difference_mps=(-9.0, 9.0), brakes_mps2=2.0)
    seen = objective.seen(recorded(118.5, 0.0, 8.0, name="e"))
    assert seen is not None
    assert objective.cost(seen) > 1.0
    for braked_mps2, cost in ((2.0, 0.0), (1.6, 1.0), (2.4, 1.0)):
        asked = replace(seen, measures=replace(seen.measures, brakes_mps2=braked_mps2))
        assert objective.cost(asked) == pytest.approx(cost, abs=1e-6)
    for name, measure in (("ttc_s", "min_ttc_s"), ("pet_s", "pet_s"), ("drac_mps2", "drac_mps2")):
        event = objective.event.model_copy(update={"brakes_mps2": 0.0, name: (1.0, 3.0)})
        each = [replace(seen, measures=replace(seen.measures, **{measure: value})) for value in (2.0, 3.0)]
        assert [replace(objective, event=event).cost(one) for one in each] == pytest.approx([0.0, 1.0], abs=1e-6)


@pytest.mark.parametrize(("at_s", "step"), [((1.0, 4.0), 35), ((1.0, 9.0), 40)])
def test_a_leader_brakes_within_half_a_second_from_the_moment_on(at_s: tuple[float, float], step: int) -> None:
    """It brakes from step 40 to 50; the middle of what is asked is step 25, too early, or 50, too late."""
    v = 8.0 - 2.4 * np.clip(0.1 * np.arange(110) - 4.0, 0.0, 1.0)
    track = replace(recorded(118.5, 0.0, 8.0, name="e"), velocity=np.column_stack([v, np.zeros(110)]))
    asked = _objective(at_s=at_s, gap_m=(0.0, 28.0), speed_difference_mps=(-9.0, 9.0), brakes_mps2=2.0)
    assert asked.likely_step(track) == step


def test_who_crosses_first_is_told() -> None:
    """The target is at x = 150 at 6.25 s; one along +y at 10 m/s from y = -40.5 is at y = 0 after 4 s, before it."""
    seen = _objective(kind="cross", at_s=(4.0, 4.0)).seen(recorded(150.0, -40.5, 10.0, heading=np.pi / 2, name="e"))
    assert seen is not None
    assert (seen.at_step, seen.order) == (40, 1)
    assert seen.measures.gap_m == pytest.approx(0.1 * 8.0 * 22 - 2.25, abs=0.9)
