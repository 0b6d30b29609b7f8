"""Paths on which events may come about: routes over a lane, with everybody on them and what the road allows there."""

from dataclasses import dataclass, field, replace

import numpy as np

from hid2.agents import BoxSize, FloatArray
from hid2.drivers.driver import Driver
from hid2.insertion.event_motions import Along
from hid2.insertion.event_targets import Target
from hid2.insertion.routes import Routes
from hid2.motion.route import ROUTE_LONGEST_M, Route, routes_from
from hid2.occupancy.along_path import PathOccupancy, look_along
from hid2.occupancy.traffic import Traffic
from hid2.policy.roads import Roads
from hid2.scene import Scene
from netconvert.lane_graph import TurnType


@dataclass(slots=True)
class EventPaths:
    """Paths of one scene for a vehicle; box: what is kept clear for it; fixed: vehicles that are kept.

    What is found out is kept.
    """

    scene: Scene
    routes: Routes
    roads: Roads
    box: BoxSize
    fixed: Traffic
    _over: dict[tuple[int, tuple[int, ...]], list[Route]] = field(default_factory=dict)
    _caps: dict[tuple[Route, float], FloatArray] = field(default_factory=dict)
    _taken: dict[Route, PathOccupancy] = field(default_factory=dict)

    def over(self, lane_id: int, ahead: tuple[int, ...] = (), before: tuple[int, ...] = ()) -> list[Route]:
        """Routes over a lane: on along the lanes ahead where they can, else straight on; back to the map's edge.

        First those that come along the lanes before.
        """
        key = lane_id, (*ahead, -1, *before)
        if key not in self._over:
            self._over[key] = self._routes_over(lane_id, ahead, before) if self.routes.usable(lane_id) else []
        return self._over[key]

    def along(self, route: Route, target: Target | None, desired_mps: float, *, from_m: float = 0.0) -> Along:
        """A route's path with everybody on it: recorded vehicles and those kept. from_m: as in `Along`."""
        path = self.scene.path(route)
        if route not in self._taken:
            taken = self.scene.kept_clear_on(path, self.box)
            if self.fixed.ids:
                width_m = self.box.width_m + 2 * self.scene.config.conflict.margin_lateral_m
                more = look_along(path.line, self.fixed, self.box.length_m, width_m)
                taken = taken.joined(replace(more, agents=np.full(more.agents.size, -1)))  # none of them is a target
            self._taken[route] = taken
        taken = self._taken[route]
        own = np.isin(taken.agents, [] if target is None else [target.row])
        return Along(self._cap(route, desired_mps), taken, own, path.exit_s, from_m)

    def _cap(self, route: Route, desired_mps: float) -> FloatArray:
        """(S,) m/s, what the road lets a vehicle drive at most at the table of its path."""
        key = route, desired_mps
        if key not in self._caps:
            config = self.scene.config
            driver = Driver(
                desired_mps=desired_mps, tau_s=1.0, accel_mps2=config.event_search.speeds_up_mps2,
                decel_mps2=config.event_search.slows_mps2, min_gap_m=2.0,
                turn_lateral_mps2=config.drivers.turn_lateral_max_mps2, offset_m=0.0,
                lane_change_s=config.event_search.change_s,
            )  # fmt: skip
            self._caps[key] = np.minimum(self.roads.speeds(self.scene.path(route), driver), desired_mps)
        return self._caps[key]

    def _routes_over(self, lane_id: int, ahead: tuple[int, ...], before: tuple[int, ...]) -> list[Route]:
        graph, lanes = self.scene.grid.graph, self.scene.grid.graph.lanes

        def choose(onward: tuple[int, ...]) -> tuple[int, ...]:
            return tuple(sorted(onward, key=lambda n: (n not in ahead, lanes[n].turn is not TurnType.STRAIGHT, n)))

        onward = routes_from(
            graph, lane_id, choose=choose, usable=self.routes.usable, most=1, longest_m=ROUTE_LONGEST_M
        )
        found: list[Route] = []
        open_: list[tuple[Route, float]] = [(next(onward, (lane_id,)), 0.0)]
        while open_ and len(found) < self.scene.config.event_search.routes:
            route, back_m = open_.pop()
            back = [n for n in graph.predecessors(route[0]) if self.routes.usable(n) and n not in route]
            if not back or back_m > 0.5 * ROUTE_LONGEST_M:
                found.append(route)
                continue
            back.sort(key=lambda n: (n in before, lanes[n].turn is TurnType.STRAIGHT, -n))  # the best one last
            open_.extend(((n, *route), back_m + lanes[n].length_m) for n in back)
        return found
