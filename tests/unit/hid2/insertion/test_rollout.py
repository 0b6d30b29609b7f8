"""The world that candidates are rolled out in: what a motion does to others, and what is known without one of them."""

import gc
from dataclasses import replace

import numpy as np
import pytest
from hand_drawn import draw_chain, draw_lane, draw_road, draw_track, graph_of
from inserted import recorded, scene_on, start_on

from hid2.agents import FloatArray, Policy, Track
from hid2.conflicts.guard import Guard
from hid2.conflicts.stop_lines import ClosedLines, StopLines
from hid2.insertion.rollout import RolledOut, Rollout, World
from hid2.kernels.steering import CAUSES
from hid2.manoeuvre import ManoeuvreDue
from hid2.occupancy.traffic import Traffic
from hid2.policy.overtake import Stage
from hid2.policy.roads import Roads
from hid2.reasons import Reason
from hid2.scene import Scene
from hid2.vehicle import DrivenVehicle, Start


def world_of(*tracks: Track) -> World:
    """Two lanes of 300 m with nothing inserted."""
    return world_on(scene_on(draw_road(length_m=300.0), *tracks))


def world_on(scene: Scene) -> World:
    return World(scene, Roads(scene), Guard(scene, Traffic.none(scene.future.num_steps), StopLines(scene)))


def _part(start: Start, s: FloatArray, v: FloatArray) -> Rollout:
    """All of a motion along the path of a start."""
    return Rollout(start.path, start.step, s, v, np.zeros((s.size, 0)))


def _steady(
    world: World, s: float, mps: float, *, number: int = 0, lane: int = 1, policy: Policy = Policy.STRAIGHT
) -> RolledOut:
    """A vehicle that keeps its speed, m/s, from s m on."""
    start = start_on(world.scene, (lane,), s, mps, number=number, policy=policy)
    steps = np.arange(world.scene.num_steps)
    part = _part(start, s + 0.1 * mps * steps, np.full(steps.size, mps))
    return world.rolled_out(start, (part,))


@pytest.mark.parametrize(
    ("mps", "ahead_m", "reason"),
    [(24.0, 18.8, Reason.FOLLOWER_HEADWAY), (24.0, 19.6, None), (6.0, 7.9, Reason.FOLLOWER_HEADWAY), (6.0, 8.3, None)],
)
def test_recorded_follower_keeps_its_time_headway(mps: float, ahead_m: float, reason: Reason | None) -> None:
    """At 24 m/s 18.8 m from front to front are .78 s, 19.6 m .82 s; .8 s is the limit. An event's target bears it.

    At 6 m/s 1.2 m of a leader 4.5 m long count: 7.9 m from front to front are 3.4 m between bumpers, .77 s in all.
    """
    world = world_of(recorded(20.0, 0.0, mps))
    candidate = _steady(world, 20.0 + ahead_m, mps)
    assert world.harm_to_followers(candidate) is reason
    world.target_id = "r"
    assert world.harm_to_followers(candidate) is None


def test_follower_that_kept_as_little_in_the_recording_does_not_mind() -> None:
    """It follows a recorded one at .7 s for 3 s, which is gone then; afterwards an inserted one at .75 s."""
    gone = draw_track(range(30), 27.0 + np.arange(30), track_id="b")
    world = world_of(recorded(20.0, 0.0, 10.0, name="a"), gone)
    start = start_on(world.scene, (1,), 57.5, 10.0, step=30)
    steps = np.arange(world.scene.num_steps - 30)
    part = _part(start, 57.5 + 1.0 * steps, np.full(steps.size, 10.0))
    assert world.harm_to_followers(world.rolled_out(start, (part,))) is None


@pytest.mark.parametrize(("ahead_m", "reason"), [(10.2, Reason.FOLLOWER_HEADWAY), (10.8, None)])
def test_follower_of_a_round_before_keeps_its_time_headway(ahead_m: float, reason: Reason | None) -> None:
    """At 10 m/s 2 m of a leader's length count: 10.2 m from front to front are .77 s, 10.8 m .83 s; .8 s is the limit.

    One chosen in the same round would brake: it is no reason.
    """
    world = world_of()
    behind = _steady(world, 20.0, 10.0, number=1)
    kept = World(world.scene, world.roads, Guard(world.scene, behind.traffic, world.guard.stop_lines))
    candidate = _steady(kept, 20.0 + ahead_m, 10.0)
    assert kept.rejection_reason(candidate.start, candidate.parts) is reason
    world.choose(behind)
    assert world.rejection_reason(candidate.start, candidate.parts) is None


@pytest.mark.parametrize(
    ("seen", "mps", "kind", "reason"),
    [
        (range(20, 40), 0.0, "vehicle", Reason.MEETS_RECORDED),
        (range(85, 109), 0.0, "vehicle", Reason.MEETS_RECORDED),
        (range(35, 40), 0.0, "vehicle", None),
        (range(20, 40), 0.5, "vehicle", None),
        (range(20, 40), 0.0, "pedestrian", None),
    ],
    ids=["is lost before", "is found later", "is seen for half a second", "creeps", "a pedestrian"],
)
def test_none_drives_through_a_vehicle_that_stands_where_it_is_not_seen(
    seen: range, mps: float, kind: str, reason: Reason | None
) -> None:
    """At 10 m/s from 10 m on, it is where the other stands, at 80 m, from step 65 to step 75."""
    world = world_of(draw_track(seen, 80.0 + 0.1 * mps * np.arange(len(seen)), object_type=kind))
    candidate = _steady(world, 10.0, 10.0)
    assert world.rejection_reason(candidate.start, candidate.parts) is reason


def test_follower_that_closes_in_is_named() -> None:
    """10 m/s behind 5 m/s: the gap of 15.5 m lasts 3.1 s."""
    world = world_of(recorded(20.0, 0.0, 10.0))
    assert world.harm_to_followers(_steady(world, 40.0, 5.0)) is Reason.TTC_RECORDED_FOLLOWER


@pytest.mark.parametrize(("gap_m", "reason"), [(48.0, Reason.FOLLOWER_BRAKING), (75.0, None)])
def test_recorded_follower_is_not_to_brake_harder_than_it_does(gap_m: float, reason: Reason | None) -> None:
    """It keeps 15 m/s; the vehicle slows to 5 m/s in 4 s, for which the gap loses 20 m, and speeds up again.

    10^2 / (2 * 28) = 1.8 m/s2 would do, and .8 s later, at 7 m/s, still 1.5; of a gap 27 m longer 100 / 110 = .9 m/s2.
    Least TTC is 2.8 s.
    """
    world = world_of(recorded(20.0, 0.0, 15.0))
    v = 15.0 - 2.5 * np.clip(0.1 * np.arange(110) - 1.0, 0.0, 4.0) + 2.5 * np.clip(0.1 * np.arange(110) - 5.0, 0.0, 4.0)
    s = 24.5 + gap_m + np.cumsum(0.1 * v)
    start = start_on(world.scene, (1,), s[0], 15.0)
    candidate = world.rolled_out(start, (_part(start, s, v),))
    assert world.harm_to_followers(candidate) is reason
    world.target_id = "r"
    assert world.harm_to_followers(candidate) is None


def test_vehicle_is_rolled_out_anew_without_itself() -> None:
    """What is known on the path is the others, as in a world that it was never chosen in."""
    world, plain = world_of(recorded(200.0, 0.0, 8.0)), world_of(recorded(200.0, 0.0, 8.0))
    first, second, third = (_steady(world, s, 8.0, number=n) for n, s in enumerate((20.0, 60.0, 100.0)))
    world.choose(first)
    world.choose(second)
    around = world.joined_by(third, without="v1_0")
    plain.choose(first, third)
    path, box = first.start.path, first.start.box
    seen, wanted = around.guard.known_on(path, box), plain.guard.known_on(path, box)
    assert seen.low == pytest.approx(wanted.low)
    assert around.guard.inserted_known.ids == ("v0_0", "v2_0")
    assert world.guard.inserted_known.ids == ("v0_0", "v1_0")  # nothing is chosen by asking


def test_what_is_looked_at_in_vain_is_not_kept() -> None:
    """One that has another motion keeps its place among those chosen."""
    world = world_of()
    for number, s in enumerate((20.0, 60.0, 100.0)):
        world.choose(_steady(world, s, 8.0, number=number))
    gc.collect()
    before = sum(isinstance(one, Traffic) for one in gc.get_objects())
    world.joined_by(_steady(world, 140.0, 8.0, number=3), without="v0_0")
    gc.collect()
    assert sum(isinstance(one, Traffic) for one in gc.get_objects()) == before
    world.choose(_steady(world, 50.0, 8.0, number=1))
    assert world.guard.inserted_known.position[:, 0, 0] == pytest.approx([20.0, 50.0, 100.0])


def test_a_cell_that_begins_farther_on_takes_a_vehicle_there() -> None:
    """SUMO puts a vehicle as far into the facing cell as into its own: 2 m on where the lane beside begins 2 m on."""
    driven_on = []
    for begin_m in (0.0, 2.0):
        scene = scene_on(graph_of(
            draw_lane(1, [(0.0, 0.0), (300.0, 0.0)], left=2),
            draw_lane(2, [(begin_m, 3.5), (300.0 + begin_m, 3.5)], right=1),
        ))  # fmt: skip
        world = world_on(scene)
        before, onto = world.roll_manoeuvre(start_on(scene, (1,), 50.0, 10.0, policy=Policy.LANE_CHANGE))[1]
        assert onto.s[0] == pytest.approx(before.s[-1])
        driven_on.append(onto.s[-1] - onto.s[0] - 0.05 * (onto.v[1:] + onto.v[:-1]).sum())
    assert driven_on[1] - driven_on[0] == pytest.approx(2.0, abs=0.02)


@pytest.mark.parametrize(("beside_m", "reason"), [(60.0, Reason.CELLS_OCCUPIED), (None, Reason.NO_ADJACENT_LANE)])
def test_lane_change_that_a_lane_refused_is_not_said_to_have_had_no_lane(
    beside_m: float | None, reason: Reason
) -> None:
    """The lane beside ends as one at 100 m, after 4 s; a car drives there beside the vehicle. Or there is none."""
    has = beside_m is not None
    graph = graph_of(
        draw_lane(1, [(0.0, 0.0), (100.0, 0.0)], successors=(3,), left=2 if has else None),
        draw_lane(2, [(0.0, 3.5), (100.0, 3.5)], successors=(4,), right=1 if has else None),
        draw_lane(3, [(100.0, 0.0), (300.0, 0.0)]),
        draw_lane(4, [(100.0, 3.5), (300.0, 3.5)]),
    )
    beside = [recorded(beside_m, 3.5, 10.0)] if beside_m is not None else []
    scene = scene_on(graph, *beside)
    world = world_on(scene)
    vehicle, _ = world.roll_manoeuvre(start_on(scene, (1, 3), 60.0, 10.0, policy=Policy.LANE_CHANGE))
    assert vehicle.stage is Stage.ABORTED
    assert vehicle.reason is reason


def test_vehicle_that_stands_while_it_passes_another_one_is_looked_at_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """It stands 2 m short of the way back all the time: no step is the one at which it will be past."""
    world = world_of()

    def passes(vehicle: DrivenVehicle, _scene: Scene, _step: int) -> bool:
        vehicle.stage = Stage.PASS
        return True

    monkeypatch.setattr("hid2.insertion.rollout.advance", passes)
    monkeypatch.setattr(ManoeuvreDue, "passed_gap_m", lambda _: world.scene.config.overtake.return_gap_m - 2.0)
    start = start_on(world.scene, (1,), 100.0, 0.0, policy=Policy.OVERTAKE)
    steps = world.scene.num_steps
    stands = _part(start, np.full(steps, 100.0), np.zeros(steps))
    monkeypatch.setattr(World, "roll", lambda *_args, **_more: stands)
    vehicle, parts = world.roll_manoeuvre(start)
    assert (vehicle.reason, len(parts)) == (Reason.NOT_AHEAD, 1)


def test_only_what_comes_near_a_lane_change_makes_it_be_rolled_out_anew() -> None:
    """Beside 20 m behind it does; 100 m behind, or where it is never there at the same time, it does not."""
    world = world_of()
    changer = _steady(world, 150.0, 8.0, policy=Policy.LANE_CHANGE)
    across = replace(changer, parts=(changer.parts[0].until(40), replace(changer.parts[0], step=41)))
    world.choose(across)
    near, far = _steady(world, 130.0, 8.0, number=1), _steady(world, 40.0, 8.0, number=2)
    assert world.to_roll_anew(near) == [across]
    assert world.to_roll_anew(far) == []


@pytest.mark.parametrize(("since", "reason"), [(0, Reason.ENTERS_ON_RED), (22, Reason.ENTERS_ON_RED), (28, None)])
def test_none_is_to_enter_where_it_has_been_red_for_long(
    monkeypatch: pytest.MonkeyPatch, since: int, reason: Reason | None
) -> None:
    """At 10 m/s from 60 m on the front is at the entrance at step 38: red for 1.6 s is long, for 1 s amber."""
    scene = scene_on(draw_chain(100.0, 300.0, crossing=2))
    closed = np.arange(scene.num_steps)[None] >= since
    line = ClosedLines(np.array([97.0]), np.array([120.0]), closed, np.array([CAUSES.index("signal")]))
    monkeypatch.setattr(StopLines, "on", lambda *_: line)
    world = world_on(scene)
    start, steps = start_on(scene, (1, 2), 60.0, 10.0), np.arange(scene.num_steps)
    part = _part(start, 60.0 + 1.0 * steps, np.full(steps.size, 10.0))
    assert world.rejection_reason(start, (part,)) is reason


@pytest.mark.parametrize(("stops_m", "stands", "reason"), [
    (112.0, 5, Reason.STOPS_IN_INTERSECTION), (112.0, 4, None), (95.0, 20, None), (140.0, 20, None),
])  # fmt: skip
def test_none_is_to_stop_in_an_intersection(stops_m: float, stands: int, reason: Reason | None) -> None:
    """Lanes of 100 m, 25 m inside an intersection, and 175 m: standing for half a second counts inside alone.

    Before, it stood at the beginning for a step or two.
    """
    scene = scene_on(draw_chain(100.0, 125.0, 300.0, crossing=2))
    world = world_on(scene)
    start = start_on(scene, (1, 2, 3), 60.0, 10.0)
    v = np.full(scene.num_steps, 10.0)
    stopped = int((stops_m - 60.0) / 1.0)
    v[stopped : stopped + stands] = 0.0
    v[:2] = [0.0, 0.1]
    v[2] = 29.9
    s = 60.0 + np.concatenate([[0.0], np.cumsum(0.1 * v[:-1])])
    part = _part(start, s, v)
    assert world.rejection_reason(start, (part,)) is reason


@pytest.mark.parametrize(
    ("aside_m", "stops_m", "reason"), [(1.0, 92.0, Reason.BEHIND_PARKED), (1.0, 85.5, None), (0.0, 92.0, None)]
)
def test_none_is_to_wait_behind_a_parked_vehicle(aside_m: float, stops_m: float, reason: Reason | None) -> None:
    """A car stands at 100 m throughout, 1 m off the middle of its lane: parked; in the middle it is a queue."""
    world = world_of(recorded(100.0, aside_m))
    start, time_s = start_on(world.scene, (1,), 60.0, 10.0), 0.1 * np.arange(world.scene.num_steps)
    v = np.clip(10.0 - 2.0 * (time_s - (stops_m - 85.0) / 10.0), 0.0, 10.0)  # 25 m of braking
    s = 60.0 + np.concatenate([[0.0], np.cumsum(0.05 * (v[1:] + v[:-1]))])
    part = _part(start, s, v)
    assert world.rejection_reason(start, (part,)) is reason
