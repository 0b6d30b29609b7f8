"""Vehicles for one scene, round after round: plan, drive, settle, until the count is reached or nothing more fits."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bridge.generation.records import outcomes
from bridge.sumo.replay import Replay, ReplayErrors, in_the_way, met_by
from bridge.sumo.simulation import Simulation
from bridge.sumo.steering import Driver, Steering
from hid2.agents import Policy, Track
from hid2.insertion.draws import Draws
from hid2.insertion.foresight import BEHIND_TURN_M
from hid2.insertion.places import Places
from hid2.insertion.spawning import Spawner
from hid2.motion.repair import SettledVehicle, settle, settle_as_planned, settled_traffic
from hid2.motion.route import first_turn
from hid2.occupancy.traffic import Traffic
from hid2.policy.turns import TURN_OF_POLICY
from hid2.scene import PlannedVehicle, World, predicted_traffic

_ATTEMPTS = 30
#: Fewer when places are gone through again; fewer still find as many turns, but not as many lane changes.
_ATTEMPTS_AGAIN = dict.fromkeys(Policy, 12) | {Policy.LANE_CHANGE: 20}
#: Times that all places are gone through again; these hang most on where, how fast and when they are tried.
_LOOKS_AGAIN = dict.fromkeys(Policy, 1) | {Policy.LANE_CHANGE: 5, Policy.RIGHT_TURN: 3}
_ATTEMPTS_LAST = 400
_LOOKS_MOST = 8  # for vehicles that go straight, as long as each finds one more
_ATTEMPTS_LATE = 10_000
_MAX_AGENTS = 400
#: How a road is packed: from an empty one, with the mix or with vehicles that go where there is room; or from the
#: fullest one so far, some of it anew.
_Way = Literal["mix", "no mix", "some anew"]
_FULL: tuple[_Way, ...] = ("mix", "some anew", "some anew", "no mix")
_OVERFULL: tuple[_Way, ...] = ("no mix", "some anew", "some anew", "some anew")
_NEARLY_FULL: tuple[_Way, ...] = ("some anew", "some anew", "some anew", "mix")
_TO_THE_END: tuple[_Way, ...] = ("no mix", "some anew")
_OFTENER = 8  # times as many attempts, where only a few are missing
_FEW_MOST = 4
_SPARE_LATER = 2
_NEARLY_SHARE = 0.85  # of the count: if fewer find a place, the road is packed at once
#: Of those that find a place with the usual gaps at all, so many do by the first and second look, at least; usually.
_BY_LOOK_LEAST, _BY_LOOK = (0.55, 0.8), (0.65, 0.9)
_TELLING = 10  # vehicles asked for: of fewer it is luck how many do
_FEW_SHARE = 0.1  # of the count: so few may still fit in between the others, with the gaps of a packed road
_PACKED_MORE = 1.5  # times as many as with the usual gaps find a place on a packed road that has the mix on it
_MIX_OF_MOST = 40


@dataclass(frozen=True, eq=False, slots=True)
class Settled:
    """A vehicle in the scene, with how SUMO drove it."""

    vehicle: SettledVehicle
    driver: Driver


class Rounds:
    """Rounds of planning, driving and settling until the count is reached or nothing more fits."""

    def __init__(self, world: World, simulation: Simulation, seed: list[int]) -> None:
        self.world, self.simulation, self.seed = world, simulation, seed
        self.draws = Draws(np.random.default_rng([*seed, 0]))
        self.settled: list[Settled] = []
        self.reasons: Counter[str] = Counter()
        self.unmet: list[tuple[Policy, str]] = []
        self.fixed: Traffic = predicted_traffic([], world.num_steps)
        self.replay_errors = ReplayErrors()
        self.sumo_version = simulation.version()
        self._next = 0
        self._found = 0  # places on a road with the usual gaps

    def fill(self) -> None:
        """All rounds; where they do not reach the count, more with closer gaps, then again from an empty road, packed.

        The count goes before the mix: a road that cannot hold both is packed without manoeuvres, if that holds more.
        Packing takes the same course whatever the count, so that no count ends below what `max` finds.
        """
        request = self.world.config.request
        target, mixed = (_MAX_AGENTS, _MIX_OF_MOST) if request.agents == "max" else (request.agents, request.agents)
        if request.agents != "max" or not self._packs:
            self._rounds(_mix(request.behaviours, mixed, self.draws), target, packed=False)
            if len(self.settled) == target or not self._packs:
                return
            if target - len(self.settled) <= _few(target):
                self.world = self.world.packed()
                self._rounds([], target, packed=True)
                if len(self.settled) == target:
                    return
        if len(self.settled) >= _NEARLY_SHARE * target:
            self._pack(target, _NEARLY_FULL)
        else:
            self._pack(target, _FULL if target <= _PACKED_MORE * self._found else _OVERFULL)

    @property
    def _packs(self) -> bool:
        """Whether a road that does not take the count is packed."""
        config = self.world.config
        return config.packing.attempts > 0 and "collision" not in config.without

    def _may_pack(self, places: Places) -> bool:
        return self._packs and not places.packed

    def _pack(self, target: int, ways: Sequence[_Way]) -> None:
        """Fill the road again and again, in one way after the other, and keep the fullest."""
        attempts, close = self.world.config.packing.attempts, self.world.packed()
        for attempt in range(_OFTENER * attempts):
            best = self.settled, self.fixed, self.unmet
            if attempt >= attempts and len(best[0]) < target - _few(target):
                return
            way = ways[attempt % len(ways)] if attempt < attempts else _TO_THE_END[attempt % len(_TO_THE_END)]
            self.draws, self.world = Draws(np.random.default_rng([*self.seed, attempt + 1])), close
            if way == "some anew":
                self._keep(self._all_but_a_few())
                self._rounds([], target, packed=True, more_than=len(best[0]))
            else:
                asked = _mix(close.config.request.behaviours, min(target, _MIX_OF_MOST), self.draws)
                unmet: list[tuple[Policy, str]] = [
                    (policy, "road_packed") for policy in asked if policy is not Policy.STRAIGHT
                ]
                self.unmet = [] if way == "mix" else unmet
                self._keep([])
                self._rounds(asked if way == "mix" else [], target, packed=True)
            if len(self.settled) < len(best[0]) or (len(self.settled) == len(best[0]) and way != "some anew"):
                self.settled, self.fixed, self.unmet = best
            if len(self.settled) >= target:
                return

    def _keep(self, settled: list[Settled]) -> None:
        self.settled = settled
        self.fixed = settled_traffic([item.vehicle for item in settled], self.world.num_steps)

    def _all_but_a_few(self) -> list[Settled]:
        """Without some neighbours that go straight: where those were, differently placed ones may be one more."""
        leaders = {item.driver.leader_id for item in self.settled}
        idle = [
            item for item in self.settled
            if item.vehicle.driven.spec.policy is Policy.STRAIGHT
            and item.vehicle.driven.spec.vehicle_id not in leaders
        ]  # fmt: skip
        if not idle:
            return self.settled
        start = np.array([item.vehicle.trajectory.position[0] for item in idle])
        middle = start[self.draws.index(len(idle))]
        near = np.argsort(np.hypot(*(start - middle).T), kind="stable")[: 1 + self.draws.index(_FEW_MOST)]
        gone = {id(idle[row]) for row in near.tolist()}
        return [item for item in self.settled if id(item) not in gone]

    def _rounds(self, mix: Sequence[Policy], target: int, *, packed: bool, more_than: int = -1) -> None:
        """Rounds until the count is reached; a manoeuvre that no round brought about is noted with its last reason."""
        pending: list[tuple[Policy, str]] = [
            (policy, "count_reached") for policy in mix if policy is not Policy.STRAIGHT
        ]
        places = Places(self.world, self.draws, packed)
        for number in range(self.world.config.spawn.rounds):
            missing = target - len(self.settled)
            if missing <= 0 and number > 0:
                break
            before = len(self.settled)
            patience = number + 2 if packed else number
            reseeds = number < self.world.config.spawn.reseed_rounds
            if number > max(self.world.config.spawn.reseed_rounds, 1):  # the count matters more by now
                self.unmet += pending
                pending = []
            asked = [policy for policy, _ in pending[:missing]]
            again, full = self._round(places, asked, missing, patience=patience, reseeds=reseeds, more_than=more_than)
            pending = again + pending[missing:]
            if number >= 1 and len(self.settled) == before and not asked:
                break
            if not packed and full and not again:
                break
        self.unmet += pending

    def _round(
        self, places: Places, asked: Sequence[Policy], missing: int, *, patience: int, reseeds: bool, more_than: int
    ) -> tuple[list[tuple[Policy, str]], bool]:
        """Plan, drive and settle; returns the manoeuvres that are to be tried again, with what went wrong.

        And whether the road is full: later rounds find no more places with the same gaps. What cannot end with more
        vehicles in the scene than more_than is not driven.
        """
        spawner, target = Spawner(places, self.fixed, patience), len(self.settled) + missing
        attempts = _ATTEMPTS_LATE if patience >= 2 or places.packed else _ATTEMPTS
        # manoeuvres need the room most, so they choose first; what finds no place looks again, with more patience
        order = sorted(asked, key=list(Policy).index, reverse=True)
        without = [policy for policy in order if not self._plan(spawner, policy, missing, attempts)]
        for look in range(max(_LOOKS_AGAIN.values()) if patience == 0 else 0):
            again = [policy for policy in without if look < _LOOKS_AGAIN[policy]]
            if again:
                spawner.look_again()
                for policy in again:
                    if self._plan(spawner, policy, missing, _ATTEMPTS_AGAIN[policy]):
                        without.remove(policy)
        spawner.patience = patience
        reached = len(spawner.planned) >= missing  # leaders of overtakes count too
        self.unmet += [(policy, "count_reached" if reached else spawner.why_none(policy)) for policy in without]
        self._fill_up(spawner, missing, attempts)
        self.reasons.update(spawner.reasons)
        if not places.packed:
            self._found = max(self._found, len(self.settled) + len(spawner.planned))
        # what manoeuvres keep free is known better once they are driven: with them there may be more room later
        full = len(spawner.planned) < missing and all(vehicle.claims is None for vehicle in spawner.planned)
        if not spawner.planned and self.replay_errors.states > 0:
            return [], full
        if len(self.settled) + len(spawner.planned) <= more_than:
            return [], True
        if self._may_pack(places) and not self.settled and len(spawner.planned) < _NEARLY_SHARE * target:
            return [], True  # not worth driving
        return self._drive(spawner, target, reseeds=reseeds), full

    def _fill_up(self, spawner: Spawner, missing: int, attempts: int) -> None:
        """Plan vehicles that go straight, in look after look as long as each finds one more."""
        # in a later round, few are missing and each has a hard time: one that fails would cost another round
        spare = missing + (_SPARE_LATER if self.settled else math.floor(self.world.config.spawn.spare_share * missing))
        patience, target, may_pack = spawner.patience, len(self.settled) + missing, self._may_pack(spawner.places)
        for look in range(_LOOKS_MOST):
            closer = attempts if look < 2 else max(attempts, _ATTEMPTS_LAST)  # a place found now saves a round
            before = len(spawner.planned)
            wanted = spare if look <= 1 else missing  # later on a spare one costs more than the round that it may save
            while len(spawner.planned) < wanted and self._plan(spawner, Policy.STRAIGHT, wanted, closer):
                pass
            # from patience 2 on, looking again only draws anew where, how fast and how large
            enough = 1 if patience >= 2 else 2
            if len(spawner.planned) >= missing or (look >= enough and len(spawner.planned) == before):
                break
            if may_pack:
                sofar, few = len(self.settled) + len(spawner.planned), missing - len(spawner.planned) <= _few(target)
                early = target >= _TELLING and look < len(_BY_LOOK)
                if early and sofar < _BY_LOOK_LEAST[look] * _NEARLY_SHARE * target:
                    self._found = max(self._found, math.floor(sofar / _BY_LOOK[look]))
                    break
                if look > 0 and few and spawner.world is not self.world.packed():
                    self.world = self.world.packed()  # what follows is driven with closer gaps, too
                    spawner.close_up(self.world)
            spawner.look_again()

    def _plan(self, spawner: Spawner, policy: Policy, missing: int, attempts: int) -> bool:
        room = missing - len(spawner.planned)
        if room <= 0:
            return False
        if policy is not Policy.OVERTAKE:
            return spawner.spawn(policy, self._new_id(), attempts=attempts) is not None
        leader_id = self._new_id() if room >= 2 and self.world.config.request.spawn_leaders else None
        return bool(spawner.spawn_overtake(self._new_id(), leader_id, attempts=attempts))

    def _drive(self, spawner: Spawner, target: int, *, reseeds: bool) -> list[tuple[Policy, str]]:
        """Drive and settle what was planned; returns the manoeuvres that did not come about, with the reason.

        reseeds: a vehicle that lives but did not do what it was placed for makes room for another one elsewhere.
        """
        world, simulation, first = self.world, self.simulation, self.replay_errors.states == 0
        simulation.rewind()
        way = in_the_way(world, spawner.planned)
        traffic = world.traffic if first else world.traffic.rows(np.flatnonzero(way).tolist())
        recorded = Replay(simulation, traffic, "r", checked=first, in_the_way=way if first else None)
        steering = Steering(world, simulation, self.fixed)
        drivers = steering.run(
            spawner.planned, [recorded, Replay(simulation, met_by(self.fixed, spawner.planned), "f", checked=False)]
        )
        if first:
            self.replay_errors = recorded.errors
        by_id = {driver.spec.vehicle_id: driver for driver in drivers}
        settled, failed = settle(world, steering.driven(), [item.vehicle for item in self.settled], self.fixed)
        failed += [(driver.spec, driver.objection) for driver in drivers if driver.objection is not None]
        settled, gone = self._without_conflicts(settled)
        failed += gone
        if reseeds:
            settled, missed = self._keep_what_was_asked(settled, by_id, spawner.led_by)
            failed += missed
        again: list[tuple[Policy, str]] = [
            (spec.policy, reason) for spec, reason in failed if spec.policy is not Policy.STRAIGHT
        ]
        surplus = len(self.settled) + len(settled) + (len(again) if reseeds else 0) - target
        if surplus > 0:  # the spare ones were not needed
            leaders = {driver.leader_id for driver in drivers}
            idle = [
                v for v in settled
                if v.driven.spec.policy is Policy.STRAIGHT and v.driven.spec.vehicle_id not in leaders
            ]  # fmt: skip
            dropped = {id(v) for v in idle[-surplus:]}
            settled = [v for v in settled if id(v) not in dropped]
        self.reasons.update(reason for _, reason in failed)
        self.settled += [Settled(vehicle, by_id[vehicle.driven.spec.vehicle_id]) for vehicle in settled]
        self.fixed = self.fixed.joined(settled_traffic(settled, world.num_steps))
        return again

    def _without_conflicts(
        self, settled: Sequence[SettledVehicle]
    ) -> tuple[list[SettledVehicle], list[tuple[PlannedVehicle, str]]]:
        """Without those that a reader of the positions would see below the critical TTC or PET, and with the reason.

        Where a vehicle of an earlier round gets there because of a new one, the new one goes. A new one may get out of
        it on the motion that was planned for it.
        """
        vehicles, gone = [*(item.vehicle for item in self.settled), *settled], []
        tried: set[str] = set()
        if not {"collision", "topology", "smoothing"} & self.world.config.without:
            while found := self._conflicts(vehicles):
                row, other, reason = found[-1]
                late = other if row < len(self.settled) and other is not None else row
                spec = vehicles[late].driven.spec
                if late >= len(self.settled) and spec.vehicle_id not in tried:
                    tried.add(spec.vehicle_id)
                    planned = settle_as_planned(
                        self.world, vehicles[late], [v for i, v in enumerate(vehicles) if i != late]
                    )
                    if planned is not None:
                        vehicles[late] = planned
                        continue
                vehicles.pop(late)
                gone.append((spec, reason))
                if late < len(self.settled):
                    self._keep([item for row, item in enumerate(self.settled) if row != late])
        return vehicles[len(self.settled) :], gone

    def _conflicts(self, vehicles: Sequence[SettledVehicle]) -> list[tuple[int, int | None, str]]:
        """Row of a vehicle, of the other one where that is generated too, and the reason."""
        tracks = [exported_track(vehicle, f"gen_{row}", 0) for row, vehicle in enumerate(vehicles)]
        leaving = [bool(vehicle.driven.path.shifts) for vehicle in vehicles]
        critical = self.world.config.conflict
        seen = self.world.recorded.with_generated(tracks)
        followed = seen.followed_conflicts(critical_s=critical.follower_ttc_min_s)
        following = seen.following_conflicts(leaving, critical_s=critical.ttc_min_s)
        crossing = seen.crossing_conflicts(critical_s=critical.pet_min_s)
        return [
            *((row, None, "ttc_of_recorded") for row in followed),
            *((*pair, "ttc_on_lane") for pair in following),
            *((*pair, "pet") for pair in crossing),
        ]

    def _keep_what_was_asked(
        self, settled: Sequence[SettledVehicle], drivers: Mapping[str, Driver], led_by: Mapping[str, str]
    ) -> tuple[list[SettledVehicle], list[tuple[PlannedVehicle, str]]]:
        """Vehicles that did what they were placed for; and the others, with the leaders that they brought along."""
        traffic = self.world.traffic.joined(self.fixed).joined(settled_traffic(settled, self.world.num_steps))
        missed: dict[str, str] = {}
        for vehicle in settled:
            spec = vehicle.driven.spec
            for record in outcomes(vehicle, drivers[spec.vehicle_id], self.world, traffic):
                if record.status != "done" and record.status != "not_triggered":
                    missed[spec.vehicle_id] = f"{record.kind}_{record.reason}"
                    if spec.vehicle_id in led_by:
                        missed.setdefault(led_by[spec.vehicle_id], "led_no_overtake")
        kept = [vehicle for vehicle in settled if vehicle.driven.spec.vehicle_id not in missed]
        specs = {vehicle.driven.spec.vehicle_id: vehicle.driven.spec for vehicle in settled}
        return kept, [(specs[vehicle_id], reason) for vehicle_id, reason in missed.items() if vehicle_id in specs]

    def credit_turns(self) -> None:
        """A turn that found no place of its own is met by a vehicle that was placed to go straight and turns so."""
        unmet: list[tuple[Policy, str]] = []
        for policy, reason in self.unmet:
            row = next((row for row, item in enumerate(self.settled) if self._turned(item.vehicle, policy)), None)
            if row is None:
                unmet.append((policy, reason))
                continue
            vehicle, driver = self.settled[row].vehicle, self.settled[row].driver
            driven = replace(vehicle.driven, spec=replace(vehicle.driven.spec, policy=policy))
            self.settled[row] = Settled(replace(vehicle, driven=driven), driver)
        self.unmet = unmet

    def _turned(self, vehicle: SettledVehicle, policy: Policy) -> bool:
        """Whether a vehicle without a manoeuvre has driven the turn of a policy from its start to its end."""
        spec = vehicle.driven.spec
        if policy not in TURN_OF_POLICY or spec.policy is not Policy.STRAIGHT:
            return False
        turn = first_turn(self.world.grid.graph, vehicle.driven.path, TURN_OF_POLICY[policy], after=spec.s0)
        return turn is not None and turn.end + BEHIND_TURN_M < float(vehicle.motion.s[-1])

    def _new_id(self) -> str:
        self._next += 1
        return f"v{self._next}"


def _few(count: int) -> int:
    """So many of a count may still fit in between the others."""
    return math.ceil(_FEW_SHARE * count)


def _mix(shares: Mapping[Policy, float], count: int, draws: Draws) -> list[Policy]:
    """Policies of `count` vehicles by largest remainder: the mix asked for, not a draw from it."""
    total = sum(shares.values())
    exact = {policy: count * share / total for policy, share in shares.items()}
    counts = {policy: int(value) for policy, value in exact.items()}
    rest = sorted(exact, key=lambda p: (counts[p] - exact[p], list(Policy).index(p)))
    for policy in rest[: count - sum(counts.values())]:
        counts[policy] += 1
    mixed = [policy for policy in Policy for _ in range(counts[policy])]
    return [mixed[i] for i in draws.permutation(len(mixed))]


def exported_track(vehicle: SettledVehicle, track_id: str, category: int) -> Track:
    """A settled vehicle as a track of the scene, of its own size."""
    trajectory = vehicle.trajectory
    return Track(
        track_id=track_id,
        object_type=vehicle.driven.spec.object_type,
        category=category,
        timesteps=np.arange(vehicle.num_steps, dtype=np.int64),
        position=trajectory.position,
        heading=trajectory.heading,
        velocity=trajectory.velocity,
        size=vehicle.driven.spec.own_size,
    )
