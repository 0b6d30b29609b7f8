"""Synthetic recordings, of one-way roads for studies of traffic flow, and a road with its traffic as a file.

They have the columns of the other scenes, ids that begin with `corridor-`, and are no scenes of Argoverse. Readers of
the format demand a recording vehicle and a focal track: both stand on the shoulder, off the lanes. Traffic enters in a
study (`flow.veh_per_h_lane`), or as the file of a road says, which then lies beside.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, model_validator

from bridge.config import CORRIDOR_PREFIX
from bridge.recordings.export import parquet_bytes, write_folder
from bridge.recordings.limits import MAX_CORRIDOR_STEPS, MAX_LANE_M
from bridge.recordings.scenario import OBSERVED_STEPS, STEP_S, table_of
from bridge.toml import read_toml_as
from hid2.agents import AV_ID, DEFAULT_SIZES, FOCAL_CATEGORY, Track
from netconvert.errors import ConfigError

#: Name of the file in the folder of a corridor that is made of one.
ROAD_FILE = "road.toml"
#: Most lanes; factor of the row in the id of a lane, to which the lane's number from the left is added.
MOST_LANES, ROW = 8, 100
RAMPS = _FEEDER, _OFF = 98, 99
#: Length of what lies between a stop line and the other side of the crossing, m.
CROSSING_M = 20.0
#: Usual widths of a motorway, least length of a road on which vehicles meet, spacing of points as on real maps, m.
_LANE_M, _SHOULDER_M, _LEAST_M, _POINT_EVERY_M = 3.5, 4.0, 100.0, 10.0

_Share = Annotated[float, Field(ge=0, le=1)]
_Flow = Annotated[float, Field(ge=0, le=3000)]
_Speed = Annotated[float, Field(gt=0, le=40)]
_Phase = Annotated[float, Field(ge=1, le=600)]


class RoadPart(BaseModel):
    """A part of the file of a road, or of one beside it: unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class AuxiliaryLane(RoadPart):
    """An auxiliary lane on the right of all others, m from the section's start, with the ramps that it joins."""

    from_m: float = Field(ge=0)
    to_m: float = Field(gt=0)
    on_ramp: bool = False
    off_ramp: bool = False


class Signal(RoadPart):
    """A signal for all lanes, with its stop line at_m from the section's start: green from offset_s on, yellow, red."""

    at_m: float = Field(gt=0)
    green_s: _Phase
    yellow_s: _Phase = 3.0
    red_s: _Phase
    offset_s: float = Field(default=0.0, ge=0)

    @property
    def phases(self) -> tuple[tuple[float, str], ...]:
        """Seconds and SUMO's letter of each."""
        return (self.green_s, "G"), (self.yellow_s, "y"), (self.red_s, "r")

    def shown(self, step_s: float, steps: int | None = None) -> npt.NDArray[np.str_]:
        """(T,) SUMO's letter of each step: of so many, or of one cycle."""
        ends_s, letters = np.cumsum([self.green_s, self.yellow_s, self.red_s]), np.array([*"Gyr"])
        at_s = np.arange(round(ends_s[-1] / step_s) if steps is None else steps) * step_s - self.offset_s
        return np.asarray(letters[np.searchsorted(ends_s, at_s % ends_s[-1], side="right") % 3])


class Period(RoadPart):
    """Traffic until a time: veh/h that enter by lane, counted from the left, the on-ramp last.

    end_mps: speed limit behind the section from then on, by lane, without which none is congested; none: as it was.
    """

    until_s: float = Field(gt=0)
    veh_per_h: Annotated[list[_Flow], Field(min_length=1)]
    end_mps: list[_Speed] = []


class Lane(NamedTuple):
    """A stretch of a lane, m from the section's start. number: from the left, the auxiliary lane and ramps the last.

    closed: no lane is changed there; crossing: it begins at a stop line.
    """

    lane_id: int
    number: int
    start_m: float
    end_m: float
    closed: bool
    left: int | None
    right: int | None
    successors: tuple[int, ...]
    crossing: bool = False


class Road(RoadPart):
    """The section that is measured, what lies before and behind it, and its traffic. Lanes are counted from the left.

    approach_m, run_out_m: before and behind the section, where lanes are kept; ramp_m: of each ramp; drop_m: where the
    rightmost lane ends; leaving: share of those of each start lane, the on-ramp last, that take the off-ramp;
    warm_up_s: not counted; step_s: of the simulation; SUMO's models are made for steps up to their time gap.
    """

    length_m: float = Field(ge=100, le=MAX_LANE_M)
    lanes: int = Field(ge=2, le=MOST_LANES)
    approach_m: float = Field(default=150.0, ge=20, le=2000)
    run_out_m: float = Field(default=150.0, ge=20, le=2000)
    ramp_m: float = Field(default=100.0, ge=20, le=1000)
    drop_m: float | None = Field(default=None, gt=0)
    beside: AuxiliaryLane | None = None
    signal: list[Signal] = []
    trucks: _Share = 0.0
    warm_up_s: float = Field(default=180.0, ge=0, le=3600)
    step_s: float = Field(default=0.5, gt=0, le=1)
    period: Annotated[list[Period], Field(min_length=1)]
    leaving: list[_Share] = []

    @model_validator(mode="after")
    def _check(self) -> Self:
        aside, stops, until = self.beside, self._crossings, [one.until_s for one in self.period]
        ends = [aside.from_m, aside.to_m] if aside else [self.drop_m or self.length_m]
        if ends != sorted(set(ends)) or ends[-1] > self.length_m:
            raise ValueError(f"beside and drop_m lie in the section, 0 to {self.length_m:g} m, from_m before to_m")
        if self.drop_m and (aside or self.lanes < 3):
            raise ValueError("drop_m: expected three lanes or more, and no lane beside")
        if stops and (stops != sorted(set(stops)) or stops[-1] >= self.length_m or aside or self.drop_m):
            room = f"by more than {CROSSING_M:g} m and to end as much before the section's end"
            raise ValueError(f"signal: at_m has to rise {room}, with no lane beside and no drop_m")
        if until != sorted(set(until)):
            raise ValueError("period: until_s has to rise")
        if self.warm_up_s >= self.seconds:
            raise ValueError(f"warm_up_s {self.warm_up_s:g}: expected less than the {self.seconds:g} s of traffic")
        starts = len(self.from_lanes)
        rows = [("leaving", self.leaving, starts)]
        rows += [(f"period.end_mps until {one.until_s:g} s", one.end_mps, self.lanes) for one in self.period]
        rows += [(f"period.veh_per_h until {one.until_s:g} s", one.veh_per_h, starts) for one in self.period]
        for name, values, count in rows:
            if values and len(values) != count:
                ramp = " and the on-ramp" if count > self.lanes else ""
                raise ValueError(f"{name}: {len(values)} values, expected one for each of {self.lanes} lanes{ramp}")
        if any(self.leaving) and not (aside and aside.off_ramp):
            raise ValueError("leaving: expected beside.off_ramp = true")
        return self

    @property
    def _crossings(self) -> list[float]:
        """Where each crossing begins, at its stop line, and ends, m."""
        return [at_m for one in self.signal for at_m in (one.at_m, one.at_m + CROSSING_M)]

    @property
    def seconds(self) -> float:
        """How long traffic enters, s."""
        return self.period[-1].until_s

    @property
    def asked(self) -> bool:
        """Whether none enters by the file: vehicles come by `flow.veh_per_h_lane`, and are asked for lane changes."""
        return not any(rate for part in self.period for rate in part.veh_per_h)

    @property
    def from_lanes(self) -> list[str]:
        """What changes per vehicle of each start lane are called, and of the ramp."""
        ramp = ["from_ramp"] if self.beside and self.beside.on_ramp else []
        return [*(f"from_lane_{number}" for number in range(1, self.lanes + 1)), *ramp]

    @property
    def signals(self) -> dict[int, Signal]:
        """By lane that begins at a stop line, its signal."""
        at = {one.at_m: one for one in self.signal}
        return {lane.lane_id: at[lane.start_m] for lane in self.stretches() if lane.crossing}

    def stretches(self) -> list[Lane]:
        """Every lane, cut where lanes begin and end, row by row and from the left; ramps last."""
        aside, last, stops = self.beside, self.lanes + 1, [one.at_m for one in self.signal]
        first_m, end_m = -self.approach_m, self.length_m + self.run_out_m
        reach = dict.fromkeys(range(1, last), (first_m, end_m)) | {self.lanes: (first_m, self.drop_m or end_m)}
        reach |= {last: (aside.from_m, aside.to_m)} if aside else {}
        cuts = sorted({0.0, self.length_m, *self._crossings, *(at_m for ends in reach.values() for at_m in ends)})
        leads_out = (_OFF,) if aside and aside.off_ramp else ()
        found = []
        for row, (start_m, end_m) in enumerate(pairwise(cuts)):
            closed = start_m < 0.0 or start_m >= self.length_m or start_m in stops
            numbers = [number for number, (since_m, until_m) in reach.items() if since_m <= start_m < until_m]
            for number in numbers:
                name = ROW * row + number
                on = (name + ROW,) if end_m < reach[number][1] else leads_out if number == last else ()
                left, right = (name + by if number + by in numbers else None for by in (-1, 1))
                found.append(Lane(name, number, start_m, end_m, closed, left, right, on, start_m in stops))
        if aside and aside.on_ramp:
            onto = (ROW * cuts.index(aside.from_m) + last,)
            found.append(Lane(_FEEDER, last, aside.from_m - self.ramp_m, aside.from_m, True, None, None, onto))
        if aside and aside.off_ramp:
            found.append(Lane(_OFF, last, aside.to_m, aside.to_m + self.ramp_m, True, None, None, ()))
        return found

    def route(self, *, ramp: bool, leaves: bool) -> list[int]:
        """Lane ids from where a vehicle enters, on the on-ramp or not, to where it leaves, one of each row."""
        aside = self.beside
        first_m, last_m = aside.from_m if ramp and aside else -np.inf, aside.to_m if leaves and aside else np.inf
        rows = [one.lane_id for one in self.stretches() if one.number == 1 and first_m <= one.start_m < last_m]
        return [*[_FEEDER] * ramp, *rows, *[_OFF] * leaves]


def read_road(path: Path) -> Road:
    """Read a road. Errors: ConfigError with file, key, value."""
    return read_toml_as(Road, path, "a road")


def write_corridor(out_dir: Path, *, length_m: float, lanes: int, seconds: float) -> Path:
    """Write OUT/corridor-.../ with parquet and map; returns the folder. Lanes 1, 2, ... from the right.

    Errors: ConfigError for a value out of its range; ExportError.
    """
    least_s, most_s = OBSERVED_STEPS * STEP_S, MAX_CORRIDOR_STEPS * STEP_S
    for name, value, least, most, unit in (
        ("length", length_m, _LEAST_M, MAX_LANE_M, " m"),
        ("lanes", lanes, 2, MOST_LANES, ""),
        ("seconds", seconds, least_s, most_s, " s"),
    ):
        if not least <= value <= most:
            raise ConfigError(f"--{name} {value:g}: expected {least:g} to {most:g}{unit}")
    scenario_id = f"{CORRIDOR_PREFIX}{length_m:g}m-{lanes}lanes-{seconds:g}s"
    straight = [
        Lane(n, lanes + 1 - n, 0.0, length_m, False, n + 1 if n < lanes else None, n - 1 if n > 1 else None, ())
        for n in range(1, lanes + 1)
    ]
    return _written(out_dir, scenario_id, straight, lanes, round(seconds / STEP_S))


def write_road(out_dir: Path, file: Path) -> Path:
    """Write OUT/corridor-NAME-DIGEST/ of the file of a road, with that file; returns the folder.

    Errors: ConfigError with file, key, value; ExportError.
    """
    road, content = read_road(file), file.read_bytes()
    if road.seconds > MAX_CORRIDOR_STEPS * STEP_S:
        raise ConfigError(f"{file}: period until {road.seconds:g} s, expected {MAX_CORRIDOR_STEPS * STEP_S:g} at most")
    scenario_id = f"{CORRIDOR_PREFIX}{file.stem}-{hashlib.sha256(content).hexdigest()[:8]}"
    steps = round(max(road.seconds, OBSERVED_STEPS * STEP_S) / STEP_S)
    return _written(out_dir, scenario_id, road.stretches(), road.lanes, steps, {ROAD_FILE: content})


def _written(
    out_dir: Path, name: str, stretches: Sequence[Lane], lanes: int, steps: int, more: Mapping[str, bytes] = {}
) -> Path:
    y, size, still = -(_LANE_M + _SHOULDER_M) / 2, DEFAULT_SIZES["vehicle"], (np.zeros(steps), np.zeros((steps, 2)))
    tracks = [  # the two vehicles on the shoulder, at every step
        Track(track_id, "vehicle", category, np.arange(steps), np.tile([x, y], (steps, 1)), *still, size)
        for track_id, category, x in (("1", FOCAL_CATEGORY, 20.0), (AV_ID, 1, 30.0))
    ]
    same = {"scenario_id": name, "start_timestamp": 0.0, "end_timestamp": (steps - 1) * STEP_S * 1e9}
    same |= {"num_timestamps": steps, "focal_track_id": "1", "city": "corridor"}
    table = parquet_bytes(table_of(tracks, same, observed_steps=OBSERVED_STEPS))
    streets = json.dumps(_map(stretches, lanes)).encode()
    write_folder(out_dir / name, {f"scenario_{name}.parquet": table, f"log_map_archive_{name}.json": streets, **more})
    return out_dir / name


def _map(stretches: Sequence[Lane], lanes: int) -> dict[str, Any]:
    def line(lane: Lane, y: float) -> list[dict[str, float]]:
        x = np.linspace(lane.start_m, lane.end_m, max(2, int((lane.end_m - lane.start_m) / _POINT_EVERY_M) + 1))
        return [{"x": round(float(at), 2), "y": round(y, 2), "z": 0.0} for at in x]

    led_to: dict[int, list[int]] = {lane.lane_id: [] for lane in stretches}
    for lane in stretches:
        for other in lane.successors:
            led_to[other].append(lane.lane_id)
    segments = {}
    for lane in stretches:
        y = (lanes - lane.number) * _LANE_M
        segments[str(lane.lane_id)] = {
            "id": lane.lane_id,
            "is_intersection": lane.crossing,
            "lane_type": "VEHICLE",
            "centerline": line(lane, y),
            "left_lane_boundary": line(lane, y + _LANE_M / 2),
            "right_lane_boundary": line(lane, y - _LANE_M / 2),
            "left_lane_mark_type": "SOLID_WHITE" if lane.closed or lane.left is None else "DASHED_WHITE",
            "right_lane_mark_type": "SOLID_WHITE" if lane.closed or lane.right is None else "DASHED_WHITE",
            "left_neighbor_id": lane.left,
            "right_neighbor_id": lane.right,
            "predecessors": led_to[lane.lane_id],
            "successors": list(lane.successors),
        }
    lowest = min(lanes - lane.number for lane in stretches)
    low, high = (lowest - 0.5) * _LANE_M - _SHOULDER_M, (lanes - 0.5) * _LANE_M + 1.0
    first, last = min(lane.start_m for lane in stretches), max(lane.end_m for lane in stretches)
    corners = [(first - 30.0, low), (last + 30.0, low), (last + 30.0, high), (first - 30.0, high)]
    ground = {"1": {"area_boundary": [{"x": round(a, 2), "y": round(b, 2), "z": 0.0} for a, b in corners], "id": 1}}
    return {"drivable_areas": ground, "lane_segments": segments, "pedestrian_crossings": {}}
