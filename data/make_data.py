"""Make the synthetic data set: three small scenes in exactly the Argoverse 2 motion-forecasting format.

    python data/make_data.py [OUT]          (default: data/av2 beside this file)

arterial      three lanes one way, some 320 m, with slow leaders and fast traffic; two lanes the other way
intersection  four arms, no signal: straight, left and right connectors; a bus, a left turn, a right turn, a yield
curve         two lanes one way and one the other on a curve; the right lane splits, and merges again

Every byte follows from this file. Local frame of a scene: metres, x east, y north; it is turned and moved into that of
a city when it is written.
"""

import json
import sys
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from bridge.recordings.export import parquet_bytes
from bridge.recordings.scenario import OBSERVED_STEPS, STEP_S, table_of
from hid2.agents import AV_ID, DEFAULT_SIZES, FOCAL_CATEGORY, FloatArray, IntArray, Track
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
    xy = p + min(legs) / float(along[-1]) * (along[:, None] * t + across[:, None] * n)
    longer = float(abs(legs[0] - legs[1]))
    if longer > 0.05:
        straight = (np.arange(int(longer / 0.02)) + 1)[:, None] * (longer / int(longer / 0.02))
        xy = np.vstack([xy, xy[-1] + straight * n] if legs[1] > legs[0] else [p, p + straight * t, xy[1:] + longer * t])
    xy[0], xy[-1] = p, q
    return Path2d.through(xy)


def sideways(base: Path2d, offset: Callable[[FloatArray], FloatArray] | float) -> Path2d:
    """The path at an offset to the left of another, constant or over its arc length."""
    offsets = offset(base.s) if callable(offset) else np.full(len(base.s), offset)
    return Path2d.through(base.xy + np.column_stack([-np.sin(base.heading), np.cos(base.heading)]) * offsets[:, None])


@dataclass
class SceneDraft:
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
        left_m: float | Sequence[tuple[float, float]] = 0.0,
    ) -> None:
        """An agent along a path from start_m (m) at time 0.

        speeds: m/s, and left_m: of the path, each a number or (time s, value) knots; sway: phase of a small variation
        of both, 0 for none.
        """
        time = np.arange(round(STEPS * STEP_S / FINE_S) + 11) * FINE_S - 10 * FINE_S  # from one step before
        speed, offset = _at_times(speeds, time), _at_times(left_m, time)
        if sway:
            speed = speed * (1.0 + 0.03 * _swing(0.55 * time + 0.9 * (sway % 7)))
        s = np.concatenate([[0.0], np.cumsum((speed[:-1] + speed[1:]) / 2 * FINE_S)])
        s = s - s[10] + start_m
        if sway:
            offset = offset + 0.08 * _swing(0.04 * s + (sway % 6)) * (speed / (speed + 2.0))
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


def _at_times(knots: float | Sequence[tuple[float, float]], time: FloatArray) -> FloatArray:
    """A value at times, s: a constant, or from knot (time s, value) to knot."""
    each = [(0.0, knots)] if isinstance(knots, float | int) else list(knots)
    found = np.full(len(time), float(each[0][1]))
    for (t0, v0), (t1, v1) in pairwise(each):
        found = found + (v1 - v0) * smoothstep((time - t0) / (t1 - t0))
    return found


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


def map_json(scene: SceneDraft) -> bytes:
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


def scenario_parquet(scene: SceneDraft) -> bytes:
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


def arterial() -> SceneDraft:
    """Three lanes one way (right, middle, left), two the other way, a parking strip at the right."""
    scene = SceneDraft("arterial", "train", "austin", 0.35, (1210.0, -640.0), slope(22.0, 0.012, -0.004), 310_100_000)
    base = bend(lambda s: 0.0012 * np.sin(s / 55.0), 322.0)
    there = {name: sideways(base, offset) for name, offset in {"r": 1.75, "m": 5.25, "l": 8.75}.items()}
    back = {name: sideways(base, offset).reverse() for name, offset in {"a": 12.25, "b": 15.75}.items()}
    cuts = [0.0, 48.0, 110.0, 172.0, 236.0, 288.0, 320.0]
    dash, solid, centre = "DASHED_WHITE", "SOLID_WHITE", "DOUBLE_SOLID_YELLOW"
    rows(scene, there, base, cuts, {"r": (dash, solid), "m": (dash, dash), "l": (centre, dash)})
    rows(scene, back, base, cuts, {"a": (centre, dash), "b": (dash, solid)})
    for i in range(len(cuts) - 1):
        scene.side_by_side(f"m{i}", f"r{i}")
        scene.side_by_side(f"l{i}", f"m{i}")
        scene.side_by_side(f"a{i}", f"b{i}")
        scene.oncoming(f"l{i}", f"a{i}")
    scene.areas.append(strip(base, (0.0, 320.0), left_m=18.3, right_m=-3.2))
    scene.crossings.append(crossing(base, 305.0, left_m=18.0, right_m=-3.0))

    drive, r, m, left = scene.drive, there["r"], there["m"], there["l"]
    drive(left, 20.0, 13.0, category=3, sway=1)  # the focal vehicle, fast
    drive(r, 92.0, 5.2, category=2, sway=2)  # slow leaders: with free lanes beside them they can be overtaken
    drive(m, 190.0, 5.4, category=2, sway=3)
    drive(m, 8.0, 12.2, category=2, sway=4)
    drive(r, 8.0, [(0.0, 11.5), (6.0, 11.5), (10.5, 7.0)], sway=5)  # slows behind the slow leader
    drive(left, 236.0, 13.5, category=0, sway=6, steps=(0, 62))  # leaves the scene
    drive(r, 218.0, 8.0, object_type="bus", sway=1)
    drive(r, 152.0, 4.2, object_type="cyclist", category=2, sway=2, left_m=-1.1)
    late(scene, left, 2.0, 14.0, appears=62)  # a track that appears late
    drive(back["a"], 30.0, 12.0, sway=3)
    drive(back["a"], 190.0, 11.5, sway=5, category=0, steps=(0, 104))
    drive(back["b"], 84.0, 9.5, sway=6, left_m=[(2.5, 0.0), (7.5, LANE_M)])  # changes lanes
    drive(back["b"], 20.0, 8.5, sway=2)
    drive(back["b"], 208.0, 9.0, sway=4)
    for i in range(7):  # the parked row
        xy, heading = base.at(np.array([104.0 + 6.8 * i]), offset_m=-1.35 - 0.06 * (i % 3))
        scene.stand(xy[0], float(heading[0]) + 0.01 * (i % 2), category=0 if i % 3 else 1)
    pedestrian(scene, sideways(base, -4.6), 120.0, 1.35, sway=1)
    pedestrian(scene, sideways(base, -5.4).reverse(), 150.0, 1.2, sway=3)
    pedestrian(scene, sideways(base, 19.6), 60.0, 1.5, sway=5)
    xy, heading = base.at(np.array([307.0]), offset_m=-4.4)
    scene.stand(xy[0], float(heading[0]) + 1.57, object_type="pedestrian", category=0)
    drive(m, 66.0, 12.3, sway=2)  # AV
    return scene


def _ground_of_intersection(scene: SceneDraft, reach: float) -> None:
    """Drivable area and pedestrian crossings."""
    outline = [(-reach, 7.8), (-13.6, 7.8), (-4.3, 15.1), (-4.3, reach)]  # a quarter: arm, corner, arm
    corners = [*outline, *[(-x, y) for x, y in reversed(outline)]]
    corners += [*[(-x, -y) for x, y in outline], *[(x, -y) for x, y in reversed(outline)]]
    parking = [(-36.0, -7.8), (-37.5, -10.2), (-82.0, -10.2), (-83.5, -7.8)]  # beside the eastbound lanes
    scene.areas.append(np.array([*corners[:-1], *parking, corners[-1]]))
    for sign in (1.0, -1.0):
        scene.crossings.append(
            (np.array([(-4.3, sign * 16.5), (4.3, sign * 16.5)]), np.array([(-4.3, sign * 19.5), (4.3, sign * 19.5)]))
        )


def intersection() -> SceneDraft:
    """Two lanes each way on the east-west road, one each way on the other; no signal; stop lines at 13.5 and 15 m."""
    scene = SceneDraft(
        "intersection", "val", "pittsburgh", -0.6, (2480.0, 1130.0), slope(41.0, -0.01, 0.015), 320_200_000
    )
    solid, dash, yellow, none = "SOLID_WHITE", "DASHED_WHITE", "DOUBLE_SOLID_YELLOW", "NONE"
    east, north, reach = 13.5, 15.0, 95.0
    half = LANE_M / 2
    arms = {  # approach: start, end of each lane towards the middle; the exit lanes are the approaches of the others
        "e": {"l": ((-reach, -half), (-east, -half)), "r": ((-reach, -3 * half), (-east, -3 * half))},
        "w": {"l": ((reach, half), (east, half)), "r": ((reach, 3 * half), (east, 3 * half))},
        "n": {"l": ((half, -reach), (half, -north))},
        "s": {"l": ((-half, reach), (-half, north))},
    }
    ways = {"e": (1.0, 0.0), "w": (-1.0, 0.0), "n": (0.0, 1.0), "s": (0.0, -1.0)}
    paths: dict[str, Path2d] = {}
    for way, lanes in arms.items():
        for lane, (far, near) in lanes.items():
            paths[f"{way}{lane}_in"] = line(far, near)
            paths[f"{way}{lane}_out"] = line(*[(-x, y) if way in "ew" else (x, -y) for x, y in (near, far)])
    for name, path in paths.items():
        inward, lane = name.endswith("_in"), name[1]
        single, length = name[0] in "ns", float(path.s[-1])
        cuts = [0.0, length - 32.0, length] if inward else [0.0, 32.0, length]
        for i in range(2):
            near = i == (1 if inward else 0)
            between = solid if near else dash  # no lane changes close to the middle
            marks = (yellow, solid) if single else (yellow, between) if lane == "l" else (between, solid)
            scene.add_lane(f"{name}{i}", path, (cuts[i], cuts[i + 1]), marks=marks)
        scene.link(f"{name}0", f"{name}1")
    for way in "ew":
        for part in ("in0", "in1", "out0", "out1"):
            scene.side_by_side(f"{way}l_{part}", f"{way}r_{part}")
    for one, other in (("el_in", "wl_out"), ("wl_in", "el_out"), ("nl_in", "sl_out"), ("sl_in", "nl_out")):
        for i in range(2):
            scene.oncoming(f"{one}{i}", f"{other}{1 - i}")
    left_of, right_of = {"e": "n", "n": "w", "w": "s", "s": "e"}, {"e": "s", "s": "w", "w": "n", "n": "e"}
    connectors = []
    for way in "ewns":
        single = way in "ns"
        straight = ["l"] if single else ["l", "r"]
        connectors += [(way, lane, way, lane, "straight") for lane in straight]
        connectors.append((way, "l", left_of[way], "l", "left"))
        connectors.append((way, "l" if single else "r", right_of[way], "r" if single else "l", "right"))
    for way, lane, to, to_lane, kind in connectors:
        start, end = paths[f"{way}{lane}_in"].xy[-1], paths[f"{to}{to_lane}_out"].xy[0]
        name = f"{way}{lane}_{kind}"
        paths[name] = line(start, end) if kind == "straight" else turn(start, ways[way], end, ways[to])
        scene.add_lane(name, paths[name], (0.0, float(paths[name].s[-1])), marks=(none, none), is_intersection=True)
        scene.link(f"{way}{lane}_in1", name, f"{to}{to_lane}_out0")
    for way in "ew":
        scene.side_by_side(f"{way}l_straight", f"{way}r_straight")
    _ground_of_intersection(scene, reach)

    def route(*names: str) -> Path2d:
        return Path2d.joined(*(paths[name] for name in names))

    drive, focal = scene.drive, route("wl_in", "wl_left", "sl_out")
    drive(focal, 62.0, [(0.0, 8.5), (3.0, 5.3), (6.4, 5.3), (9.6, 9.0)], category=3)  # turns left ahead of the AV
    right_turn = [(0.0, 9.0), (2.0, 9.0), (6.0, 4.2), (10.0, 4.2), (13.0, 6.5)]
    drive(route("er_in", "er_right", "sl_out"), 32.0, right_turn, category=2, sway=1)
    drive(route("wl_in", "wl_straight", "wl_out"), 22.0, 8.5, object_type="bus", category=2, sway=3)
    drive(route("wr_in", "wr_straight", "wr_out"), 68.0, 4.6, object_type="cyclist", category=2, sway=2, left_m=-1.0)
    drive(route("nl_in", "nl_right", "er_out"), 72.0, [(0.0, 0.0), (7.4, 0.0), (11.0, 4.0), (12.0, 4.2)])  # yields
    drive(route("nl_in"), 42.0, [(0.0, 6.5), (5.5, 0.0)], sway=0)  # queues behind it
    drive(route("sl_in"), 36.0, [(0.0, 8.2), (1.0, 8.2), (7.5, 0.0)], category=2)  # stops for the crossing pedestrians
    drive(route("el_in", "el_straight", "el_out"), 112.0, 11.5, category=0, sway=4, steps=(0, 66))  # leaves the scene
    drive(paths["wr_out"], 24.0, 9.5, category=0, sway=5, steps=(0, 60))
    drive(paths["nl_out"], 14.0, 8.0, category=0, sway=6, steps=(0, 81))
    late(scene, route("wr_in", "wr_straight"), 6.0, 10.0, appears=56)  # a track that appears late
    for i in range(6):  # the parked row
        scene.stand((-78.0 + 6.9 * i, -8.95 - 0.05 * (i % 2)), 0.01 * (i % 3), category=0 if i % 2 else 1)
    pedestrian(scene, line((-7.0, 17.6), (12.0, 17.6)), 0.6, 1.2, sway=1)
    pedestrian(scene, line((7.0, 18.6), (-12.0, 18.6)), 0.9, 1.1, sway=4)
    pedestrian(scene, line((-70.0, 9.2), (-20.0, 9.2)), 4.0, 1.4, sway=2)
    drive(route("el_in", "el_straight", "el_out"), 4.0, 9.9, sway=2)  # AV
    return scene


def curve() -> SceneDraft:
    """Left and right lane one way, one lane the other way; a branch leaves the right lane and comes back."""
    scene = SceneDraft("curve", "train", "miami", 1.9, (5230.0, 870.0), slope(-24.0, 0.004, 0.003), 330_300_000)
    base = bend(lambda s: (smoothstep(s / 50.0) - smoothstep((s - 235.0) / 50.0)) / 105.0, 302.0)

    def branch_offset(s: FloatArray) -> FloatArray:
        return -1.75 - 8.5 * (smoothstep((s - 72.0) / 58.0) - smoothstep((s - 172.0) / 58.0))

    left, right, back = sideways(base, 1.75), sideways(base, -1.75), sideways(base, 5.25).reverse()
    branch = sideways(base, branch_offset)
    dash, solid, yellow, none = "DASHED_WHITE", "SOLID_WHITE", "DASHED_YELLOW", "NONE"
    cuts = [0.0, 36.0, 72.0, 130.0, 172.0, 230.0, 268.0, 300.0]
    rows(scene, {"l": left, "r": right}, base, cuts, {"l": (yellow, dash), "r": (dash, solid)})
    rows(scene, {"o": back}, base, cuts, {"o": (yellow, solid)})
    for i in range(len(cuts) - 1):
        scene.side_by_side(f"l{i}", f"r{i}")
        scene.oncoming(f"l{i}", f"o{i}")
    for name in ("r2", "r4"):
        scene.lanes[name]["right_lane_mark_type"] = none
    for i in (2, 3, 4):
        ends = stations(base, branch, cuts[i : i + 2])
        scene.add_lane(f"f{i}", branch, (ends[0], ends[1]), marks=(none if i != 3 else solid, solid))
    scene.link("r1", "f2", "f3", "f4", "r5")
    for i in (2, 4):  # where the branch starts and ends, it does so at the right lane's own points
        end = 0 if i == 2 else -1
        scene.lanes[f"f{i}"]["centerline"][end] = scene.lanes[f"r{i}"]["centerline"][end]
    scene.areas.append(strip(base, (0.0, 300.0), left_m=8.2, right_m=-4.4))
    ends = stations(base, branch, [66.0, 236.0])
    scene.areas.append(strip(branch, (ends[0], ends[1]), left_m=2.4, right_m=-4.9))
    scene.crossings.append(crossing(base, 255.0, left_m=8.0, right_m=-4.2))

    drive = scene.drive
    drive(branch, 58.0, 8.8, category=3, sway=1)  # the focal vehicle takes the branch
    drive(branch, 142.0, [(0.0, 7.0), (5.0, 8.5)], category=2, sway=2)  # merges
    drive(right, 88.0, 7.2, object_type="bus", category=2, sway=3)
    drive(right, 38.0, 6.2, category=2, sway=4)
    drive(right, 192.0, 9.2, sway=5)
    drive(left, 6.0, 10.5, sway=6)
    drive(left, 150.0, 10.8, sway=1)
    drive(right, 8.0, 4.4, object_type="cyclist", category=2, sway=2, left_m=-1.1)
    drive(back, 24.0, 10.0, sway=4)
    drive(back, 96.0, 10.4, sway=2)
    drive(back, 150.0, 9.8, sway=3)
    late(scene, back, 3.0, 10.0, appears=58)  # a track that appears late
    for i in range(6):  # the parked row, beside the branch
        at = stations(base, branch, [118.0 + 7.2 * i])[0]
        xy, heading = branch.at(np.array([at]), offset_m=-3.15 - 0.05 * (i % 2))
        scene.stand(xy[0], float(heading[0]), category=0 if i % 2 else 1)
    pedestrian(scene, sideways(base, -16.8), 100.0, 1.3, sway=1)
    pedestrian(scene, sideways(base, 9.4), 140.0, 1.45, sway=3)
    pedestrian(scene, sideways(base, 9.9).reverse(), 80.0, 1.2, sway=5)
    drive(left, 52.0, 10.2, sway=2)  # AV
    return scene


def slope(z_m: float, x_grade: float, y_grade: float) -> Callable[[FloatArray], FloatArray]:
    """Ground that rises evenly."""
    return lambda xy: z_m + x_grade * xy[:, 0] + y_grade * xy[:, 1]


def stations(base: Path2d, path: Path2d, at: Sequence[float]) -> list[float]:
    """Arc lengths on a sideways path abreast of arc lengths on its base (or on the base's reverse)."""
    index = [round(station / 0.02) for station in at]
    if np.linalg.norm(path.xy[0] - base.xy[0]) > np.linalg.norm(path.xy[0] - base.xy[-1]):
        return [float(path.s[len(base.s) - 1 - i]) for i in index]
    return [float(path.s[i]) for i in index]


def rows(
    scene: SceneDraft, paths: dict[str, Path2d], base: Path2d, cuts: Sequence[float], marks: dict[str, tuple[str, str]]
) -> None:
    """Cut lanes abreast of each other at the same places of the base; number i lies between cuts i and i + 1."""
    for name, path in paths.items():
        ends, names = stations(base, path, cuts), [f"{name}{i}" for i in range(len(cuts) - 1)]
        for lane, between in zip(names, pairwise(ends), strict=True):
            scene.add_lane(lane, path, (min(between), max(between)), marks=marks[name])
        scene.link(*(names if ends[0] < ends[-1] else reversed(names)))


def strip(base: Path2d, between: tuple[float, float], *, left_m: float, right_m: float) -> FloatArray:
    """The outline of the ground between two offsets of a path."""
    count = max(2, int((between[1] - between[0]) / 5))
    at = between[0] + (between[1] - between[0]) * np.arange(count) / (count - 1)
    return np.vstack([base.at(at, offset_m=left_m)[0], base.at(at[::-1], offset_m=right_m)[0]])


def crossing(base: Path2d, at_m: float, *, left_m: float, right_m: float) -> tuple[FloatArray, FloatArray]:
    """The two edges of a pedestrian crossing, 3 m apart."""
    ends = left_m, right_m
    first, last = (np.vstack([base.at(np.array([s]), offset_m=m)[0] for m in ends]) for s in (at_m, at_m + 3.0))
    return first, last


def late(scene: SceneDraft, path: Path2d, start_m: float, speed: float, *, appears: int) -> None:
    """A vehicle first seen at a later timestep, at start_m."""
    before = line(path.xy[0] - 200.0 * np.array([np.cos(path.heading[0]), np.sin(path.heading[0])]), path.xy[0])
    longer = Path2d.joined(before, path)
    scene.drive(longer, 200.0 + start_m - speed * appears * STEP_S, speed, category=0, steps=(appears, STEPS))


def pedestrian(scene: SceneDraft, path: Path2d, start_m: float, speed: float, *, sway: int) -> None:
    """A pedestrian along a path."""
    scene.drive(path, start_m, speed, object_type="pedestrian", sway=sway)


def make(out_dir: Path) -> list[Path]:
    """Write the data set under out_dir; returns the scenario folders."""
    folders = []
    for scene in (arterial(), intersection(), curve()):
        folder = out_dir / scene.split / scene.scenario_id
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"log_map_archive_{scene.scenario_id}.json").write_bytes(map_json(scene))
        (folder / f"scenario_{scene.scenario_id}.parquet").write_bytes(scenario_parquet(scene))
        folders.append(folder)
    return folders


if __name__ == "__main__":
    for made in make(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "av2"):
        print(made)
