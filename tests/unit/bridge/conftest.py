"""Hand-made generated tracks, so that export and validation are tested without a simulation."""

from collections.abc import Callable

import numpy as np
import pytest

from bridge.config import config_sha256, config_to_dict, load_config
from bridge.export import new_scenario_id
from bridge.scenario import Scenario
from bridge.sidecar import (
    AgentRecord,
    GeneratorRecord,
    ManeuverRecord,
    PlacedRecord,
    ReplayRecord,
    RequestedRecord,
    Sidecar,
    SpawnRecord,
)
from hid2.agents import BoxSize, Policy, Track

Fake = tuple[list[Track], Sidecar, str]


@pytest.fixture
def fake_generated() -> Callable[..., Fake]:
    """fake_generated(scenario, count=2, category=1): tracks that drive circles of 50 m, a sidecar for them, an id.

    On a circle of radius 50 m at 10 m/s the angle grows by 0.2 rad/s: position 50 (cos a, sin a), heading a + pi/2,
    velocity 10 (-sin a, cos a).
    """

    def make(scenario: Scenario, *, count: int = 2, category: int = 1) -> Fake:
        config = load_config(None, [f"request.agents={count}"])
        steps = np.arange(scenario.num_steps)
        tracks = []
        for i in range(count):
            angle = 0.2 * 0.1 * steps + i
            circle = np.column_stack([np.cos(angle), np.sin(angle)])
            ahead = np.column_stack([-np.sin(angle), np.cos(angle)])
            heading = np.arctan2(ahead[:, 1], ahead[:, 0])
            tracks.append(
                Track(f"gen_{i}", "vehicle", category, steps, 50 * circle, heading, 10 * ahead, BoxSize(4.5, 1.9))
            )
        lane_id = min(scenario.graph.lanes)
        agents = tuple(
            AgentRecord(
                track_id=track.track_id,
                length_m=4.5,
                width_m=1.9,
                policy=Policy.LANE_CHANGE,
                spawn=SpawnRecord(lane_segment_id=lane_id, cell=0, speed_mps=10.0),
                route=(lane_id,),
                maneuvers=(
                    ManeuverRecord(
                        kind="lane_change",
                        status="done",
                        trigger_s=1.0,
                        start_s=1.5,
                        crossing_s=3.0,
                        end_s=4.5,
                        source_lane=lane_id,
                        target_lane=lane_id,
                    ),
                ),
            )
            for track in tracks
        )
        sidecar = Sidecar(
            source_scenario_id=scenario.scenario_id,
            generator=GeneratorRecord(version="0.1.0"),
            sumo_version="1.28.0",
            seed=0,
            variant=0,
            config=config_to_dict(config),
            config_sha256=config_sha256(config),
            replay=ReplayRecord(states=scenario.table.num_rows, max_position_error_m=0.0, max_heading_error_rad=0.0),
            requested=RequestedRecord(agents=count, behaviours=config.request.behaviours),
            placed=PlacedRecord(agents=count, behaviours={Policy.LANE_CHANGE: count}),
            agents=agents,
        )
        return tracks, sidecar, new_scenario_id(scenario.scenario_id, config, 0, 0)

    return make
