"""What a process of a study does: generate each run and keep what was measured, with or without the scene itself."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bridge.batch.batch import Place, Run
from bridge.batch.isolation import Failure
from bridge.batch.manifest import ManifestRow
from bridge.batch.scene_work import run_each
from bridge.files import write_text
from bridge.generation.generate import GeneratedScene, write
from bridge.studies.study import RUN_FILE, RUNS, SCENES
from hid2.evaluation.safety import prepare_map, safety
from hid2.measures.arrays import stack
from hid2.measures.time_to_collision import CAP_S


def measure_runs(place: Place, runs: Sequence[Run]) -> Iterator[ManifestRow | Failure]:
    """Generate and measure each run."""
    yield from run_each(place, runs, lambda scene: _write_run(scene, place.out))


def measure_and_keep_runs(place: Place, runs: Sequence[Run]) -> Iterator[ManifestRow | Failure]:
    """Generate and measure each run, and write its scene."""

    def finish(scene: GeneratedScene) -> Path:
        write(scene, place.out / SCENES)
        return _write_run(scene, place.out)

    yield from run_each(place, runs, finish)


def measure_scene(scene: GeneratedScene) -> list[dict[str, Any]]:
    """One record per manoeuvre that was asked for: the sidecar's, and what the exported positions show.

    window_ttc_s: smallest two-dimensional TTC to anything from start to end (None where it did not start), at most
    5 s; pet_s: smallest PET of the vehicle at a crossing of paths with another, None without one within 5 s.
    """
    step_s = scene.scenario.step_s
    arrays = stack([*scene.scenario.tracks, *scene.generated], num_steps=scene.scenario.num_steps, step_s=step_s)
    measured = safety(arrays, prepare_map(scene.scenario.graph))
    number = {track_id: index for index, track_id in enumerate(arrays.track_ids)}
    pet: dict[int, float] = {}
    for crossing in measured.encroachments:
        for one in (crossing.first, crossing.second):
            pet[one] = min(pet.get(one, CAP_S), crossing.pet_s)
    records = []
    for agent in scene.sidecar.agents:
        index = number[agent.track_id]
        rows = slice(int(arrays.first[index]), int(arrays.first[index + 1]))
        time_s, ttc_s = arrays.step[rows] * step_s, measured.ttc_s[rows]
        for maneuver in agent.maneuvers:
            inside = np.zeros(len(time_s), dtype=bool)
            if maneuver.start_s is not None:
                end_s = maneuver.end_s if maneuver.end_s is not None else float(time_s[-1])
                inside = (time_s >= maneuver.start_s - step_s / 2) & (time_s <= end_s + step_s / 2)
            records.append(
                {
                    "track_id": agent.track_id,
                    "policy": agent.policy.value,
                    **maneuver.model_dump(mode="json"),
                    "window_ttc_s": float(ttc_s[inside].min()) if inside.any() else None,
                    "pet_s": pet.get(index),
                }
            )
    return records


def _write_run(scene: GeneratedScene, out_dir: Path) -> Path:
    folder = out_dir / RUNS / scene.new_id
    write_text(folder / RUN_FILE, json.dumps(measure_scene(scene), indent=1) + "\n")
    return folder
