"""The second checker: judges exported scenes by evaluation.md, "Limits of the judge"; it shares nothing with hid2.

check_folder(scene_folder, source) gives one Finding for each inserted vehicle, quantity and other agent: the worst one.
Manoeuvres and events are in second_claims.py, tracks in second_scene.py, the map in second_map.py.

Decisions where evaluation.md and method.md are silent:
- overlap: boxes at the steps, not between them.
- off_road: the outline is sampled every 0.25 m, corners among it.
- against_lane: only lanes on whose ground the centre lies count; a vehicle on none of them is against none. Faster than
  1 m/s the direction of motion has to agree with the same lane as the heading: a vehicle that drives in reverse along
  its lane is against it, also where lanes of both directions share the ground.
- limits of motion: np.gradient of the position over and over, without a gap in the track; rows 2 to T - 3 are judged.
  Longitudinal jerk is the derivative of the longitudinal acceleration, as in nuPlan, from which its limit is.
- curvature: the larger of yaw rate by speed and of the one of the positions, above 1 m/s.
- ttc_leader: leaders are vehicles, buses, motorcyclists, cyclists with a heading within 45 degrees of the path; the own
  box is pushed along its path until it touches. A leader that rolls backwards stands: that is noise of a tracker.
- pet: the least time between two boxes on the same ground, as SSAM has it (per place, not per conflict area). Where
  the driven lines do not cut each other under 30 degrees, paths join, part or pass, and do not cross.
- end: the last step of the vehicle itself, also at the map's edge; headings stay. A follower is an agent behind the own
  centre that moves (or, standing, points) within 45 degrees of the own heading; its contacts count for end_ttc alone.
- follower_headway: front bumper to front bumper by the follower's speed; ten steps in a row are one second.
- recorded against recorded is left out.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import shapely
from second_map import Bools, Floats, SecondMap, box_corners, contact_s, turned
from second_scene import DRIVEN_TYPES, DT_S, DrivenLine, SecondScene, SecondTrack, read_scene

OVERLAP_M2 = 1e-6
OFF_ROAD_M = 0.3
AGAINST_DEG, AGAINST_OUTSIDE_DEG = 90.0, 60.0
#: method.md's limits (nuPlan's comfort bounds): quantity, sign of the side that is judged, limit.
ACCEL_MPS2, DECEL_MPS2 = 2.40, -4.05
BOTH_SIDES = {
    "lateral_accel": 4.89, "longitudinal_jerk": 4.13, "jerk": 8.37, "yaw_rate": 0.95, "yaw_accel": 1.93,
    "curvature": 0.2 * 1.1,
}  # fmt: skip
TTC_S, LEADER_M = 1.5, 100.0
PET_S, PET_DEG = 1.0, 30.0
END_TTC_S, END_HORIZON_S, END_BRAKES_AFTER_S, END_BRAKES_MPS2 = 1.0, 3.0, 1.0, 3.0
HEADWAY_S, HEADWAY_STEPS, HEADWAY_MPS = 0.8, 10, 3.0
#: Nothing farther ahead is within 0.8 s of a follower, m.
FOLLOWED_M = 25.0
ALIKE_RAD = math.radians(45.0)
MOVES_MPS = 1.0
EDGE_M = 0.25


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with one inserted vehicle. step: the timestep at which it is worst."""

    scene: str
    vehicle: str
    step: int
    quantity: str
    value: float
    limit: float
    other: str = ""


def check_folder(scene_folder: Path, source: Path | None = None) -> list[Finding]:
    """All findings of a scene folder. source: the folder of its recording, for the sizes of recorded boxes."""
    return check_scene(read_scene(scene_folder, source))


def check_scene(scene: SecondScene) -> list[Finding]:
    """All findings of a scene."""
    from second_claims import claims  # it takes Finding from here

    found = [one for track in scene.inserted for check in CHECKS for one in check(scene, track)]
    return [*found, *follower_headways(scene), *claims(scene)]


def has_errors(scene: SecondScene, first: SecondTrack) -> bool:
    """Whether check_scene would find an error, looked for with that track first and up to the first one."""
    from second_claims import claims

    tracks = [first, *(one for one in scene.inserted if one is not first)]
    return any(True for track in tracks for check in CHECKS for _ in check(scene, track)) or any(claims(scene))


def overlaps(scene: SecondScene, track: SecondTrack) -> Iterator[Finding]:
    """Ground shared with each other box, at the step at which it is most; two inserted ones are told once."""
    told = set(scene.inserted_ids[: scene.inserted_ids.index(track.track_id)])
    rows, own = _rows_near(scene, scene.tracks.index(track))
    areas = shapely.area(shapely.intersection(scene.boxes_all[rows], track.boxes[own]))
    for other in np.unique(scene.owner[rows]):
        mine = scene.owner[rows] == other
        worst = int(np.argmax(np.where(mine, areas, -1.0)))
        name = scene.tracks[other].track_id
        if areas[worst] > OVERLAP_M2 and name not in told:
            step = int(track.steps[own[worst]])
            yield Finding(scene.scenario_id, track.track_id, step, "overlap", float(areas[worst]), 0.0, name)


def _own_rows(scene: SecondScene, track: SecondTrack) -> npt.NDArray[np.int64]:
    """(R,) the track's row at the step of every row of the scene, -1 where it is not there."""
    place = np.full(int(scene.step_all.max()) + 1, -1)
    place[track.steps] = np.arange(len(track.steps))
    return place[scene.step_all]


def _rows_near(scene: SecondScene, index: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Rows of other agents whose box may touch the track's at the same step, and the track's rows; a cheap choice."""
    own = _own_rows(scene, scene.tracks[index])
    size = np.array([math.hypot(track.length_m, track.width_m) for track in scene.tracks])
    near = np.hypot(*(scene.xy_all - scene.tracks[index].xy[own]).T) <= (size[scene.owner] + size[index]) / 2
    rows = np.flatnonzero((own >= 0) & (scene.owner != index) & near)
    return rows, own[rows]


def off_road(scene: SecondScene, track: SecondTrack) -> Iterator[Finding]:
    """The point of the outline that is farthest outside the drivable area."""
    points = [track.corners]
    for k in range(4):
        a, b = track.corners[:, k], track.corners[:, (k + 1) % 4]
        count = max(2, math.ceil(float(np.hypot(*(b[0] - a[0]))) / EDGE_M))
        shares = np.arange(1, count)[None, :, None] / count
        points.append(a[:, None] + shares * (b - a)[:, None])
    outline = np.concatenate(points, axis=1)
    far = scene.ground.outside_m(outline.reshape(-1, 2)).reshape(outline.shape[:2]).max(axis=1)
    worst = int(np.argmax(far))
    if far[worst] > OFF_ROAD_M:
        yield Finding(
            scene.scenario_id, track.track_id, int(track.steps[worst]), "off_road", float(far[worst]), OFF_ROAD_M
        )


def against_lane(scene: SecondScene, track: SecondTrack) -> Iterator[Finding]:
    """The step at which the least angle to a lane under the centre is largest, beyond that lane's limit."""
    velocity = _gradient(track.xy) if len(track.steps) > 1 else np.zeros_like(track.xy)
    fast = np.hypot(*velocity.T) > MOVES_MPS
    course = np.where(fast, np.arctan2(velocity[:, 1], velocity[:, 0]), track.heading)
    worst: tuple[float, float, int] | None = None
    for row, lanes in enumerate(scene.ground.holding(track.xy)):
        off = _off_lanes(scene.ground, lanes, track.xy[row], np.array([track.heading[row], course[row]]))
        if off is not None and (worst is None or off[0] > worst[0]):
            worst = (*off, int(track.steps[row]))
    if worst is not None:
        yield Finding(scene.scenario_id, track.track_id, worst[2], "against_lane", worst[0], worst[1])


def _off_lanes(ground: SecondMap, lanes: list[int], xy: Floats, courses: Floats) -> tuple[float, float] | None:
    """Least angle of a lane to the farther one of two courses, and its limit, degrees; None where a lane agrees."""
    angles = []
    for lane_id in lanes:
        limit = AGAINST_DEG if ground.lanes[lane_id].in_intersection else AGAINST_OUTSIDE_DEG
        angle = float(ground.off_lane_deg(lane_id, np.stack([xy, xy]), courses).max())
        if angle <= limit:
            return None
        angles.append((angle, limit))
    return min(angles, default=None)


def _gradient(values: Floats) -> Floats:
    return np.asarray(np.gradient(values, DT_S, axis=0))


def motion_of(track: SecondTrack, rows: slice) -> dict[str, Floats]:
    """The quantities of motion over rows without a gap, five of them at least; first and last two rows left out."""
    heading = np.unwrap(track.heading[rows])
    ahead = np.column_stack([np.cos(heading), np.sin(heading)])
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    velocity = _gradient(track.xy[rows])
    acceleration = _gradient(velocity)
    jerk = _gradient(acceleration)
    yaw_rate = _gradient(heading)
    speed = np.hypot(*velocity.T)
    fast = np.maximum(speed, MOVES_MPS)
    bend = np.maximum(
        np.abs(yaw_rate) / fast,
        np.abs(velocity[:, 0] * acceleration[:, 1] - velocity[:, 1] * acceleration[:, 0]) / fast**3,
    )
    values = {
        "accel": np.sum(acceleration * ahead, axis=1), "lateral_accel": np.sum(acceleration * left, axis=1),
        "longitudinal_jerk": _gradient(np.sum(acceleration * ahead, axis=1)), "jerk": np.hypot(*jerk.T),
        "yaw_rate": yaw_rate, "yaw_accel": _gradient(yaw_rate),
        "curvature": np.where(speed > MOVES_MPS, bend, 0.0), "speed": speed,
    }  # fmt: skip
    return {name: value[2:-2] for name, value in values.items()}


def motion(scene: SecondScene, track: SecondTrack) -> Iterator[Finding]:
    """The worst row of every limit of motion."""
    worst: dict[str, Finding] = {}
    for rows in track.runs:
        if rows.stop - rows.start < 5:
            continue
        values = motion_of(track, rows)
        over = {name: (np.abs(values[name]), limit) for name, limit in BOTH_SIDES.items()}
        over |= {"accel": (values["accel"], ACCEL_MPS2), "decel": (-values["accel"], -DECEL_MPS2)}
        for name, (size, limit) in over.items():
            row = int(np.argmax(size))
            value = float(values["accel" if name == "decel" else name][row])
            if size[row] > limit + 1e-9 and (name not in worst or abs(value) > abs(worst[name].value)):
                step = int(track.steps[rows][2 + row])
                worst[name] = Finding(
                    scene.scenario_id, track.track_id, step, name, value, DECEL_MPS2 if name == "decel" else limit
                )
    yield from worst.values()


def _ahead(
    scene: SecondScene, track: SecondTrack, path: DrivenLine, *, within_m: float = LEADER_M
) -> dict[str, np.ndarray]:
    """Rows of agents ahead on a track's path at the same step, in its direction, as wide as the way of its box.

    rows, own: (P,) rows of the scene and of the track; gap: m between bumpers along the path; along: m/s.
    """
    index = scene.tracks.index(track)
    own = _own_rows(scene, track)
    near = np.hypot(*(scene.xy_all - track.xy[own]).T) < within_m + 20.0
    rows = np.flatnonzero(near & (own >= 0) & (scene.owner != index) & scene.driven_all)
    line = shapely.LineString(path.line.xy)
    shapely.prepare(line)
    rows = rows[shapely.dwithin(line, shapely.points(scene.xy_all[rows]), 4.0)]
    s, d = path.line.project(scene.xy_all[rows]) if len(rows) else (np.zeros(0), np.zeros(0))
    direction = path.line.at(s)[1] if len(rows) else np.zeros(0)
    off = turned(scene.heading_all[rows] - direction)
    length = np.array([t.length_m for t in scene.tracks])[scene.owner[rows]]
    width = np.array([t.width_m for t in scene.tracks])[scene.owner[rows]]
    across = (np.abs(np.sin(off)) * length + np.abs(np.cos(off)) * width + track.width_m) / 2
    reach = (np.abs(np.cos(off)) * length + np.abs(np.sin(off)) * width + track.length_m) / 2
    ahead_m = s - path.own_m[own[rows]]
    leads = (np.abs(off) <= ALIKE_RAD) & (np.abs(d) < across) & (ahead_m > 1.0) & (ahead_m - reach < LEADER_M)
    velocity = scene.velocity_all[rows]
    along = velocity[:, 0] * np.cos(direction) + velocity[:, 1] * np.sin(direction)
    return {
        "rows": rows[leads], "own": own[rows][leads], "gap": (ahead_m - reach)[leads], "along": along[leads],
        "fronts": (ahead_m + (length - track.length_m) / 2)[leads],
    }  # fmt: skip


def leader_ttc(scene: SecondScene, track: SecondTrack) -> Iterator[Finding]:
    """The least TTC to each leader on the path driven."""
    for other, (ttc, step) in _least_ttc(scene, track).items():
        yield Finding(scene.scenario_id, track.track_id, step, "ttc_leader", ttc, TTC_S, scene.tracks[other].track_id)


def follower_ttc(scene: SecondScene, track: SecondTrack) -> Iterator[Finding]:
    """The least TTC of each recorded vehicle that has the track as a leader on the path that it drives."""
    own = scene.tracks.index(track)
    for other in scene.tracks:
        recorded = other.track_id not in scene.inserted_ids and other.object_type in DRIVEN_TYPES and other.moves
        if recorded and _meet(other, track) and own in (found := _least_ttc(scene, other)):
            ttc, step = found[own]
            yield Finding(scene.scenario_id, track.track_id, step, "ttc_recorded_follower", ttc, TTC_S, other.track_id)


def _least_ttc(scene: SecondScene, track: SecondTrack) -> dict[int, tuple[float, int]]:
    """TTC and step by the number of the agent that leads, below the limit; kept, as each inserted one asks for it."""
    if track not in scene.least_ttc:
        scene.least_ttc[track] = _found_ttc(scene, track)
    return scene.least_ttc[track]


def _found_ttc(scene: SecondScene, track: SecondTrack) -> dict[int, tuple[float, int]]:
    path = scene.driven_line(track)
    if path is None:
        return {}
    ahead = _ahead(scene, track, path)
    speed = np.hypot(*track.moved.T)[ahead["own"]]
    closing = speed - np.maximum(ahead["along"], 0.0)
    worst: dict[int, tuple[float, int]] = {}
    for k in np.flatnonzero((closing > 0.05) & (ahead["gap"] < TTC_S * closing)):
        row, own = int(ahead["rows"][k]), int(ahead["own"][k])
        other = int(scene.owner[row])
        room = _room(path, track, own, scene.boxes_all[row], most_m=TTC_S * float(closing[k]))
        ttc = room / float(closing[k])
        if ttc < worst.get(other, (TTC_S, 0))[0]:
            worst[other] = (ttc, int(track.steps[own]))
    return worst


def _room(path: DrivenLine, track: SecondTrack, row: int, other: shapely.Geometry, *, most_m: float) -> float:
    """How far the own box can be pushed along its path until it touches the other, m, to 5 cm; inf beyond most_m."""
    pushed = np.arange(0.0, most_m + 0.05, 0.05)
    centre, heading = path.line.at(path.own_m[row] + pushed)
    touches = shapely.intersects(shapely.polygons(box_corners(centre, heading, track.length_m, track.width_m)), other)
    return float(pushed[np.argmax(touches)]) if touches.any() else math.inf


def encroachment(scene: SecondScene, track: SecondTrack) -> Iterator[Finding]:
    """The least PET with each moving vehicle whose heading differs by 30 degrees where the boxes share ground."""
    if not track.moves:
        return
    index = scene.tracks.index(track)
    others = np.flatnonzero(scene.driven_all & scene.moving_all & (scene.owner != index))
    if not len(others):
        return
    own, found = shapely.STRtree(scene.boxes_all[others]).query(track.boxes, predicate="intersects")
    rows = others[found]
    apart = np.abs(scene.step_all[rows] - track.steps[own])
    crosses = np.abs(turned(scene.heading_all[rows] - track.heading[own])) >= math.radians(PET_DEG)
    for other in np.unique(scene.owner[rows[crosses]]):
        mine = np.flatnonzero(crosses & (scene.owner[rows] == other))
        least = mine[np.argmin(apart[mine])]
        pet = float(apart[least]) * DT_S
        if pet < PET_S - 1e-9 and _paths_cross(scene, track, scene.tracks[other]):
            name = scene.tracks[other].track_id
            yield Finding(scene.scenario_id, track.track_id, int(track.steps[own[least]]), "pet", pet, PET_S, name)


def _paths_cross(scene: SecondScene, track: SecondTrack, other: SecondTrack) -> bool:
    """Whether what was driven of the two lines cuts under 30 to 150 degrees: meeting head-on is no crossing."""
    first, second = scene.driven_line(track), scene.driven_line(other)
    if first is None or second is None:
        return False
    cuts = shapely.intersection(shapely.LineString(first.line.xy), shapely.LineString(second.line.xy))
    points = shapely.get_coordinates(cuts)
    if not len(points):
        return False
    places = [one.line.project(points)[0] for one in (first, second)]
    angles = [one.line.at(s)[1] for one, s in zip((first, second), places, strict=True)]
    driven = (places[0] <= first.driven_m + EDGE_M) & (places[1] <= second.driven_m + EDGE_M)
    return bool(np.any(driven & (np.abs(np.sin(angles[0] - angles[1])) >= math.sin(math.radians(PET_DEG)))))


def scene_end(scene: SecondScene, track: SecondTrack) -> Iterator[Finding]:
    """Contacts after the vehicle's last step: by TTC at constant velocities, and those that braking does not avoid."""
    step = int(track.steps[-1])
    for other in scene.tracks:
        row = other.row_of.get(step)
        if other is track or row is None:
            continue
        away = other.xy[row] - track.xy[-1]
        if math.hypot(*away) > 200.0:
            continue
        ttc = contact_s(track.corners[-1], other.corners[row], other.velocity[row] - track.velocity[-1])
        if ttc < END_TTC_S:
            yield Finding(scene.scenario_id, track.track_id, step, "end_ttc", ttc, END_TTC_S, other.track_id)
        ahead = np.array([math.cos(track.heading[-1]), math.sin(track.heading[-1])])
        course = (
            float(np.arctan2(*other.velocity[row][::-1]))
            if np.hypot(*other.velocity[row]) > MOVES_MPS
            else other.heading[row]
        )
        follows = abs(float(turned(course - track.heading[-1]))) < ALIKE_RAD and float(away @ ahead) < 0.0
        if ttc < END_HORIZON_S and not follows:
            met_s = _contact_braking_s(track, other, row)
            if met_s < END_HORIZON_S - 1e-9:
                yield Finding(
                    scene.scenario_id, track.track_id, step, "end_contact", met_s, END_HORIZON_S, other.track_id
                )


def _contact_braking_s(track: SecondTrack, other: SecondTrack, row: int) -> float:
    """Seconds until contact when the track brakes with 3 m/s2 after 1 s; inf if none within 3 s."""
    times = np.arange(0.0, END_HORIZON_S + 0.01, 0.02)
    speed = float(np.hypot(*track.velocity[-1]))
    brakes = np.clip(times - END_BRAKES_AFTER_S, 0.0, speed / END_BRAKES_MPS2)
    driven = speed * np.minimum(times, END_BRAKES_AFTER_S) + speed * brakes - END_BRAKES_MPS2 * brakes**2 / 2
    unit = track.velocity[-1] / max(speed, 1e-9)
    own = shapely.polygons(track.corners[-1] + driven[:, None, None] * unit)
    theirs = shapely.polygons(other.corners[row] + times[:, None, None] * other.velocity[row])
    touches: Bools = shapely.intersects(own, theirs)
    return float(times[np.argmax(touches)]) if touches.any() else math.inf


def follower_headways(scene: SecondScene) -> Iterator[Finding]:
    """A recorded vehicle that follows an inserted one nearer than any recorded one."""
    if not scene.inserted:
        return
    for track in scene.tracks:
        if track.track_id in scene.inserted_ids or track.object_type not in DRIVEN_TYPES or not track.moves:
            continue
        path = scene.driven_line(track) if any(_meet(track, one) for one in scene.inserted) else None
        if path is None:
            continue
        kept = _least_headways(scene, track, path)
        recorded = min((value for name, (value, _) in kept.items() if name not in scene.inserted_ids), default=math.inf)
        for name in kept.keys() & set(scene.inserted_ids) - _aimed_at(scene, track):
            least, step = kept[name]
            if least < min(HEADWAY_S, recorded):
                yield Finding(scene.scenario_id, name, step, "follower_headway", least, HEADWAY_S, track.track_id)


def _aimed_at(scene: SecondScene, track: SecondTrack) -> set[str]:
    """Vehicles of ordered events with a target: the gap that they leave to it was asked for."""
    events = scene.sidecar.get("events", ())
    return {one.get("track_id") for one in events if one.get("target_track_id") == track.track_id}


def _meet(one: SecondTrack, other: SecondTrack, *, within_m: float = 25.0) -> bool:
    _, rows, others = np.intersect1d(one.steps, other.steps, assume_unique=True, return_indices=True)
    return bool(np.any(np.hypot(*(one.xy[rows] - other.xy[others]).T) < within_m))


def _least_headways(scene: SecondScene, track: SecondTrack, path: DrivenLine) -> dict[str, tuple[float, int]]:
    """By leader: the least headway that was not exceeded for a second above 3 m/s, and the step at which it begins."""
    ahead = _ahead(scene, track, path, within_m=FOLLOWED_M)
    speed = np.hypot(*track.moved.T)[ahead["own"]]
    leader = np.full(int(track.steps[-1]) + 1, -1)
    headway = np.full(len(leader), math.inf)
    for k in np.argsort(-ahead["fronts"]):  # the nearest one last
        if speed[k] > HEADWAY_MPS:
            step = int(track.steps[ahead["own"][k]])
            leader[step], headway[step] = scene.owner[ahead["rows"][k]], ahead["fronts"][k] / speed[k]
    found = {}
    for other in np.unique(leader[leader >= 0]):
        series = np.where(leader == other, headway, math.inf)
        if len(series) >= HEADWAY_STEPS:
            second = np.lib.stride_tricks.sliding_window_view(series, HEADWAY_STEPS).max(axis=1)
            found[scene.tracks[other].track_id] = (float(second.min()), int(np.argmin(second)))
    return found


CHECKS = (overlaps, off_road, against_lane, motion, leader_ttc, follower_ttc, scene_end, encroachment)
