"""Places from which an event may come about: along which route, and where on it a vehicle has to be at which step.

lead, follow   on the lanes of the target, ahead of it or behind it
cut_in         on the lane beside, ahead of it
overtake       on its lane, behind it, where a lane beside lasts long enough
merge          where the lane begins that both come onto, the vehicle from another one than the target
cross          where the paths cross
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np

from hid2.agents import FloatArray
from hid2.insertion.event_objective import MOMENT_S
from hid2.insertion.event_targets import Target
from hid2.insertion.routes import RouteOffer, Routes
from hid2.measures.encounters import CROSSING_RAD
from hid2.motion.route import ROUTE_LONGEST_M, DrivenPath, Route, is_drivable, is_simple, straightest_first
from hid2.occupancy.traffic import BoolArray
from hid2.params import Event
from netconvert.lane_graph import Side

#: Other ways onto a lane, and on from it, at most. Not a parameter, it saves time: a path takes as long as 20 rollouts.
_OTHER_WAYS = 2
#: Largest distance, m, and least cosine of the angle of a path to a target beside it; largest distance of a crossed
#: lane to the target's next position, m. No tunables: a lane and a half, 37 degrees, more than a car drives in a step.
_BESIDE_M, _ALONG, _NEAR_M = 6.0, 0.8, 3.0
#: Time from the beginning of an overtake until the vehicle is back, s, and distance behind the target at the beginning,
#: m, least and largest. No tunables: bounds of what is drawn.
_OVERTAKES_S, _BEHIND_M = (4.0, 10.0), (3.0, 30.0)
#: Largest PET of a crossing where none is asked for, s; largest time that the boxes add to a PET, to make the time
#: between the centres, s. No tunables: bounds of what is drawn.
_LARGEST_PET_S, _BOXES_S = 5.0, 2.0
#: Tolerance of a place, and of the best beginning, m. Not a parameter, it saves time: farther off no event comes about.
ABOUT_M = 2.0
#: Share of MOMENT_S by which places may be earlier or later. No tunable: SUMO's vehicle is not where its rollout is.
_SPARE_SHARE = 0.8
_SIDES: tuple[tuple[Side, Side], ...] = (("left", "right"), ("right", "left"))


@dataclass(frozen=True, eq=False, slots=True)
class Place:
    """A route, and where on its path a vehicle has to be for an event.

    along (T,) m, by the step at which it is there, NaN where that is too early, too late, or nowhere; beyond: least and
    largest distance, m, to add to that. side: to which it changes lanes.
    """

    offer: RouteOffer
    path: DrivenPath
    along: FloatArray
    beyond: tuple[float, float]
    side: Side | None = None

    def is_come_to(self, s: FloatArray, step_m: FloatArray) -> BoolArray:
        """(K,) whether a motion, m by the steps from 0 on, is about there in time; step_m (K,): its way in a step."""
        off = s - self.along[: s.size]
        low, high = self.beyond
        return np.asarray((off > low - step_m - ABOUT_M) & (off < high + step_m + ABOUT_M))


@dataclass(frozen=True, eq=False, slots=True)
class Places:
    """Places of an event with a target. lengths_m: half of both lengths."""

    routes: Routes
    event: Event
    target: Target
    lengths_m: float

    def all(self) -> Iterator[Place]:
        """Every place of the event's kind, those on the way of the target first."""
        kinds = {
            "lead": self._on_its_lanes, "follow": self._on_its_lanes, "cut_in": self._beside,
            "overtake": self._behind, "merge": self._merging, "cross": self._crossing,
        }  # fmt: skip
        seen: set[tuple[Route, Side | None]] = set()
        for place in kinds[self.event.kind]():
            key = place.offer.route, place.side
            if key not in seen and np.isfinite(place.along).any():
                seen.add(key)
                yield place

    def _on_its_lanes(self) -> Iterator[Place]:
        for lane, at in self._lanes(*self.event.at_band_s):
            for route in self._over(lane, self.target.lanes_from(at), self.target.lanes_before(at)):
                yield self._relative(route, *self.event.at_band_s, *self._gaps())

    def _beside(self) -> Iterator[Place]:
        """On the lane beside; where the target has none yet, there may be one by where the vehicle is."""
        graph, target = self.routes.scene.grid.graph, self.target
        for lane, at in self._lanes(*self.event.at_band_s):
            ahead, before = target.lanes_from(at), target.lanes_before(at)
            for where, side in _SIDES:
                lanes = (n for one in (lane, *ahead[1:4]) if (n := graph.neighbor(one, where)) is not None)
                beside = next((n for n in lanes if graph.neighbor(n, side) is not None), None)
                if beside is None:
                    continue
                beside_them = [
                    tuple(n for one in some if (n := graph.neighbor(one, where)) is not None)
                    for some in (ahead, before)
                ]
                for route in self._over(beside, *beside_them):
                    yield self._relative(route, *self.event.at_band_s, *self._gaps(), side)

    def _behind(self) -> Iterator[Place]:
        (low_s, high_s), (least_s, most_s) = self.event.at_band_s, _OVERTAKES_S
        band = max(0.0, low_s - most_s), max(0.0, high_s - least_s)
        for lane, at in self._lanes(*band):
            for route in self._over(lane, self.target.lanes_from(at), self.target.lanes_before(at)):
                for side, _ in _SIDES:
                    if self.routes.together(self.routes.offer_of(route), side) is not None:
                        yield self._relative(route, *band, -_BEHIND_M[1], -_BEHIND_M[0], side)

    def _merging(self) -> Iterator[Place]:
        graph, target = self.routes.scene.grid.graph, self.target
        for (source, _, _), (lane, entered, _) in zip(target.runs, target.runs[1:], strict=False):
            if source not in graph.predecessors(lane):
                continue
            for other in (n for n in graph.predecessors(lane) if n != source):
                for route in self._over(other, (lane, *target.lanes_from(entered))):
                    begin = next((one.start for one in self._path(route).segments if one.lane_id == lane), None)
                    if begin is not None:
                        yield self._fixed(route, begin, np.abs(target.way - target.way[entered]) - self.lengths_m)

    def _crossing(self) -> Iterator[Place]:
        target, scene = self.target, self.routes.scene
        least_s, most_s = self.event.pet_s or (scene.config.conflict.pet_min_s, _LARGEST_PET_S)
        for lane, lane_m, crossed in self._crossed_lanes():
            apart_s = np.abs(np.arange(target.present.size) - crossed) * scene.step_s
            gap = np.abs(target.way - target.way[crossed]) - 0.5 * target.track.size.length_m
            gap[(apart_s < least_s) | (apart_s > most_s + _BOXES_S)] = np.inf
            for route in self._over(lane):
                point = next(one for one in self._path(route).segments if one.lane_id == lane).s_at(lane_m)
                yield self._fixed(route, point, gap)

    def _gaps(self) -> tuple[float, float]:
        """Where the centre is relative to the target's, m."""
        low, high = self.event.gap_band_m
        if self.event.kind == "follow":
            return -high - self.lengths_m, -low - self.lengths_m
        return low + self.lengths_m, high + self.lengths_m

    def _relative(
        self, route: Route, low_s: float, high_s: float, least_m: float, most_m: float, side: Side | None = None
    ) -> Place:
        """Relative to the target, at the steps at which it is beside the path."""
        path, target = self._path(route), self.target
        s, d = path.raw_line.frenet(target.position)
        turned = np.cos(path.raw_line.heading(s) - target.heading)
        there = self._within(low_s, high_s) & (np.abs(d) < _BESIDE_M) & (turned > _ALONG)
        along = np.where(there, path.all_to_line(s), np.nan)
        return Place(self.routes.offer_of(route), path, along, (least_m, most_m), side)

    def _fixed(self, route: Route, s: float, gap_m: FloatArray) -> Place:
        """At a place, s m, at the steps at which the target is as far from there as is asked for: gap (T,) m."""
        low, high = self.event.gap_band_m
        there = self._within(*self.event.at_band_s) & (gap_m >= low) & (gap_m <= high)
        return Place(self.routes.offer_of(route), self._path(route), np.where(there, s, np.nan), (0.0, 0.0))

    def _within(self, low_s: float, high_s: float) -> BoolArray:
        """(T,) steps within a band of times, or nearly, at which the target is there."""
        time_s = np.arange(self.target.present.size) * self.routes.scene.step_s
        spare_s = _SPARE_SHARE * MOMENT_S
        return self.target.present & (time_s >= low_s - spare_s) & (time_s <= high_s + spare_s)

    def _lanes(self, low_s: float, high_s: float) -> list[tuple[int, int]]:
        """Lanes that the target drives within a band of times, each with a step at which it does."""
        found: dict[int, int] = {}
        for step in np.flatnonzero(self._within(low_s, high_s)).tolist():
            lane = self.target.lane_at(step)
            if lane is not None:
                found.setdefault(lane, step)
        return list(found.items())

    def _path(self, route: Route) -> DrivenPath:
        return self.routes.scene.paths.along(route)

    def _crossed_lanes(self) -> list[tuple[int, float, int]]:
        """Lanes that the target crosses: lane id, arc length there, m, and the step at which it does."""
        target, graph = self.target, self.routes.scene.grid.graph
        steps, own = np.flatnonzero(target.present), {lane for lane, _, _ in target.runs}
        found: list[tuple[int, float, int]] = []
        for lane_id in (n for n in self.routes.lanes if n not in own):
            path = graph.lanes[lane_id].path
            s, d = path.frenet(target.position[steps])
            inside = (s[1:] > 0.0) & (s[1:] < path.length_m) & (d[1:] * d[:-1] < 0.0) & (np.abs(d[1:]) < _NEAR_M)
            for row in np.flatnonzero(inside).tolist():
                lane_heading = float(path.heading(s[row + 1 : row + 2])[0])
                angle = abs(math.sin(lane_heading - float(target.heading[steps[row + 1]])))
                if angle > math.sin(CROSSING_RAD):
                    found.append((lane_id, float(s[row + 1]), int(steps[row + 1])))
                    break
        return found

    def _over(self, lane_id: int, ahead: tuple[int, ...] = (), before: tuple[int, ...] = ()) -> list[Route]:
        """Routes over a lane: on along the lanes ahead where they can, else straight on; from along the lanes before.

        Then those that come onto it from elsewhere, and those that go on elsewhere, the nearest ones first.
        """
        graph = self.routes.scene.grid.graph
        if not is_drivable(graph, lane_id):
            return []
        onward = self._ways(lane_id, graph.successors, ahead, ROUTE_LONGEST_M)
        back = self._ways(lane_id, graph.predecessors, before, 0.5 * ROUTE_LONGEST_M)
        pairs = [(0, 0), *((0, row) for row in range(1, len(onward))), *((row, 0) for row in range(1, len(back)))]
        found = [(*back[one][:0:-1], *onward[other]) for one, other in pairs]
        return [route for route in found if is_simple(graph, route)]

    def _ways(self, lane_id: int, onto: Callable[[int], Iterable[int]], known: Route, longest_m: float) -> list[Route]:
        """Lanes from a lane on, by what is best at each split; then with another one at a split, the nearest first."""
        graph = self.routes.scene.grid.graph

        def beyond(way: Route) -> Route:
            if sum(graph.lanes[n].length_m for n in way[1:]) > longest_m:
                return ()
            others = (n for n in onto(way[-1]) if is_drivable(graph, n) and n not in way)
            return straightest_first(graph, way[-1], others, known)

        def goes_on(way: Route) -> Route:
            while options := beyond(way):
                way = (*way, options[0])
            return way

        best = goes_on((lane_id,))
        others = (goes_on((*best[:k], n)) for k in range(1, len(best)) for n in beyond(best[:k])[1:])
        return [best, *islice(others, _OTHER_WAYS)]
