"""The rules on the rows of a scenario: the format, what readers take for granted, generated tracks, the source."""

import re
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
from pydantic_core import from_json

from bridge.recordings.recording import FOCAL_CATEGORY, SCORED_CATEGORY
from bridge.recordings.scenario import RowArrays, row_breaches
from hid2.agents import VEHICLE_TYPES
from netconvert.av2_map import Breach

#: The rule on recorded rows, which are kept as they are.
RECORDED = "recorded"
CITIES = frozenset({"austin", "dearborn", "miami", "palo-alto", "pittsburgh", "washington-dc"})
#: Between central differences of positions 0.2 s apart and the velocity, m/s: 8.37 m/s3 of jerk make 0.014.
VELOCITY_TOLERANCE_MPS = 0.05
#: The same at the two ends of a track, where differences are one-sided: 4.05 m/s2 make 0.2.
END_VELOCITY_TOLERANCE_MPS = 0.3
HEADING_TOLERANCE_RAD = 0.1
#: Slower vehicles have no direction of motion to speak of, m/s.
HEADING_FROM_MPS = 0.5
_GENERATED_ID = re.compile(r"gen_(0|[1-9][0-9]*)")


def check_rows(rows: RowArrays, new_id: str) -> Iterator[Breach]:
    """The hard and the silent requirements on the rows, one breach for each rule and column."""
    yield from _check_index(rows.table)
    for rule, said, more in row_breaches(rows):
        yield rule, said + (f" (and {more} more rows)" if more else "")
    scenario_id, city = (rows.constants[column][0] for column in ("scenario_id", "city"))
    if scenario_id != new_id:
        yield "scenario-id", f"column scenario_id is {scenario_id!r}, expected {new_id!r} as the folder"
    if city and city not in CITIES:
        yield RECORDED, f"city {city!r} is none of {', '.join(sorted(CITIES))}"
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
    metadata = (table.schema.metadata or {}).get(b"pandas")
    try:
        index = from_json(metadata)["index_columns"] if metadata is not None else []
    except (ValueError, KeyError, TypeError) as error:
        yield "columns", f"what pandas wrote about its index cannot be read ({error})"
        return
    wanted = {"kind": "range", "name": None, "start": 0, "stop": table.num_rows, "step": 1}
    if index not in ([], [wanted]):
        yield "columns", f"index {index}, expected a RangeIndex from 0 to {table.num_rows}"


def check_generated(rows: RowArrays, track_id: str) -> Iterator[Breach]:
    """What is demanded of a generated track beyond the format."""
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
        at = int(steps[np.flatnonzero(np.diff(steps) != 1)[0]])
        yield "generated", f"{name}: gap after timestep {at}"
        return
    if rows.last_observed not in steps:
        yield "generated", f"{name}: lasts from {steps[0]} to {steps[-1]}, expected {rows.last_observed} in it"
    if category >= FOCAL_CATEGORY - 1 and (steps[0] > 0 or steps[-1] < rows.num_steps - 1):
        yield "generated", f"{name}: category {category}, from {steps[0]} to {steps[-1]}, expected all {rows.num_steps}"
    motion = rows.motion[index]
    if len(steps) < 3 or not np.isfinite(motion).all():
        return
    position, heading, velocity = motion[:, :2], motion[:, 2], motion[:, 3:]
    error = np.hypot(*(np.gradient(position, rows.step_s, axis=0) - velocity).T)
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
        yield "heading", f"{name}: heading {heading[np.argmax(np.abs(heading))]:.3f}, expected -pi to pi"


def compare_rows(table: pa.Table, source: pa.Table, generated_ids: set[str]) -> Iterator[str]:
    """Recorded rows against those of the source, bit for bit."""
    if [(field.name, field.type) for field in table.schema] != [(field.name, field.type) for field in source.schema]:
        yield f"columns {table.schema.names}, expected those of the source with their types"
        return
    generated = pc.is_in(
        table.column("track_id"), value_set=pa.array(sorted(generated_ids), table.schema.field("track_id").type)
    )
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
    left_null, right_null = one.is_null().to_numpy(), other.is_null().to_numpy()
    if pa.types.is_floating(one.type):
        left, right = (
            np.ascontiguousarray(column.to_numpy(), dtype=np.float64).view(np.int64) for column in (one, other)
        )
        same = left == right
    else:
        try:
            same = pc.fill_null(pc.equal(one, other), fill_value=False).to_numpy()
        except pa.ArrowNotImplementedError:  # lists, or nothing at all, in a column of the source's own
            same = np.array([left == right for left, right in zip(one.to_pylist(), other.to_pylist(), strict=True)])
        same = same | left_null
    return np.asarray((left_null == right_null) & same, dtype=bool)
