"""Start sites: where on the map a request may be met, in which order they are looked at."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import dataclass, field
from functools import partial
from itertools import chain

import numpy as np

from hid2.agents import DEFAULT_SIZES, Policy
from hid2.conflicts.guard import Guard
from hid2.drivers.driver import usual_driver
from hid2.insertion.entry_sites import TRIES, EntrySites
from hid2.insertion.finalise import ExportedVehicle
from hid2.insertion.meetings import PACE_SHARE, by_weight
from hid2.insertion.overtake_starts import OvertakeStarts
from hid2.insertion.routes import RouteOffer
from hid2.insertion.situations import NONE_WANTED, Situation, Wanted
from hid2.insertion.starts import CLEAR_GAP_M, Site, Starts
from hid2.insertion.surroundings import Surroundings
from hid2.judge.findings import FOLLOWER_HEADWAY_S
from hid2.occupancy.sigma import clear_places
from hid2.policy.behaviours import BEHAVIOURS
from hid2.policy.rules import refusal_of_lane
from hid2.reasons import Reason
from hid2.scene import Scene
from hid2.vehicle import Start, VehicleRequest
from netconvert.cells import Cell

#: Distance up to which none is tried near a vehicle that could not begin or be kept, m. Not a parameter, it saves time.
_AVOIDED_M = 8.0
#: Time headway left to recorded followers at sites tried first, s: most keep it among themselves (36 of 39 in fourteen
#: scenes). No tunable: `request.sites = any` draws without it.
USUAL_HEADWAY_S = 1.3
#: Sites looked at in full for a start that meets a wanted situation. Not a parameter, it saves time: the rest are
#: seldom better.
_WANTED_TRIES = 8
#: Vehicles of a policy without a site for a situation, after which a round looks for that situation no more.
_IN_VAIN = 2
#: Times that the cells for a manoeuvre are gone through, each with other places and drivers. Not a parameter, it saves
#: time: with a third one more manoeuvres are done, and on full roads fewer vehicles placed.
_PASSES = 2
#: Situations without the speed for a lane change: behind what brakes or stands.
_SLOWS = frozenset({Situation.BRAKES, Situation.STANDS})
#: Share of the usual speed at which a vehicle must not leave the map too early. Not a parameter, it saves time.
_STAYS_SHARE = 0.8
# No tunables from here to _BESIDE_M: manoeuvres are foreseen roughly; a rollout, SUMO and the judge follow.
#: Least distance from a start to its turn at a strict site, m (strict: `InsertionSites._start_for`).
_BEFORE_TURN_M = 5.0
_APPROACH_SHARE = 0.75  # speed on the way to a turn over the usual speed
_TURN_MPS = 5.0  # speed in a turn, m/s
_TURN_SPARE_S = 2.0  # least time left in the scene after a turn at a strict site, s
_CHANGE_SPARE_S = 0.3  # spare length of the lane beside, s at the usual speed: drivers are not all as fast as usual
_STRICT_SPARE_S = 0.5  # spare length of the lane beside at a strict site, s at the usual speed
#: Share of its way at the usual speed by which a vehicle may come farther by its trigger, at a strict site.
_FARTHER_SHARE = 0.3
_CHANGE_RATIO = 1.3  # duration of a lane change over the shortest one, at a strict site
_BESIDE_M = 1.0  # tolerance of where a lane beside begins and ends, m: places come from cells and a usual speed


@dataclass(slots=True)
class TurnedDown:
    """What is known to fail, as rows of cells: from which none could go straight, and near to which none was kept.

    Whether a manoeuvre comes about is a matter of metres and of the driver: cells are looked at for it again.
    each_cell: one that could not go straight speaks for its cell alone, as where few places are left.
    """

    straight: set[int] = field(default_factory=set)
    near_failed: set[int] = field(default_factory=set)
    each_cell: bool = False

    def rows(self, policy: Policy) -> set[int]:
        """Rows of the cells that are left out for vehicles of a policy."""
        return self.near_failed | self.straight if policy is Policy.STRAIGHT else self.near_failed

    def look_anew(self) -> None:
        """Nothing is known to fail any more, and few places are left."""
        self.straight.clear()
        self.near_failed.clear()
        self.each_cell = True

    def cannot_go_straight(self, scene: Scene, row: int) -> None:
        """A vehicle could not begin on a cell, by its row: what speaks against one mostly speaks against those near."""
        self.straight.update((row,) if self.each_cell else _around(scene, row))

    def not_kept(self, scene: Scene, row: int) -> None:
        """A vehicle that began on a cell could not be kept: none begins near to it."""
        self.near_failed.update(_around(scene, row))


def _around(scene: Scene, row: int) -> range:
    """Rows of the cells of a lane within _AVOIDED_M of a cell."""
    config, grid = scene.config, scene.grid
    lane_id = grid.cells[row].lane_id
    reach, first = int(_AVOIDED_M / config.grid.cell_m), grid.index_of[Cell(lane_id, 0)]
    return range(max(first, row - reach), min(first + grid.count(lane_id), row + reach + 1))


@dataclass(slots=True)
class InsertionSites:
    """Sites of one scene for the requests of a round; what was proposed in this round is kept clear of.

    kept: vehicles of rounds before; wanted: what vehicles are to meet; turned_down: what was found out in rounds
    before, and in this one.
    """

    here: Surroundings
    guard: Guard
    rng: np.random.Generator
    round_number: int
    wanted: Wanted = NONE_WANTED
    turned_down: TurnedDown = field(default_factory=TurnedDown)
    kept: Sequence[ExportedVehicle] = ()
    starts: Starts = field(init=False)
    overtakes: OvertakeStarts = field(init=False)
    entering: EntrySites = field(init=False)
    _in_vain: Counter[tuple[Policy, Situation]] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        """Sites of all kinds share the starts of the round."""
        here, changers = self.here, [one for one in self.kept if one.driven.shifts]
        self.starts = Starts(here.scene, here.roads, here.meetings, self.guard, self.rng, self.round_number, changers)
        self.overtakes = OvertakeStarts(here, self.starts)
        self.entering = EntrySites(here, self.starts)

    def propose(self, request: VehicleRequest, slow_leader: VehicleRequest | None = None) -> list[Start]:
        """A start for a request, and where it is to overtake and finds no leader, one for that; empty where none fits.

        slow_leader: the request that such a leader would meet.
        """
        if self.here.meetings.is_target_missing:
            self.starts.refusals[Reason.NEAR_NO_TRACK] += 1
            return []
        if request.policy is Policy.OVERTAKE:
            return self.overtakes.propose(request, slow_leader)
        found = self._start_for(request)
        return [] if found is None else self.starts.take([found])

    def _start_for(self, request: VehicleRequest) -> Start | None:
        """A start at one of the sites in weighted random order; first where it meets what is wanted, then strict ones.

        Strict: the lane beside is not in an intersection; a turn is driven through in the time of the scene; a vehicle
        that is to go straight comes to no turn in that time.
        """
        wants = self._wants(request.policy)
        if self.entering.is_to_enter(request):
            entry = next(self.entering.starts_of(request, self._followed(), wants), None)
            if entry is not None:
                return entry
        if self.here.scene.config.request.sites == "any":
            return self._start_where(request, lambda *_: True, FOLLOWER_HEADWAY_S)
        strict = partial(self._promises, request, strict=True)
        for one in sorted(wants, key=lambda one: (self.wanted.shares[one], one)):  # the rarest first
            found = self._start_where(request, strict, USUAL_HEADWAY_S, frozenset({one}))
            if found is not None:
                return found
            self._in_vain[request.policy, one] += 1
        return self._start_where(request, strict, USUAL_HEADWAY_S) or self._start_where(
            request, partial(self._promises, request, strict=False), FOLLOWER_HEADWAY_S
        )

    def _wants(self, policy: Policy) -> frozenset[Situation]:
        """What a vehicle is to meet, so that as many do as recorded ones; later rounds fill up with what there is."""
        lacking = self.wanted.lacking(self._there()) if self.round_number == 0 else frozenset[Situation]()
        lacking -= {one for one in lacking if self._in_vain[policy, one] == _IN_VAIN}
        return lacking - _SLOWS if BEHAVIOURS[policy].changes_lanes else lacking

    def _start_where(
        self, request: VehicleRequest, promises: Callable[[RouteOffer, float, float], bool], headway_s: float,
        wants: frozenset[Situation] = frozenset(),
    ) -> Start | None:  # fmt: skip
        """A start at the first site from which one can begin, each on the first route that promises what is asked.

        wants: sites are those from which something of it would be met; what goes straight meets it by its rollout.
        """
        scene, starts, tried = self.here.scene, self.starts, 0
        passes = 1 if request.policy is Policy.STRAIGHT or wants else _PASSES
        for cell, lane_m in chain.from_iterable(self._places(request, wants) for _ in range(passes)):
            usual_mps = scene.usual_speed(cell.lane_id)
            offer = next((
                one for one in self._order(request, cell, wants)
                if not starts.leaves_early(one, one.start_m + lane_m, _STAYS_SHARE * usual_mps)
                and promises(one, one.start_m + lane_m, usual_mps)
            ), None)  # fmt: skip
            if offer is None:
                continue
            site = Site(offer, offer.start_m + lane_m, headway_s=headway_s)
            start = starts.make(request, site, wants=wants if request.policy is Policy.STRAIGHT else frozenset())
            if isinstance(start, Start):
                return start
            starts.refusals[start] += 1
            if start is Reason.NO_SITE:
                continue  # another vehicle of this round may be in the way
            with_less = start is Reason.FOLLOWER_HEADWAY and headway_s > FOLLOWER_HEADWAY_S  # it is tried again
            if request.policy is Policy.STRAIGHT and not (wants or with_less):
                self.turned_down.cannot_go_straight(scene, scene.grid.index_of[cell])
            tried += 1
            if tried == (_WANTED_TRIES if wants else TRIES):
                break
        return None

    def _order(self, request: VehicleRequest, cell: Cell, wants: frozenset[Situation]) -> list[RouteOffer]:
        """Routes from a cell in weighted random order; those that go straight on first unless a turn is asked for."""
        offers, promising = self.here.routes.offers(cell.lane_id), self.here.scene.config.request.sites == "promising"
        weight = self.here.meetings.offer_weights(cell, request.policy, wants) if promising else np.ones(len(offers))
        if len(offers) == 1:
            return [one for one in offers if weight[0] > 0.0]
        order = [offers[row] for row in by_weight(weight, self.rng).tolist()]
        if BEHAVIOURS[request.policy].turn is not None:
            return order
        return sorted(order, key=lambda offer: bool(offer.turns))

    def _places(self, request: VehicleRequest, wants: Set[Situation]) -> Iterator[tuple[Cell, float]]:
        """Free cells at step 0 and arc lengths, m, on their lanes, from which something wanted would be met, if any is.

        In weighted random order; intersections are last or never.
        """
        scene, policy = self.here.scene, request.policy
        grid, promising = scene.grid, scene.config.request.sites == "promising"
        rows, inside = self.here.routes.free_cells(policy if promising else Policy.STRAIGHT)
        if not rows.size:
            return
        weight, tier = np.ones(rows.size), np.zeros(rows.size, dtype=np.int64)
        if promising:
            seen = self.here.meetings.outlook(policy)
            weight = seen.weight[rows]
            if wants:
                weight = weight * seen.meets_any(wants, self._followed())[rows]
            # last are those from which a named target is not met, before them those that leave the map before the end
            tier = np.where(seen.stays[rows], 0, 1)
            if scene.config.request.is_near_agents:
                tier += np.where(seen.near[rows], 0, 2)
            if policy is Policy.STRAIGHT:  # behind a recorded vehicle it goes through with that
                inside = inside & (seen.leader[rows] < 0)
        share = self.rng.random(rows.size)
        order = by_weight(weight, self.rng)
        clear = np.ones(rows.size, dtype=np.bool_)
        if "collision" not in scene.config.without:  # most places of a full road; what is left is looked at on its path
            at_begin = scene.traffic.at(0).joined(self.starts.world.guard.inserted_known.at(0))
            clear = clear_places(scene.boxes, rows, share, at_begin, box=DEFAULT_SIZES["vehicle"], gap_m=CLEAR_GAP_M)
        order = order[np.lexsort((tier[order], inside[order]))]
        if promising and not inside.all():
            order = order[~inside[order]]
        turned_down = self.turned_down.rows(policy) if promising else set[int]()
        for place in order[clear[order]].tolist():
            row = int(rows[place])
            if row in turned_down:
                continue
            cell = grid.cells[row]
            begin, end = grid.edges_m[cell.lane_id][cell.index : cell.index + 2]
            yield cell, float(begin + share[place] * (end - begin))

    def _there(self) -> list[Start]:
        """Those kept and taken."""
        return [*(one.driven.start for one in self.kept), *self.starts.taken]

    def _followed(self) -> list[int]:
        """Leaders of those kept and taken, as `Meetings` numbers them."""
        return [start.leader for start in self._there() if start.leader >= 0]

    def _promises(
        self, request: VehicleRequest, offer: RouteOffer, s: float, speed_mps: float, *, strict: bool
    ) -> bool:
        """Whether the map offers what is asked for from arc length s on, in the time that the scene has."""
        duration, turn = self.here.scene.last_s, BEHAVIOURS[request.policy].turn
        reach = s + speed_mps * duration
        if turn is not None:
            begin, end = offer.next_turn(turn, s)
            if not strict or begin >= reach:
                return s < begin < reach
            to_turn_s = (begin - s) / (_APPROACH_SHARE * speed_mps)
            needs_s = to_turn_s + (end - begin) / _TURN_MPS + _TURN_SPARE_S
            return begin - s > _BEFORE_TURN_M and needs_s < duration
        at = s + PACE_SHARE * speed_mps * request.trigger_s
        if BEHAVIOURS[request.policy].sides:
            return self._offers_change(request, offer, at, speed_mps, strict=strict)
        return not strict or all(begin >= reach or end <= s for _, begin, end in offer.turns)

    def _offers_change(
        self, request: VehicleRequest, offer: RouteOffer, at: float, speed_mps: float, *, strict: bool
    ) -> bool:
        """Whether a route has a lane beside, long enough, about where a vehicle is at its trigger, before any turn.

        And the configured rule would take it with no vehicle on it.
        """
        change, drivers = self.here.scene.config.lane_change, self.here.scene.config.drivers
        waits_m = change.give_up_s * speed_mps
        needed = change.min_remaining_m + _CHANGE_SPARE_S * speed_mps
        if strict:  # it may be faster than usual
            farther_m = _FARTHER_SHARE * speed_mps * request.trigger_s
            across_m = _CHANGE_RATIO * change.min_duration_s * speed_mps
            needed = max(change.min_remaining_m, across_m) + _STRICT_SPARE_S * speed_mps + farther_m
            if offer.meets_junction(at, at + drivers.lane_change_mean_s * speed_mps):
                return False  # lane changes outside intersections first
        over = at + change.min_duration_s * speed_mps
        if any(at < end and begin < over for _, begin, end in offer.turns):
            return False
        sides = {
            beside.side for beside in offer.beside
            if beside.side in BEHAVIOURS[request.policy].sides
            and beside.start <= at + waits_m + _BESIDE_M and beside.end > at + _BESIDE_M
            and not (strict and offer.meets_junction(beside.start, beside.end))
            and beside.remaining_m - max(0.0, at - beside.start) > needed
        }  # fmt: skip
        driver = usual_driver(speed_mps)
        refused = {refusal_of_lane(driver, change, speed_mps=speed_mps, side=side) for side in sorted(sides)}
        self.starts.refusals.update(one for one in refused if one is not None and None not in refused)
        return None in refused
