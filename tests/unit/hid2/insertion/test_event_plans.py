"""Plans, courses and paths of events: gap, speed and moment are those asked for, and nobody else is met."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from inserted import CAR, nobody, recorded, scene_on

from hid2.agents import Track
from hid2.conflicts.guard import Guard
from hid2.conflicts.stop_lines import StopLines
from hid2.insertion.event_courses import Courses
from hid2.insertion.event_paths import EventPaths
from hid2.insertion.event_plans import Plan, Planner
from hid2.insertion.event_targets import target_of
from hid2.insertion.routes import Routes
from hid2.params import Event, LaneChange
from hid2.policy.roads import Roads
from hid2.reasons import Reason
from hid2.scene import Scene
from netconvert.lane_graph import LaneGraph, LaneSegment

#: Half of both lengths: the target and the vehicle are 4.5 m long.
LENGTHS_M = 4.5


@pytest.fixture
def scene_of(road: Callable[..., LaneGraph]) -> Callable[..., Scene]:
    """scene_of(*recorded) -> two lanes of 400 m: lane 1 at y = 0, lane 2 at y = 3.5 m."""

    def make(*tracks: Track) -> Scene:
        return scene_on(road(lanes=2, length_m=400.0), *tracks)

    return make


def _planner(scene: Scene) -> Planner:
    guard = Guard(scene, nobody(scene.future.num_steps), StopLines(scene))
    return Planner(scene, Routes(scene), Roads(scene), CAR, CAR, guard)


def _plans(scene: Scene, planner: Planner | None = None, **asked: object) -> list[Plan]:
    target = target_of(scene, 0)
    assert target is not None
    event = Event.model_validate({"kind": "lead", "target": "r", "at_s": (4.0, 4.0), **asked})
    return (planner or _planner(scene)).plans(event, target)


@pytest.mark.parametrize(("kind", "order"), [("lead", 1), ("follow", -1)])
def test_plan_has_the_gap_asked_for_at_the_moment_asked_for(
    scene_of: Callable[..., Scene], kind: str, order: int
) -> None:
    """A target at 8 m/s from 150 m: at 4 s it is at 182 m, and whoever is 10 m away, bumper to bumper, at 14.5 m."""
    plan = _plans(scene_of(recorded(150.0, 0.0, 8.0)), kind=kind, gap_m=(9.5, 10.5))[0]
    assert (plan.at_step * 0.1, plan.order) == (pytest.approx(4.0, abs=0.3), order)
    apart = plan.way[plan.at_step] - (150.0 + 0.8 * plan.at_step)
    assert apart == pytest.approx(order * (10.0 + LENGTHS_M), abs=0.6)
    assert plan.speeds[plan.at_step] == pytest.approx(8.0, abs=1.01)


def test_cut_in_comes_from_the_lane_beside_half_its_duration_before_the_moment(scene_of: Callable[..., Scene]) -> None:
    """3.0 s at 9.6 m/s, where its heading is 9.5 degrees, so 3.6 s at 8 m/s: from 1.8 s before.

    The target is on lane 1, so from lane 2 to the right.
    """
    plan = _plans(scene_of(recorded(100.0, 0.0, 8.0)), kind="cut_in")[0]
    assert (plan.route, plan.side) == ((2,), "right")
    assert plan.trigger_s == pytest.approx(plan.at_step * 0.1 - 1.8)


def test_overtake_is_foreseen_of_the_target_alone_and_back_at_the_time_asked_for(
    scene_of: Callable[..., Scene],
) -> None:
    """The target is at 60 m with 4 m/s, another slow one 200 m ahead of it: from behind the target, out to the left."""
    scene = scene_of(recorded(60.0, 0.0, 4.0), recorded(260.0, 0.0, 4.0, name="other"))
    found = _plans(scene, kind="overtake", at_s=(6.0, 8.0))
    assert found
    for plan in found:
        assert (plan.route, plan.side) == ((1,), "left")
        assert plan.start_s < 60.0 - LENGTHS_M
        assert 5.5 <= plan.at_step * 0.1 <= 8.5
        assert plan.driver is not None
        assert 4.0 + 1.5 <= plan.driver.desired_mps <= 4.0 + 6.0
    assert not _plans(scene, kind="overtake", at_s=(2.0, 2.0))  # out and back alone take longer


@pytest.mark.parametrize(("kind", "left"), [("cut_in", False), ("overtake", False), ("lead", True)])
def test_no_plan_expects_a_change_of_lanes_that_the_configured_rule_never_begins(
    scene_of: Callable[..., Scene], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, left: bool
) -> None:
    """By the paper's rule each kind has plans beside a target at 5 m/s; those that change no lane are left."""
    (tmp_path / "refusing_rule.py").write_text("def never(view):\n    return False\n")
    monkeypatch.syspath_prepend(tmp_path)
    usual = scene_of(recorded(150.0, 0.0, 5.0))
    never = replace(
        usual, config=usual.config.model_copy(update={"lane_change": LaneChange(rule="refusing_rule:never")})
    )
    asked = {"kind": kind, "at_s": (4.0, 10.0), "speed_difference_mps": (-6.0, 6.0)}
    planner = _planner(never)
    assert _plans(usual, **asked)
    assert bool(_plans(never, planner, **asked)) == left
    assert (planner.turned_down[Reason.RULE_REFUSES] == 0) == left


def test_no_overtake_is_foreseen_beside_a_queue(scene_of: Callable[..., Scene]) -> None:
    """Cars stand on the lane beside all along, so that nobody comes past; the reason is counted."""
    queue = [recorded(20.0 + 8.0 * number, 3.5, 0.0, name=f"q{number}") for number in range(40)]
    scene = scene_of(recorded(60.0, 0.0, 4.0), *queue)
    planner = _planner(scene)
    assert not _plans(scene, planner, kind="overtake", at_s=(4.0, 10.0))
    assert planner.turned_down[Reason.NO_OVERTAKE_FORESEEN] > 0


def test_likeliest_plans_come_first(scene_of: Callable[..., Scene]) -> None:
    scores = [plan.score for plan in _plans(scene_of(recorded(100.0, 0.0, 8.0)))]
    assert len(scores) > 10
    assert scores == sorted(scores)


def test_no_plan_where_somebody_stands_on_the_way_and_the_reason_is_counted(scene_of: Callable[..., Scene]) -> None:
    """Ahead of a target by 10 m there are others all the way, 8 m apart, and they are as fast."""
    row = [recorded(60.0 + 8.0 * number, 0.0, 8.0, name=f"o{number}") for number in range(12)]
    scene = scene_of(recorded(52.0, 0.0, 8.0), *row)
    planner = _planner(scene)
    assert not _plans(scene, planner, gap_m=(9.5, 10.5))
    assert planner.turned_down[Reason.MEETS_RECORDED] > 0


def test_motions_tried_hold_the_bands_of_the_event(scene_of: Callable[..., Scene]) -> None:
    """Gaps of 6 to 12 m and differences of -1 to 1 m/s to a target at 8 m/s."""
    scene = scene_of(recorded(100.0, 0.0, 8.0))
    target = target_of(scene, 0)
    assert target is not None
    event = Event(kind="lead", target="r", at_s=(4.0, 4.0), gap_m=(6.0, 12.0), speed_difference_mps=(-1.0, 1.0))
    paths = EventPaths(scene, Routes(scene), Roads(scene), CAR, nobody(scene.future.num_steps))
    (course,) = Courses(paths, event, target, LENGTHS_M).all()
    assert np.all((course.wanted.gap_m >= 6.0) & (course.wanted.gap_m <= 12.0))
    assert np.all(np.abs(course.wanted.speed_mps - 8.0) <= 1.0 + 1e-9)
    assert course.wanted.gap_m[np.argmin(course.off)] == pytest.approx(9.0)


def test_routes_over_a_lane_come_from_the_edge_of_the_map(lane: Callable[..., LaneSegment]) -> None:
    """Lanes 1 and 2 lead to 3: both ways are known, first the one that the target came."""
    lanes = [
        lane(1, [(0.0, 0.0), (100.0, 0.0)], successors=(3,)), lane(2, [(0.0, 40.0), (100.0, 0.0)], successors=(3,)),
        lane(3, [(100.0, 0.0), (300.0, 0.0)]),
    ]  # fmt: skip
    scene = scene_on(LaneGraph({one.lane_id: one for one in lanes}), recorded(50.0, 0.0, 8.0))
    paths = EventPaths(scene, Routes(scene), Roads(scene), CAR, nobody(scene.future.num_steps))
    assert paths.over(3) == [(1, 3), (2, 3)]
    assert paths.over(3, before=(2,)) == [(2, 3), (1, 3)]
