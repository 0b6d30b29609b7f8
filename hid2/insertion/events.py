"""Events with a recorded target: candidates rolled out until one brings the event about, then driven freely.

An ordered event is an objective over rollouts. Candidates are drawn over the map (`event_places.py`): a place on a
route, a driver as any other is drawn, and a trigger where it changes lanes. Each is rolled out as any other start is
(`starts.py`); the judge is asked whether its motion shows the event, and the cost is how far that is from the middle of
what is asked. The best are driven by SUMO and Algorithm 1 and held to nothing; the first that the judge finds to be as
asked in its exported positions is kept.
"""

import logging
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from itertools import pairwise
from typing import get_args

import numpy as np

from hid2.agents import DEFAULT_SIZES, BoxSize, FloatArray, Policy, Track
from hid2.conflicts.guard import Guard
from hid2.conflicts.stop_lines import StopLines
from hid2.drivers.driver import draw_driver
from hid2.insertion.event_places import Place, Places
from hid2.insertion.event_targets import Target, candidate_rows, target_of
from hid2.insertion.finalise import ExportedVehicle, conflicting, finalise, traffic_of_exported
from hid2.insertion.outcome import Outcome, outcome_of
from hid2.insertion.rollout import Foreseen, Rollout, World
from hid2.insertion.sizes import draw_size
from hid2.insertion.starts import Starts
from hid2.insertion.surroundings import Surroundings
from hid2.judge.claims import EventClaim, crossing_steps, event_step
from hid2.judge.events import EventMeasures, measure_event
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.occupancy.agent_states import agent_states
from hid2.occupancy.gaps import gaps_on_path
from hid2.occupancy.traffic import BoolArray, Traffic
from hid2.params import Config, Event
from hid2.params import EventSearch as EventSearchParams
from hid2.policy.observation import admissible_neighbor
from hid2.policy.overtake import Stage
from hid2.reasons import Reason
from hid2.scene import Scene, clearance_box
from hid2.vehicle import DrivenVehicle, Start, VehicleRequest

#: Drives one vehicle alone among the recorded and the kept ones: scene, stop lines, start, kept ones.
DriveAlone = Callable[[Scene, StopLines, Start, Traffic], DrivenVehicle]
#: Vehicles of events are numbered from here on, behind all others: bookkeeping.
FIRST_NUMBER = 10_000
_POLICY = {"cut_in": Policy.LANE_CHANGE, "overtake": Policy.OVERTAKE}
_MEETS_CROSSING = frozenset({"cross", "merge"})
#: Candidates of one target that are drawn before the best of them is driven, or another target looked at. No tunable.
_AT_A_TIME = 30
#: A place is left out where so many drivers in a row cannot begin. No tunable, spares time.
_NOT_BEGUN = 20
#: Of those that bring it about so many are judged and driven. No tunable.
_BEST = 5
#: A leader is no farther than this beside the target, m. No tunable, spares time: the judge looks again.
_ASIDE_M = 2.5
#: Of each driver so many places are looked at, and the first that is free is taken. No tunable, spares time.
_DRAWS = 32
_CREEPS_MPS = 0.2  # a wish to stand is one to roll on so slowly; no tunable: SUMO takes no wish of 0
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False, slots=True)
class EventOutcome:
    """What became of an event that was asked for; vehicle, at_s s and measures where it came about.

    order: 1 where the vehicle is ahead of the target, or crosses first; tries: vehicles that were driven for it; tried:
    what each try or, where none was driven, each candidate failed by.
    """

    event: Event
    reason: Reason | None = None
    target_id: str | None = None
    vehicle: ExportedVehicle | None = None
    outcome: Outcome | None = None
    at_s: float | None = None
    measures: EventMeasures | None = None
    order: int = 1
    tries: int = 0
    tried: Mapping[Reason, int] = field(default_factory=dict)


def scene_for(scene: Scene, event: Event) -> Scene:
    """The scene with the rules that an event is made by: the gap asked for counts, not the one that drivers like.

    Critical values are lowered only where a criticality below them is asked for. Recorded traffic that crosses makes an
    entrance red (`conflicts/signals.py`); where meeting it is what is asked for, it is red only while it crosses.
    """
    config, conflict = scene.config, scene.config.conflict
    critical: dict[str, float] = {}
    if event.ttc_s is not None:
        # the vehicle is behind, ahead, or either
        names = {"follow": ("ttc_min_s",), "merge": ("ttc_min_s", "follower_ttc_min_s")}
        for name in names.get(event.kind, ("follower_ttc_min_s",)):
            critical[name] = min(getattr(conflict, name), event.ttc_s[0])
    if event.pet_s is not None:
        critical["pet_min_s"] = min(conflict.pet_min_s, event.pet_s[0])
    update: dict[str, object] = {"conflict": conflict.model_copy(update=critical)}
    if event.kind in _MEETS_CROSSING:
        update["signals"] = config.signals.model_copy(update={"before_s": 0.0, "after_s": 0.0})
    if event.kind == "cut_in":  # behind the vehicle the event's band counts alone
        waits_s = min(config.lane_change.give_up_s, float(np.ptp(event.at_band_s)) + 2 * config.event_search.moment_s)
        change = {"time_gap_front_s": config.event_search.cut_in_gap_s, "time_gap_rear_s": 0.0, "min_gap_m": 1.0,
                  "braking_mps2": 9.0, "heading_deg": 20.0, "give_up_s": waits_s}
        update["lane_change"] = config.lane_change.model_copy(update=change)
    changed: Config = config.model_copy(update=update)
    return replace(scene, config=changed, _known={} if "pet_min_s" in critical else scene._known)


@dataclass(frozen=True, eq=False, slots=True)
class Seen:
    """An event as the judge sees it in the states of a vehicle and its target. order: as in `EventOutcome`."""

    at_step: int
    order: int
    measures: EventMeasures


@dataclass(frozen=True, eq=False, slots=True)
class Objective:
    """What is asked for of a vehicle and a target: whether its states show it, and how near to the middle."""

    scene: Scene
    event: Event
    target: Target

    @property
    def search(self) -> EventSearchParams:
        """Of the configuration."""
        return self.scene.config.event_search

    @property
    def _at_band_s(self) -> tuple[float, float]:
        spare_s = self.search.moment_s
        return self.event.at_band_s[0] - spare_s, self.event.at_band_s[1] + spare_s

    def likely_step(self, track: Track) -> int | None:
        """The step nearest to the middle of what is asked at which a vehicle may bring the event about; None for never.

        By centres, boxes and speeds alone: a cheap look before the judge's.
        """
        event, target, at = self.event, self.target, track.timesteps
        forward = np.stack([np.cos(target.heading[at]), np.sin(target.heading[at])], axis=1)
        offset = track.position - target.position[at]
        ahead = (offset * forward).sum(axis=1)
        gap_m = np.abs(ahead) - 0.5 * (track.size.length_m + target.track.size.length_m)
        bands = [(at * self.scene.step_s, self._at_band_s)]
        if event.kind != "cross":  # its gap is the target's to the conflict point
            bands += [(gap_m, event.gap_band_m), (track.speed - target.speed[at], event.difference_band_mps)]
        if event.kind in ("cut_in", "overtake"):
            bands.append((ahead, (0.0, math.inf)))
        if event.kind in ("lead", "follow"):
            aside = np.abs(offset[:, 1] * forward[:, 0] - offset[:, 0] * forward[:, 1])
            bands += [(aside, (0.0, _ASIDE_M)), (ahead if event.kind == "lead" else -ahead, (0.0, math.inf))]
        within = target.present[at] & np.logical_and.reduce([(low <= x) & (x <= high) for x, (low, high) in bands])
        off = np.max([_off(x, band) for x, band in bands[:3]], axis=0)
        return int(at[np.argmin(np.where(within, off, np.inf))]) if within.any() else None

    def seen(self, track: Track) -> Seen | None:
        """The event as the judge sees it; None where it does not."""
        scene, kind, target, near = self.scene, self.event.kind, self.target, self.likely_step(track)
        if near is None:
            return None
        pair = agent_states(
            [target.track, track], scene.states.lanes, num_steps=scene.num_steps, step_s=scene.step_s,
            is_inserted=track.track_id.__eq__,
        )  # fmt: skip
        order, crossed = -1 if kind == "follow" else 1, None
        if kind == "cross":
            crossed = crossing_steps(pair, 1, 0)
            order = 1 if crossed is not None and crossed[0] < crossed[1] else -1
        claim = EventClaim(kind, track.track_id, target.track.track_id, near * scene.step_s, ahead=order > 0)
        at = event_step(pair, claim)
        if at is None or at not in target.track.timesteps or at not in track.timesteps:
            return None
        since = {"cross": 0, "cut_in": max(0, at - scene.steps_in(_ARRIVES_S))}.get(kind, at)
        found = measure_event(pair, 1, 0, at_step=at, since_step=since)
        if crossed is not None:  # from the target's bumper to the conflict point
            way = abs(float(target.way[crossed[1]] - target.way[crossed[0]]))
            found = replace(found, gap_m=way - 0.5 * target.track.size.length_m)
        if kind == "merge":
            row = int(np.searchsorted(track.timesteps, at))
            offset, heading = track.position[row] - target.position[at], target.heading[at]
            order = 1 if offset @ np.array([np.cos(heading), np.sin(heading)]) > 0.0 else -1
        return Seen(at, order, found)

    def cost(self, seen: Seen) -> float:
        """How far from the middle of what is asked, over half of each band; above 1 where it is not as asked."""
        event, found = self.event, seen.measures
        asked = [
            (seen.at_step * self.scene.step_s, self._at_band_s), (found.gap_m, event.gap_band_m),
            (found.speed_difference_mps, event.difference_band_mps), (found.min_ttc_s, event.ttc_s),
            (found.pet_s, event.pet_s), (found.drac_mps2, event.drac_mps2),
        ]  # fmt: skip
        offs = [
            float(_off(np.array(math.inf if value is None else value), band)) for value, band in asked
            if band is not None
        ]  # fmt: skip
        if event.brakes_mps2:
            offs.append(abs(found.brakes_mps2 / event.brakes_mps2 - 1.0) / (1.0 - self.search.brakes_share))
        return max(offs)


def _off(value: FloatArray, band: tuple[float, float]) -> FloatArray:
    """Distance from the middle of a band, over half of it."""
    return np.abs(value - 0.5 * (band[0] + band[1])) / max(0.5 * (band[1] - band[0]), 1e-6)


@dataclass(slots=True)
class _EventStarts(Starts):
    """Starts whose rollouts may bring an event about.

    place: at which; made: what was rolled out last; rolls: how often that has been done.
    """

    _: KW_ONLY
    objective: Objective
    place: Place | None = None
    made: Start | None = None
    rolls: int = 0

    def _does(self, world: World, start: Start) -> tuple[Rollout, ...] | Reason:
        """The rollout of a vehicle that may bring the event about, and meets nothing; or why it does not.

        What is to change lanes does so when it would be at the place half a change later, or now for an overtake.
        """
        place, parts, policy = self.place, (world.roll(start),), start.request.policy
        assert place is not None
        self.rolls += 1
        there = place.is_come_to(parts[0].s, world.scene.step_s * parts[0].v)
        if place.side is not None:
            half = world.scene.steps_in(0.5 * start.driver.lane_change_s) if policy is Policy.LANE_CHANGE else 0
            there &= self._may_change(place, parts[0].s)
            there = np.concatenate([there[half:], np.zeros(min(half, there.size), dtype=np.bool_)])
            there &= self._may_change(place, parts[0].s)
        if not there.any():
            return Reason.EVENT_NOT_AS_ASKED
        self.made = start
        if place.side is not None:
            step = int(self.rng.choice(np.flatnonzero(there)))
            request = replace(start.request, trigger_s=step * world.scene.step_s)
            self.made = replace(start, request=request, sides=(place.side,))
            vehicle, parts = world.act(self.made)
            if not vehicle.shifts or (policy is Policy.OVERTAKE and vehicle.stage is not Stage.DONE):
                return vehicle.reason or Reason.SCENE_ENDED
            trigger_s = vehicle.shifts[0].requested_step * world.scene.step_s
            self.made = replace(self.made, request=replace(request, trigger_s=trigger_s))
        step = self.objective.likely_step(track_of(world.foreseen(start, parts)))
        if step is None:
            return Reason.EVENT_NOT_AS_ASKED
        if self.objective.event.brakes_mps2:
            self.made = self._braking(self.made, step, float(parts[-1].v[step]))
            parts = (world.roll(self.made),)
        return world.objection(self.made, parts) or parts

    def _braking(self, start: Start, step: int, speed_mps: float) -> Start:
        """A driver whose wish falls from a step on, so that it brakes as hard as is asked for, and then drives on.

        By the IDM a (1 - (v / v0)^4) = -b, so v0 = v / (1 + b / a)^(1/4).
        """
        scene, brakes_mps2 = self.scene, self.objective.event.brakes_mps2
        braked_s = scene.step_s * np.arange(start.desired.size - step)
        speed = speed_mps - brakes_mps2 * np.minimum(braked_s, scene.config.event_search.brakes_s)
        ratio = (1.0 + brakes_mps2 / start.driver.accel_mps2) ** 0.25
        wish = np.where(braked_s < scene.config.event_search.brakes_s, speed / ratio, speed)
        desired = np.concatenate([start.desired[:step], np.maximum(wish, _CREEPS_MPS)])
        driver = replace(start.driver, decel_mps2=max(start.driver.decel_mps2, brakes_mps2))
        return replace(start, desired=desired, driver=driver)

    def _may_change(self, place: Place, s: FloatArray) -> BoolArray:
        """(K,) whether the marking lets a vehicle over at places, m."""
        assert place.side is not None
        may = [admissible_neighbor(self.scene, one.lane_id, place.side) is not None for one in place.path.segments]
        ends = np.array([segment.end for segment in place.path.segments])
        return np.array(may)[np.minimum(np.searchsorted(ends, s, side="right"), ends.size - 1)]

    def rolled(self, start: Start) -> Foreseen:
        """The rollout of a start that was made last."""
        assert self.made is not None
        return replace(self._rolled[start.vehicle_id][0], start=replace(self.made, offset=start.offset))


def track_of(foreseen: Foreseen) -> Track:
    """A rolled-out vehicle as it would be exported."""
    traffic, start = foreseen.traffic, foreseen.start
    steps = np.flatnonzero(traffic.present[0, : start.desired.size])
    return Track(
        start.vehicle_id, start.object_type, 1, steps, traffic.position[0, steps], traffic.heading[0, steps],
        traffic.velocity[0, steps], start.size,
    )  # fmt: skip


@dataclass(frozen=True, eq=False, slots=True)
class _Candidate:
    """A rolled-out vehicle that brings an event about. cost: as in `Objective.cost`."""

    rolled: Foreseen
    cost: float

    def as_driven(self) -> DrivenVehicle:
        """As if SUMO had driven it, for the last word."""
        *before, last = self.rolled.parts
        ends = [later.step - part.step for part, later in pairwise(self.rolled.parts)]
        s, v = (
            np.concatenate([*(getattr(part, name)[:end] for part, end in zip(before, ends, strict=True)),
                            getattr(last, name)]).tolist()
            for name in ("s", "v")
        )  # fmt: skip
        return DrivenVehicle(self.rolled.start, last.path, s, v, [0.0] * len(s))


@dataclass(slots=True)
class _Candidates:
    """Candidates for an event with one target, drawn over its places."""

    objective: Objective
    here: Surroundings
    size: BoxSize
    guard: Guard
    rng: np.random.Generator
    number: int
    rejected: Counter[Reason]
    places: list[Place] = field(init=False)
    _box: BoxSize = field(init=False)
    _starts: _EventStarts = field(init=False)
    _begun: list[int] = field(init=False)

    def __post_init__(self) -> None:
        """Find the places."""
        objective = self.objective
        lengths_m = 0.5 * (self.size.length_m + objective.target.track.size.length_m)
        self._box = clearance_box(self.size, DEFAULT_SIZES["vehicle"])
        self.places = list(Places(self.here.routes, objective.event, objective.target, lengths_m).all())
        self._begun = [0] * len(self.places)
        self._starts = _EventStarts(
            objective.scene, self.here.roads, self.guard.stop_lines, self.here.meetings, self.guard, self.rng, 0,
            objective=objective,
        )  # fmt: skip

    def draw(self, count: int) -> list[_Candidate]:
        """Those of so many rolled out that bring the event about; places where none can begin are left out from then on."""
        found: list[_Candidate] = []
        rolled = self._starts.rolls
        while self.places and self._starts.rolls - rolled < count:
            row, before = int(self.rng.integers(len(self.places))), self._starts.rolls
            made = self._drawn(self.places[row])
            if not isinstance(made, Reason):
                found.append(made)
                continue
            self.rejected[made] += 1
            self._begun[row] += 1 if self._starts.rolls == before else -self._begun[row]
            if self._begun[row] >= _NOT_BEGUN:
                del self.places[row], self._begun[row]
        return found

    def _drawn(self, place: Place) -> _Candidate | Reason:
        """A candidate that begins where its driver would be at the place in time; or why it is none."""
        scene, event, rng, starts = self.objective.scene, self.objective.event, self.rng, self._starts
        at = rng.choice(np.flatnonzero(np.isfinite(place.along)), _DRAWS)
        s = place.along[at] + rng.uniform(*place.beyond, _DRAWS)
        driver = draw_driver(scene.config, rng, lane_speed_mps=self._flow_mps(place, int(at[0]), float(s[0])))
        pace = np.minimum(self.here.roads.speeds(place.path, driver), driver.desired_mps)
        time_s = np.concatenate([[0.0], np.cumsum(TABLE_STEP_M / np.maximum(pace, _CREEPS_MPS))])
        cells = np.arange(time_s.size) * TABLE_STEP_M
        held_up = np.where(rng.random(_DRAWS) < 0.5, 1.0, rng.random(_DRAWS))  # share of the way that it comes so far
        start_s = np.interp(np.interp(s, cells, time_s) - held_up * at * scene.step_s, time_s, cells, left=-1.0)
        near = gaps_on_path(starts.world.known_on(place.path, self._box), start_s, 0)
        clear = np.minimum(near.lead_m, near.lag_m) >= scene.config.spawn.clear_gap_m
        clear &= (start_s > 0.5 * self._box.length_m) & (s < place.path.exit_s)
        if not clear.any():
            return Reason.NO_SITE
        row = int(np.argmax(clear))
        request = VehicleRequest(FIRST_NUMBER + self.number, _POLICY.get(event.kind, Policy.STRAIGHT), 0.0)
        begin_s, starts.place = float(start_s[row]), place
        start = starts.make(
            request, place.offer, place.path.segment_at(begin_s).lane_id, place.path.to_raw(begin_s), driver=driver,
            size=self.size,
        )  # fmt: skip
        if isinstance(start, Reason):
            return start
        rolled = starts.rolled(start)
        seen = self.objective.seen(track_of(rolled))
        if seen is None:
            return Reason.EVENT_NOT_AS_ASKED
        cost = self.objective.cost(seen)
        return _Candidate(rolled, cost) if cost <= 1.0 else Reason.EVENT_NOT_AS_ASKED

    def _flow_mps(self, place: Place, at: int, s: float) -> float:
        """Speed of the traffic that a driver goes with: its lane's, the target's then, or at its fastest, m/s."""
        target, kind = self.objective.target, int(self.rng.integers(3))
        if kind == 0 or self.objective.event.kind in ("cross", "overtake"):
            return self.objective.scene.lane_speed(place.path.segment_at(s).lane_id, self.rng)
        return float(target.speed[at] if kind == 1 else target.speed[target.present].max())


#: No tunable: the criticality of a cut-in counts from when the vehicle is about half way over, s before the moment.
_ARRIVES_S = 1.5


@dataclass(slots=True)
class EventSearch:
    """Searches the events of one scene, one after the other. kept: vehicles of events that came about so far."""

    here: Surroundings
    seed: Sequence[int]
    kept: list[ExportedVehicle] = field(default_factory=list)
    tried: Counter[Reason] = field(default_factory=Counter)

    def run(self, drive: DriveAlone) -> list[EventOutcome]:
        """All events of the configuration, in order."""
        found: list[EventOutcome] = []
        for event in self.here.scene.config.event:
            for _ in range(event.count):
                outcome = self.search(event, len(found), drive)
                if outcome.vehicle is not None:
                    self.kept.append(outcome.vehicle)
                found.append(outcome)
        return found

    def search(self, event: Event, number: int, drive: DriveAlone) -> EventOutcome:
        """One event; its reason where none of the tries brought it about."""
        rng = np.random.default_rng([*self.seed, 0xE7E27, number])
        scene = scene_for(self.here.scene, event)
        fixed = traffic_of_exported(self.kept, scene)
        lines = StopLines(scene) if event.kind in _MEETS_CROSSING else self.here.stop_lines
        objectives = self._objectives(scene, event, rng)
        if not objectives:
            return EventOutcome(event, Reason.EVENT_NO_TARGET)
        self.tried, rejected, tries = Counter(), Counter[Reason](), 0
        _, size = draw_size(scene.config.request.model_copy(update={"bus_share": 0.0}), rng)
        guard = Guard(scene, fixed, lines)
        for objective, candidate in self._likely(objectives, size, guard, rng, number, rejected):
            start = replace(candidate.rolled.start, vehicle_id=f"e{number}_{tries}")
            outcome = self._drive(objective, lines, start, fixed, drive)
            tries += 1
            if outcome is not None:
                return replace(outcome, tries=tries)
            if tries >= scene.config.event_search.tries:
                break
        tried = dict((self.tried or _told(rejected)).most_common())
        said = ", ".join(f"{reason} {count}" for reason, count in tried.items())
        _LOG.debug("event %s: %d tries; %s", event.kind, tries, said or "no place")
        reason = Reason.EVENT_NOT_AS_ASKED if tries else Reason.EVENT_NO_PLACE
        return EventOutcome(event, reason, tries=tries, tried=tried)

    def _objectives(self, scene: Scene, event: Event, rng: np.random.Generator) -> list[Objective]:
        """Of the targets that may be taken, in the order in which they are tried."""
        rows = candidate_rows(scene, event.target)
        if event.target == "any":
            rows = [rows[k] for k in rng.permutation(len(rows)).tolist()]
        return [Objective(scene, event, target) for row in rows if (target := target_of(scene, row)) is not None]

    def _likely(
        self, objectives: Sequence[Objective], size: BoxSize, guard: Guard, rng: np.random.Generator, number: int,
        rejected: Counter[Reason],
    ) -> Iterator[tuple[Objective, _Candidate]]:  # fmt: skip
        """Candidates that bring the event about, the best of a few first; targets in turns."""
        known: dict[int, _Candidates] = {}
        left, waiting = guard.scene.config.event_search.candidates, list(range(len(objectives)))
        while left > 0 and waiting:
            row = waiting.pop(0)
            if row not in known:
                known[row] = _Candidates(objectives[row], self.here, size, guard, rng, number, rejected)
            likely = sorted(known[row].draw(_AT_A_TIME), key=lambda one: one.cost)
            left -= _AT_A_TIME
            if known[row].places:
                waiting.append(row)
            for candidate in likely[:_BEST]:
                judged = self._judged(objectives[row], candidate.as_driven())
                if isinstance(judged, Reason):
                    rejected[judged] += 1
                else:
                    yield objectives[row], candidate

    def _drive(
        self, objective: Objective, lines: StopLines, start: Start, fixed: Traffic, drive: DriveAlone
    ) -> EventOutcome | None:
        """Drive a candidate: the event where it came about as asked; else its reason is counted."""
        scene, event, target = objective.scene, objective.event, objective.target
        judged = self._judged(objective, drive(scene, lines, start, fixed))
        if isinstance(judged, Reason):
            self.tried[judged] += 1
            _LOG.debug(
                "event %s: %s at %.1f m of lane %d, %.1f m/s, trigger %.1f s: %s", event.kind, start.vehicle_id,
                start.start_s, start.path.segment_at(start.start_s).lane_id, start.start_mps, start.request.trigger_s,
                judged,
            )  # fmt: skip
            return None
        vehicle, seen = judged
        return EventOutcome(
            event, None, target.track.track_id, vehicle, outcome_of(scene, vehicle, self.kept),
            seen.at_step * scene.step_s, seen.measures, seen.order,
        )  # fmt: skip

    def _judged(self, objective: Objective, driven: DrivenVehicle) -> tuple[ExportedVehicle, Seen] | Reason:
        """A vehicle that is exported and brings the event about as asked, beside those kept; or why it is not."""
        vehicle = finalise(objective.scene, driven, self.kept)
        if isinstance(vehicle, Reason):
            return vehicle
        seen = objective.seen(vehicle.track(driven.vehicle_id, 1))
        if seen is None or objective.cost(seen) > 1.0:
            return driven.reason or Reason.EVENT_NOT_AS_ASKED
        conflicts = conflicting(objective.scene, [*self.kept, vehicle])
        own = next((reason for row, reason in conflicts if row >= len(self.kept)), None)
        return own or (vehicle, seen)


def _told(rejected: Counter[Reason]) -> Counter[Reason]:
    """What candidates failed by that were as asked, where any was."""
    others = Counter({reason: count for reason, count in rejected.items() if reason is not Reason.EVENT_NOT_AS_ASKED})
    return others or rejected


def offered_events(here: Surroundings, targets: Sequence[str]) -> tuple[str, ...]:
    """Which events come about in a rollout, as `kind:target`: of a vehicle of usual size, from second 1 to 4 s before the end; an overtake to the end."""
    return ()
