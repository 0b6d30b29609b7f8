"""The rules on a written scene: its rows, its sidecar, its sequence of Argoverse 1, and all of them before its source.

Those on the format of rows are in `scenario`, those on maps in `map_rules`, which readers ask as well; what is safe and
drivable is for the judge.
"""

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence, Set
from itertools import chain, zip_longest
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from bridge.config import config_from_dict, config_sha256, config_to_dict, copy_id, is_corridor, new_scenario_id
from bridge.files import read_received
from bridge.recordings.argoverse1 import INSERTED, check_sequence, sequence_bytes
from bridge.recordings.recording import Recording
from bridge.recordings.scenario import RowArrays, row_breaches
from bridge.recordings.sidecar import AgentRecord, Sidecar
from hid2.agents import AV_ID, FOCAL_CATEGORY, REAR_AXLE_SHARE, SCORED_CATEGORY, VEHICLE_TYPES, FloatArray, Policy
from hid2.judge.events import brakes_for
from hid2.params import Config
from netconvert.av2_map import Breach
from netconvert.errors import ConfigError, ScenarioError
from netconvert.geometry import wrap_angle
from netconvert.net_xml import CITY_ORIGINS

#: The rule on recorded rows, which are kept as they are.
RECORDED = "recorded"
#: Tolerance between central differences of positions 0.2 s apart and velocity, m/s: 8.37 m/s3 of jerk make 0.014.
VELOCITY_TOLERANCE_MPS = 0.05
#: Tolerance of the velocity at the two ends of a track, m/s, where differences are one-sided: 4.05 m/s2 make 0.2.
END_VELOCITY_TOLERANCE_MPS = 0.3
HEADING_TOLERANCE_RAD = 0.1
#: Speed below which a vehicle has no direction of motion to speak of, m/s.
HEADING_FROM_MPS = 0.5
_GENERATED_ID = re.compile(r"gen_(0|[1-9][0-9]*)")
#: Whether something is wrong, and what is said then.
_Told = Iterator[tuple[bool, str]]


def check_rows(rows: RowArrays, new_id: str) -> Iterator[Breach]:
    """The hard and the silent requirements on the rows, one breach for each rule and column."""
    yield from _check_index(rows.table)
    yield from row_breaches(rows)
    scenario_id, city = (rows.constants[column][0] for column in ("scenario_id", "city"))
    if scenario_id != new_id:
        yield "scenario-id", f"column scenario_id is {scenario_id!r}, expected {new_id!r} as the folder"
    if city and city not in CITY_ORIGINS:
        yield RECORDED, f"city {city!r} is none of {', '.join(CITY_ORIGINS)}"
    for code, track_id in enumerate(rows.ids):
        own, is_generated = rows.of_track(code), _GENERATED_ID.fullmatch(track_id) is not None
        steps, category = rows.timestep[own], rows.category[own.start]
        is_there = rows.last_observed in steps
        if category == FOCAL_CATEGORY and is_there and steps[-1] != rows.num_steps - 1:
            said = f"track {track_id!r} lasts from {steps[0]} to {steps[-1]}, expected {rows.num_steps - 1}"
            yield "focal" if is_generated else RECORDED, said
        if category == SCORED_CATEGORY and not is_there:
            said = f"track {track_id!r} is scored and absent at timestep {rows.last_observed}"
            yield "scored" if is_generated else RECORDED, said


def _check_index(table: pa.Table) -> Iterator[Breach]:
    try:
        index = (table.schema.pandas_metadata or {"index_columns": []})["index_columns"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        yield "columns", f"what pandas wrote about its index cannot be read ({error})"
        return
    if index not in ([], [{"kind": "range", "name": None, "start": 0, "stop": table.num_rows, "step": 1}]):
        yield "columns", f"index {index}, expected a RangeIndex from 0 to {table.num_rows}"


def check_generated(rows: RowArrays, track_id: str, clean: FloatArray | None, length_m: float) -> Iterator[Breach]:
    """Demands on a track beyond the format. clean (N, 5): its motion without a tracker's noise; length_m: its box's."""
    index = rows.of_track(rows.ids.index(track_id))
    steps, category = rows.timestep[index], int(rows.category[index.start])
    name = f"track {track_id!r}"
    if not _GENERATED_ID.fullmatch(track_id):
        yield "generated", f"{name}: expected an id gen_0, gen_1, ..."
    kind = rows.kinds[rows.kind[index.start]]
    if kind not in VEHICLE_TYPES:
        yield "generated", f"{name}: object_type {kind!r}, expected {' or '.join(sorted(VEHICLE_TYPES))}"
    if category == 0:
        yield "generated", f"{name}: category 0, expected 1, 2 or 3"
    if (np.diff(steps) != 1).any():
        yield "generated", f"{name}: gap after timestep {steps[np.flatnonzero(np.diff(steps) != 1)[0]]}"
        return
    if rows.last_observed not in steps:
        yield "generated", f"{name}: lasts from {steps[0]} to {steps[-1]}, expected {rows.last_observed} in it"
    if category >= FOCAL_CATEGORY - 1 and (steps[0] > 0 or steps[-1] < rows.num_steps - 1):
        yield "generated", f"{name}: category {category}, from {steps[0]} to {steps[-1]}, expected all {rows.num_steps}"
    motion = rows.motion[index] if clean is None else clean
    if len(motion) != len(steps):
        yield "generated", f"{name}: {len(motion)} clean states, expected {len(steps)}, as it has rows"
    elif np.abs(rows.motion[index, 2]).max() > np.pi:
        heading = rows.motion[index, 2]
        yield "heading", f"{name}: heading {heading[np.argmax(np.abs(heading))]:.3f}, expected -pi to pi"
    if len(steps) < 3 or len(motion) != len(steps) or not np.isfinite(motion).all():
        return
    position, heading, velocity = motion[:, :2], motion[:, 2], motion[:, 3:]
    error = np.hypot(*(np.gradient(position, rows.step_s, axis=0) - velocity).T)
    tolerance = np.full(len(steps), VELOCITY_TOLERANCE_MPS)
    tolerance[[0, -1]] = END_VELOCITY_TOLERANCE_MPS
    wrong = np.flatnonzero(error > tolerance)
    if len(wrong):
        worst = int(wrong[np.argmax(error[wrong])])
        yield "velocity", f"{name}, timestep {steps[worst]}: {error[worst]:.3f} m/s off the derivative of position"
    axle = position - REAR_AXLE_SHARE * length_m * np.column_stack([np.cos(heading), np.sin(heading)])
    courses = [np.arctan2(moved[:, 1], moved[:, 0]) for moved in (velocity, np.gradient(axle, rows.step_s, axis=0))]
    off = np.abs(wrap_angle(heading - courses)).min(axis=0)
    off[np.hypot(*velocity.T) < HEADING_FROM_MPS] = 0
    if off.max() > HEADING_TOLERANCE_RAD:
        worst = int(np.argmax(off))
        yield "heading", f"{name}, timestep {steps[worst]}: {off[worst]:.3f} rad off the direction of motion"


def compare_rows(table: pa.Table, source: pa.Table, generated_ids: set[str]) -> Iterator[str]:
    """Recorded rows against those of the source, bit for bit."""
    columns = zip_longest(*([f"{field.name} ({field.type})" for field in one.schema] for one in (table, source)))
    differing = next(((own, its) for own, its in columns if own != its), None)
    if differing is not None:
        yield f"column {differing[0]}, expected {differing[1]}, as the source has it"
        try:  # what is in them is compared all the same
            table = table.cast(source.schema)
        except (pa.ArrowException, ValueError):
            return
    ids = table.column("track_id")
    generated = pc.is_in(ids, value_set=pa.array(sorted(generated_ids), ids.type))
    recorded = table.filter(pc.invert(generated)) if generated_ids else table
    if recorded.num_rows != source.num_rows:
        yield f"{recorded.num_rows} recorded rows, expected {source.num_rows}"
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
            yield f"track {track!r}, timestep {step}: {name} {found!r}, expected {wanted!r} ({int((~same).sum())} rows)"


def _same_bits(one: pa.ChunkedArray, other: pa.ChunkedArray) -> npt.NDArray[np.bool_]:
    """Which rows of two columns of one type are the same; nulls are, with nulls alone."""
    if pa.types.is_floating(one.type):
        one, other = (pc.cast(column, pa.float64()).combine_chunks().view(pa.int64()) for column in (one, other))
    if one.equals(other):
        return np.ones(len(one), dtype=bool)
    return np.array([left == right for left, right in zip(one.to_pylist(), other.to_pylist(), strict=True)])


def check_sidecar(
    sidecar: Sidecar, new_id: str, begins: Mapping[str, int], generated_ids: Set[str], lanes: Set[str]
) -> Iterator[Breach]:
    """A sidecar against its scene. begins: first timestep of each track of the rows, by its id; lanes: of the map."""
    if is_corridor(new_id):
        yield "scenario-id", f"folder {new_id!r}, expected a UUID: a synthetic corridor is no scene of Argoverse"
    try:
        config = config_from_dict(sidecar.config)
    except ConfigError as error:
        yield "sidecar", f"config: {error}"
    else:
        wanted = new_scenario_id(sidecar.source_scenario_id, config, sidecar.seed, sidecar.variant)
        copies = (copy_id(wanted, number) for number in range(1, 1000))  # of a composed data set
        if wanted != new_id and new_id not in copies:
            yield "scenario-id", f"{new_id}, expected {wanted} of this source, configuration, seed and variant"
        yield from (("sidecar", said) for is_wrong, said in _config_rules(sidecar, config) if is_wrong)
    of_agents = (_agent_rules(agent, begins, lanes) for agent in sidecar.agents)
    told = chain(_scene_rules(sidecar, generated_ids & begins.keys()), *of_agents)
    yield from (("sidecar", said) for is_wrong, said in told if is_wrong)


def _config_rules(sidecar: Sidecar, config: Config) -> _Told:
    same = sidecar.config_sha256 == config_sha256(config) and config_to_dict(config) == sidecar.config
    yield not same, f"config_sha256 {sidecar.config_sha256[:12]}..., expected that of config"
    asked = [(event.kind, event.target) for event in config.event for _ in range(event.count)]
    yield asked != [(one.kind, one.target) for one in sidecar.events], f"events: expected those of config, {asked}"
    noisy = config.export.adds_noise(sidecar.recording.provenance)
    for policy in sorted({agent.policy for agent in sidecar.agents} - {*config.request.behaviours}):
        yield True, f"policy {policy!r}, expected one of {', '.join(config.request.behaviours)}"
    other = any((agent.clean is not None) != noisy for agent in sidecar.agents)
    yield other, f"expected clean states of {'all' if noisy else 'no'} agents, by export.noise and the recording"


def _scene_rules(sidecar: Sidecar, generated_ids: Set[str]) -> _Told:
    """Vehicles and events of a sidecar against its sums and against the generated tracks of the rows."""
    agents, placed = sidecar.agents, sidecar.placed
    yield placed.agents != len(agents), f"placed.agents {placed.agents}, but {len(agents)} agents"
    entered = sum(one.spawn.timestep > 0 for one in agents)
    yield placed.entered != entered, f"placed.entered {placed.entered}, but {entered} agents"
    counts = Counter(agent.policy for agent in agents)
    for policy in dict.fromkeys((*Policy, *counts, *placed.behaviours)):
        told = placed.behaviours.get(policy, 0)
        yield told != counts[policy], f"placed.behaviours.{policy} {told}, but {counts[policy]} agents"
    listed = {agent.track_id for agent in agents}
    yield len(listed) != len(agents), "two agents have the same track_id"
    yield listed != generated_ids, f"agents and generated tracks differ: {', '.join(sorted(listed ^ generated_ids))}"
    for number, event in enumerate(sidecar.events):
        named, its = AV_ID if event.target == "av" else event.target, event.target_track_id
        other = event.status != "done" or (its is not None and named not in ("any", "focal", "scored", its))
        said = f"event {number}: {event.status} with {event.target}, but made by {event.track_id} with {its}"
        yield other and event.track_id is not None, said
        brakes, of = event.human_brakes, (event.min_ttc_s, event.drac_mps2)
        yield brakes not in (None, brakes_for(*of)), f"event {number}: human_brakes {brakes}, but TTC, DRAC {of}"


def _agent_rules(agent: AgentRecord, begins: Mapping[str, int], lanes: Set[str]) -> _Told:
    name, maneuvers, since = f"agent {agent.track_id}", agent.maneuvers, agent.spawn.timestep
    kinds = [one.kind for one in maneuvers]
    told = agent.policy.value in kinds if agent.policy in tuple(Policy) else bool(kinds)  # of one's own: any
    yield not told and agent.policy is not Policy.STRAIGHT, f"{name}: policy {agent.policy}, but no record of it"
    for one in maneuvers:
        stated = (one.trigger_s, one.start_s, one.crossing_s, one.end_s)
        times, is_known = [time for time in stated if time is not None], one.leader_track_id in (None, *begins)
        of = f"{name}: {one.kind}"
        yield times != sorted(times), f"{of}: times {times}, expected trigger, start, crossing, end in order"
        yield one.status == "done" and None in (one.start_s, one.end_s), f"{of}: done without start_s and end_s"
        yield not is_known, f"{of}: no leader {one.leader_track_id!r}"
    of_maneuvers = {lane for one in maneuvers for lane in (one.source_lane, one.target_lane) if lane is not None}
    for lane in sorted({agent.spawn.lane_segment_id, *agent.route} | of_maneuvers):
        yield str(lane) not in lanes, f"{name}: lane segment {lane} is not in the map"
    began = begins.get(agent.track_id, since)
    yield began != since, f"{name}: spawn.timestep {since}, but it begins at {began}"


def check_written_sequence(
    path: Path, rows: RowArrays, generated_ids: set[str], *, source: Recording | None
) -> Iterator[Breach]:
    """A sequence against what is written of its recorded lines and the rows of its scene, and these lines' source."""
    try:
        content = read_received(path, ScenarioError, wanted="an Argoverse 1 sequence")
        check_sequence(content, str(path))
        lines = content.decode("ascii").splitlines(keepends=True)
        recorded = [line for line in lines if INSERTED not in line]
        ours = [rows.of_track(code) for code, name in enumerate(rows.ids) if name in generated_ids]
        inserted = [(rows.timestep[own], rows.motion[own, :2]) for own in ours]
        wanted = sequence_bytes("".join(recorded).encode(), inserted).decode().splitlines(keepends=True)
    except (ScenarioError, IndexError) as error:  # of fewer time stamps than steps
        yield "sequence", str(error)
        return
    if lines != wanted:
        yield "sequence", f"line {_first_other(lines, wanted)} is not as the inserted vehicles of the scene have it"
    if source is not None and source.sequence is not None:
        theirs = source.sequence.decode("ascii").splitlines()
        if [line.rstrip("\r\n") for line in recorded] != theirs:
            line = _first_other([line.rstrip("\r\n") for line in recorded], theirs)
            yield "source", f"recorded line {line} is not that of {source.folder.name}"


def _first_other(lines: Sequence[str], wanted: Sequence[str]) -> int:
    """Number of the first line that is another one, from 1."""
    return next(k for k, (one, other) in enumerate(zip_longest(lines, wanted), start=1) if one != other)
