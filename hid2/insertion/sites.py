"""Start sites: where on the map a request may be met, and whether a vehicle can begin there."""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from hid2.agents import DEFAULT_SIZES, BoxSize, FloatArray, IntArray, Policy
from hid2.conflicts.guard import Guard, Obstacles
from hid2.conflicts.stop_lines import StopLines
from hid2.drivers.driver import Driver, desired_speeds, draw_driver, lane_offset
from hid2.insertion.entries import Entries
from hid2.insertion.meetings import Meetings
from hid2.insertion.overtakes import ForeseenOvertake, Overtakes, Way
from hid2.insertion.routes import RouteOffer, Routes
from hid2.insertion.sizes import draw_size
from hid2.insertion.spread import Spread, by_weight
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.motion.route import DrivenPath, first_turn
from hid2.occupancy.along_path import PathOccupancy
from hid2.occupancy.traffic import Traffic
from hid2.params import Config, Sites
from hid2.policy.decision import Side
from hid2.policy.lane_change import lane_change_reason, safe_gap_m
from hid2.policy.observation import lane_options, lay_across
from hid2.policy.roads import Roads
from hid2.policy.turns import TURN_OF_POLICY
from hid2.reasons import Reason
from hid2.scene import Scene, clearance_box
from hid2.vehicle import Start, VehicleRequest
from netconvert.cells import Cell

#: A vehicle begins with its rear bumper so far from the beginning of its way at least, m.
_FROM_EDGE_M = 0.5
#: Verdicts that another driver may change.
_ANOTHER_DRIVER = frozenset({Reason.TTC_RECORDED_FOLLOWER, Reason.LEAVES_TOO_EARLY})
_BESIDE_MOST_M = 80.0  # no tunable, spares time: two starts farther apart have nothing to do with each other

#: Centre (x, y), m, and unit vector of the direction, of one vehicle.
_Pose = tuple[list[float], list[float]]


@dataclass(slots=True)
class InsertionSites:
    """Sites of one scene for requests; what was proposed in this round is kept clear of.

    avoided: lanes and arc lengths, m, at which vehicles of rounds before began that could not be kept; asked: how many
    vehicles of each policy the scene is asked for, which share its sites; kept: starts of vehicles of rounds before.
    """

    scene: Scene
    roads: Roads
    routes: Routes
    stop_lines: StopLines
    guard: Guard
    rng: np.random.Generator
    round_number: int
    meetings: Meetings
    entries: Entries
    spread: Spread
    avoided: Sequence[tuple[int, float]] = ()
    kept: Sequence[Start] = ()
    asked: Counter[Policy] = field(default_factory=Counter)
    taken: list[Start] = field(default_factory=list)
    foresees_none: bool = False
    """Whether the overtake looked for last fits nowhere into the recorded traffic."""
    rejected: Counter[Reason] = field(default_factory=Counter)
    _looked: Counter[Policy] = field(default_factory=Counter)
    _entering: int = 0
    _overtakes: Overtakes = field(init=False)
    _poses: dict[str, _Pose] = field(default_factory=dict)
    _obstacles: dict[tuple[DrivenPath, BoxSize], Obstacles] = field(default_factory=dict)
    _foreseen: dict[tuple[float, int], Traffic] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """One for all requests of a round: what is known on a way is looked up once."""
        self._overtakes = Overtakes(self.scene, self.routes, self.roads, self.guard)

    def propose(self, request: VehicleRequest, slow_leader: VehicleRequest | None = None) -> list[Start]:
        """A start for a request, and where it is to overtake and finds no leader, one for that; empty where none fits.

        slow_leader: the request that such a leader would meet.
        """
        if request.policy is Policy.OVERTAKE:
            return self._propose_overtake(request, slow_leader)
        found = next(self._starts(request), None)
        return [] if found is None else self._take([found])

    def _take(self, starts: list[Start]) -> list[Start]:
        self.taken += starts
        return starts

    def _propose_overtake(self, request: VehicleRequest, slow_leader: VehicleRequest | None) -> list[Start]:
        if self.scene.config.request.sites == "promising":
            return self._take(self._foreseen_overtake(request, slow_leader))
        for start in self._starts(request):
            if self._has_slower_leader(start):
                return self._take([start])
            if slow_leader is not None and self.scene.config.request.spawn_leaders:
                leader = self._slow_leader(start, slow_leader, *self._slow_place(start))
                if leader is not None:
                    return self._take([leader, start])
        return []

    def _foreseen_overtake(self, request: VehicleRequest, slow_leader: VehicleRequest | None) -> list[Start]:
        """A start where an overtake from the trigger on fits into what is known, and its leader where one is added."""
        sites, waits_s = self.scene.config.sites, self.scene.config.foresight.waits_s
        adds = slow_leader is not None and self.scene.config.request.spawn_leaders
        rivals_on = {lane for start in self.taken if start.request.policy is Policy.OVERTAKE for lane in start.route}
        ways = [way for way in self.routes.ways_past() if rivals_on.isdisjoint(way[0].route)]
        tried, self.foresees_none = 0, True
        for place in self.rng.permutation(len(ways)).tolist():
            if tried == sites.overtake_ways:
                break
            drivers = [
                draw_driver(self.scene.config, self.rng, lane_speed_mps=self.scene.lane_speed(ways[place][1], self.rng))
                for _ in range(sites.drivers)
            ]
            driver = max(drivers, key=lambda one: one.desired_mps)  # who overtakes is in a hurry
            way = self._overtakes.way(*ways[place], reach_m=driver.desired_mps * (request.trigger_s + waits_s))
            if way is None:
                continue
            tried += 1
            found = self._overtakes.foresee(way, driver, self.rng, trigger_s=request.trigger_s, lead=adds)
            if not found:
                self.rejected[Reason.NO_OVERTAKE_FORESEEN] += 1
                continue
            self.foresees_none = False
            for one in found[: sites.drivers]:
                starts = self._overtake_starts(request, slow_leader, way, one, driver)
                if starts:
                    return starts
        return []

    def _overtake_starts(
        self, request: VehicleRequest, slow_leader: VehicleRequest | None, way: Way, seen: ForeseenOvertake,
        driver: Driver,
    ) -> list[Start]:  # fmt: skip
        """The vehicle and, where it is added, its leader, ahead of it; empty where they cannot begin so."""
        raw = way.path.to_raw(seen.start_s)
        found = self._start(request, way.offer, way.lane_id, raw, driver=driver, speed_mps=seen.start_mps)
        if not isinstance(found, Start):
            self.rejected[found] += 1
            return []
        found = replace(found, sides=(way.side,))
        if seen.leader_s is None:
            return [found]
        assert slow_leader is not None
        leader = self._slow_leader(found, slow_leader, seen.leader_s, seen.leader_mps)
        return [] if leader is None else [leader, found]

    def _starts(self, request: VehicleRequest) -> Iterator[Start]:
        """Starts at sites in weighted random order; first where more speaks for them.

        Strict: the lane beside is not in an intersection; whoever is to go straight meets no turn in the time of the
        scene. Likely: a gap beside is foreseen at the trigger; nobody known is in the way of a turn.
        """
        if self._is_to_enter(request):
            yield from self._entering_starts(request)
        if self.scene.config.request.sites == "any":
            yield from self._starts_where(request, _any_site, likely=False)
            return
        tiers = ((True, True), (False, True), (False, False))
        for strict, likely in tiers if request.policy is Policy.LANE_CHANGE else tiers[::2]:
            yield from self._starts_where(request, partial(self._promises, request, strict=strict), likely=likely)

    def _is_to_enter(self, request: VehicleRequest) -> bool:
        """Whether a vehicle is to enter at the map's edge if it can; who is scored is there from the first step on."""
        asked = self.scene.config.request
        if request.policy is not Policy.STRAIGHT or asked.generated_category > 1 or asked.entering == 0.0:
            return False
        return bool(self.rng.random() < asked.entering)

    def _entering_starts(self, request: VehicleRequest) -> Iterator[Start]:
        """Starts at the map's edge during the scene: lane, route and step in the order of `Spread`."""
        scene, table = self.scene, self.entries.table
        weight = table.weight.copy()
        followed = [self._leader_of(start) for start in (*self.kept, *self.taken)]
        weight[np.isin(table.leader, followed) & (table.leader >= 0)] /= scene.config.spawn.leader_weight
        if self.meetings.is_target_named:
            weight[~table.near] = 0.0
        order = self.spread.order(
            weight, self.rng, number=self._entering, kind=len(Policy), round_number=self.round_number,
            of=round(scene.config.request.entering * self.asked[Policy.STRAIGHT]),
        )  # fmt: skip
        self._entering += 1
        likely = self.round_number < scene.config.spawn.reseed_rounds  # the count matters more by then
        for row in order[: scene.config.sites.tries].tolist():
            start = self._start(
                request, self.entries.offer(row), int(table.lane[row]), None, step=self.entries.step(row, self.rng),
                led_by=int(table.leader[row]), likely=likely,
            )  # fmt: skip
            if isinstance(start, Start):
                yield start
            else:
                self.rejected[start] += 1

    def _starts_where(
        self, request: VehicleRequest, promises: Callable[[RouteOffer, float, float], bool], *, likely: bool
    ) -> Iterator[Start]:
        tried = 0
        rivals_on = {
            start.path.segment_at(start.start_s).lane_id
            for start in self.taken
            if start.request.number == request.number
        }
        for lane_id, lane_s in self._places(request):
            if lane_id in rivals_on:  # of two on one lane the one behind would wait for the other
                continue
            for offer in self._order(request, self.scene.grid.cell_at(lane_id, lane_s)):
                s = offer.start_m + lane_s
                usual_mps = self.meetings.usual_speed(lane_id)
                if self._leaves_early(offer, s, 0.8 * usual_mps) or not promises(offer, s, usual_mps):
                    continue
                start = self._start(request, offer, lane_id, s, likely=likely)
                tried += start is not Reason.NO_SITE
                if isinstance(start, Start):
                    yield start
                else:
                    self.rejected[start] += 1
                break
            if tried >= self.scene.config.sites.tries:
                return

    def _order(self, request: VehicleRequest, cell: Cell) -> list[RouteOffer]:
        """Routes from a cell in weighted random order; those that go straight on first unless a turn is asked for."""
        offers = self.routes.offers(cell.lane_id)
        key = self.rng.exponential(size=len(offers))
        if len(offers) == 1:  # drawn all the same
            return list(offers)
        if self.scene.config.request.sites == "promising":
            key /= np.array(self.meetings.offer_weights(cell, request.policy))
        order = [offers[row] for row in np.argsort(key, kind="stable").tolist()]
        if request.policy in TURN_OF_POLICY:
            return order
        return sorted(order, key=lambda offer: bool(offer.turns))

    def _places(self, request: VehicleRequest) -> Iterator[tuple[int, float]]:
        """Lane and arc length, m, of free cells at step 0; first from where more is met, intersections last or never.

        The order is that of `Spread`, by the number of this vehicle among those of its policy.
        """
        scene, policy = self.scene, request.policy
        grid, promising = scene.grid, scene.config.request.sites == "promising"
        rows, inside = self.routes.free_cells(policy if promising else Policy.STRAIGHT)
        if not rows.size:
            return
        weight, tier = np.ones(rows.size), np.zeros(rows.size, dtype=np.int64)
        if promising:
            weight, tier = self._weights(policy, rows)
        failed: dict[int, list[float]] = {}
        for lane_id, at in self.avoided:
            failed.setdefault(lane_id, []).append(at)
        if failed:
            weight /= [1.0 + len(failed.get(grid.cells[row].lane_id, ())) for row in rows.tolist()]
        if promising and policy is Policy.STRAIGHT:  # who follows a recorded vehicle goes through with it
            inside = inside & (self.meetings.outlook(policy).leader[rows] < 0)
        share = self.rng.random(rows.size)
        if not promising:
            order = by_weight(weight, self.rng)
        else:
            order = self.spread.order(
                weight, self.rng, number=self._looked[policy], of=self.asked[policy],
                kind=list(Policy).index(policy), round_number=self.round_number,
            )  # fmt: skip
        self._looked[policy] += 1
        all_inside = bool(inside.all())
        for place in order[np.lexsort((tier[order], inside[order]))].tolist():
            if inside[place] and promising and not all_inside:
                return
            cell = grid.cells[rows[place]]
            begin, end = grid.edges_s(cell.lane_id)[cell.index : cell.index + 2]
            lane_s = float(begin + share[place] * (end - begin))
            if not any(abs(lane_s - at) < scene.config.sites.avoided_m for at in failed.get(cell.lane_id, ())):
                yield cell.lane_id, lane_s

    def _weights(self, policy: Policy, rows: IntArray) -> tuple[FloatArray, IntArray]:
        """Weights of cells, rows (N,) of the grid; and 1 for those from which a named target is not met, else 0.

        A leader whom a vehicle follows already, of this round or of one before, speaks for no other site.
        """
        meetings, seen = self.meetings, self.meetings.outlook(policy)
        leader, weight = seen.leader[rows], seen.weight[rows].copy()
        followed = [self._leader_of(start) for start in (*self.kept, *self.taken)]
        weight[np.isin(leader, followed) & (leader >= 0)] /= self.scene.config.spawn.leader_weight
        tier = ~seen.near[rows] if meetings.is_target_named else np.zeros(len(rows), dtype=np.bool_)
        return weight, tier.astype(np.int64)

    def _leader_of(self, start: Start) -> int:
        """The recorded vehicle that a start follows, as `Meetings` numbers them; -1 none."""
        if start.step > 0:
            return self.entries.leader_of(start.route, start.step)
        return self.meetings.leader_of(self.scene.cell_at(start.path, start.start_s), start.route)

    def _promises(
        self, request: VehicleRequest, offer: RouteOffer, s: float, speed_mps: float, *, strict: bool
    ) -> bool:
        """Whether the map offers what is asked for from arc length s on, in the time that the scene has."""
        scene, sites = self.scene, self.scene.config.sites
        duration = scene.last_s
        reach = s + speed_mps * duration
        ahead = [turn for turn in offer.turns if turn[2] > s]
        if request.policy in TURN_OF_POLICY:
            if not ahead or ahead[0][0] is not TURN_OF_POLICY[request.policy]:
                return False
            _, begin, end = ahead[0]
            to_turn_s = (begin - s) / (sites.turn_approach_share * speed_mps)
            needs_s = to_turn_s + (end - begin) / sites.turn_pace_mps + sites.turn_spare_s * (1.0 if strict else 0.5)
            return begin - s > sites.before_turn_m and needs_s < duration
        at = s + 0.9 * speed_mps * request.trigger_s
        if request.policy is Policy.LANE_CHANGE:
            return self._offers_change(request, offer, at, speed_mps, strict=strict)
        return not (strict or request.policy is Policy.OVERTAKE) or all(begin >= reach for _, begin, _ in ahead)

    def _offers_change(
        self, request: VehicleRequest, offer: RouteOffer, at: float, speed_mps: float, *, strict: bool
    ) -> bool:
        """Whether a route has a lane beside, long enough, about where a vehicle is at its trigger, before any turn."""
        change, sites, drivers = self.scene.config.lane_change, self.scene.config.sites, self.scene.config.drivers
        waits_m = max(sites.gap_waits_s) * speed_mps
        needed = change.min_remaining_m + 0.3 * speed_mps
        if strict:  # it may be faster than usual
            slack_m = 0.3 * speed_mps * request.trigger_s
            needed = max(change.min_remaining_m, 1.3 * change.min_duration_s * speed_mps) + 0.5 * speed_mps + slack_m
            if self._meets_junction(offer, at, at + drivers.lane_change_mean_s * speed_mps):
                return False  # lane changes outside intersections first
        over = at + change.min_duration_s * speed_mps
        if any(at < end and begin < over for _, begin, end in offer.turns):
            return False
        return any(
            beside.start <= at + waits_m + 1.0 and beside.end > at + 1.0
            and not (strict and beside.in_intersection)
            and beside.remaining_m - max(0.0, at - beside.start) > needed
            for beside in offer.beside
        )  # fmt: skip

    def _meets_junction(self, offer: RouteOffer, begin: float, end: float) -> bool:
        """Whether a stretch of a route, m along its lanes, touches an intersection."""
        lanes, at = self.scene.grid.graph.lanes, 0.0
        for lane_id in offer.route:
            lane = lanes[lane_id]
            if lane.is_intersection and at < end and at + lane.length_m > begin:
                return True
            at += lane.length_m
        return False

    def _start(
        self, request: VehicleRequest, offer: RouteOffer, lane_id: int, s: float | None, *,
        driver: Driver | None = None, speed_mps: float | None = None, likely: bool = False, step: int = 0,
        led_by: int = -1,
    ) -> Start | Reason:  # fmt: skip
        """A vehicle with a driver at a site, with a start speed, m/s, or why it cannot begin there.

        s: along the route's lanes, m; None: at their beginning, all of it on them. step: from which on it is there;
        led_by: whom it would follow then.
        """
        scene, config, rng = self.scene, self.scene.config, self.rng
        object_type, size = draw_size(config.request, rng)
        box = clearance_box(size, DEFAULT_SIZES[object_type])
        half_m, run_on = box.length_m / 2, "topology" in config.without
        if s is None:  # it has come over the edge since the step before
            s = half_m + _FROM_EDGE_M + float(rng.random()) * self.meetings.usual_speed(lane_id) * scene.step_s
        if s < half_m + _FROM_EDGE_M or (s + half_m > offer.length_m - 1.0 and not run_on):
            return Reason.NO_SITE
        if step == 0 and self._meets_taken_roughly(lane_id, s - offer.start_m, box):
            return Reason.NO_SITE
        path = scene.path(offer.route)
        start_s = path.to_line(s)
        if "collision" not in config.without and self._is_taken(path, box, start_s, step):
            return Reason.NO_SITE
        reach_s: float | None = None
        if request.policy in TURN_OF_POLICY:
            turn = first_turn(scene.grid.graph, path, TURN_OF_POLICY[request.policy], after=start_s)
            if turn is None:
                return Reason.TURN_NOT_SEEN
            reach_s = turn.end + 1.0 if likely else None
        elif likely and (step > 0 or request.policy is not Policy.STRAIGHT):  # who changes lanes or enters is under way
            pace_mps = config.sites.under_way_share * self.meetings.usual_speed(lane_id)
            reach_s = start_s + pace_mps * (scene.last_s - step * scene.step_s)
        led_mps = 0.0
        if config.request.sites == "promising":
            leader = led_by if step else self.meetings.leader_of(scene.cell_at(path, start_s), offer.route)
            led_mps = self.meetings.pace_of(leader)
        verdict: Reason = Reason.NO_SITE
        for _ in range(1 if driver is not None else config.sites.drivers):
            # who follows at a usual gap drives as fast as the leader at least, or would not be there
            pace_mps = max(scene.lane_speed(lane_id, rng), led_mps)
            who = driver or draw_driver(config, rng, lane_speed_mps=pace_mps)
            speed = speed_mps
            if speed is None:
                speed = who.desired_mps * (1.0 + config.spawn.speed_sd * min(max(rng.standard_normal(), -2.0), 2.0))
            found = self._start_speed(offer, path, box, s, start_s, speed, who, reach_s, step)
            if not isinstance(found, Reason):
                break
            verdict = found
            if found not in _ANOTHER_DRIVER:
                return found
        else:
            return verdict
        speed = found
        sides: tuple[Side, ...] = ("left", "right") if rng.random() < 0.5 else ("right", "left")
        if (
            likely
            and request.policy is Policy.LANE_CHANGE
            and not self._gap_likely(path, box, start_s, speed, request, who)
        ):
            return Reason.CELLS_OCCUPIED
        wished = desired_speeds(
            who, config, rng, num_steps=scene.num_steps - step, step_s=scene.step_s, at_least_mps=speed
        )
        return Start(
            vehicle_id=self._name(request), request=request, object_type=object_type, size=size,
            box=box, route=offer.route, path=path, start_s=start_s, start_mps=speed, driver=who,
            desired=np.concatenate([np.full(step, wished[0]), wished]),
            offset=lane_offset(who, config, rng, length_m=path.line.length_m), sides=sides, step=step,
        )  # fmt: skip

    def _name(self, request: VehicleRequest) -> str:
        rivals = sum(start.request.number == request.number for start in self.taken)
        return f"v{request.number}_{self.round_number}" + (f"_{rivals}" if rivals else "")

    def _gap_likely(
        self, path: DrivenPath, box: BoxSize, s: float, speed_mps: float, request: VehicleRequest, driver: Driver
    ) -> bool:
        """Whether a vehicle that drives on finds a gap beside it soon after its trigger, and a way into it in time."""
        scene, change = self.scene, self.scene.config.lane_change
        for wait_s in self.scene.config.sites.gap_waits_s:
            at_s = request.trigger_s + wait_s
            step = round(at_s / scene.step_s)
            if step >= scene.num_steps:
                break
            at, v = self._place_after(path, box, s, speed_mps, driver, at_s)
            if at > path.exit_s:
                break
            options = lane_options(
                scene, path, box, s=at, step=step, sides=("left", "right"), fixed=self.guard.fixed,
                fleet=self._taken_at(at_s), speed_mps=v, desired_mps=driver.desired_mps,
            )  # fmt: skip
            for option, target in options:
                reason = lane_change_reason(
                    speed_mps=v, cells_free=option.cells_free, front=option.front, rear=option.rear,
                    remaining_m=option.remaining_m, params=change,
                )  # fmt: skip
                if reason is not None:
                    continue
                across = lay_across(
                    scene, path, target, s=at, step=step, pace_mps=v, remaining_m=option.remaining_m,
                    lasting_s=driver.lane_change_s,
                )  # fmt: skip
                if isinstance(across, DrivenPath) and (across.shifts[-1][1] - at) < v * (scene.last_s - at_s):
                    return True
        return False

    def _place_after(
        self, path: DrivenPath, box: BoxSize, s: float, speed_mps: float, driver: Driver, time_s: float
    ) -> tuple[float, float]:
        """Where a vehicle is after some time, m on its path, and how fast, m/s: as before, or behind who is ahead."""
        known, step = self._known_on(path, box), round(time_s / self.scene.step_s)
        at, low, along = s + speed_mps * time_s, known.low[:, step], known.along[:, step]
        leads = known.same_direction[:, step] & np.isfinite(low) & (known.low[:, 0] >= s) & np.isfinite(known.low[:, 0])
        behind = np.where(leads, low - driver.min_gap_m - driver.tau_s * np.maximum(along, 0.0), np.inf)
        if behind.size == 0 or behind.min() >= at:
            return at, speed_mps
        first = int(np.argmin(behind))
        return max(s, float(behind[first])), max(0.0, float(along[first]))

    def _taken_at(self, time_s: float) -> Traffic:
        """The other starts of this round after some time, each at its start speed (one step)."""
        count, step_s = len(self.taken), self.scene.step_s
        if (time_s, count) not in self._foreseen:
            lasting_s = [time_s - start.step * step_s for start in self.taken]
            places = [
                np.array([start.start_s + start.start_mps * max(0.0, since_s)])
                for start, since_s in zip(self.taken, lasting_s, strict=True)
            ]
            poses = [start.path.line.motion(at) for start, at in zip(self.taken, places, strict=True)]
            tangent = np.array([tangent[0] for _, tangent, _ in poses]).reshape(count, 1, 2)
            self._foreseen[time_s, count] = Traffic(
                ids=tuple(start.vehicle_id for start in self.taken),
                position=np.array([xy[0] for xy, _, _ in poses]).reshape(count, 1, 2),
                heading=np.arctan2(tangent[..., 1], tangent[..., 0]),
                velocity=tangent * np.array([start.start_mps for start in self.taken])[:, None, None],
                present=np.array([since_s >= 0.0 for since_s in lasting_s], dtype=np.bool_).reshape(count, 1),
                length_m=np.array([start.box.length_m for start in self.taken]),
                width_m=np.array([start.box.width_m for start in self.taken]),
            )  # fmt: skip
        return self._foreseen[time_s, count]

    def _start_speed(
        self, offer: RouteOffer, path: DrivenPath, box: BoxSize, s: float, start_s: float, speed: float,
        driver: Driver, reach_s: float | None, step: int,
    ) -> float | Reason:  # fmt: skip
        """Speed at which a driver who would like to drive at `speed` begins, m/s; or why it cannot begin there.

        s, start_s: the site along the route's lanes and on the path, m; reach_s: where it has to get unhindered.
        """
        limits, export = self.scene.config.limits, self.scene.config.export
        if self._leaves_early(offer, s + box.length_m / 2, 0.95 * speed, step):
            return Reason.LEAVES_TOO_EARLY
        reach = slice(int(start_s / TABLE_STEP_M), int((start_s + 12.0 * speed) / TABLE_STEP_M) + 2)
        if np.abs(path.line.table_curvature[reach]).max(initial=0.0) > export.limit_share / limits.min_radius_m:
            return Reason.LIMIT_CURVATURE
        road = self.roads.speeds(path, driver)
        speed = min(speed, float(road[min(int(start_s / TABLE_STEP_M), road.size - 1)]))
        if "collision" in self.scene.config.without:
            return speed
        return self._admitted_speed(path, box, start_s, speed, driver, reach_s, step)

    def _leaves_early(self, offer: RouteOffer, s: float, speed_mps: float, step: int = 0) -> bool:
        """Whether the map ends before the last observed step at a speed."""
        if "topology" in self.scene.config.without:
            return False
        return offer.length_m - s < speed_mps * self.scene.steps_to_stay(step) * self.scene.step_s

    def _is_taken(self, path: DrivenPath, box: BoxSize, s: float, step: int) -> bool:
        """Whether somebody recorded or kept is at a place at the start, or too near to it."""
        clear = self.scene.config.spawn.clear_gap_m
        known = self._known_at(path, box, step)
        return bool(np.any((known.low[:, 0] - clear < s) & (s < known.high[:, 0] + clear)))

    def _known_at(self, path: DrivenPath, box: BoxSize, step: int) -> PathOccupancy:
        """Everybody known on a path at a step, (A, 1)."""
        return self.guard.at_start(path, box) if step == 0 else self._known_on(path, box).at(step)

    def _known_on(self, path: DrivenPath, box: BoxSize) -> PathOccupancy:
        return self._obstacles_on(path, box).known

    def _obstacles_on(self, path: DrivenPath, box: BoxSize) -> Obstacles:
        key = path, box
        if key not in self._obstacles:
            self._obstacles[key] = self.guard.obstacles(path, box, [])
        return self._obstacles[key]

    def _admitted_speed(
        self, path: DrivenPath, box: BoxSize, s: float, speed: float, driver: Driver, reach_s: float | None, step: int
    ) -> float | Reason:
        """Speed that who is ahead allows, m/s, at most the one wished for; or why nobody can begin there."""
        conflict, spawn, sites = self.scene.config.conflict, self.scene.config.spawn, self.scene.config.sites
        known, wished = self._known_at(path, box, step), speed
        low, along = known.low[:, 0], known.along[:, 0]
        ahead = np.isfinite(low) & (low >= s)
        for gap, leader_mps in zip((low - s)[ahead].tolist(), along[ahead].tolist(), strict=True):
            speed = min(speed, speed_behind(gap, max(0.0, leader_mps), driver, sites))
        stop = self.stop_lines.arrays(path, box).braking(driver, s=s, speed_mps=speed, step=step)
        if stop is not None and stop[0] < -driver.decel_mps2:
            return Reason.CONFLICT_PREDICTED
        own_xy, own_t, _ = path.line.motion(np.array([s]))
        own = own_xy[0].tolist(), own_t[0].tolist()
        for other in self.taken:
            verdict = self._beside_start(
                self._later(path, s, speed, other.step - step) or own, box, driver, other, speed,
                self._later(other.path, other.start_s, other.start_mps, step - other.step),
            )  # fmt: skip
            if verdict is None:
                return Reason.NO_SITE
            speed = min(speed, verdict)
        if step > 0 and (speed < sites.standing_mps or self._follower_is_near(own, box, speed, step)):
            return Reason.NO_SITE
        if speed < sites.standing_mps:
            if not np.any(ahead & (low - s < sites.queue_m) & (along < sites.standing_mps)):
                return Reason.NO_SITE
            speed = 0.0
        elif speed < sites.slowest_share * wished:
            return Reason.NO_SITE  # nobody drives so slowly with so much room ahead
        fleet = np.array([[s, speed, 0.0, 0.0, 1.0]])
        found = self.guard.braking(
            self._obstacles_on(path, box), own=0, step=step, fleet=fleet, state=(s, speed, 0.0),
            desired_mps=driver.desired_mps, road=self.roads.speeds(path, driver), driver=driver,
            horizon_s=self.scene.last_s - step * self.scene.step_s,
        )  # fmt: skip
        if found.run_into:
            return Reason.TTC_RECORDED_FOLLOWER
        soon = found.free_conflict_s is not None and found.free_conflict_s < conflict.horizon_s
        if found.conflict_s is not None and found.conflict_s < spawn.settle_s:
            return Reason.CONFLICT_PREDICTED
        if soon and found.decel_mps2 > sites.braking_ratio * driver.decel_mps2:
            return Reason.CONFLICT_PREDICTED
        if reach_s is not None and found.free_s < reach_s:
            return Reason.CONFLICT_PREDICTED
        return speed

    def _pose_of(self, start: Start) -> _Pose:
        """Where another start of this round is, m, and its direction."""
        if start.vehicle_id not in self._poses:
            xy, tangent, _ = start.path.line.motion(np.array([start.start_s]))
            self._poses[start.vehicle_id] = xy[0].tolist(), tangent[0].tolist()
        return self._poses[start.vehicle_id]

    def _later(self, path: DrivenPath, s: float, speed_mps: float, steps: int) -> _Pose | None:
        """Where a vehicle is so many steps after its start at its start speed; None for no step after it."""
        if steps <= 0:
            return None
        xy, tangent, _ = path.line.motion(np.array([s + speed_mps * steps * self.scene.step_s]))
        return xy[0].tolist(), tangent[0].tolist()

    def _follower_is_near(self, own: _Pose, box: BoxSize, speed_mps: float, step: int) -> bool:
        """Whether somebody comes from behind at a step, as recorded or kept, on the lane or before the map's edge."""
        config = self.scene.config
        here = self.scene.traffic.at(step)
        here = here.joined(self.guard.fixed.at(step)) if self.guard.fixed.ids else here
        (x, y), (tx, ty) = own
        offset = here.position[:, 0] - (x, y)
        behind_m = -(offset @ (tx, ty)) - 0.5 * (here.length_m + box.length_m)
        across_m = np.abs(offset @ (-ty, tx)) - 0.5 * (here.width_m + box.width_m)
        closing = here.velocity[:, 0] @ (tx, ty) - speed_mps
        least_m = np.maximum(config.spawn.clear_gap_m, config.conflict.follower_ttc_min_s * closing)
        near = (across_m < config.conflict.margin_lateral_m) & (behind_m > -box.length_m) & (behind_m < least_m)
        return bool(np.any(near & here.present[:, 0] & (offset @ (tx, ty) < 0.0)))

    def _beside_start(
        self, own: _Pose, box: BoxSize, driver: Driver, other: Start, speed: float, pose: _Pose | None = None
    ) -> float | None:
        """Fastest start speed beside another start of this round; None where the two are too near.

        pose: of the other one when the later of the two begins, where that is not at its own start.
        """
        sites = self.scene.config.sites
        (own_x, own_y), (own_tx, own_ty) = own
        (x, y), (tx, ty) = pose or self._pose_of(other)
        dx, dy = x - own_x, y - own_y
        if math.hypot(dx, dy) > _BESIDE_MOST_M:
            return speed
        same_way = own_tx * tx + own_ty * ty
        along = dx * own_tx + dy * own_ty
        across = abs(dy * own_tx - dx * own_ty)
        gap = abs(along) - (box.length_m + other.box.length_m) / 2
        beside = across > (box.width_m + other.box.width_m) / 2 + 0.5
        ahead_of_other = -(dx * tx + dy * ty)
        near = -sites.pass_behind_m < ahead_of_other < sites.pass_ahead_m and across <= sites.pass_beside_m
        if other.request.policy is Policy.OVERTAKE and near and same_way >= 0.7:
            return None  # nor between it and its leader
        if beside:
            if same_way < 0.7 or across > sites.pass_beside_m:
                return speed
            return None if self._in_the_gap(other, ahead_of_other, speed, box) else speed
        if same_way < 0.7:
            return speed if gap > sites.crossing_gap_m else None
        if along > 0:
            fits = speed_behind(gap, other.start_mps, driver, sites)
            return min(speed, fits) if gap > self.scene.config.spawn.clear_gap_m else None
        return speed if speed_behind(gap, speed, other.driver, sites) >= other.start_mps else None

    def _in_the_gap(self, changes: Start, ahead_m: float, speed_mps: float, box: BoxSize) -> bool:
        """Whether a vehicle ahead_m ahead on a lane beside is where another one is to change lanes, at its trigger."""
        if changes.request.policy is not Policy.LANE_CHANGE:
            return False
        params, apart = self.scene.config.lane_change, 0.5 * (changes.box.length_m + box.length_m)
        at_m = ahead_m + (speed_mps - changes.start_mps) * changes.request.trigger_s
        front_m = safe_gap_m(changes.start_mps, speed_mps, time_gap_s=params.time_gap_front_s, params=params)
        rear_m = safe_gap_m(speed_mps, changes.start_mps, time_gap_s=params.time_gap_rear_s, params=params)
        return -rear_m < at_m + apart and at_m - apart < front_m

    def _meets_taken_roughly(self, lane_id: int, lane_s: float, box: BoxSize) -> bool:
        point = self.scene.grid.graph.lanes[lane_id].path.point(np.array([lane_s]))[0]
        for other in self.taken:
            x, y = self._pose_of(other)[0]
            if math.hypot(x - point[0], y - point[1]) < min(box.width_m, other.box.width_m):
                return True
        return False

    def _has_slower_leader(self, start: Start) -> bool:
        overtake, sites = self.scene.config.overtake, self.scene.config.sites
        found = self.scene.recorded_on(start.path, start.box)
        low, along = found.low[:, 0], found.along[:, 0]
        rows = np.isin(self.scene.rows_on(start.path, start.box), self.scene.vehicle_rows)
        near = (
            rows
            & found.same_direction[:, 0]
            & (low > start.start_s)
            & (low - start.start_s < overtake.d_obs_m + sites.leader_beyond_m)
        )
        slower = along < start.driver.desired_mps - sites.leader_advantage_ratio * overtake.speed_advantage_mps
        return bool(np.any(near & slower & (along > overtake.parked_mps)))

    def _slow_place(self, start: Start) -> tuple[float, float]:
        """Where a slow vehicle begins that is caught up with at the trigger, m on the path, and its speed, m/s."""
        sites = self.scene.config.sites
        share = float(self.rng.uniform(sites.slow_leader_min, sites.slow_leader_max))
        slow_mps = max(sites.slow_leader_mps, share * start.driver.desired_mps)
        s = start.start_s + start.box.length_m + sites.slow_leader_gap_m + sites.slow_leader_gap_s * start.start_mps
        return s + max(0.0, (start.start_mps - slow_mps) * start.request.trigger_s), slow_mps

    def _slow_leader(self, start: Start, request: VehicleRequest, s: float, slow_mps: float) -> Start | None:
        """A slow vehicle at a place ahead, m, of one that is to overtake; None where it cannot begin there."""
        base = draw_driver(self.scene.config, self.rng, lane_speed_mps=start.driver.desired_mps)
        slow = replace(base, desired_mps=slow_mps)
        raw = start.path.to_raw(s)
        lanes, begin = self.scene.grid.graph.lanes, 0.0
        for lane_id in start.route:
            if raw < begin + lanes[lane_id].length_m:
                break
            begin += lanes[lane_id].length_m
        offer = RouteOffer(start.route, begin, start.path.to_raw(start.path.line.length_m), (), ())
        found = self._start(request, offer, lane_id, raw, driver=slow, speed_mps=slow_mps)
        if not isinstance(found, Start) or abs(found.path.line.length_m - start.path.line.length_m) > 0.1:
            return None
        return found


def _any_site(_offer: RouteOffer, _s: float, _speed_mps: float) -> bool:
    """Every admissible site will do."""
    return True


def entry_speed(start: Start, fleet: Traffic, config: Config, *, step_s: float) -> float | None:
    """Speed at which a vehicle can enter at the map's edge among those that are driven, m/s; None: there is no room.

    fleet: where these were step_s before (one step). At most the speed of the start.
    """
    if not fleet.ids:
        return start.start_mps
    xy, tangent, _ = start.path.line.motion(np.array([start.start_s]))
    (tx, ty), speed = tangent[0], start.start_mps
    offset = fleet.position[:, 0] + step_s * fleet.velocity[:, 0] - xy[0]
    along_m, across_m = offset @ (tx, ty), np.abs(offset @ (-ty, tx))
    gap_m = np.abs(along_m) - 0.5 * (fleet.length_m + start.box.length_m)
    in_lane = across_m < 0.5 * (fleet.width_m + start.box.width_m) + config.conflict.margin_lateral_m
    for row in np.flatnonzero(in_lane & fleet.present[:, 0]).tolist():
        gap, other_mps = float(gap_m[row]), float(fleet.velocity[row, 0] @ (tx, ty))
        leads = along_m[row] > 0.0
        if gap < config.spawn.clear_gap_m or (not leads and gap < config.sites.entry_gap_s * other_mps):
            return None
        if leads:
            speed = min(speed, speed_behind(gap, max(0.0, other_mps), start.driver, config.sites))
    slowest_mps = max(config.sites.standing_mps, config.sites.slowest_share * start.driver.desired_mps)
    return speed if speed >= slowest_mps else None


def speed_behind(gap_m: float, leader_mps: float, driver: Driver, sites: Sites) -> float:
    """Fastest speed at which a driver may begin behind a leader without having to brake (IDM), m/s."""
    room = math.sqrt(1.0 + sites.begin_braking_mps2 / driver.accel_mps2) * gap_m - driver.min_gap_m
    if room <= 0.0:
        return 0.0
    # v tau + v max(0, v - v_l) / (2 sqrt(a b)) = room
    c = 2.0 * math.sqrt(driver.accel_mps2 * driver.decel_mps2)
    b = driver.tau_s * c - leader_mps
    return min(room / driver.tau_s, 0.5 * (-b + math.sqrt(b * b + 4.0 * c * room)))
