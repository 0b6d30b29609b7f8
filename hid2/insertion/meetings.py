"""What can be met from a start site: recorded traffic nearby, a leader to follow, a path to cross; weights of sites."""

import math
from collections.abc import Collection, Iterator, Sequence
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from hid2.agents import AV_ID, DEFAULT_SIZES, FOCAL_CATEGORY, SCORED_CATEGORY, FloatArray, IntArray, Policy
from hid2.conflicts.signals import InferredSignals
from hid2.drivers.driver import LINE_GAP_M
from hid2.insertion.routes import RouteOffer, Routes
from hid2.insertion.situations import Situation
from hid2.kernels.meetings import met_on_route
from hid2.measures.arrays import STANDS_MPS
from hid2.measures.encounters import BRAKES_MPS2, CROSSING_RAD, FOLLOWS_FOR_S, FOLLOWS_S
from hid2.motion.route import Route
from hid2.occupancy.traffic import BoolArray
from hid2.once import once
from hid2.policy.behaviours import BEHAVIOURS
from hid2.scene import Scene, cruising_mps
from netconvert.cells import Cell
from netconvert.lane_graph import TurnType

#: Weight of a site near to agents that `request.near` asks for, over that of any other site. No tunable:
#: `request.near`, `within_m` and `sites` say what is wanted.
NEAR_WEIGHT = 20.0
#: Weight of a site where a recorded follower would run into the vehicle: most of them fail. No tunable, as NEAR_WEIGHT.
_RUN_INTO_WEIGHT = 0.2
# No tunables from here to _ROUTES: what is met is foreseen roughly here; a rollout follows.
PACE_SHARE = 0.9  # foreseen over usual speed of a vehicle, which brakes now and then
_NEAR_SHARE = 0.7  # share of `request.within_m` up to which agents are near
_LEAVES_SHARE = 0.8  # least way left at a site over the way at the usual speed
_ROUTES = 4  # routes with the same first turn that a mean is taken over, at most
#: Least and largest time between centres where a path is crossed, s: boxes take about .8 s of it, which leaves a PET
#: from the critical 1 to 3 s. No tunable: foreseen roughly, a rollout follows.
_CROSSING_APART_S = (1.8, 3.8)
#: Time between looks at recorded traffic, s. Not a parameter, it saves time: estimates of positions need no more.
_EVERY_S = 0.5
#: Largest distance of a centre on a cell to its middle, m: half a lane and a little. No tunable: what on a cell means.
_ON_CELL_M = 3.0
#: Least distance from the centre of a follower to that of its leader, m. No tunable: a box ahead of a box.
_LEADS_FROM_M = 6.0
#: Least number of looks at which a leader is ahead. No tunable: what following is by `measures/encounters.py`.
_LEADS_LOOKS = 1 + round(FOLLOWS_FOR_S / _EVERY_S)
_LEAST = 1e-3  # weight of a route that is not worth trying; no tunable: above 0, to be drawn where no other route is


def target_rows(scene: Scene) -> IntArray:
    """Rows of `scene.traffic` that vehicles are to be near to: av, focal, scored, a track id, else moving traffic."""
    request = scene.config.request
    return named_rows(scene, request.near) if request.is_near_agents else moving_vehicles(scene)


def named_rows(scene: Scene, name: str) -> IntArray:
    """Rows of `scene.traffic` by name: av, focal, scored, or a track id; none where there is none."""
    if name in ("focal", "scored"):
        return np.flatnonzero(scene.states.arrays.category >= (FOCAL_CATEGORY if name == "focal" else SCORED_CATEGORY))
    wanted = AV_ID if name == "av" else name
    return np.array([row for row, track_id in enumerate(scene.traffic.ids) if track_id == wanted], dtype=np.int64)


def moving_vehicles(scene: Scene) -> IntArray:
    """Rows of the recorded vehicles that move, without tracker fragments."""
    return np.flatnonzero(scene.states.arrays.clean)


class Outlook(NamedTuple):
    """What vehicles that start on cells would meet at usual speed, in the order of the grid, or of a lane.

    weight (C,): of each cell, 0 where a vehicle would leave the map before the last observed step, and on lanes that
    cars do not drive on; near (C,): whether a named target would be near at the last observed step; leader (C,): the
    leader of a vehicle from there, a number of its own, -1 for none; stays (C,): whether it would be on the map until
    the scene ends, as recorded vehicles are; meets: whether it would meet each `Situation` (C,).
    """

    weight: FloatArray
    near: BoolArray
    leader: IntArray
    stays: BoolArray
    meets: dict[Situation, BoolArray]

    @classmethod
    def none(cls, count: int) -> "Outlook":
        """Of so many cells from which no vehicle drives."""
        never = np.zeros(count, dtype=np.bool_)
        return cls(
            np.zeros(count), never, np.full(count, -1, dtype=np.int64), never.copy(),
            {one: np.zeros(count, dtype=np.bool_) for one in Situation},
        )  # fmt: skip

    @classmethod
    def joined(cls, each: Sequence["Outlook"]) -> "Outlook":
        """Of the cells of all, in this order."""
        weight, near, leader, stays = (np.concatenate([one[k] for one in each]) for k in range(4))
        meets = {name: np.concatenate([one.meets[name] for one in each]) for name in Situation}
        return cls(weight, near, leader, stays, meets)

    @classmethod
    def over(cls, routes: Sequence["Outlook"]) -> "Outlook":
        """Of the same cells on some route: the weight is the mean, the leader that on the best."""
        weights, leaders = np.array([one.weight for one in routes]), np.array([one.leader for one in routes])
        best = (weights * (1.0 + (leaders >= 0))).argmax(axis=0)
        near, stays = np.asarray(np.any([(one.near, one.stays) for one in routes], axis=0))
        meets = {name: np.asarray(np.any([one.meets[name] for one in routes], axis=0)) for name in Situation}
        return cls(weights.mean(axis=0), near, leaders[best, np.arange(best.size)], stays, meets)

    def meets_any(self, wants: Collection[Situation], followed: Collection[int]) -> BoolArray:
        """(C,) whether something that is wanted is met on a route; a leader that is followed already does not count."""
        free = ~np.isin(self.leader, list(followed))
        alone = Situation.CROSSES, Situation.STANDS
        return np.asarray(np.any([self.meets[one] & (free | (one in alone)) for one in wants], axis=0))


class Meetings:
    """What vehicles that start on the cells of a scene would meet at usual speed.

    signals: those of the stop lines, at which vehicles wait; looks: steps at which recorded traffic is looked at.
    """

    def __init__(self, scene: Scene, routes: Routes, signals: InferredSignals) -> None:
        """Where recorded moving vehicles are, on which cells, and which cells they cross."""
        self.scene, self.routes, self.signals = scene, routes, signals
        traffic, rows, moving = scene.traffic, scene.vehicle_rows, moving_vehicles(scene)
        self._targets = target_rows(scene)
        self.looks = np.arange(0, scene.num_steps, scene.steps_in(_EVERY_S))
        self._target_xy = traffic.position[self._targets][:, self.looks]
        self._target_there = traffic.present[self._targets][:, self.looks]
        self._lane_cell = scene.occupancy.cell[rows][:, self.looks]
        self._number = np.full(len(traffic.ids), -1, dtype=np.int64)
        self._number[moving] = np.arange(moving.size)
        self._number = self._number[rows]
        self._crossed_from, self._crossed_s = self._crossings(moving)
        self._pace_mps = [cruising_mps(traffic, row) for row in moving.tolist()]
        speed = np.hypot(*traffic.velocity[moving][:, self.looks].transpose(2, 0, 1))
        slows = np.diff(speed, axis=1) < BRAKES_MPS2 * np.diff(self.looks) * scene.step_s
        there = traffic.present[moving][:, self.looks]
        slows &= there[:, 1:] & there[:, :-1]
        # of leaders, by their numbers; the last for none, -1
        self._brakes = np.append(slows.any(axis=1), False)
        self._stands = np.append(((speed < STANDS_MPS) & there).any(axis=1), False)

    @property
    def is_target_missing(self) -> bool:
        """Whether the scene lacks the track that vehicles are to be near to."""
        return self.scene.config.request.is_near_agents and not self._targets.size

    def _crossings(self, moving: IntArray) -> tuple[IntArray, FloatArray]:
        """Times, s, at which moving recorded vehicles cross cells: those of cell c from first[c] to first[c + 1]."""
        boxes, traffic = self.scene.boxes, self.scene.traffic
        found: list[tuple[IntArray, FloatArray]] = [(np.zeros(0, dtype=np.int64), np.zeros(0))]
        for row in moving.tolist():
            steps = self.looks[traffic.present[row, self.looks]]
            if not steps.size:
                continue
            way = traffic.position[row, steps]
            low, high = way.min(axis=0) - _ON_CELL_M, way.max(axis=0) + _ON_CELL_M
            some = np.flatnonzero(((boxes.center >= low) & (boxes.center <= high)).all(axis=1))
            offset = boxes.center[some, None] - way
            turned = np.abs(np.sin(boxes.heading[some, None] - traffic.heading[row, steps]))
            near = (np.hypot(offset[..., 0], offset[..., 1]) < _ON_CELL_M) & (turned > math.sin(CROSSING_RAD))
            cell, look = np.nonzero(near)
            found.append((some[cell], steps[look] * self.scene.step_s))
        cells = np.concatenate([cell for cell, _ in found])
        count = np.bincount(cells, minlength=boxes.heading.size)
        times = np.concatenate([time_s for _, time_s in found])[np.argsort(cells, kind="stable")]
        return np.concatenate([[0], np.cumsum(count)]), times

    def outlook(self, policy: Policy) -> Outlook:
        """Of all cells, for vehicles of a policy: in the mean over the routes that it would take."""
        return self._towards(_turn_of(policy))

    @once
    def _towards(self, turn: TurnType) -> Outlook:
        grid = self.scene.grid
        found = Outlook.none(len(grid.cells))
        for lane_id in self.routes.lanes:
            looked = [self._of_offer(lane_id, row) for row in self.offers_towards(lane_id, turn)]
            if not looked:
                continue
            first = grid.index_of[Cell(lane_id, 0)]
            cells = slice(first, first + grid.count(lane_id))
            one = looked[0] if len(looked) == 1 else Outlook.over(looked)
            found.weight[cells], found.near[cells], found.leader[cells], found.stays[cells] = one[:4]
            for name, met in found.meets.items():
                met[cells] = one.meets[name]
        return found

    @once
    def offer_weights(self, cell: Cell, policy: Policy, wants: frozenset[Situation]) -> FloatArray:
        """Weight of each of the routes from a cell, in the order of `Routes.offers`; the mean where none is known.

        0 where nothing is met that is wanted.
        """
        rows = self.offers_towards(cell.lane_id, _turn_of(policy))
        looked = {row: self._of_offer(cell.lane_id, row) for row in rows}
        if wants:
            looked = {row: one for row, one in looked.items() if any(one.meets[each][cell.index] for each in wants)}
        known = {row: max(_LEAST, float(one.weight[cell.index])) for row, one in looked.items()}
        other = 0.0 if wants else max(_LEAST, sum(known.values()) / max(1, len(known)))
        return np.array([known.get(row, other) for row in range(len(self.routes.offers(cell.lane_id)))])

    def from_edge(self, lane_id: int, row: int, look: int) -> Outlook:
        """Of the first cell of a lane on one of its routes, for a vehicle that is there from a look on."""
        return self._of_route(lane_id, self.routes.offers(lane_id)[row], self.scene.usual_speed(lane_id), look, 1)

    def leader_of(self, cell: Cell, route: Route) -> int:
        """The leader of a vehicle from a cell on a route, a number of its own; -1 for none."""
        for row, offer in enumerate(self.routes.offers(cell.lane_id)):
            if offer.route == route:
                return int(self._of_offer(cell.lane_id, row).leader[cell.index])
        return -1

    def pace_of(self, leader: int) -> float:
        """How fast a leader drives while it moves, m/s, as `Scene.lane_speed` has it; 0 for none."""
        return self._pace_mps[leader] if leader >= 0 else 0.0

    def offers_towards(self, lane_id: int, turn: TurnType) -> list[int]:
        """Rows of `Routes.offers` that first turn so, a few; straight ones where the map has them, else any."""
        offers = self.routes.offers(lane_id)
        rows = [row for row, one in enumerate(offers) if (one.turns[0][0] if one.turns else TurnType.STRAIGHT) is turn]
        if turn is TurnType.STRAIGHT and not rows:
            rows = list(range(len(offers)))
        return rows[:_ROUTES]

    @once
    def _of_offer(self, lane_id: int, row: int) -> Outlook:
        return self._of_route(lane_id, self.routes.offers(lane_id)[row], self.scene.usual_speed(lane_id))

    def _of_route(
        self, lane_id: int, offer: RouteOffer, speed_mps: float, look: int = 0, count: int | None = None
    ) -> Outlook:
        """Of the cells of a lane on one route, for a vehicle there from a look on; count: of its first cells alone."""
        scene, config = self.scene, self.scene.config
        request = config.request
        cells, middle = self._cells(lane_id, offer)
        count, pace = count or scene.grid.count(lane_id), PACE_SHARE * speed_mps
        start, since, step = middle[:count], slice(look, None), int(self.looks[look])
        time_s = np.asarray((self.looks[since] - step) * scene.step_s, dtype=np.float64)
        last = int(np.searchsorted(self.looks, min(scene.first_exit_step, scene.num_steps) - 1, side="right")) - 1
        target_xy = np.ascontiguousarray(self._target_xy[:, since])
        target_there = np.ascontiguousarray(self._target_there[:, since])
        lane_cell = np.ascontiguousarray(self._lane_cell[:, since])
        stop_at, red = self._red(lane_id, offer, look)
        near, near_last, leader, is_run_into, crosses, is_held = met_on_route(
            scene.grid.centers, cells, middle, count, time_s, pace, target_xy, target_there,
            _NEAR_SHARE * request.within_m, lane_cell, self._number, _LEADS_FROM_M,
            FOLLOWS_S * speed_mps + _LEADS_FROM_M, _LEADS_LOOKS, self._crossed_from,
            self._crossed_s - step * scene.step_s, *_CROSSING_APART_S, last - look, stop_at, red,
        )  # fmt: skip
        weight = np.ones(count)
        if request.near == "anywhere":
            leader = np.full(count, -1, dtype=np.int64)
        else:
            weight[is_run_into] *= _RUN_INTO_WEIGHT
            weight[near] *= NEAR_WEIGHT
        meets = {
            Situation.FOLLOWS: leader >= 0,
            Situation.BRAKES: self._brakes[leader],
            Situation.CROSSES: crosses,
            Situation.STANDS: is_held | self._stands[leader],
        }
        left_m, usual_m = middle[-1] - start, _LEAVES_SHARE * speed_mps * scene.step_s
        if "topology" not in scene.config.without:
            weight[left_m < usual_m * scene.steps_to_stay(step)] = 0.0
        stays = left_m >= speed_mps * scene.step_s * (scene.num_steps - step)
        return Outlook(weight, near_last, leader, stays, meets)

    def _red(self, lane_id: int, offer: RouteOffer, look: int) -> tuple[FloatArray, BoolArray]:
        """Where a vehicle on a route stops at signals, (L,) m from a lane on, and whether they are red (L, looks)."""
        before_m = DEFAULT_SIZES["vehicle"].length_m / 2 + sum(LINE_GAP_M) / 2
        each = [(at - before_m, self.signals.red(lane)) for lane, at in self._lanes_from(lane_id, offer)]
        found = [(at, red[self.looks[look:]]) for at, red in each if red is not None]
        red = np.array([red for _, red in found], dtype=np.bool_).reshape(-1, self.looks.size - look)
        return np.array([at for at, _ in found]), red

    def _cells(self, lane_id: int, offer: RouteOffer) -> tuple[IntArray, FloatArray]:
        """Cells of a route from a lane on, (K,) rows of the grid, and their middles along it, (K,) m."""
        each = [(self._of_lane(lane), begin) for lane, begin in self._lanes_from(lane_id, offer)]
        return np.concatenate([rows for (rows, _), _ in each]), np.concatenate([begin + at for (_, at), begin in each])

    def _lanes_from(self, lane_id: int, offer: RouteOffer) -> Iterator[tuple[int, float]]:
        """Lanes of a route from a lane on, and where each begins, m from that."""
        lanes, onward = self.scene.grid.graph.lanes, offer.route[offer.route.index(lane_id) :]
        return zip(onward, accumulate((lanes[lane].length_m for lane in onward), initial=0.0), strict=False)

    @once
    def _of_lane(self, lane_id: int) -> tuple[IntArray, FloatArray]:
        """Cells of a lane, rows of the grid, and their middles on it, m."""
        grid = self.scene.grid
        first, borders = grid.index_of[Cell(lane_id, 0)], grid.edges_m[lane_id]
        return np.arange(first, first + grid.count(lane_id)), 0.5 * (borders[1:] + borders[:-1])


def _turn_of(policy: Policy) -> TurnType:
    """The first turn of the routes that a vehicle of a policy would take."""
    return BEHAVIOURS[policy].turn or TurnType.STRAIGHT


def by_weight(weight: FloatArray, rng: np.random.Generator) -> IntArray:
    """Rows of those of some weight (N,) in weighted random order."""
    key = rng.exponential(size=weight.size)
    with_weight = np.flatnonzero(weight > 0.0)
    return with_weight[np.argsort(key[with_weight] / weight[with_weight], kind="stable")]
