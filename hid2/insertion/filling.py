"""Rounds of inserting vehicles until the count is reached: site, driver, drive, smooth, verify, keep or try another."""

import logging
import math
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, field, replace

import numpy as np

from hid2.agents import Policy
from hid2.conflicts.guard import Guard
from hid2.insertion.events import EventOutcome, comes_between
from hid2.insertion.finalise import ExportedVehicle, conflicting, finalise, traffic_of_exported
from hid2.insertion.outcome import Outcome, outcome_of, takes_gap
from hid2.insertion.requests import draw_requests
from hid2.insertion.sites import InsertionSites, TurnedDown
from hid2.insertion.situations import Wanted
from hid2.insertion.surroundings import Surroundings
from hid2.measures.encounters import BRAKES_FOR_S
from hid2.occupancy.traffic import Traffic
from hid2.policy.behaviours import BEHAVIOURS
from hid2.reasons import Reason
from hid2.scene import Scene
from hid2.vehicle import DrivenVehicle, Start, VehicleRequest
from netconvert.cells import Cell

# No tunables from here to _MOST_FAILURES_STRAIGHT: they bound the search.
_MOST = 400  # vehicles that `agents = max` asks for, at most
_MOST_FAILURES = 4  # requests of a policy without a site, after which a round looks for no more such sites
#: The same of requests to go straight, where `agents` is a number. With `max` too, the first that fails is looked for
#: once more, with all cells open again.
_MOST_FAILURES_STRAIGHT = 1
#: Length of lane per vehicle on a full road, m. No tunable: what `agents = max` means.
SPACING_M = 25.0
#: Runs one simulation: starts, generated vehicles kept in rounds before, number of the round.
Drive = Callable[[Sequence[Start], Traffic, int], list[DrivenVehicle]]
#: Rounds in a row without a new vehicle, after which the search ends. No tunable: one round may have bad luck; a third
#: adds .4 % of the vehicles for a tenth of the search.
_MOST_IDLE = 2
#: Random stream by which `Wanted` rounds its numbers, apart from the rounds' streams. No tunable: a name.
_ROUNDING = (0, 79)
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Unmet:
    """A manoeuvre that was asked for and that no vehicle performs, with the last reason."""

    request: VehicleRequest
    reason: Reason


@dataclass(frozen=True, slots=True)
class Rejection:
    """A vehicle that was driven and not exported: why, in which round, in which cell it started."""

    vehicle: DrivenVehicle
    reason: Reason
    round_number: int
    cell: Cell
    detail: str | None = None


@dataclass(slots=True)
class Filling:
    """One scene being filled.

    kept: exported vehicles; outcomes: of those that were to do a manoeuvre, by id.
    """

    surroundings: Surroundings
    seed: Sequence[int]
    scene: Scene = field(init=False)
    kept: list[ExportedVehicle] = field(default_factory=list)
    outcomes: dict[str, Outcome] = field(default_factory=dict)
    unmet: list[Unmet] = field(default_factory=list)
    rejected: list[Rejection] = field(default_factory=list)
    no_site: Counter[Reason] = field(default_factory=Counter)
    events: list[EventOutcome] = field(default_factory=list)
    rounds: int = 0
    _open: list[VehicleRequest] = field(default_factory=list)
    _last_reason: dict[int, Reason] = field(default_factory=dict)
    _turned_down: TurnedDown = field(default_factory=TurnedDown)
    _wanted: Wanted = field(init=False)
    _kept_traffic: Traffic = field(init=False)
    """Those kept; each round joins its own to it, so that intervals worked out before still hold."""

    def __post_init__(self) -> None:
        """Recorded vehicles are where they were; those that react may be elsewhere later."""
        self.scene = self.surroundings.scene
        self._kept_traffic = traffic_of_exported([], self.scene)
        self._wanted = Wanted.of(self.surroundings.shares, np.random.default_rng([*self.seed, *_ROUNDING]))

    def take_events(self, found: Sequence[EventOutcome]) -> None:
        """Keep the vehicles of events first: all others are driven among them. They count among those asked for."""
        self.events = list(found)
        for one in found:
            if one.vehicle is not None:
                self.kept.append(one.vehicle)
                if one.outcome is not None:
                    self.outcomes[one.vehicle.driven.vehicle_id] = one.outcome
        self._kept_traffic = traffic_of_exported(self.kept, self.scene)

    def fill(self, drive: Drive) -> None:
        """All rounds. The count is a wish: a full road ends with fewer, and says so."""
        config, target = self.scene.config, self._target()
        self._open = self._requests(max(0, target - len(self.kept)))
        idle = 0
        for number in range(config.spawn.rounds):
            starts, before = self._starts(number), len(self.kept)
            if starts or number == 0:  # without a start it measures the replay alone
                self.rounds = number + 1
                self._keep(drive(starts, self._kept_traffic, number))
            if not self._open:
                break
            added = len(self.kept) - before
            idle = 0 if added else idle + 1
            is_over = self._manoeuvres_are_over(number)
            if (is_over or idle == _MOST_IDLE) and self._give_up_manoeuvres():
                idle = 0  # a vehicle that goes straight may find a place
            if idle == _MOST_IDLE:
                break
        self._give_up_manoeuvres()

    def _manoeuvres_are_over(self, number: int) -> bool:
        """Whether manoeuvres that did not come about by a round are given up, and what is driven is kept as it is."""
        return number >= self.scene.config.spawn.reseed_rounds

    def fill_together(self, drive: Drive) -> None:
        """Where recorded vehicles react: drive all starts together, again without those that fail, until none fails.

        So no recorded vehicle has reacted to one that is not exported. None is replaced. Each `drive` sets `scene` to
        what it has become, by which the vehicles are judged.
        """
        starts = sorted(self._starts_of(self._target()), key=lambda start: start.request.number)
        while True:
            vehicles = drive(starts, self._kept_traffic, self.rounds)
            self.rounds += 1
            self.kept, rejections = self._checked_round(vehicles)
            if not rejections:
                break
            self.kept = []
            for one in rejections.values():
                self._note(one)
                self._last_reason[one.vehicle.start.request.number] = one.reason
            starts = [start for start in starts if start.vehicle_id not in rejections]
        self._give_up_manoeuvres({one.driven.start.request.number for one in self.kept})

    def _starts_of(self, count: int) -> list[Start]:
        self._open = self._requests(count)
        return self._starts(0)

    def first_starts(self, count: int) -> list[Start]:
        """Starts of one round for `count` requests; those that find none are in `unmet`."""
        starts = self._starts_of(count)
        met = {start.request.number for start in starts}
        self.unmet += [Unmet(request, Reason.NO_SITE) for request in self._open if request.number not in met]
        return starts

    def _target(self) -> int:
        """How many are asked for; `max`: how many the road takes at usual gaps, about."""
        asked = self.scene.config.request.agents
        if asked != "max":
            return asked
        lanes = self.scene.grid.graph.lanes
        length_m = sum(lanes[lane_id].length_m for lane_id in self.surroundings.routes.lanes)
        return min(_MOST, math.ceil(length_m / SPACING_M))

    def _requests(self, count: int) -> list[VehicleRequest]:
        """What is asked for; what map or scene's length do not allow is noted, and a vehicle goes straight."""
        last_s = self.scene.last_s
        found = []
        rng = np.random.default_rng([*self.seed, 0])
        for request in draw_requests(self.scene.config, rng, count=count, duration_s=last_s):
            reason: Reason | None = None
            if not self.surroundings.routes.map_offers(request.policy):
                reason = BEHAVIOURS[request.policy].no_map
            elif BEHAVIOURS[request.policy].changes_lanes and request.trigger_s > last_s:
                reason = Reason.TRIGGER_AFTER_SCENE
            if reason is not None and request.policy is not Policy.STRAIGHT:
                self.unmet.append(Unmet(request, reason))
                request = replace(request, policy=Policy.STRAIGHT)
            found.append(request)
        return found

    def _starts(self, number: int) -> list[Start]:
        """Starts of a round for open requests, each of which keeps clear of those before it.

        A manoeuvre that finds no site is given up: its request goes straight, after all others.
        """
        rng = np.random.default_rng([*self.seed, 1 + number])
        here = self.surroundings
        guard = Guard(self.scene, self._kept_traffic, here.stop_lines)
        sites = InsertionSites(here, guard, rng, number, self._wanted, self._turned_down, self.kept)
        starts, used = list[Start](), set[int]()
        waiting = deque(sorted(self._open, key=lambda one: (BEHAVIOURS[one.policy].site_order, one.number)))
        failed, refused = Counter[Policy](), defaultdict[Policy, Counter[Reason]](Counter)
        redrawn = False
        most_straight = _MOST_FAILURES if self.scene.config.request.agents == "max" else _MOST_FAILURES_STRAIGHT
        while waiting:
            request = waiting.popleft()
            if request.number in used:
                continue
            policy, before = request.policy, sites.starts.refusals.copy()
            straight = policy is Policy.STRAIGHT
            found: list[Start] = []
            if failed[policy] < (most_straight if straight else _MOST_FAILURES):
                found = self._proposed(sites, request, [one for one in waiting if one.number not in used])
                if straight and not found and not redrawn:
                    redrawn = True  # what was full for one draw of places may not be for another
                    self._turned_down.look_anew()
                    found = sites.propose(request)
                if not found:
                    failed[policy] += 1
                refused[policy] += sites.starts.refusals - before
            if not found and not straight:  # it goes straight, after all others
                # what became of a vehicle that was driven for the manoeuvre says more
                self._last_reason.setdefault(request.number, _found_none(policy, sites, refused[policy]))
                waiting.append(self._gives_up(request))
            used.update(start.request.number for start in found)
            starts += found
        self.no_site.update(sites.starts.refusals)
        turned_down = ", ".join(f"{reason} {count}" for reason, count in sites.starts.refusals.most_common())
        _LOG.debug("round %d: %d starts; sites turned down: %s", number, len(starts), turned_down or "none")
        return starts

    def _proposed(self, sites: InsertionSites, request: VehicleRequest, others: list[VehicleRequest]) -> list[Start]:
        """A start for a request, after that of its slow leader where one is added for an overtake; empty: no site.

        Such a leader meets another request: one to go straight, else the last overtake, which is given up.
        """
        if request.policy is not Policy.OVERTAKE or not self.scene.config.request.spawn_leaders:
            return sites.propose(request)
        straight = [one for one in others if one.policy is Policy.STRAIGHT]
        overtakes = [one for one in others if one.policy is Policy.OVERTAKE]
        slow = next(iter(straight + overtakes[::-1]), None)
        found = sites.propose(request, None if slow is None else replace(slow, policy=Policy.STRAIGHT))
        if slow is not None and slow.policy is Policy.OVERTAKE and len(found) > 1:
            self._last_reason[slow.number] = Reason.LEADS_AN_OVERTAKE
            self._gives_up(slow)
        return found

    def _gives_up(self, request: VehicleRequest) -> VehicleRequest:
        """A request to go straight in place of one for a manoeuvre, which is given up with its reason."""
        self.unmet.append(Unmet(request, self._last_reason.get(request.number, Reason.NO_SITE)))
        straight = replace(request, policy=Policy.STRAIGHT)
        self._open = [straight if one is request else one for one in self._open]
        return straight

    def _give_up_manoeuvres(self, met: Set[int] = frozenset()) -> bool:
        """Requests that no round met become vehicles that go straight; whether there was any. met: numbers."""
        left = [r for r in self._open if r.policy is not Policy.STRAIGHT and r.number not in met]
        for request in left:
            self._gives_up(request)
        return bool(left)

    def _keep(self, vehicles: list[DrivenVehicle]) -> None:
        """Keep what passes the final check; the others are rejected with a reason, and their requests stay open."""
        new, rejections = self._checked_round(vehicles)
        for one in rejections.values():
            self._last_reason[one.vehicle.start.request.number] = one.reason
        self._reject_what_waited(new, rejections)
        if not self._manoeuvres_are_over(self.rounds - 1):
            new = self._reused_as_straight(new, rejections)
            self._reject_what_waited(new, rejections)
        for one in rejections.values():
            self._note(one)
        kept_now = [vehicle for vehicle in new if vehicle.driven.vehicle_id not in rejections]
        for vehicle in kept_now:
            outcome = self.outcomes.get(vehicle.driven.vehicle_id)
            became = None if outcome is None else " ".join(filter(None, (outcome.status, outcome.reason)))
            self._tell(vehicle.driven, self._site(vehicle.driven), "kept", became)
        self.kept += kept_now
        self._kept_traffic = self._kept_traffic.joined(traffic_of_exported(kept_now, self.scene))
        met = {one.driven.start.request.number for one in kept_now}
        self._open = [request for request in self._open if request.number not in met]

    def _checked_round(self, vehicles: list[DrivenVehicle]) -> tuple[list[ExportedVehicle], dict[str, Rejection]]:
        """Those driven that pass the final check beside those kept, with outcomes; rejections of the others, by id."""
        new: list[ExportedVehicle] = []
        rejections: dict[str, Rejection] = {}
        for vehicle in vehicles:
            found = finalise(self.scene, vehicle, [*self.kept, *new])
            if isinstance(found, ExportedVehicle):
                new.append(found)
            else:
                rejections[vehicle.vehicle_id] = self._rejection(vehicle, found)
        for row, reason in conflicting(self.scene, [*self.kept, *new], first_row=len(self.kept)):
            driven = new[row - len(self.kept)].driven
            rejections[driven.vehicle_id] = self._rejection(driven, reason)
        for one in new:  # replaces a reason found above
            if any(comes_between(self.scene, event, one) for event in self.events):
                rejections[one.driven.vehicle_id] = self._rejection(one.driven, Reason.BREAKS_EVENT)
        changers = [] if "collision" in self.scene.config.without else [one for one in self.kept if one.driven.shifts]
        for one in new if changers else ():
            alone = traffic_of_exported([one], self.scene)
            if any(takes_gap(self.scene, before, alone) for before in changers):
                rejections.setdefault(one.driven.vehicle_id, self._rejection(one.driven, Reason.TAKES_GAP))
        new = [one for one in new if one.driven.vehicle_id not in rejections]
        for one in new:
            outcome = outcome_of(self.scene, one, [*self.kept, *new])
            if outcome is not None:
                self.outcomes[one.driven.vehicle_id] = outcome
        return new, rejections

    def _reused_as_straight(
        self, new: list[ExportedVehicle], rejections: dict[str, Rejection]
    ) -> list[ExportedVehicle]:
        """Vehicles that did not do their manoeuvre take over open requests to go straight; the others are rejected.

        One that has begun to drive across cannot. The manoeuvre stays open. Vehicles that others need come first.
        """
        left = [one for one in new if one.driven.vehicle_id not in rejections]
        needed = set().union(*(_needs(one.driven, self.scene) for one in left))
        met = {one.driven.start.request.number for one in left}
        straight = [r for r in self._open if r.policy is Policy.STRAIGHT and r.number not in met]
        found = {one.driven.vehicle_id: one for one in new}
        for one in sorted(left, key=lambda one: one.driven.vehicle_id not in needed):
            driven, outcome = one.driven, self.outcomes.get(one.driven.vehicle_id)
            if outcome is None or outcome.done:
                continue
            del self.outcomes[driven.vehicle_id]
            said = self._last_reason[driven.start.request.number] = outcome.reason or Reason.SCENE_ENDED
            if straight and not driven.path.lateral_spans:
                own = driven.start.request  # the vehicle is as large as it was driven
                other = replace(straight.pop(), object_type=own.object_type, size=own.size)
                start = replace(driven.start, request=other)
                found[driven.vehicle_id] = replace(one, driven=replace(driven, start=start))
            else:
                rejections[driven.vehicle_id] = self._rejection(driven, Reason.DID_NOT_DO_IT, said)
        return list(found.values())

    def _reject_what_waited(self, new: list[ExportedVehicle], rejections: dict[str, Rejection]) -> None:
        """Reject each vehicle that braked for a rejected one, or overtook it, until none is left."""
        changed = True
        while changed:
            changed = False
            for one in new:
                driven = one.driven
                if driven.vehicle_id in rejections or not _needs(driven, self.scene) & rejections.keys():
                    continue
                rejections[driven.vehicle_id] = self._rejection(driven, Reason.WAITED_FOR_GONE)
                changed = True

    def _site(self, vehicle: DrivenVehicle) -> Cell:
        """Cell that a vehicle started in."""
        return self.scene.cell_at(vehicle.start.path, vehicle.start.start_m)

    def _rejection(self, vehicle: DrivenVehicle, reason: Reason, detail: str | None = None) -> Rejection:
        return Rejection(vehicle, reason, self.rounds - 1, self._site(vehicle), detail)

    def _note(self, one: Rejection) -> None:
        self._tell(one.vehicle, one.cell, one.reason, one.detail)
        self.rejected.append(one)
        place_failed = one.reason not in (Reason.DID_NOT_DO_IT, Reason.WAITED_FOR_GONE)
        if place_failed and one.vehicle.start.step == 0 and self.scene.config.request.sites == "promising":
            self._turned_down.not_kept(self.scene, self.scene.grid.index_of[one.cell])

    def _tell(self, vehicle: DrivenVehicle, cell: Cell, verdict: str, detail: str | None) -> None:
        """What became of a vehicle that was driven, as a line of the debug log."""
        more = "" if detail is None else f" ({detail})"
        _LOG.debug(
            "round %d: vehicle %s, %s, lane %d cell %d, last step %d: %s%s", self.rounds - 1, vehicle.vehicle_id,
            vehicle.policy, cell.lane_id, cell.index, vehicle.last_step, verdict, more,
        )  # fmt: skip


def _found_none(policy: Policy, sites: InsertionSites, refused: Counter[Reason]) -> Reason:
    """Why no site was found: what most of those looked at were turned down for, rather than for being taken."""
    if policy is Policy.OVERTAKE and sites.overtakes.found_none is not None:
        return sites.overtakes.found_none
    return min(refused, key=lambda one: (one is Reason.NO_SITE, -refused[one]), default=Reason.NO_CELL_IN_REACH)


def _needs(vehicle: DrivenVehicle, scene: Scene) -> set[str]:
    """Vehicles without which a vehicle would have driven otherwise: those for which it braked long, and overtook."""
    least_steps = scene.steps_in(BRAKES_FOR_S)
    waited_for = {name for name, steps in vehicle.waited_for.items() if steps >= least_steps}
    return waited_for | ({vehicle.overtaken_id} if vehicle.overtaken_id is not None else set())
