"""Make the synthetic data set: three small scenes in exactly the Argoverse 2 motion-forecasting format.

    python data/make_data.py [OUT]          (default: data/av2 beside this file)

arterial      three lanes one way, some 320 m, with slow leaders and fast traffic; two lanes the other way
intersection  four arms, no signal: straight, left and right connectors; a bus, a left turn, a right turn, a yield
curve         two lanes one way and one the other on a curve; the right lane splits, and merges again

Every byte follows from this file: sines and angles are computed from sums and products alone, because those of the
platform's mathematical library may differ in the last bit. Local frame of a scene: metres, x east, y north; it is
turned and moved into the frame of a city when it is written.
"""

import json
import sys
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from bridge.export import parquet_bytes

FloatArray = npt.NDArray[np.float64]

STEPS, OBSERVED, STEP_S, FINE_S = 110, 50, 0.1, 0.01
LANE_M = 3.5
PI = 3.141592653589793
START_NS = 315_970_000_000_000_000.0


# Numbers that are the same on every machine ---------------------------------------------------------------------------


def sin(angle: FloatArray | float) -> FloatArray:
    """Sine by its series, |angle| below 8 rad."""
    x = np.asarray(angle, dtype=np.float64)
    term, total = x, x
    for n in range(1, 22):
        term = -term * x * x / ((2 * n) * (2 * n + 1))
        total = total + term
    return total


def cos(angle: FloatArray | float) -> FloatArray:
    """Cosine by its series, |angle| below 8 rad."""
    x = np.asarray(angle, dtype=np.float64)
    term, total = np.ones_like(x), np.ones_like(x)
    for n in range(1, 22):
        term = -term * x * x / ((2 * n - 1) * (2 * n))
        total = total + term
    return total


def norm(xy: FloatArray) -> FloatArray:
    """Lengths of vectors (..., 2)."""
    return np.asarray(np.sqrt(xy[..., 0] * xy[..., 0] + xy[..., 1] * xy[..., 1]))


def direction(xy: FloatArray) -> FloatArray:
    """Angles of vectors (..., 2) in [-pi, pi], by Newton's method from a rough start."""
    length = norm(xy)
    c = np.where(length > 0, xy[..., 0], 1.0) / np.where(length > 0, length, 1.0)
    s = xy[..., 1] / np.where(length > 0, length, 1.0)
    rough = s / (np.abs(c) + np.abs(s)) * PI / 2
    angle = np.where(c >= 0, rough, np.where(s >= 0, PI, -PI) - rough)
    for _ in range(6):
        angle = angle + s * cos(angle) - c * sin(angle)
    return angle


def smoothstep(u: FloatArray | float) -> FloatArray:
    """0 to 1 with two continuous derivatives, constant outside [0, 1]."""
    u = np.clip(u, 0.0, 1.0)
    return np.asarray(u * u * u * (10.0 + u * (6.0 * u - 15.0)))


# Paths ----------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Path2d:
    """A densely sampled path. xy (N, 2) m; s (N,) m, arc length; heading (N,) rad, not wrapped."""

    xy: FloatArray
    s: FloatArray
    heading: FloatArray

    @classmethod
    def through(cls, xy: FloatArray) -> "Path2d":
        """The path along dense points."""
        s = np.concatenate([[0.0], np.cumsum(norm(np.diff(xy, axis=0)))])
        heading = direction(np.gradient(xy, axis=0))
        turns = np.diff(heading)
        jumps = np.cumsum(np.where(turns > PI, -2 * PI, 0.0) + np.where(turns < -PI, 2 * PI, 0.0))
        return cls(xy, s, heading + np.concatenate([[0.0], jumps]))

    @classmethod
    def joined(cls, *parts: "Path2d") -> "Path2d":
        """One path along several that follow each other."""
        return cls.through(np.vstack([parts[0].xy, *(part.xy[1:] for part in parts[1:])]))

    def at(self, s: FloatArray, *, offset_m: FloatArray | float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Points (M, 2) and headings (M,) of the path at arc lengths, offset to the left."""
        heading = np.interp(s, self.s, self.heading)
        xy = np.column_stack([np.interp(s, self.s, self.xy[:, 0]), np.interp(s, self.s, self.xy[:, 1])])
        return xy + np.column_stack([-sin(heading), cos(heading)]) * np.reshape(offset_m, (-1, 1)), heading

    def reverse(self) -> "Path2d":
        """The same path driven the other way."""
        return Path2d.through(self.xy[::-1])


def line(start: Sequence[float], end: Sequence[float]) -> Path2d:
    """A straight path."""
    first, last = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    count = int(norm(last - first) / 0.02) + 2
    u = np.arange(count) / (count - 1)
    return Path2d.through(np.vstack([first + u[:-1, None] * (last - first), last]))


def bend(curvature: Callable[[FloatArray], FloatArray], length_m: float) -> Path2d:
    """A path from the origin, eastward at first, by its curvature (1/m) over arc length."""
    s = np.arange(int(length_m / 0.02) + 1) * 0.02
    heading = np.concatenate([[0.0], np.cumsum(curvature(s[:-1] + 0.01)) * 0.02])
    middle = (heading[:-1] + heading[1:]) / 2
    steps = np.column_stack([cos(middle), sin(middle)]) * 0.02
    return Path2d(np.vstack([[0.0, 0.0], np.cumsum(steps, axis=0)]), s, heading)


def turn(start: Sequence[float], start_to: Sequence[float], end: Sequence[float], end_to: Sequence[float]) -> Path2d:
    """A turn by 90 degrees between two points with unit directions.

    Its curvature rises, stays and falls (30, 40 and 30 % of the way) over the shorter leg; what the other leg is
    longer by is straight.
    """
    p, q, t, n = (np.asarray(value, dtype=np.float64) for value in (start, end, start_to, end_to))
    u = (np.arange(2000) + 0.5) / 2000
    heading = np.concatenate([[0.0], np.cumsum(np.clip(np.minimum(u, 1 - u) / 0.3, 0.0, 1.0))])
    heading = heading / heading[-1] * PI / 2
    middle = (heading[:-1] + heading[1:]) / 2
    along = np.concatenate([[0.0], np.cumsum(cos(middle))])
    across = np.concatenate([[0.0], np.cumsum(sin(middle))])
    legs = float((q - p) @ t), float((q - p) @ n)
    scale = min(legs) / float(along[-1])
    xy = p + scale * (along[:, None] * t + across[:, None] * n)
    longer = float(abs(legs[0] - legs[1]))
    if longer > 0.05:
        straight = (np.arange(int(longer / 0.02)) + 1)[:, None] * (longer / int(longer / 0.02))
        xy = (
            np.vstack([xy, xy[-1] + straight * n])
            if legs[1] > legs[0]
            else np.vstack([p, p + straight * t, xy[1:] + longer * t])
        )
    xy[0], xy[-1] = p, q
    return Path2d.through(xy)


def sideways(base: Path2d, offset: Callable[[FloatArray], FloatArray] | float) -> Path2d:
    """The path at an offset to the left of another, constant or over its arc length."""
    offsets = offset(base.s) if callable(offset) else np.full(len(base.s), offset)
    normal = np.column_stack([-sin(base.heading), cos(base.heading)])
    return Path2d.through(base.xy + normal * offsets[:, None])


# Scene ----------------------------------------------------------------------------------------------------------------


@dataclass
class Lane:
    """A lane segment in the making; points are local."""

    centerline: FloatArray
    left: FloatArray
    right: FloatArray
    is_intersection: bool
    left_mark: str
    right_mark: str
    successors: list[str] = field(default_factory=list)
    left_neighbor: str | None = None
    right_neighbor: str | None = None


@dataclass(frozen=True, eq=False)
class Agent:
    """A recorded agent: timesteps (T,), position (T, 2) m, heading (T,) rad, velocity (T, 2) m/s, local."""

    object_type: str
    category: int
    timesteps: npt.NDArray[np.int64]
    position: FloatArray
    heading: FloatArray
    velocity: FloatArray


@dataclass
class Scene:
    """A scene in the making. height_m: ground height at local points (N, 2); turn and origin lead to the city frame."""

    name: str
    split: str
    city: str
    turn_rad: float
    origin: tuple[float, float]
    height_m: Callable[[FloatArray], FloatArray]
    first_id: int
    lanes: dict[str, Lane] = field(default_factory=dict)
    areas: list[FloatArray] = field(default_factory=list)
    crossings: list[tuple[FloatArray, FloatArray]] = field(default_factory=list)
    agents: list[Agent] = field(default_factory=list)

    @property
    def scenario_id(self) -> str:
        """UUID of the scene's name."""
        return str(uuid.uuid5(uuid.NAMESPACE_URL, f"hid2-sumo/data/{self.name}"))

    def add_lane(
        self,
        name: str,
        path: Path2d,
        between: tuple[float, float],
        *,
        marks: tuple[str, str] = ("NONE", "NONE"),
        is_intersection: bool = False,
        width_m: float = LANE_M,
    ) -> None:
        """A lane segment along a stretch (m) of a path; 10 centreline points, boundaries as far apart as needed."""
        first, last = between
        centre, _ = path.at(first + (last - first) * np.arange(10) / 9)
        bent = float(np.ptp(path.heading))
        count = max(2, int((last - first) / (1.5 if is_intersection else 5.0)) + 1) if bent > 0.02 else 2
        stations = first + (last - first) * np.arange(count) / (count - 1)
        left, _ = path.at(stations, offset_m=width_m / 2)
        right, _ = path.at(stations, offset_m=-width_m / 2)
        self.lanes[name] = Lane(centre, left, right, is_intersection, *marks)

    def link(self, name: str, *successors: str) -> None:
        """Successors of a lane."""
        self.lanes[name].successors += successors

    def side_by_side(self, left: str, right: str) -> None:
        """Two lanes of one direction, side by side."""
        self.lanes[left].right_neighbor, self.lanes[right].left_neighbor = right, left

    def oncoming(self, one: str, other: str) -> None:
        """Two lanes of opposite directions; each is the other's left neighbour."""
        self.lanes[one].left_neighbor, self.lanes[other].left_neighbor = other, one

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
            speed = speed * (1.0 + 0.03 * sin(0.55 * time + 0.9 * (sway % 7)))
        s = np.concatenate([[0.0], np.cumsum((speed[:-1] + speed[1:]) / 2 * FINE_S)])
        s = s - s[10] + start_m
        offset = np.full(len(time), offset_m)
        if sway:
            offset = offset + 0.08 * sin(0.04 * s + (sway % 6)) * (speed / (speed + 2.0))
        if shift is not None:
            offset = offset + shift[2] * smoothstep((time - shift[0]) / (shift[1] - shift[0]))
        if s.min() < 0 or s[10 + 10 * (steps[1] - 1)] > path.s[-1]:
            raise ValueError(f"{self.name}: agent {len(self.agents)} leaves its path ({s.min():.1f} to {s.max():.1f})")
        xy, heading = path.at(s, offset_m=offset)
        velocity = np.gradient(xy, FINE_S, axis=0)
        moving = norm(velocity) > 0.3
        course = direction(velocity)
        heading = np.where(moving, heading + wrap(course - heading), heading)
        timesteps = np.arange(*steps)
        fine = 10 + 10 * timesteps
        self.agents.append(Agent(object_type, category, timesteps, xy[fine], wrap(heading[fine]), velocity[fine]))

    def stand(self, xy: Sequence[float], heading: float, *, object_type: str = "vehicle", category: int = 1) -> None:
        """An agent that does not move."""
        self.agents.append(
            Agent(
                object_type,
                category,
                np.arange(STEPS),
                np.tile(np.asarray(xy, dtype=np.float64), (STEPS, 1)),
                np.full(STEPS, heading),
                np.zeros((STEPS, 2)),
            )
        )

    def city_xy(self, xy: FloatArray) -> FloatArray:
        """Local points or, less the origin, vectors in the city frame."""
        c, s = float(cos(self.turn_rad)), float(sin(self.turn_rad))
        turned = np.column_stack([c * xy[:, 0] - s * xy[:, 1], s * xy[:, 0] + c * xy[:, 1]])
        return turned + np.asarray(self.origin)


def wrap(angle: FloatArray) -> FloatArray:
    """Angles in (-pi, pi]."""
    return np.asarray(angle + 2 * PI * np.floor((PI - angle) / (2 * PI)))


# The three scenes -----------------------------------------------------------------------------------------------------


def arterial() -> Scene:
    """Three lanes one way (right, middle, left), two the other way, a parking strip at the right."""
    scene = Scene("arterial", "train", "austin", 0.35, (1210.0, -640.0), slope(22.0, 0.012, -0.004), 310_100_000)
    base = bend(lambda s: 0.0012 * sin(s / 55.0), 322.0)
    lanes = {"r": 1.75, "m": 5.25, "l": 8.75}
    there = {name: sideways(base, offset) for name, offset in lanes.items()}
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
    drive(r, 152.0, 4.2, object_type="cyclist", category=2, sway=2, offset_m=-1.1)
    late(scene, left, 2.0, 14.0, appears=62)  # a track that appears late
    drive(back["a"], 30.0, 12.0, sway=3)
    drive(back["a"], 190.0, 11.5, sway=5, category=0, steps=(0, 104))
    drive(back["b"], 84.0, 9.5, sway=6, shift=(2.5, 7.5, LANE_M))  # changes lanes
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


def intersection() -> Scene:
    """Two lanes each way on the east-west road, one each way on the other; no signal; stop lines at 13.5 and 15 m."""
    scene = Scene("intersection", "val", "pittsburgh", -0.6, (2480.0, 1130.0), slope(41.0, -0.01, 0.015), 320_200_000)
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
            mirrored = [(-x, y) if way in "ew" else (x, -y) for x, y in (near, far)]
            paths[f"{way}{lane}_out"] = line(*mirrored)
    for name, path in paths.items():
        inward, lane = name.endswith("_in"), name[1]
        single = name[0] in "ns"
        length = float(path.s[-1])
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
        scene.link(f"{way}{lane}_in1", name)
        scene.link(name, f"{to}{to_lane}_out0")
    for way in "ew":
        scene.side_by_side(f"{way}l_straight", f"{way}r_straight")
    outline = [(-reach, 7.8), (-13.6, 7.8), (-4.3, 15.1), (-4.3, reach)]  # a quarter: arm, corner, arm
    corners = [*outline, *[(-x, y) for x, y in reversed(outline)]]
    corners += [*[(-x, -y) for x, y in outline], *[(x, -y) for x, y in reversed(outline)]]
    parking = [(-36.0, -7.8), (-37.5, -10.2), (-82.0, -10.2), (-83.5, -7.8)]  # beside the eastbound lanes
    scene.areas.append(np.array([*corners[:-1], *parking, corners[-1]]))
    for sign in (1.0, -1.0):
        scene.crossings.append((np.array([(-4.3, sign * 16.5), (4.3, sign * 16.5)]),
                                np.array([(-4.3, sign * 19.5), (4.3, sign * 19.5)])))  # fmt: skip

    def route(*names: str) -> Path2d:
        return Path2d.joined(*(paths[name] for name in names))

    drive = scene.drive
    focal = route("wl_in", "wl_left", "sl_out")
    drive(focal, 62.0, [(0.0, 8.5), (3.0, 5.3), (6.4, 5.3), (9.6, 9.0)], category=3)  # turns left ahead of the AV
    right_turn = [(0.0, 9.0), (2.0, 9.0), (6.0, 4.2), (10.0, 4.2), (13.0, 6.5)]
    drive(route("er_in", "er_right", "sl_out"), 32.0, right_turn, category=2, sway=1)
    drive(route("wl_in", "wl_straight", "wl_out"), 22.0, 8.5, object_type="bus", category=2, sway=3)
    drive(route("wr_in", "wr_straight", "wr_out"), 68.0, 4.6, object_type="cyclist", category=2, sway=2, offset_m=-1.0)
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


def curve() -> Scene:
    """Left and right lane one way, one lane the other way; a branch leaves the right lane and comes back."""
    scene = Scene("curve", "train", "miami", 1.9, (5230.0, 870.0), slope(-24.0, 0.004, 0.003), 330_300_000)
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
        scene.lanes[name].right_mark = none
    for i in (2, 3, 4):
        ends = stations(base, branch, cuts[i : i + 2])
        scene.add_lane(f"f{i}", branch, (ends[0], ends[1]), marks=(none if i != 3 else solid, solid))
    scene.link("r1", "f2")
    scene.link("f2", "f3")
    scene.link("f3", "f4")
    scene.link("f4", "r5")
    for i in (2, 4):  # where the branch starts and ends, it does so at the right lane's own points
        scene.lanes[f"f{i}"].centerline[0 if i == 2 else -1] = scene.lanes[f"r{i}"].centerline[0 if i == 2 else -1]
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
    drive(right, 8.0, 4.4, object_type="cyclist", category=2, sway=2, offset_m=-1.1)
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
    if float(norm(path.xy[0] - base.xy[0])) > float(norm(path.xy[0] - base.xy[-1])):
        return [float(path.s[len(base.s) - 1 - i]) for i in index]
    return [float(path.s[i]) for i in index]


def rows(
    scene: Scene,
    paths: dict[str, Path2d],
    base: Path2d,
    cuts: Sequence[float],
    marks: dict[str, tuple[str, str]],
) -> None:
    """Cut lanes abreast of each other at the same places of the base; number i lies between cuts i and i + 1."""
    for name, path in paths.items():
        ends = stations(base, path, cuts)
        reverse = ends[0] > ends[-1]
        for i in range(len(cuts) - 1):
            between = (ends[i + 1], ends[i]) if reverse else (ends[i], ends[i + 1])
            scene.add_lane(f"{name}{i}", path, between, marks=marks[name])
        for i in range(len(cuts) - 2):
            one, other = (i + 1, i) if reverse else (i, i + 1)
            scene.link(f"{name}{one}", f"{name}{other}")


def strip(base: Path2d, between: tuple[float, float], *, left_m: float, right_m: float) -> FloatArray:
    """The outline of the ground between two offsets of a path."""
    count = max(2, int((between[1] - between[0]) / 5))
    at = between[0] + (between[1] - between[0]) * np.arange(count) / (count - 1)
    return np.vstack([base.at(at, offset_m=left_m)[0], base.at(at[::-1], offset_m=right_m)[0]])


def crossing(base: Path2d, at_m: float, *, left_m: float, right_m: float) -> tuple[FloatArray, FloatArray]:
    """The two edges of a pedestrian crossing, 3 m apart."""
    edges = [
        np.vstack([base.at(np.array([s]), offset_m=offset)[0] for offset in (left_m, right_m)])
        for s in (at_m, at_m + 3.0)
    ]
    return edges[0], edges[1]


def late(scene: Scene, path: Path2d, start_m: float, speed: float, *, appears: int) -> None:
    """A vehicle first seen at a later timestep, at start_m."""
    before = line(path.xy[0] - np.array([float(cos(path.heading[0])), float(sin(path.heading[0]))]) * 200.0, path.xy[0])
    longer = Path2d.joined(before, path)
    scene.drive(longer, 200.0 + start_m - speed * appears * STEP_S, speed, category=0, steps=(appears, STEPS))


def pedestrian(scene: Scene, path: Path2d, start_m: float, speed: float, *, sway: int) -> None:
    """A pedestrian along a path."""
    scene.drive(path, start_m, speed, object_type="pedestrian", sway=sway)


# Files ----------------------------------------------------------------------------------------------------------------


def map_json(scene: Scene) -> bytes:
    """log_map_archive_<id>.json."""

    def points(xy: FloatArray, *, flat: bool = False) -> list[dict[str, float]]:
        heights = np.zeros(len(xy)) if flat else scene.height_m(xy)
        return [
            {"x": round(float(x), 2), "y": round(float(y), 2), "z": round(float(z), 2)}
            for (x, y), z in zip(scene.city_xy(xy), heights, strict=True)
        ]

    ids = {name: scene.first_id + 37 * i for i, name in enumerate(scene.lanes)}
    predecessors: dict[str, list[int]] = {name: [] for name in scene.lanes}
    for name, lane in scene.lanes.items():
        for successor in lane.successors:
            predecessors[successor].append(ids[name])
    document: dict[str, dict[str, Any]] = {"drivable_areas": {}, "lane_segments": {}, "pedestrian_crossings": {}}
    for i, area in enumerate(scene.areas):
        area_id = scene.first_id // 10 + i
        document["drivable_areas"][str(area_id)] = {"area_boundary": points(area), "id": area_id}
    for name, lane in scene.lanes.items():
        document["lane_segments"][str(ids[name])] = {
            "centerline": points(lane.centerline, flat=True),
            "id": ids[name],
            "is_intersection": lane.is_intersection,
            "lane_type": "VEHICLE",
            "left_lane_boundary": points(lane.left),
            "left_lane_mark_type": lane.left_mark,
            "left_neighbor_id": ids[lane.left_neighbor] if lane.left_neighbor else None,
            "predecessors": predecessors[name],
            "right_lane_boundary": points(lane.right),
            "right_lane_mark_type": lane.right_mark,
            "right_neighbor_id": ids[lane.right_neighbor] if lane.right_neighbor else None,
            "successors": [ids[successor] for successor in lane.successors],
        }
    for i, (edge1, edge2) in enumerate(scene.crossings):
        crossing_id = scene.first_id // 10 + 500 + i
        document["pedestrian_crossings"][str(crossing_id)] = {
            "edge1": points(edge1),
            "edge2": points(edge2),
            "id": crossing_id,
        }
    return json.dumps(document).encode()


def scenario_parquet(scene: Scene) -> bytes:
    """scenario_<id>.parquet; the last agent is the AV, the one of category 3 is focal."""
    count = len(scene.agents)
    track_ids = [*(str(scene.first_id // 1000 + 7 * i) for i in range(count - 1)), "AV"]
    focal = [track for track, agent in zip(track_ids, scene.agents, strict=True) if agent.category == 3]
    lengths = [len(agent.timesteps) for agent in scene.agents]
    rows_total = sum(lengths)

    def each(values: Sequence[Any]) -> list[Any]:
        return [value for value, length in zip(values, lengths, strict=True) for _ in range(length)]

    c, s = float(cos(scene.turn_rad)), float(sin(scene.turn_rad))
    timestep = np.concatenate([agent.timesteps for agent in scene.agents])
    position = scene.city_xy(np.vstack([agent.position for agent in scene.agents])).round(6)
    velocity = np.vstack([agent.velocity for agent in scene.agents])
    velocity = np.column_stack([c * velocity[:, 0] - s * velocity[:, 1], s * velocity[:, 0] + c * velocity[:, 1]])
    heading = wrap(np.concatenate([agent.heading for agent in scene.agents]) + scene.turn_rad)
    columns = {
        "observed": pa.array(timestep < OBSERVED),
        "track_id": pa.array(each(track_ids), pa.string()),
        "object_type": pa.array(each([agent.object_type for agent in scene.agents]), pa.string()),
        "object_category": pa.array(each([agent.category for agent in scene.agents]), pa.int64()),
        "timestep": pa.array(timestep, pa.int64()),
        "position_x": pa.array(position[:, 0]),
        "position_y": pa.array(position[:, 1]),
        "heading": pa.array(heading.round(6)),
        "velocity_x": pa.array(velocity[:, 0].round(6) + 0.0),
        "velocity_y": pa.array(velocity[:, 1].round(6) + 0.0),
        "scenario_id": pa.array([scene.scenario_id] * rows_total, pa.string()),
        "start_timestamp": pa.array([START_NS] * rows_total, pa.float64()),
        "end_timestamp": pa.array([START_NS + (STEPS - 1) * 1e8] * rows_total, pa.float64()),
        "num_timestamps": pa.array([STEPS] * rows_total, pa.int64()),
        "focal_track_id": pa.array(focal * rows_total, pa.string()),
        "city": pa.array([scene.city] * rows_total, pa.string()),
        "map_id": pa.array([scene.first_id // 1000] * rows_total, pa.uint64()),
        "slice_id": pa.array(
            [str(uuid.uuid5(uuid.NAMESPACE_URL, f"hid2-sumo/data/{scene.name}/slice"))] * rows_total, pa.string()
        ),
    }
    return parquet_bytes(pa.table(columns))


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
