"""`hid2 validate`: everything that readers of a generated data set demand, also what they would not complain about."""

import json
import re
import uuid
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from bridge.config import config_from_dict, config_sha256, config_to_dict
from bridge.export import new_scenario_id
from bridge.scenario import (
    AV_ID,
    FOCAL_CATEGORY,
    LAST_OBSERVED,
    MAX_STEPS,
    SCENARIO_COLUMNS,
    SPLITS,
    STEP_S,
    find_scenarios,
    read_table,
)
from bridge.sidecar import AgentRecord, Sidecar, read_sidecar, sidecar_path
from hid2.agents import DEFAULT_SIZES, VEHICLE_TYPES, Policy
from netconvert.errors import ConfigError, ScenarioError

#: What each rule demands; the names are those of findings.
RULES: Mapping[str, str] = {
    "folder": "OUT/[train|val|test/]<id>/ with scenario_<id>.parquet, log_map_archive_<id>.json and hid2_<id>.json",
    "other-parquet": "no other parquet file anywhere under OUT: readers take every one they find",
    "scenario-id": "a UUID, the same in folder, file names and column, made of source, configuration, seed and variant",
    "columns": "every column of the format with its type and no nulls, RangeIndex from 0",
    "constant": "scenario columns say the same in every row, object_type and object_category in every row of a track",
    "finite": "no NaN and no infinity",
    "duplicate": "one row for a track and a timestep",
    "timestep": "timesteps from 0 to 109, num_timestamps at least as many as there are and at most 110",
    "observed": "observed where the timestep is below 50, and only there",
    "object-type": "an object type of the format",
    "category": "0 fragment, 1 context, 2 scored or 3 focal",
    "focal": "exactly one track of category 3, which is focal_track_id, present at timestep 49 and to the end",
    "scored": "a track of category 2 is present at timestep 49",
    "av": "a track named AV",
    "city": "one of the six cities, that of the source",
    "map": "drivable areas, lane segments with every field, z on every point",
    "mark-type": "lane mark types of the enum, never null",
    "lane-type": "VEHICLE, BIKE or BUS",
    "boundary": "boundaries and centrelines of at least two points",
    "sidecar": "the schema of hid2_<id>.json, in agreement with itself, the tracks and the map",
    "generated": "gen_<n>, a vehicle, category 1 to 3, without gaps, present at 49; scored or focal: at all steps",
    "velocity": "a generated track's velocity is the time derivative of its position",
    "heading": "a generated track's heading follows its motion",
    "source": "recorded rows are the source's bit for bit, but for a former focal's category; the map is the source's",
}

CITIES = frozenset({"austin", "dearborn", "miami", "palo-alto", "pittsburgh", "washington-dc"})
LANE_TYPES = frozenset({"VEHICLE", "BIKE", "BUS"})
MARK_TYPES = frozenset(
    {
        "DASH_SOLID_YELLOW",
        "DASH_SOLID_WHITE",
        "DASHED_WHITE",
        "DASHED_YELLOW",
        "DOUBLE_SOLID_YELLOW",
        "DOUBLE_SOLID_WHITE",
        "DOUBLE_DASH_YELLOW",
        "DOUBLE_DASH_WHITE",
        "SOLID_YELLOW",
        "SOLID_WHITE",
        "SOLID_DASH_WHITE",
        "SOLID_DASH_YELLOW",
        "SOLID_BLUE",
        "NONE",
        "UNKNOWN",
    }
)
#: Between central differences of positions 0.2 s apart and the velocity, m/s: 8.37 m/s3 of jerk make 0.014.
VELOCITY_TOLERANCE_MPS = 0.05
#: The same at the two ends of a track, where differences are one-sided: 4.05 m/s2 make 0.2.
END_VELOCITY_TOLERANCE_MPS = 0.3
HEADING_TOLERANCE_RAD = 0.1
#: Slower vehicles have no direction of motion to speak of, m/s.
HEADING_FROM_MPS = 0.5
_MOTION_COLUMNS = ("position_x", "position_y", "heading", "velocity_x", "velocity_y")
_GENERATED_ID = re.compile(r"gen_(0|[1-9][0-9]*)")


class Finding(NamedTuple):
    """One breach of one rule."""

    file: Path
    rule: str
    message: str


def validate_folder(out: Path, *, source: Path | None = None) -> list[Finding]:
    """Check every scenario under a data set that was generated; source: where its recorded scenes lie.

    out and source: a scenario folder, a split folder or a data-set root. Returns what is wrong, nothing if all is well.
    Errors: ScenarioError where out or source is no folder or holds no scenario.
    """
    folders = find_scenarios(out)
    sources = _index_sources(source) if source is not None else None
    findings = list(_check_tree(out, folders))
    for folder in folders:
        findings += validate_scene(folder, sources=sources)
    return findings


def validate_scene(folder: Path, *, sources: Mapping[str, Path] | None = None) -> list[Finding]:
    """Check one scenario folder; sources: folders of recorded scenarios by id, None for no comparison."""
    findings: list[Finding] = []
    new_id = folder.name
    parquet_path = folder / f"scenario_{new_id}.parquet"
    map_path = folder / f"log_map_archive_{new_id}.json"
    wanted = (parquet_path, map_path, sidecar_path(folder, new_id))
    findings += [Finding(path, "folder", "no such file") for path in wanted if not path.is_file()]

    sidecar = None
    if sidecar_path(folder, new_id).is_file():
        try:
            sidecar = read_sidecar(sidecar_path(folder, new_id))
        except ScenarioError as error:
            findings.append(Finding(sidecar_path(folder, new_id), "sidecar", str(error)))
    document = None
    if map_path.is_file():
        document, map_findings = _read_map(map_path)
        findings += map_findings
    rows = None
    if parquet_path.is_file():
        try:
            rows = _Rows(read_table(parquet_path))
        except ScenarioError as error:
            findings.append(Finding(parquet_path, "columns", str(error)))

    generated_ids: set[str] = {agent.track_id for agent in sidecar.agents} if sidecar is not None else set()
    if rows is not None:
        generated_ids |= {track_id for track_id in rows.ids if track_id.startswith("gen_")}
        breaches = list(_check_rows(rows, new_id))
        for track_id in sorted(generated_ids & set(rows.ids)):
            breaches += _check_generated(rows, track_id)
        findings += [Finding(parquet_path, *breach) for breach in breaches]
    if sidecar is not None:
        breaches = list(_check_sidecar(sidecar, new_id, rows, generated_ids, document))
        findings += [Finding(sidecar_path(folder, new_id), *breach) for breach in breaches]
    if sources is not None and sidecar is not None:
        source = sources.get(sidecar.source_scenario_id)
        if source is None:
            message = f"source scenario {sidecar.source_scenario_id} is not among the {len(sources)} given"
            return [*findings, Finding(sidecar_path(folder, new_id), "source", message)]
        source_id = sidecar.source_scenario_id
        if rows is not None:
            messages = _compare_rows(rows.table, source / f"scenario_{source_id}.parquet", generated_ids)
            findings += [Finding(parquet_path, "source", message) for message in messages]
        if document is not None:
            messages = _compare_map(map_path, document, source / f"log_map_archive_{source_id}.json")
            findings += [Finding(map_path, "source", message) for message in messages]
    return findings


_Breach = tuple[str, str]


class _Rows:
    """The rows of a scenario as arrays (N,), in the order of the file; code: index into ids."""

    def __init__(self, table: pa.Table) -> None:
        self.table = table
        encoded = pc.dictionary_encode(table.column("track_id")).combine_chunks()
        self.ids: list[str] = encoded.dictionary.to_pylist()
        self.code: npt.NDArray[np.int64] = encoded.indices.to_numpy(zero_copy_only=False).astype(np.int64)
        self.timestep: npt.NDArray[np.int64] = table.column("timestep").to_numpy()
        self.category: npt.NDArray[np.int64] = table.column("object_category").to_numpy()
        self.observed: npt.NDArray[np.bool_] = table.column("observed").to_numpy()
        self.motion: npt.NDArray[np.float64] = np.column_stack([table.column(c).to_numpy() for c in _MOTION_COLUMNS])
        self.num_steps = int(self.timestep.max()) + 1

    def where(self, row: int) -> str:
        """Names a row in messages."""
        return f"track {self.ids[self.code[row]]!r}, timestep {self.timestep[row]}"

    def of(self, track_id: str) -> npt.NDArray[np.int64]:
        """Rows of a track, sorted by timestep."""
        rows = np.flatnonzero(self.code == self.ids.index(track_id))
        return np.asarray(rows[np.argsort(self.timestep[rows], kind="stable")], dtype=np.int64)


def _check_tree(out: Path, folders: Sequence[Path]) -> Iterator[Finding]:
    expected = {folder / f"scenario_{folder.name}.parquet" for folder in folders}
    for path in sorted(out.rglob("*.parquet")):
        if path not in expected:
            yield Finding(path, "other-parquet", RULES["other-parquet"])
    for folder in folders:
        depth = len(folder.relative_to(out).parts)
        if depth == 2 and folder.parent.name not in SPLITS:
            yield Finding(folder, "folder", f"split {folder.parent.name!r}, want one of {', '.join(SPLITS)}")


def _check_rows(rows: _Rows, new_id: str) -> Iterator[_Breach]:
    """The hard and the silent requirements on the rows, one breach for each rule and column."""
    table = rows.table
    yield from _check_index(table)
    for column in SCENARIO_COLUMNS:
        values = pc.unique(table.column(column))
        if len(values) != 1:
            yield "constant", f"{column} has {len(values)} values, want one"
    first = {column: table.column(column)[0].as_py() for column in SCENARIO_COLUMNS}
    if first["scenario_id"] != new_id:
        yield "scenario-id", f"column scenario_id is {first['scenario_id']!r}, want {new_id!r} as the folder"
    if first["city"] not in CITIES:
        yield "city", f"city {first['city']!r}, want one of {', '.join(sorted(CITIES))}"
    if not rows.num_steps <= first["num_timestamps"] <= MAX_STEPS:
        yield "timestep", f"num_timestamps {first['num_timestamps']}, want {rows.num_steps} to {MAX_STEPS}"
    yield from _first(rows, (rows.timestep < 0) | (rows.timestep >= MAX_STEPS), "timestep", "want 0 to 109")
    for i, column in enumerate(_MOTION_COLUMNS):
        yield from _first(rows, ~np.isfinite(rows.motion[:, i]), "finite", f"{column} is not a finite number")
    order = np.lexsort((rows.timestep, rows.code))
    again = np.zeros(len(order), dtype=bool)
    again[order[1:]] = (np.diff(rows.code[order]) == 0) & (np.diff(rows.timestep[order]) == 0)
    yield from _first(rows, again, "duplicate", "is there more than once")
    yield from _first(rows, rows.observed != (rows.timestep <= LAST_OBSERVED), "observed", "observed is wrong")
    kinds = table.column("object_type").to_numpy()
    unknown = ~np.isin(kinds, list(DEFAULT_SIZES))
    yield from _first(rows, unknown, "object-type", f"want one of {', '.join(DEFAULT_SIZES)}")
    outside = (rows.category < 0) | (rows.category > FOCAL_CATEGORY)
    yield from _first(rows, outside, "category", "want 0, 1, 2 or 3")
    _, first_rows = np.unique(rows.code, return_index=True)
    yield from _first(rows, rows.category != rows.category[first_rows][rows.code], "constant", "category changes")
    yield from _first(rows, kinds != kinds[first_rows][rows.code], "constant", "object_type changes")

    focals = {rows.ids[code] for code in rows.code[rows.category == FOCAL_CATEGORY]}
    if focals != {first["focal_track_id"]}:
        names = ", ".join(map(repr, sorted(focals))) or "none"
        yield "focal", f"tracks of category 3: {names}, want focal_track_id {first['focal_track_id']!r} alone"
    for track_id in sorted(focals):
        steps = rows.timestep[rows.of(track_id)]
        if LAST_OBSERVED not in steps or steps[-1] != rows.num_steps - 1:
            yield "focal", f"track {track_id!r} lasts from {steps[0]} to {steps[-1]}, want {rows.num_steps - 1}"
    at_last = set(rows.code[rows.timestep == LAST_OBSERVED])
    for code in sorted(set(rows.code[rows.category == FOCAL_CATEGORY - 1]) - at_last):
        yield "scored", f"track {rows.ids[code]!r} is scored and absent at timestep {LAST_OBSERVED}"
    if AV_ID not in rows.ids:
        yield "av", f"no track {AV_ID!r} among {len(rows.ids)}"


def _check_index(table: pa.Table) -> Iterator[_Breach]:
    metadata = (table.schema.metadata or {}).get(b"pandas")
    index = json.loads(metadata)["index_columns"] if metadata is not None else []
    wanted = {"kind": "range", "name": None, "start": 0, "stop": table.num_rows, "step": 1}
    if index not in ([], [wanted]):
        yield "columns", f"index {index}, want a RangeIndex from 0 to {table.num_rows}"


def _first(rows: _Rows, bad: npt.NDArray[np.bool_], rule: str, message: str) -> Iterator[_Breach]:
    found = np.flatnonzero(bad)
    if len(found):
        more = f" (and {len(found) - 1} more rows)" if len(found) > 1 else ""
        yield rule, f"{rows.where(int(found[0]))}: {message}{more}"


def _check_generated(rows: _Rows, track_id: str) -> Iterator[_Breach]:
    """What is demanded of a generated track beyond the format."""
    index = rows.of(track_id)
    steps, category = rows.timestep[index], int(rows.category[index[0]])
    name = f"track {track_id!r}"
    if not _GENERATED_ID.fullmatch(track_id):
        yield "generated", f"{name}: want an id gen_0, gen_1, ..."
    kind = rows.table.column("object_type")[int(index[0])].as_py()
    if kind not in VEHICLE_TYPES:
        yield "generated", f"{name}: object_type {kind!r}, want {' or '.join(sorted(VEHICLE_TYPES))}"
    if category == 0:
        yield "generated", f"{name}: category 0, want 1, 2 or 3"
    if (np.diff(steps) != 1).any():
        at = int(steps[np.flatnonzero(np.diff(steps) != 1)[0]])
        yield "generated", f"{name}: gap after timestep {at}"
        return
    if LAST_OBSERVED not in steps:
        yield "generated", f"{name}: lasts from {steps[0]} to {steps[-1]}, want {LAST_OBSERVED} in it"
    if category >= FOCAL_CATEGORY - 1 and (steps[0] > 0 or steps[-1] < rows.num_steps - 1):
        yield "generated", f"{name}: category {category}, from {steps[0]} to {steps[-1]}, want all {rows.num_steps}"
    motion = rows.motion[index]
    if len(steps) < 3 or not np.isfinite(motion).all():
        return
    position, heading, velocity = motion[:, :2], motion[:, 2], motion[:, 3:]
    error = np.hypot(*(np.gradient(position, STEP_S, axis=0) - velocity).T)
    tolerance = np.full(len(steps), VELOCITY_TOLERANCE_MPS)
    tolerance[[0, -1]] = END_VELOCITY_TOLERANCE_MPS
    wrong = np.flatnonzero(error > tolerance)
    if len(wrong):
        worst = int(wrong[np.argmax(error[wrong])])
        yield "velocity", f"{name}, timestep {steps[worst]}: {error[worst]:.3f} m/s off the derivative of position"
    course = np.arctan2(velocity[:, 1], velocity[:, 0])
    off = np.abs(np.mod(heading - course + np.pi, 2 * np.pi) - np.pi)
    off[np.hypot(*velocity.T) < HEADING_FROM_MPS] = 0
    if off.max() > HEADING_TOLERANCE_RAD:
        worst = int(np.argmax(off))
        yield "heading", f"{name}, timestep {steps[worst]}: {off[worst]:.3f} rad off the direction of motion"
    if np.abs(heading).max() > np.pi:
        yield "heading", f"{name}: heading {heading[np.argmax(np.abs(heading))]:.3f}, want -pi to pi"


def _check_sidecar(
    sidecar: Sidecar,
    new_id: str,
    rows: _Rows | None,
    generated_ids: set[str],
    document: Mapping[str, Any] | None,
) -> Iterator[_Breach]:
    try:
        if str(uuid.UUID(new_id)) != new_id:
            raise ValueError
    except ValueError:
        yield "scenario-id", f"folder {new_id!r}, want a UUID of 36 characters"
    try:
        config = config_from_dict(sidecar.config)
    except ConfigError as error:
        yield "sidecar", f"config: {error}"
    else:
        if sidecar.config_sha256 != config_sha256(config) or config_to_dict(config) != sidecar.config:
            yield "sidecar", f"config_sha256 {sidecar.config_sha256[:12]}..., want that of config"
        wanted = new_scenario_id(sidecar.source_scenario_id, config, sidecar.seed, sidecar.variant)
        if wanted != new_id:
            yield "scenario-id", f"{new_id}, want {wanted} of this source, configuration, seed and variant"
    if sidecar.placed.agents != len(sidecar.agents):
        yield "sidecar", f"placed.agents {sidecar.placed.agents}, but {len(sidecar.agents)} agents"
    for policy in Policy:
        count = sum(agent.policy == policy for agent in sidecar.agents)
        if sidecar.placed.behaviours.get(policy, 0) != count:
            yield (
                "sidecar",
                f"placed.behaviours.{policy} {sidecar.placed.behaviours.get(policy, 0)}, but {count} agents",
            )
    listed = [agent.track_id for agent in sidecar.agents]
    if len(set(listed)) != len(listed):
        yield "sidecar", "two agents have the same track_id"
    if rows is not None and set(listed) != generated_ids & set(rows.ids):
        missing = ", ".join(sorted(set(listed) ^ (generated_ids & set(rows.ids))))
        yield "sidecar", f"agents and generated tracks differ: {missing}"
    lanes = {str(lane) for lane in document["lane_segments"]} if document is not None else None
    for agent in sidecar.agents:
        yield from _check_agent(agent, set(rows.ids) if rows is not None else None, lanes)


def _check_agent(agent: AgentRecord, track_ids: set[str] | None, lanes: set[str] | None) -> Iterator[_Breach]:
    name = f"agent {agent.track_id}"
    kinds = [maneuver.kind for maneuver in agent.maneuvers]
    if agent.policy is not Policy.STRAIGHT and agent.policy.value not in kinds:
        yield "sidecar", f"{name}: policy {agent.policy}, but no record of it"
    used = {agent.spawn.lane_segment_id, *agent.route}
    for maneuver in agent.maneuvers:
        used |= {lane for lane in (maneuver.source_lane, maneuver.target_lane) if lane is not None}
        times = [
            time
            for time in (maneuver.trigger_s, maneuver.start_s, maneuver.crossing_s, maneuver.end_s)
            if time is not None
        ]
        if times != sorted(times):
            yield "sidecar", f"{name}: {maneuver.kind}: times {times}, want trigger, start, crossing, end in order"
        if maneuver.status == "done" and (maneuver.start_s is None or maneuver.end_s is None):
            yield "sidecar", f"{name}: {maneuver.kind}: done without start_s and end_s"
        if track_ids is not None and maneuver.leader_track_id not in (None, *track_ids):
            yield "sidecar", f"{name}: {maneuver.kind}: no leader {maneuver.leader_track_id!r}"
    if lanes is not None:
        for lane in sorted(lane for lane in used if str(lane) not in lanes):
            yield "sidecar", f"{name}: lane segment {lane} is not in the map"


def _read_map(path: Path) -> tuple[dict[str, Any] | None, list[Finding]]:
    try:
        document = json.loads(path.read_bytes())
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        return None, [Finding(path, "map", f"not JSON ({error})")]
    if not isinstance(document, dict) or not all(
        isinstance(document.get(part), dict) for part in ("drivable_areas", "lane_segments", "pedestrian_crossings")
    ):
        return None, [Finding(path, "map", "want drivable_areas, lane_segments and pedestrian_crossings")]
    return document, [Finding(path, rule, message) for rule, message in _check_map(document)]


def _check_map(document: Mapping[str, Any]) -> Iterator[_Breach]:
    if not document["drivable_areas"]:
        yield "map", "no drivable area"
    for key, area in document["drivable_areas"].items():
        yield from _check_points(area, "area_boundary", f"drivable area {key}", least=3)
    for key, crossing in document["pedestrian_crossings"].items():
        for edge in ("edge1", "edge2"):
            yield from _check_points(crossing, edge, f"pedestrian crossing {key}", least=2)
    for key, lane in document["lane_segments"].items():
        name = f"lane segment {key}"
        for column in ("id", "is_intersection", "successors", "predecessors", "left_neighbor_id", "right_neighbor_id"):
            if column not in lane:
                yield "map", f"{name}: no {column}"
        if str(lane.get("id")) != str(key):
            yield "map", f"{name}: id {lane.get('id')!r}, want its key"
        if lane.get("lane_type") not in LANE_TYPES:
            yield "lane-type", f"{name}: lane_type {lane.get('lane_type')!r}, want {', '.join(sorted(LANE_TYPES))}"
        for side in ("left", "right"):
            mark = lane.get(f"{side}_lane_mark_type")
            if mark not in MARK_TYPES:
                yield "mark-type", f"{name}: {side}_lane_mark_type {mark!r}, want one of the enum"
            yield from _check_points(lane, f"{side}_lane_boundary", name, least=2)
        yield from _check_points(lane, "centerline", name, least=2)


def _check_points(owner: Mapping[str, Any], field: str, name: str, *, least: int) -> Iterator[_Breach]:
    points = owner.get(field)
    if not isinstance(points, list) or len(points) < least:
        have = len(points) if isinstance(points, list) else "none"
        yield "boundary", f"{name}: {field} of {have} points, want at least {least}"
        return
    for i, point in enumerate(points):
        values = [point.get(axis) for axis in "xyz"] if isinstance(point, dict) else [None]
        if not all(isinstance(value, float | int) and np.isfinite(value) for value in values):
            yield "map", f"{name}: {field}[{i}] is {point}, want finite x, y and z"
            return


def _index_sources(source: Path) -> dict[str, Path]:
    found = [path for folder in find_scenarios(source) for path in folder.glob("scenario_*.parquet")]
    return {path.stem.removeprefix("scenario_"): path.parent for path in found}


def _compare_rows(table: pa.Table, source_path: Path, generated_ids: set[str]) -> Iterator[str]:
    """Recorded rows against those of the source, bit for bit."""
    try:
        source = read_table(source_path)
    except ScenarioError as error:
        yield str(error)
        return
    if [(field.name, field.type) for field in table.schema] != [(field.name, field.type) for field in source.schema]:
        yield f"columns {table.schema.names}, want those of the source with their types"
        return
    generated = pc.is_in(
        table.column("track_id"), value_set=pa.array(sorted(generated_ids), table.schema.field("track_id").type)
    )
    recorded = table.filter(pc.invert(generated)) if generated_ids else table
    if recorded.num_rows != source.num_rows:
        yield f"{recorded.num_rows} recorded rows, want {source.num_rows}"
        return
    focal_changes = table.column("focal_track_id")[0].as_py() in generated_ids
    for name in source.schema.names:
        if name == "scenario_id" or (name == "focal_track_id" and focal_changes):
            continue
        same = _same_bits(recorded.column(name), source.column(name))
        if name == "object_category" and focal_changes:
            former = source.column(name).to_numpy() == FOCAL_CATEGORY
            same |= former & (recorded.column(name).to_numpy() != FOCAL_CATEGORY)
        if not same.all():
            row = int(np.flatnonzero(~same)[0])
            track, step = source.column("track_id")[row].as_py(), source.column("timestep")[row].as_py()
            found, wanted = recorded.column(name)[row].as_py(), source.column(name)[row].as_py()
            yield f"track {track!r}, timestep {step}: {name} {found!r}, want {wanted!r} ({int((~same).sum())} rows)"


def _same_bits(one: pa.ChunkedArray, other: pa.ChunkedArray) -> npt.NDArray[np.bool_]:
    if pa.types.is_floating(one.type):
        left, right = (np.asarray(column.to_numpy()).view(np.int64) for column in (one, other))
    else:
        left, right = one.to_numpy(), other.to_numpy()
    return np.asarray(left == right, dtype=bool)


def _compare_map(path: Path, document: Mapping[str, Any], source_path: Path) -> Iterator[str]:
    """The map against the source's, byte for byte; only centrelines may have been added."""
    try:
        raw = source_path.read_bytes()
        if path.read_bytes() == raw:
            return
        source = json.loads(raw)
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        yield f"{source_path}: cannot be read ({error})"
        return
    lanes = source.get("lane_segments", {})
    lacking = {key for key, lane in lanes.items() if not lane.get("centerline")}
    if not lacking:
        yield f"not the bytes of {source_path.name}"
        return

    def without_added(lane_segments: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
        return {
            key: {name: value for name, value in lane.items() if name != "centerline" or key not in lacking}
            for key, lane in lane_segments.items()
        }

    ours = {**document, "lane_segments": without_added(document["lane_segments"])}
    if ours != {**source, "lane_segments": without_added(lanes)}:
        yield f"differs from {source_path.name} in more than added centrelines"
