from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hid2.agents import Track
from hid2.measures.lane_matching import flatten_lanes
from hid2.occupancy.agent_states import agent_states
from netconvert.lane_graph import LaneGraph


@pytest.mark.parametrize(("stated", "found"), [(8.5, 10.0), (11.5, 11.5), (99.0, 10.0)])
def test_agent_is_as_fast_as_the_faster_of_what_is_stated_and_what_its_positions_show(
    road: Callable[..., LaneGraph], track: Callable[..., Track], stated: float, found: float
) -> None:
    """10 m/s by the positions: a follower closes in by the larger one. 99 m/s are not believed."""
    one = replace(track(range(2, 12), np.arange(2.0, 12.0)), velocity=np.tile([stated, 0.0], (10, 1)))
    states = agent_states([one], flatten_lanes(road()), num_steps=20, step_s=0.1)
    assert states.speed(0)[2:12] == pytest.approx([found] * 10)
