"""What the small forecaster sees of a scene: each target's surroundings as polylines, in the target's own frame.

The frame of a target has its last observed position as origin and its heading there as x axis. Targets are the tracks
of category 2 and 3 (scored and focal) that are present at the observation's end; those of training have a whole future.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bridge.evaluation.predictions import FUTURE_STEPS
from bridge.recordings.scenario import FOCAL_CATEGORY, MAX_STEPS, OBSERVED_STEPS, STEP_S, Scenario, read_scenario
from hid2.agents import FloatArray, Track
from hid2.params import Forecasting
from netconvert.errors import Hid2Error, ScenarioError
from netconvert.geometry import arc_length
from netconvert.lane_graph import TurnType

#: Features of an agent at a step: x, y, cos and sin of heading, vx, vy, present.
AGENT_FEATURES = 7
#: Of an agent over all: vehicle, pedestrian, two-wheeler, other, is the target.
AGENT_KINDS = 5
#: Of a lane's point: x, y, direction x and y.
LANE_FEATURES = 4
#: Of a lane: motor vehicles, intersection, left turn, right turn.
LANE_KINDS = 4
#: Lengths are given to the network in tens of metres, speeds in ten metres a second.
UNIT_M = 10.0
_SCORED_CATEGORY = 2
_LAST_OBSERVED = OBSERVED_STEPS - 1
_KIND = {"vehicle": 0, "bus": 0, "pedestrian": 1, "cyclist": 2, "motorcyclist": 2, "riderless_bicycle": 2}

Array32 = npt.NDArray[np.float32]


class Target(NamedTuple):
    """One track to forecast.

    agents (A, T, AGENT_FEATURES) at every few observed steps to the last, agent_kinds (A, AGENT_KINDS): the target
    first, then its neighbours, nearest first, zeros beyond them; lanes (L, P, LANE_FEATURES), lane_kinds
    (L, LANE_KINDS) likewise; future (60, 2) in the frame, None where it is not whole; origin (2,) m, heading rad: the
    frame.
    """

    scenario_id: str
    track_id: str
    focal: bool
    agents: Array32
    agent_kinds: Array32
    lanes: Array32
    lane_kinds: Array32
    future: Array32 | None
    origin: FloatArray
    heading: float

    def to_city(self, points: npt.NDArray[np.floating]) -> FloatArray:
        """Points (..., 2) of the frame, in UNIT_M, to the city, m."""
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        turned = np.asarray(points, dtype=np.float64) * UNIT_M @ np.array([[cos, sin], [-sin, cos]])
        return np.asarray(turned + self.origin, dtype=np.float64)


def features_of(
    folders: Sequence[Path], params: Forecasting, *, on_scene: Callable[[int, int], None] | None = None
) -> tuple[list[Target], list[str]]:
    """Targets of scenes in the order of folders, and a line for each scene that cannot be read."""
    found: list[Target] = []
    left_out = []
    for done, folder in enumerate(folders, 1):
        try:
            found += targets_of(read_scenario(folder), params)
        except Hid2Error as error:
            left_out.append(str(error))
        if on_scene is not None:
            on_scene(done, len(folders))
    return found, left_out


def targets_of(scenario: Scenario, params: Forecasting) -> list[Target]:
    """The targets of a scene, in the order of its tracks.

    Errors: ScenarioError for a recording of another data set with other steps than Argoverse 2's.
    """
    if scenario.observed_steps != OBSERVED_STEPS:
        raise ScenarioError(
            f"{scenario.folder}: {scenario.observed_steps} observed steps, expected {OBSERVED_STEPS}, Argoverse 2's"
        )
    if scenario.step_s != STEP_S:
        raise ScenarioError(f"{scenario.folder}: steps of {scenario.step_s:g} s, expected {STEP_S:g} s, Argoverse 2's")
    history = np.zeros((len(scenario.tracks), OBSERVED_STEPS, 6))
    present = np.zeros((len(scenario.tracks), OBSERVED_STEPS), dtype=np.bool_)
    for row, track in enumerate(scenario.tracks):
        seen = track.timesteps < OBSERVED_STEPS
        steps, heading = track.timesteps[seen], track.heading[seen]
        present[row, steps] = True
        history[row, steps] = np.column_stack(
            [track.position[seen], np.cos(heading), np.sin(heading), track.velocity[seen]]
        )
    around = _Seen(history, present, *_lanes(scenario, params.lane_points))
    return [
        _target(scenario, row, around, params)
        for row, track in enumerate(scenario.tracks)
        if track.category >= _SCORED_CATEGORY and present[row, _LAST_OBSERVED]
    ]


class _Seen(NamedTuple):
    """What all targets of a scene see, in the city: agents (N, 50, 6) where present (N, 50), and `_lanes`."""

    history: FloatArray
    present: npt.NDArray[np.bool_]
    lanes: FloatArray
    lane_kinds: FloatArray


def _target(scenario: Scenario, row: int, around: _Seen, params: Forecasting) -> Target:
    history, present, lanes, lane_kinds = around
    track = scenario.tracks[row]
    last = history[row, _LAST_OBSERVED]
    origin, heading = last[:2], float(np.arctan2(last[3], last[2]))
    turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])  # city to frame, on rows

    apart = np.hypot(*(history[:, _LAST_OBSERVED, :2] - origin).T)
    apart[~present[:, _LAST_OBSERVED]] = np.inf
    apart[row] = -1.0  # the target is the first
    nearest = [k for k in np.argsort(apart, kind="stable")[: params.agents] if apart[k] <= params.radius_m]
    steps = np.arange(_LAST_OBSERVED, -1, -params.history_every)[::-1]
    agents = np.zeros((params.agents, len(steps), AGENT_FEATURES), dtype=np.float32)
    agent_kinds = np.zeros((params.agents, AGENT_KINDS), dtype=np.float32)
    seen, states = present[np.ix_(nearest, steps)][..., None], history[np.ix_(nearest, steps)]
    agents[: len(nearest)] = np.concatenate(
        [(states[..., :2] - origin) @ turn / UNIT_M, states[..., 2:4] @ turn, states[..., 4:] @ turn / UNIT_M, seen],
        axis=-1,
    ) * seen  # fmt: skip
    for slot, k in enumerate(nearest):
        agent_kinds[slot, _KIND.get(scenario.tracks[k].object_type, 3)] = 1
    agent_kinds[0, 4] = 1

    near = np.hypot(*np.moveaxis(lanes[..., :2] - origin, -1, 0)).min(axis=1)
    chosen = [k for k in np.argsort(near, kind="stable")[: params.lanes] if near[k] <= params.radius_m]
    own_lanes = np.zeros((params.lanes, params.lane_points, LANE_FEATURES), dtype=np.float32)
    own_kinds = np.zeros((params.lanes, LANE_KINDS), dtype=np.float32)
    shape = lanes[chosen]
    own_lanes[: len(chosen)] = np.concatenate(
        [(shape[..., :2] - origin) @ turn / UNIT_M, shape[..., 2:] @ turn], axis=-1
    )
    own_kinds[: len(chosen)] = lane_kinds[chosen]
    return Target(
        scenario_id=scenario.scenario_id, track_id=track.track_id, focal=track.category == FOCAL_CATEGORY,
        agents=agents, agent_kinds=agent_kinds, lanes=own_lanes, lane_kinds=own_kinds,
        future=_future(track, origin, turn), origin=origin.copy(), heading=heading,
    )  # fmt: skip


def _future(track: Track, origin: FloatArray, turn: FloatArray) -> Array32 | None:
    ahead = track.timesteps >= OBSERVED_STEPS
    if ahead.sum() != FUTURE_STEPS or track.timesteps[-1] != MAX_STEPS - 1:
        return None
    return np.asarray((track.position[ahead] - origin) @ turn / UNIT_M, dtype=np.float32)


def _lanes(scenario: Scenario, points: int) -> tuple[FloatArray, FloatArray]:
    """(N, P, 4) of every lane: points at equal distances and the direction there, city frame; (N, 4) its kind."""
    shapes, kinds = [], []
    for lane in scenario.graph.lanes.values():
        line = lane.centerline
        along = arc_length(line)
        at = np.linspace(0.0, along[-1], points)
        place = np.column_stack([np.interp(at, along, line[:, axis]) for axis in (0, 1)])
        ahead = np.gradient(place, axis=0)
        length = np.maximum(np.hypot(*ahead.T), 1e-9)
        shapes.append(np.column_stack([place, ahead / length[:, None]]))
        kinds.append(
            [
                lane.lane_type != "BIKE", lane.is_intersection, lane.turn is TurnType.LEFT, lane.turn is TurnType.RIGHT,
            ]
        )  # fmt: skip
    return np.array(shapes).reshape(-1, points, LANE_FEATURES), np.array(kinds, dtype=np.float64).reshape(
        -1, LANE_KINDS
    )
