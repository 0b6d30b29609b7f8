"""Every measure of one scene folder: a row for the scene, one per track, one per manoeuvre, and histograms."""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bridge.config import asked_for
from bridge.generation.scene import TrafficScene
from bridge.recordings.folders import Address, split_of
from bridge.recordings.judging import findings_of, recording_states
from bridge.recordings.recording import Recording
from bridge.recordings.scenario import log_of
from bridge.recordings.sidecar import REACTIVE, EventRecord, ManeuverRecord, Sidecar
from bridge.recordings.sources import read_recording
from hid2.agents import AV_ID, FloatArray, Policy, Track
from hid2.evaluation.kinematics import kinematics, motion
from hid2.evaluation.metrics import CRITICAL, METRICS, Group, columns, driven, policies
from hid2.evaluation.realism import RealismCounts, count_scene
from hid2.evaluation.safety import IOU_THRESHOLD, Overlap, Safety, colliding, safety, ttc_after_last_step
from hid2.evaluation.windows import Windows, windows
from hid2.judge.findings import Finding
from hid2.measures.arrays import SceneArrays, is_generated_id
from hid2.measures.conflicts import TrafficConflict, conflicts
from hid2.measures.encounters import encounters
from hid2.measures.lane_changes import LaneChangeRow, lane_changes
from hid2.measures.manoeuvres import Maneuver, ManeuverKind, detect
from hid2.measures.surrogates import CAP_S, Encroachment
from hid2.occupancy.agent_states import AgentStates
from hid2.policy.rules import place_in
from netconvert.errors import ConfigError, ScenarioError

if TYPE_CHECKING:
    import pandas as pd

#: Tolerance around a manoeuvre seen, s, within which a record that it belongs to has its crossing, or else its start.
SAME_MANEUVER_S = 2.0

PAIR_GROUPS = ("original_original", "generated_original", "generated_generated")
PAIR_KINDS = ("pairs_vehicles", "pairs_all", "touching_all", "crossings", "pet_critical")
PAIR_COLUMNS = tuple(f"{kind}_{group}" for kind in PAIR_KINDS for group in PAIR_GROUPS)

Row = dict[str, Any]


@dataclass(frozen=True, eq=False, slots=True)
class SceneMeasures:
    """What evaluation keeps of a scene. tables: its rows, by the names of TABLES; windows: for the critics."""

    tables: Mapping[str, list[Row]]
    realism: RealismCounts
    windows: Windows

    @property
    def scene(self) -> Row:
        """The row of the scene itself."""
        return self.tables["scenes"][0]


def measure_folder(folder: Address, sources: Collection[str] = ()) -> SceneMeasures:
    """Measure one recording or generated scene; sources: of which recorded driving is measured, without their scenes.

    Errors: ScenarioError, MapError.
    """
    recording = read_recording(folder)
    _check_fixed(recording)
    sidecar = recording.sidecar
    apart = sidecar is not None and sidecar.source_scenario_id not in sources
    measures = measure(recording, recording.tracks, sidecar, apart=apart)
    name: Row = {"scenario_id": recording.scenario_id}
    place: Row = {"split": split_of(folder) or "", "city": recording.city, "folder": str(folder)}
    before = dict.fromkeys(TABLES, name) | {"scenes": name | place, "events": name | {"folder": str(folder)}}
    tables = {table: [before[table] | row for row in rows] for table, rows in measures.tables.items()}
    return replace(measures, tables=tables)


def _check_fixed(recording: Recording) -> None:
    """Errors: ScenarioError where recorded vehicles react: they are not where they were recorded."""
    if recording.sidecar is not None and recording.sidecar.replay.mode == "reactive":
        raise ScenarioError(f"{recording.folder}: {REACTIVE}")


def measure(
    recording: Recording, tracks: Sequence[Track], sidecar: Sidecar | None, *, apart: bool = False
) -> SceneMeasures:
    """Measure tracks on the map of a recording, with its steps and by default limits; sidecar: of a generated scene.

    apart: whether realism and windows of recorded vehicles are those among themselves, without inserted ones.
    """
    source = sidecar.source_scenario_id if sidecar else recording.scenario_id
    log = log_of(recording.table) or source  # windows of one share their traffic
    states, groups = _grouped(recording, tracks)
    arrays, safe, last_observed = states.arrays, groups["combined"].safe, recording.last_observed
    maneuvers, findings = detect(states), findings_of(states, sidecar)
    policy_of = policies(arrays, maneuvers)
    scene: Row = {
        "format": recording.format,
        "provenance": recording.provenance,
        "source": source,
        "log": log,
        "steps": arrays.num_steps,
        "tracks": arrays.num_agents,
        "tracks_at_49": int((arrays.row_of[:, last_observed] >= 0).sum()),
        "generated": int(arrays.generated.sum()),
        "generated_at_49": int((arrays.row_of[arrays.generated, last_observed] >= 0).sum()),
        "findings": Counter(one.quantity.value for one in findings),
    }
    for name, group in groups.items():
        scene |= {f"{name}_{key}": value for key, value in _group_row(group, maneuvers, policy_of).items()}
    scene |= _pair_row(safe, arrays) | _request_row(sidecar)

    def driving_of(states: AgentStates, safe: Safety, maneuvers: Sequence[Maneuver]) -> tuple[RealismCounts, Windows]:
        """How vehicles drive: histograms, and windows for the critics."""
        seen = windows(states, safe.leaders, scene=log, labelled=recording.provenance == "human")
        return count_scene(states.arrays, safe, seen, maneuvers, scene=log), seen

    realism, driving = driving_of(states, safe, maneuvers)
    if apart and arrays.generated.any() and not arrays.generated.all():
        alone = states.rows(np.flatnonzero(~arrays.generated).tolist())
        seen = [one for one in maneuvers if not is_generated_id(one.track_id)]
        among, own = driving_of(alone, safety(alone), seen)
        both = RealismCounts()
        both.add(realism, recorded=False)
        both.add(among, generated=False)
        realism, driving = both, np.concatenate([driving[driving["generated"]], own])
    tables = {
        "scenes": [scene],
        "tracks": _track_rows(groups, findings, policy_of, sidecar),
        "maneuvers": [
            row | _apart(row, arrays, recording.focal_track_id) for row in _maneuver_rows(maneuvers, sidecar)
        ],
        "events": [event.model_dump(mode="json") for event in sidecar.events] if sidecar else [],
        "lane_changes": [asdict(row) for row in lane_changes(states, safe.leaders, maneuvers)],
        "conflicts": [asdict(row) for row in conflicts(arrays)],
    }
    return SceneMeasures(tables, realism, driving)


def evaluate_scene(scene: TrafficScene, *own: Callable[[Group], float]) -> "pd.DataFrame":
    """The report's metrics over one scene, and functions of your own of a `Group`: a row each, a column a group.

    Errors: ConfigError with file and line where a function of your own takes no Group, raises, or gives no number, or
    has the name of another metric; ScenarioError for a scene in which recorded vehicles react.
    """
    import pandas as pd

    recording = scene.recording
    _check_fixed(recording)
    _, groups = _grouped(recording, recording.tracks)
    found: dict[str, list[object]] = {}
    for metric in METRICS:
        each = [(metric.numerator.of(group), metric.denominator.of(group)) for group in groups.values()]
        found[metric.key] = [metric.label, metric.unit, *(a / b if b else None for a, b in each)]
    for one in own:
        name = getattr(one, "__name__", repr(one))
        if name in found:
            raise ConfigError(f"metric {name!r}: there is one of this name already, expected another name")
        found[name] = [name.replace("_", " "), "", *(_number_of(one, name, group) for group in groups.values())]
    return pd.DataFrame.from_dict(found, orient="index", columns=["label", "unit", *groups])


def _number_of(own: Callable[[Group], float], name: str, group: Group) -> float:
    """What a function of a user's own makes of a group. Errors: ConfigError."""
    try:
        return float(own(group))
    except (Exception, SystemExit) as error:  # whatever a user's code may raise
        said = f"{place_in(error, own, __file__)}{type(error).__name__}: {error!s:.200}"
        raise ConfigError(f"metric {name!r}: {said}; expected a function of a Group that gives a number") from error


def _grouped(recording: Recording, tracks: Sequence[Track]) -> tuple[AgentStates, dict[str, Group]]:
    """States of tracks on the map of a recording, inserted ones last, and what was measured of them by group."""
    states = recording_states(recording, tracks)
    arrays, safe = states.arrays, safety(states)
    kinematic, met = kinematics(arrays, motion(arrays)), encounters(arrays, safe.leaders)
    recorded, every = ~arrays.generated, np.ones(arrays.num_agents, dtype=bool)
    groups = {}
    # contacts that count: of added vehicles with any road user, of recorded ones with recorded ones
    for name, members, others in (
        ("original", recorded, recorded),
        ("generated", arrays.generated, every),
        ("combined", every, every),
    ):
        end_ttc_s = ttc_after_last_step(arrays, members & driven(arrays), others)
        partners = others if name == "generated" else others & arrays.vehicle  # as in the paper's SCR
        groups[name] = Group(arrays, kinematic, safe, members, partners, end_ttc_s, met)
    return states, groups


def _group_row(group: Group, maneuvers: Sequence[Maneuver], policy_of: Mapping[str, Policy]) -> Row:
    """Sums and counts of one group; ratios are formed when scenes are pooled."""
    arrays = group.arrays
    moving = group.vehicles & arrays.moving
    members = {"agents": group.members, "vehicles": group.vehicles, "moving": moving}
    row: Row = {name: int(those.sum()) for name, those in members.items()} | {"colliding": group.colliding}
    row |= {name: column.of(group) for name, column in columns().items()}
    counts = Counter(policy_of[arrays.track_ids[a]] for a in np.flatnonzero(moving))
    row |= {f"policy_{policy.value}": counts[policy] for policy in Policy}
    ids = {arrays.track_ids[a] for a in np.flatnonzero(group.members)}
    seen = Counter(m.kind for m in maneuvers if m.track_id in ids and m.part_of is None)
    row |= {f"seen_{kind.value}": seen[kind] for kind in ManeuverKind}
    return row


def _pair_row(safe: Safety, arrays: SceneArrays) -> Row:
    """Colliding pairs (IoU above the threshold), pairs that touch at all, and PET, by the groups of the two."""
    hits = [pair for pair in safe.overlaps if pair.iou > IOU_THRESHOLD]
    kinds: Mapping[str, Iterable[Overlap | Encroachment]] = {
        "pairs_vehicles": (pair for pair in hits if arrays.vehicle[pair.first] and arrays.vehicle[pair.second]),
        "pairs_all": hits,
        "touching_all": safe.overlaps,
        "crossings": safe.encroachments,
        "pet_critical": (one for one in safe.encroachments if one.pet_s < CRITICAL.pet_min_s),
    }
    number = arrays.generated.astype(int)  # of inserted ones in a pair
    counts = Counter((kind, number[one.first] + number[one.second]) for kind, found in kinds.items() for one in found)
    return {f"{kind}_{group}": counts[kind, k] for kind in PAIR_KINDS for k, group in enumerate(PAIR_GROUPS)}


def _request_row(sidecar: Sidecar | None) -> Row:
    if sidecar is None:
        return {"requested": None, "placed": 0} | dict.fromkeys(("rejected", "selection", "wanted", "seed", "variant"))
    asked = asked_for(sidecar.requested.agents, len(sidecar.events))
    return {
        "requested": asked if isinstance(asked, int) else None,
        "placed": sidecar.placed.agents,
        "rejected": {item.reason: item.count for item in sidecar.rejected},
        "wanted": dict(sidecar.wanted),
        "selection": None if sidecar.selection is None else sidecar.selection.model_dump(),
        "seed": sidecar.seed,
        "variant": sidecar.variant,
    }


def _track_rows(
    groups: Mapping[str, Group], findings: Sequence[Finding], policy_of: Mapping[str, Policy], sidecar: Sidecar | None
) -> list[Row]:
    """A row for each track."""
    whole = groups["combined"]
    arrays, safe, kinematic = whole.arrays, whole.safe, whole.kinematic
    # of recorded agents contacts with recorded ones, of inserted ones with any
    end_ttc_s = np.minimum(groups["original"].end_ttc_s, groups["generated"].end_ttc_s)
    asked = {agent.track_id: agent.policy.value for agent in sidecar.agents} if sidecar else {}
    hit = colliding(arrays, safe.overlaps)
    off = {"off_road": safe.off_road, "off_footprint": safe.off_footprint, "against_lane": safe.against_lane}

    def known(values: FloatArray) -> list[float | None]:
        """None where a value is not finite."""
        return [value if np.isfinite(value) else None for value in values.tolist()]

    def least(values: FloatArray) -> list[float | None]:
        """Smallest value of each agent."""
        return known(np.minimum.reduceat(values, arrays.first[:-1]))

    table: dict[str, Sequence[Any]] = {
        "track_id": arrays.track_ids,
        "group": np.where(arrays.generated, "generated", "original").tolist(),
        "object_type": arrays.object_types,
        "category": arrays.category.tolist(),
        "steps": arrays.rows_per_agent.tolist(),
        "moving": arrays.moving.tolist(),
        "policy_requested": [asked.get(track_id) for track_id in arrays.track_ids],
        "policy_seen": [policy_of[name].value if name in policy_of else None for name in arrays.track_ids],
        "mean_speed_mps": kinematic.speed_mps.tolist(),
        "lo_mps2": kinematic.lo.tolist(),
        "la_mps2": kinematic.la.tolist(),
        "je_mps3": kinematic.je.tolist(),
        "collides_with_original": np.any(hit[:, ~arrays.generated], axis=1).tolist(),
        "collides_with_generated": np.any(hit[:, arrays.generated], axis=1).tolist(),
        "min_ttc_s": least(np.where(safe.ttc_s < CAP_S, safe.ttc_s, np.inf)),
        "min_leader_ttc_s": least(safe.leaders.ttc_s),
        "min_time_gap_s": least(safe.leaders.time_gap_s),
        "end_ttc_s": known(end_ttc_s),
        "findings": [Counter(one.quantity.value for one in findings if one.track_id == t) for t in arrays.track_ids],
        **{f"{name}_steps": np.add.reduceat(mask, arrays.first[:-1], dtype=int).tolist() for name, mask in off.items()},
    }
    return [dict(zip(table, values, strict=True)) for values in zip(*table.values(), strict=True)]


def _maneuver_rows(seen: Sequence[Maneuver], sidecar: Sidecar | None) -> list[Row]:
    """Records of the sidecar joined with what was seen, then what was seen without a record."""
    left, joined = list(seen), list[tuple[str | None, str, ManeuverRecord | None, Maneuver | None]]()
    for track_id, record in sidecar.asked if sidecar else ():
        found = _seen(track_id, record, left)
        if found is not None:
            left.remove(found)
        joined.append((track_id, record.kind, record, found))
    joined += [(one.track_id, one.kind, None, one) for one in left]
    return [
        {
            "track_id": track_id,
            "group": "generated" if record or (sidecar and is_generated_id(str(track_id))) else "original",
            "kind": kind,
            "recorded": record is not None,
            **{name: getattr(record, name, None) for name in _RECORD},
            **{column: getattr(found, name, None) for column, name in _SEEN.items()},
        }
        for track_id, kind, record, found in joined
    ]


def _seen(track_id: str | None, record: ManeuverRecord, candidates: Sequence[Maneuver]) -> Maneuver | None:
    """The manoeuvre seen that a record tells of."""
    kinds = {record.kind, *((ManeuverKind.PASS, ManeuverKind.OBSTACLE_AVOIDANCE) if record.kind == "overtake" else ())}
    same = [m for m in candidates if m.track_id == track_id and m.kind in kinds]
    at = record.crossing_s if record.crossing_s is not None else record.start_s
    if at is None or not same:
        return None
    nearest = min(same, key=lambda m: abs(m.crossing_s - at))
    return nearest if nearest.start_s - SAME_MANEUVER_S <= at <= nearest.end_s + SAME_MANEUVER_S else None


def _apart(row: Row, arrays: SceneArrays, focal_track_id: str) -> Row:
    """Metres from the focal track and the recording vehicle as a manoeuvre that was done or seen crosses, or begins."""
    told = [row[name] for name in ("crossing_s", "start_s", "seen_crossing_s") if row[name] is not None]
    if not told or row["status"] not in ("done", None):
        return dict.fromkeys(_APART)
    step = min(round(told[0] / arrays.step_s), arrays.num_steps - 1)
    rows = zip(arrays.track_ids, arrays.row_of[:, step].tolist(), strict=True)
    at = {track_id: arrays.position[there] for track_id, there in rows if there >= 0}
    own, *others = (at.get(track_id) for track_id in (row["track_id"], focal_track_id, AV_ID))
    return {
        name: None if own is None or other is None else float(np.hypot(*(other - own)))
        for name, other in zip(_APART, others, strict=True)
    }


#: Columns of the table of manoeuvres: fields of the record, of the manoeuvre that was seen, and distances.
_RECORD = (
    "status", "reason", "trigger_s", "requested_s", "start_s", "crossing_s", "end_s", "gap_front_m", "gap_rear_m",
    "min_ttc_s", "leader_track_id",
)  # fmt: skip
_SEEN = {"seen": "kind", **{f"seen_{name}": name for name in ("start_s", "crossing_s", "end_s", "complete")}}
_SEEN |= {name: name for name in ("source_lane", "target_lane", "other_track_id", "part_of")}
_APART = ("focal_m", "av_m")


#: Tables that grow as scenes are done, and the columns of those that may stay empty.
TABLES: Mapping[str, tuple[str, ...]] = {
    "scenes": (),
    "tracks": (),
    "maneuvers": ("scenario_id", "track_id", "group", "kind", "recorded", *_RECORD, *_SEEN, *_APART),
    "events": ("scenario_id", "folder", *EventRecord.model_fields),
    "lane_changes": ("scenario_id", *(field.name for field in fields(LaneChangeRow))),
    "conflicts": ("scenario_id", *(field.name for field in fields(TrafficConflict))),
}
