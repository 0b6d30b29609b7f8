"""Courses for events: along which path, and with which motions, a vehicle may come about an event of a kind.

t_c  moment of the event    s_c  where the vehicle is then, on its own path    gap  bumper to bumper

lead, follow   s_c = s_T(t_c) +- (gap + half of both lengths), on the target's lanes
cut_in         the same, on the lane beside; the change of lanes begins half its duration before t_c
merge          s_c = start of the lane that both come onto, the vehicle from another lane than the target
cross          s_c = where the paths cross
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from hid2.agents import FloatArray
from hid2.insertion.event_motions import Along, Rules, Wanted
from hid2.insertion.event_paths import EventPaths
from hid2.insertion.event_targets import Target
from hid2.motion.route import Route
from hid2.params import Event, EventSearch
from hid2.policy.decision import Side

#: A motion as a row of a table: step, place m, gap m, speed m/s, acceleration before, later speed over that, score.
_Row = tuple[int, float, float, float, float, float, float]


@dataclass(frozen=True, eq=False, slots=True)
class Course:
    """Motions that are wanted along one route, with what they have to do with.

    off (N,): their scores, how far from the middle of what is asked; desired_mps: what the driver drives at most; side:
    of the change of lanes; apart_m: between the two lanes at its moment.
    """

    route: Route
    wanted: Wanted
    off: FloatArray
    rules: Rules
    before: Along
    after: Along
    desired_mps: float
    side: Side | None = None
    apart_m: float = 0.0


@dataclass(frozen=True, eq=False, slots=True)
class Courses:
    """Courses for an event with a target. lengths_m: half of both lengths."""

    paths: EventPaths
    event: Event
    target: Target
    lengths_m: float

    def all(self) -> Iterator[Course]:
        """Every course of the event's kind."""
        kinds = {
            "lead": self._on_its_lanes, "follow": self._on_its_lanes, "cut_in": self._cut_ins, "merge": self._merges,
            "cross": self._crossings,
        }  # fmt: skip
        return kinds[self.event.kind]()

    @property
    def _search(self) -> EventSearch:
        return self.paths.scene.config.event_search

    @property
    def _fastest_mps(self) -> float:
        return self.paths.scene.config.spawn.max_speed_mps

    # kinds

    def _on_its_lanes(self) -> Iterator[Course]:
        """Ahead of the target, or behind it."""
        target, order = self.target, 1 if self.event.kind == "lead" else -1
        for lane, moments in self._moments_by_lane():
            at = moments[0][0]
            for route in self.paths.over(lane, target.lanes_from(at), target.lanes_before(at)):
                ahead = target.along(self.paths.scene.path(route), at)
                if ahead is None:
                    continue
                along = self.paths.along(route, target, self._fastest_mps)
                wanted, off = self._table(self._around(moments, ahead, order))
                yield Course(route, wanted, off, self._rules(ahead, order), along, along, self._fastest_mps)

    def _cut_ins(self) -> Iterator[Course]:
        """From the lane beside to before the target, wherever the marking lets one over."""
        scene, target, usable = self.paths.scene, self.target, self.paths.routes.usable
        graph = scene.grid.graph
        sides: tuple[tuple[Side, Side], ...] = (("left", "right"), ("right", "left"))
        for (lane, moments), (where, side) in product(self._moments_by_lane(), sides):
            at = moments[0][0]
            own = self.paths.over(lane, target.lanes_from(at), target.lanes_before(at))
            # the vehicle is ahead: where the target has no lane beside yet, there may be one by then
            lanes = [lane, *target.lanes_from(at)[1:4]]
            beside = next((n for one in lanes if (n := graph.neighbor(one, where)) is not None), None)
            if beside is None or not usable(beside) or not own:
                continue
            ahead_lanes = tuple(n for one in own[0] if (n := graph.neighbor(one, where)) is not None)
            before = tuple(n for one in target.lanes_before(at) if (n := graph.neighbor(one, where)) is not None)
            over = graph.neighbor(beside, side)
            if over is None or not usable(over):
                continue
            for route in self.paths.over(beside, ahead_lanes, before):
                # the way that it will go on: beside its own route, as Algorithm 1 has it
                joined = scene.route_beside(route[route.index(beside) :], over)
                ahead, there = target.along(scene.path(route), at), target.along(scene.path(joined), at)
                if ahead is None or there is None:
                    continue
                wanted, off = self._table(self._around(moments, ahead, 1))
                desired = min(self._fastest_mps, float(wanted.speed_mps.max(initial=self._search.slowest_mps)) + 1.0)
                first = self.paths.along(route, target, desired)
                second = self.paths.along(joined, target, desired, from_m=float(there[at] - ahead[at]))
                own_xy, over_xy = (
                    scene.path(one).line.position(along[at : at + 1])
                    for one, along in ((route, ahead), (joined, there))
                )
                apart_m = float(np.hypot(*(own_xy - over_xy)[0]))
                rules = self._rules(ahead, 1, changes=True)
                yield Course(route, wanted, off, rules, first, second, desired, side, apart_m)

    def _merges(self) -> Iterator[Course]:
        """Onto a lane that the target comes onto from another one, before or behind it."""
        graph, target = self.paths.scene.grid.graph, self.target
        for (source, _, _), (lane, entered, _) in zip(target.runs, target.runs[1:], strict=False):
            if source not in graph.predecessors(lane):
                continue
            for other in (n for n in graph.predecessors(lane) if n != source and self.paths.routes.usable(n)):
                for route in self.paths.over(other, (lane, *target.lanes_from(entered))):
                    if lane not in route:
                        continue
                    begin = next(s.start for s in self.paths.scene.path(route).segments if s.lane_id == lane)
                    yield from self._at_place(route, begin, begin + target.way - target.way[entered])

    def _at_place(self, route: Route, place: float, ahead: FloatArray) -> Iterator[Course]:
        """At a place on a route at each step of the time asked for: the gap is what the target leaves."""
        event, target, search = self.event, self.target, self._search
        along = self.paths.along(route, target, self._fastest_mps)
        steps = np.flatnonzero(target.present)
        near = (
            np.abs(steps * target.step_s - 0.5 * sum(event.at_band_s))
            <= 0.5 * np.ptp(event.at_band_s) + search.moment_s
        )
        gaps = np.abs(place - ahead[steps]) - self.lengths_m
        steps = steps[near & (gaps >= event.gap_band_m[0]) & (gaps <= event.gap_band_m[1]) & (steps > 0)]
        _, differences = self._relations()
        for order in (1, -1):
            moments = [int(step) for step in steps if (place > ahead[step]) == (order > 0)]
            if not moments:
                continue
            rows = [
                (at, place, abs(place - float(ahead[at])) - self.lengths_m, target.speed[at] + d, a, later,
                 search.off_merging_difference * abs(d) + self._off_acceleration(a))
                for at in moments[:: max(1, len(moments) // 6)]
                for d, a, later in product(differences, self._accelerations(), self._later_speeds())
            ]  # fmt: skip
            wanted, off = self._table(rows)
            yield Course(route, wanted, off, self._rules(ahead, order), along, along, self._fastest_mps)

    def _crossings(self) -> Iterator[Course]:
        """Across the target's path, before or behind it."""
        for lane, lane_s, crossed in self.target.crossed_lanes(self.paths.routes):
            for route in self.paths.over(lane):
                segment = next(s for s in self.paths.scene.path(route).segments if s.lane_id == lane)
                share = lane_s / max(segment.lane_end, 1e-9)
                point = segment.start + share * (segment.end - segment.start)
                along = self.paths.along(route, None, self._fastest_mps)
                for order in (1, -1):
                    rows = list(self._across(lane, point, crossed, order))
                    if rows:
                        wanted, off = self._table(rows)
                        yield Course(route, wanted, off, self._rules(None, order), along, along, self._fastest_mps)

    def _across(self, lane_id: int, point: float, crossed: int, order: int) -> Iterator[_Row]:
        """Passing a conflict point at each step of the time asked for; crossed: the step at which the target does."""
        event, target, search = self.event, self.target, self._search
        accelerations = [a for a in self._accelerations() if not math.isnan(a)]
        for at in range(1, target.present.size):
            apart_s, at_s = order * (crossed - at) * target.step_s, at * target.step_s
            asked = event.at_band_s[0] - search.moment_s <= at_s <= event.at_band_s[1] + search.moment_s
            if not asked or not target.present[at] or not self._is_apart(apart_s):
                continue
            gap = abs(float(target.way[crossed] - target.way[at])) - 0.5 * target.track.size.length_m
            if event.gap_band_m[0] <= gap <= event.gap_band_m[1]:
                off = search.off_apart * abs(apart_s - search.cross_usual_s)
                for speed, a in product(self._crossing_speeds(lane_id), accelerations):
                    yield at, point, gap, speed, a, 0.0, off + self._off_acceleration(a)

    # what is tried

    def _moments(self) -> list[tuple[int, float]]:
        """Steps of the time asked for at which the target is there, with their distance from its middle, 0 to 1."""
        target, search = self.target, self._search
        spare, (low, high) = 0.6 * search.moment_s, self.event.at_band_s
        times = [low + share * (high - low) for share in search.band_shares[:-1]] if high - low > 2 * spare else [
            0.5 * (low + high) + share * spare for share in (0.0, -1.0, 1.0)
        ]  # fmt: skip
        middle, wide = 0.5 * (low + high), max(0.5 * (high - low), spare)
        steps = {round(time_s / target.step_s): abs(time_s - middle) / wide for time_s in reversed(times)}
        return [(step, off) for step, off in steps.items() if 0 < step < target.present.size and target.present[step]]

    def _moments_by_lane(self) -> list[tuple[int, list[tuple[int, float]]]]:
        """Lanes of the target with the moments at which it is there, together."""
        found: dict[int, list[tuple[int, float]]] = {}
        for at, off in sorted(self._moments(), key=lambda moment: moment[1]):
            lane = self.target.lane_at(at)
            if lane is not None:
                found.setdefault(lane, []).append((at, off))
        return list(found.items())

    def _relations(self) -> tuple[FloatArray, FloatArray]:
        """Gaps, m, and speed differences, m/s, within what is asked for."""
        event, search = self.event, self._search
        least, most = event.gap_m or (event.gap_band_m[0], min(event.gap_band_m[1], search.gap_most_m))
        gaps = np.array([least + share * (most - least) for share in search.band_shares])
        low, high = event.difference_band_mps
        if event.ttc_s is None and event.drac_mps2 is None:
            usual = [difference for difference in search.differences_mps if low <= difference <= high]
            differences = usual or [low + share * (high - low) for share in search.band_shares]
        else:
            last = search.critical_differences - 1
            differences = [low + number / last * (high - low) for number in range(last + 1)]
        return np.unique(gaps), np.unique(differences)

    def _around(self, moments: Sequence[tuple[int, float]], ahead: FloatArray, order: int) -> FloatArray:
        """(N, 7) every gap, speed difference and way to come there that is tried, at each moment."""
        target, search = self.target, self._search
        gaps, differences = self._relations()
        if self.event.ttc_s is not None:  # whoever is behind is faster, or nobody closes in
            differences = differences[order * differences < 0.0]
        middle, wide = 0.5 * (gaps[0] + gaps[-1]), max(float(np.ptp(gaps)), 1.0)
        tried = np.arange(len(moments)), gaps, differences, self._accelerations(), self._later_speeds()
        moment, gap, d, a, later = (one.ravel() for one in np.meshgrid(*tried, indexing="ij"))
        at, late = np.array(moments, dtype=np.float64).reshape(-1, 2)[moment.astype(np.int64)].T
        step = at.astype(np.int64)
        off = (
            search.off_moment * late + search.off_gap * np.abs(gap - middle) / wide
            + search.off_difference * np.abs(d) + self._off_accelerations(a)
            + np.where(np.isnan(later), 0.0, search.off_later)
        )  # fmt: skip
        place = ahead[step] + order * (gap + self.lengths_m)
        return np.stack([at, place, gap, target.speed[step] + d, a, later, off], axis=1)

    def _accelerations(self) -> tuple[float, ...]:
        """Before the moment, m/s2; none, and nan: as the target moves."""
        return 0.0, math.nan, *self._search.accelerations_mps2

    def _later_speeds(self) -> tuple[float, ...]:
        """Speeds to which a vehicle goes afterwards, over that at the moment, m/s; nan: it keeps to the target."""
        return math.nan, 0.0, *self._search.later_mps

    def _off_acceleration(self, before_mps2: float) -> float:
        return float(self._off_accelerations(np.array(before_mps2)))

    def _off_accelerations(self, before_mps2: FloatArray) -> FloatArray:
        search = self._search
        return np.where(np.isnan(before_mps2), search.off_as_target, search.off_acceleration * np.abs(before_mps2))

    def _crossing_speeds(self, lane_id: int) -> tuple[float, ...]:
        """Speeds tried on a lane, m/s, by what its traffic drives."""
        scene, search = self.paths.scene, self._search
        pool = scene.lane_speeds.get(lane_id) or scene.scene_speeds
        usual = float(np.median(pool)) if pool else scene.config.spawn.prior_speed_mps
        return tuple(min(max(share * usual, search.slowest_mps), self._fastest_mps) for share in search.cross_speeds)

    def _is_apart(self, apart_s: float) -> bool:
        """Whether a time between the two centres at the conflict point is what is asked for, about."""
        asked, (least, most) = self.event.pet_s, self._search.cross_apart_s
        if asked is not None:
            least, most = (one + over for one, over in zip(asked, self._search.pet_apart_s, strict=True))
        return least <= apart_s <= most

    def _table(self, rows: FloatArray | Iterable[_Row]) -> tuple[Wanted, FloatArray]:
        """Motions of rows, without those too slow or too fast, and their scores."""
        table = np.asarray(rows if isinstance(rows, np.ndarray) else list(rows), dtype=np.float64).reshape(-1, 7)
        table = table[(table[:, 3] >= self._search.slowest_mps) & (table[:, 3] <= self._fastest_mps)]
        at, place, gap, speed, before, later, off = table.T
        return Wanted(at.astype(np.int64), place, gap, speed, before, np.maximum(speed + later, 0.5)), off

    def _rules(self, ahead: FloatArray | None, order: int, *, changes: bool = False) -> Rules:
        critical = self.paths.scene.config.conflict
        return Rules(
            order=order, lengths=self.lengths_m, changes=changes,
            brakes_mps2=self.event.brakes_mps2 if self.event.kind == "lead" else 0.0, target_mps=self.target.speed,
            ahead=ahead,
            ttc_s=max(critical.ttc_min_s, critical.follower_ttc_min_s) + self._search.ttc_spare_s,
            tau_s=max(self._search.taus_s),
            step_s=self.target.step_s, search=self._search,
        )  # fmt: skip
