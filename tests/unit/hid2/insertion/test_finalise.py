"""The last word on a driven vehicle: exported, or the reason why not."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hand_drawn import draw_lane, draw_road, graph_of
from inserted import CAR, changing, driven, recorded, scene_on, start_on

from hid2.agents import BoxSize, Track
from hid2.drivers.driver import LaneOffset
from hid2.insertion.finalise import ExportedVehicle, conflicting, finalise, traffic_of_exported
from hid2.judge.findings import allowed_to
from hid2.motion.route import DrivenPath
from hid2.params import Config, Request
from hid2.policy.observation import Foreseen, lay_across
from hid2.reasons import Reason
from hid2.scene import Scene
from hid2.vehicle import DrivenVehicle

T, TEN = 0.1 * np.arange(110), np.full(110, 10.0)


def scene_of(*tracks: Track, length_m: float = 300.0, config: Config | None = None) -> Scene:
    """Two lanes of 300 m, 6 m of asphalt beyond each side."""
    return scene_on(draw_road(length_m=length_m), *tracks, config=config)


def _aside(offset_m: float) -> LaneOffset:
    return LaneOffset(np.array([0.0, 1000.0]), np.full(2, offset_m), np.zeros(2))


def _alone(scene: Scene, v: Any, s: float = 40.0, **changes: Any) -> ExportedVehicle | Reason:
    start = start_on(scene, (1,), s, float(np.asarray(v)[0]), **changes)
    return finalise(scene, driven(start, v), [])


def _kept(scene: Scene, v: Any, s: float = 40.0, *, lane: int = 1, **changes: Any) -> ExportedVehicle:
    start = start_on(scene, (lane,), s, float(np.asarray(v)[0]), **changes)
    found = finalise(scene, driven(start, v), [])
    assert isinstance(found, ExportedVehicle), found
    return found


def test_vehicle_alone_is_exported_as_it_was_driven() -> None:
    """10 m/s for 10.9 s from x = 40 on."""
    found = _kept(scene_of(), TEN)
    track = found.track("gen_0", 1)
    assert track.timesteps.tolist() == list(range(110))
    assert track.position == pytest.approx(np.column_stack([40.0 + 10.0 * T, np.zeros(110)]), abs=1e-6)
    assert track.velocity == pytest.approx(np.column_stack([TEN, np.zeros(110)]), abs=1e-6)
    assert found.simulated_off_m == pytest.approx(np.zeros(110), abs=1e-9)
    assert found.min_ttc_s == np.inf


def test_track_ends_where_the_rear_of_the_map_is_not_left_behind() -> None:
    """150 m of lane, 10 m/s from 80: the box is whole on the map up to 150 - 2.25 = 147.75 m, after 6.7 s.

    Scored vehicles have to stay to the end.
    """
    found = _kept(scene_of(length_m=150.0), TEN, 80.0)
    assert found.num_steps == 68
    scene = scene_of(length_m=150.0, config=Config(request=Request(generated_category=2)))
    assert _alone(scene, TEN, 80.0) is Reason.LEAVES_TOO_EARLY


@pytest.mark.parametrize("mark", ["DASHED_WHITE", "SOLID_WHITE"])
def test_vehicle_that_crosses_a_solid_line_is_not_exported(mark: str) -> None:
    foreseen, scene = (scene_on(draw_road(length_m=300.0, mark=line)) for line in ("DASHED_WHITE", mark))
    start, v = start_on(foreseen, (1,), 40.0, 10.0), TEN
    found = finalise(scene, changing(foreseen, start, v, to=2, at_step=20, wanted_s=4.0), [])
    assert (found is Reason.SOLID_LINE) is (mark == "SOLID_WHITE")


def _stands_at_the_end(x: float) -> Track:
    """Across the lane at the last two steps."""
    steps = np.array([108, 109])
    return Track("r", "vehicle", 2, steps, np.tile([x, 0.0], (2, 1)), np.full(2, np.pi / 2), np.zeros((2, 2)), CAR)


#: Of a vehicle from x = 40 m on at 10 m/s: what it meets or does, and the reason that is named. It ends at 149 m.
FINDINGS = {
    "4 m/s2 for 2 s": (None, 10.0 + np.clip(4.0 * (T - 3.0), 0.0, 8.0), Reason.LIMIT_ACCEL),
    "-7 m/s2 for 2 s": (None, 16.0 - np.clip(7.0 * (T - 3.0), 0.0, 14.0), Reason.LIMIT_DECEL),
    "stands": (None, np.zeros(110), Reason.STANDS_THROUGHOUT),
    # A leader at 62 m drives 4 m/s; it slows to that late, at 3 m/s2 from 1.5 s on. Then the gap is 17.5 - 6 * 1.5 =
    # 8.5 m and closes at 6 m/s: 1.4 s, and it begins to brake only then.
    "critical TTC": (recorded(62.0, 0.0, 4.0), np.clip(10.0 - 3.0 * np.clip(T - 1.5, 0.0, None), 4.0, None),
                     Reason.TTC_LANE_LEADER),
    # It leaves x = 90.95 after 5.3 s; what crosses is there 0.1 s after 5.8, 6.1, 6.6 s (y = -0.95); 1 s is critical.
    "PET of 0.6 s": (recorded(90.0, -62.0, 10.0, heading=np.pi / 2), TEN, Reason.PET),
    "PET of 0.9 s": (recorded(90.0, -65.0, 10.0, heading=np.pi / 2), TEN, Reason.PET),
    "PET of 1.4 s": (recorded(90.0, -70.0, 10.0, heading=np.pi / 2), TEN, None),
    # Half a length and half a width more, 2 or 3 s ahead: its driver brakes with 2 m/s2, over 25 m.
    "20 m after the end": (_stands_at_the_end(149.0 + 20.0 + 3.2), TEN, Reason.TTC_AT_END),
    "30 m after the end": (_stands_at_the_end(149.0 + 30.0 + 3.2), TEN, None),
    # A leader ends 30 m of gap ahead, at 10 m/s by its positions; -25 m/s are stated: 30 m close at 35 m/s, 0.86 s.
    # Trackers' velocities are not the differences of their positions, and readers of the file know no others.
    "leader at 10 m/s": (recorded(74.5, 0.0, 10.0), TEN, None),
    "leader stated to come back": (replace(recorded(74.5, 0.0, 10.0), velocity=np.tile([-25.0, 0.0], (110, 1))), TEN,
                                   Reason.TTC_AT_END),
}  # fmt: skip


@pytest.mark.parametrize("name", FINDINGS)
def test_first_finding_of_the_judge_is_the_reason(name: str) -> None:
    other, v, reason = FINDINGS[name]
    found = _alone(scene_of(*([] if other is None else [other])), v)
    assert found is reason or (reason is None and isinstance(found, ExportedVehicle))


def test_jerk_that_a_wider_filter_takes_out_is_exported_without_it() -> None:
    """1.5 sin(2.5 t) m/s: a jerk of 9.4 m/s3, 4.13 are allowed; the speed is smoothed until it is, and no other one."""
    mild = 10.0 + 0.5 * np.sin(1.5 * T)
    assert _kept(scene_of(), mild).motion.v[10:-10] == pytest.approx(mild[10:-10], abs=0.05)
    found = _kept(scene_of(), 10.0 + 1.5 * np.sin(2.5 * T))
    assert np.abs(np.gradient(found.motion.a, 0.1)).max() <= 4.13 + 0.05


def test_footprint_beside_the_road_is_off_road() -> None:
    """The ground ends at y = -1.75: 0.95 + 1.2 = 2.15 m reach 0.4 m over it. In the middle of the lane it would fit.

    A share of the driver's place in the lane is tried: the vehicle is exported, but not out there.
    """
    found = _kept(scene_of(), TEN, offset=_aside(-1.2))
    assert found.trajectory.position[:, 1] == pytest.approx(np.full(110, -0.6))


def test_road_too_narrow_for_it_is_off_road() -> None:
    ground = [(0.0, -0.5), (300.0, -0.5), (300.0, 0.5), (0.0, 0.5)]
    graph = graph_of(draw_lane(1, [(0.0, 0.0), (300.0, 0.0)]), ground=ground)
    assert _alone(scene_on(graph), TEN) is Reason.OFF_ROAD


def test_box_of_a_recorded_agent_is_met() -> None:
    """Somebody stands at 100 m across both lanes, where the vehicle comes after 5 s; unchecked nobody is looked at."""
    stands, v = recorded(100.0, 0.0, heading=np.pi / 2), TEN
    assert _alone(scene_of(stands), v) is Reason.MEETS_RECORDED
    assert isinstance(_alone(scene_of(stands, config=Config(without=frozenset({"collision"}))), v), ExportedVehicle)


def test_box_of_another_inserted_vehicle_is_met() -> None:
    """Both on lane 1: one at 60 m with 5 m/s, one at 40 with 10 m/s; after 3.1 s the gap of 15.5 m is gone."""
    scene = scene_of()
    slow = _kept(scene, np.full(110, 5.0), 60.0)
    start = start_on(scene, (1,), 40.0, 10.0, number=1)
    assert finalise(scene, driven(start, TEN), [slow]) is Reason.MEETS_GENERATED


def test_ttc_to_the_leader_is_taken_down() -> None:
    """From 40 m at 8 m/s behind one at 100 m with 6: the gap of 55.5 m closes at 2 m/s to 33.7 m, 16.8 s."""
    found = _kept(scene_of(recorded(100.0, 0.0, 6.0)), np.full(110, 8.0))
    assert found.min_ttc_s == pytest.approx(16.8, abs=0.4)


def test_recorded_follower_may_not_close_in_critically() -> None:
    """A recorded one 12.5 m behind keeps 10 m/s, whatever happens; the vehicle slows to 5 m/s and speeds up again.

    It loses 5 m while it slows (2.5 m/s2, 2 s) and 6.25 m until it is as fast (2 m/s2): nobody is touched. But 1 s
    before, at 8 m/s, the gap is 12.5 - 5 - 4 = 3.5 m and closes at 3 m/s: 1.2 s.
    """
    slows = 10.0 - 2.5 * np.clip(T - 2.0, 0.0, 2.0)
    v = np.minimum(slows + 2.0 * np.clip(T - 4.0, 0.0, None), np.where(T < 4.0, slows, 12.0))
    scene = scene_of(recorded(23.0, 0.0, 10.0))
    found = _kept(scene, v)
    assert conflicting(scene, [found]) == [(0, Reason.TTC_RECORDED_FOLLOWER)]


@pytest.mark.parametrize(("length_m", "found"), [(3.9, [(0, Reason.FOLLOWER_HEADWAY)]), (4.5, [])])
def test_headway_is_that_to_the_box_that_is_exported(length_m: float, found: list[tuple[int, Reason]]) -> None:
    """19.4 m between the centres at 24 m/s; .3 m less to the front of a car of 3.9 m with a clearance 4.5 m long.

    The target of an event bears the gap that the event is about.
    """
    scene = scene_of(recorded(20.6, 0.0, 24.0))
    vehicle = _kept(scene, np.full(110, 24.0), size=BoxSize(length_m, 1.8))
    assert conflicting(scene, [vehicle]) == found
    assert conflicting(scene, [vehicle], allowed=allowed_to("r", {})) == []


def test_lane_of_a_damaged_map_that_turns_back_on_itself_is_not_driven() -> None:
    """The middle goes 1.2 m back at x = 90; the smoothed line goes on and runs against it there."""
    lane = draw_lane(1, [(0.0, 0.0), (90.0, 0.0), (88.8, 0.1), (300.0, 0.0)])
    graph = graph_of(lane, ground=[(-20.0, -9.0), (320.0, -9.0), (320.0, 9.0), (-20.0, 9.0)])
    assert _alone(scene_on(graph), TEN) is Reason.AGAINST_LANE


def test_of_two_that_come_too_near_together_the_later_one_goes() -> None:
    """Each of the two is exported alone: at 40 m with 10, at 60 m with 5 m/s. Together their TTC falls below 1.5 s."""
    scene = scene_of()
    slow, fast = _kept(scene, np.full(110, 5.0), 60.0), _kept(scene, TEN, 40.0, number=1)
    assert [row for row, _ in conflicting(scene, [slow, fast])] == [1]
    assert [row for row, _ in conflicting(scene, [slow, fast], first_row=1)] == [1]
    assert conflicting(scene, [slow, fast], first_row=2) == []
    assert conflicting(scene, [slow, _kept(scene, TEN, 40.0, lane=2, number=1)]) == []


@pytest.mark.parametrize(("aside_m", "rows"), [(0.7, [1]), (0.0, [])], ids=["towards it", "in the middle"])
def test_who_drives_aside_in_its_lane_closes_in_on_who_is_aside_ahead(aside_m: float, rows: list[int]) -> None:
    """Lanes 3.5 m apart; the slow one drives 1 m to the right in lane 2, at y = 2.5. Boxes are 1.9 m wide: who is at
    y = 0.7 would touch it, who is at y = 0 passes 0.6 m beside it.
    """
    scene = scene_of()
    slow = _kept(scene, np.full(110, 5.0), 60.0, lane=2, offset=_aside(-1.0))
    fast = _kept(scene, TEN, 40.0, offset=_aside(aside_m), number=1)
    assert [row for row, _ in conflicting(scene, [slow, fast])] == rows


@pytest.mark.parametrize(("y", "aside_m", "kept_m"), [(2.5, 0.7, 0.35), (2.5, 0.0, 0.0), (1.5, 0.7, None)])
def test_the_same_with_a_recorded_one_aside_in_the_next_lane(y: float, aside_m: float, kept_m: float | None) -> None:
    """At y, 5 m/s, from 60 m on; the vehicle comes from 40 m with 10 m/s and brakes 7 m behind it: 1.4 s.

    Boxes are 1.9 m wide with .1 m to the side. At y = 2.5 half of the place in the lane leaves .2 m between them, and
    is taken; at y = 1.5 no place in the lane does.
    """
    scene = scene_of(recorded(60.0, y, 5.0))
    v = np.concatenate([np.full(18, 10.0), np.linspace(10.0, 5.0, 20), np.full(72, 5.0)])
    found = finalise(scene, driven(start_on(scene, (1,), 40.0, 10.0, offset=_aside(aside_m)), v), [])
    if kept_m is None:
        assert found is Reason.TTC_LANE_LEADER
    else:
        assert isinstance(found, ExportedVehicle)
        assert found.trajectory.position[:, 1] == pytest.approx(kept_m, abs=0.01)


def test_without_smoothing_the_grid_path_is_exported() -> None:
    """The paper's ablation: piecewise linear from cell centre to cell centre, headings jump at the centres.

    A bend of 30 m in cells of 4 m: at the centres the position is on the circle, between them on the chord, which
    is 4^2 / (8 * 30) = 0.067 m inside it.
    """
    angle = np.linspace(0.0, np.pi, 120)
    bend = 30.0 * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
    outer = 34.0 * np.column_stack([np.sin(angle), -np.cos(angle)]) + [0.0, 30.0]
    graph = graph_of(draw_lane(1, bend), ground=[*outer, [0.0, 30.0]])
    scene = scene_on(graph, config=Config(without=frozenset({"smoothing"})))
    found = _kept(scene, np.full(110, 6.0), 10.0)
    radius = np.hypot(*(found.trajectory.position - [0.0, 30.0]).T)
    assert radius.max() <= 30.0 + 0.01
    assert 30.0 - radius.min() == pytest.approx(0.067, abs=0.02)
    turn = np.abs(np.diff(np.unwrap(found.trajectory.heading)))
    assert set(np.round(turn, 2)) <= {0.0, 0.13}  # 4 / 30 rad from chord to chord, 0 on it
    assert np.any(turn > 0.1)


def test_who_is_started_ahead_of_a_kept_vehicle_that_comes_into_its_lane_is_no_leader_too_slow_for_it() -> None:
    """From lane 1 to lane 2 at 10 m/s, 149 m after 10.9 s; ahead there 6 m/s from 93 m on: 4.9 m apart, 1.2 s."""
    scene = scene_of()
    start = start_on(scene, (1,), 40.0, 10.0)
    own = Foreseen(scene.paths.along((1,)), 60.0, 20, np.array([10.0]))
    across = lay_across(scene, own, scene.paths.along((2,)), side="left", remaining_m=200.0, driver=start.driver)
    assert isinstance(across, DrivenPath)
    changer = finalise(scene, replace(driven(start, TEN), path=across), [])
    assert isinstance(changer, ExportedVehicle)
    near, far = (_kept(scene, np.full(110, 6.0), s, lane=2, number=1) for s in (93.0, 100.0))
    assert conflicting(scene, [changer, near]) == [(1, Reason.TTC_LANE_LEADER)]
    assert conflicting(scene, [changer, far]) == []


# Vehicles that enter during the scene ---------------------------------------------------------------------------------


def test_vehicle_that_enters_has_the_steps_since_then() -> None:
    scene = scene_of()
    found = _kept(scene, np.full(80, 10.0), 3.0, step=30)
    track = found.track("gen_0", 1)
    assert track.timesteps.tolist() == list(range(30, 110))
    assert track.position[0] == pytest.approx([3.0, 0.0], abs=1e-6)
    traffic = traffic_of_exported([found], scene)
    assert np.flatnonzero(traffic.present[0, :110]).tolist() == list(range(30, 110))
    assert traffic.position[0, 60] == pytest.approx([33.0, 0.0], abs=1e-6)
    assert traffic.present[0, 110:].all()
    assert traffic.num_steps == scene.future.num_steps > 110
    assert traffic.position[0, 119] == pytest.approx([92.0, 0.0], abs=1e-6)  # at constant velocity beyond the scene


@pytest.mark.parametrize(
    ("steps", "met_by"), [(range(51), 0), (range(60, 110), 30)], ids=["there until step 50", "there from step 60 on"]
)
def test_who_is_met_depends_on_when_a_vehicle_enters(steps: range, met_by: int) -> None:
    """Somebody stands across the lane at x = 60. From x = 20 on at 10 m/s that is reached after 3.7 s, and left after
    4.3 s: from step 0 on at steps 37 to 43, from step 30 on at steps 67 to 73.
    """
    stands = recorded(60.0, 0.0, heading=np.pi / 2)
    rows = slice(steps.start, steps.stop)
    track = Track(
        "r", "vehicle", 2, stands.timesteps[rows], stands.position[rows], stands.heading[rows], stands.velocity[rows],
        CAR,
    )  # fmt: skip
    scene = scene_of(track)
    for step in (0, 30):
        found = _alone(scene, np.full(110 - step, 10.0), 20.0, step=step)
        assert (found is Reason.MEETS_RECORDED) is (step == met_by)
        assert isinstance(found, ExportedVehicle) is (step != met_by)


@pytest.mark.parametrize(("step", "found"), [(0, Reason.LEAVES_TOO_EARLY), (20, None), (45, Reason.LEAVES_TOO_EARLY)])
def test_who_enters_stays_until_it_has_been_observed_and_a_while(
    monkeypatch: pytest.MonkeyPatch, step: int, found: Reason | None
) -> None:
    """From x = 110 of 150 m on it leaves after 3.7 s, less than 4.9: from step 0 on at step 37, from step 20 on at step
    57, after the last observed one; who enters at step 45 is to be there for 4 s.
    """
    monkeypatch.setattr("hid2.scene.ENTRY_STAYS_S", 3.0 if step < 45 else 4.0)
    scene = scene_of(length_m=150.0)
    verdict = _alone(scene, np.full(110 - step, 10.0), 110.0, step=step)
    assert verdict is found or (found is None and isinstance(verdict, ExportedVehicle))


@pytest.mark.parametrize(("heading", "mps", "y", "kept_m"), [
    (np.pi, 8.0, 2.3, -0.425), (np.pi, 8.0, 2.6, 0.0), (np.pi, 8.0, 3.0, 0.25), (np.pi, 8.0, 3.6, 0.5),
    (0.0, 8.0, 2.8, 0.0), (0.6, 0.0, 3.6, -0.25),
])  # fmt: skip
def test_what_is_beside_is_passed_with_room(heading: float, mps: float, y: float, kept_m: float) -> None:
    """One comes at y, goes the same way, or stands askew; the place is .5 m towards it; at y = 2.3 .075 m, as judged.

    Boxes are 1.9 m wide: .8 m are left at .5 m from y = 3.2 on, .25 m farther aside from 2.95 on, at 0 from 2.7 on;
    nearer the most that there is. The one askew reaches .5 (4.5 sin .6 + 1.9 cos .6) = 2.06 m towards the lane.
    """
    scene = scene_of(recorded(200.0 if heading > 3.0 else 60.0, y, mps, heading=heading))
    found = _kept(scene, TEN, offset=_aside(0.5))
    assert found.trajectory.position[:, 1] == pytest.approx(kept_m, abs=0.01)


def test_what_sumo_objected_to_is_the_reason() -> None:
    scene = scene_of()
    vehicle = DrivenVehicle(start=start_on(scene, (1,), 40.0, 9.0), path=scene.paths.along((1,)))
    vehicle.not_inserted = Reason.SUMO_REFUSES_INSERTION
    assert finalise(scene, vehicle, []) is Reason.SUMO_REFUSES_INSERTION


def test_ttc_to_a_leader_is_that_of_the_steps_driven() -> None:
    """A leader at 5 m/s, at x = 20 at step 0, slows nobody down who comes in at step 40, 20 m behind it, at 5 m/s; from
    step 0 on, 12.5 m behind it bumper to bumper at 10 m/s, it is reached after 2.5 s.
    """
    scene = scene_of(recorded(20.0, 0.0, 5.0))
    assert isinstance(_alone(scene, np.full(70, 5.0), 20.0, step=40), ExportedVehicle)
    assert _alone(scene, TEN, 3.0) is Reason.MEETS_RECORDED
