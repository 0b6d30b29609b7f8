"""Recorded vehicles that yield in time: who is ahead of them, how far they get, and what becomes of their tracks."""

from collections.abc import Callable

import numpy as np
import pytest
from hand_drawn import draw_box, draw_lane
from inserted import CAR, nobody, recorded, scene_on

from hid2.agents import Track
from hid2.conflicts.reaction import Reactions, yielding
from hid2.occupancy.traffic import Traffic
from hid2.scene import Scene
from netconvert.lane_graph import LaneGraph


def _scene(*tracks: Track) -> Scene:
    """A lane along x, 400 m."""
    return scene_on(LaneGraph({1: draw_lane(1, [(0.0, 0.0), (400.0, 0.0)])}), *tracks)


def _ahead(x: float, y: float = 0.0, speed: float = 0.0) -> Traffic:
    """One generated car at a step, heading along x."""
    return draw_box(x, y, 0.0, speed, steps=1, name="v")


def _at(speed_mps: float) -> Callable[[int, float, float, float], float]:
    return lambda row, speed, gap, leader: speed_mps


def _asking(asked: list[tuple[int, float, float, float]], *, share: float = 1.0) -> Callable[..., float]:
    """Notes what is asked: row, speed, gap and the leader's speed; answers a share of the speed."""

    def follow(row: int, speed: float, gap: float, leader: float) -> float:
        asked.append((row, speed, gap, leader))
        return share * speed

    return follow


def _unasked(row: int, speed: float, gap: float, leader: float) -> float:
    raise AssertionError


def test_vehicle_without_anybody_ahead_drives_as_recorded_to_the_last_bit() -> None:
    """Nobody ahead, one beside (3.5 m aside) and one behind: its car following is not even asked."""
    scene = _scene(recorded(50.0, 0.0, 10.0))
    reactions = Reactions(scene, _unasked)
    for step in range(1, 110):
        x = float(scene.traffic.position[0, step - 1, 0])
        others = _ahead(x + 3.0, 3.5).joined(_ahead(x - 8.0))
        assert not reactions.advance(step, others)
    assert reactions.scene is scene
    assert reactions.late_s == {}


def test_leader_is_told_with_its_gap_and_its_speed_unless_it_is_farther_than_80_m() -> None:
    """Centres 30 m apart, both 4.5 m long: 25.5 m bumper to bumper, to half a metre. 79 m are asked about, 81 not."""
    asked: list[tuple[int, float, float, float]] = []
    for x in (80.0, 131.0, 129.0):
        Reactions(_scene(recorded(50.0, 0.0, 10.0)), _asking(asked)).advance(1, _ahead(x, speed=6.0))
    ((row, speed, gap, leader), (_, _, far, _)) = asked
    assert (row, leader, speed) == (0, 6.0, pytest.approx(10.0))
    assert (gap, far) == pytest.approx((25.5, 74.5), abs=0.6)


def test_half_the_speed_is_half_a_step_later_and_all_that_follows_so_much_later() -> None:
    """10 m/s recorded, 5 m/s driven for two steps: 1 m behind, 0.1 s late, from then on at the recorded pace."""
    track = recorded(50.0, 0.0, 10.0)
    reactions = Reactions(_scene(track), _at(5.0))
    for step in (1, 2):
        assert reactions.advance(step, _ahead(80.0))
    assert reactions.late_s == {"r": pytest.approx(0.1)}
    (driven,) = reactions.tracks([track])
    x = driven.position[:, 0]
    assert x[:4] == pytest.approx([50.0, 50.5, 51.0, 52.0])
    assert x[3:] == pytest.approx(track.position[3:, 0] - 1.0)
    assert np.all(driven.position[:, 1] == 0.0)


def test_nobody_catches_up_or_exceeds_the_recorded_speed_of_a_place() -> None:
    """Recorded 10 m/s up to x = 80 and 4 m/s from there on; car following asks for 30 m/s after one step of none."""
    track = recorded(50.0, 0.0, 10.0)
    x = np.where(track.timesteps <= 30, 50.0 + track.timesteps, 80.0 + 0.4 * (track.timesteps - 30))
    track.position[:, 0] = x
    free: list[float] = [0.0]
    reactions = Reactions(_scene(track), lambda row, speed, gap, leader: free[0])
    reactions.advance(1, _ahead(70.0))
    free[0] = 30.0
    for step in range(2, 110):
        assert not reactions.advance(step, nobody(1))
    (driven,) = reactions.tracks([track])
    assert driven.position[:, 0] == pytest.approx(np.concatenate([[50.0], x[:-1]]))


def test_who_is_late_yields_to_everybody_and_others_to_those_who_are_late() -> None:
    """Two recorded ones 20 m apart: they are each other's business only once the one ahead is late."""
    pair = recorded(50.0, 0.0, 10.0, name="behind"), recorded(70.0, 0.0, 10.0, name="ahead")
    asked: list[tuple[int, float, float, float]] = []
    reactions = Reactions(_scene(*pair), _asking(asked, share=0.5))
    reactions.advance(1, nobody(1))
    assert asked == []
    reactions.advance(2, _ahead(95.0))
    assert [one[0] for one in asked] == [0, 1]  # both have the generated one ahead
    asked.clear()
    reactions.advance(3, nobody(1))
    assert [one[0] for one in asked] == [0, 1]
    assert set(reactions.late_s) == {"behind", "ahead"}


@pytest.mark.parametrize("kind", ["cyclist", "pedestrian", "motorcyclist"])
def test_only_cars_and_buses_react(kind: str) -> None:
    reactions = Reactions(_scene(recorded(50.0, 0.0, 5.0, kind=kind)), _unasked)
    assert not reactions.advance(1, _ahead(60.0))


def test_track_that_ends_in_the_scene_is_driven_to_its_end_later() -> None:
    """Recorded for 50 steps, one step of standing: present for 51, and at the same place at last."""
    whole = recorded(50.0, 0.0, 10.0)
    cut = slice(0, 50)
    track = Track(
        "r", "vehicle", 1, whole.timesteps[cut], whole.position[cut], whole.heading[cut], whole.velocity[cut], CAR
    )
    reactions = Reactions(_scene(track), _at(0.0))
    reactions.advance(10, _ahead(70.0))
    (driven,) = reactions.tracks([track])
    assert driven.timesteps.tolist() == list(range(51))
    assert driven.position[-1] == pytest.approx(track.position[-1])
    assert driven.position[10] == pytest.approx(driven.position[9])


def test_what_is_known_of_the_scene_is_that_of_the_late_vehicle() -> None:
    """Cells and future: 5 s after a standstill of one step all is 1 m behind."""
    track = recorded(50.0, 0.0, 10.0)
    scene = _scene(track)
    reactions = Reactions(scene, _at(0.0))
    reactions.advance(1, _ahead(70.0))
    new = reactions.scene
    assert new.traffic.position[0, 50, 0] == pytest.approx(99.0)
    assert new.future.position[0, -1, 0] == pytest.approx(scene.future.position[0, -1, 0] - 1.0)
    assert scene.traffic.position[0, 50, 0] == 100.0  # the recorded scene is as it was
    moved = np.flatnonzero(new.occupancy.sigma[52] != scene.occupancy.sigma[52])
    assert moved.size > 0


@pytest.mark.parametrize(
    ("x", "speed", "heading", "yields"),
    [
        (30.0, 15.0, 0.0, True),  # gap 15.5 m, closing in with 5 m/s: 0.8 m/s2
        (43.0, 15.0, 0.0, False),  # gap 2.5 m: 5 m/s2
        (30.0, 15.0, np.pi, False),  # oncoming
        (70.0, 5.0, 0.0, False),  # ahead
    ],
)
def test_who_comes_from_behind_and_can_brake_is_expected_to_yield(
    x: float, speed: float, heading: float, yields: bool
) -> None:
    """A vehicle at x = 50 with 10 m/s; YIELDS_MPS2 is 4.5."""
    scene = _scene(recorded(x, 0.0, speed, heading=heading))
    found = yielding(
        scene, np.array([0]), 0, xy=np.array([50.0, 0.0]), forward=np.array([1.0, 0.0]), half_m=2.25, speed_mps=10.0
    )
    assert found.tolist() == [yields]
