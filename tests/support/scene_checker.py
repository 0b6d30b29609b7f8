"""A checker of generated scenes: loops over numpy and shapely that share nothing with the code they judge.

check_scene(scene) returns one sentence for each violation: overlaps, a footprint off the road, limits of motion,
velocity and heading against the positions, driving against a lane, time to collision, a contact soon after the last
step, and the replay's own figures.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
import shapely
import shapely.affinity

from bridge.generation.scene import TrafficScene
from hid2.agents import DEFAULT_SIZES, Track
from netconvert.geometry import Polyline
from netconvert.lane_graph import LaneGraph

DT_S = 0.1
LAST_OBSERVED = 49
TOLERANCE_M = 0.3
TTC_MIN_S = 1.5
END_TTC_MIN_S = 1.0
#: Rear bumper of who enters at the map's edge to the beginning of the lane: 0.5 m, and what is driven in a step.
ENTERS_WITHIN_M = 3.0
EDGE_STEP_M = 0.5
#: method.md's limits (nuPlan's comfort bounds).
LIMITS = {
    "acceleration": (-4.05, 2.40),
    "lateral acceleration": (-4.89, 4.89),
    "yaw rate": (-0.95, 0.95),
    "yaw acceleration": (-1.93, 1.93),
    "longitudinal jerk": (-4.13, 4.13),
    "jerk": (0.0, 8.37),
}
Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Moving:
    """A box at twice the steps: pose k at timestep k / 2; None where the agent is not there."""

    track_id: str
    length_m: float
    width_m: float
    poses: list[tuple[float, float, float] | None]

    def polygon(self, k: int) -> shapely.Polygon:
        pose = self.poses[k]
        assert pose is not None
        x, y, heading = pose
        half_l, half_w = self.length_m / 2, self.width_m / 2
        flat = shapely.box(-half_l, -half_w, half_l, half_w)
        return shapely.affinity.translate(shapely.affinity.rotate(flat, heading, origin=(0, 0), use_radians=True), x, y)


@dataclass
class Verdict:
    """Violations found, as sentences."""

    found: list[str] = field(default_factory=list)

    def note(self, *parts: object) -> None:
        self.found.append(" ".join(str(part) for part in parts))


def moving_boxes(track: Track, length_m: float, width_m: float, num_steps: int) -> Moving:
    """States at the steps and, where both neighbours exist, half way between them, turning the short way round."""
    poses: list[tuple[float, float, float] | None] = [None] * (2 * num_steps - 1)
    states = dict(
        zip(track.timesteps.tolist(), zip(track.position.tolist(), track.heading.tolist(), strict=True), strict=True)
    )
    for step, ((x, y), heading) in states.items():
        poses[2 * step] = (x, y, heading)
        if step + 1 in states:
            (x1, y1), heading1 = states[step + 1]
            turn = math.remainder(heading1 - heading, 2 * math.pi)
            poses[2 * step + 1] = ((x + x1) / 2, (y + y1) / 2, heading + turn / 2)
    return Moving(track.track_id, length_m, width_m, poses)


def check_overlaps(generated: list[Moving], recorded: list[Moving], verdict: Verdict) -> None:
    """No generated box shares ground with any other, at every step and half step."""
    for place, own in enumerate(generated):
        others = recorded + generated[place + 1 :]
        for k, pose in enumerate(own.poses):
            if pose is None:
                continue
            near = []
            for other in others:
                pose2 = other.poses[k]
                if pose2 is None:
                    continue
                reach = (math.hypot(own.length_m, own.width_m) + math.hypot(other.length_m, other.width_m)) / 2
                if math.hypot(pose[0] - pose2[0], pose[1] - pose2[1]) < reach:
                    near.append(other)
            if near:
                ground = own.polygon(k)
                for other in near:
                    if ground.intersection(other.polygon(k)).area > 1e-6:
                        verdict.note("overlap", own.track_id, other.track_id, "at timestep", k / 2)


def check_drivable(boxes: Moving, drivable: shapely.Geometry, verdict: Verdict) -> None:
    """The footprint at most 0.3 m outside the drivable area: points every 0.5 m along all sides, corners among them."""
    for k in range(0, len(boxes.poses), 2):
        if boxes.poses[k] is None:
            continue
        outline = boxes.polygon(k).exterior
        corners = np.array(outline.coords)[:4]
        between = shapely.line_interpolate_point(outline, np.arange(0.0, outline.length, EDGE_STEP_M))
        points = [*shapely.points(corners), *between]
        worst = max(drivable.distance(point) for point in points)
        if worst > TOLERANCE_M:
            verdict.note("off road", boxes.track_id, "by", round(worst, 3), "m at timestep", k / 2)


def check_after_end(scene: TrafficScene, track: Track, sizes: dict[str, tuple[float, float]], verdict: Verdict) -> None:
    """Nobody is touched within 1 s after the track's last step, all who are there at the velocity stated for it."""
    last = int(track.timesteps[-1])
    own = _at_step(track, last)
    assert own is not None
    for other in (*scene.source.tracks, *scene.generated):
        theirs = None if other.track_id == track.track_id else _at_step(other, last)
        if theirs is None:
            continue
        reach = sum(math.hypot(*sizes[one.track_id]) / 2 for one in (track, other))
        for ahead_s in np.arange(0.0, END_TTC_MIN_S, 0.02):
            apart = own[0] + ahead_s * own[2] - theirs[0] - ahead_s * theirs[2]
            if math.hypot(*apart) > reach:
                continue
            grounds = [
                Moving("", *sizes[one.track_id], [(*(xy + ahead_s * velocity), heading)]).polygon(0)
                for one, (xy, heading, velocity) in ((track, own), (other, theirs))
            ]
            if grounds[0].intersects(grounds[1]):
                verdict.note(
                    "after the end", track.track_id, "meets", other.object_type, other.track_id, "in",
                    round(float(ahead_s), 2), "s from timestep", last,
                )  # fmt: skip
                break


def _at_step(track: Track, step: int) -> tuple[Floats, float, Floats] | None:
    """Centre, heading and stated velocity at a timestep; None where the track has no state then."""
    rows = np.flatnonzero(track.timesteps == step)
    if not rows.size:
        return None
    return track.position[rows[0]], float(track.heading[rows[0]]), track.velocity[rows[0]]


def central(values: Floats) -> Floats:
    """Central differences over time, one-sided at the ends."""
    rate = np.empty_like(values)
    rate[1:-1] = (values[2:] - values[:-2]) / (2 * DT_S)
    rate[0], rate[-1] = (values[1] - values[0]) / DT_S, (values[-1] - values[-2]) / DT_S
    return rate


def check_motion(track: Track, verdict: Verdict) -> None:
    """Limits, by the stated velocity and by the positions; velocity against positions; heading against motion."""
    derived = central(track.position)
    forward = np.column_stack([np.cos(track.heading), np.sin(track.heading)])
    left = forward[:, ::-1] * [-1.0, 1.0]
    yaw_rate = central(np.unwrap(track.heading))
    for source, velocity in (("velocity", track.velocity), ("positions", derived)):
        acceleration = central(velocity)
        along = np.sum(acceleration * forward, axis=1)
        quantities = {
            "acceleration": along,
            "lateral acceleration": np.sum(acceleration * left, axis=1),
            "yaw rate": yaw_rate,
            "yaw acceleration": central(yaw_rate),
            "longitudinal jerk": central(along),
            "jerk": np.linalg.norm(central(acceleration), axis=1),
        }
        for name, values in quantities.items():
            low, high = LIMITS[name]
            if values.min() < low or values.max() > high:
                worst = values[np.argmax(np.maximum(low - values, values - high))]
                verdict.note("limit", name, round(float(worst), 3), "of", track.track_id, "by its", source)
    error = np.abs(derived - track.velocity)[1:-1].max()
    if error > 0.1:  # central differences of a jerk of 8 m/s3 are off by 8 * 0.1^2 / 6 = 0.013 m/s, in curves by more
        verdict.note("velocity of", track.track_id, "is off its positions by", round(float(error), 3), "m/s")
    for step in range(1, len(derived) - 1):
        vx, vy = derived[step]
        if math.hypot(vx, vy) > 0.5:
            slip = math.remainder(math.atan2(vy, vx) - float(track.heading[step]), 2 * math.pi)
            if abs(slip) > 0.1:
                verdict.note("heading of", track.track_id, "is off its motion by", round(slip, 3), "rad at", step)
                break


def check_direction(track: Track, lanes: list[tuple[Polyline, float]], verdict: Verdict) -> None:
    """At every step some lane under the centre (half a width plus 0.5 m) runs within 60 degrees of the heading."""
    agrees = np.zeros(len(track.heading), dtype=bool)
    covered = np.zeros(len(track.heading), dtype=bool)
    for path, half_width in lanes:
        s, d = path.frenet(track.position)
        on = (np.abs(d) <= half_width + 0.5) & (s >= -0.5) & (s <= path.length_m + 0.5)  # joints may have a kink
        turn = np.abs(np.angle(np.exp(1j * (path.heading(np.clip(s, 0.0, path.length_m)) - track.heading))))
        covered |= on
        agrees |= on & (turn < math.pi / 3)
    against = covered & ~agrees
    if against.any():
        verdict.note("against the lane", track.track_id, "at", np.flatnonzero(against).tolist())


def way_on(graph: LaneGraph, track: Track) -> Floats:
    """Points beyond the end of a track, 60 m or so: along its lane and the straightest successors, then straight on.

    At the place in the lane where the track ends: a step back to the middle would be a bend that nobody drives.
    """
    end, heading = track.position[-1], float(track.heading[-1])
    best, lane_id, at, aside = 1.5, None, 0.0, 0.0
    for lane in graph.lanes.values():
        s, d = lane.path.frenet(end)
        turn = math.remainder(float(lane.path.heading(np.clip(s, 0.0, lane.length_m))[0]) - heading, 2 * math.pi)
        if 0.0 <= s[0] <= lane.length_m and abs(d[0]) + 2.0 * abs(turn) < best:
            best, lane_id, at = float(abs(d[0]) + 2.0 * abs(turn)), lane.lane_id, float(s[0])
            aside = float(d[0])
    points: list[Floats] = []
    left_m = 60.0
    while lane_id is not None and left_m > 0.0:
        path = graph.lanes[lane_id].path
        points.append(path.xy(np.arange(at + 1.0, path.length_m, 1.0), aside))
        left_m -= path.length_m - at
        heading, at = float(path.heading(np.array([path.length_m]))[0]), 0.0
        onward = [(abs(math.remainder(float(graph.lanes[n].path.heading(np.zeros(1))[0] - heading), math.tau)), n)
                  for n in graph.successors(lane_id)]  # fmt: skip
        lane_id = min(onward)[1] if onward else None
    ahead = np.array([math.cos(heading), math.sin(heading)])
    reached = np.vstack(points) if points else np.empty((0, 2))
    return np.vstack([reached, (reached[-1] if len(reached) else end) + max(left_m, 5.0) * ahead])


def check_times(scene: TrafficScene, track: Track, verdict: Verdict) -> None:
    """No gaps. Who is not there from step 0 enters while it is observed, where the map has nothing before a lane."""
    first, scenario = int(track.timesteps[0]), scene.source
    if not np.array_equal(track.timesteps, first + np.arange(len(track.timesteps))):
        verdict.note("gaps in", track.track_id)
    if first == 0:
        return
    if track.category != 1 or first > scenario.last_observed:
        verdict.note(track.track_id, "of category", track.category, "begins at timestep", first)
    lanes = scenario.graph.lanes
    led_to = {after for lane in lanes.values() for after in lane.successors}
    begins = np.array([lane.centerline[0] for n, lane in lanes.items() if n not in led_to])
    apart = float(np.hypot(*(begins - track.position[0]).T).min())
    if apart > 0.5 * track.size.length_m + ENTERS_WITHIN_M:
        verdict.note(track.track_id, "begins at timestep", first, "but", round(apart, 1), "m from where lanes begin")
    agent = next(one for one in scene.sidecar.agents if one.track_id == track.track_id)
    if agent.spawn.timestep != first:
        verdict.note(track.track_id, "begins at timestep", first, "by its record at", agent.spawn.timestep)


def check_leaders(scene: TrafficScene, track: Track, sizes: dict[str, tuple[float, float]], verdict: Verdict) -> None:
    """TTC to who is ahead on the path driven: aligned, overlapping the swept width, closing by positions.

    A recorded vehicle that rolls backwards against its heading is noise of the tracker, not a leader to be closed on.
    """
    moved = np.append(True, np.hypot(*np.diff(track.position, axis=0).T) > 1e-3)
    path = Polyline(np.vstack([track.position[moved], way_on(scene.source.graph, track)]))
    own_s, _ = path.frenet(track.position)
    own_v = np.hypot(*track.velocity.T)
    length, width = sizes[track.track_id]
    for other in (*scene.source.tracks, *scene.generated):
        if other.track_id == track.track_id or len(other.timesteps) < 2:
            continue
        steps, at, own = np.intersect1d(other.timesteps, track.timesteps, assume_unique=True, return_indices=True)
        if steps.size == 0 or np.hypot(*(other.position[at] - track.position[own]).T).min() > 80.0:
            continue
        s, d = path.frenet(other.position[at])
        heading = path.heading(s)
        elapsed = np.gradient(other.timesteps * DT_S)
        speed = np.gradient(other.position, axis=0) / elapsed[:, None]
        along = speed[at, 0] * np.cos(heading) + speed[at, 1] * np.sin(heading)
        other_length, other_width = sizes[other.track_id]
        leads = (
            (np.cos(other.heading[at] - heading) > 0.7)
            & (np.abs(d) < (width + other_width) / 2 - 0.1)
            & (s > own_s[own] + 1.0)
            & (s < path.length_m - 1.0)
        )
        if other.track_id not in {one.track_id for one in scene.generated}:
            leads &= along > -0.2
        gap = s - own_s[own] - (length + other_length) / 2
        closing = own_v[own] - along
        for row in np.flatnonzero(leads & (closing > 0.05) & (gap < TTC_MIN_S * closing)):
            step, here = int(steps[row]), int(own[row])
            box = Moving(
                other.track_id, other_length, other_width, [(*other.position[at][row], other.heading[at][row])]
            )
            room = free_run(path, float(own_s[here]), box.polygon(0), length, width, most_m=float(gap[row]) + 15.0)
            if room < TTC_MIN_S * closing[row]:
                verdict.note(
                    "TTC", round(room / float(closing[row]), 2), "s:", track.track_id, "to", other.object_type,
                    other.track_id, "at timestep", step, "gap", round(room, 2), "own", round(float(own_v[here]), 2),
                    "leader", round(float(along[row]), 2), "aside", round(float(d[row]), 2),
                )  # fmt: skip
                break


def free_run(
    path: Polyline, s: float, other: shapely.Polygon, length_m: float, width_m: float, *, most_m: float
) -> float:
    """How far the own box can be pushed along the path until it touches the other, m, to 5 cm; inf beyond most_m."""
    for pushed in np.arange(0.0, most_m, 0.05):
        at = np.array([s + pushed])
        own = Moving("", length_m, width_m, [(*path.point(at)[0], float(path.heading(at)[0]))])
        if own.polygon(0).intersects(other):
            return float(pushed)
    return math.inf


def assumed(track: Track, sizes: dict[str, tuple[float, float]]) -> tuple[float, float]:
    """The larger of the labelled box and the one that a reader without labels takes: neither may overlap."""
    default = DEFAULT_SIZES[track.object_type]
    return max(sizes[track.track_id][0], default.length_m), max(sizes[track.track_id][1], default.width_m)


def with_tracks(scene: TrafficScene, generated: Sequence[Track]) -> TrafficScene:
    """A scene with other inserted tracks."""
    assert scene.source is not None
    return replace(scene, recording=replace(scene.recording, tracks=(*scene.source.tracks, *generated)))


def check_scene(scene: TrafficScene) -> list[str]:
    """Everything issue-worthy about an exported scene."""
    scenario, verdict = scene.source, Verdict()
    sizes = {track.track_id: (track.size.length_m, track.size.width_m) for track in scenario.tracks}
    sizes |= {agent.track_id: (agent.length_m, agent.width_m) for agent in scene.sidecar.agents}
    recorded = [moving_boxes(t, *assumed(t, sizes), scenario.num_steps) for t in scenario.tracks]
    generated = [moving_boxes(t, *sizes[t.track_id], scenario.num_steps) for t in scene.generated]
    widest = [moving_boxes(t, *assumed(t, sizes), scenario.num_steps) for t in scene.generated]
    lanes = [(lane.path, lane.width_m / 2) for lane in scenario.graph.lanes.values() if lane.lane_type == "VEHICLE"]
    check_overlaps(widest, recorded, verdict)
    for track, boxes in zip(scene.generated, generated, strict=True):
        check_times(scene, track, verdict)
        if track.timesteps[-1] < min(LAST_OBSERVED, scenario.num_steps - 1):
            verdict.note(track.track_id, "ends before it is predicted")
        if not (
            np.isfinite(track.position).all() and np.isfinite(track.heading).all() and np.isfinite(track.velocity).all()
        ):
            verdict.note("a number that is none in", track.track_id)
            continue
        check_drivable(boxes, scenario.graph.drivable, verdict)
        check_motion(track, verdict)
        check_direction(track, lanes, verdict)
        check_leaders(scene, track, sizes, verdict)
        check_after_end(scene, track, sizes, verdict)
    replay = scene.sidecar.replay
    if replay.max_position_error_m > 0.001 or replay.max_heading_error_rad > 0.001:
        verdict.note("replay is off by", replay.max_position_error_m, "m or", replay.max_heading_error_rad, "rad")
    states = sum(len(track.timesteps) for track in scenario.tracks)
    if replay.checked and replay.states < states:
        verdict.note("replayed", replay.states, "states of", states)
    return verdict.found
