"""Faults planted into scenes that hid2 wrote: one inserted vehicle's rows are replaced in a copy, all else is kept.

planted(folder, source, out) yields one PlantedFault after the other: every kind that the scene has room for, gross,
20 % beyond its limit (overlap: 5 cm deep) and 20 % inside it (5 cm apart), where that makes sense for the kind. The
vehicle drives an exactly built motion along a stretch of lane (a cubic through the centreline), with velocities that
are the central differences of its positions; its claims and the events that name it are taken out of the sidecar. The
first stretch is taken on which the fault can be built and the scene inside the limit passes.
"""

import itertools
import json
import math
import shutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import shapely
from second_checker import DECEL_MPS2, has_errors, motion_of
from second_claims import crossings
from second_map import Floats, line_of, turned
from second_scene import DT_S, SecondScene, SecondTrack, read_scene

STEPS = 70
GROSS, BEYOND, INSIDE = "gross", "beyond", "inside"
#: What the strength of a fault is of its limit.
SHARE = {BEYOND: 1.2, INSIDE: 0.8}
T, ZERO = np.arange(STEPS) * DT_S, np.zeros(STEPS)


@dataclass(frozen=True)
class PlantedFault:
    """A scene folder with one fault. quantity: what a checker must find of the vehicle; inside the limit nothing."""

    name: str
    kind: str
    strength: str
    folder: Path
    source: Path
    vehicle: str
    quantity: str


@dataclass(frozen=True, eq=False)
class Stretch:
    """A cubic y(x) beside a chain of lanes, by arc length. lanes: their ids."""

    origin: Floats
    heading: float
    cubic: np.polynomial.Polynomial
    lanes: tuple[int, ...]
    length_m: float

    @cached_property
    def slope(self) -> np.polynomial.Polynomial:
        return self.cubic.deriv()

    @cached_property
    def table(self) -> tuple[Floats, Floats]:
        """Arc lengths by x, every 2 cm; straight on beyond the ends."""
        x = np.arange(-700.0, 900.0, 0.02)
        lengths = np.cumsum(np.hypot(1.0, self.slope(np.clip(x, 0.0, self.length_m)))) * 0.02
        return lengths - np.interp(0.0, x, lengths), x

    def pose(self, s: Floats, d: Floats) -> tuple[Floats, Floats]:
        """Points (T, 2) at arc lengths and offsets to the left, and the path's headings (T,)."""
        at = np.interp(s, *self.table)
        inside = np.clip(at, 0.0, self.length_m)
        slope = self.slope(inside)
        angle = np.arctan(slope)
        y = self.cubic(inside) + (at - inside) * slope
        local = np.column_stack([at - d * np.sin(angle), y + d * np.cos(angle)])
        c, sn = math.cos(self.heading), math.sin(self.heading)
        return self.origin + local @ np.array([[c, sn], [-sn, c]]), angle + self.heading

    @cached_property
    def dense(self) -> tuple[Floats, Floats, Floats]:
        """Arc lengths, points and headings every 5 cm."""
        s = np.arange(0.0, self.length_m, 0.05)
        return s, *self.pose(s, np.zeros_like(s))

    def place(self, points: Floats) -> tuple[Floats, Floats]:
        """Arc length and offset of points, to 5 cm."""
        s, xy, heading = self.dense
        near = np.argmin(np.hypot(*(points[:, None] - xy[None]).transpose(2, 0, 1)), axis=1)
        away = points - xy[near]
        return s[near], away[:, 1] * np.cos(heading[near]) - away[:, 0] * np.sin(heading[near])


@dataclass(frozen=True, eq=False)
class Motion:
    """Arc length, offset to the left and turn of the heading from the path's, at the steps; (T,) each."""

    s: Floats
    d: Floats
    turn: Floats


@dataclass(frozen=True, eq=False)
class Site:
    """A stretch, a place on it and, where the fault needs one, a recorded agent."""

    stretch: Stretch
    start_m: float
    other: SecondTrack | None = None


@dataclass(frozen=True, eq=False)
class Planting:
    """What becomes of a fault on a site: the track, claims and events that go with it."""

    track: SecondTrack
    maneuvers: tuple[dict[str, Any], ...] = ()
    events: tuple[dict[str, Any], ...] = ()


Build = Callable[["Bench", Site, str], Planting | None]


class Bench:
    """A scene into which faults are planted, in the place of its inserted vehicle `vehicle`."""

    def __init__(self, folder: Path, source: Path) -> None:
        self.folder, self.source = folder, source
        self.scene = read_scene(folder, source)
        self.vehicle = self.scene.inserted_ids[-1]
        self.own = self.scene.by_id[self.vehicle]

    def track(self, site: Site, motion: Motion) -> SecondTrack:
        """The vehicle with another motion, from step 0 on."""
        xy, heading = site.stretch.pose(site.start_m + motion.s, motion.d)
        return self.with_states(xy, heading + motion.turn)

    def with_states(self, xy: Floats, heading: Floats) -> SecondTrack:
        velocity = np.gradient(xy, DT_S, axis=0)
        return replace(
            self.own, category=1, steps=np.arange(len(xy)), xy=xy, heading=turned(heading), velocity=velocity
        )

    def planted_scene(self, planting: Planting) -> SecondScene:
        """The scene in memory, as check_folder would read it."""
        tracks = [planting.track if one.track_id == self.vehicle else one for one in self.scene.tracks]
        return SecondScene(
            self.scene.scenario_id, tracks, self.scene.inserted_ids, self.scene.ground, self.sidecar(planting)
        )

    def sidecar(self, planting: Planting) -> dict[str, Any]:
        changed: dict[str, Any] = json.loads(json.dumps(self.scene.sidecar))
        for agent in changed["agents"]:
            if agent["track_id"] == self.vehicle:
                lanes = [min(held) for held in self.scene.ground.holding(planting.track.xy) if held]
                agent["maneuvers"] = list(planting.maneuvers)
                agent["route"] = list(dict.fromkeys(lanes)) or agent["route"]
                agent["spawn"] |= {"speed_mps": float(np.hypot(*planting.track.velocity[0])), "timestep": 0}
        kept = [one for one in changed["events"] if self.vehicle not in (one["track_id"], one["target_track_id"])]
        changed["events"] = [*kept, *planting.events]
        return changed

    def write(self, planting: Planting, out: Path) -> None:
        """A copy of the folder with the vehicle's rows and records replaced, the rows in their place."""
        shutil.copytree(self.folder, out)
        (path,) = out.glob("scenario_*.parquet")
        table = pd.read_parquet(path)
        old = np.flatnonzero(table["track_id"] == self.vehicle)
        track = planting.track
        rows = pd.concat([table.iloc[old[:1]]] * len(track.steps), ignore_index=True).assign(
            timestep=track.steps, observed=track.steps < 50, object_category=track.category, heading=track.heading,
            position_x=track.xy[:, 0], position_y=track.xy[:, 1],
            velocity_x=track.velocity[:, 0], velocity_y=track.velocity[:, 1],
        )  # fmt: skip
        parts = [table.iloc[: old[0]], rows, table.iloc[old[-1] + 1 :]]
        whole = pd.concat(parts, ignore_index=True).astype(table.dtypes)
        pq.write_table(pa.Table.from_pandas(whole).cast(pq.read_schema(path).remove_metadata()), path)
        (side,) = out.glob("hid2_*.json")
        side.write_text(json.dumps(self.sidecar(planting), indent=1))

    def stretches(self, length_m: float) -> Iterator[Stretch]:
        """Stretches so long, nearly straight and smooth; they begin on a lane for vehicles outside of intersections."""
        ground = self.scene.ground
        for lane_id, lane in ground.lanes.items():
            points, chain, at = [lane.line.xy], [lane_id], lane_id
            while sum(ground.lanes[n].line.length_m for n in chain) < length_m + 10.0:
                after = ground.onward(at)
                if after is None or after in chain:
                    break
                chain.append(after)
                points.append(ground.lanes[after].line.xy)
                at = after
            xy = np.concatenate(points)
            found = None if lane.in_intersection or lane.for_bikes else _fitted(xy, tuple(chain), length_m)
            if found is not None:
                yield found


def _fitted(xy: Floats, lanes: tuple[int, ...], length_m: float) -> Stretch | None:
    line = line_of(xy)
    ends = xy[-1] - xy[0]
    if line is None or math.hypot(*ends) < length_m:
        return None
    xy = line.at(np.linspace(0.0, line.length_m, round(line.length_m)))[0]
    heading = math.atan2(ends[1], ends[0])
    c, sn = math.cos(heading), math.sin(heading)
    local = (xy - xy[0]) @ np.array([[c, -sn], [sn, c]])
    cubic = np.polynomial.Polynomial.fit(local[:, 0], local[:, 1], 3).convert()
    bend = cubic.deriv(2)(np.linspace(0.0, local[-1, 0], 50))
    if np.abs(cubic(local[:, 0]) - local[:, 1]).max() > 0.4 or np.abs(bend).max() > 0.005:
        return None
    return Stretch(xy[0], heading, cubic, lanes, float(local[-1, 0]))


# Motions --------------------------------------------------------------------------------------------------------------


def driving(speed_mps: float, acceleration: Callable[[Floats], Floats] | None = None, steps: int = STEPS) -> Floats:
    """Arc lengths (T,) from 0, by a speed at the start and an acceleration over time."""
    fine = np.arange(0.0, steps * DT_S, 0.001)
    a = np.zeros_like(fine) if acceleration is None else acceleration(fine)
    v = speed_mps + np.concatenate([[0.0], np.cumsum((a[1:] + a[:-1]) / 2) * 0.001])
    s = np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) / 2) * 0.001])
    return np.asarray(s[:: round(DT_S / 0.001)][:steps])


def pulse(lasting_s: float, begins_s: float = 1.5) -> Callable[[Floats], Floats]:
    """1 in the middle, 0 outside, smooth: sin squared."""
    return lambda t: np.where(
        (t > begins_s) & (t < begins_s + lasting_s), np.sin(np.pi * (t - begins_s) / lasting_s) ** 2, 0.0
    )


def cycle(lasting_s: float, begins_s: float = 2.5) -> Callable[[Floats], Floats]:
    """One cycle of a sine."""
    return lambda t: np.where(
        (t > begins_s) & (t < begins_s + lasting_s), np.sin(2 * np.pi * (t - begins_s) / lasting_s), 0.0
    )


def least(reaches: Callable[[float], bool], low: float, high: float) -> float:
    """The least value between two that reaches something, as all above it do, by bisection."""
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (low, middle) if reaches(middle) else (middle, high)
    return high


def _limited(quantity: str, limit: float, gross: float, motion: Callable[[float], Motion]) -> Build:
    """The motion whose largest value of a quantity is the target."""
    measured = "accel" if quantity == "decel" else quantity

    def build(bench: Bench, site: Site, strength: str) -> Planting:
        target = abs(gross if strength == GROSS else limit * SHARE[strength])

        def size(amplitude: float) -> float:
            track = bench.track(site, motion(amplitude))
            return float(np.abs(motion_of(track, track.runs[0])[measured]).max())

        return Planting(bench.track(site, motion(least(lambda one: size(one) >= target, 0.0, 100.0))))

    return build


def _along(speed_mps: float, shape: Callable[[Floats], Floats], sign: float = 1.0) -> Callable[[float], Motion]:
    return lambda size: Motion(driving(speed_mps, lambda t: sign * size * shape(t)), ZERO, ZERO)


def _sideways(size: float) -> Motion:
    """A short swerve, heading along the lane: a jerk across it."""
    return Motion(driving(9.0), driving(0.0, lambda t: size * cycle(1.6)(t)), ZERO)


def _weaving(size: float) -> Motion:
    """Along a wave about the lane, heading along the lane, at its outermost at the end."""
    return Motion(driving(9.0), size / 1.9**2 * np.cos(1.9 * (T - T[-1])), ZERO)


def _swinging(frequency: float) -> Callable[[float], Motion]:
    """Straight on, with a heading that swings about the lane's."""
    return lambda size: Motion(driving(9.0), ZERO, size / frequency**2 * np.sin(frequency * T))


def _winding(size: float) -> Motion:
    """Slowly along a wave with the heading along it: a bend."""
    phase = 0.5 * (driving(2.2) - driving(2.2)[-1])
    d = size * np.cos(phase)
    return Motion(driving(2.2), d, np.arctan(-0.5 * size * np.sin(phase)))


# Faults that are built on their surroundings ------------------------------------------------------------------------


def _plainly(s: Floats, *, aside_m: float = 0.0) -> Build:
    """Along the lane or so far beside it, by arc lengths, with the heading along it."""
    motion = Motion(s, np.full(STEPS, aside_m), ZERO)
    return lambda bench, site, strength: Planting(bench.track(site, motion))


def _aside(bench: Bench, site: Site, strength: str) -> Planting | None:
    """Along the lane, so far to its right that the outline leaves the drivable ground by the target."""
    s = driving(7.0)

    def shifted(d: float) -> SecondTrack:
        return bench.track(site, Motion(s, ZERO - d, ZERO))

    if strength == GROSS:
        return Planting(shifted(30.0))

    def outside_m(d: float) -> float:
        return float(bench.scene.ground.outside_m(shifted(d).corners.reshape(-1, 2)).max())

    aside_m = least(lambda d: outside_m(d) >= 0.3 * SHARE[strength], 0.0, 12.0)
    return Planting(shifted(aside_m)) if aside_m < 11.9 else None


def _past(bench: Bench, site: Site, strength: str) -> Planting | None:
    """Past a standing recorded vehicle, 5 cm beside it or 5 cm deep in it; gross: through its middle."""
    assert site.other is not None
    _, aside = site.stretch.place(site.other.xy[:1])
    s = driving(5.0)

    def shifted(d: float) -> SecondTrack:
        return bench.track(site, Motion(s, ZERO + d, ZERO))

    if strength == GROSS:
        return Planting(shifted(float(aside[0])))
    boxes = shapely.union_all(site.other.boxes)
    away = -math.copysign(1.0, float(aside[0]))

    def apart_m(d: float) -> float:
        return float(shapely.distance(shifted(float(aside[0]) + away * d).boxes, boxes).min())

    clear = float(aside[0]) + away * least(lambda d: apart_m(d) >= 0.05, 0.0, 6.0)
    return Planting(shifted(clear if strength == INSIDE else clear - 0.1 * away))


def _same_path(bench: Bench, site: Site, strength: str) -> Planting:
    assert site.other is not None
    rows = np.flatnonzero(site.other.steps < STEPS)
    return Planting(bench.with_states(site.other.xy[rows], site.other.heading[rows]))


def _turned(bench: Bench, site: Site, strength: str) -> Planting | None:
    """Straight on along the lane with a heading that is turned from it, across the way of none; gross: turned round."""
    angle = math.pi if strength == GROSS else math.radians(60.0 * SHARE[strength])
    track = bench.track(site, Motion(driving(7.0), ZERO, np.full(STEPS, angle)))
    return Planting(track) if _is_alone(bench, track, within_m=5.0, within_s=1.5) else None


def _leader(site: Site, steps: int = STEPS) -> tuple[Floats, Floats] | None:
    """The arc lengths (T,) of the recorded agent on the stretch, and its speeds along it; None where it leaves it."""
    other = site.other
    if other is None or other.steps[0] != 0 or len(other.steps) < steps:
        return None
    s, d = site.stretch.place(other.xy[:steps])
    if np.abs(d).max() > 1.0 or s.max() > site.stretch.length_m - 1.0 or s.min() < 0.1:
        return None
    along = np.column_stack([np.cos(other.heading), np.sin(other.heading)])
    return s, np.sum(other.velocity * along, axis=1)[:steps]


def _approach(bench: Bench, site: Site, strength: str) -> Planting | None:
    """Up to a recorded leader, 5 m/s faster than it at first, so near that the least TTC is the target."""
    led = _leader(site)
    if led is None or led[1].min() < 1.0:
        return None
    final = float(led[1][-1])
    s = driving(final + 5.0, lambda t: -2.0 * 5.0 / 3.6 * pulse(3.6)(t))
    own = np.gradient(s, DT_S)
    target = {GROSS: 0.3, BEYOND: 1.2, INSIDE: 1.8}[strength]
    closing = np.maximum(own - led[1], 1e-6)
    reach = (bench.own.length_m + site.other.length_m) / 2

    def ttc_from(start: float) -> float:
        return float(np.where(own - led[1] > 0.05, (led[0] - start - s - reach) / closing, math.inf).min())

    start = least(lambda one: ttc_from(one) <= target, -60.0, 60.0) - 1e-6  # just before
    if start < 0.5 or start + s[-1] > site.stretch.length_m - 1.0 or ttc_from(start) > target + 0.1:
        return None  # it may not come near
    return Planting(bench.track(replace(site, start_m=start), Motion(s, ZERO, ZERO)))


def _before_end(gap_m: dict[str, float], faster_mps: float) -> Build:
    """At a constant speed, so much faster than a recorded agent, with a gap at the last step; negative: ahead of it."""

    def build(bench: Bench, site: Site, strength: str) -> Planting | None:
        led = _leader(site)
        if led is None or led[1].min() < 1.0 or led[1][-1] + faster_mps < 1.5:
            return None
        reach = (bench.own.length_m + site.other.length_m) / 2
        gap = gap_m[strength] + reach if faster_mps > 0.0 else -gap_m[strength] - reach
        s = driving(float(led[1][-1]) + faster_mps)
        start = float(led[0][-1]) - gap - float(s[-1])
        if start < 0.5 or start + s[-1] > site.stretch.length_m - 1.0:
            return None
        return Planting(bench.track(replace(site, start_m=start), Motion(s, ZERO, ZERO)))

    return build


def _pet(bench: Bench, site: Site, start_m: float) -> tuple[float, SecondTrack, Floats, Floats, Floats]:
    """PET (0 if none is first everywhere, inf if they do not meet) of a drive at 7 m/s, and where they meet when."""
    assert site.other is not None
    track = bench.track(replace(site, start_m=start_m), Motion(driving(7.0), ZERO, ZERO))
    own, theirs = shapely.STRtree(site.other.boxes).query(track.boxes, predicate="intersects")
    apart = (track.steps[own] - site.other.steps[theirs]) * DT_S
    pet = math.inf if not len(apart) else float(np.abs(apart).min()) if apart.min() * apart.max() > 0.0 else 0.0
    return pet, track, apart, own, theirs


def _crossing(bench: Bench, site: Site, strength: str) -> Planting | None:
    """At a constant speed across the path of a recorded vehicle, before or after it, at the PET that is wanted."""
    other = site.other
    assert other is not None
    wanted = {GROSS: 0.2, BEYOND: 0.8, INSIDE: 1.2}[strength]
    line = shapely.LineString(site.stretch.pose(np.arange(0.0, site.stretch.length_m, 0.5), np.zeros(1))[0])
    steepest = np.abs(np.sin(other.heading - site.stretch.heading)).max()
    if steepest < 0.5 or not shapely.intersects(line, shapely.LineString(other.xy)):
        return None
    s = driving(7.0)
    last = max(site.stretch.length_m - float(s[-1]), 0.0)
    near = [start for start in np.arange(0.0, last, 3.5) if abs(_pet(bench, site, float(start))[0] - wanted) < 0.8]
    for start in sorted({round(one + 0.35 * k, 2) for one in near for k in range(-5, 6)}):
        pet, track, apart, own, theirs = _pet(bench, site, max(start, 0.0))
        if abs(pet - wanted) > 0.01:
            continue
        nearest = int(np.argmin(np.abs(apart)))
        angle = abs(float(turned(track.heading[own[nearest]] - other.heading[theirs[nearest]])))
        cuts = shapely.intersects(shapely.LineString(track.xy), shapely.LineString(other.xy))
        if cuts and math.radians(45.0) < angle < math.radians(135.0):
            return Planting(track)
    return None


def _changing(bench: Bench, site: Site) -> tuple[SecondTrack, float, int, int] | None:
    """A lane change to the lane beside: the track, when the centre crosses the line, both lanes."""
    for side in (1.0, -1.0):
        d = side * 3.5 / 2 * (1 - np.cos(np.pi * np.clip((T - 1.0) / 5.0, 0.0, 1.0)))
        track, found = _drifting(bench, site, driving(9.0), d)
        if found is not None and _is_alone(bench, track, within_m=5.0, within_s=0.0):
            return track, *found
    return None


def _drifting(bench: Bench, site: Site, s: Floats, d: Floats) -> tuple[SecondTrack, tuple[float, int, int] | None]:
    """The track along s and d with its heading along it; when it crosses from which lane to which, if it does once."""
    track = bench.track(site, Motion(s, d, np.arctan2(np.gradient(d, DT_S), np.gradient(s, DT_S))))
    found = crossings(bench.scene, track)
    return track, found[0] if len({round(one[0], 1) for one in found}) == 1 else None


def _is_alone(bench: Bench, track: SecondTrack, *, within_m: float, within_s: float) -> bool:
    """Whether no agent comes so near to where it is within such a time.

    Its own fault is to be the only one, by whatever convention of leaders and followers.
    """
    for other in bench.scene.tracks:
        apart_m = np.hypot(*(other.xy[:, None] - track.xy).transpose(2, 0, 1))
        soon = np.abs(other.steps[:, None] - track.steps) * DT_S <= within_s
        if other.track_id != bench.vehicle and (soon & (apart_m < within_m)).any():
            return False
    return True


def _claimed_change(bench: Bench, site: Site, strength: str) -> Planting | None:
    """A lane change, claimed for another moment than that of the states."""
    change = _changing(bench, site)
    if change is None:
        return None
    track, at_s, source, target = change
    claimed = round(at_s + {GROSS: 2.0, BEYOND: 0.6, INSIDE: 0.4}[strength], 6)
    claim = {
        "kind": "lane_change", "status": "done", "reason": None, "trigger_s": 0.5, "requested_s": 0.6, "start_s": 1.0,
        "crossing_s": claimed, "end_s": 6.0, "source_lane": source, "target_lane": target, "leader_track_id": None,
        "gap_front_m": None, "gap_rear_m": None, "min_ttc_s": None,
    }  # fmt: skip
    return Planting(track, (claim,))


def _event(kind: str, vehicle: str, target: str, at_s: float) -> dict[str, Any]:
    return {
        "kind": kind, "target": target, "status": "done", "reason": None, "track_id": vehicle,
        "target_track_id": target, "at_s": round(at_s, 6), "ahead": True, "gap_m": None, "speed_difference_mps": None,
        "min_ttc_s": None, "pet_s": None, "drac_mps2": None, "human_brakes": None, "brakes_mps2": None, "tries": 1,
        "tried": {},
    }  # fmt: skip


def _claimed_cut_in(bench: Bench, site: Site, strength: str) -> Planting | None:
    """A cut-in ahead of a recorded vehicle, claimed for another moment; gross: in its lane all the time."""
    led = _leader(site)
    if led is None:
        return None
    s, ahead = driving(float(led[1].mean())), replace(site, start_m=float(led[0][0]) + 18.0)
    for side in (1.0, -1.0):
        d = side * 3.5 / 2 * (1 + np.cos(np.pi * np.clip((T - 1.0) / 5.0, 0.0, 1.0)))
        track, found = _drifting(bench, ahead, s, ZERO if strength == GROSS else d)
        if strength == GROSS or found is not None:
            at_s = 3.5 if found is None else found[0] + {BEYOND: 0.6, INSIDE: 0.4}[strength]
            return Planting(track, (), (_event("cut_in", bench.vehicle, site.other.track_id, at_s),))
    return None


# The list of faults ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Kind:
    """A kind of fault. length_m: the stretch that it takes; with_other: what recorded agents its sites have."""

    name: str
    quantity: str
    build: Build
    length_m: float
    with_other: str = ""
    strengths: tuple[str, ...] = (INSIDE, BEYOND, GROSS)


#: What 3 m/s2 after 1 s take away of a closing speed of 6 m/s: 6 m in the first second, 6^2 / (2 * 3) m after it.
STOPS_M = 12.0
KINDS = (
    Kind("accel", "accel", _limited("accel", 2.40, 15.0, _along(5.0, pulse(3.2))), 75.0),
    Kind("decel", "decel", _limited("decel", DECEL_MPS2, 30.0, _along(12.0, pulse(4.2), -1.0)), 70.0),
    Kind("hasty braking", "longitudinal_jerk",
         _limited("longitudinal_jerk", 4.13, 25.0, _along(9.0, pulse(2.0), -1.0)), 70.0),
    Kind("jerk", "jerk", _limited("jerk", 8.37, 60.0, _sideways), 75.0),
    Kind("lateral_accel", "lateral_accel", _limited("lateral_accel", 4.89, 15.0, _weaving), 75.0),
    Kind("yaw_rate", "yaw_rate", _limited("yaw_rate", 0.95, 3.0, _swinging(1.5)), 75.0),
    Kind("yaw_accel", "yaw_accel", _limited("yaw_accel", 1.93, 10.0, _swinging(4.0)), 75.0),
    Kind("curvature", "curvature", _limited("curvature", 0.22, 0.6, _winding), 30.0),
    Kind("aside", "off_road", _aside, 60.0),
    Kind("500 m aside", "off_road", _plainly(driving(7.0), aside_m=-500.0), 60.0, strengths=(GROSS,)),
    Kind("past a standing vehicle", "overlap", _past, 45.0, "standing"),
    Kind("same path", "overlap", _same_path, 30.0, "moving", strengths=(GROSS,)),
    Kind("70 m/s", "off_road", _plainly(driving(70.0)), 60.0, strengths=(GROSS,)),
    Kind("teleporting", "accel", _plainly(driving(5.0) + 20.0 * (T > 3.95)), 60.0, strengths=(GROSS,)),
    Kind("heading turned", "against_lane", _turned, 60.0),
    Kind("in reverse", "against_lane", _plainly(7.0 * (T[-1] - T)), 60.0, strengths=(GROSS,)),
    Kind("approach", "ttc_leader", _approach, 60.0, "moving"),
    Kind("crossing", "pet", _crossing, 60.0, "crossing"),
    # nothing inside: a recorded follower may not come so near as the TTC of the end alone would let it
    Kind("run into at the end", "end_ttc", _before_end({GROSS: 0.3, BEYOND: 2.4}, -3.0), 60.0, "moving",
         (BEYOND, GROSS)),
    Kind("contact after the end", "end_contact",
         _before_end({GROSS: 4.0, BEYOND: STOPS_M * 0.8, INSIDE: STOPS_M * 1.2}, 6.0), 60.0, "moving"),
    Kind("lane change", "claim", _claimed_change, 75.0),
    Kind("cut-in", "claim", _claimed_cut_in, 90.0, "moving"),
)  # fmt: skip


def _sites(bench: Bench, kind: Kind) -> Iterator[Site]:
    others = [
        one
        for one in bench.scene.tracks
        if one.object_type == "vehicle" and one.track_id not in bench.scene.inserted_ids
    ]
    lengths = (110.0, kind.length_m) if kind.with_other else (kind.length_m,)
    for stretch in itertools.chain.from_iterable(map(bench.stretches, lengths)):
        if not kind.with_other:
            for start in np.arange(2.0, max(stretch.length_m - kind.length_m, 3.0), 9.0):
                yield Site(stretch, float(start))
            continue
        for other in others:
            if other.moves == (kind.with_other == "standing") or len(other.steps) < STEPS:
                continue
            s, d = stretch.place(other.xy[[0, len(other.xy) // 2, -1]])
            if kind.with_other == "standing":
                along = abs(float(turned(other.heading[0] - stretch.pose(s[:1], np.zeros(1))[1][0])))
                if 1.2 < abs(d[0]) < 4.5 and 8.0 < s[0] < stretch.length_m - 30.0 and min(along, math.pi - along) < 0.1:
                    yield Site(stretch, max(1.0, float(s[0]) - 18.0), other)
            elif kind.with_other == "crossing" or np.abs(d).max() < 1.2:
                yield Site(stretch, 0.0, other)


def planted(
    folder: Path, source: Path, out: Path, *, kinds: tuple[Kind, ...] = KINDS, tries: int = 40
) -> Iterator[PlantedFault]:
    """Every fault that a scene has room for, written below a folder. tries: sites of a kind that are looked at."""
    bench = Bench(folder, source)
    for kind in kinds:
        for strength, planting in _built(bench, kind, tries).items():
            name = f"{bench.scene.scenario_id[:8]} {kind.name} {strength}"
            target = out / name.replace(" ", "_").replace("/", "_") / bench.scene.scenario_id
            bench.write(planting, target)
            yield PlantedFault(name, kind.name, strength, target, source, bench.vehicle, kind.quantity)


def planted_in(scenes: Iterable[tuple[Path, Path]], out: Path) -> Iterator[PlantedFault]:
    """Every kind once, in the first of the scenes (folder, folder of its recording) that has room for it."""
    left = KINDS
    for folder, source in scenes:
        found = set()
        for fault in planted(folder, source, out, kinds=left):
            found.add(fault.kind)
            yield fault
        left = tuple(kind for kind in left if kind.name not in found)


def _passes(bench: Bench, kind: Kind, planting: Planting) -> bool:
    """Whether a scene inside the limit is without any fault, and one without another agent meets none."""
    alone = bool(kind.with_other) or _is_alone(bench, planting.track, within_m=3.0, within_s=2.5)
    return alone and not has_errors(bench.planted_scene(planting), planting.track)


def _built(bench: Bench, kind: Kind, tries: int) -> dict[str, Planting]:
    """All strengths of a kind on the first site on which the one inside the limit passes; {} where there is none."""
    looked_at = 0
    for site in _sites(bench, kind):
        built: dict[str, Planting] = {}
        for strength in kind.strengths:  # inside first
            planting = kind.build(bench, site, strength)
            if planting is None or (strength == INSIDE and not _passes(bench, kind, planting)):
                looked_at += planting is not None
                break
            built[strength] = planting
        if len(built) == len(kind.strengths):
            return built
        if looked_at >= tries:
            break
    return {}
