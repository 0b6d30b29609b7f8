"""Whom vehicles meet from a start site: leaders on their route, who would run into them, and what came of it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hand_drawn import draw_chain, draw_road
from inserted import recorded, scene_on, sites_of

from hid2.agents import Policy
from hid2.conflicts.stop_lines import StopLines
from hid2.insertion.meetings import Meetings
from hid2.insertion.routes import Routes
from hid2.insertion.situations import Situation
from hid2.insertion.starts import Site
from hid2.params import Config, Drivers, Spawn
from hid2.scene import Scene
from hid2.vehicle import Start, VehicleRequest

ROAD_M = 400.0
#: A lane with a light at its end, 100 m, and the one beyond.
LIT = draw_chain(100.0, 400.0)


def scene_of(*tracks: object, **spawn: float) -> Scene:
    """Two lanes of 400 m in cells of 4 m: lane 1 at y = 0, lane 2 at y = 3.5 m."""
    config = Config(spawn=Spawn(prior_speed_mps=9.0, **spawn), drivers=Drivers(desired_mean=1.0, desired_sd=0.0))
    return scene_on(draw_road(lanes=2, length_m=ROAD_M), *tracks, config=config)


def _meetings(scene: Scene) -> Meetings:
    return Meetings(scene, Routes(scene), StopLines(scene).signals)


def _leader(meetings: Meetings, scene: Scene, lane_id: int, at_m: float) -> int:
    """The leader from a site on the lane's only route; 0 is the moving vehicle that was recorded first, -1 nobody."""
    meetings.outlook(Policy.STRAIGHT)
    cell = scene.grid.cell_at(lane_id, at_m)
    return meetings.leader_of(cell, meetings.routes.offers(lane_id)[0].route)


def _weight(meetings: Meetings, scene: Scene, lane_id: int, at_m: float) -> float:
    cell = scene.grid.cell_at(lane_id, at_m)
    return float(meetings.outlook(Policy.STRAIGHT).weight[scene.grid.index_of[cell]])


def test_leader_is_next_ahead_on_the_same_lane_within_three_seconds() -> None:
    """One at 9 m/s from 100 m on: within 3 s, 27 m, of it a vehicle that starts at 82 m follows it, on its lane only.

    At 0.9 of its speed the one from 82 m falls behind by 0.9 m/s and is within 3 s for more than three looks.
    """
    scene = scene_of(recorded(100.0, 0.0, 9.0))
    meetings = _meetings(scene)
    assert _leader(meetings, scene, 1, 82.0) == 0
    assert _leader(meetings, scene, 1, 40.0) == -1
    assert _leader(meetings, scene, 1, 120.0) == -1
    assert _leader(meetings, scene, 2, 82.0) == -1
    assert (meetings.pace_of(0), meetings.pace_of(-1)) == (pytest.approx(9.0), 0.0)
    met = meetings.outlook(Policy.STRAIGHT).meets[Situation.FOLLOWS]
    rows = [scene.grid.index_of[scene.grid.cell_at(lane, 82.0)] for lane in (1, 2)]
    assert met[rows].tolist() == [True, False]
    scene = scene_of(recorded(100.0, 0.0, 9.0, name="far"), recorded(91.0, 0.0, 9.0, name="between"))
    assert _leader(_meetings(scene), scene, 1, 80.0) == 1


def test_a_leader_that_brakes_is_told_from_one_that_does_not() -> None:
    """From 9 m/s by 1 m/s2 from 6 s on; a vehicle that changes lanes is to meet none: there is no speed for it."""
    steady = recorded(100.0, 0.0, 9.0)
    time_s = 0.1 * np.arange(110)
    x = 100.0 + 9.0 * time_s - 0.5 * np.maximum(time_s - 6.0, 0.0) ** 2
    xy = np.column_stack([x, np.zeros(110)])
    braking = replace(steady, position=xy, velocity=np.gradient(xy, 0.1, axis=0))
    for track, expected in ((steady, False), (braking, True)):
        scene = scene_of(track)
        met = _meetings(scene).outlook(Policy.STRAIGHT).meets[Situation.BRAKES]
        assert met[scene.grid.index_of[scene.grid.cell_at(1, 82.0)]] == expected
    sites = sites_of(scene, 0, Situation.BRAKES)
    assert sites._wants(Policy.STRAIGHT) == {Situation.BRAKES}
    assert sites._wants(Policy.LANE_CHANGE) == set()


@pytest.mark.parametrize(("is_red", "expected"), [(False, 0), (True, -1)])
def test_nobody_is_followed_beyond_a_red_light(is_red: bool, expected: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """One at 3 m/s from 130 m on: at 8.1 m/s who starts at 50 m is within 33 m of it from 9.2 s on, the light at 100 m
    behind it.
    """
    scene = scene_on(LIT, recorded(130.0, 0.0, 3.0))
    meetings = _meetings(scene)
    red = {2: np.full(scene.num_steps, is_red)}
    meetings.signals = SimpleNamespace(red=red.get)
    monkeypatch.setattr(Scene, "usual_speed", lambda *_: 9.0)
    assert _leader(meetings, scene, 1, 50.0) == expected


def test_vehicle_that_comes_to_a_red_light_stands() -> None:
    """A light at 100 m that is red throughout: from all cells before the place where a centre stands, at 97 m."""
    scene = scene_on(LIT)
    for is_red in (False, True):
        meetings = _meetings(scene)
        meetings.signals = SimpleNamespace(red={2: np.full(scene.num_steps, is_red)}.get)
        met = meetings.outlook(Policy.STRAIGHT).meets[Situation.STANDS]
        assert met[5:24].tolist() == [is_red] * 19
        assert not met[25:].any()


def test_site_at_which_somebody_recorded_would_run_into_a_vehicle_weighs_a_fifth(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """On lane 1 one at 20 m/s from 20 m on drives 218 m: past who starts at 60 m, not past who starts behind it."""
    scene = scene_of(recorded(20.0, 0.0, 20.0), recorded(20.0, 3.5, 9.0, name="other"), max_speed_mps=12.0)
    meetings = _meetings(scene)
    monkeypatch.setattr(Scene, "usual_speed", lambda *_: 9.0)
    behind, ahead = _weight(meetings, scene, 2, 60.0), _weight(meetings, scene, 1, 60.0)
    assert ahead == pytest.approx(0.2 * behind)


def test_who_follows_drives_as_fast_as_the_leader_at_least() -> None:
    """Half the traffic of the lane crawls at 4 m/s, far ahead; who starts behind the one at 12 m/s wants 12, not 4."""
    crawling = recorded(300.0, 0.0, 4.0, name="c")
    scene = scene_of(recorded(60.0, 0.0, 12.0), crawling)
    meetings = _meetings(scene)
    starts = [start for seed in range(60) for start in sites_of(scene, seed, Situation.FOLLOWS).propose(_request())]
    led = [one for one in starts if _leader(meetings, scene, one.route[0], one.start_m) == 0]
    assert len(led) >= 5
    assert all(one.driver.desired_mps == pytest.approx(12.0) for one in led)


def test_leader_who_is_followed_by_a_kept_vehicle_speaks_for_no_other_site() -> None:
    scene = scene_of(recorded(100.0, 0.0, 9.0))
    sites = sites_of(scene, 0, Situation.FOLLOWS)
    cell = scene.grid.index_of[scene.grid.cell_at(1, 82.0)]

    def rows() -> list[int]:
        return [scene.grid.index_of[one] for one, _ in sites._places(_request(), {Situation.FOLLOWS})]

    assert cell in rows()
    kept = sites.starts.make(_request(), Site(sites.here.routes.offers(1)[0], 80.0))
    assert isinstance(kept, Start)
    sites.kept = [SimpleNamespace(driven=SimpleNamespace(start=kept))]
    assert rows() == []


def test_weight_of_a_route_is_that_of_its_cell() -> None:
    scene = scene_of(recorded(100.0, 0.0, 9.0))
    meetings = _meetings(scene)
    cell = scene.grid.cell_at(1, 82.0)
    weight = _weight(meetings, scene, 1, 82.0)
    for wants, expected in ((set(), weight), ({Situation.FOLLOWS}, weight), ({Situation.CROSSES}, 0.0)):
        assert meetings.offer_weights(cell, Policy.STRAIGHT, frozenset(wants)) == pytest.approx([expected])


def _request() -> VehicleRequest:
    return VehicleRequest(0, Policy.STRAIGHT, 0.0)


def test_leader_does_not_depend_on_what_was_looked_at_before() -> None:
    """Variants share what they find: a site asked for first is answered as one asked for after all others."""
    scene = scene_of(recorded(100.0, 0.0, 9.0))
    fresh, used = _meetings(scene), _meetings(scene)
    for policy in Policy:
        used.outlook(policy)
    route = used.routes.offers(1)[0].route
    answers = [[one.leader_of(scene.grid.cell_at(1, at_m), route) for at_m in (40.0, 82.0)] for one in (fresh, used)]
    assert answers[0] == answers[1] == [-1, 0]
