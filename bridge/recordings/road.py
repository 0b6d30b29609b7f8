"""A one-way road with its traffic as a file: lanes, ramps, signals, and inflow and speed at the end over time."""

from itertools import pairwise
from pathlib import Path
from typing import Annotated, NamedTuple, Self

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, model_validator

from bridge.recordings.limits import MAX_LANE_M
from bridge.toml import read_toml_as

#: Name of the file in the folder of a corridor that is made of one.
ROAD_FILE = "road.toml"
#: Most lanes, and how ids of lanes are made: row times this, and the lane, counted from the left.
MOST_LANES, ROW = 8, 100
RAMPS = _FEEDER, _OFF = 98, 99
#: Length of what lies between a stop line and the other side of the crossing, m.
CROSSING_M = 20.0

_Share = Annotated[float, Field(ge=0, le=1)]
_Flow = Annotated[float, Field(ge=0, le=3000)]
_Speed = Annotated[float, Field(gt=0, le=40)]
_Phase = Annotated[float, Field(ge=1, le=600)]


class RoadPart(BaseModel):
    """A part of the file of a road, or of one beside it: unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Beside(RoadPart):
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

    def red(self, steps: int, step_s: float) -> npt.NDArray[np.bool_]:
        """(T,) whether it is not green."""
        since_s = (np.arange(steps) * step_s - self.offset_s) % sum(seconds for seconds, _ in self.phases)
        return np.asarray(since_s >= self.green_s)


class Period(RoadPart):
    """Traffic until a time: veh/h that enter by lane, counted from the left, the on-ramp last.

    end_mps: speed limit behind the section from the period on, by lane: what lies downstream, without which no
    congestion arises; none: as it was.
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
    beside: Beside | None = None
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
