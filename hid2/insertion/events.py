"""Events with a recorded target: candidates rolled out until one brings the event about, then driven freely.

An ordered event is an objective over rollouts. Candidates are drawn over the map (`event_places.py`): a place on a
route, a driver as any other is drawn, and a trigger where it changes lanes. Each is rolled out as any other start is
(`event_starts.py`); the judge is asked whether its motion shows the event, and the cost is how far that is from the
middle of what is asked (`event_objective.py`). The best are driven by SUMO and Algorithm 1 and held to nothing; the
first that the judge finds to be as asked in its exported positions is kept.
"""

import logging
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hid2.agents import Policy
from hid2.conflicts.guard import Guard
from hid2.conflicts.stop_lines import StopLines
from hid2.insertion.event_objective import MOMENT_S, Objective, Seen
from hid2.insertion.event_places import Places
from hid2.insertion.event_starts import Candidate, EventStarts
from hid2.insertion.event_targets import candidate_rows, target_of
from hid2.insertion.finalise import ExportedVehicle, as_written, conflicting, finalise, traffic_of_exported
from hid2.insertion.outcome import Outcome, outcome_of
from hid2.insertion.requests import draw_size
from hid2.insertion.surroundings import Surroundings
from hid2.judge.claims import EventClaim, event_step
from hid2.judge.findings import allowed_to
from hid2.occupancy.traffic import Traffic
from hid2.params import Event
from hid2.reasons import Reason
from hid2.scene import Scene
from hid2.vehicle import DrivenVehicle, Start, VehicleRequest

#: Time gap to the leader (`lane_change.time_gap_front_s`) in a cut-in, s. No tunable: the gap asked for is behind.
_CUT_IN_GAP_S = 0.3
#: Drives one vehicle alone among the recorded and the kept ones: scene, stop lines, start, kept ones.
DriveAlone = Callable[[Scene, StopLines, Start, Traffic], DrivenVehicle]
#: First number of the vehicles of events, behind the numbers of all others: bookkeeping.
FIRST_NUMBER = 10_000
_POLICY = {"cut_in": Policy.LANE_CHANGE, "overtake": Policy.OVERTAKE}
_MEETS_CROSSING = frozenset({"cross", "merge"})
#: Candidates of one target that are rolled out before another target is looked at. Not a parameter, it saves time.
_AT_A_TIME = 30
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False, slots=True)
class EventOutcome:
    """What became of an event that was asked for; vehicle, outcome and what is seen of it where it came about.

    tries: vehicles that were driven for it; tried: what each try or, where none was driven, each candidate failed by.
    """

    event: Event
    reason: Reason | None = None
    target_id: str | None = None
    vehicle: ExportedVehicle | None = None
    outcome: Outcome | None = None
    seen: Seen | None = None
    tries: int = 0
    tried: Mapping[Reason, int] = field(default_factory=dict)


def scene_for(scene: Scene, event: Event) -> Scene:
    """The scene with the rules that an event is made by: the gap asked for counts, not the one that drivers like.

    Critical values are lowered only where a criticality below them is asked for: here towards all agents, while the
    vehicle is judged by those that hold for the target alone (`SceneEvents._judged`). Recorded traffic that crosses
    makes an entrance red (`conflicts/signals.py`); where meeting it is what is asked for, only while it crosses.
    """
    config, conflict = scene.config, scene.config.conflict
    # the TTC of the vehicle where it follows, of the target where that does, of either where one of them merges
    names = {"follow": ("ttc_min_s",), "merge": ("ttc_min_s", "follower_ttc_min_s")}
    asked = dict.fromkeys(names.get(event.kind, ("follower_ttc_min_s",)), event.ttc_s) | {"pet_min_s": event.pet_s}
    critical = {name: min(getattr(conflict, name), band[0]) for name, band in asked.items() if band is not None}
    update: dict[str, object] = {"conflict": conflict.model_copy(update=critical)}
    if event.kind in _MEETS_CROSSING:
        update["signals"] = config.signals.model_copy(update={"before_s": 0.0, "after_s": 0.0})
    if event.kind == "cut_in":  # behind the vehicle the event's band counts alone
        waits_s = min(config.lane_change.give_up_s, float(np.ptp(event.at_band_s)) + 2 * MOMENT_S)
        change = {
            "time_gap_front_s": _CUT_IN_GAP_S,
            "time_gap_rear_s": 0.0,
            "min_gap_m": 1.0,
            "braking_mps2": 9.0,
            "heading_deg": 20.0,
            "give_up_s": waits_s,
        }
        update["lane_change"] = config.lane_change.model_copy(update=change)
    return replace(scene, config=config.model_copy(update=update))


@dataclass(slots=True)
class SceneEvents:
    """Searches the events of one scene, one after the other. found: what became of those so far."""

    here: Surroundings
    seed: Sequence[int]
    found: list[EventOutcome] = field(default_factory=list)

    @property
    def kept(self) -> list[ExportedVehicle]:
        """Vehicles of the events that came about."""
        return [one.vehicle for one in self.found if one.vehicle is not None]

    def run(self, drive: DriveAlone) -> list[EventOutcome]:
        """All events of the configuration, in order."""
        for event in self.here.scene.config.event:
            for _ in range(event.count):
                self.found.append(self.search(event, len(self.found), drive))
        return self.found

    def search(self, event: Event, number: int, drive: DriveAlone) -> EventOutcome:
        """One event; its reason where none of the tries brought it about."""
        tried, rejected, kept = Counter[Reason](), Counter[Reason](), traffic_of_exported(self.kept, self.here.scene)
        objectives = self.objectives(event, np.random.default_rng([*self.seed, 0x7A26E7, number]))
        if not objectives:
            return EventOutcome(event, Reason.EVENT_NO_TARGET)
        for starts, candidate in self.likely(objectives, number, rejected):
            if tried.total() >= starts.scene.config.event_search.tries:
                break
            start = replace(candidate.rolled.start, vehicle_id=f"e{number}_{tried.total()}")
            judged = self._judged(starts.objective, drive(starts.scene, starts.world.guard.stop_lines, start, kept))
            if not isinstance(judged, Reason):
                vehicle, seen = judged
                return EventOutcome(
                    event, None, starts.objective.target.track.track_id, vehicle,
                    outcome_of(starts.scene, vehicle, self.kept), seen, tried.total() + 1,
                )  # fmt: skip
            tried[judged] += 1
            _LOG.debug("event %s: %s fails: %s", event.kind, start.vehicle_id, judged)
        told = dict((tried or rejected).most_common())
        said = ", ".join(f"{reason} {count}" for reason, count in told.items())
        _LOG.debug("event %s: %d tries; %s", event.kind, tried.total(), said or "no place")
        reason = Reason.EVENT_NOT_AS_ASKED if tried else Reason.EVENT_NOT_FORESEEN if told else Reason.EVENT_NO_PLACE
        return EventOutcome(event, reason, tries=tried.total(), tried=told)

    def objectives(self, event: Event, rng: np.random.Generator) -> list[Objective]:
        """Of the targets that may be taken, in the order in which they are tried."""
        scene = scene_for(self.here.scene, event)
        rows = candidate_rows(scene, event.target)
        if event.target == "any":
            rows = [rows[k] for k in rng.permutation(len(rows)).tolist()]
        known = as_written(scene, self.kept)
        return [Objective(scene, event, target, known) for row in rows if (target := target_of(scene, row)) is not None]

    def likely(
        self, objectives: Sequence[Objective], number: int, rejected: Counter[Reason]
    ) -> Iterator[tuple[EventStarts, Candidate]]:
        """Candidates that the judge finds to be as asked, the best of a few first; targets in turns."""
        scene, event = objectives[0].scene, objectives[0].event
        rng = np.random.default_rng([*self.seed, 0xE7E27, number])
        lines = StopLines(scene) if event.kind in _MEETS_CROSSING else self.here.stop_lines
        guard, left = Guard(scene, traffic_of_exported(self.kept, scene), lines), scene.config.event_search.candidates
        _, size = draw_size(scene.config.request.model_copy(update={"bus_share": 0.0}), rng)
        policy = _POLICY.get(event.kind, Policy.STRAIGHT)
        request = VehicleRequest(FIRST_NUMBER + number, policy, 0.0, size=size)
        changers = [one for one in self.kept if one.driven.shifts]
        waiting: list[Objective | EventStarts] = list(objectives)
        while left > 0 and waiting:
            starts = waiting.pop(0)
            if isinstance(starts, Objective):
                lengths_m = 0.5 * (size.length_m + starts.target.track.size.length_m)
                starts = EventStarts(
                    scene, self.here.roads, self.here.meetings, guard, rng, 0, refusals=rejected, changers=changers,
                    objective=starts, request=request,
                    places=list(Places(self.here.routes, event, starts.target, lengths_m).all()),
                )  # fmt: skip
            before = starts.rolls
            for candidate in starts.draw(_AT_A_TIME):
                judged = self._judged(starts.objective, candidate.as_driven())
                if isinstance(judged, Reason):
                    rejected[judged] += 1
                else:
                    yield starts, candidate
            left -= _AT_A_TIME if starts.rolls > before else 0
            if starts.rolls > before:  # else it has no places
                waiting.append(starts)

    def _judged(self, objective: Objective, driven: DrivenVehicle) -> tuple[ExportedVehicle, Seen] | Reason:
        """A vehicle that is exported and brings the event about as asked, beside those kept; or why it is not."""
        kept = self.kept
        vehicle = finalise(objective.scene, driven, kept)
        if isinstance(vehicle, Reason):
            return vehicle
        seen = objective.seen(vehicle.track(driven.vehicle_id, 1))
        if seen is None or (missed := objective.missed_by(seen)) is Reason.EVENT_NOT_THERE:
            return driven.reason or Reason.EVENT_NOT_THERE
        if missed is not None:
            return missed
        allowed = allowed_to(objective.target.track.track_id, objective.event.model_dump())
        conflicts = conflicting(self.here.scene, [*kept, vehicle], allowed=allowed)
        own = next((reason for row, reason in conflicts if row >= len(kept)), None)
        if own is None and any(comes_between(objective.scene, event, vehicle) for event in self.found):
            own = Reason.BREAKS_EVENT
        return own or (vehicle, seen)


def comes_between(scene: Scene, event: EventOutcome, vehicle: ExportedVehicle) -> bool:
    """Whether a vehicle comes between the two of a lead or follow event at its moment."""
    if event.vehicle is None or event.seen is None or event.event.kind not in ("lead", "follow"):
        return False
    names, at_s = (event.vehicle.driven.vehicle_id, str(event.target_id)), event.seen.at_step * scene.step_s
    claim = EventClaim(event.event.kind, *names, at_s, ahead=event.seen.order > 0)
    return event_step(as_written(scene, [event.vehicle, vehicle]), claim) is None


def offered_events(here: Surroundings, names: Sequence[str]) -> tuple[str, ...]:
    """Which of some events, as `kind:target`, a candidate brings about by its rollout: nothing is driven.

    From second 1 on to 4 s before the end, an overtake to the end.
    """
    found, search = [], SceneEvents(here, (0,))
    for name in names:
        kind, _, target = name.partition(":")
        until_s = here.scene.last_s - (0.0 if kind == "overtake" else 4.0)
        event = Event.model_validate({"kind": kind, "target": target, "at_s": (1.0, max(1.0, until_s))})
        objectives = search.objectives(event, np.random.default_rng(0))
        if objectives and next(search.likely(objectives, 0, Counter()), None) is not None:
            found.append(name)
    return tuple(found)
