"""What a scene process does: generate and write the runs on one scene. Imports libsumo, so the caller must not."""

import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from bridge.batch.batch import Run, SceneFolders, base_row
from bridge.batch.isolation import Failure, attempts
from bridge.batch.manifest import ManifestRow
from bridge.generation.generate import PreparedScene, generate, prepare
from bridge.recordings.export import check_step
from bridge.recordings.sidecar import EventRecord, Sidecar
from bridge.recordings.sources import read_recording
from hid2.agents import Policy

_FOUND = sys.modules["libsumo"]  # imported with what generates
if not hasattr(_FOUND, "simulation"):  # a file of that name in the way is found before the first scene
    raise ImportError(f"{getattr(_FOUND, '__file__', None) or _FOUND}: not SUMO's libsumo, rename it or move it away")


def generate_runs(place: SceneFolders, runs: Sequence[Run]) -> Iterator[ManifestRow | Failure]:
    """Read the scene and build its grid once, then generate and write each run; their grid is the same."""
    prepared: PreparedScene | None = None

    def made(run: Run) -> ManifestRow:
        nonlocal prepared
        if prepared is None:
            recording = read_recording(place.folder)
            check_step(recording)
            prepared = prepare(recording, run.config)
        scene = generate(prepared, run.config, variant=run.variant)
        if place.argoverse1:
            from bridge.recordings.argoverse1 import write_sequence

            write_sequence(prepared.scenario, scene.generated, place.out, new_id=scene.recording.scenario_id)
        row = base_row(place, run, scene.write(place.out, record=("gaps",) if place.gaps else ()))
        assert scene.sidecar is not None
        found = prepared.scenario
        return summarise(scene.sidecar, row)._replace(city=found.city, recorded=len(found.tracks))

    return attempts(made, runs)


def summarise(sidecar: Sidecar, row: ManifestRow) -> ManifestRow:
    """Add what a sidecar says about vehicles, manoeuvres and events."""
    # passing a standing vehicle is finished, but it is no overtake: it has a reason too
    maneuvers = [(one.kind, one.reason or ("" if one.status == "done" else one.status)) for _, one in sidecar.asked]
    missed = [event for event in sidecar.events if event.status != "done"]
    events = [(f"{event.kind} with {event.target}", event.reason or event.status) for event in missed]
    done = Counter[str](kind for kind, why in maneuvers if not why)
    not_done = Counter(f"{what}: {why}" for what, why in (*maneuvers, *events) if why)
    return row._replace(
        placed=sidecar.placed.agents,
        near=sidecar.placed.near,
        entered=sidecar.placed.entered,
        focal=sidecar.placed.focal or "",
        **dict[str, Any](done),  # columns have the names of the kinds
        straight=sidecar.placed.behaviours.get(Policy.STRAIGHT, 0),
        maneuvers_requested=len(maneuvers),
        maneuvers_done=sum(done.values()),
        events_requested=len(sidecar.events),
        events_done=len(sidecar.events) - len(missed),
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
    found: dict[str, Any] = {"driven": told.kept.vehicles + told.dropped.vehicles}
    for name, of in told:
        for what in ("braking", "standing"):
            found[f"{what}_{name}"] = round(getattr(of, what) / max(1, of.vehicles), 4)
        if of is not told.recorded:
            found[f"limited_{name}"] = round(of.limited / max(1, of.steps), 4)
    return found


def join_counts(counts: Mapping[str, int]) -> str:
    """One text "reason (count); ...", most frequent first."""
    return "; ".join(f"{one} ({counts[one]})" for one in sorted(counts, key=lambda one: (-counts[one], one)))
