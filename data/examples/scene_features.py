"""What the small forecaster sees of a scene: each target's surroundings as polylines, in the target's own frame.

The frame of a target has its last observed position as origin and its heading there as x axis. Targets are the tracks
of category 2 and 3 (scored and focal) that are present at the observation's end; those of training have a whole future.
"""

import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from bridge.forecasting.predictions import FUTURE_STEPS
from bridge.recordings.recording import Recording
from bridge.recordings.scenario import MAX_STEPS, OBSERVED_STEPS, STEP_S, read_scenario
from hid2.agents import FOCAL_CATEGORY, SCORED_CATEGORY, FloatArray
from netconvert.errors import Hid2Error, ScenarioError
from netconvert.lane_graph import TurnType

#: What is seen: the nearest agents and lanes, how far, every so many steps of a history, points of a lane.
AGENTS, LANES, RADIUS_M, HISTORY_EVERY, LANE_POINTS = 48, 48, 100.0, 5, 6
#: Features of an agent at a step: x, y, cos and sin of heading, vx, vy, present; and over all: vehicle, pedestrian,
#: two-wheeler, other, is the target. Of a lane's point: x, y, direction; of a lane: motor vehicles, intersection, left
#: turn, right turn.
AGENT_FEATURES, AGENT_KINDS, LANE_FEATURES, LANE_KINDS = 7, 5, 4, 4
#: Lengths are given to the network in tens of metres, speeds in ten metres a second.
UNIT_M = 10.0
_LAST = OBSERVED_STEPS - 1
_KIND = {"vehicle": 0, "bus": 0, "pedestrian": 1, "cyclist": 2, "motorcyclist": 2, "riderless_bicycle": 2}


class TargetView(NamedTuple):
    """What the network sees of a target as arrays, float32; of several, a row each, as tensors.

    agents (A, T, 7) at every few observed steps to the last, agent_kinds (A, 5): the target first, then its neighbours,
    nearest first, zeros beyond them; lanes (L, P, 4), lane_kinds (L, 4) likewise; future (60, 2) in the frame, None
    where it is not whole.
    """

    agents: Any
    agent_kinds: Any
    lanes: Any
    lane_kinds: Any
    future: Any


class ForecastTarget(NamedTuple):
    """One track to forecast, in its frame: origin (2,) m, heading rad."""

    scenario_id: str
    track_id: str
    focal: bool
    seen: TargetView
    origin: FloatArray
    heading: float

    def to_city(self, points: npt.NDArray[np.floating]) -> FloatArray:
        """Points (..., 2) of the frame, in UNIT_M, to the city, m."""
        return np.asarray(points, dtype=np.float64) * UNIT_M @ _turn(self.heading).T + self.origin


def features_of(
    folders: Sequence[Path], *, on_scene: Callable[[int, int], None] | None = None
) -> tuple[list[ForecastTarget], list[str]]:
    """Targets of scenes in the order of folders, and a line for each scene that cannot be read."""
    found: list[ForecastTarget] = []
    left_out = []
    for done, folder in enumerate(folders, 1):
        try:
            found += targets_of(read_scenario(folder))
        except Hid2Error as error:
            left_out.append(str(error))
        if on_scene is not None:
            on_scene(done, len(folders))
    return found, left_out


def checksum(targets: Sequence[ForecastTarget]) -> int:
    """Of all that is learned from: another one where a track, its surroundings or its future differ."""
    found = 0
    for one in targets:
        for part in (f"{one.scenario_id} {one.track_id}".encode(), *(array.tobytes() for array in one.seen)):
            found = zlib.crc32(part, found)
    return found


def targets_of(scenario: Recording) -> list[ForecastTarget]:
    """The targets of a scene, in the order of its tracks.

    Errors: ScenarioError for a recording of another data set with other steps than Argoverse 2's.
    """
    if scenario.observed_steps != OBSERVED_STEPS:
        raise ScenarioError(
            f"{scenario.folder}: {scenario.observed_steps} observed steps, expected {OBSERVED_STEPS}, Argoverse 2's"
        )
    if scenario.step_s != STEP_S:
        raise ScenarioError(f"{scenario.folder}: steps of {scenario.step_s:g} s, expected {STEP_S:g} s, Argoverse 2's")
    # x, y, cos and sin of heading, vx, vy, and whether it is present, (tracks, observed steps, 7) in the city
    history = np.zeros((len(scenario.tracks), OBSERVED_STEPS, AGENT_FEATURES))
    for row, track in enumerate(scenario.tracks):
        seen = track.timesteps < OBSERVED_STEPS
        heading = track.heading[seen]
        history[row, track.timesteps[seen]] = np.column_stack(
            [track.position[seen], np.cos(heading), np.sin(heading), track.velocity[seen], np.ones(len(heading))]
        )
    lanes = _lanes(scenario)
    return [
        _target(scenario, row, history, *lanes)
        for row, track in enumerate(scenario.tracks)
        if track.category >= SCORED_CATEGORY and history[row, _LAST, 6]
    ]


def _turn(heading: float) -> FloatArray:
    """(2, 2) that takes rows of vectors from the city to a frame."""
    cos, sin = np.cos(heading), np.sin(heading)
    return np.array([[cos, -sin], [sin, cos]])


def _target(
    scenario: Recording, row: int, history: FloatArray, lanes: FloatArray, lane_kinds: FloatArray
) -> ForecastTarget:
    track, last = scenario.tracks[row], history[row, _LAST]
    origin, heading = last[:2], float(np.arctan2(last[3], last[2]))
    turn = _turn(heading)
    apart = np.where(history[:, _LAST, 6] > 0, np.hypot(*(history[:, _LAST, :2] - origin).T), np.inf)
    apart[row] = -1.0  # the target is the first
    nearest = _nearest(apart, AGENTS)
    states = history[np.ix_(nearest, np.arange(_LAST, -1, -HISTORY_EVERY)[::-1])]
    moved = (states[..., :2] - origin) @ turn / UNIT_M, states[..., 2:4] @ turn, states[..., 4:6] @ turn / UNIT_M
    agents = np.concatenate([*moved, states[..., 6:]], axis=-1) * states[..., 6:]
    agent_kinds = np.eye(AGENT_KINDS)[[_KIND.get(scenario.tracks[k].object_type, 3) for k in nearest]]
    agent_kinds[0, 4] = 1
    chosen = _nearest(np.hypot(*np.moveaxis(lanes[..., :2] - origin, -1, 0)).min(axis=1), LANES)
    shape = lanes[chosen]
    own_lanes = np.concatenate([(shape[..., :2] - origin) @ turn / UNIT_M, shape[..., 2:] @ turn], axis=-1)
    around = (agents, AGENTS), (agent_kinds, AGENTS), (own_lanes, LANES), (lane_kinds[chosen], LANES)
    ahead = track.timesteps >= OBSERVED_STEPS
    is_whole = ahead.sum() == FUTURE_STEPS and track.timesteps[-1] == MAX_STEPS - 1
    future = np.asarray((track.position[ahead] - origin) @ turn / UNIT_M, dtype=np.float32) if is_whole else None
    seen = TargetView(*(_padded(values, most) for values, most in around), future)
    is_focal = track.category == FOCAL_CATEGORY
    return ForecastTarget(scenario.scenario_id, track.track_id, is_focal, seen, origin.copy(), heading)


def _nearest(apart_m: FloatArray, most: int) -> npt.NDArray[np.int64]:
    """Numbers of those within RADIUS_M by their distance, nearest first, at most so many."""
    order = np.argsort(apart_m, kind="stable")[:most]
    return order[apart_m[order] <= RADIUS_M]


def _padded(values: FloatArray, most: int) -> npt.NDArray[np.float32]:
    """The same, with rows of zeros behind to so many."""
    return np.pad(values, [(0, most - len(values)), *[(0, 0)] * (values.ndim - 1)]).astype(np.float32)


def _lanes(scenario: Recording) -> tuple[FloatArray, FloatArray]:
    """(N, P, 4) of every lane: points at equal distances and the direction there, city frame; (N, 4) its kind."""
    shapes, kinds = [], []
    for lane in scenario.graph.lanes.values():
        place = lane.path.point(np.linspace(0.0, lane.path.length_m, LANE_POINTS))
        ahead = np.gradient(place, axis=0)
        shapes.append(np.column_stack([place, ahead / np.maximum(np.hypot(*ahead.T), 1e-9)[:, None]]))
        turns = lane.turn is TurnType.LEFT, lane.turn is TurnType.RIGHT
        kinds.append([lane.lane_type != "BIKE", lane.is_intersection, *turns])
    return np.array(shapes), np.array(kinds, dtype=np.float64)
