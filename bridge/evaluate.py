"""One pass over any number of scenes, recorded or generated: metrics.json, CSV tables and report.html."""

import csv
import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np

from bridge.aggregate import CLEAN, KINEMATIC, LIMITS, SAFETY, diversity, table
from bridge.engine import Settings, Task, execute_here
from bridge.isolation import Failure
from bridge.scenario import find_scenarios
from bridge.scene_metrics import Row, SceneMeasures
from bridge.scene_table import SceneTable
from hid2.agents import FloatArray
from hid2.evaluation.arrays import BoolArray
from hid2.evaluation.realism import DRIVING_FEATURES, RealismCounts, classifier_test
from hid2.params import Limits
from netconvert.av2_map import read_lane_graph
from netconvert.cells import build_cell_grid
from netconvert.errors import ExportError, Hid2Error
from netconvert.fidelity import measure_fidelity
from netconvert.net_xml import net_bytes

#: Most scenes that a process gets at a time.
_CHUNK = 40
#: Most vehicles that the classifier test looks at.
_MOST_SAMPLES = 50_000
#: Nets of at most this many different maps are measured.
_MOST_NETS = 20
PAIRS = ("original_original", "generated_original", "generated_generated")


@dataclass(eq=False, slots=True)
class ManeuverCounts:
    """Manoeuvres asked for by kind and status, whether they were seen, reasons, and delays from trigger to start."""

    status: Counter[tuple[str, str]] = field(default_factory=Counter)
    seen: Counter[tuple[str, str]] = field(default_factory=Counter)
    reasons: Counter[tuple[str, str, str]] = field(default_factory=Counter)
    unasked: Counter[str] = field(default_factory=Counter)
    delays: dict[str, list[float]] = field(default_factory=dict)

    def add(self, rows: Iterable[Row]) -> None:
        """Count manoeuvre rows of generated vehicles."""
        for row in rows:
            if row["group"] != "generated":
                continue
            kind, status = row["kind"], row["status"]
            if not row["recorded"]:
                if row["part_of"] is None and row["seen_complete"]:
                    self.unasked[kind] += 1
                continue
            self.status[kind, status] += 1
            self.seen[kind, status] += row["seen"] is not None
            if row["reason"]:
                self.reasons[kind, status, row["reason"]] += 1
            if row["trigger_s"] is not None and row["start_s"] is not None:
                self.delays.setdefault(kind, []).append(row["start_s"] - row["trigger_s"])


@dataclass(eq=False, slots=True)
class Evaluation:
    """What is known of a folder after the pass; `metrics` is the content of metrics.json.

    scenes: one row per scene; before: rows of the source scenes where a source was given; failures: scenes that could
    not be read, with the reason.
    """

    scenes: SceneTable = field(default_factory=SceneTable)
    before: SceneTable = field(default_factory=SceneTable)
    failures: list[tuple[Path, str]] = field(default_factory=list)
    realism: RealismCounts = field(default_factory=RealismCounts)
    maneuvers: ManeuverCounts = field(default_factory=ManeuverCounts)
    metrics: dict[str, Any] = field(default_factory=dict)


@dataclass(eq=False, slots=True)
class _Samples:
    """Vectors for the classifier test; the recorded vehicles of a source scene count once."""

    x: list[FloatArray] = field(default_factory=list)
    generated: list[BoolArray] = field(default_factory=list)
    scenes: list[str] = field(default_factory=list)
    known: set[str] = field(default_factory=set)

    def add(self, measures: SceneMeasures) -> None:
        if len(self.scenes) >= _MOST_SAMPLES:
            return
        source = str(measures.scene["source"])
        keep = measures.sample_generated | (source not in self.known)
        self.known.add(source)
        self.x.append(measures.samples[keep])
        self.generated.append(measures.sample_generated[keep])
        self.scenes += [source] * int(keep.sum())

    def test(self, columns: int | None = None) -> float | None:
        if not self.scenes:
            return None
        return classifier_test(np.concatenate(self.x)[:, :columns], np.concatenate(self.generated), self.scenes)


def evaluate_folder(
    out: Path,
    *,
    report_dir: Path,
    source: Path | None = None,
    jobs: int = 1,
    on_scene: Callable[[int, int], None] | None = None,
) -> Evaluation:
    """Measure every scene below `out`, recorded or generated, and write the report into `report_dir`.

    Writes metrics.json, scenes.csv, tracks.csv, maneuvers.csv, realism.csv and report.html. `source`: where the
    recorded scenes are; "before" is then every scene there, else the recorded tracks of the scenes in `out`. A scene
    that cannot be read is listed and left out. on_scene(done, total) is called as scenes are done.
    Errors: ScenarioError where there is no scene; ExportError where the report cannot be written.
    """
    from bridge.report import write_report  # matplotlib: only this half needs it

    folders = sorted(find_scenarios(out), key=_map_size)
    sources = find_scenarios(source) if source is not None else []
    evaluation, samples = Evaluation(), _Samples()
    try:
        report_dir.mkdir(parents=True, exist_ok=True)
        with (
            (report_dir / "tracks.csv").open("w", newline="") as tracks,
            (report_dir / "maneuvers.csv").open("w", newline="") as maneuvers,
        ):
            tables = _Table(tracks), _Table(maneuvers)
            for done, (folder, measures) in enumerate(_measured([*folders, *sources], jobs=jobs), 1):
                if isinstance(measures, Failure):
                    evaluation.failures.append((folder, measures.message))
                elif done > len(folders):
                    evaluation.before.append(measures.scene)
                else:
                    evaluation.scenes.append(measures.scene)
                    evaluation.realism.add(measures.realism)
                    evaluation.maneuvers.add(measures.maneuvers)
                    samples.add(measures)
                    tables[0].write(measures.tracks)
                    tables[1].write(measures.maneuvers)
                if on_scene is not None:
                    on_scene(done, len(folders) + len(sources))
        evaluation.metrics = _metrics(evaluation, samples)
        _write_tables(evaluation, report_dir)
        write_report(evaluation, report_dir / "report.html")
    except OSError as error:
        raise ExportError(f"{report_dir}: cannot write the report ({error})") from error
    return evaluation


def _measured(folders: Sequence[Path], *, jobs: int) -> Iterator[tuple[Path, SceneMeasures | Failure]]:
    """Measures of each folder, in the order of the folders whatever the order in which they are done."""
    size = max(1, min(_CHUNK, len(folders) // (4 * jobs)))
    chunks = [tuple(folders[start : start + size]) for start in range(0, len(folders), size)]
    tasks = (
        Task(f"evaluate-{number}", "bridge.scene_metrics:measure_folders", Limits(), chunk)
        for number, chunk in enumerate(chunks)
    )
    waiting: dict[int, list[tuple[Path, SceneMeasures | Failure]]] = {}
    following = 0
    for result in execute_here(tasks, jobs=min(jobs, max(1, len(chunks))), settings=Settings(timeout_s=120)):
        number = int(result.task.key.removeprefix("evaluate-"))
        waiting[number] = [(outcome.item, outcome.failure or outcome.value) for outcome in result.outcomes]
        while following in waiting:
            yield from waiting.pop(following)
            following += 1


def _map_size(folder: Path) -> int:
    """Bytes of a scene's map: scenes in this order have those of one map together, so that it is read once."""
    return sum(path.stat().st_size for path in folder.glob("log_map_archive_*.json"))


class _Table:
    """A CSV file that grows row by row; columns are those of its first row."""

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream
        self._writer: csv.DictWriter[str] | None = None

    def write(self, rows: Iterable[Row]) -> None:
        for row in rows:
            if self._writer is None:
                self._writer = csv.DictWriter(self._stream, list(row))
                self._writer.writeheader()
            self._writer.writerow({key: _cell(value) for key, value in row.items()})


def _cell(value: object) -> object:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, dict):
        return "; ".join(f"{key} ({count})" for key, count in value.items())
    return "" if value is None else value


def _write_tables(evaluation: Evaluation, report_dir: Path) -> None:
    text = json.dumps(evaluation.metrics, indent=1, allow_nan=False)
    (report_dir / "metrics.json").write_text(text + "\n", encoding="utf-8")
    with (report_dir / "scenes.csv").open("w", newline="") as stream:
        _Table(stream).write(dict(row) for row in evaluation.scenes)
    with (report_dir / "realism.csv").open("w", newline="") as stream:
        _Table(stream).write(evaluation.metrics["realism"]["distances"])


def _metrics(evaluation: Evaluation, samples: _Samples) -> dict[str, Any]:
    rows = evaluation.scenes
    return {
        "scenes": {
            "scenes": len(rows),
            "sources": len({row["source"] for row in rows}),
            "generated_scenes": sum(row["generated"] > 0 for row in rows),
            "generated_vehicles": sum(row["generated"] for row in rows),
            "failed": [{"folder": str(folder), "reason": reason} for folder, reason in evaluation.failures],
        },
        "kinematics": {"paper": table(rows, KINEMATIC), "clean": table(rows, CLEAN), "limits": table(rows, LIMITS)},
        "safety": table(rows, SAFETY) | {"pairs": _pairs(rows)},
        "diversity": diversity(rows, evaluation.before),
        "realism": {
            "distances": [
                {
                    "feature": d.feature.name,
                    "unit": d.feature.unit,
                    "jensen_shannon": d.jensen_shannon,
                    "jensen_shannon_floor": d.jensen_shannon_floor,
                    "jensen_shannon_ratio": _ratio(d.jensen_shannon, d.jensen_shannon_floor),
                    "wasserstein": d.wasserstein,
                    "wasserstein_floor": d.wasserstein_floor,
                    "generated_samples": d.generated,
                    "recorded_samples": d.recorded,
                }
                for d in evaluation.realism.distances()
            ],
            "classifier_auc": samples.test(),
            "classifier_auc_driving": samples.test(len(DRIVING_FEATURES)),
        },
        "requests": _requests(rows, evaluation.maneuvers),
        "replay": {
            "states": sum(row["replay_states"] for row in rows),
            "max_position_error_m": max((row["replay_position_error_m"] or 0.0 for row in rows), default=0.0),
        },
        "nets": _nets(rows),
    }


def _ratio(value: float | None, floor: float | None) -> float | None:
    return value / floor if value is not None and floor else None


def _pairs(rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, int]]:
    kinds = ("pairs_vehicles", "pairs_all", "touching_all", "crossings", "pet_critical")
    return {kind: {name: sum(row[f"{kind}_{name}"] for row in rows) for name in PAIRS} for kind in kinds}


def _requests(rows: Sequence[Mapping[str, Any]], maneuvers: ManeuverCounts) -> dict[str, Any]:
    rejected: Counter[str] = Counter()
    for row in rows:
        rejected.update(row.get("rejected") or {})
    asked = [row for row in rows if row["requested"] is not None]
    kinds = sorted({kind for kind, _ in maneuvers.status})
    return {
        "requested": sum(row["requested"] for row in asked),
        "placed": sum(row["placed"] for row in rows),
        "placed_of_requested": sum(row["placed"] for row in asked),
        "rejected": dict(rejected.most_common()),
        "maneuvers": {kind: _maneuver(kind, maneuvers) for kind in kinds},
        "seen_without_record": dict(sorted(maneuvers.unasked.items())),
    }


def _maneuver(kind: str, counts: ManeuverCounts) -> dict[str, Any]:
    statuses = ("done", "aborted", "not_feasible", "not_triggered")
    delays = counts.delays.get(kind, [])
    return {
        **{status: counts.status[kind, status] for status in statuses},
        "done_and_seen": counts.seen[kind, "done"],
        "reasons": {
            f"{status}: {reason}": count
            for (name, status, reason), count in counts.reasons.most_common()
            if name == kind
        },
        "median_trigger_to_start_s": float(np.median(delays)) if delays else None,
    }


def _nets(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Fidelity of the nets of the first maps."""
    folders: Mapping[str, str] = {str(row["source"]): str(row["folder"]) for row in reversed(rows)}
    nets: dict[str, Any] = {}
    for source in sorted(folders)[:_MOST_NETS]:
        try:
            grid = build_cell_grid(read_lane_graph(next(Path(folders[source]).glob("log_map_archive_*.json"))))
            report = measure_fidelity(grid, net_bytes(grid))
        except Hid2Error as error:
            nets[source] = {"failed": str(error)}
            continue
        nets[source] = {
            "lanes": report.lanes_in,
            "lanes_in_net": report.lanes_out,
            "cells": report.cells_out,
            "largest_distance_m": report.largest_distance_m,
            "successors": report.successors_in,
            "successors_kept": report.successors_kept,
            "neighbors": report.neighbors_in,
            "neighbors_kept": report.neighbors_kept,
        }
    return nets
