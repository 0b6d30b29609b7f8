"""Routes from every lane, with what they offer: turns, lanes beside, and how far they go."""

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hid2.agents import IntArray, Policy
from hid2.motion.route import Route, is_drivable, routes_from, with_run_up
from hid2.occupancy.sigma import FREE
from hid2.occupancy.traffic import BoolArray
from hid2.once import once
from hid2.policy.behaviours import BEHAVIOURS
from hid2.policy.observation import admissible_neighbor
from hid2.policy.overtake import stretch_m
from hid2.scene import Scene
from netconvert.lane_graph import SIDES, Side, TurnType

#: Routes known from a lane, at most. Not a parameter, it saves time.
_MOST = 16
#: Length of a route's run-up to its lane, on which followers are seen, m. Not a parameter, it saves time.
_RUN_UP_M = 40.0


@dataclass(frozen=True, slots=True)
class Beside:
    """A stretch of a route with a lane beside that may be changed to: arc lengths on the route, m.

    remaining_m: length of that lane from the start of the stretch to where it ends for good.
    """

    side: Side
    start: float
    end: float
    remaining_m: float


@dataclass(frozen=True, slots=True)
class RouteOffer:
    """A route with its run-up: start_m, where its lane begins; turns (type, start, end) m; junctions (start, end) m."""

    route: Route
    start_m: float
    length_m: float
    turns: tuple[tuple[TurnType, float, float], ...]
    beside: tuple[Beside, ...]
    junctions: tuple[tuple[float, float], ...]

    def next_turn(self, kind: TurnType, s: float = 0.0) -> tuple[float, float]:
        """Where the next turn, if of a kind, begins and ends, m; inf where not, or where none is seen: the map ends."""
        turn, begin, end = next((one for one in self.turns if one[2] > s), (None, np.inf, np.inf))
        return (begin, end) if turn is kind and end < self.length_m else (np.inf, np.inf)

    def meets_junction(self, begin: float, end: float) -> bool:
        """Whether a stretch, m along the lanes, touches an intersection."""
        return any(at < end and begin < to for at, to in self.junctions)


@dataclass(frozen=True, eq=False)
class Routes:
    """Routes of a scene's map."""

    scene: Scene

    @cached_property
    def lanes(self) -> tuple[int, ...]:
        """Lanes that cars drive on."""
        graph = self.scene.grid.graph
        return tuple(n for n in graph.lanes if is_drivable(graph, n))

    @once
    def offers(self, lane_id: int) -> tuple[RouteOffer, ...]:
        """All routes from a lane on, in the order of the map."""
        if "topology" in self.scene.config.without:
            return (self.offer_of((lane_id,)),)
        graph, needed_m = self.scene.grid.graph, self.scene.paths.needed_m
        found = routes_from(graph, lane_id, choose=lambda _, on: tuple(sorted(on)), most=_MOST, needed_m=needed_m)
        return tuple(self.offer_of(with_run_up(graph, route, _RUN_UP_M), lane_id) for route in found)

    @once
    def map_offers(self, policy: Policy) -> bool:
        """Whether the map has any place at all for a policy, occupied or not; the rule of `hid2 scan` too."""
        return any(self.lane_offers(lane_id, policy) for lane_id in self.lanes)

    def lane_offers(self, lane_id: int, policy: Policy) -> bool:
        """Whether some route from a lane has a place for a policy."""
        if policy is Policy.STRAIGHT:
            return True
        kind = BEHAVIOURS[policy].turn
        if kind is not None:
            return any(offer.next_turn(kind)[1] < np.inf for offer in self.offers(lane_id))
        if policy is Policy.OVERTAKE:
            return any(self.together(offer, side) is not None for offer in self.offers(lane_id) for side in SIDES)
        needed_m = self.scene.config.lane_change.min_remaining_m
        beside = (one for offer in self.offers(lane_id) for one in offer.beside)
        return any(one.remaining_m > needed_m and one.side in BEHAVIOURS[policy].sides for one in beside)

    def together(self, offer: RouteOffer, side: Side) -> tuple[float, float] | None:
        """First stretch of a route, m along its lanes, with a lane beside that lasts for an overtake; None without."""
        graph, needed_m, at, begin = self.scene.grid.graph, stretch_m(self.scene.config), 0.0, 0.0
        before: int | None = None
        for lane_id in offer.route:
            beside = self._lane_to_pass_on(lane_id, side) if at > offer.start_m - 1e-6 else None
            if beside is None or before is None or beside not in graph.successors(before):
                if at - begin > needed_m and before is not None:
                    return begin, at
                begin = at
            before, at = beside, at + graph.lanes[lane_id].length_m
        return (begin, at) if before is not None and at - begin > needed_m else None

    @once
    def _lane_to_pass_on(self, lane_id: int, side: Side) -> int | None:
        """The lane beside that may be changed to, and back from, where neither of the two turns; None without."""
        lanes, beside = self.scene.grid.graph.lanes, self._beside(lane_id).get(side)
        if beside is None or ("left" if side == "right" else "right") not in self._beside(beside):
            return None
        return beside if lanes[lane_id].turn is lanes[beside].turn is TurnType.STRAIGHT else None

    @cached_property
    def ways_past(self) -> list[tuple[RouteOffer, int, Side]]:
        """Routes, the lanes they begin on, and the side of a lane beside that lasts for an overtake."""
        return [
            (offer, lane_id, side)
            for lane_id in self.lanes
            for offer in self.offers(lane_id)
            for side in SIDES
            if self.together(offer, side) is not None
        ]

    @once
    def free_cells(self, policy: Policy) -> tuple[IntArray, BoolArray]:
        """Rows of the grid's cells on lanes with a place for a policy that no recorded agent holds at step 0.

        And whether each is in an intersection.
        """
        grid, lanes = self.scene.grid, self.scene.grid.graph.lanes
        usable = {n for n in self.lanes if self.lane_offers(n, policy)}
        free = (self.scene.occupancy.sigma[0] == FREE).tolist()
        rows = [row for row, cell in enumerate(grid.cells) if free[row] and cell.lane_id in usable]
        inside = [lanes[grid.cells[row].lane_id].is_intersection for row in rows]
        return np.array(rows, dtype=np.int64), np.array(inside, dtype=np.bool_)

    def offer_of(self, route: Route, lane_id: int | None = None) -> RouteOffer:
        """What a route offers from a lane on, the first one unless told; those before it are the run-up."""
        lanes, first = self.scene.grid.graph.lanes, 0 if lane_id is None else route.index(lane_id)
        ends = list(itertools.accumulate(lanes[n].length_m for n in route))
        starts, rows = [0.0, *ends[:-1]], range(first, len(route))
        turns = tuple(
            (lanes[route[row]].turn, starts[row], ends[row])
            for row in rows
            if row > 0 and lanes[route[row]].turn is not TurnType.STRAIGHT
        )
        beside = tuple(
            Beside(side, starts[row], ends[row], self._beside_m(route[row:], lane))
            for row in rows
            for side, lane in self._beside(route[row]).items()
        )
        junctions = tuple((at, to) for n, at, to in zip(route, starts, ends, strict=True) if lanes[n].is_intersection)
        return RouteOffer(route, starts[first], ends[-1], turns, beside, junctions)

    @once
    def _beside(self, lane_id: int) -> dict[Side, int]:
        """The lanes beside that may be changed to."""
        return {side: n for side in SIDES if (n := admissible_neighbor(self.scene, lane_id, side)) is not None}

    @once
    def _beside_m(self, own: Route, lane_id: int) -> float:
        """Length of the way on a lane beside an own route, from the start of that lane on, m."""
        route = self.scene.paths.route_beside(own, lane_id)
        return sum(self.scene.grid.graph.lanes[n].length_m for n in route[route.index(lane_id) :])
