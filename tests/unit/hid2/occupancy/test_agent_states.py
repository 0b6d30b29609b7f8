"""The states of agents, and the lines that they drive."""

from dataclasses import replace

import numpy as np
import pytest
from hand_drawn import draw_lane, draw_track

from hid2.agents import Track
from hid2.measures.lane_matching import FlatLanes, flatten_lanes
from hid2.occupancy.agent_states import AgentStates, agent_states
from netconvert.lane_graph import LaneGraph


@pytest.fixture
def lanes() -> FlatLanes:
    """Lane 1 along y = 0, lane 2 up the map along x = 100."""
    row = draw_lane(1, [(0.0, 0.0), (200.0, 0.0)]), draw_lane(2, [(100.0, -50.0), (100.0, 150.0)])
    return flatten_lanes(LaneGraph({one.lane_id: one for one in row}))


def _states(lanes: FlatLanes, *tracks: Track) -> AgentStates:
    return agent_states(tracks, lanes, num_steps=20, step_s=0.1)


def test_line_goes_on_along_the_lane_of_the_last_state(lanes: FlatLanes) -> None:
    """One state alone, at (100, 20), heading up: 30 m on it is at (100, 50), whatever the row before drives along."""
    states = _states(
        lanes, draw_track(range(20), np.arange(20.0)), draw_track([5], [100.0], 20.0, np.pi / 2, track_id="up")
    )
    driven = states.line(1)
    assert driven is not None
    assert driven.line.position(np.array([30.0]))[0] == pytest.approx([100.0, 50.0], abs=0.1)
    assert np.flatnonzero(np.isfinite(driven.s)).tolist() == [5]


def test_parts_that_are_joined_keep_their_lines(lanes: FlatLanes) -> None:
    """Rows 0 and 1 are of the first part, 2 of the second, 3 of the third."""
    one, two, three, four = (draw_track(range(20), 30.0 * n + np.arange(20.0), track_id=str(n)) for n in range(4))
    parts = _states(lanes, one, two), _states(lanes, three), _states(lanes, four)
    joined = parts[0].joined(*parts[1:])
    assert [joined.line(row) for row in range(4)] == [
        parts[0].line(0),
        parts[0].line(1),
        *(p.line(0) for p in parts[1:]),
    ]


@pytest.mark.parametrize(("stated", "found"), [(8.5, 10.0), (11.5, 11.5), (99.0, 10.0)])
def test_agent_is_as_fast_as_the_faster_of_what_is_stated_and_what_its_positions_show(
    lanes: FlatLanes, stated: float, found: float
) -> None:
    """10 m/s by the positions: a follower closes in by the larger one. 99 m/s are not believed."""
    one = replace(draw_track(range(2, 12), np.arange(2.0, 12.0)), velocity=np.tile([stated, 0.0], (10, 1)))
    states = _states(lanes, one)
    assert states.speed(0)[2:12] == pytest.approx([found] * 10)
