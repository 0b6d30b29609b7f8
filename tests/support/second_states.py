"""Whether the columns of inserted tracks agree with each other and with the sidecar. Part of the second checker.

Apart from its limits, as faults are planted into positions alone: velocities are central differences of positions; what
is as far behind the middle of a box as its rear axle moves along its heading; a track has no gaps, begins at the first
step or where lanes of the map begin, and is seen until it is predicted; boxes share no ground between the steps either,
by sizes that a reader without labels takes.
"""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from second_checker import Finding, overlaps
from second_map import turned
from second_scene import DT_S, SMALL_THING, TYPE_SIZES, SecondScene, SecondTrack

LAST_OBSERVED = 49
#: Central differences of a jerk of 8 m/s3 are off by 8 * 0.1^2 / 6 = 0.013 m/s, in curves by more.
VELOCITY_MPS, SLIP_RAD, SLIPS_MPS = 0.1, 0.1, 0.5
AXLE_SHARE = 0.3  # of the length of a box, from its middle to its rear axle
#: From the rear bumper of a vehicle that enters to where a lane begins: 0.5 m, and what is driven in a step.
ENTERS_WITHIN_M = 3.0


def check_states(scene: SecondScene) -> list[Finding]:
    """All findings of a scene."""
    found = [one for track in scene.inserted for one in (*_columns(scene, track), *_times(scene, track))]
    tracks = [_at_half_steps(track) for track in scene.tracks]
    halves = SecondScene(scene.scenario_id, tracks, scene.inserted_ids, scene.ground, scene.sidecar)
    return found + [replace(one, step=one.step // 2) for track in halves.inserted for one in overlaps(halves, track)]


def _columns(scene: SecondScene, track: SecondTrack) -> Iterator[Finding]:
    derived = np.gradient(track.xy, DT_S, axis=0)
    off = np.abs(derived - track.velocity)[1:-1].max(axis=1)
    behind = AXLE_SHARE * track.length_m * np.stack([np.cos(track.heading), np.sin(track.heading)], axis=1)
    rolls = np.gradient(track.xy - behind, DT_S, axis=0)
    slip = np.abs(turned(np.arctan2(rolls[:, 1], rolls[:, 0]) - track.heading))[1:-1]
    slip = np.where(np.hypot(*derived[1:-1].T) > SLIPS_MPS, slip, 0.0)
    for name, values, limit in (("velocity", off, VELOCITY_MPS), ("slip", slip, SLIP_RAD)):
        row = int(np.argmax(values))
        if not values[row] <= limit:
            step = int(track.steps[1 + row])
            yield Finding(scene.scenario_id, track.track_id, step, name, float(values[row]), limit)


def _times(scene: SecondScene, track: SecondTrack) -> Iterator[Finding]:
    first, last, ground = int(track.steps[0]), int(track.steps[-1]), scene.ground
    steps = max(int(one.steps[-1]) for one in scene.tracks)
    begins = np.array([lane.line.xy[0] for lane_id, lane in ground.lanes.items() if not ground.predecessors[lane_id]])
    apart_m = float(np.hypot(*(begins - track.xy[0]).T).min()) if len(begins) else math.inf
    said = scene.agents[track.track_id]["spawn"]["timestep"]
    for name, value, limit, wrong in (
        ("gaps", len(track.runs), 1, len(track.runs) > 1),
        ("ends before it is predicted", last, LAST_OBSERVED, last < min(LAST_OBSERVED, steps)),
        ("begins where no lane does", apart_m, ENTERS_WITHIN_M,
         first > 0 and apart_m > 0.5 * track.length_m + ENTERS_WITHIN_M),
        ("enters though it is to be predicted", track.category, 1, first > 0 and track.category != 1),
        ("enters unobserved", first, LAST_OBSERVED, first > LAST_OBSERVED),
        ("begins when its record does not", first, said, first != said),
    ):  # fmt: skip
        if wrong:
            yield Finding(scene.scenario_id, track.track_id, first, name, value, limit)


def _at_half_steps(track: SecondTrack) -> SecondTrack:
    """A track at twice the steps, turning the short way round, in a box at least as large as its type's."""
    rows = np.flatnonzero(np.diff(track.steps) == 1)
    steps = np.concatenate([2 * track.steps, 2 * track.steps[rows] + 1])
    xy = np.concatenate([track.xy, (track.xy[rows] + track.xy[rows + 1]) / 2])
    turn = turned(track.heading[rows + 1] - track.heading[rows]) / 2
    heading = np.concatenate([track.heading, track.heading[rows] + turn])
    order, usual = np.argsort(steps), TYPE_SIZES.get(track.object_type, SMALL_THING)
    return replace(
        track, steps=steps[order], xy=xy[order], heading=heading[order],
        velocity=np.concatenate([track.velocity, track.velocity[rows]])[order],
        length_m=max(track.length_m, usual[0]), width_m=max(track.width_m, usual[1]),
    )  # fmt: skip
