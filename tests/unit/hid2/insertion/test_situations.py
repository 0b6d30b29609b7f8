"""What recorded vehicles meet, how many inserted ones are to meet the same, and what a rollout foresees of it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hand_drawn import draw_road
from inserted import guard_of, recorded, scene_on

from hid2.agents import Policy
from hid2.insertion.situations import _PRIOR, Situation, Wanted
from hid2.insertion.starts import Site, Starts
from hid2.insertion.surroundings import Surroundings
from hid2.params import Config, Drivers, Request
from hid2.reasons import Reason
from hid2.scene import Scene
from hid2.vehicle import Start, VehicleRequest

STRAIGHT = VehicleRequest(0, Policy.STRAIGHT, 0.0)


def scene_of(*tracks: object) -> Scene:
    """A lane of 400 m at y = 0."""
    return scene_on(
        draw_road(lanes=1, length_m=400.0), *tracks, config=Config(drivers=Drivers(desired_mean=1.0, desired_sd=0.0))
    )


def _started(scene: Scene, at_m: float, *wants: Situation, mps: float = 9.0) -> Start | Reason:
    here = Surroundings(scene)
    starts = Starts(scene, here.roads, here.meetings, guard_of(here), np.random.default_rng(0), 0)
    return starts.make(STRAIGHT, Site(here.routes.offers(1)[0], at_m), speed_mps=mps, wants=frozenset(wants))


def test_shares_are_those_of_the_scene_and_of_six_vehicles_of_others() -> None:
    """Of two recorded vehicles one follows the other, 2 s behind; none brakes, crosses or stands."""
    scene = scene_of(recorded(100.0, 0.0, 9.0), recorded(77.0, 0.0, 9.0, name="b"))
    expected = {one: pytest.approx(((one is Situation.FOLLOWS) + 6.0 * _PRIOR[one]) / 8.0) for one in Situation}
    assert Surroundings(scene).shares == expected
    for config in (Config(request=Request(near="anywhere")), Config(without={"collision"})):  # the latter foresees none
        assert Surroundings(replace(scene, config=config)).shares == {}


def test_as_many_are_to_meet_something_as_the_shares_say() -> None:
    """A third of them: the first of three where it is rounded up, the third where it is rounded down."""
    for over, expected in ((0.0, [False, False, True]), (0.7, [True, False, False])):
        wanted, there, lacks = Wanted({Situation.STANDS: 0.34}, {Situation.STANDS: over}), [], []
        for _ in range(3):
            lacking = wanted.lacking(there)
            lacks.append(lacking == {Situation.STANDS})
            there.append(SimpleNamespace(situations=lacking))
        assert lacks == expected


@pytest.mark.parametrize(
    ("leader_m", "leader_mps", "expected"),
    [(90.0, 9.0, {Situation.FOLLOWS}), (200.0, 9.0, set()), (130.0, 1.0, {Situation.FOLLOWS, Situation.BRAKES})],
)
def test_rollout_tells_what_a_vehicle_meets(leader_m: float, leader_mps: float, expected: set[Situation]) -> None:
    """Of one that begins at 70 m with 9 m/s: bumpers are 1.7 s, 14 s, 6 s apart. What meets none wanted goes."""
    scene = scene_of(recorded(leader_m, 0.0, leader_mps))
    start = _started(scene, 70.0)
    assert isinstance(start, Start)
    assert start.situations == expected
    assert _started(scene, 70.0, Situation.CROSSES) is Reason.OTHER_SITUATION
    wanted = _started(scene, 70.0, Situation.CROSSES, Situation.FOLLOWS)
    assert isinstance(wanted, Start) is (Situation.FOLLOWS in expected)


@pytest.mark.parametrize(("from_m", "crosses"), [(65.0, True), (100.0, False)])
def test_path_of_a_vehicle_that_crosses_in_three_seconds_is_crossed(from_m: float, crosses: bool) -> None:
    """At 10 m/s across the lane at 150 m, there at 6.5 or 10 s; a vehicle from 110 m on is there after some 4.5 s."""
    xy, velocity = np.column_stack([np.full(110, 150.0), np.arange(110) - from_m]), np.tile([0.0, 10.0], (110, 1))
    across = replace(recorded(150.0, 0.0), position=xy, heading=np.full(110, np.pi / 2), velocity=velocity)
    start = _started(scene_of(across), 110.0)
    assert isinstance(start, Start)
    assert (Situation.CROSSES in start.situations) == crosses
