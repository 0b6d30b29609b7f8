"""Hand-drawn roads, lines and boxes for the tests of the method: everything in metres, along +x unless bent."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hand_drawn import draw_lane, draw_road

from hid2.agents import BoxSize, Track
from hid2.motion.reference_line import ReferenceLine, build_reference_line
from hid2.motion.route import DrivenPath, LanePaths
from hid2.occupancy.traffic import Traffic
from hid2.params import Limits
from netconvert.lane_graph import LaneGraph, LaneSegment


@pytest.fixture(scope="session")
def lane() -> Callable[..., LaneSegment]:
    """lane(id, points, successors=(...), left=..., right=..., ...) -> LaneSegment, 3.5 m wide."""
    return draw_lane


@pytest.fixture(scope="session")
def road() -> Callable[..., LaneGraph]:
    """road(lanes=2, length_m=200) -> lanes 1, 2, ... along +x from the right, 3.5 m apart, lane 1 at y = 0."""
    return draw_road


@pytest.fixture(scope="session")
def straight_line() -> ReferenceLine:
    """The x axis from 0 to 200 m."""
    return build_reference_line(np.array([[0.0, 0.0], [200.0, 0.0]]), step_m=1.0, min_radius_m=5.0, max_offset_m=0.6)


@pytest.fixture(scope="session")
def straight_path(road: Callable[..., LaneGraph]) -> DrivenPath:
    """The middle of the right lane of a two-lane road of 200 m."""
    return LanePaths(road(), Limits()).along((1,))


@pytest.fixture(scope="session")
def box() -> Callable[..., Traffic]:
    """box(x, y, heading, speed, ...) -> Traffic of one box moving straight ahead at constant speed."""

    def make(
        x: float,
        y: float,
        heading: float = 0.0,
        speed: float = 0.0,
        *,
        steps: int = 110,
        first: int = 0,
        length_m: float = 4.5,
        width_m: float = 1.9,
        name: str = "a",
    ) -> Traffic:
        time = 0.1 * np.arange(steps)
        ahead = np.array([np.cos(heading), np.sin(heading)])
        return Traffic(
            ids=(name,),
            position=(np.array([x, y]) + speed * time[:, None] * ahead)[None],
            heading=np.full((1, steps), heading),
            velocity=np.broadcast_to(speed * ahead, (1, steps, 2)).copy(),
            present=(np.arange(steps) >= first)[None],
            length_m=np.array([length_m]),
            width_m=np.array([width_m]),
        )

    return make


@pytest.fixture(scope="session")
def track() -> Callable[..., Track]:
    """track(timesteps, x, y=0, heading=0, ...) -> Track of a vehicle; velocity is not that of the positions."""

    def make(
        timesteps: Sequence[int],
        x: Sequence[float],
        y: Sequence[float] | float = 0.0,
        heading: Sequence[float] | float = 0.0,
        *,
        track_id: str = "t",
        object_type: str = "vehicle",
        category: int = 1,
        size: BoxSize | None = None,
    ) -> Track:
        count = len(timesteps)
        return Track(
            track_id=track_id,
            object_type=object_type,
            category=category,
            timesteps=np.array(timesteps, dtype=np.int64),
            position=np.column_stack([np.array(x, dtype=np.float64), np.broadcast_to(y, count)]),
            heading=np.broadcast_to(np.asarray(heading, dtype=np.float64), count).copy(),
            velocity=np.full((count, 2), 99.0),
            size=size or BoxSize(4.5, 1.9),
        )

    return make
