"""What a scene process does: generate and write the runs on one scene. Imports libsumo, so the caller must not."""

import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from bridge.batch.batch import Place, Run, base_row
from bridge.batch.isolation import Failure, attempts
from bridge.batch.manifest import ManifestRow, files_sha256, output_files
from bridge.generation.generate import PreparedScene, generate, prepare
from bridge.generation.scene import TrafficScene
from bridge.recordings.export import check_step
from bridge.recordings.recording import Recording
from bridge.recordings.sidecar import DrivesRecord, EventRecord, Sidecar
from bridge.recordings.sources import read_recording
from hid2.agents import Policy
from hid2.params import Grid

_FOUND = sys.modules["libsumo"]  # imported with what generates
if not hasattr(_FOUND, "simulation"):  # a file of that name in the way is found before the first scene
    raise ImportError(f"{getattr(_FOUND, '__file__', None) or _FOUND}: not SUMO's libsumo, rename it or move it away")


def write_all(scene: TrafficScene, place: Place) -> Path:
    """Write a scene, with what was asked for beside; returns its folder. Errors: ExportError."""
    if place.argoverse1:
        from bridge.recordings.sequence import write_sequence

        assert scene.source is not None
        write_sequence(scene.source, scene.generated, place.out, new_id=scene.recording.scenario_id)
    return scene.write(place.out, record=("gaps",) if place.gaps else ())


def generate_runs(
    place: Place, runs: Sequence[Run], finish: Callable[[TrafficScene, Place], Path] = write_all
) -> Iterator[ManifestRow | Failure]:
    """Read the scene and build its net once, generate each run, let `finish` write it to a folder."""
    prepared: dict[Grid, PreparedScene] = {}

    @cache
    def source() -> Recording:
        found = read_recording(place.folder)
        check_step(found)
        return found

    def made(run: Run) -> ManifestRow:
        scenario, grid = source(), run.config.grid
        if grid not in prepared:
            prepared[grid] = prepare(scenario, run.config)
        scene = generate(prepared[grid], run.config, variant=run.variant)
        folder = finish(scene, place)
        assert scene.sidecar is not None
        return summarise(scene.sidecar, base_row(place, run))._replace(
            city=scenario.city,
            recorded=len(scenario.tracks),
            folder=folder.relative_to(place.out).as_posix(),
            output_sha256=files_sha256(output_files(folder)),
        )

    return attempts(made, runs)


def summarise(sidecar: Sidecar, row: ManifestRow) -> ManifestRow:
    """Add what a sidecar says about vehicles, manoeuvres and events."""
    maneuvers = [record for _, record in sidecar.asked]
    # passing a standing vehicle is finished, but it is no overtake: it has a reason too
    finished = (maneuver for maneuver in maneuvers if maneuver.status == "done" and maneuver.reason is None)
    done: Counter[str] = Counter(maneuver.kind for maneuver in finished)
    not_done = Counter(
        f"{maneuver.kind}: {maneuver.reason or maneuver.status}"
        for maneuver in maneuvers
        if maneuver.status != "done" or maneuver.reason is not None
    )
    not_done.update(
        f"{event.kind} with {event.target}: {event.reason or event.status}"
        for event in sidecar.events
        if event.status != "done"
    )
    return row._replace(
        placed=sidecar.placed.agents,
        near=sidecar.placed.near,
        **dict[str, Any](done),  # columns have the names of the kinds
        straight=sidecar.placed.behaviours.get(Policy.STRAIGHT, 0),
        maneuvers_requested=len(maneuvers),
        maneuvers_done=sum(done.values()),
        events_requested=len(sidecar.events),
        events_done=sum(event.status == "done" for event in sidecar.events),
        events="; ".join(told_of(event) for event in sidecar.events if event.status == "done"),
        rejected=join_counts({entry.reason: entry.count for entry in sidecar.rejected}),
        not_done=join_counts(not_done),
        **_selection(sidecar),
    )


def told_of(event: EventRecord) -> str:
    """An event that came about, in a few words: the two vehicles, when, and how critical it was."""
    figures = {"gap": (event.gap_m, "m"), "TTC": (event.min_ttc_s, "s"), "PET": (event.pet_s, "s")}
    at = {"TTC": "" if event.ttc_at_s is None else f" at {event.ttc_at_s:.1f} s"}
    told = ", ".join(
        f"{name} {value:.1f} {unit}{at.get(name, '')}" for name, (value, unit) in figures.items() if value is not None
    )
    return f"{event.kind} of {event.track_id} with {event.target_track_id} at {event.at_s:.1f} s ({told})"


def _selection(sidecar: Sidecar) -> dict[str, Any]:
    """What tells of the selection."""
    told = sidecar.selection
    assert told is not None
    found: dict[str, Any] = {"driven": told.driven}
    for name in ("kept", "dropped", "recorded"):
        of: DrivesRecord = getattr(told, name)
        found |= {
            f"braking_{name}": round(of.braking / max(1, of.vehicles), 4),
            f"standing_{name}": round(of.standing / max(1, of.vehicles), 4),
        }
        if name != "recorded":
            found[f"limited_{name}"] = round(of.limited / max(1, of.steps), 4)
    return found


def join_counts(counts: Mapping[str, int]) -> str:
    """One text "reason (count); ...", most frequent first."""
    ordered = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    return "; ".join(f"{reason} ({count})" for reason, count in ordered)
