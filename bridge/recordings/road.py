"""A one-way road with its traffic as a file: lanes, ramps, inflow by lane and speed at the end over time."""

from pathlib import Path
from typing import Annotated, NamedTuple, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from bridge.config import read_toml_as
from bridge.recordings.limits import MAX_LANE_M

#: Name of the file in the folder of a corridor that is made of one.
ROAD_FILE = "road.toml"
#: Most lanes, and how ids of lanes are made: row times this, and the lane, counted from the left.
MOST_LANES, ROW = 8, 100
RAMPS = _FEEDER, _OFF = 98, 99

_Share = Annotated[float, Field(ge=0, le=1)]
_Flow = Annotated[float, Field(ge=0, le=3000)]
_Speed = Annotated[float, Field(gt=0, le=40)]


class RoadPart(BaseModel):
    """A part of the file of a road, or of one beside it: unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Beside(RoadPart):
    """An auxiliary lane on the right of all others, m from the section's start, with the ramps that it joins."""

    from_m: float = Field(ge=0)
    to_m: float = Field(gt=0)
    on_ramp: bool = False
    off_ramp: bool = False


class Inflow(RoadPart):
    """Traffic that enters until a time: veh/h by lane, counted from the left, and on the ramp."""

    until_s: float = Field(gt=0)
    veh_per_h: Annotated[list[_Flow], Field(min_length=1)]
    on_ramp: _Flow = 0.0


class EndSpeed(RoadPart):
    """Speed limit behind the section until a time, m/s, by lane: what lies downstream of it."""

    until_s: float = Field(gt=0)
    mps: Annotated[list[_Speed], Field(min_length=1)]


class Lane(NamedTuple):
    """A stretch of a lane, m from the section's start. number: from the left, the auxiliary lane and ramps the last."""

    lane_id: int
    number: int
    start_m: float
    end_m: float
    closed: bool
    left: int | None
    right: int | None
    successors: tuple[int, ...]


class Road(RoadPart):
    """The section that is measured, what lies before and behind it, and its traffic. Lanes are counted from the left.

    approach_m, run_out_m: before and behind the section, where lanes are kept; ramp_m: of each ramp; drop_m: where the
    rightmost lane ends; leaving: share of those of each start lane that take the off-ramp; warm_up_s: not counted;
    step_s: of the simulation; SUMO's models are made for steps up to their time gap.
    """

    length_m: float = Field(ge=100, le=MAX_LANE_M)
    lanes: int = Field(ge=2, le=MOST_LANES)
    approach_m: float = Field(default=150.0, ge=20, le=2000)
    run_out_m: float = Field(default=150.0, ge=20, le=2000)
    ramp_m: float = Field(default=100.0, ge=20, le=1000)
    drop_m: float | None = Field(default=None, gt=0)
    beside: Beside | None = None
    trucks: _Share = 0.0
    warm_up_s: float = Field(default=180.0, ge=0, le=3600)
    step_s: float = Field(default=0.5, gt=0, le=1)
    inflow: Annotated[list[Inflow], Field(min_length=1)]
    end_speed: list[EndSpeed] = []
    leaving: list[_Share] = []
    ramp_leaving: _Share = 0.0

    @model_validator(mode="after")
    def _check(self) -> Self:
        ends = [self.beside.from_m, self.beside.to_m] if self.beside else []
        if ends != sorted(set(ends)) or any(end > self.length_m for end in [*ends, self.drop_m or 0.0]):
            raise ValueError(f"beside and drop_m lie in the section, 0 to {self.length_m:g} m, from_m before to_m")
        if self.drop_m is not None and (self.beside or self.lanes < 3):
            raise ValueError("drop_m: expected three lanes or more, and no lane beside")
        for name, parts in (("inflow", self.inflow), ("end_speed", self.end_speed)):
            if [part.until_s for part in parts] != sorted({part.until_s for part in parts}):
                raise ValueError(f"{name}: until_s has to rise")
        rows = [(f"inflow.veh_per_h until {one.until_s:g} s", one.veh_per_h) for one in self.inflow]
        rows += [(f"end_speed.mps until {one.until_s:g} s", one.mps) for one in self.end_speed]
        for name, values in [*rows, *([("leaving", self.leaving)] if self.leaving else [])]:
            if len(values) != self.lanes:
                raise ValueError(f"{name}: {len(values)} values, expected one for each of {self.lanes} lanes")
        if self.warm_up_s >= self.seconds:
            raise ValueError(f"warm_up_s {self.warm_up_s:g}: expected less than the {self.seconds:g} s of inflow")
        if any(one.on_ramp for one in self.inflow) and not (self.beside and self.beside.on_ramp):
            raise ValueError("inflow.on_ramp: expected beside.on_ramp = true")
        if (any(self.leaving) or self.ramp_leaving) and not (self.beside and self.beside.off_ramp):
            raise ValueError("leaving: expected beside.off_ramp = true")
        return self

    @property
    def seconds(self) -> float:
        """How long traffic enters, s."""
        return self.inflow[-1].until_s

    @property
    def beside_number(self) -> int:
        """What the lane beside, and ramps, are counted as."""
        return self.lanes + 1

    def stretches(self) -> list[Lane]:
        """Every lane, cut where lanes begin and end, row by row and from the left; ramps last."""
        aside = self.beside
        cuts = {-self.approach_m, 0.0, self.length_m, self.length_m + self.run_out_m}
        cuts |= {aside.from_m, aside.to_m} if aside else set()
        cuts |= {self.drop_m} if self.drop_m else set()
        at = sorted(cuts)
        rows: list[list[int]] = []
        for start_m in at[:-1]:
            last = self.lanes - (self.drop_m is not None and start_m >= self.drop_m)
            extra = aside is not None and aside.from_m <= start_m < aside.to_m
            rows.append([*range(1, last + 1), *([self.beside_number] if extra else [])])
        found = []
        for row, numbers in enumerate(rows):
            closed = at[row] < 0.0 or at[row] >= self.length_m
            behind = rows[row + 1] if row + 1 < len(rows) else []
            for number in numbers:
                name = ROW * row + number
                on = (name + ROW,) if number in behind else ()
                if aside and aside.off_ramp and number == self.beside_number and at[row + 1] == aside.to_m:
                    on = (_OFF,)
                left, right = (name + by if number + by in numbers else None for by in (-1, 1))
                found.append(Lane(name, number, at[row], at[row + 1], closed, left, right, on))
        first = at.index(aside.from_m) if aside else 0
        if aside and aside.on_ramp:
            onto = (ROW * first + self.beside_number,)
            start_m = aside.from_m - self.ramp_m
            found.append(Lane(_FEEDER, self.beside_number, start_m, aside.from_m, True, None, None, onto))
        if aside and aside.off_ramp:
            end_m = aside.to_m + self.ramp_m
            found.append(Lane(_OFF, self.beside_number, aside.to_m, end_m, True, None, None, ()))
        return found

    def route(self, number: int, *, leaves: bool) -> list[int]:
        """Lane ids from where a vehicle of a start lane enters to where it leaves, one of each row."""
        known = {lane.lane_id: lane for lane in self.stretches()}
        first_of = {
            lane.lane_id // ROW: lane.lane_id for lane in reversed(known.values()) if lane.lane_id % ROW < _FEEDER
        }
        rows = [first_of[row] for row in sorted(first_of)]
        if number == self.beside_number:
            rows = [_FEEDER, *(one for one in rows if known[one].start_m >= known[_FEEDER].end_m)]
        if leaves:
            rows = [*(one for one in rows if known[one].start_m < known[_OFF].start_m), _OFF]
        return rows


def read_road(path: Path) -> Road:
    """Read a road. Errors: ConfigError with file, key, value."""
    return read_toml_as(Road, path, "a road")
