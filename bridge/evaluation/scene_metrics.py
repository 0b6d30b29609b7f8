"""Every measure of one scene folder: a row for the scene, one per track, one per manoeuvre, and histograms."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bridge.batch.isolation import Failure, attempt_each
from bridge.files import read_regular
from bridge.recordings.export import recording_record_of
from bridge.recordings.folders import Address, Source
from bridge.recordings.limits import MAX_FILE_MB, check_ground
from bridge.recordings.map_rules import read_source_map
from bridge.recordings.scenario import (
    Rows,
    read_scenario,
    read_sizes,
    read_table,
    recording_record,
    split_of,
    split_rows,
)
from bridge.recordings.sidecar import REACTIVE, ManeuverRecord, RecordingRecord, Sidecar, sidecar_in
from bridge.recordings.sources import read_recording
from hid2.agents import BoxSize, FloatArray, Policy, Track
from hid2.evaluation.behaviour import policies
from hid2.evaluation.critics import pack
from hid2.evaluation.kinematics import Kinematics, Motion, beyond_limits, kinematics, motion
from hid2.evaluation.metrics import CRITICAL, GROUPS, Group, last_step_counts, measure_group
from hid2.evaluation.realism import RealismCounts, count_scene, half_number, scene_values
from hid2.evaluation.safety import IOU_THRESHOLD, PreparedMap, Safety, prepare_map, safety
from hid2.evaluation.windows import is_labelled, windows
from hid2.measures.arrays import BoolArray, SceneArrays, stack
from hid2.measures.encounters import encounters
from hid2.measures.manoeuvres import Maneuver, ManeuverKind, detect
from hid2.measures.scene_end import Contact, contacts_after_last_step
from hid2.params import Limits
from netconvert.errors import ScenarioError

#: A manoeuvre seen belongs to a record of its kind whose crossing (or start) is at most this far away.
SAME_MANEUVER_S = 2.0
#: Maps kept while scenes are measured.
_MOST_MAPS = 8

Row = dict[str, Any]
#: Sizes of recorded tracks by the id of their scene, then of the track.
Labelled = Mapping[str, Mapping[str, BoxSize]]


@dataclass(frozen=True, eq=False, slots=True)
class SceneMeasures:
    """What evaluation keeps of a scene. samples (M, WIDTH), sample_generated (M,): windows for the critics."""

    scene: Row
    tracks: list[Row]
    maneuvers: list[Row]
    events: list[Row]
    realism: RealismCounts
    samples: FloatArray
    sample_generated: BoolArray


@dataclass(frozen=True, eq=False, slots=True)
class _View:
    arrays: SceneArrays
    moved: Motion
    kinematic: Kinematics
    safe: Safety
    maneuvers: list[Maneuver]
    limits: Mapping[str, BoolArray]
    after_end: Mapping[int, Contact]
    """First contacts after the last step, by agent: of recorded ones with recorded ones, of inserted ones with any."""


def measure_folders(
    limits: Limits, folders: Sequence[Address], labelled: Labelled | None = None
) -> Iterator[SceneMeasures | Failure]:
    """The work of a process: measure each folder; a folder that cannot be read gives its failure."""
    maps = Maps()
    return attempt_each(lambda folder: measure_folder(folder, limits, maps, labelled), folders)


class Maps:
    """The last maps read, by their content: scenes made from one share its map, and reading it takes longest."""

    def __init__(self) -> None:
        self._known: dict[bytes, PreparedMap] = {}

    def read(self, path: Path) -> PreparedMap:
        """The map in a file, which keeps the rules and limits of a source's. Errors: MapError."""
        try:
            content = read_regular(path, most_mb=MAX_FILE_MB)
        except OSError:
            content = b""  # what is wrong is said below
        ground = self._known.pop(content, None) or prepare_map(read_source_map(path))
        self._known[content] = ground  # the last one used comes last
        while len(self._known) > _MOST_MAPS:
            self._known.pop(next(iter(self._known)))
        return ground


def measure_folder(folder: Address, limits: Limits, maps: Maps, labelled: Labelled | None = None) -> SceneMeasures:
    """Measure one recording or generated scene. Errors: ScenarioError, MapError.

    labelled: sizes of the recorded tracks of source scenes, for generated ones whose sidecar does not have them.
    """
    rows, ground, known = _read(folder, maps)
    sidecar = sidecar_in(folder, rows.scenario_id) if isinstance(folder, Path) else None
    if sidecar is not None and sidecar.replay.mode == "reactive":
        raise ScenarioError(f"{folder}: {REACTIVE}")
    sizes = (labelled or {}).get(sidecar.source_scenario_id, {}) if sidecar else {}
    measures = measure(
        [replace(t, size=sizes[t.track_id]) if t.track_id in sizes else t for t in rows.tracks]
        if sizes
        else rows.tracks,
        ground,
        sidecar,
        limits=limits,
        num_steps=rows.num_steps,
        source=sidecar.source_scenario_id if sidecar else rows.scenario_id,
        observed_steps=known.observed_steps,
        step_s=known.step_s,
    )
    return _named(measures, rows, folder, known)


def _read(folder: Address, maps: Maps) -> tuple[Rows, PreparedMap, RecordingRecord]:
    """As read_recording, but the map of a folder that is known is not read again."""
    if isinstance(folder, Source):
        scenario = read_recording(folder)
        rows = Rows(
            scenario.scenario_id, scenario.city, scenario.focal_track_id, scenario.num_steps, scenario.tracks,
            scenario.observed_steps, scenario.step_s,
        )  # fmt: skip
        return rows, prepare_map(scenario.graph), recording_record_of(scenario)
    tables, files = list(folder.glob("scenario_*.parquet")), list(folder.glob("log_map_archive_*.json"))
    if len(tables) != 1 or len(files) != 1:
        read_scenario(folder)  # says what is wrong
        raise ScenarioError(f"{folder}: {len(tables)} scenarios and {len(files)} maps, expected one of each")
    known = recording_record(folder)
    rows = split_rows(
        read_table(tables[0]), name=str(tables[0]), sizes=read_sizes(folder), observed_steps=known.observed_steps
    )
    ground = maps.read(files[0])
    check_ground(rows.tracks, ground.graph, str(folder))
    return rows, ground, known


def measure(
    tracks: Sequence[Track],
    ground: PreparedMap,
    sidecar: Sidecar | None,
    *,
    limits: Limits,
    num_steps: int,
    source: str,
    observed_steps: int,
    step_s: float,
) -> SceneMeasures:
    """Measure tracks on a map. `source`: id of the recorded scene; observed_steps, step_s: of its data set."""
    arrays = stack(tracks, num_steps=num_steps, step_s=step_s)
    last_observed = min(observed_steps, num_steps) - 1
    moved = motion(arrays)
    safe = safety(arrays, ground)
    maneuvers = detect(arrays, safe.lanes, safe.matches)
    policy_of = policies(arrays, maneuvers)
    kinematic = kinematics(arrays, moved)
    beyond = beyond_limits(moved, limits)
    groups = _groups(arrays, kinematic, safe, beyond)
    view = _View(
        arrays,
        moved,
        kinematic,
        safe,
        maneuvers,
        beyond,
        {**groups["original"].end_contacts, **groups["generated"].end_contacts},
    )
    scene: Row = {
        "source": source,
        "steps": arrays.num_steps,
        "tracks": arrays.num_agents,
        "tracks_at_49": int((arrays.row_of[:, last_observed] >= 0).sum()),
        "generated": int(arrays.generated.sum()),
        "generated_at_49": int((arrays.row_of[arrays.generated, last_observed] >= 0).sum()),
    }
    for group in GROUPS:
        row = _group_row(groups[group], maneuvers, policy_of)
        scene |= {f"{group}_{key}": value for key, value in row.items()}
    scene |= _pair_row(view)
    scene |= _request_row(sidecar)
    durations: dict[str, list[float]] = {}
    for maneuver in maneuvers:
        if maneuver.kind is ManeuverKind.LANE_CHANGE and maneuver.complete:
            durations.setdefault(maneuver.track_id, []).append(maneuver.duration_s)
    vehicles = arrays.vehicle & arrays.moving
    generated, recorded = vehicles & arrays.generated, vehicles & ~arrays.generated & ~arrays.fragment
    driving = windows(arrays, safe, generated | recorded)
    halves = np.array([half_number(source, arrays.track_ids[a]) for a in driving.agent], dtype=np.int64)
    return SceneMeasures(
        scene=scene,
        tracks=_track_rows(view, policy_of, sidecar),
        maneuvers=_maneuver_rows(view, sidecar),
        events=[event.model_dump(mode="json") for event in sidecar.events] if sidecar else [],
        realism=count_scene(
            source, arrays, scene_values(arrays, safe, driving, durations), generated=generated, recorded=recorded
        ),
        samples=pack(driving, halves, labelled=is_labelled(arrays)),
        sample_generated=arrays.generated[driving.agent],
    )


def _groups(
    arrays: SceneArrays, kinematic: Kinematics, safe: Safety, beyond: Mapping[str, BoolArray]
) -> dict[str, Group]:
    """Recorded agents, generated ones, and both."""
    everybody = np.ones(arrays.num_agents, dtype=bool)
    met = encounters(arrays, safe.lanes, safe.matches, safe.leaders)
    groups = {}
    # whom a group's vehicles may touch: what was added any road user, what was recorded what was recorded
    for name, members, others in (
        ("original", ~arrays.generated, ~arrays.generated),
        ("generated", arrays.generated, everybody),
        ("combined", everybody, everybody),
    ):
        groups[name] = Group(
            arrays=arrays,
            kinematic=kinematic,
            safe=safe,
            beyond=beyond,
            members=members,
            partners=others if name == "generated" else others & arrays.vehicle,  # as in the paper's SCR
            end_contacts=contacts_after_last_step(
                arrays, members & last_step_counts(arrays), horizon_s=CRITICAL.end_horizon_s, among=others
            ),
            met=met,
        )
    return groups


def _named(measures: SceneMeasures, scene: Rows, folder: Address, known: RecordingRecord) -> SceneMeasures:
    """Put the scene's names in front of every row."""
    name: Row = {"scenario_id": scene.scenario_id}
    place: Row = {"split": split_of(folder) or "", "city": scene.city, "folder": str(folder)}
    place |= {"format": known.format, "provenance": known.provenance}
    return SceneMeasures(
        scene=name | place | measures.scene,
        tracks=[name | row for row in measures.tracks],
        maneuvers=[name | row for row in measures.maneuvers],
        events=[name | {"folder": str(folder)} | row for row in measures.events],
        realism=measures.realism,
        samples=measures.samples,
        sample_generated=measures.sample_generated,
    )


def _group_row(group: Group, maneuvers: Sequence[Maneuver], policy_of: Mapping[str, Policy]) -> Row:
    """Sums and counts of one group; ratios are formed when scenes are pooled."""
    arrays = group.arrays
    moving = group.vehicles & arrays.moving
    row: Row = {
        "agents": int(group.members.sum()),
        "vehicles": int(group.vehicles.sum()),
        "moving": int(moving.sum()),
        "colliding": group.colliding,
    }
    row |= measure_group(group)
    counts = Counter(policy_of[arrays.track_ids[a]] for a in np.flatnonzero(moving))
    row |= {f"policy_{policy.value}": counts[policy] for policy in Policy}
    ids = {arrays.track_ids[a] for a in np.flatnonzero(group.members)}
    seen = Counter(m.kind for m in maneuvers if m.track_id in ids and m.part_of is None)
    row |= {f"seen_{kind.value}": seen[kind] for kind in ManeuverKind}
    return row


def _pair_row(view: _View) -> Row:
    """Colliding pairs (IoU above the threshold), pairs that touch at all, and PET, by who is involved."""
    row: Row = {}
    names = ("original_original", "generated_original", "generated_generated")
    generated = view.arrays.generated
    vehicle = view.arrays.vehicle
    for kind in ("pairs_vehicles", "pairs_all", "touching_all", "crossings", "pet_critical"):
        row |= {f"{kind}_{name}": 0 for name in names}
    for pair in view.safe.overlaps:
        name = names[int(generated[pair.first]) + int(generated[pair.second])]
        row[f"touching_all_{name}"] += 1
        if pair.iou > IOU_THRESHOLD:
            row[f"pairs_all_{name}"] += 1
            row[f"pairs_vehicles_{name}"] += int(vehicle[pair.first] and vehicle[pair.second])
    for crossing in view.safe.encroachments:
        name = names[int(generated[crossing.first]) + int(generated[crossing.second])]
        row[f"crossings_{name}"] += 1
        row[f"pet_critical_{name}"] += int(crossing.pet_s < CRITICAL.pet_min_s)
    return row


def _request_row(sidecar: Sidecar | None) -> Row:
    if sidecar is None:
        unknown = ("replay_position_error_m", "replay_heading_error_rad", "rejected", "seed", "variant")
        return {"requested": None, "placed": 0, "replay_states": 0} | dict.fromkeys(unknown)
    asked = sidecar.requested.agents
    return {
        "requested": asked if isinstance(asked, int) else None,
        "placed": sidecar.placed.agents,
        "replay_states": sidecar.replay.states,
        "replay_position_error_m": sidecar.replay.max_position_error_m,
        "replay_heading_error_rad": sidecar.replay.max_heading_error_rad,
        "rejected": {item.reason: item.count for item in sidecar.rejected},
        "seed": sidecar.seed,
        "variant": sidecar.variant,
    }


def _track_rows(view: _View, policy_of: Mapping[str, Policy], sidecar: Sidecar | None) -> list[Row]:
    arrays, safe, kinematic = view.arrays, view.safe, view.kinematic
    asked = {agent.track_id: agent.policy.value for agent in sidecar.agents} if sidecar else {}
    collides_generated = np.zeros(arrays.num_agents, dtype=bool)
    collides_original = np.zeros(arrays.num_agents, dtype=bool)
    for pair in safe.overlaps:
        if pair.iou > IOU_THRESHOLD:
            for one, other in ((pair.first, pair.second), (pair.second, pair.first)):
                (collides_generated if arrays.generated[other] else collides_original)[one] = True
    sums = {
        "off_road_steps": arrays.sum_per_agent(safe.off_road),
        "off_footprint_steps": arrays.sum_per_agent(safe.off_footprint),
        "against_lane_steps": arrays.sum_per_agent(safe.against_lane),
        **{f"beyond_{name}_steps": arrays.sum_per_agent(mask) for name, mask in view.limits.items()},
    }
    speed = arrays.mean_per_agent(view.moved.speed)
    starts = arrays.first[:-1]
    min_ttc = np.minimum.reduceat(safe.ttc_s, starts) if len(starts) else starts
    min_leader = np.minimum.reduceat(safe.leaders.ttc_s, starts) if len(starts) else starts
    min_gap = np.minimum.reduceat(safe.leaders.time_gap_s, starts) if len(starts) else starts
    rows: list[Row] = []
    for a in range(arrays.num_agents):
        track_id = arrays.track_ids[a]
        policy = policy_of.get(track_id)
        rows.append(
            {
                "track_id": track_id,
                "group": "generated" if arrays.generated[a] else "original",
                "object_type": arrays.object_types[a],
                "category": int(arrays.category[a]),
                "steps": int(arrays.rows_per_agent[a]),
                "moving": bool(arrays.moving[a]),
                "policy_requested": asked.get(track_id),
                "policy_seen": policy.value if policy is not None else None,
                "mean_speed_mps": float(speed[a]),
                "lo_mps2": float(kinematic.lo[a]),
                "la_mps2": float(kinematic.la[a]),
                "je_mps3": float(kinematic.je[a]),
                "collides_with_original": bool(collides_original[a]),
                "collides_with_generated": bool(collides_generated[a]),
                "min_ttc_s": float(min_ttc[a]),
                "min_leader_ttc_s": _finite(min_leader[a]),
                "min_time_gap_s": _finite(min_gap[a]),
                "end_ttc_s": view.after_end[a].ttc_s if a in view.after_end else None,
                **{name: int(values[a]) for name, values in sums.items()},
            }
        )
    return rows


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _maneuver_rows(view: _View, sidecar: Sidecar | None) -> list[Row]:
    """Records of the sidecar joined with what was seen, then what was seen without a record."""
    left = list(view.maneuvers)
    rows: list[Row] = []
    for agent in sidecar.agents if sidecar else ():
        for record in agent.maneuvers:
            found = _seen(agent.track_id, record, left)
            if found is not None:
                left.remove(found)
            known: Row = {"track_id": agent.track_id, "group": "generated", "kind": record.kind, "recorded": True}
            rows.append(known | _record_row(record) | _seen_row(found))
    generated = {view.arrays.track_ids[a] for a in np.flatnonzero(view.arrays.generated)}
    for maneuver in left:
        group = "generated" if maneuver.track_id in generated else "original"
        unasked: Row = {"track_id": maneuver.track_id, "group": group, "kind": maneuver.kind.value, "recorded": False}
        rows.append(unasked | _record_row(None) | _seen_row(maneuver))
    return rows


def _seen(track_id: str, record: ManeuverRecord, candidates: Sequence[Maneuver]) -> Maneuver | None:
    """The manoeuvre seen that a record tells of."""
    kinds = (
        {record.kind, ManeuverKind.PASS, ManeuverKind.OBSTACLE_AVOIDANCE}
        if record.kind == "overtake"
        else {record.kind}
    )
    same = [m for m in candidates if m.track_id == track_id and m.kind in kinds]
    at = record.crossing_s if record.crossing_s is not None else record.start_s
    if at is None or not same:
        return None
    nearest = min(same, key=lambda m: abs(m.crossing_s - at))
    inside = nearest.start_s - SAME_MANEUVER_S <= at <= nearest.end_s + SAME_MANEUVER_S
    return nearest if inside else None


def _record_row(record: ManeuverRecord | None) -> Row:
    times = ("trigger_s", "requested_s", "start_s", "crossing_s", "end_s")
    names = ("status", "reason", *times, "gap_front_m", "gap_rear_m", "min_ttc_s", "leader_track_id")
    return {name: getattr(record, name) if record is not None else None for name in names}


def _seen_row(maneuver: Maneuver | None) -> Row:
    if maneuver is None:
        return {"seen": None, "seen_start_s": None, "seen_crossing_s": None, "seen_end_s": None, "seen_complete": None,
                "source_lane": None, "target_lane": None, "other_track_id": None, "part_of": None}  # fmt: skip
    return {
        "seen": maneuver.kind.value,
        "seen_start_s": maneuver.start_s,
        "seen_crossing_s": maneuver.crossing_s,
        "seen_end_s": maneuver.end_s,
        "seen_complete": maneuver.complete,
        "source_lane": maneuver.source_lane,
        "target_lane": maneuver.target_lane,
        "other_track_id": maneuver.other_track_id,
        "part_of": maneuver.part_of.value if maneuver.part_of else None,
    }
