"""What became of a manoeuvre, by the exported motion."""

from dataclasses import replace

import numpy as np
import pytest
from hand_drawn import draw_lane, draw_road, graph_of
from inserted import changing, driven, scene_on, start_on

from hid2.agents import Policy
from hid2.insertion.finalise import ExportedVehicle, finalise, traffic_of_exported
from hid2.insertion.outcome import Outcome, gaps_at_request, outcome_of, takes_gap
from hid2.params import Config, LaneChange
from hid2.reasons import Reason
from hid2.scene import Scene
from hid2.vehicle import DrivenVehicle


@pytest.fixture
def scene() -> Scene:
    return scene_on(draw_road(length_m=400.0))


def _exported(scene: Scene, vehicle: DrivenVehicle) -> ExportedVehicle:
    found = finalise(scene, vehicle, [])
    assert isinstance(found, ExportedVehicle), found
    return found


def _outcome(scene: Scene, vehicle: DrivenVehicle) -> Outcome:
    one = _exported(scene, vehicle)
    found = outcome_of(scene, one, [])
    assert found is not None
    return found


def test_who_goes_straight_has_no_outcome(scene: Scene) -> None:
    one = _exported(scene, driven(start_on(scene, (1,), 40.0, 10.0), np.full(110, 10.0)))
    assert outcome_of(scene, one, []) is None


def test_lane_change_is_done_with_its_times(scene: Scene) -> None:
    """From step 20 on within 4 s at 10 m/s: the middle is crossed at 4 s.

    |d'| passes 0.1 m/s of at most 2 * 3.5 / 4 = 1.75: at tau^2 16 = .1 / 3.5 * 4, tau = .085, .34 s after the start;
    lateral speed is that of a parabola over 1.1 s, which shows the motion up to .5 s before.
    """
    start = start_on(scene, (1,), 40.0, 10.0, policy=Policy.LANE_CHANGE, trigger_s=2.0)
    found = _outcome(scene, changing(scene, start, np.full(110, 10.0), to=2, at_step=20, wanted_s=4.0))
    assert (found.status, found.reason, found.done) == ("done", None, True)
    assert (found.start_s, found.crossing_s, found.end_s) == (
        pytest.approx(2.1, abs=0.21), pytest.approx(4.0, abs=0.05), pytest.approx(5.9, abs=0.21),
    )  # fmt: skip
    assert (found.source_lane, found.target_lane) == (1, 2)


@pytest.mark.parametrize(("rule", "behind_m"), [("paper", 6.5), ("paper", 35.0), ("MOBIL", 6.5), ("LC2013", 6.5)])
def test_gap_that_a_lane_change_takes_is_left_to_it(scene: Scene, rule: str, behind_m: float) -> None:
    """All at 10 m/s, boxes 4.5 m long: 2 m from bumper to bumper are less than two rules ask for; SUMO alone says."""
    scene = replace(scene, config=Config(lane_change=LaneChange(rule=rule)))
    start = start_on(scene, (1,), 40.0, 10.0, policy=Policy.LANE_CHANGE, trigger_s=2.0)
    kept = _exported(scene, changing(scene, start, np.full(110, 10.0), to=2, at_step=20, wanted_s=4.0))
    later = _exported(scene, driven(start_on(scene, (2,), 40.0 - behind_m, 10.0, number=1), np.full(110, 10.0)))
    inserted = traffic_of_exported([later], scene)
    assert takes_gap(scene, kept, inserted) is (behind_m < 10.0 and rule != "LC2013")
    front, rear = gaps_at_request(scene, kept, kept.driven.shifts[0], inserted)
    assert np.isinf(front.distance_m)
    assert rear.distance_m == pytest.approx(behind_m - 4.5, abs=0.6)


def test_lane_change_starts_with_its_decision_at_the_earliest(scene: Scene) -> None:
    """Decided at 3 s, as SUMO tells, of a motion aside that the states show from about 2.3 s on."""
    start = start_on(scene, (1,), 40.0, 10.0, policy=Policy.LANE_CHANGE, trigger_s=2.0)
    vehicle = changing(scene, start, np.full(110, 10.0), to=2, at_step=20, wanted_s=4.0)
    vehicle.shifts[0] = replace(vehicle.shifts[0], requested_step=30)
    assert _outcome(scene, vehicle).start_s == 3.0


def test_lane_change_that_the_scene_cuts_off_is_aborted(scene: Scene) -> None:
    """Begun at 7.2 s at 10 m/s and slowed to 4: after 10.9 s it is still on its way across."""
    start = start_on(scene, (1,), 40.0, 10.0, policy=Policy.LANE_CHANGE, trigger_s=7.2)
    v = np.where(np.arange(110) < 72, 10.0, np.clip(10.0 - 0.2 * (np.arange(110) - 72), 4.0, None))
    found = _outcome(scene, changing(scene, start, v, to=2, at_step=72, wanted_s=2.5))
    assert (found.status, found.reason, found.end_s) == ("aborted", Reason.SCENE_ENDED, None)


@pytest.mark.parametrize(
    ("trigger_s", "step", "told", "status", "reason"),
    [
        (2.0, 0, Reason.SUMO_REFUSES, "not_feasible", Reason.SUMO_REFUSES),
        (11.0, 0, None, "not_triggered", Reason.SCENE_ENDED),  # behind the end of the track
        (8.0, 40, Reason.FRONT_GAP, "not_feasible", Reason.FRONT_GAP),  # there from 4 to 10.9 s
    ],
)
def test_lane_change_that_never_began_names_the_last_answer_or_was_not_triggered(
    scene: Scene, trigger_s: float, step: int, told: Reason | None, status: str, reason: Reason
) -> None:
    """Trigger times count from the scene's begin, also of a vehicle that enters late."""
    start = start_on(scene, (1,), 40.0, 10.0, policy=Policy.LANE_CHANGE, trigger_s=trigger_s, step=step)
    found = _outcome(scene, driven(start, np.full(110 - step, 10.0), reason=told))
    assert (found.status, found.reason, found.start_s) == (status, reason, None)


def bend(degrees: float) -> Scene:
    """60 m straight, a left turn of a radius of 20 m by so much in an intersection, 200 m on."""
    angle = np.linspace(0.0, np.radians(degrees), 30)
    arc = np.array([60.0, 0.0]) + 20.0 * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
    ahead = np.array([np.cos(angle[-1]), np.sin(angle[-1])])
    on = arc[-1] + np.linspace(0.0, 200.0, 50)[:, None] * ahead
    lanes = (
        draw_lane(1, [(0.0, 0.0), (60.0, 0.0)], successors=(2,)),
        draw_lane(2, arc, successors=(3,), is_intersection=True), draw_lane(3, on),
    )  # fmt: skip
    return scene_on(graph_of(*lanes, ground=[(-50.0, -50.0), (350.0, -50.0), (350.0, 350.0), (-50.0, 350.0)]))


def test_turn_is_done_once_its_lane_is_behind() -> None:
    """From 30 m at 6 m/s: the entrance (60 m) after 5 s, the arc of 31.4 m left after 10.2 s."""
    scene = bend(90.0)
    start = start_on(scene, (1, 2, 3), 30.0, 6.0, policy=Policy.LEFT_TURN)
    found = _outcome(scene, driven(start, np.full(110, 6.0)))
    assert (found.status, found.reason) == ("done", None)
    assert (found.start_s, found.end_s) == (pytest.approx(5.0, abs=0.11), pytest.approx(10.2, abs=0.31))
    assert (found.source_lane, found.target_lane) == (1, 2)


@pytest.mark.parametrize(
    ("degrees", "speed", "status", "reason"),
    [
        (90.0, 6.0, "aborted", Reason.SCENE_ENDED),  # 85.4 m at the end, in the middle of the arc (60 to 91.4 m)
        (90.0, 3.0, "not_feasible", Reason.SCENE_ENDED),  # not reached
        (25.0, 8.0, "not_feasible", Reason.TURN_NOT_SEEN),  # a bend of less than 30 degrees is no turn to be seen
    ],
)
def test_turn_that_is_not_done_has_a_reason(degrees: float, speed: float, status: str, reason: Reason) -> None:
    """From 20 m on."""
    scene = bend(degrees)
    start = start_on(scene, (1, 2, 3), 20.0, speed, policy=Policy.LEFT_TURN)
    found = _outcome(scene, driven(start, np.full(110, speed)))
    assert (found.status, found.reason, found.start_s is None) == (status, reason, status == "not_feasible")
