"""Trajectories as the Surrogate Safety Assessment Model reads them: `.trj`, open trajectory format 1.04."""

from itertools import pairwise

import numpy as np

from bridge.recordings.judging import recording_states
from bridge.recordings.recording import Recording
from hid2.measures.arrays import SceneArrays
from hid2.measures.lane_matching import Matches
from netconvert.geometry import differences

#: Record types, byte order and units of the format: little-endian, metric.
_FORMAT, _DIMENSIONS, _TIMESTEP, _VEHICLE, _LITTLE, _METRIC = 0, 1, 2, 3, ord("L"), 1
_HEAD = np.dtype(
    {
        "names": ["format", "endian", "version", "dimensions", "units", "scale", "bounds"],
        "formats": ["u1", "u1", "<f4", "u1", "u1", "<f4", "4<i4"],
    }
)
_TIME = np.dtype([("kind", "u1"), ("time_s", "<f4")])
_ROW = np.dtype(
    {
        "names": ["kind", "vehicle", "link", "lane", "front", "rear", "length_m", "width_m", "speed_mps", "accel_mps2"],
        "formats": ["u1", "<i4", "<i4", "u1", "2<f4", "2<f4", "<f4", "<f4", "<f4", "<f4"],
    }
)


def trj_files(scene: Recording) -> dict[str, bytes]:
    """<id>.trj by file name, of a scene, recorded or generated."""
    states = recording_states(scene)
    return {f"{scene.scenario_id}.trj": trj_bytes(states.arrays, states.matches)}


def trj_bytes(arrays: SceneArrays, matches: Matches) -> bytes:
    """The vehicles of a scene as a .trj file.

    Vehicle n is the n-th agent of the arrays, from 1; link n the n-th lane of the map, 0 off every lane, with one lane
    each: SSAM then tells conflicts apart by their angle. x, y: front and rear bumper, city frame, m.
    """
    rows = np.flatnonzero(arrays.vehicle[arrays.agent])
    agent = arrays.agent[rows]
    forward = np.stack([np.cos(arrays.heading[rows]), np.sin(arrays.heading[rows])], axis=1)
    half = 0.5 * arrays.length[agent][:, None] * forward
    speed = np.hypot(*arrays.velocity.T)
    accel = np.concatenate(
        [np.zeros(0)] + [differences(speed[a:b], arrays.step_s) for a, b in pairwise(arrays.first.tolist())]
    )
    table = np.zeros(len(rows), _ROW)
    table["kind"], table["lane"], table["vehicle"], table["link"] = _VEHICLE, 1, agent + 1, matches.lane[rows] + 1
    table["front"], table["rear"] = arrays.position[rows] + half, arrays.position[rows] - half
    table["length_m"], table["width_m"] = arrays.length[agent], arrays.width[agent]
    table["speed_mps"], table["accel_mps2"] = speed[rows], accel[rows]
    head = np.zeros(1, _HEAD)
    head["endian"], head["version"], head["dimensions"], head["units"] = _LITTLE, 1.04, _DIMENSIONS, _METRIC
    head["scale"], ends = 1.0, np.concatenate([np.zeros((int(not rows.size), 2)), table["front"], table["rear"]])
    head["bounds"] = [*np.floor(ends.min(axis=0)), *np.ceil(ends.max(axis=0)) + 1]
    order = np.lexsort((agent, arrays.step[rows]))
    table, step = table[order], arrays.step[rows][order]
    parts = [head.tobytes()]
    for at in range(arrays.num_steps):
        time = np.array([(_TIMESTEP, at * arrays.step_s)], _TIME)
        parts += [time.tobytes(), table[np.searchsorted(step, at) : np.searchsorted(step, at + 1)].tobytes()]
    return b"".join(parts)
