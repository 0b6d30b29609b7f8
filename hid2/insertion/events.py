"""Events with a recorded target, searched over sites, speeds and trigger times until they come about as asked.

The same machinery as for any other vehicle: a site, a driver, a trigger; SUMO drives, Algorithm 1 decides, the last
word is `finalise`. What is added is a plan (`event_plans.py`), and a look at the exported positions: does the event
have the time, the gap, the speed difference and the criticality asked for? If not, the next try begins farther ahead or
later by what was missing, or follows another plan.
"""

import logging
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import get_args

import numpy as np

from hid2.agents import DEFAULT_SIZES, Policy
from hid2.conflicts.guard import Guard
from hid2.conflicts.stop_lines import StopLines
from hid2.drivers.driver import desired_speeds, lane_offset
from hid2.insertion.event_plans import Plan, Planner
from hid2.insertion.event_targets import candidate_rows, target_of
from hid2.insertion.finalise import ExportedVehicle, conflicting, finalise, traffic_of_exported
from hid2.insertion.outcome import Outcome, outcome_of
from hid2.insertion.routes import Routes
from hid2.insertion.sizes import draw_size
from hid2.judge.claims import EventClaim, crossing_steps, event_step
from hid2.judge.events import EventMeasures, measure_event
from hid2.occupancy.agent_states import agent_states
from hid2.occupancy.traffic import Traffic
from hid2.params import Config, Event
from hid2.policy.roads import Roads
from hid2.reasons import Reason
from hid2.scene import Scene, clearance_box
from hid2.vehicle import DrivenVehicle, Start, VehicleRequest

#: Drives one vehicle alone among the recorded and the kept ones: scene, stop lines, start, kept ones.
DriveAlone = Callable[[Scene, StopLines, Start, Traffic], DrivenVehicle]
#: Vehicles of events are numbered from here on, behind all others: bookkeeping.
FIRST_NUMBER = 10_000
_POLICY = {"cut_in": Policy.LANE_CHANGE, "overtake": Policy.OVERTAKE}
_MEETS_CROSSING = frozenset({"cross", "merge"})
_SAME_M = 0.1  # a start moved by less is the same; no tunable
_CREEPS_MPS = 0.2  # who wishes to stand is let roll on so slowly; no tunable: SUMO takes no wish of 0
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False, slots=True)
class EventOutcome:
    """What became of an event that was asked for; vehicle, at_s s and measures where it came about.

    order: 1 where the vehicle is ahead of the target, or crosses first; tries: vehicles that were driven for it; tried:
    what each try or, where nobody was driven, each plan failed by.
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


@dataclass(frozen=True, eq=False, slots=True)
class _Seen:
    """An event as it is seen in exported positions."""

    at_step: int
    measures: EventMeasures


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
    if event.kind == "cut_in":
        search = config.event_search
        change = {  # behind the vehicle the event's band counts alone
            "time_gap_front_s": search.cut_in_gap_s, "min_gap_m": search.cut_in_gap_m, "time_gap_rear_s": 0.0,
            "braking_mps2": search.cut_in_braking_mps2, "heading_deg": search.cut_in_heading_deg,
        }  # fmt: skip
        update["lane_change"] = config.lane_change.model_copy(update=change)
    changed: Config = config.model_copy(update=update)
    return replace(scene, config=changed, _known={} if "pet_min_s" in critical else scene._known)


def offered_events(routes: Routes, targets: Sequence[str]) -> tuple[str, ...]:
    """Which events the map, the targets' ways and recorded traffic have room for by plan, as `kind:target`.

    From second 1 on to 4 s before the end, an overtake to the end; a vehicle of usual size.
    """
    scene = routes.scene
    size, roads = DEFAULT_SIZES["vehicle"], Roads(scene)
    usual_lines, nobody = StopLines(scene), traffic_of_exported([], scene)
    found = []
    at = {name: target_of(scene, row) for name in targets for row in candidate_rows(scene, name)[:1]}
    for kind in get_args(Event.model_fields["kind"].annotation):
        until_s = scene.last_s if kind == "overtake" else scene.last_s - 4.0
        event = Event(kind=kind, at_s=(1.0, max(1.0, until_s)))
        ruled = scene_for(scene, event)
        lines = StopLines(ruled) if kind in _MEETS_CROSSING else usual_lines
        planner = Planner(ruled, routes, roads, size, clearance_box(size, size), Guard(ruled, nobody, lines))
        found += [f"{kind}:{name}" for name, target in at.items() if target and planner.has_plan(event, target)]
    return tuple(sorted(found, key=lambda one: targets.index(one.partition(":")[2])))


@dataclass(slots=True)
class EventSearch:
    """Searches the events of one scene, one after the other. kept: vehicles of events that came about so far."""

    scene: Scene
    roads: Roads
    routes: Routes
    stop_lines: StopLines
    seed: Sequence[int]
    kept: list[ExportedVehicle] = field(default_factory=list)
    tried: Counter[Reason] = field(default_factory=Counter)

    def run(self, drive: DriveAlone) -> list[EventOutcome]:
        """All events of the configuration, in order."""
        found: list[EventOutcome] = []
        for event in self.scene.config.event:
            for _ in range(event.count):
                outcome = self.search(event, len(found), drive)
                if outcome.vehicle is not None:
                    self.kept.append(outcome.vehicle)
                found.append(outcome)
        return found

    def search(self, event: Event, number: int, drive: DriveAlone) -> EventOutcome:
        """One event; its reason where none of the tries brought it about."""
        rng = np.random.default_rng([*self.seed, 0xE7E27, number])
        self.tried = Counter()
        scene = scene_for(self.scene, event)
        rows = self._targets(event, rng)
        targets = [target for row in rows if (target := target_of(scene, row)) is not None]
        if not targets:
            return EventOutcome(event, Reason.EVENT_NO_TARGET)
        object_type, size = draw_size(scene.config.request.model_copy(update={"bus_share": 0.0}), rng)
        fixed = traffic_of_exported(self.kept, scene)
        lines = StopLines(scene) if event.kind in _MEETS_CROSSING else self.stop_lines
        guard = Guard(scene, fixed, lines)
        for planned in (size, DEFAULT_SIZES[object_type]):  # a usual car fits where the one drawn is too long
            box = clearance_box(planned, DEFAULT_SIZES[object_type])
            planner = Planner(scene, self.routes, self.roads, planned, box, guard)
            found = [planner.plans(event, target) for target in targets]
            if any(found):
                break
        search, tries = scene.config.event_search, 0
        for plan in self._plans(found, rng):
            best: Plan | None = plan
            for _ in range(search.plan_tries):
                if best is None or tries >= search.tries:
                    break
                start = self._start(planner, best, number, tries, rng)
                objection = planner.objection(best, start.driver, start.box)
                if objection is not None:
                    self.tried[objection] += 1
                    break
                outcome, best = self._drive(scene, lines, best, start, fixed, drive)
                tries += 1
                if outcome is not None:
                    return replace(outcome, tries=tries)
            if tries >= search.tries:
                break
        tried = dict((self.tried or +planner.turned_down).most_common())
        said = ", ".join(f"{reason} {count}" for reason, count in tried.items())
        _LOG.debug("event %s: %d tries; %s", event.kind, tries, said or "no plan")
        reason = Reason.EVENT_NOT_AS_ASKED if tries else Reason.EVENT_NO_PLACE
        return EventOutcome(event, reason, tries=tries, tried=tried)

    def _targets(self, event: Event, rng: np.random.Generator) -> list[int]:
        """Rows of the targets that may be taken, in the order in which they are tried."""
        rows = candidate_rows(self.scene, event.target)
        return [rows[k] for k in rng.permutation(len(rows)).tolist()] if event.target == "any" else rows

    def _plans(self, found: Sequence[list[Plan]], rng: np.random.Generator) -> Iterator[Plan]:
        """Plans of all targets in turns, those of a target the likeliest first, with a little chance among them.

        Those that are like one that was given out before come later.
        """
        search, scores, traits = self.scene.config.event_search, [], []
        for plans in found:
            scores.append(np.array([plan.score for plan in plans]) + search.off_chance * rng.random(len(plans)))
            traits.append(np.array([plan.traits for plan in plans]))
        for _ in range(search.plans):
            if not any(score.size and np.isfinite(score.min()) for score in scores):
                return
            for plans, score, trait in zip(found, scores, traits, strict=True):
                if score.size and np.isfinite(score.min()):
                    row = int(np.argmin(score))
                    yield plans[row]
                    score += search.off_alike * np.mean(trait == trait[row], axis=1)
                    score[row] = np.inf

    def _start(self, planner: Planner, plan: Plan, number: int, tries: int, rng: np.random.Generator) -> Start:
        """A driver who holds to a plan, or the free one of a plan, at its site."""
        scene = self.scene
        request = VehicleRequest(FIRST_NUMBER + number, _POLICY.get(plan.event.kind, Policy.STRAIGHT), plan.trigger_s)
        path = scene.path(plan.route)
        driver = planner.driver_of(plan, rng)
        if plan.driver is None:  # the wish at a step is for the next one
            desired = np.maximum(np.append(plan.speeds[1:], plan.speeds[-1:]), _CREEPS_MPS)
        else:
            desired = desired_speeds(
                driver, scene.config, rng, num_steps=scene.num_steps, step_s=scene.step_s,
                at_least_mps=float(plan.speeds[0]),
            )  # fmt: skip
        return Start(
            vehicle_id=f"e{number}_{tries}", request=request, object_type="vehicle", size=planner.size,
            box=planner.box, route=plan.route, path=path, start_s=plan.start_s, start_mps=float(plan.speeds[0]),
            driver=driver, desired=desired,
            offset=lane_offset(driver, scene.config, rng, length_m=path.line.length_m),
            sides=("left", "right") if plan.side is None else (plan.side,), is_held=plan.driver is None,
        )  # fmt: skip

    def _drive(
        self, scene: Scene, lines: StopLines, plan: Plan, start: Start, fixed: Traffic, drive: DriveAlone
    ) -> tuple[EventOutcome | None, Plan | None]:
        """Drive a plan: the event where it came about as asked, else a better plan, None where none is known."""
        event, target = plan.event, plan.target
        driven = drive(scene, lines, start, fixed)
        vehicle = finalise(scene, driven, self.kept)
        if not isinstance(vehicle, ExportedVehicle):
            self._tell(plan, start, vehicle, driven.reason)
            return None, None
        seen = self._seen(scene, plan, vehicle)
        if seen is None:
            self._tell(plan, start, Reason.EVENT_NOT_AS_ASKED, driven.reason or "not seen")
            return None, None
        if not _is_as_asked(scene, event, seen):
            missing = seen.measures
            low, high = event.gap_band_m
            edge = scene.config.event_search.edge_share * (high - low)
            gap = min(max(missing.gap_m, low + edge), high - edge) - missing.gap_m
            late_s = (plan.at_step - seen.at_step) * scene.step_s
            self._tell(plan, start, Reason.EVENT_NOT_AS_ASKED, f"at {seen.at_step * scene.step_s:.1f} s {missing}")
            later_s = late_s if event.kind == "cut_in" else 0.0
            if event.kind == "overtake" or (abs(gap) < _SAME_M and abs(later_s) < scene.step_s):
                return None, None  # it would be driven once more as it was
            return None, plan.moved(forward_m=plan.order * gap, later_s=later_s)
        if any(row >= len(self.kept) for row, _ in conflicting(scene, [*self.kept, vehicle])):
            self._tell(plan, start, Reason.TTC_LANE_LEADER, None)
            return None, None
        found = EventOutcome(
            event, None, target.track.track_id, vehicle, outcome_of(scene, vehicle, self.kept),
            seen.at_step * scene.step_s, seen.measures, plan.order,
        )  # fmt: skip
        return found, None

    def _tell(self, plan: Plan, start: Start, reason: Reason, detail: str | None) -> None:
        self.tried[reason] += 1
        _LOG.debug(
            "event %s: %s at %.1f m of lane %d, %.1f m/s, for %.1f s: %s%s", plan.event.kind, start.vehicle_id,
            start.start_s, start.path.segment_at(start.start_s).lane_id, start.start_mps,
            plan.at_step * self.scene.step_s, reason, "" if detail is None else f" ({detail})",
        )  # fmt: skip

    def _seen(self, scene: Scene, plan: Plan, vehicle: ExportedVehicle) -> _Seen | None:
        """The event as the judge sees it in the states of the vehicle and its target; None where it does not."""
        kind, target, name = plan.event.kind, plan.target, vehicle.driven.vehicle_id
        pair = agent_states(
            [target.track, vehicle.track(name, 1)], scene.states.lanes, num_steps=scene.num_steps, step_s=scene.step_s,
            is_inserted=name.__eq__,
        )  # fmt: skip
        claim = EventClaim(kind, name, target.track.track_id, plan.at_step * scene.step_s, ahead=plan.order > 0)
        at = event_step(pair, claim)
        if at is None or at not in target.track.timesteps or not vehicle.span.start <= at < vehicle.span.stop:
            return None
        since = at
        if kind == "cut_in":
            since = max(0, at - round(0.5 * scene.config.event_search.change_s / scene.step_s))
        elif kind == "cross":
            since = 0
        found = measure_event(pair, 1, 0, at_step=at, since_step=since)
        if kind == "cross" and (steps := crossing_steps(pair, 1, 0)) is not None:
            # from the target's bumper to the conflict point
            way = abs(float(target.way[steps[1]] - target.way[steps[0]]))
            found = replace(found, gap_m=way - 0.5 * target.track.size.length_m)
        return _Seen(at, found)


def _is_as_asked(scene: Scene, event: Event, seen: _Seen) -> bool:
    """Whether an event has the time, gap, speed difference and criticality asked for."""
    found, spare = seen.measures, scene.config.event_search.moment_s
    within = [
        (seen.at_step * scene.step_s, (event.at_band_s[0] - spare, event.at_band_s[1] + spare)),
        (found.gap_m, event.gap_band_m),
        (found.speed_difference_mps, event.difference_band_mps),
    ]
    if event.ttc_s is not None:
        within.append((np.inf if found.min_ttc_s is None else found.min_ttc_s, event.ttc_s))
    if event.pet_s is not None:
        within.append((np.inf if found.pet_s is None else found.pet_s, event.pet_s))
    if event.drac_mps2 is not None:
        within.append((found.drac_mps2, event.drac_mps2))
    brakes = found.brakes_mps2 >= scene.config.event_search.brakes_share * event.brakes_mps2
    return brakes and all(low <= value <= high for value, (low, high) in within)
