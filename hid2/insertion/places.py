"""Where on the map a vehicle of a policy may start, and on which route: what the map alone says."""

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from hid2.agents import FloatArray, Policy
from hid2.conflicts.cases import DT_S
from hid2.insertion.draws import Draws
from hid2.insertion.foresight import LATEST_S, SPARE_LANE_M, Wish
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.motion.route import ROUTE_LONGEST_M, DrivenPath, Route, Way, routes_from
from hid2.policy.decision import Side
from hid2.policy.maneuver import admissible_neighbor
from hid2.policy.turns import TURN_OF_POLICY
from hid2.scene import DRIVABLE_TYPES, World
from netconvert.cells import Cell
from netconvert.lane_graph import TurnType

_FASTEST_MPS = 9.0  # mean over approach and turn
_SLOWEST_MPS = (6.0, 3.0)  # a candidate's road lasts until the last observed step at this speed; with patience
#: Of two lanes side by side: from 3 m/s behind a slow leader out, past it and back, speeding up by 1.8 m/s2 to 9 m/s.
_OVERTAKE_STRETCH_M = 65.0
_STRETCH_MOST_M = 120.0
_RUN_UP_M = 150.0  # of a route before the place
_TURN_ROUTES, _OTHER_ROUTES = 6, 3
_BEFORE_TURN_M = 3.0
_ROUGHLY_M = 2.0  # by which two lanes side by side may differ in length up to a place

#: With its run-up, m, and where the turn that it is for begins and ends, m behind that.
_FoundWay = tuple[Way, float, float, float]
_ANYWHERE = math.inf, -math.inf  # begin and end of no turn: every place is before it, and through it in time


@dataclass(slots=True)
class Places:
    """Candidates (route, s0 m) for each policy; what is found out about the map is kept. patience as for the spawner.

    packed: each lane is filled from its downstream end, so that everybody can adapt to who is ahead.
    """

    world: World
    draws: Draws
    packed: bool = False
    lanes: tuple[int, ...] = field(init=False)
    _known_ways: dict[tuple[TurnType, int, int], tuple[_FoundWay, ...]] = field(default_factory=dict)
    _known_before: dict[int, tuple[int, ...]] = field(default_factory=dict)
    _usable: frozenset[int] = field(init=False)
    _known_beside: dict[int, float] = field(default_factory=dict)
    _known_left: list[float] = field(default_factory=list)
    _known_cells: dict[Policy, tuple[list[Cell], list[int], FloatArray, FloatArray]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Lanes that cars drive on."""
        graph = self.world.grid.graph
        self.lanes = tuple(i for i, lane in graph.lanes.items() if lane.lane_type in DRIVABLE_TYPES)
        self._usable = frozenset(self.lanes)

    def offers(self, policy: Policy) -> bool:
        """Whether the map has any place at all for a policy, whoever is on it."""
        if policy is Policy.STRAIGHT:
            return bool(self.lanes)
        if policy in TURN_OF_POLICY:
            return any(self._turns_into(lane_id, TURN_OF_POLICY[policy]) for lane_id in self.lanes)
        return any(self._may_start(policy, lane_id) for lane_id in self.lanes)

    def candidates(
        self, policy: Policy, is_free: Callable[[int], bool], patience: int
    ) -> Iterator[tuple[Way, float] | None]:
        """(route, s0) in random order, suited to the policy; None for a cell that is taken.

        is_free tells by index whether a cell is free at step 0; it is asked again whenever the next one is taken.
        """
        cells, place_of, low, high = self._cells(policy)
        order, starts = self.draws.permutation(len(cells)), self.draws.between(low, high)
        if self.packed and policy is Policy.STRAIGHT:
            order.sort(key=self._left_m().__getitem__)
        for row in order:
            cell = cells[row]
            if not is_free(place_of[row]):
                yield None
                continue
            s0 = starts[row]
            for place in self._ways(policy, cell.lane_id, s0, patience):
                if not is_free(place_of[row]):
                    break  # taken meanwhile: by the vehicle that the route before was for
                yield place

    def unsuited(self, wish: Wish, way: Way, s0: float, cruise_mps: float, patience: int) -> str | None:
        """What the map says against a candidate, before a path is laid and anybody is looked at."""
        half_m = wish.size.length_m / 2
        run_on = "topology" in self.world.config.without
        if s0 < half_m or (s0 + half_m > way.length_m - 1.0 and not run_on):
            return "no_room_on_lane"
        slowest = _SLOWEST_MPS[min(patience, 1)]
        stay_m = 0.75 * min(cruise_mps, slowest) * self.world.earliest_exit_step * DT_S
        if way.length_m - s0 < 2 * half_m + stay_m and not run_on:
            return "leaves_too_early"
        if wish.policy is Policy.STRAIGHT and patience == 0:
            reached = way.between(s0, s0 + cruise_mps * self.world.num_steps * DT_S)
            if any(self._turn(lane_id) is not TurnType.STRAIGHT for lane_id, _ in reached):
                return "would_turn"
        if wish.policy in (Policy.LANE_CHANGE, Policy.OVERTAKE):
            slowest, fastest = 0.3 * cruise_mps * wish.trigger_s, cruise_mps * (wish.trigger_s + LATEST_S)
            least_m = self._remaining_m - _ROUGHLY_M if wish.policy is Policy.LANE_CHANGE else -math.inf
            reached = way.between(s0 + slowest + SPARE_LANE_M, s0 + fastest + SPARE_LANE_M)
            if not any(self._beside_m(lane_id, lane_s) > least_m for lane_id, lane_s in reached):
                return "no_lane_beside_at_trigger"
        if wish.policy is Policy.OVERTAKE:
            lane_id, lane_s = way.on_lane(s0)
            if self._overtaking_m(lane_id) - lane_s < _OVERTAKE_STRETCH_M:
                return "lanes_part_too_soon"
        return None

    def _cells(self, policy: Policy) -> tuple[list[Cell], list[int], FloatArray, FloatArray]:
        """Cells that a policy may start from, their indices, and where on their lanes they begin and end (M,), m."""
        if policy not in self._known_cells:
            grid = self.world.grid
            allowed = {n for n in self.lanes if policy is Policy.STRAIGHT or self._may_start(policy, n)}
            rows = [row for row, cell in enumerate(grid.cells) if cell.lane_id in allowed]
            cells = [grid.cells[row] for row in rows]
            borders = [grid.edges_s(cell.lane_id)[cell.index : cell.index + 2] for cell in cells]
            low, high = np.reshape(borders, (-1, 2)).T
            self._known_cells[policy] = cells, rows, low, high
        return self._known_cells[policy]

    def lies_beside(self, way: Way, s: float) -> bool:
        """Whether a lane that may be changed to lies beside a little behind arc length s of a route, m, and lasts."""
        s += SPARE_LANE_M
        return s < way.length_m and self._beside_m(*way.on_lane(s)) >= self._remaining_m

    def too_sharp(self, path: DrivenPath, start: float, end: float) -> bool:
        """Whether the path bends more than kappa_max = 1 / R_min between two arc lengths (Trajectory Smoothing)."""
        cells = slice(int(start / TABLE_STEP_M), int(end / TABLE_STEP_M) + 2)
        bend = float(np.abs(path.line.table_curvature[cells]).max(initial=0.0))
        return bend > self.world.curvature_most

    def _turns_into(self, lane_id: int, wanted: TurnType) -> bool:
        """Whether a turning lane is of the wanted kind, can be entered, and is one that a car can follow."""
        before = [p for p in self.world.grid.graph.predecessors(lane_id) if p in self.lanes]
        if self._turn(lane_id) is not wanted or not before:
            return False
        path = self.world.path((before[0], lane_id, *self.world.grid.graph.successors(lane_id)[:1]))
        return not self.too_sharp(path, path.segments[1].start, path.segments[1].end)

    def _may_start(self, policy: Policy, lane_id: int) -> bool:
        if policy in TURN_OF_POLICY:
            return self._turn(lane_id) is TurnType.STRAIGHT
        if "topology" in self.world.config.without:
            return False
        if policy is Policy.OVERTAKE:
            return self._overtaking_m(lane_id) >= _OVERTAKE_STRETCH_M
        return self._beside_m(lane_id, 0.0) >= self._remaining_m

    @property
    def _remaining_m(self) -> float:
        """Length of l' that a lane change needs."""
        return self.world.config.lane_change.min_remaining_m

    def _beside_m(self, lane_id: int, lane_s: float) -> float:
        """Length of a lane beside that may be changed to, on to the end of the map, from arc length lane_s of a lane.

        Not beyond what a lane change there needs; -inf where none lies beside.
        """
        if lane_id not in self._known_beside:
            enough_m = self._remaining_m + self.world.grid.graph.lanes[lane_id].length_m
            lanes = (admissible_neighbor(self.world, lane_id, side) for side in ("left", "right"))
            self._known_beside[lane_id] = max(
                (self._onward_m(beside, 0.0, enough_m) for beside in lanes if beside is not None), default=-math.inf
            )
        return self._known_beside[lane_id] - lane_s

    def _overtaking_m(self, lane_id: int) -> float:
        """Length from the start of a lane on with room to overtake on either side, m."""
        return max(self._stretch_m(lane_id, "left", "right", 0.0), self._stretch_m(lane_id, "right", "left", 0.0))

    def _stretch_m(self, lane_id: int, out: Side, back: Side, sofar_m: float) -> float:
        """Length from the start of a lane on over which a lane lies beside that can be entered and left again, m."""
        beside = admissible_neighbor(self.world, lane_id, out)
        if beside is None or admissible_neighbor(self.world, beside, back) is None or sofar_m > _STRETCH_MOST_M:
            return sofar_m
        sofar_m += self.world.grid.graph.lanes[lane_id].length_m
        onward = self.world.grid.graph.successors(lane_id)
        return max((self._stretch_m(n, out, back, sofar_m) for n in onward), default=sofar_m)

    def _onward_m(self, lane_id: int, sofar_m: float, enough_m: float) -> float:
        """Length from the start of a lane to the end of the map, or beyond what is enough, m."""
        sofar_m += self.world.grid.graph.lanes[lane_id].length_m
        if sofar_m >= enough_m:
            return sofar_m
        onward = [n for n in self.world.grid.graph.successors(lane_id) if n in self._usable]
        return max((self._onward_m(n, sofar_m, enough_m) for n in onward), default=sofar_m)

    def _with_run_up(self, route: Route) -> tuple[Way, float]:
        """A route that begins at the edge of the map, or some way before the first lane, and by how much, m.

        Who comes from behind is seen there, and places on different lanes share what is found out about a path.
        """
        before: list[int] = []
        if "topology" not in self.world.config.without:
            before = [lane_id for lane_id in self._lanes_before(route[0]) if lane_id not in route]
        lanes = self.world.grid.graph.lanes
        return self.world.way((*before, *route)), sum(lanes[lane_id].length_m for lane_id in before)

    def _lanes_before(self, lane_id: int) -> tuple[int, ...]:
        """Lanes that lead to a lane, the straightest way, back to the map's edge or _RUN_UP_M."""
        if lane_id not in self._known_before:
            graph = self.world.grid.graph
            before: tuple[int, ...] = ()
            length = 0.0
            while length < _RUN_UP_M:
                here = before[0] if before else lane_id
                onto = [p for p in graph.predecessors(here) if p in self._usable and p not in (lane_id, *before)]
                if not onto:
                    break
                first = min(onto, key=lambda p: (graph.straightest_successor(p) != here, p))
                before = (first, *before)
                length += graph.lanes[first].length_m
            self._known_before[lane_id] = before
        return self._known_before[lane_id]

    def _left_m(self) -> list[float]:
        """From each cell that one who goes straight may start from to the nearest edge of the map, m."""
        if not self._known_left:
            cells, _, low, _ = self._cells(Policy.STRAIGHT)
            left_m = self._distance_to_exit()
            self._known_left = [left_m[cell.lane_id] - begin for cell, begin in zip(cells, low.tolist(), strict=True)]
        return self._known_left

    def _distance_to_exit(self) -> dict[int, float]:
        """From the start of each lane to the nearest edge of the map, m; lanes that only lead back count as far."""
        graph = self.world.grid.graph
        left = dict.fromkeys(self.lanes, 1e6)
        for _ in range(len(left)):  # Bellman-Ford; maps are a few lanes deep
            changed = False
            for lane_id in self.lanes:
                onward = [left[n] for n in graph.successors(lane_id) if n in left]
                new = graph.lanes[lane_id].length_m + (min(onward) if onward else 0.0)
                if new < left[lane_id]:
                    left[lane_id], changed = new, True
            if not changed:
                break
        return left

    def _ways(self, policy: Policy, lane_id: int, s0: float, patience: int) -> Iterator[tuple[Way, float]]:
        """Routes from a place that serve the policy, with run-up, and where on each the place is, m.

        More than one only where patience asks for it (reroute). Those for a turn have the wanted one as their first,
        and may be through it before the scene ends.
        """
        wanted = TURN_OF_POLICY.get(policy, TurnType.STRAIGHT)
        most = _TURN_ROUTES if policy in TURN_OF_POLICY else 1 if patience == 0 else _OTHER_ROUTES
        key = wanted, lane_id, most
        if key not in self._known_ways:
            self._known_ways[key] = self._find_ways(lane_id, wanted, most)
        reached_m = _FASTEST_MPS * self.world.num_steps * DT_S
        for way, before_m, start, end in self._known_ways[key]:
            if start - s0 > _BEFORE_TURN_M and end - s0 < reached_m:
                yield way, s0 + before_m
                if patience == 0:
                    return

    def _find_ways(self, lane_id: int, wanted: TurnType, most: int) -> tuple[_FoundWay, ...]:
        if "topology" in self.world.config.without:
            return ((*self._with_run_up((lane_id,)), *_ANYWHERE),)

        def choose(onward: tuple[int, ...]) -> tuple[int, ...]:
            return tuple(sorted(onward, key=lambda n: (self._turn(n) is not wanted, self.draws.unit())))

        found: list[_FoundWay] = []
        for route in routes_from(
            self.world.grid.graph, lane_id, choose=choose, usable=self._usable.__contains__, most=most,
            longest_m=ROUTE_LONGEST_M,
        ):  # fmt: skip
            straight = wanted is TurnType.STRAIGHT
            kind, start, end = (wanted, *_ANYWHERE) if straight else self._first_turn(route)
            if kind is wanted:
                found.append((*self._with_run_up(route), start, end))
        return tuple(found)

    def _first_turn(self, route: Route) -> tuple[TurnType, float, float]:
        """Kind of the first turn of a route, and where on the route it begins and ends, m; STRAIGHT where none is."""
        lanes, start = self.world.grid.graph.lanes, 0.0
        for before, lane_id in itertools.pairwise(route):
            start += lanes[before].length_m
            if lanes[lane_id].turn is not TurnType.STRAIGHT:
                return lanes[lane_id].turn, start, start + lanes[lane_id].length_m
        return TurnType.STRAIGHT, 0.0, 0.0

    def _turn(self, lane_id: int) -> TurnType:
        return self.world.grid.graph.lanes[lane_id].turn
