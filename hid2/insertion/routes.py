"""Routes from every lane, with what they offer: turns, lanes beside, and how far they go."""

import itertools
from dataclasses import dataclass, field

import numpy as np

from hid2.agents import IntArray, Policy
from hid2.motion.route import ROUTE_LONGEST_M, Route, routes_from
from hid2.occupancy.sigma import FREE
from hid2.occupancy.traffic import BoolArray
from hid2.policy.behaviours import BEHAVIOURS, TURN_OF_POLICY
from hid2.policy.decision import Side
from hid2.policy.observation import admissible_neighbor
from hid2.policy.overtake import stretch_m
from hid2.scene import DRIVABLE_TYPES, Scene
from netconvert.lane_graph import LaneGraph, TurnType

#: Not parameters, they save time: routes known from a lane, and m of a route before it, where followers are seen.
_MOST, _RUN_UP_M = 16, 40.0

_SIDES: tuple[Side, ...] = ("left", "right")


@dataclass(frozen=True, slots=True)
class Beside:
    """A stretch of a route with a lane beside that may be changed to: arc lengths on the route, m.

    remaining_m: length of that lane from the start of the stretch to where it ends for good.
    """

    side: Side
    start: float
    end: float
    remaining_m: float
    in_intersection: bool


@dataclass(frozen=True, slots=True)
class RouteOffer:
    """A route with its run-up: start_m, where the lane that it is for begins; turns: (type, start, end) m."""

    route: Route
    start_m: float
    length_m: float
    turns: tuple[tuple[TurnType, float, float], ...]
    beside: tuple[Beside, ...]


def lane_to_pass_on(graph: LaneGraph, lane_id: int, side: Side) -> int | None:
    """The lane beside that may be changed to, and back from, where neither of the two turns; None without."""
    neighbor = graph.neighbor(lane_id, side)
    if neighbor is None or graph.lanes[neighbor].lane_type not in DRIVABLE_TYPES:
        return None
    if any(graph.lanes[one].turn is not TurnType.STRAIGHT for one in (lane_id, neighbor)):
        return None
    back: Side = "left" if side == "right" else "right"
    return neighbor if graph.may_change(lane_id, side) and graph.may_change(neighbor, back) else None


@dataclass(slots=True)
class Routes:
    """Routes of a scene's map; what is found out is kept."""

    scene: Scene
    lanes: tuple[int, ...] = field(init=False)
    _offers: dict[int, tuple[RouteOffer, ...]] = field(default_factory=dict)
    _beside: dict[tuple[Route, int], float] = field(default_factory=dict)
    _ways_past: list[tuple[RouteOffer, int, Side]] | None = None
    _free: dict[Policy, tuple[IntArray, BoolArray]] = field(default_factory=dict)
    _admissible: dict[tuple[int, Side], int | None] = field(default_factory=dict)
    _to_pass_on: dict[tuple[int, Side], int | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Lanes that cars drive on."""
        graph = self.scene.grid.graph
        self.lanes = tuple(n for n, lane in graph.lanes.items() if lane.lane_type in DRIVABLE_TYPES)

    def usable(self, lane_id: int) -> bool:
        """Whether cars drive on a lane."""
        return self.scene.grid.graph.lanes[lane_id].lane_type in DRIVABLE_TYPES

    def offers(self, lane_id: int) -> tuple[RouteOffer, ...]:
        """All routes from a lane on, in the order of the map."""
        if lane_id not in self._offers:
            graph = self.scene.grid.graph
            if "topology" in self.scene.config.without:
                found: list[Route] = [(lane_id,)]
            else:
                found = list(
                    routes_from(
                        graph,
                        lane_id,
                        choose=lambda onward: tuple(sorted(onward)),
                        usable=self.usable,
                        most=_MOST,
                        longest_m=ROUTE_LONGEST_M,
                    )
                )
            before = self._run_up(lane_id)
            self._offers[lane_id] = tuple(
                self._offer(tuple(n for n in before if n not in route), route) for route in found
            )
        return self._offers[lane_id]

    def map_offers(self, policy: Policy) -> bool:
        """Whether the map has any place at all for a policy, occupied or not; the rule of `hid2 scan` too."""
        return any(self.lane_offers(lane_id, policy) for lane_id in self.lanes)

    def lane_offers(self, lane_id: int, policy: Policy) -> bool:
        """Whether some route from a lane has a place for a policy."""
        if policy is Policy.STRAIGHT:
            return True
        if policy in TURN_OF_POLICY:
            kind = TURN_OF_POLICY[policy]
            return any(offer.turns and offer.turns[0][0] is kind for offer in self.offers(lane_id))
        if policy is Policy.OVERTAKE:
            return any(self.together(offer, side) is not None for offer in self.offers(lane_id) for side in _SIDES)
        needed_m = self.scene.config.lane_change.min_remaining_m
        beside = (one for offer in self.offers(lane_id) for one in offer.beside)
        return any(one.remaining_m > needed_m and one.side in BEHAVIOURS[policy].sides for one in beside)

    def together(self, offer: RouteOffer, side: Side) -> tuple[float, float] | None:
        """First stretch of a route, m along its lanes, with a lane beside that lasts for an overtake; None without."""
        graph, lanes, without = self.scene.grid.graph, self.scene.grid.graph.lanes, self.scene.config.without
        needed_m, at, begin = stretch_m(self.scene.config), 0.0, 0.0
        before: int | None = None
        for lane_id in offer.route:
            beside = None
            if at > offer.start_m - 1e-6 and "topology" not in without:
                key = lane_id, side
                if key not in self._to_pass_on:
                    self._to_pass_on[key] = lane_to_pass_on(graph, lane_id, side)
                beside = self._to_pass_on[key]
            if beside is None or before is None or beside not in graph.successors(before):
                if at - begin > needed_m and before is not None:
                    return begin, at
                begin = at
            before, at = beside, at + lanes[lane_id].length_m
        return (begin, at) if before is not None and at - begin > needed_m else None

    def ways_past(self) -> list[tuple[RouteOffer, int, Side]]:
        """Routes, the lanes they begin on, and the side of a lane beside that lasts for an overtake."""
        if self._ways_past is None:
            self._ways_past = [
                (offer, lane_id, side)
                for lane_id in self.lanes
                for offer in self.offers(lane_id)
                for side in _SIDES
                if self.together(offer, side) is not None
            ]
        return self._ways_past

    def free_cells(self, policy: Policy) -> tuple[IntArray, BoolArray]:
        """Rows of the grid's cells on lanes with a place for a policy that no recorded agent holds at step 0.

        And whether each is in an intersection.
        """
        if policy not in self._free:
            grid, lanes = self.scene.grid, self.scene.grid.graph.lanes
            usable = {n for n in self.lanes if self.lane_offers(n, policy)}
            free = (self.scene.occupancy.sigma[0] == FREE).tolist()
            rows = [row for row, cell in enumerate(grid.cells) if free[row] and cell.lane_id in usable]
            inside = [lanes[grid.cells[row].lane_id].is_intersection for row in rows]
            self._free[policy] = np.array(rows, dtype=np.int64), np.array(inside, dtype=np.bool_)
        return self._free[policy]

    def offer_of(self, route: Route) -> RouteOffer:
        """What a route offers from its beginning on."""
        return self._offer((), route)

    def _offer(self, before: Route, route: Route) -> RouteOffer:
        lanes = self.scene.grid.graph.lanes
        whole = (*before, *route)
        ends = list(itertools.accumulate(lanes[n].length_m for n in whole))
        starts = [0.0, *ends[:-1]]
        rows = range(len(before), len(whole))
        turns = tuple(
            (lanes[whole[row]].turn, starts[row], ends[row])
            for row in rows
            if row > 0 and lanes[whole[row]].turn is not TurnType.STRAIGHT
        )
        beside = tuple(
            Beside(side, starts[row], ends[row], self._beside_m(whole[row:], lane), lanes[whole[row]].is_intersection)
            for row in rows
            for side in _SIDES
            if (lane := self._neighbor(whole[row], side)) is not None
        )
        return RouteOffer(whole, starts[len(before)], ends[-1], turns, beside)

    def _neighbor(self, lane_id: int, side: Side) -> int | None:
        key = lane_id, side
        if key not in self._admissible:
            self._admissible[key] = admissible_neighbor(self.scene, lane_id, side)
        return self._admissible[key]

    def _beside_m(self, own: Route, lane_id: int) -> float:
        """Length of the way on a lane beside an own route, from the start of that lane on, m."""
        key = own, lane_id
        if key not in self._beside:
            graph = self.scene.grid.graph
            route = self.scene.route_beside(own, lane_id)
            ahead = route[route.index(lane_id) :]
            self._beside[key] = sum(graph.lanes[n].length_m for n in ahead)
        return self._beside[key]

    def _run_up(self, lane_id: int) -> Route:
        """Lanes that lead to a lane, the straightest way, back to the map's edge or _RUN_UP_M."""
        if "topology" in self.scene.config.without:
            return ()
        graph, length = self.scene.grid.graph, 0.0
        before: Route = ()
        while length < _RUN_UP_M:
            here = before[0] if before else lane_id
            onto = [p for p in graph.predecessors(here) if self.usable(p) and p not in (lane_id, *before)]
            if not onto:
                break
            first = min(onto, key=lambda p: (graph.straightest_successor(p) != here, p))
            before = (first, *before)
            length += graph.lanes[first].length_m
        return before
