"""The map and the geometry of the second checker: lanes with polygons, polylines, boxes. Nothing of the product.

Decisions: a lane without a centerline gets the mean of its boundaries; a lane's polygon is the ground between its
boundaries; lanes of every type can be driven; a lane is left or right of another where one of the two says so.
"""

import json
import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt
import shapely

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]


def turned(radians: npt.ArrayLike) -> Floats:
    """Angles in (-pi, pi]."""
    return np.asarray(np.angle(np.exp(1j * np.asarray(radians, dtype=np.float64))), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Line:
    """A polyline. xy: (N, 2) m, N >= 2, without repeated points."""

    xy: Floats

    @cached_property
    def steps(self) -> Floats:
        return np.diff(self.xy, axis=0)

    @cached_property
    def lengths(self) -> Floats:
        return np.hypot(*self.steps.T)

    @cached_property
    def start_m(self) -> Floats:
        return np.concatenate([[0.0], np.cumsum(self.lengths)])

    @property
    def length_m(self) -> float:
        return float(self.start_m[-1])

    def project(self, points: Floats) -> tuple[Floats, Floats]:
        """Arc length and offset to the left (P,) of the nearest points; beyond the ends s goes on straight."""
        points = np.atleast_2d(points)
        unit_x, unit_y = (self.steps / self.lengths[:, None]).T
        away_x, away_y = (points[:, None, axis] - self.xy[None, :-1, axis] for axis in (0, 1))
        along = away_x * unit_x + away_y * unit_y
        inside = np.clip(along, 0.0, self.lengths)
        nearest = np.argmin((away_x - inside * unit_x) ** 2 + (away_y - inside * unit_y) ** 2, axis=1)
        rows, last = np.arange(len(points)), len(self.lengths) - 1
        free, t = along[rows, nearest], inside[rows, nearest]
        beyond = ((nearest == 0) & (free < 0.0)) | ((nearest == last) & (free > self.lengths[nearest]))
        t = np.where(beyond, free, t)
        x, y, unit_x, unit_y = away_x[rows, nearest], away_y[rows, nearest], unit_x[nearest], unit_y[nearest]
        off = np.hypot(x - t * unit_x, y - t * unit_y)
        return self.start_m[nearest] + t, np.copysign(off, unit_x * y - unit_y * x)

    def at(self, s: npt.ArrayLike) -> tuple[Floats, Floats]:
        """Points (P, 2) and headings (P,) at arc lengths; straight on beyond the ends."""
        where = np.atleast_1d(np.asarray(s, dtype=np.float64))
        segment = np.clip(np.searchsorted(self.start_m, where, side="right") - 1, 0, len(self.lengths) - 1)
        unit = self.steps[segment] / self.lengths[segment][:, None]
        points = self.xy[segment] + (where - self.start_m[segment])[:, None] * unit
        return points, np.arctan2(unit[:, 1], unit[:, 0])


def line_of(points: Floats, *, least_m: float = 1e-3) -> Line | None:
    """A polyline through points that lie at least so far apart; None where nothing of it is left."""
    if (np.hypot(*np.diff(points, axis=0).T) >= least_m).all():
        return Line(np.array(points)) if len(points) > 1 else None
    kept = [points[0]]
    for point in points[1:]:
        if math.hypot(*(point - kept[-1])) >= least_m:
            kept.append(point)
    return Line(np.array(kept)) if len(kept) > 1 else None


@dataclass(frozen=True, eq=False)
class MapLane:
    """One lane segment; left, right: ids of the lanes beside it, of either direction; for_bikes: for them alone."""

    lane_id: int
    line: Line
    ground: shapely.Geometry
    in_intersection: bool
    for_bikes: bool
    successors: tuple[int, ...]
    left: int | None
    right: int | None

    @cached_property
    def turn_deg(self) -> float:
        """Net change of heading from its first to its last piece, to the left positive."""
        ends = self.line.at(np.array([0.0, self.line.length_m]))[1]
        return math.degrees(float(turned(ends[1] - ends[0])))


class SecondMap:
    """Lanes and drivable ground of one log_map_archive_*.json."""

    def __init__(self, path: Path) -> None:
        raw = json.loads(path.read_text())
        self.lanes = {int(one["id"]): _lane(one) for one in raw["lane_segments"].values()}
        rings = (_xy(one["area_boundary"]) for one in raw["drivable_areas"].values())
        self.drivable = shapely.union_all([shapely.make_valid(shapely.Polygon(ring)) for ring in rings])
        shapely.prepare(self.drivable)
        self.ids = list(self.lanes)
        self.tree = shapely.STRtree([self.lanes[lane_id].ground for lane_id in self.ids])
        self.predecessors = {
            after: [lane_id for lane_id in self.ids if after in self.lanes[lane_id].successors] for after in self.ids
        }

    def outside_m(self, points: Floats) -> Floats:
        """Distance of points (P, 2) from the drivable ground, 0 on it."""
        far = np.zeros(len(points))
        out = ~shapely.contains_xy(self.drivable, points)
        far[out] = shapely.distance(shapely.points(points[out]), self.drivable)
        return far

    def holding(self, points: Floats) -> list[list[int]]:
        """For each point the ids of the lanes whose ground it lies on."""
        found: list[list[int]] = [[] for _ in points]
        for point, lane in self.tree.query(shapely.points(points), predicate="intersects").T:
            found[point].append(self.ids[lane])
        return found

    def off_lane_deg(self, lane_id: int, points: Floats, headings: Floats) -> Floats:
        """Angle between headings and the lane's direction beside points, degrees."""
        line = self.lanes[lane_id].line
        s, _ = line.project(points)
        return np.degrees(np.abs(turned(line.at(np.clip(s, 0.0, line.length_m))[1] - headings)))

    def agreeing(self, points: Floats, headings: Floats, *, within_deg: float = 60.0) -> list[list[int]]:
        """For each point the lanes that it lies on and whose direction agrees with the heading."""
        rows, lanes = self.tree.query(shapely.points(points), predicate="intersects")
        off = np.zeros(len(rows))
        for lane in np.unique(lanes):
            mine = lanes == lane
            off[mine] = self.off_lane_deg(self.ids[lane], points[rows[mine]], headings[rows[mine]])
        found: list[list[int]] = [[] for _ in points]
        for row, lane in zip(rows[off <= within_deg], lanes[off <= within_deg], strict=True):
            found[row].append(self.ids[lane])
        return found

    def chain(self, lane_ids: Iterable[int], *, hops: int = 4) -> set[int]:
        """The lanes and those before and after them, so many joints away."""
        reached = {lane_id for lane_id in lane_ids if lane_id in self.lanes}
        for links in (lambda n: self.lanes[n].successors, lambda n: self.predecessors[n]):
            front = set(reached)
            for _ in range(hops):
                front = {after for lane_id in front for after in links(lane_id) if after in self.lanes}
                reached |= front
        return reached

    def beside(self, lane_id: int) -> set[int]:
        """Lanes of the same direction left and right of a lane, where one of the two says so."""
        lane = self.lanes[lane_id]
        middle, heading = lane.line.at(lane.line.length_m / 2)
        sides = {n for n, one in self.lanes.items() if n in (lane.left, lane.right) or lane_id in (one.left, one.right)}
        return {side for side in sides if self.off_lane_deg(side, middle, heading)[0] < 90.0}

    def onward(self, lane_id: int) -> int | None:
        """The successor that goes on most nearly straight."""
        ends = [after for after in self.lanes[lane_id].successors if after in self.lanes]
        return min(ends, key=lambda n: abs(self.lanes[n].turn_deg), default=None)


def _xy(points: list[dict[str, float]]) -> Floats:
    return np.array([(point["x"], point["y"]) for point in points], dtype=np.float64)


def _even(points: Floats, count: int) -> Floats:
    line = line_of(points)
    assert line is not None
    return line.at(np.linspace(0.0, line.length_m, count))[0]


def _lane(raw: dict[str, object]) -> MapLane:
    left, right = (_xy(raw[f"{side}_lane_boundary"]) for side in ("left", "right"))  # type: ignore[arg-type]
    middle = _xy(raw["centerline"]) if raw.get("centerline") else (_even(left, 20) + _even(right, 20)) / 2  # type: ignore[arg-type]
    line = line_of(middle)
    assert line is not None
    return MapLane(
        lane_id=int(raw["id"]), line=line,  # type: ignore[call-overload]
        ground=shapely.make_valid(shapely.Polygon(np.vstack([left, right[::-1]]))),
        in_intersection=bool(raw["is_intersection"]), for_bikes=raw["lane_type"] == "BIKE",
        successors=tuple(raw["successors"]),  # type: ignore[arg-type]
        left=raw["left_neighbor_id"], right=raw["right_neighbor_id"],  # type: ignore[arg-type]
    )  # fmt: skip


def box_corners(xy: Floats, heading: Floats, length_m: float, width_m: float) -> Floats:
    """Corners (T, 4, 2) of boxes with centres (T, 2) and headings (T,), counter-clockwise from the front left one."""
    ahead = np.column_stack([np.cos(heading), np.sin(heading)])
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    signs = ((1, 1), (-1, 1), (-1, -1), (1, -1))
    return np.stack([xy + a * length_m / 2 * ahead + b * width_m / 2 * left for a, b in signs], axis=1)


def contact_s(own: Floats, other: Floats, velocity: Floats) -> float:
    """Seconds until two convex quadrangles (4, 2) touch when the other one moves at a relative velocity; inf if never.

    Exact: on every axis across a side the shadows overlap during one interval of time; they touch where all do.
    """
    first, last = 0.0, math.inf
    for corners in (own, other):
        for k in (0, 1):
            side = corners[k + 1] - corners[k]
            axis = np.array([-side[1], side[0]]) / math.hypot(*side)
            a, b, speed = own @ axis, other @ axis, float(velocity @ axis)
            low, high = float(a.min() - b.max()), float(a.max() - b.min())  # moved so far, the shadows overlap
            if abs(speed) < 1e-9:
                if low > 0.0 or high < 0.0:
                    return math.inf
                continue
            enter, leave = sorted((low / speed, high / speed))
            first, last = max(first, enter), min(last, leave)
    return first if first <= last else math.inf
