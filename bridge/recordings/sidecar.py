"""hid2_<id>.json: what was asked for, what was placed, and one record for every manoeuvre, whatever became of it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, FailFast, Field, ValidationError, model_validator

from bridge.files import read_received
from bridge.recordings.folders import source_id
from bridge.recordings.limits import MAX_SIDECAR_MB
from hid2.agents import BoxSize, FloatArray, Policy, Track
from hid2.measures.selection import Drives
from netconvert.errors import ScenarioError

#: How the tracks were made: by the recording vehicle's own tracker, or by people that labelled boxes.
Provenance = Literal["tracker", "human"]
ManeuverKind = Literal["lane_change", "overtake", "left_turn", "right_turn"]
ManeuverStatus = Literal["done", "aborted", "not_feasible", "not_triggered"]
Seconds = Annotated[float, Field(ge=0)]
Version = Annotated[str, Field(max_length=100, pattern="^[ -~]+$")]
BoxLength = Annotated[float, Field(gt=0, lt=50)]
_Entry = TypeVar("_Entry")
#: Checked up to the first entry that is wrong: of a crafted file with a million the errors alone would fill the memory.
Listed = Annotated[tuple[_Entry, ...], FailFast()]
BoxWidth = Annotated[float, Field(gt=0, lt=10)]


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class GeneratorRecord(_Record):
    """The program that made the scene, its code and the libraries it computed with."""

    name: Version = "hid2-sumo"
    version: Version
    code_sha256: str = Field(pattern="^[0-9a-f]{64}$")
    libraries: Mapping[Version, Version]


class RecordingRecord(_Record):
    """The recording that vehicles were inserted into. first_step: of the source; map: a map chosen for it, by name.

    sizes: length and width of recorded tracks with measured boxes, m.
    """

    format: str
    provenance: Provenance
    step_s: float = Field(ge=0.05, le=0.5)
    observed_steps: int = Field(ge=1)
    first_step: int = Field(default=0, ge=0)
    map: str | None = None
    sizes: Mapping[str, tuple[BoxLength, BoxWidth]] = Field(default_factory=dict)


class ReplayRecord(_Record):
    """How the recorded agents were replayed, and how exactly. late_s: agents that yielded, and how late that made them.

    reactive: recorded vehicles keep their path but yield in time. checked: so many states were compared with SUMO's.
    """

    mode: Literal["fixed", "reactive"] = "fixed"
    late_s: Mapping[str, Seconds] = Field(default_factory=dict)
    checked: bool = True
    states: int = Field(ge=0)
    max_position_error_m: float = Field(ge=0)
    max_heading_error_rad: float = Field(ge=0)


#: What a scene is not in which recorded vehicles react.
REACTIVE = (
    "made with driving.replay = reactive: recorded vehicles yield and do not drive as recorded; for studies and "
    "planner tests, expected a scene with driving.replay = fixed"
)


class RequestedRecord(_Record):
    """Vehicles asked for; share by policy."""

    agents: Annotated[int, Field(ge=0)] | Literal["max"]
    behaviours: Mapping[Policy, float]


class PlacedRecord(_Record):
    """Vehicles exported; by policy; near what request.near names; entered after step 0; policy that a focal does."""

    agents: int = Field(ge=0)
    behaviours: Mapping[Policy, int]
    near: int = Field(default=0, ge=0)
    entered: int = Field(default=0, ge=0)
    focal: Policy | None = None


class SpawnRecord(_Record):
    """Where and how fast a vehicle was inserted; timestep: its first, above 0 where it enters at the map's edge."""

    lane_segment_id: int
    cell: int = Field(ge=0)
    speed_mps: float = Field(ge=0)
    timestep: int = Field(default=0, ge=0)


class ManeuverRecord(_Record):
    """One manoeuvre asked for; s from timestep 0, None for what did not come about; lanes: by which it is seen."""

    kind: ManeuverKind
    status: ManeuverStatus
    reason: str | None = None
    trigger_s: Seconds | None = None
    requested_s: Seconds | None = None
    start_s: Seconds | None = None
    crossing_s: Seconds | None = None
    end_s: Seconds | None = None
    source_lane: int | None = None
    target_lane: int | None = None
    leader_track_id: str | None = None
    gap_front_m: float | None = None
    gap_rear_m: float | None = None
    min_ttc_s: float | None = None


class DriverRecord(_Record):
    """The driver: SUMO's car-following model with this vehicle's parameters, and its place in the lane."""

    model: str
    parameters: Mapping[str, float]


class GapsRecord(_Record):
    """Gaps looked at from the trigger on: how many, and how many each of the two refused."""

    looked_at: int = Field(default=0, ge=0)
    refused_by_rule: int = Field(default=0, ge=0)
    refused_by_sumo: int = Field(default=0, ge=0)


class SimulatedRecord(_Record):
    """Exported s(t) against SUMO's own place along the path, m: the largest difference of all steps."""

    max_off_m: float = Field(ge=0)


class StatesRecord(_Record):
    """States at the steps of a track, (N,) each: box centre x, y m, heading rad, velocity vx, vy m/s."""

    x: Listed[float]
    y: Listed[float]
    heading: Listed[float]
    vx: Listed[float]
    vy: Listed[float]

    @model_validator(mode="after")
    def _check(self) -> "StatesRecord":
        if len({len(column) for _, column in self}) > 1:
            raise ValueError("x, y, heading, vx, vy: expected as many values in each")
        return self

    @classmethod
    def of(cls, track: Track) -> "StatesRecord":
        """Those of a track."""
        columns = (*track.position.T, track.heading, *track.velocity.T)
        return cls(**dict(zip(cls.model_fields, (tuple(one.tolist()) for one in columns), strict=True)))

    @property
    def motion(self) -> FloatArray:
        """(N, 5)."""
        return np.array([column for _, column in self], dtype=np.float64).T


class AgentRecord(_Record):
    """One generated vehicle, with fields as README.md tells; rerouted_s: when it took another way at a split."""

    track_id: str
    object_type: Literal["vehicle", "bus"] = "vehicle"
    length_m: BoxLength
    width_m: BoxWidth
    policy: Policy
    spawn: SpawnRecord
    route: Listed[int]
    maneuvers: Listed[ManeuverRecord] = ()
    driver: DriverRecord | None = None
    limited: Mapping[str, float] = Field(default_factory=dict)
    policies: Mapping[str, float] = Field(default_factory=dict)
    gaps: GapsRecord = GapsRecord()
    rerouted_s: Seconds | None = None
    simulated: SimulatedRecord | None = None
    clean: StatesRecord | None = None
    end_reason: str | None = None


class RejectedRecord(_Record):
    """Candidates that were not exported, by reason."""

    reason: str
    count: int = Field(ge=1)


class ReplacedRecord(_Record):
    """A vehicle that was tried and is not in the scene: why, where it started, in which round, and its last step."""

    vehicle: str
    policy: Policy
    reason: str
    detail: str | None = None
    round: int = Field(ge=0)
    lane_segment_id: int
    cell: int = Field(ge=0)
    last_step: int = Field(ge=0)


class SelectionRecord(_Record):
    """How vehicles drive that are exported, that were driven and dropped, and that are recorded and move."""

    kept: Drives
    dropped: Drives
    recorded: Drives


class EventRecord(_Record):
    """One event that was asked for, what became of it, and what it was like for its target as recorded.

    README.md tells what each of the fields is.
    """

    kind: Literal["cut_in", "overtake", "lead", "follow", "merge", "cross"]
    target: str
    status: Literal["done", "not_feasible"]
    reason: str | None = None
    track_id: str | None = None
    target_track_id: str | None = None
    at_s: Seconds | None = None
    ahead: bool | None = None
    gap_m: float | None = None
    speed_difference_mps: float | None = None
    min_ttc_s: Seconds | None = None
    ttc_at_s: Seconds | None = None
    headway_s: float | None = None
    pet_s: Seconds | None = None
    drac_mps2: float | None = Field(default=None, ge=0)
    human_brakes: bool | None = None
    brakes_mps2: float | None = Field(default=None, ge=0)
    tries: int = Field(ge=0)
    tried: Mapping[str, int] = {}


class Sidecar(_Record):
    """The whole file. Nothing in it depends on the clock or the machine: same request, same bytes.

    unmet: manoeuvres that were asked for and that no vehicle does; in place of most of them one goes straight.
    wanted: shares of the inserted vehicles that were to meet something, by what the scene's recorded vehicles meet.
    """

    schema_version: Literal["2"] = "2"
    source_scenario_id: str
    generator: GeneratorRecord
    recording: RecordingRecord
    sumo_version: Version
    seed: int = Field(ge=0)
    variant: int = Field(ge=0)
    config: Mapping[str, Any]
    config_sha256: str = Field(pattern="^[0-9a-f]{64}$")
    replay: ReplayRecord
    requested: RequestedRecord
    placed: PlacedRecord
    agents: Listed[AgentRecord] = ()
    unmet: Listed[ManeuverRecord] = ()
    events: Listed[EventRecord] = ()
    rejected: Listed[RejectedRecord] = ()
    replaced: Listed[ReplacedRecord] = ()
    selection: SelectionRecord | None = None
    wanted: Mapping[str, float] = {}

    def __repr__(self) -> str:
        """Of what it was made, how much of what was asked for is in it."""
        return f"Sidecar(of {self.source_scenario_id}: {self.placed.agents} of {self.requested.agents} vehicles)"

    __str__ = __repr__

    @property
    def asked(self) -> list[tuple[str | None, ManeuverRecord]]:
        """Each manoeuvre that was asked for, with the vehicle that was to do it; None where none was found."""
        told = [(agent.track_id, record) for agent in self.agents for record in agent.maneuvers]
        return [*told, *((None, record) for record in self.unmet)]

    @property
    def program(self) -> dict[str, str]:
        """Versions of the program and its libraries, by name; the code by its digest."""
        by, sumo = self.generator, self.sumo_version.removeprefix("SUMO ")
        return {by.name: by.version, "code": by.code_sha256[:12], "SUMO": sumo, **by.libraries}

    @property
    def boxes(self) -> dict[str, BoxSize]:
        """Boxes by track id, as far as they are known: those measured of recorded tracks, those of inserted ones."""
        recorded = {track_id: BoxSize(*size) for track_id, size in self.recording.sizes.items()}
        return recorded | {agent.track_id: BoxSize(agent.length_m, agent.width_m) for agent in self.agents}


def sidecar_path(folder: Path, scenario_id: str) -> Path:
    """The sidecar's place in a scenario folder."""
    return folder / f"hid2_{scenario_id}.json"


def sidecar_bytes(sidecar: Sidecar) -> bytes:
    """Deterministic JSON, UTF-8."""
    return sidecar.model_dump_json(indent=1).encode() + b"\n"


def read_sidecar(path: Path) -> Sidecar:
    """Read a sidecar. Errors: ScenarioError with the file, the first field that is wrong and its value."""
    try:
        content = read_received(path, ScenarioError, wanted="a sidecar", most_mb=MAX_SIDECAR_MB)
        return Sidecar.model_validate_json(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        if first["type"] == "json_invalid":
            raise ScenarioError(f"{path}: not JSON, expected a sidecar, hid2_<id>.json of a generated scene") from error
        field = ".".join(str(part) for part in first["loc"]) or "the file"
        later = "; of another hid2-sumo, which can read it" if field == "schema_version" else ""
        raise ScenarioError(f"{path}: {field}: {first['msg']} (got {str(first['input'])[:60]!r}){later}") from error


def sidecar_in(folder: Path) -> Sidecar | None:
    """The sidecar of a scenario folder; None where there is none: the scene was recorded. Errors: ScenarioError."""
    path = sidecar_path(folder, source_id(folder))
    return read_sidecar(path) if path.is_file() else None
