"""Whom inserted vehicles meet on real scenes, beside recorded ones, and how far variants repeat each other. A script:

python tests/benchmarks/encounters_figures.py --variants 20 --seed 0 [--near focal --within 50] [--set ...] [ROOT]
"""

import argparse
import itertools
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
from shared_data import SHARED_DATA

from bridge.config import load_config
from bridge.generation.generate import generate, prepare
from bridge.generation.scene import TrafficScene
from bridge.recordings.folders import find_scenarios
from bridge.recordings.scenario import read_scenario
from hid2.measures.arrays import SceneArrays
from hid2.measures.encounters import NEAR_M, encounters
from hid2.measures.following import leaders
from hid2.measures.lane_matching import FlatLanes, flatten_lanes
from hid2.measures.manoeuvres import ManeuverKind, detect
from hid2.occupancy.agent_states import agent_states

#: Vehicles of two variants are twins where they start and are 5 s later this near to each other, m.
TWIN_START_M, TWIN_LATER_M, LATER_S = 3.0, 5.0, 5.0
STRETCH_M = 10.0
#: So near to the focal track or the recording vehicle a lane change is an encounter, m.
FOCAL_M = 50.0
MEASURES = (
    f"never within {NEAR_M:g} m of moving recorded traffic", "recorded leader within 3 s for 1 s",
    "braking for a recorded leader", "crossing a recorded one with PET < 3 s", "stands",
)  # fmt: skip


def met_of(met: dict[str, np.ndarray]) -> np.ndarray:
    """(A, len(MEASURES)) of every agent; the same for inserted and recorded ones."""
    return np.column_stack([
        met[name] for name in ("far", "follows_recorded", "brakes_recorded", "crosses_recorded", "stands")
    ])  # fmt: skip


class Figures:
    """Sums over scenes."""

    def __init__(self) -> None:
        self.met: dict[str, list[np.ndarray]] = defaultdict(list)
        self.starts: dict[str, list[np.ndarray]] = defaultdict(list)
        self.cells: dict[str, int] = {}
        self.places: dict[str, set[tuple[int, int]]] = defaultdict(set)
        self.offered: dict[str, int] = {}
        self.near: dict[str, list[int]] = defaultdict(list)
        self.changes: list[float] = []
        self.enters: list[bool] = []

    def add_recorded(self, name: str, tracks, lanes: FlatLanes, *, num_steps: int, step_s: float) -> None:
        states = agent_states(tracks, lanes, num_steps=num_steps, step_s=step_s)
        arrays, led = states.arrays, leaders(states.arrays, lanes, states.matches)
        found = met_of(encounters(arrays, led))
        members = arrays.vehicle & arrays.moving & ~arrays.fragment
        self.met["recorded"].append(found[members])
        self.met[f"recorded, {name}"].append(found[members])

    def add(self, name: str, scene: TrafficScene, lanes: FlatLanes, target: str | None, within_m: float) -> None:
        recording = scene.source
        tracks = [*recording.tracks, *scene.generated]
        states = agent_states(tracks, lanes, num_steps=recording.num_steps, step_s=recording.step_s)
        arrays, matches = states.arrays, states.matches
        found = met_of(encounters(arrays, leaders(arrays, lanes, matches)))
        self.met["inserted"].append(found[arrays.generated])
        self.met["inserted, moving"].append(found[arrays.generated & arrays.moving])
        self.met[f"inserted, {name}"].append(found[arrays.generated])
        later = min(round(LATER_S / recording.step_s), recording.num_steps - 1)  # some scenes last for 5 s
        ends = [(t.position[0], t.position[later]) for t in scene.generated if len(t.timesteps) > later]
        self.starts[name].append(np.array(ends).reshape(-1, 2, 2))
        for one in detect(arrays, lanes, matches):
            if one.kind is ManeuverKind.LANE_CHANGE and one.track_id.startswith("gen_"):
                agent = arrays.track_ids.index(one.track_id)
                row = arrays.row_of[agent, min(round(one.crossing_s / arrays.step_s), arrays.num_steps - 1)]
                if row >= 0:
                    self.places[name].add((int(matches.lane[row]), int(matches.s[row] // STRETCH_M)))
        self.changes += changes_near(scene)
        self.enters += [bool(track.timesteps[0] > 0) for track in scene.generated]
        if target is not None:
            self.near[name].append(_near(arrays, target, within_m, recording))

    def lines(self) -> list[str]:
        """Inserted vehicles come in equal parts from all maps, recorded ones do not: their mean by map is beside."""
        kinds = [kind for kind in self.met if "," not in kind or kind.endswith("moving")]
        by_map = np.mean([one.mean(axis=0) for one in self.met["recorded"] if len(one)], axis=0)
        out = [f"{'':44s}{' '.join(f'{k:>24s}' for k in ('recorded, maps alike', *kinds))}"]
        for row, name in enumerate(MEASURES):
            shares = [by_map[row], *(np.concatenate(self.met[kind])[:, row].mean() for kind in kinds)]
            out.append(f"{name:44s}{' '.join(f'{share:24.3f}' for share in shares)}")
        out.append(f"{'vehicles':68s} {' '.join(f'{len(np.concatenate(self.met[k])):24d}' for k in kinds)}")
        for kind in sorted(set(self.met) - set(kinds)):
            found = np.concatenate(self.met[kind])
            out.append(f"{kind:40s} {' '.join(f'{share:.2f}' for share in found.mean(axis=0))} of {len(found)}")
        near = np.array(self.changes) <= FOCAL_M
        out.append(f"{near.size} lane changes done, {near.sum()} within {FOCAL_M:g} m of the focal track or the AV")
        out.append(f"{np.mean(self.enters):.3f} of the inserted enter during the scene")
        for name, variants in self.starts.items():
            pairs = [_twins(one, other) for one, other in itertools.permutations(variants, 2)]
            near = self.near.get(name)
            out.append(
                f"{name} twins {np.mean(pairs) if pairs else float('nan'):.3f}, lane changes at "
                f"{len(self.places[name])} stretches of {STRETCH_M:g} m, on offer {self.offered[name]}; "
                f"{self.cells[name]} cells"
                + (f"; near {np.median(near):g} (median), {min(near)} .. {max(near)}" if near else "")
            )
        return out


def changes_near(scene: TrafficScene) -> list[float]:
    """Of each lane change that was done, m from the focal track or the recording vehicle as it crosses."""
    tracks = {track.track_id: track for track in scene.recording.tracks}
    found, done = [], scene.maneuvers.query("kind == 'lane_change' and status == 'done'")
    for track_id, crossing_s in zip(done["track_id"], done["crossing_s"], strict=True):
        step = round(crossing_s / scene.recording.step_s)
        own, *others = (
            tracks[one].position[tracks[one].timesteps == step]
            for one in (track_id, scene.recording.focal_track_id, "AV")
        )
        apart = [float(np.hypot(*(other - own)[0])) for other in others if len(other) and len(own)]
        found.append(min(apart, default=np.inf))
    return found


def _twins(one: np.ndarray, other: np.ndarray) -> float:
    """Share of the vehicles of a variant, starts and later places (N, 2, 2), that have a twin in another one."""
    if not len(one) or not len(other):
        return 0.0
    apart = np.linalg.norm(one[:, None] - other[None], axis=-1)
    return float(((apart[..., 0] < TWIN_START_M) & (apart[..., 1] < TWIN_LATER_M)).any(axis=1).mean())


def _near(arrays: SceneArrays, target: str, within_m: float, recording) -> int:
    """Inserted vehicles within a distance of a target at the last observed step."""
    step = recording.last_observed
    wanted = {"av": "AV", "focal": recording.focal_track_id}.get(target, target)
    row = arrays.row_of[arrays.track_ids.index(wanted), step]
    ours = arrays.row_of[arrays.generated, step]
    apart = np.hypot(*(arrays.position[ours[ours >= 0]] - arrays.position[row]).T)
    return int((apart <= within_m).sum())


def offered(graph) -> int:
    """Stretches of 10 m of the lanes that have a same-direction lane beside, intersections left out."""
    lanes, total = graph.lanes, 0
    for lane in lanes.values():
        if lane.lane_type == "VEHICLE" and not lane.is_intersection:
            beside = [lanes.get(n) for n in (lane.left_neighbor_id, lane.right_neighbor_id) if n is not None]
            total += any(
                one is not None and one.lane_type == "VEHICLE"
                and float(np.dot(one.centerline[-1] - one.centerline[0], lane.centerline[-1] - lane.centerline[0])) > 0
                for one in beside
            ) * int(np.ceil(lane.length_m / STRETCH_M))  # fmt: skip
    return total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--variants", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--near", default="traffic")
    parser.add_argument("--within", type=float, default=30.0)
    parser.add_argument("--set", dest="settings", action="append", default=[])
    parser.add_argument("root", type=Path, nargs="?", help="data-set root, by default the shared real scenes")
    options = parser.parse_args()
    asked = {"request.seed": options.seed, "request.near": options.near, "request.within_m": options.within}
    target = options.near if options.near in ("av", "focal") else None
    figures, scenes, seconds = Figures(), 0, 0.0
    for folder in find_scenarios(options.root or SHARED_DATA / "av2"):
        config = load_config(None, options.settings, asked)
        recording = read_scenario(folder)
        prepared, lanes, name = prepare(recording, config), flatten_lanes(recording.graph), folder.name[:8]
        figures.cells[name], figures.offered[name] = len(prepared.grid.cells), offered(recording.graph)
        figures.add_recorded(
            name, recording.tracks, lanes, num_steps=recording.num_steps, step_s=recording.step_s
        )  # fmt: skip
        for variant in range(options.variants):
            began = time.process_time()
            scene = generate(prepared, config, variant=variant)
            seconds, scenes = seconds + time.process_time() - began, scenes + 1
            figures.add(name, scene, lanes, target, options.within)
    print(f"{seconds / scenes:.2f} s of processor time a scene, {scenes} scenes")
    print("\n".join(figures.lines()))


if __name__ == "__main__":
    main()
