from collections.abc import Callable

import numpy as np
import pytest

from hid2.agents import BoxSize, Track
from hid2.measures.lane_matching import FlatLanes, flatten_lanes
from hid2.measures.surrogate_safety import RecordedVehicles
from hid2.reasons import Reason
from netconvert.lane_graph import LaneGraph

STEPS = 40


def _drive(name: str, x: float, y: float, speed: float, *, aside_mps: float = 0.0, first: int = 0) -> Track:
    """Along x from step `first` on, moving aside evenly; the heading is that of the velocity."""
    steps = np.arange(first, STEPS)
    time = 0.1 * (steps - first)
    velocity = np.tile([speed, aside_mps], (steps.size, 1))
    return Track(
        track_id=name, object_type="vehicle", category=1, timesteps=steps,
        position=np.array([x, y]) + time[:, None] * velocity[0], velocity=velocity,
        heading=np.full(steps.size, np.arctan2(aside_mps, speed)), size=BoxSize(4.5, 1.9),
    )  # fmt: skip


@pytest.fixture(scope="module")
def lanes(road: Callable[..., LaneGraph]) -> FlatLanes:
    """Lane 1 at y = 0 and lane 2 at y = 3.5."""
    return flatten_lanes(road())


def _pressing(recorded: list[Track], generated: list[Track], leaving: list[bool], lanes: FlatLanes):
    return (
        RecordedVehicles(recorded, lanes, STEPS, step_s=0.1)
        .with_generated(generated)
        .following_conflicts(leaving, critical_s=1.5)
    )


def test_leader_of_the_lane_that_is_being_left_counts_until_the_lane_is_left(lanes: FlatLanes) -> None:
    """A car at 10 m/s moves out at 1 m/s behind one that stands 30 m ahead.

    Boxes overlap across the lane until it is 1.9 m aside, at 1.9 s; by then the gap is 30 - 4.5 - 19 = 6.5 m: 0.65 s.
    From 45 m the gap is 21.5 m then: 2.15 s.
    """
    leaves = _drive("gen_0", 0.0, 0.0, 10.0, aside_mps=1.0)
    assert _pressing([_drive("a", 30.0, 0.0, 0.0)], [leaves], [True], lanes) == [(0, None)]
    assert _pressing([_drive("a", 45.0, 0.0, 0.0)], [leaves], [True], lanes) == []


def test_leader_that_is_generated_is_named(lanes: FlatLanes) -> None:
    """Two cars in lane 2 are no part of it; gen_2 follows gen_1 at 10 against 2 m/s, 12 m apart: 7.5 / 8 = 0.94 s."""
    others = [_drive("a", 20.0, 3.5, 0.0), _drive("b", 60.0, 3.5, 0.0)]
    generated = [_drive("gen_0", 80.0, 3.5, 8.0), _drive("gen_1", 20.0, 0.0, 2.0), _drive("gen_2", 8.0, 0.0, 10.0)]
    assert _pressing(others, generated, [False, False, False], lanes) == [(2, 1)]


def test_who_stands_in_the_next_lane_is_no_leader(lanes: FlatLanes) -> None:
    generated = [_drive("gen_0", 0.0, 0.0, 10.0)]
    for leaving in (True, False):
        assert _pressing([_drive("a", 20.0, 3.5, 0.0)], generated, [leaving], lanes) == []


def test_leader_that_appears_late_counts_from_then_on(lanes: FlatLanes) -> None:
    """At step 20 the follower is at 20 m, somebody appears 10 m before it, standing: 5.5 m at 10 m/s."""
    appears = _drive("a", 30.0, 0.0, 0.0, first=20)
    assert _pressing([appears], [_drive("gen_0", 0.0, 0.0, 10.0)], [False], lanes) == [(0, None)]


def _cross(name: str, y: float) -> Track:
    """Northwards along x = 20 at 10 m/s."""
    steps = np.arange(STEPS)
    return Track(
        track_id=name, object_type="vehicle", category=1, timesteps=steps,
        position=np.array([20.0, y]) + 0.1 * steps[:, None] * np.array([0.0, 10.0]),
        velocity=np.tile([0.0, 10.0], (STEPS, 1)), heading=np.full(STEPS, np.pi / 2), size=BoxSize(4.5, 1.9),
    )  # fmt: skip


def _crossing(recorded: list[Track], generated: list[Track], lanes: FlatLanes):
    return (
        RecordedVehicles(recorded, lanes, STEPS, step_s=0.1)
        .with_generated(generated)
        .crossing_conflicts(critical_s=1.0)
    )


def test_crossing_too_soon_behind_somebody_is_a_conflict(lanes: FlatLanes) -> None:
    """One that drives along y = 0 at 10 m/s leaves x = 20.95, the far side of the crossing path, with its rear after
    (20.95 + 2.25) / 10 = 2.32 s. One that starts at y = -33.2 reaches y = -0.95 with its front after 3.0 s: PET 0.7 s.
    From y = -37.2 it is 0.4 s more.
    """
    first = _drive("a", 0.0, 0.0, 10.0)
    assert _crossing([first], [_cross("gen_0", -33.2)], lanes) == [(0, None)]
    assert _crossing([first], [_cross("gen_0", -37.2)], lanes) == []


def test_of_two_generated_ones_that_cross_the_later_is_named_first(lanes: FlatLanes) -> None:
    both = [_cross("gen_0", -33.2), _drive("gen_1", 0.0, 0.0, 10.0)]
    assert _crossing([], both, lanes) == [(1, 0)]
    recorded = [_drive("a", 0.0, 0.0, 10.0), _cross("b", -33.2)]
    assert _crossing(recorded, [_drive("gen_0", 0.0, 30.0, 5.0)], lanes) == []


def test_generated_leader_of_a_recorded_follower_that_will_not_brake_is_found(lanes: FlatLanes) -> None:
    """A recorded car at 10 m/s comes up behind one at 2 m/s: after 3.9 s the gap is 45.7 - 4.5 - 31.2 = 10 m: 1.25 s.

    One that begins 60 m ahead is still 24.3 m away then: 3.0 s. Recorded ones among themselves are none of ours.
    """
    comes = _drive("a", 0.0, 0.0, 10.0)

    def followed(recorded: list[Track], *starts: float) -> list[int]:
        generated = [_drive(f"gen_{row}", x, 0.0, 2.0) for row, x in enumerate(starts)]
        return (
            RecordedVehicles(recorded, lanes, STEPS, step_s=0.1)
            .with_generated(generated)
            .followed_conflicts(critical_s=1.5)
        )

    assert followed([comes], 45.7) == [0]
    assert followed([comes], 60.0) == []
    assert followed([comes], 120.0, 45.7) == [1]
    assert followed([comes, _drive("b", 45.7, 0.0, 2.0)], 120.0) == []


def test_conflicts_with_recorded_vehicles_are_foreseen_for_one_track(lanes: FlatLanes) -> None:
    """The cases above, each for a single planned track: what runs up on it, what it crosses too soon, and neither."""

    def conflict(recorded: list[Track], planned: Track, *, ttc_s: float = 1.5, pet_s: float = 1.0) -> Reason | None:
        return RecordedVehicles(recorded, lanes, STEPS, step_s=0.1).conflict_with(planned, ttc_s=ttc_s, pet_s=pet_s)

    comes = _drive("a", 0.0, 0.0, 10.0)
    assert conflict([comes], _drive("gen_0", 45.7, 0.0, 2.0)) is Reason.TTC_RECORDED_FOLLOWER
    assert conflict([comes], _drive("gen_0", 45.7, 3.5, 2.0)) is None
    assert conflict([comes], _drive("gen_0", 60.0, 0.0, 2.0)) is None
    assert conflict([comes], _drive("gen_0", 45.7, 0.0, 2.0), ttc_s=0.0) is None
    assert conflict([comes], _cross("gen_0", -33.2)) is Reason.PET
    assert conflict([comes], _cross("gen_0", -37.2)) is None
    assert conflict([comes], _cross("gen_0", -33.2), pet_s=0.0) is None
    assert conflict([], _drive("gen_0", 0.0, 0.0, 5.0)) is None


def test_one_track_is_told_what_all_together_are(lanes: FlatLanes) -> None:
    """Crossings at any angle, speed and time: PET of a single track is that of the positions exported together."""
    rng = np.random.default_rng(0)

    def crosses(name: str) -> Track:
        first, last = int(rng.integers(0, 15)), int(rng.integers(16, STEPS))
        steps, angle = np.arange(first, last), rng.uniform(-np.pi, np.pi)
        velocity = rng.uniform(0.5, 15.0) * np.array([np.cos(angle), np.sin(angle)])
        begin = np.array([20.0, 0.0]) - velocity * rng.uniform(0.0, 3.0) + rng.normal(0.0, 2.0, 2)
        return Track(
            track_id=name, object_type="vehicle", category=1, timesteps=steps,
            position=begin + 0.1 * steps[:, None] * velocity, velocity=np.tile(velocity, (steps.size, 1)),
            heading=np.full(steps.size, angle), size=BoxSize(4.5, 1.9),
        )  # fmt: skip

    told = []
    for _ in range(150):
        recorded, planned = [crosses(f"r{k}") for k in range(3)], crosses("gen_0")
        found = RecordedVehicles(recorded, lanes, STEPS, step_s=0.1).conflict_with(planned, ttc_s=0.0, pet_s=1.0)
        assert (found == "pet") == bool(_crossing(recorded, [planned], lanes))
        told.append(found)
    assert 20 < told.count("pet") < 130
