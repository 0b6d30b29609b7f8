"""Starts: whether a vehicle can begin at a site, with which driver, how fast, and what a rollout says of it."""

from collections import Counter
from collections.abc import Sequence, Set
from dataclasses import InitVar, dataclass, field, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from hid2.agents import DEFAULT_SIZES, BoxSize, FloatArray, Policy
from hid2.conflicts.guard import Guard
from hid2.drivers.driver import LINE_GAP_M, MIDDLE, Driver, desired_speeds, draw_driver, lane_offset, start_speed
from hid2.insertion.finalise import ExportedVehicle
from hid2.insertion.meetings import Meetings
from hid2.insertion.outcome import takes_gap
from hid2.insertion.rollout import QUEUE_M, SLOWEST_SHARE, RolledOut, Rollout, World
from hid2.insertion.routes import RouteOffer
from hid2.insertion.situations import Situation, foreseen
from hid2.judge.findings import CURVATURE_KEPT, FOLLOWER_HEADWAY_S, LEADER_LENGTH_S
from hid2.measures.arrays import STANDS_MPS
from hid2.measures.encounters import BRAKES_FOR_S
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.motion.route import DrivenPath, first_turn
from hid2.occupancy.along_path import PathOccupancy
from hid2.occupancy.gaps import AllGaps, Gaps, gaps_from_pose, gaps_to_all
from hid2.occupancy.traffic import BoolArray
from hid2.policy.behaviours import BEHAVIOURS
from hid2.policy.roads import Roads
from hid2.reasons import Reason
from hid2.scene import Scene, clearance_box
from hid2.vehicle import Start, VehicleRequest
from netconvert.lane_graph import SIDES, Side

# No tunables from here to _BEGINS_S: how vehicles begin.
_HOLDS_S = 3.0  # time over which a start with `request.sites = any` must meet nothing, s
_FROM_EDGE_M = 0.5  # least distance from the begin of a route to a rear bumper, m
_TO_EDGE_M = 1.0  # least distance from a front bumper to the end of a route, m
_BEGINS_S = 1.3  # duration of the beginning of a vehicle, over which it does not brake hard, s
# No tunables from here to _EASED_AT_MOST: they save looking in vain.
_DRIVERS = 3  # drivers drawn for a site, at most
_KEPT_SHARE = 0.95  # share of its start speed with which a vehicle must be on the map long enough
_AHEAD_S = 12.0  # look-ahead along a route for sharp curves, s: a scene lasts 11
_TURNED_M = 1.0  # distance before and behind a turn's lane from and to which the turn is seen, m
_EASED_AT_MOST = 3  # times that a start is made slower, at most; once is enough for most
#: Parts of the motion of a vehicle that is taken without a rollout over the scene: none.
_NOT_ROLLED_OUT: tuple[Rollout, ...] = ()
#: Least bumper gap at the start, m. No tunable: what drivers keep standing.
CLEAR_GAP_M = 2.0
#: Share of vehicles that begin while they gain speed. No tunable: within 3 s .41 of 81 recorded ones gain .75 m/s or
#: more, and .2 lose as much.
_GAINING_SHARE = 0.3
#: Largest mean deceleration over _BEGINS_S, m/s2. No tunable: as of nine in ten vehicles recorded from step 0 on (89 of
#: 98 in fourteen scenes).
_EASED_TO_MPS2 = 0.5
#: Time before a start in which, at the speeds of the start, a vehicle has not come through its leader or follower, s.
#: No tunable: of recorded vehicles behind a leader .5 % would have, at any step.
_BEFORE_S = 1.5
#: Largest deceleration for a leader at a start, m/s2, before a rollout eases the start. No tunable: how vehicles begin;
#: with more of it twice as many slow down at first as recorded ones.
_LEADER_BRAKING_MPS2 = 0.3
#: Largest braking that a start may cause in a vehicle chosen before, m/s2. No tunable: what turns in lets traffic pass.
_MADE_TO_BRAKE_MPS2 = 1.2
#: Longest time that a vehicle waits astride of two lanes, s. No tunable.
_ASTRIDE_S = 1.0
#: Verdicts that another driver may change.
_ANOTHER_DRIVER = frozenset(
    {Reason.TTC_RECORDED_FOLLOWER, Reason.FOLLOWER_BRAKING, Reason.FOLLOWER_HEADWAY, Reason.LEAVES_TOO_EARLY}
)
#: Largest delay of SUMO behind a rollout at the end of an overtake, s. No tunable.
_SPARE_S = 0.2


class Site(NamedTuple):
    """Where a vehicle may begin, and at which step. s: m along the route's lanes; None: it has just come over the edge.

    leader: what it would follow where it enters later, as `Meetings` numbers them; headway_s: that recorded followers
    are left with, as `sustained_headway` has it.
    """

    offer: RouteOffer
    s: float | None
    step: int = 0
    leader: int = -1
    headway_s: float = FOLLOWER_HEADWAY_S


class Begin(NamedTuple):
    """What is known of a beginning before its driver: s, start_m: along the route's lanes and on the path, m.

    line_gap_m: from its front to the nearest closed line; wants: something of which it is to meet; gaining_share:
    how often such a vehicle begins while it gains speed: never over the map's edge or with a driver sought for a place.
    """

    request: VehicleRequest
    site: Site
    path: DrivenPath
    box: BoxSize
    s: float
    start_m: float
    line_gap_m: float
    sides: tuple[Side, ...] | None
    wants: Set[Situation]
    gaining_share: float


@dataclass(slots=True)
class Starts:
    """Starts of one round; each keeps clear of those that were taken before it.

    guard: with the vehicles kept in rounds before; `world` adds those taken to it by their rollouts; changers: of those
    kept, the ones that change lanes.
    """

    scene: Scene
    roads: Roads
    meetings: Meetings
    guard: InitVar[Guard]
    rng: np.random.Generator
    round_number: int
    changers: Sequence[ExportedVehicle] = ()
    taken: list[Start] = field(default_factory=list)
    refusals: Counter[Reason] = field(default_factory=Counter)
    world: World = field(init=False)
    _rolled: dict[Start, tuple[RolledOut, ...]] = field(default_factory=dict)

    def __post_init__(self, guard: Guard) -> None:
        """Nothing is chosen yet."""
        self.world = World(self.scene, self.roads, guard)

    def take(self, starts: list[Start]) -> list[Start]:
        """The same starts; those after them keep clear of them."""
        self.taken += starts
        if "collision" not in self.scene.config.without:
            for start in starts:  # with `request.sites = any` no rollout was kept
                rolled = self._rolled.pop(start, ()) or (self.world.rolled_out(start, (self.world.roll(start),)),)
                self.world.choose(*rolled)
        return starts

    def rolled(self, start: Start) -> tuple[RolledOut, ...]:
        """The rollout of a start that was made, and those anew of vehicles that it makes drive otherwise."""
        return self._rolled.get(start, ())

    def make(
        self, request: VehicleRequest, site: Site, *, driver: Driver | None = None, speed_mps: float | None = None,
        sides: tuple[Side, ...] | None = None, desired: FloatArray | None = None,
        wants: Set[Situation] = frozenset(),
    ) -> Start | Reason:  # fmt: skip
        """A vehicle that begins at a site, or why it cannot.

        driver, speed_mps, sides, desired: how it begins, where it looks for a lane, and its desired speeds (T,) m/s;
        drawn unless given; wants: something of which it is to meet, if anything.
        """
        scene, config, rng = self.scene, self.scene.config, self.rng
        offer, s, step, leader, headway_s = site
        box = clearance_box(request.size, DEFAULT_SIZES[request.object_type])
        half_m, run_on = box.length_m / 2, "topology" in config.without
        first_m = half_m + _FROM_EDGE_M
        if s is None:  # it has come over the edge since the step before
            s = first_m + float(rng.random()) * scene.usual_speed(offer.route[0]) * scene.step_s
        if s < first_m or (s + half_m > offer.length_m - _TO_EDGE_M and not run_on):
            return Reason.NO_SITE
        path = scene.paths.along(offer.route)
        start_m = path.to_line(s)
        if "collision" not in config.without:
            near = self.world.gaps_at(path, box, start_m, step)
            if not are_clear(near).all():
                return Reason.NO_SITE
            if near.lag_m[0] < (headway_s - LEADER_LENGTH_S) * near.lag_mps[0]:
                return Reason.FOLLOWER_HEADWAY
        lane_id = path.segment_at(start_m).lane_id
        if step == 0:
            leader = self.meetings.leader_of(scene.cell_at(path, start_m), offer.route)
        flow_mps = self.meetings.pace_of(leader) if config.request.sites == "promising" and driver is None else 0.0
        line_gap_m = self.world.guard.stop_lines.on(path, box).gap_m(start_m, step)
        gaining = 0.0 if driver is not None or site.s is None else _GAINING_SHARE
        begin = Begin(request, site._replace(leader=leader), path, box, s, start_m, line_gap_m, sides, wants, gaining)
        made: Start | Reason = Reason.NO_SITE
        for _ in range(1 if driver is not None else _DRIVERS):
            # a driver goes with the flow of its leader, or would not be there
            pace_mps = max(scene.lane_speed(lane_id, rng), flow_mps)
            made = self._begun(begin, driver or draw_driver(config, rng, lane_speed_mps=pace_mps), speed_mps, desired)
            if made not in _ANOTHER_DRIVER:
                break
        return made

    def _begun(
        self, begin: Begin, driver: Driver, speed_mps: float | None, desired: FloatArray | None
    ) -> Start | Reason:
        """The start of a driver at a site, at about its desired speed unless told; or what speaks against it."""
        scene, config, rng, request, path = self.scene, self.scene.config, self.rng, begin.request, begin.path
        step, is_given = begin.site.step, speed_mps is not None
        if LINE_GAP_M[0] <= begin.line_gap_m <= LINE_GAP_M[1]:  # it stands where it is
            driver = replace(driver, line_gap_m=begin.line_gap_m)
        if speed_mps is None:
            speed_mps = start_speed(driver, config, rng, gaining_share=begin.gaining_share)
        admitted = self._start_speed(self.world, begin, speed_mps, driver)
        if isinstance(admitted, Reason):
            return admitted
        if desired is None:
            desired = desired_speeds(
                driver, config, rng, num_steps=scene.num_steps - step, step_s=scene.step_s, at_least_mps=admitted
            )
        sides = BEHAVIOURS[request.policy].sides or SIDES
        order = sides if rng.random() < 0.5 else sides[::-1]
        start = Start(
            vehicle_id=f"v{request.number}_{self.round_number}", request=request, box=begin.box,
            route=begin.site.offer.route, path=path, start_m=begin.start_m, start_mps=admitted, driver=driver,
            desired=np.concatenate([np.full(step, desired[0]), desired]), offset=MIDDLE, sides=begin.sides or order,
            step=step, leader=begin.site.leader,
        )  # fmt: skip
        rolled = self._performed(self.world, start)
        if not is_given:  # one that is to overtake begins as that is foreseen
            start, rolled = self._eased(start, rolled)
        if isinstance(rolled, Reason):
            return rolled
        if start.start_mps < admitted:
            known = self.world.guard.known_on(path, begin.box)
            if _came_through(known, gaps_to_all(known, np.array([begin.start_m]), step), start.start_mps, step):
                return Reason.NO_SITE
        start = replace(start, situations=foreseen(self.world, start, rolled))
        if begin.wants and not begin.wants & start.situations:
            return Reason.OTHER_SITUATION
        usual = partial(scene.place_on, path)
        if BEHAVIOURS[request.policy].changes_lanes:  # the line of one lane is not that of the next
            usual = partial(np.full_like, fill_value=config.drivers.offset_mean_m)
        v = np.concatenate([one.v for one in rolled]) if rolled else np.array([driver.desired_mps])
        pace_mps = float(v @ v / v.sum())  # each metre weighs the same
        offset = lane_offset(driver, config, rng, length_m=path.line.length_m, pace_mps=pace_mps, usual=usual)
        start = replace(start, offset=offset)
        return self._harm_to_others(start, rolled, begin.site.headway_s) or start

    def _performed(self, world: World, start: Start) -> tuple[Rollout, ...] | Reason:
        """The rollout of a vehicle that does what it is asked for, and meets nothing; or why it does not.

        With `request.sites = any` it is rolled out for _HOLDS_S alone: no vehicle begins where it is met at once.
        """
        scene, config, policy = self.scene, self.scene.config, start.request.policy
        if "collision" in config.without:
            return _NOT_ROLLED_OUT
        if config.request.sites == "any":
            soon = (world.roll(start, last=start.step + scene.steps_in(_HOLDS_S)),)
            return world.rejection_reason(start, soon, ends=False) or _NOT_ROLLED_OUT
        if BEHAVIOURS[policy].changes_lanes:
            vehicle, parts = world.roll_manoeuvre(start)
            if len(vehicle.shifts) < (2 if policy is Policy.OVERTAKE else 1):
                return vehicle.reason or Reason.SCENE_ENDED
        else:
            vehicle, parts = None, (world.roll(start),)
        found = world.rejection_reason(start, parts)
        if found is not None:
            return found
        shown_m = min(float(parts[-1].s[-1]), parts[-1].path.exit_m - 0.5 * start.size.length_m)
        if vehicle is not None:
            if self._waits_astride(parts[-1]):
                return Reason.TOO_SLOW
            spare_m = _SPARE_S * parts[-1].v[-1] if policy is Policy.OVERTAKE else 0.0
            if shown_m < vehicle.path.lateral_spans[-1].end + spare_m:
                return Reason.SCENE_ENDED
        kind = BEHAVIOURS[policy].turn
        if kind is not None:
            turn = first_turn(scene.grid.graph, start.path, kind, after=start.start_m + _TURNED_M)
            if turn is None:
                return Reason.TURN_NOT_SEEN
            if shown_m < turn.end + _TURNED_M:
                lines, last = self.world.guard.stop_lines.on(start.path, start.box), scene.num_steps - 1
                room_m = lines.room_m(shown_m, last, start.driver)
                return Reason.WAITS_AT_LINE if room_m < turn.end - shown_m else Reason.SCENE_ENDED
        return parts

    def _waits_astride(self, part: Rollout) -> bool:
        """Whether a lateral motion waits for long on its way across, as the vehicle is too slow for it."""
        begin, end = np.searchsorted(part.s, part.path.lateral_spans[-1])
        slow = part.v[begin:end] < self.scene.config.lane_change.min_speed_mps
        return bool(slow.sum() > self.scene.steps_in(_ASTRIDE_S))

    def _eased(self, start: Start, rolled: tuple[Rollout, ...] | Reason) -> tuple[Start, tuple[Rollout, ...] | Reason]:
        """A start that does not brake hard at once, with its rollout: as slow as what its speed falls to allows."""
        for _ in range(_EASED_AT_MOST):
            if isinstance(rolled, Reason) or not rolled:
                break
            v, step = rolled[0].v, min(self.scene.steps_in(_BEGINS_S), rolled[0].v.size - 1)
            eased_mps = float(v[step]) + _EASED_TO_MPS2 * step * self.scene.step_s
            if eased_mps >= start.start_mps:
                break
            if eased_mps < SLOWEST_SHARE * start.driver.desired_mps <= start.start_mps:
                return start, Reason.NO_SITE
            start = replace(start, start_mps=eased_mps)
            rolled = self._performed(self.world, start)
        return start, rolled

    def _harm_to_others(self, start: Start, parts: tuple[Rollout, ...], headway_s: float) -> Reason | None:
        """Why others cannot go on with a candidate ahead of them: recorded ones, and those chosen before.

        None where these do what they are asked for all the same. What is rolled out is kept for `take`.
        """
        if parts == _NOT_ROLLED_OUT:
            return None
        candidate = self.world.rolled_out(start, parts)
        if self.world.meets_after(candidate):
            return Reason.TTC_AT_END
        harm = self.world.harm_to_followers(candidate, headway_s)
        if harm is not None:
            return harm
        if any(takes_gap(self.scene, one, candidate.traffic) for one in self.changers):
            return Reason.TAKES_GAP
        anew = [candidate]
        for one in self.world.to_roll_anew(candidate):
            around, begun = self.world.joined_by(candidate, without=one.start.vehicle_id), one.start
            if not are_clear(around.gaps_at(begun.path, begun.box, begun.start_m, begun.step)).all():
                return Reason.MEETS_GENERATED
            still = self._performed(around, begun)
            if isinstance(still, Reason):
                return Reason.MEETS_GENERATED
            if self._brakes_mps2(still) > max(_MADE_TO_BRAKE_MPS2, self._brakes_mps2(one.parts)):
                return Reason.MEETS_GENERATED
            if still:
                anew.append(around.rolled_out(begun, still))
        self._rolled[start] = tuple(anew)
        return None

    def _brakes_mps2(self, parts: tuple[Rollout, ...]) -> float:
        """How hard a vehicle brakes at most, in the mean over BRAKES_FOR_S, m/s2."""
        steps = self.scene.steps_in(BRAKES_FOR_S)
        lost = [float((one.v[:-steps] - one.v[steps:]).max(initial=0.0)) for one in parts]
        return max(lost, default=0.0) / (steps * self.scene.step_s)

    def _start_speed(self, world: World, begin: Begin, speed: float, driver: Driver) -> float | Reason:
        """Speed at which a driver that would drive at `speed` begins, m/s; or why it cannot begin there."""
        path, box, start_m, step = begin.path, begin.box, begin.start_m, begin.site.step
        limits = self.scene.config.limits
        if self.leaves_early(begin.site.offer, begin.s + box.length_m / 2, _KEPT_SHARE * speed, step):
            return Reason.LEAVES_TOO_EARLY
        ahead_m = _AHEAD_S * max(speed, driver.desired_mps)  # one that begins slowly gains speed
        reach = slice(int(start_m / TABLE_STEP_M), int((start_m + ahead_m) / TABLE_STEP_M) + 2)
        if np.abs(path.line.table_curvature[reach]).max(initial=0.0) > CURVATURE_KEPT / limits.min_radius_m:
            return Reason.LIMIT_CURVATURE
        road = self.roads.speeds(path, driver)
        road_mps = float(road[min(int(start_m / TABLE_STEP_M), road.size - 1)])
        speed = min(speed, road_mps)
        if "collision" in self.scene.config.without:
            return speed
        return self._admitted_speed(world, begin, speed, min(driver.desired_mps, road_mps), driver)

    def leaves_early(self, offer: RouteOffer, s: float, speed_mps: float, step: int = 0) -> bool:
        """Whether the map ends before the last observed step at a speed."""
        if "topology" in self.scene.config.without:
            return False
        return offer.length_m - s < speed_mps * self.scene.steps_to_stay(step) * self.scene.step_s

    def _admitted_speed(
        self, world: World, begin: Begin, speed: float, alone_mps: float, driver: Driver
    ) -> float | Reason:
        """Speed that leaders allow, m/s, at most the one told; or why none can begin. alone_mps: without leaders."""
        path, box, s, step = begin.path, begin.box, begin.start_m, begin.site.step
        conflict, known = self.scene.config.conflict, world.guard.known_on(path, box)
        seen = gaps_to_all(known, np.array([s]), step)
        leads = np.isfinite(seen.lead_m)
        speed = float(speed_behind(seen.lead_m[leads], seen.along_mps[leads], driver.following).min(initial=speed))
        closing = seen.along_mps[:, 0] - speed
        if (known.same_direction[:, step] & (seen.lag_m[:, 0] < conflict.follower_ttc_min_s * closing)).any():
            return Reason.TTC_RECORDED_FOLLOWER
        lines = world.guard.stop_lines.on(path, box)
        room_m = lines.room_m(s, step, driver)
        if room_m < 0.0:
            return Reason.ENTERS_ON_RED
        speed = min(speed, lines.towards_mps(driver, room_m))
        if step > 0 and (speed < STANDS_MPS or self._follower_is_near(world, begin, speed)):
            return Reason.NO_SITE
        if speed < max(STANDS_MPS, SLOWEST_SHARE * alone_mps):
            near = (seen.lead_m[:, 0] < QUEUE_M) & ~world.parked_on(path, box)
            queues = near & (seen.along_mps[:, 0] < SLOWEST_SHARE * alone_mps)
            if room_m > 0.0 and not queues.any():
                return Reason.NO_SITE  # no vehicle is so slow with so much room ahead, nor waits for a parked one
            if not queues.any() or seen.along_mps[queues, 0].min() < STANDS_MPS:  # else the queue moves
                speed = 0.0
        return Reason.NO_SITE if _came_through(known, seen, speed, step) else speed

    def _follower_is_near(self, world: World, begin: Begin, speed_mps: float) -> bool:
        """Whether an agent comes from behind, on the lane or before the map's edge."""
        config, box, step = self.scene.config, begin.box, begin.site.step
        here = self.scene.traffic.at(step).joined(world.guard.inserted_known.at(step))
        xy, forward, _ = begin.path.line.motion(np.array([begin.start_m]))
        seen = gaps_from_pose(xy, forward, box, here)
        least_m = np.maximum(CLEAR_GAP_M, config.conflict.follower_ttc_min_s * (seen.along_mps - speed_mps))
        near = (seen.aside_m < config.conflict.margin_lateral_m) & (seen.gap_m > -box.length_m)
        return bool(np.any(near & (seen.gap_m < least_m) & here.present[:, 0] & (seen.along_m < 0.0)))


def _came_through(known: PathOccupancy, seen: AllGaps, speed_mps: float, step: int) -> bool:
    """Whether a vehicle that begins at a speed was inside its leader or follower shortly before, by all speeds.

    seen: gaps from where it begins to those known on its path (R, 1), at that step.
    """
    nearer_m = _BEFORE_S * (seen.along_mps[:, 0] - speed_mps)
    through = (nearer_m > seen.lead_m[:, 0]) | (-nearer_m > seen.lag_m[:, 0])
    return bool((through & known.same_direction[:, step]).any())


def are_clear(near: Gaps) -> BoolArray:
    """(N,) whether vehicles may begin between those next to them, for where these are."""
    return np.minimum(near.lead_m, near.lag_m) >= CLEAR_GAP_M


def speed_behind(
    gap_m: FloatArray | float, leader_mps: FloatArray | float, following: tuple[FloatArray | float, ...]
) -> FloatArray:
    """Fastest speeds, m/s, to begin behind leaders: for these drivers brake by _LEADER_BRAKING_MPS2 (IDM).

    One that is faster leaves: a driver may be nearer to it. following: as `Driver.following`, of one or of each.
    """
    tau_s, accel, decel, min_gap_m = following
    room = np.sqrt(1.0 + _LEADER_BRAKING_MPS2 / accel) * np.maximum(gap_m, 0.0) - min_gap_m
    # v tau + v (v - v_l) / (2 sqrt(a b)) = room
    c = 2.0 * np.sqrt(accel * decel)
    b, room = tau_s * c - leader_mps, np.maximum(room, 0.0)
    return np.asarray(0.5 * (-b + np.sqrt(b * b + 4.0 * c * room)))
