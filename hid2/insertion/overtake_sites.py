"""Sites of overtakes: where one fits into the recorded traffic, and a slow vehicle ahead where there is none."""

from dataclasses import dataclass, field, replace

import numpy as np

from hid2.agents import DEFAULT_SIZES, Policy
from hid2.drivers.driver import Driver, draw_driver
from hid2.insertion.overtakes import ForeseenOvertake, Overtakes, Way
from hid2.insertion.routes import RouteOffer
from hid2.insertion.starts import Starts
from hid2.insertion.surroundings import Surroundings
from hid2.occupancy.gaps import gaps_on_path
from hid2.policy.rules import expected_reason
from hid2.reasons import Reason
from hid2.scene import clearance_box
from hid2.vehicle import Start, VehicleRequest


@dataclass(slots=True)
class OvertakeSites:
    """Sites of the overtakes of one round."""

    here: Surroundings
    starts: Starts
    foresees_none: bool = False
    """Whether the overtake looked for last fits nowhere into the recorded traffic."""
    _foresight: Overtakes = field(init=False)

    def __post_init__(self) -> None:
        """One for all requests of a round: what is known on a way is looked up once."""
        usual = DEFAULT_SIZES["vehicle"]
        self._foresight = Overtakes(
            self.here.scene, self.here.routes, self.here.roads, self.starts.guard, clearance_box(usual, usual)
        )

    def foreseen(self, request: VehicleRequest, slow_leader: VehicleRequest | None) -> list[Start]:
        """A start where an overtake from the trigger on fits into what is known, and its leader where one is added."""
        scene, rng, config = self.here.scene, self.starts.rng, self.here.scene.config
        adds = slow_leader is not None and config.request.spawn_leaders
        others = [start for start in self.starts.taken if start.request.policy is Policy.OVERTAKE]
        others_on = {lane for start in others for lane in start.route}
        ways = [way for way in self.here.routes.ways_past() if others_on.isdisjoint(way[0].route)]
        tried, self.foresees_none = 0, True
        for place in rng.permutation(len(ways)).tolist():
            if tried == config.sites.overtake_ways:
                break
            drivers = [
                draw_driver(config, rng, lane_speed_mps=scene.lane_speed(ways[place][1], rng))
                for _ in range(config.sites.drivers)
            ]
            driver = max(drivers, key=lambda one: one.desired_mps)  # who overtakes is in a hurry
            way = self._foresight.way(
                *ways[place], reach_m=driver.desired_mps * (request.trigger_s + config.foresight.waits_s)
            )
            if way is None:
                continue
            refused = expected_reason(driver, config.lane_change, speed_mps=driver.desired_mps)
            if refused is not None:
                self.starts.rejected[refused] += 1
                continue
            tried += 1
            found = self._foresight.foresee(way, driver, rng, trigger_s=request.trigger_s, lead=adds)
            if not found:
                self.starts.rejected[Reason.NO_OVERTAKE_FORESEEN] += 1
                continue
            self.foresees_none = False
            for one in found[: config.sites.drivers]:
                starts = self._starts(request, slow_leader, way, one, driver)
                if starts:
                    return starts
        return []

    def _starts(
        self, request: VehicleRequest, slow_leader: VehicleRequest | None, way: Way, seen: ForeseenOvertake,
        driver: Driver,
    ) -> list[Start]:  # fmt: skip
        """The vehicle and, where it is added, its leader, ahead of it; empty where they cannot begin so."""
        raw = way.path.to_raw(seen.start_s)
        found = self.starts.make(request, way.offer, way.lane_id, raw, driver=driver, speed_mps=seen.start_mps)
        if not isinstance(found, Start):
            self.starts.rejected[found] += 1
            return []
        found = replace(found, sides=(way.side,))
        if seen.leader_s is None:
            return [found]
        assert slow_leader is not None
        leader = self.slow_leader(found, slow_leader, seen.leader_s, seen.leader_mps)
        return [] if leader is None else [leader, found]

    def has_slower_leader(self, start: Start) -> bool:
        """Whether the recorded vehicle ahead of a start is near enough, and slower than its driver wants to be."""
        scene, overtake, sites = self.here.scene, self.here.scene.config.overtake, self.here.scene.config.sites
        seen = scene.recorded_on(start.path, start.box)
        vehicles = seen.same_direction & np.isin(seen.agents, scene.vehicle_rows)[:, None]
        found = gaps_on_path(seen, np.array([start.start_s]), 0, among=vehicles)
        near_m = overtake.d_obs_m + sites.leader_beyond_m
        most_mps = start.driver.desired_mps - sites.leader_advantage_ratio * overtake.speed_advantage_mps
        return bool(found.lead_m[0] < near_m and overtake.parked_mps < found.lead_mps[0] < most_mps)

    def slow_place(self, start: Start) -> tuple[float, float]:
        """Where a slow vehicle begins that is caught up with at the trigger, m on the path, and its speed, m/s."""
        sites = self.here.scene.config.sites
        share = float(self.starts.rng.uniform(sites.slow_leader_min, sites.slow_leader_max))
        slow_mps = max(sites.slow_leader_mps, share * start.driver.desired_mps)
        s = start.start_s + start.box.length_m + sites.slow_leader_gap_m + sites.slow_leader_gap_s * start.start_mps
        return s + max(0.0, (start.start_mps - slow_mps) * start.request.trigger_s), slow_mps

    def slow_leader(self, start: Start, request: VehicleRequest, s: float, slow_mps: float) -> Start | None:
        """A slow vehicle at a place ahead, m, of one that is to overtake; None where it cannot begin there."""
        base = draw_driver(self.here.scene.config, self.starts.rng, lane_speed_mps=start.driver.desired_mps)
        slow = replace(base, desired_mps=slow_mps)
        raw = start.path.to_raw(s)
        lanes, begin = self.here.scene.grid.graph.lanes, 0.0
        for lane_id in start.route:
            if raw < begin + lanes[lane_id].length_m:
                break
            begin += lanes[lane_id].length_m
        offer = RouteOffer(start.route, begin, start.path.to_raw(start.path.line.length_m), (), ())
        found = self.starts.make(request, offer, lane_id, raw, driver=slow, speed_mps=slow_mps)
        if not isinstance(found, Start) or abs(found.path.line.length_m - start.path.line.length_m) > 0.1:
            return None
        return found
