"""A scene in the making, its lanes and agents, and its two files in the Argoverse 2 motion-forecasting format.

Local frame of a scene: metres, x east, y north; it is turned and moved into the frame of a city when it is written.
"""

import json
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pyarrow as pa

from bridge.recordings.export import parquet_bytes
from bridge.recordings.recording import AV_ID
from bridge.recordings.scenario import OBSERVED_STEPS, STEP_S, table_of
from hid2.agents import DEFAULT_SIZES, FOCAL_CATEGORY, FloatArray, IntArray, Track
from netconvert.geometry import wrap_angle

STEPS, FINE_S = 110, 0.01
LANE_M = 3.5
START_NS = 315_970_000_000_000_000.0


def smoothstep(u: FloatArray | float) -> FloatArray:
    """0 to 1 with two continuous derivatives, constant outside [0, 1]."""
    u = np.clip(u, 0.0, 1.0)
    return np.asarray(u * u * u * (10.0 + u * (6.0 * u - 15.0)))


@dataclass(frozen=True, eq=False)
class Path2d:
    """A densely sampled path. xy (N, 2) m; s (N,) m, arc length; heading (N,) rad, not wrapped."""

    xy: FloatArray
    s: FloatArray
    heading: FloatArray

    @classmethod
    def through(cls, xy: FloatArray) -> "Path2d":
        """The path along dense points."""
        ahead = np.gradient(xy, axis=0)
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1))])
        return cls(xy, s, np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0])))

    @classmethod
    def joined(cls, *parts: "Path2d") -> "Path2d":
        """One path along several that follow each other."""
        return cls.through(np.vstack([parts[0].xy, *(part.xy[1:] for part in parts[1:])]))

    def at(self, s: FloatArray, *, offset_m: FloatArray | float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Points (M, 2) and headings (M,) of the path at arc lengths, offset to the left."""
        heading = np.interp(s, self.s, self.heading)
        xy = np.column_stack([np.interp(s, self.s, self.xy[:, 0]), np.interp(s, self.s, self.xy[:, 1])])
        return xy + np.column_stack([-np.sin(heading), np.cos(heading)]) * np.reshape(offset_m, (-1, 1)), heading

    def reverse(self) -> "Path2d":
        """The same path driven the other way."""
        return Path2d.through(self.xy[::-1])


def line(start: Sequence[float], end: Sequence[float]) -> Path2d:
    """A straight path."""
    first, last = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    count = int(np.linalg.norm(last - first) / 0.02) + 2
    u = np.arange(count) / (count - 1)
    return Path2d.through(np.vstack([first + u[:-1, None] * (last - first), last]))


def bend(curvature: Callable[[FloatArray], FloatArray], length_m: float) -> Path2d:
    """A path from the origin, eastward at first, by its curvature (1/m) over arc length."""
    s = np.arange(int(length_m / 0.02) + 1) * 0.02
    heading = np.concatenate([[0.0], np.cumsum(curvature(s[:-1] + 0.01)) * 0.02])
    middle = (heading[:-1] + heading[1:]) / 2
    steps = np.column_stack([np.cos(middle), np.sin(middle)]) * 0.02
    return Path2d(np.vstack([[0.0, 0.0], np.cumsum(steps, axis=0)]), s, heading)


def turn(start: Sequence[float], start_to: Sequence[float], end: Sequence[float], end_to: Sequence[float]) -> Path2d:
    """A turn by 90 degrees between two points with unit directions.

    Its curvature rises, stays and falls (30, 40 and 30 % of the way) over the shorter leg; what the other leg is
    longer by is straight.
    """
    p, q, t, n = (np.asarray(value, dtype=np.float64) for value in (start, end, start_to, end_to))
    u = (np.arange(2000) + 0.5) / 2000
    heading = np.concatenate([[0.0], np.cumsum(np.clip(np.minimum(u, 1 - u) / 0.3, 0.0, 1.0))])
    heading = heading / heading[-1] * np.pi / 2
    middle = (heading[:-1] + heading[1:]) / 2
    along = np.concatenate([[0.0], np.cumsum(np.cos(middle))])
    across = np.concatenate([[0.0], np.cumsum(np.sin(middle))])
    legs = float((q - p) @ t), float((q - p) @ n)
    scale = min(legs) / float(along[-1])
    xy = p + scale * (along[:, None] * t + across[:, None] * n)
    longer = float(abs(legs[0] - legs[1]))
    if longer > 0.05:
        straight = (np.arange(int(longer / 0.02)) + 1)[:, None] * (longer / int(longer / 0.02))
        xy = np.vstack([xy, xy[-1] + straight * n] if legs[1] > legs[0] else [p, p + straight * t, xy[1:] + longer * t])
    xy[0], xy[-1] = p, q
    return Path2d.through(xy)


def sideways(base: Path2d, offset: Callable[[FloatArray], FloatArray] | float) -> Path2d:
    """The path at an offset to the left of another, constant or over its arc length."""
    offsets = offset(base.s) if callable(offset) else np.full(len(base.s), offset)
    normal = np.column_stack([-np.sin(base.heading), np.cos(base.heading)])
    return Path2d.through(base.xy + normal * offsets[:, None])


@dataclass
class Scene:
    """A scene in the making. height_m: ground height at local points (N, 2); turn and origin lead to the city frame.

    lanes: fields of the format by name, in local coordinates, with names of lanes for ids; agents: local.
    """

    name: str
    split: str
    city: str
    turn_rad: float
    origin: tuple[float, float]
    height_m: Callable[[FloatArray], FloatArray]
    first_id: int
    lanes: dict[str, dict[str, Any]] = field(default_factory=dict)
    areas: list[FloatArray] = field(default_factory=list)
    crossings: list[tuple[FloatArray, FloatArray]] = field(default_factory=list)
    agents: list[Track] = field(default_factory=list)

    @property
    def scenario_id(self) -> str:
        """UUID of the scene's name."""
        return _uuid(self.name)

    def add_lane(
        self, name: str, path: Path2d, between: tuple[float, float], *, marks: tuple[str, str],
        is_intersection: bool = False,
    ) -> None:  # fmt: skip
        """A lane segment along a stretch (m) of a path; 10 centreline points, boundaries as far apart as needed."""
        first, last = between
        centre, _ = path.at(first + (last - first) * np.arange(10) / 9)
        bent = float(np.ptp(path.heading))
        count = max(2, int((last - first) / (1.5 if is_intersection else 5.0)) + 1) if bent > 0.02 else 2
        stations = first + (last - first) * np.arange(count) / (count - 1)
        left, _ = path.at(stations, offset_m=LANE_M / 2)
        right, _ = path.at(stations, offset_m=-LANE_M / 2)
        self.lanes[name] = {
            "centerline": centre, "is_intersection": is_intersection, "left_lane_boundary": left,
            "left_lane_mark_type": marks[0], "left_neighbor_id": None, "predecessors": [],
            "right_lane_boundary": right, "right_lane_mark_type": marks[1], "right_neighbor_id": None, "successors": [],
        }  # fmt: skip

    def link(self, *names: str) -> None:
        """Lanes that follow each other."""
        for name, successor in pairwise(names):
            self.lanes[name]["successors"].append(successor)
            self.lanes[successor]["predecessors"].append(name)

    def side_by_side(self, left: str, right: str) -> None:
        """Two lanes of one direction, side by side."""
        self.lanes[left]["right_neighbor_id"], self.lanes[right]["left_neighbor_id"] = right, left

    def oncoming(self, one: str, other: str) -> None:
        """Two lanes of opposite directions; each is the other's left neighbour."""
        self.lanes[one]["left_neighbor_id"], self.lanes[other]["left_neighbor_id"] = other, one

    def drive(
        self,
        path: Path2d,
        start_m: float,
        speeds: float | Sequence[tuple[float, float]],
        *,
        object_type: str = "vehicle",
        category: int = 1,
        sway: int = 0,
        steps: tuple[int, int] = (0, STEPS),
        offset_m: float = 0.0,
        shift: tuple[float, float, float] | None = None,
    ) -> None:
        """An agent along a path from start_m (m) at time 0.

        speeds: m/s, or (time s, speed) knots; sway: phase of a small variation of speed, 0 for none; shift: (start s,
        end s, metres to the left) of a lane change.
        """
        time = np.arange(round(STEPS * STEP_S / FINE_S) + 11) * FINE_S - 10 * FINE_S  # from one step before
        knots = [(0.0, speeds), (1.0, speeds)] if isinstance(speeds, float | int) else list(speeds)
        speed = np.full(len(time), float(knots[0][1]))
        for (t0, v0), (t1, v1) in pairwise(knots):
            speed = speed + (v1 - v0) * smoothstep((time - t0) / (t1 - t0))
        if sway:
            speed = speed * (1.0 + 0.03 * _swing(0.55 * time + 0.9 * (sway % 7)))
        s = np.concatenate([[0.0], np.cumsum((speed[:-1] + speed[1:]) / 2 * FINE_S)])
        s = s - s[10] + start_m
        offset = np.full(len(time), offset_m)
        if sway:
            offset = offset + 0.08 * _swing(0.04 * s + (sway % 6)) * (speed / (speed + 2.0))
        if shift is not None:
            offset = offset + shift[2] * smoothstep((time - shift[0]) / (shift[1] - shift[0]))
        if s.min() < 0 or s[10 + 10 * (steps[1] - 1)] > path.s[-1]:
            raise ValueError(f"{self.name}: agent {len(self.agents)} leaves its path ({s.min():.1f} to {s.max():.1f})")
        xy, heading = path.at(s, offset_m=offset)
        velocity = np.gradient(xy, FINE_S, axis=0)
        moving = np.linalg.norm(velocity, axis=1) > 0.3
        course = np.arctan2(velocity[:, 1], velocity[:, 0])
        heading = np.where(moving, heading + wrap_angle(course - heading), heading)
        timesteps = np.arange(*steps)
        fine = 10 + 10 * timesteps
        self._add(object_type, category, timesteps, xy[fine], wrap_angle(heading[fine]), velocity[fine])

    def stand(self, xy: Sequence[float], heading: float, *, object_type: str = "vehicle", category: int = 1) -> None:
        """An agent that does not move."""
        position = np.tile(np.asarray(xy, dtype=np.float64), (STEPS, 1))
        self._add(object_type, category, np.arange(STEPS), position, np.full(STEPS, heading), np.zeros((STEPS, 2)))

    def _add(self, object_type: str, category: int, timesteps: IntArray, *motion: FloatArray) -> None:
        track_id = str(self.first_id // 1000 + 7 * len(self.agents))
        self.agents.append(Track(track_id, object_type, category, timesteps, *motion, size=DEFAULT_SIZES[object_type]))

    def turned(self, xy: FloatArray) -> FloatArray:
        """Local vectors in the city frame."""
        c, s = np.cos(self.turn_rad), np.sin(self.turn_rad)
        return np.column_stack([c * xy[:, 0] - s * xy[:, 1], s * xy[:, 0] + c * xy[:, 1]])

    def city_xy(self, xy: FloatArray) -> FloatArray:
        """Local points in the city frame."""
        return self.turned(xy) + np.asarray(self.origin)


def _swing(angle: FloatArray) -> FloatArray:
    """A sine by the first 22 terms of its series: what the scenes were made with, 3 cm off at 18 rad."""
    x = np.asarray(angle, dtype=np.float64)
    term, total = x, x
    for n in range(1, 22):
        term = -term * x * x / ((2 * n) * (2 * n + 1))
        total = total + term
    return total


def _uuid(name: str) -> str:
    return str(uuid.uuid5(uuid.NAMESPACE_URL, f"hid2-sumo/data/{name}"))


def map_json(scene: Scene) -> bytes:
    """log_map_archive_<id>.json."""

    def points(xy: FloatArray, *, flat: bool = False) -> list[dict[str, float]]:
        heights = np.zeros(len(xy)) if flat else scene.height_m(xy)
        return [
            {"x": round(float(x), 2), "y": round(float(y), 2), "z": round(float(z), 2)}
            for (x, y), z in zip(scene.city_xy(xy), heights, strict=True)
        ]

    ids = {name: scene.first_id + 37 * i for i, name in enumerate(scene.lanes)}

    def written(key: str, value: Any) -> Any:  # noqa: ANN401  # whatever a field holds
        if isinstance(value, np.ndarray):
            return points(value, flat=key == "centerline")
        return sorted(ids[name] for name in value) if isinstance(value, list) else ids.get(value, value)

    document: dict[str, dict[str, Any]] = {"drivable_areas": {}, "lane_segments": {}, "pedestrian_crossings": {}}
    for i, area in enumerate(scene.areas):
        area_id = scene.first_id // 10 + i
        document["drivable_areas"][str(area_id)] = {"area_boundary": points(area), "id": area_id}
    for name, lane in scene.lanes.items():
        known = {key: written(key, value) for key, value in lane.items()} | {"id": ids[name], "lane_type": "VEHICLE"}
        document["lane_segments"][str(ids[name])] = dict(sorted(known.items()))
    for i, (edge1, edge2) in enumerate(scene.crossings):
        crossing_id = scene.first_id // 10 + 500 + i
        crossing = {"edge1": points(edge1), "edge2": points(edge2), "id": crossing_id}
        document["pedestrian_crossings"][str(crossing_id)] = crossing
    return json.dumps(document).encode()


def scenario_parquet(scene: Scene) -> bytes:
    """scenario_<id>.parquet; the last agent is the AV, the one of category 3 is focal."""
    tracks = [
        replace(
            agent,
            position=scene.city_xy(agent.position).round(6),
            heading=wrap_angle(agent.heading + scene.turn_rad).round(6),
            velocity=scene.turned(agent.velocity).round(6) + 0.0,
        )
        for agent in scene.agents
    ]
    tracks[-1] = replace(tracks[-1], track_id=AV_ID)
    (focal,) = (track.track_id for track in tracks if track.category == FOCAL_CATEGORY)
    same = {"scenario_id": scene.scenario_id, "start_timestamp": START_NS, "num_timestamps": STEPS}
    same |= {"end_timestamp": START_NS + (STEPS - 1) * 1e8, "focal_track_id": focal, "city": scene.city}
    table = table_of(tracks, same, observed_steps=OBSERVED_STEPS)
    table = table.append_column("map_id", pa.repeat(pa.scalar(scene.first_id // 1000, pa.uint64()), len(table)))
    table = table.append_column("slice_id", pa.repeat(_uuid(f"{scene.name}/slice"), len(table)))
    return parquet_bytes(table)
