"""Candidates for an event: drawn over its places and rolled out; those count in which the judge sees the event."""

import math
from collections import Counter
from dataclasses import KW_ONLY, dataclass, field, replace
from itertools import pairwise

import numpy as np

from hid2.agents import DEFAULT_SIZES, BoxSize, FloatArray, Policy, Track
from hid2.conflicts.guard import Guard
from hid2.drivers.driver import Driver, draw_driver
from hid2.insertion.event_objective import MOMENT_S, Objective
from hid2.insertion.event_places import ABOUT_M, Place
from hid2.insertion.rollout import RolledOut, Rollout, World
from hid2.insertion.starts import Begin, Site, Starts, are_clear
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.occupancy.gaps import gaps_on_path
from hid2.occupancy.traffic import BoolArray, Traffic
from hid2.policy.observation import admissible_neighbor
from hid2.policy.overtake import Stage
from hid2.reasons import Reason
from hid2.scene import clearance_box
from hid2.vehicle import DrivenVehicle, Start, VehicleRequest

_BRAKES_S = 2.5  # duration of the braking asked for; no tunable: until about 20 km/h slower than before
#: Beginnings drawn for a driver, of which the first free one is taken. No tunable: bounds the search.
_DRAWS = 32
#: Drivers in a row that cannot begin at a place, after which the place is left out. No tunable: bounds the search.
_NOT_BEGUN = 20
#: Drivers drawn, of which the fastest is to overtake, or the quickest across to cut in. No tunable: bounds the search.
_ASKED = 10
#: Candidates that bring an event about, tried best first before more are drawn. Not a parameter, it saves time.
_ENOUGH = 8
_CREEPS_MPS = 0.2  # desired speed of a vehicle that is to stand; no tunable: SUMO takes no desired speed of 0


@dataclass(frozen=True, eq=False, slots=True)
class Candidate:
    """A rolled-out vehicle that brings an event about. cost: as in `Objective.cost`."""

    rolled: RolledOut
    cost: float

    def as_driven(self) -> DrivenVehicle:
        """As if SUMO had driven it, for the final check."""
        parts = self.rolled.parts
        whole = [one.until(later.step - 1) for one, later in pairwise(parts)] + [parts[-1]]
        s, v = np.concatenate([part.s for part in whole]).tolist(), np.concatenate([part.v for part in whole]).tolist()
        return DrivenVehicle(self.rolled.start, parts[-1].path, s, v, [0.0] * len(s))


@dataclass(slots=True)
class EventStarts(Starts):
    """Starts with rollouts that bring an event about.

    request: of its vehicle; places: at which it may come about; rolls: how many were rolled out; _best: cost, place,
    driver and begin, m on its path, of the one nearest to what is asked so far.
    """

    _: KW_ONLY
    objective: Objective
    request: VehicleRequest
    places: list[Place]
    rolls: int = 0
    _box: BoxSize = field(init=False)
    _not_begun: Counter[int] = field(default_factory=Counter)
    _place: Place = field(init=False)
    _made: Start = field(init=False)
    _best: tuple[float, Place, Driver, float] | None = None
    _without_others: World = field(init=False)

    def __post_init__(self, guard: Guard) -> None:
        """Nothing is rolled out yet."""
        Starts.__post_init__(self, guard)
        self.world.target_id = self.objective.target.track.track_id
        self._box = clearance_box(self.request.size, DEFAULT_SIZES["vehicle"])
        recorded_alone = replace(guard, inserted_known=Traffic.none(self.scene.future.num_steps))
        self._without_others = World(self.scene, self.roads, recorded_alone)

    def draw(self, count: int) -> list[Candidate]:
        """Those of so many rolled out that bring the event about, the best first; no more than `_ENOUGH`."""
        found: list[Candidate] = []
        until = self.rolls + count
        while self.rolls < until and len(found) < _ENOUGH:
            places = [n for n in range(len(self.places)) if self._not_begun[n] < _NOT_BEGUN]
            if not places:
                break
            number, before = places[int(self.rng.integers(len(places)))], self.rolls
            made = self._drawn(self.places[number])
            self._not_begun[number] = self._not_begun[number] + 1 if self.rolls == before else 0
            if isinstance(made, Reason):
                self.refusals[made] += 1
            else:
                found.append(made)
        return sorted(found, key=lambda one: one.cost)

    def _drawn(self, place: Place) -> Candidate | Reason:
        """A candidate, or why it is none: a new driver at the place in time, or that of the best so far near by.

        Of events that come about few are as critical as asked: by a little more or less way they are.
        """
        if self._best is None or self.rng.random() < 0.5:
            begun = self._begins(place)
            if begun is None:
                return Reason.NO_SITE
        else:
            place, driver, first = self._best[1:]
            begun = driver, first + self.rng.uniform(-ABOUT_M, ABOUT_M)
        (driver, first), self._place = begun, place
        start = self.make(self.request, Site(place.offer, place.path.to_raw(first)), driver=driver)
        if isinstance(start, Reason):
            return start
        rolled = replace(self.rolled(start)[0], start=replace(self._made, offset=start.offset))
        seen = self.objective.seen(track_of(rolled))
        if seen is None:
            return Reason.EVENT_NOT_THERE
        cost = self.objective.cost(seen)
        if cost < (math.inf if self._best is None else self._best[0]):
            self._best = cost, place, driver, first
        return self.objective.missed_by(seen) or Candidate(rolled, cost)

    def _begins(self, place: Place) -> tuple[Driver, float] | None:
        """A driver and where it begins, m along the path; None where that is not free."""
        scene, rng = self.scene, self.rng
        at = rng.choice(np.flatnonzero(np.isfinite(place.along)), _DRAWS)
        s = place.along[at] + rng.uniform(*place.beyond, _DRAWS)
        driver = self._driver(place, int(at[0]), float(s[0]))
        pace = np.minimum(self.roads.speeds(place.path, driver), driver.desired_mps)
        time_s = np.concatenate([[0.0], np.cumsum(TABLE_STEP_M / np.maximum(pace, _CREEPS_MPS))])
        cells = np.arange(time_s.size) * TABLE_STEP_M
        freely = np.where(rng.random(_DRAWS) < 0.5, 1.0, rng.random(_DRAWS))  # share of the time in which it is held up
        begin_m = np.interp(np.interp(s, cells, time_s) - freely * at * scene.step_s, time_s, cells, left=-1.0)
        clear = are_clear(gaps_on_path(self.world.guard.known_on(place.path, self._box), begin_m, 0))
        clear &= (begin_m > 0.5 * self._box.length_m) & (s < place.path.exit_m)
        return (driver, float(begin_m[np.argmax(clear)])) if clear.any() else None

    def _driver(self, place: Place, at: int, s: float) -> Driver:
        """A driver that goes with the traffic of its lane, with the target as it is then, or at its fastest.

        Of some drawn what is to overtake the target is the fastest, and what is to cut in the quickest across: there is
        little time.
        """
        target, config, kind = self.objective.target, self.scene.config, int(self.rng.integers(3))
        lane_id = place.path.segment_at(s).lane_id
        if self.request.policy is Policy.OVERTAKE:
            flows = [self.scene.lane_speed(lane_id, self.rng) for _ in range(_ASKED)]
        elif kind == 0:
            flows = [self.scene.lane_speed(lane_id, self.rng)]
        else:
            flows = [float(target.speed[at] if kind == 1 else target.speed[target.present].max())]
        if self.request.policy is Policy.LANE_CHANGE:
            drawn = [draw_driver(config, self.rng, lane_speed_mps=flows[0]) for _ in range(_ASKED)]
            return min(drawn, key=lambda one: one.lane_change_s)
        drawn = [draw_driver(config, self.rng, lane_speed_mps=flow_mps) for flow_mps in flows]
        return max(drawn, key=lambda one: one.desired_mps)

    def _start_speed(self, world: World, begin: Begin, speed: float, driver: Driver) -> float | Reason:
        """The same; where vehicles of events before are all that is in the way, they are told to be met."""
        found = Starts._start_speed(self, world, begin, speed, driver)
        if found is Reason.NO_SITE and world.guard.inserted_known.ids:
            alone = Starts._start_speed(self, self._without_others, begin, speed, driver)
            return alone if isinstance(alone, Reason) else Reason.MEETS_GENERATED
        return found

    def _performed(self, world: World, start: Start) -> tuple[Rollout, ...] | Reason:
        """The rollout of a vehicle that may bring the event about, and meets nothing; or why it does not.

        The moment of a lane change is one at which the vehicle would be at the place half a change later, of an
        overtake one at which it is there.
        """
        self.rolls, self._made, place = self.rolls + 1, start, self._place
        parts: tuple[Rollout, ...] = (world.roll(start),)
        there = place.is_come_to(parts[0].s, self.scene.step_s * parts[0].v)
        if place.side is not None:
            overtakes = start.request.policy is Policy.OVERTAKE
            early = 0 if overtakes else self.scene.steps_in(0.5 * start.driver.lane_change_s)
            may = self._may_change(place, parts[0].s)
            there = (there & may)[early:] & may[: max(may.size - early, 0)]
        if not there.any():
            return Reason.EVENT_NOT_THERE
        if place.side is not None:
            step = int(self.rng.choice(np.flatnonzero(there)))
            request = replace(start.request, trigger_s=step * self.scene.step_s)
            vehicle, parts = world.roll_manoeuvre(replace(start, request=request, sides=(place.side,)))
            if not vehicle.shifts or (start.request.policy is Policy.OVERTAKE and vehicle.stage is not Stage.DONE):
                return vehicle.reason or Reason.SCENE_ENDED
            request = replace(request, trigger_s=vehicle.shifts[0].requested_step * self.scene.step_s)
            self._made = replace(vehicle.start, request=request)
        moment = self.objective.likely_step(track_of(world.rolled_out(start, parts)))
        if moment is None:
            return Reason.EVENT_NOT_THERE
        if self.objective.event.brakes_mps2:
            self._made = self._braking(start, moment, float(parts[0].v[moment]))
            parts = (world.roll(self._made),)
            seen_at = self.objective.likely_step(track_of(world.rolled_out(start, parts)))
            if seen_at is None or abs(seen_at - moment) > self.scene.steps_in(MOMENT_S):
                return Reason.EVENT_NOT_THERE  # it would be seen to brake before
        found = world.rejection_reason(self._made, parts)
        if found is Reason.TTC_LANE_LEADER and place.side is not None:
            found = None  # one that stands aside on the lane left counts there: the judge tells before any is driven
        return found or parts

    def _may_change(self, place: Place, s: FloatArray) -> BoolArray:
        """(K,) whether the marking lets a vehicle over at places, m."""
        assert place.side is not None
        may = [admissible_neighbor(self.scene, one.lane_id, place.side) is not None for one in place.path.segments]
        ends = np.array([segment.end for segment in place.path.segments])
        return np.array(may)[np.minimum(np.searchsorted(ends, s, side="right"), ends.size - 1)]

    def _braking(self, start: Start, step: int, speed_mps: float) -> Start:
        """A driver with a desired speed that falls from a step on, as fast as it is to brake, then is as before.

        SUMO takes a desired speed for the most that a vehicle may drive, and brakes for one that falls.
        """
        brakes_mps2 = self.objective.event.brakes_mps2
        since_s = self.scene.step_s * np.arange(start.desired.size - step)
        falling = np.maximum(speed_mps - brakes_mps2 * since_s, _CREEPS_MPS)
        desired = np.where(since_s < _BRAKES_S, falling, start.desired[step:])
        driver = replace(start.driver, decel_mps2=max(start.driver.decel_mps2, brakes_mps2))
        return replace(start, desired=np.concatenate([start.desired[:step], desired]), driver=driver)


def track_of(rolled: RolledOut) -> Track:
    """A rolled-out vehicle as it would be exported."""
    traffic, start = rolled.traffic, rolled.start
    steps = np.flatnonzero(traffic.present[0, : start.desired.size])
    return Track(
        start.vehicle_id, start.request.object_type, 1, steps, traffic.position[0, steps], traffic.heading[0, steps],
        traffic.velocity[0, steps], start.size,
    )  # fmt: skip
