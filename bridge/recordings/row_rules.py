"""The rules on the rows of a scenario: the format, what readers take for granted, generated tracks, the source."""

import re
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
from pydantic_core import from_json

from bridge.recordings.recording import AV_ID, FOCAL_CATEGORY
from bridge.recordings.rules import RECORDED, Breach
from bridge.recordings.scenario import OBSERVED_STEPS, SCENARIO_COLUMNS, STEP_S, longest
from hid2.agents import DEFAULT_SIZES, VEHICLE_TYPES

CITIES = frozenset({"austin", "dearborn", "miami", "palo-alto", "pittsburgh", "washington-dc"})
#: Between central differences of positions 0.2 s apart and the velocity, m/s: 8.37 m/s3 of jerk make 0.014.
VELOCITY_TOLERANCE_MPS = 0.05
#: The same at the two ends of a track, where differences are one-sided: 4.05 m/s2 make 0.2.
END_VELOCITY_TOLERANCE_MPS = 0.3
HEADING_TOLERANCE_RAD = 0.1
#: Slower vehicles have no direction of motion to speak of, m/s.
HEADING_FROM_MPS = 0.5
_MOTION_COLUMNS = ("position_x", "position_y", "heading", "velocity_x", "velocity_y")
_GENERATED_ID = re.compile(r"gen_(0|[1-9][0-9]*)")


class Rows:
    """The rows of a scenario as arrays (N,), in the order of the file; code: index into ids.

    observed_steps, step_s: of the recording, by default those of the format.
    """

    def __init__(self, table: pa.Table, *, observed_steps: int = OBSERVED_STEPS, step_s: float = STEP_S) -> None:
        self.table, self.observed_steps, self.step_s = table, observed_steps, step_s
        encoded = pc.dictionary_encode(table.column("track_id")).combine_chunks()
        self.ids: list[str] = encoded.dictionary.to_pylist()
        self.code: npt.NDArray[np.int64] = encoded.indices.to_numpy(zero_copy_only=False).astype(np.int64)
        self.timestep: npt.NDArray[np.int64] = table.column("timestep").to_numpy()
        self.category: npt.NDArray[np.int64] = table.column("object_category").to_numpy()
        self.observed: npt.NDArray[np.bool_] = table.column("observed").to_numpy()
        self.motion: npt.NDArray[np.float64] = np.column_stack([table.column(c).to_numpy() for c in _MOTION_COLUMNS])
        self.num_steps = int(self.timestep.max()) + 1

    @property
    def last_observed(self) -> int:
        """The last observed timestep."""
        return self.observed_steps - 1

    def where(self, row: int) -> str:
        """Names a row in messages."""
        return f"track {self.ids[self.code[row]]!r}, timestep {self.timestep[row]}"

    def begins(self) -> dict[str, int]:
        """First timestep of each track, by its id."""
        first = np.full(len(self.ids), np.iinfo(np.int64).max)
        np.minimum.at(first, self.code, self.timestep)
        return dict(zip(self.ids, first.tolist(), strict=True))

    def of(self, track_id: str) -> npt.NDArray[np.int64]:
        """Rows of a track, sorted by timestep."""
        rows = np.flatnonzero(self.code == self.ids.index(track_id))
        return np.asarray(rows[np.argsort(self.timestep[rows], kind="stable")], dtype=np.int64)


def check_rows(rows: Rows, new_id: str) -> Iterator[Breach]:
    """The hard and the silent requirements on the rows, one breach for each rule and column."""
    table = rows.table
    yield from _check_index(table)
    for column in SCENARIO_COLUMNS:
        values = pc.unique(table.column(column))
        if len(values) != 1:
            yield "constant", f"{column} has {len(values)} values, expected one"
    first = {column: table.column(column)[0].as_py() for column in SCENARIO_COLUMNS}
    if first["scenario_id"] != new_id:
        yield "scenario-id", f"column scenario_id is {first['scenario_id']!r}, expected {new_id!r} as the folder"
    if not first["city"]:
        yield "city", "no city"
    elif first["city"] not in CITIES:
        yield RECORDED, f"city {first['city']!r} is none of {', '.join(sorted(CITIES))}"
    most = longest(str(first["scenario_id"]))
    if not rows.num_steps <= first["num_timestamps"] <= most:
        yield "timestep", f"num_timestamps {first['num_timestamps']}, expected {rows.num_steps} to {most}"
    yield from _first(rows, (rows.timestep < 0) | (rows.timestep >= most), "timestep", f"expected 0 to {most - 1}")
    for i, column in enumerate(_MOTION_COLUMNS):
        yield from _first(rows, ~np.isfinite(rows.motion[:, i]), "finite", f"{column} is not a finite number")
    order = np.lexsort((rows.timestep, rows.code))
    again = np.zeros(len(order), dtype=bool)
    again[order[1:]] = (np.diff(rows.code[order]) == 0) & (np.diff(rows.timestep[order]) == 0)
    yield from _first(rows, again, "duplicate", "is there more than once")
    yield from _first(rows, rows.observed != (rows.timestep < rows.observed_steps), "observed", "observed is wrong")
    kinds = table.column("object_type").to_numpy()
    unknown = ~np.isin(kinds, list(DEFAULT_SIZES))
    yield from _first(rows, unknown, "object-type", f"expected one of {', '.join(DEFAULT_SIZES)}")
    outside = (rows.category < 0) | (rows.category > FOCAL_CATEGORY)
    yield from _first(rows, outside, "category", "expected 0, 1, 2 or 3")
    _, first_rows = np.unique(rows.code, return_index=True)
    yield from _first(rows, rows.category != rows.category[first_rows][rows.code], "constant", "category changes")
    yield from _first(rows, kinds != kinds[first_rows][rows.code], "constant", "object_type changes")

    focals = {rows.ids[code] for code in rows.code[rows.category == FOCAL_CATEGORY]}
    if focals != {first["focal_track_id"]}:
        names = ", ".join(map(repr, sorted(focals))) or "none"
        yield "focal", f"tracks of category 3: {names}, expected focal_track_id {first['focal_track_id']!r} alone"
    for track_id in sorted(focals):
        steps = rows.timestep[rows.of(track_id)]
        if rows.last_observed not in steps or steps[-1] != rows.num_steps - 1:
            recorded = rows.last_observed in steps and not _GENERATED_ID.fullmatch(track_id)
            said = f"track {track_id!r} lasts from {steps[0]} to {steps[-1]}, expected {rows.num_steps - 1}"
            yield RECORDED if recorded else "focal", said
    at_last = set(rows.code[rows.timestep == rows.last_observed])
    for code in sorted(set(rows.code[rows.category == FOCAL_CATEGORY - 1]) - at_last):
        recorded = not _GENERATED_ID.fullmatch(rows.ids[code])
        said = f"track {rows.ids[code]!r} is scored and absent at timestep {rows.last_observed}"
        yield RECORDED if recorded else "scored", said
    if AV_ID not in rows.ids:
        yield "av", f"no track {AV_ID!r} among {len(rows.ids)}"


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


def _first(rows: Rows, bad: npt.NDArray[np.bool_], rule: str, message: str) -> Iterator[Breach]:
    found = np.flatnonzero(bad)
    if len(found):
        more = f" (and {len(found) - 1} more rows)" if len(found) > 1 else ""
        yield rule, f"{rows.where(int(found[0]))}: {message}{more}"


def check_generated(rows: Rows, track_id: str) -> Iterator[Breach]:
    """What is demanded of a generated track beyond the format."""
    index = rows.of(track_id)
    steps, category = rows.timestep[index], int(rows.category[index[0]])
    name = f"track {track_id!r}"
    if not _GENERATED_ID.fullmatch(track_id):
        yield "generated", f"{name}: expected an id gen_0, gen_1, ..."
    kind = rows.table.column("object_type")[int(index[0])].as_py()
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
