"""The claims of a sidecar, looked up in the states: manoeuvres and events with status done. Part of the second checker.

A claim that is not seen gives a Finding "claim": its value is how far off the moment is that was seen, s (inf: never).

Decisions where evaluation.md and method.md are silent:
- lane change: the centre leaves the ground of a lane and is on that of the lane beside it, and stays 0.5 s on each
  side; it moves half a lane width across the path of the first lane. Lanes reached by joints stand for the lanes named.
- turn: between start and end, 0.5 s more on each side, the centre drives a lane of an intersection that turns at least
  30 degrees to that side, and the heading turns at least 20 degrees to it.
- overtake: relative to the path of the leader, extended along its lanes; behind and ahead by centres, in its lane
  within 1.75 m, beside it beyond that while the boxes are abreast. An event's at_s lies between the leaving and the
  return; what overtakes is the event's vehicle or, where that is said to be behind, the target.
- cut-in: the target's own path are the lanes that hold its centre at that moment, and those after them that it drives
  or, beyond its last step, could drive. The vehicle comes from ground that is of none of these lanes, from a lane whose
  direction is the path's within 30 degrees, and stays 0.5 s.
- merge: the two drive a lane, and before it different ones of its predecessors, each the one
  that it is on for longest; the one said to be ahead is, within a lane's width of the path: they join only then.
- lead, follow: the front one's centre is within 1.75 m of the path of the rear one.
- cross: both boxes have been on the same ground with 30 degrees between their headings, one of them near the moment.
"""

import math
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
import shapely
from second_checker import PET_DEG, Finding
from second_map import Bools, Floats, Line, line_of, turned
from second_scene import DRIVEN_TYPES, DT_S, SecondScene, SecondTrack

CLAIM_S = 0.5
#: Steps on each side of a crossing, and most steps during which both lanes or neither hold the centre.
STAYS, BETWEEN = 5, 5
TURN_DEG, TURNED_DEG = 30.0, 20.0
IN_LANE_M = 1.75


def claims(scene: SecondScene) -> Iterator[Finding]:
    """What sidecar claims and states do not show."""
    for track in scene.inserted:
        for one in scene.agents.get(track.track_id, {}).get("maneuvers", ()):
            if one["status"] == "done" and one["kind"] in MANEUVERS:
                off_s, at_s = MANEUVERS[one["kind"]](scene, track, one)
                yield from _told(scene, track.track_id, one["kind"], off_s, at_s)
    for one in scene.sidecar.get("events", ()):
        if one["status"] == "done":
            maker, target = scene.by_id.get(one["track_id"]), scene.by_id.get(one["target_track_id"])
            off_s = math.inf
            if maker is not None and target is not None:
                off_s = EVENTS[one["kind"]](scene, maker, target, one)
            name = f"{one['kind']} of {one['target_track_id']}"
            yield from _told(scene, str(one["track_id"]), name, off_s, float(one["at_s"] or 0.0))


def _told(scene: SecondScene, track_id: str, name: str, off_s: float, at_s: float) -> Iterator[Finding]:
    if off_s > CLAIM_S + 1e-9:
        yield Finding(scene.scenario_id, track_id, round(at_s / DT_S), "claim", off_s, CLAIM_S, name)


def crossings(scene: SecondScene, track: SecondTrack) -> list[tuple[float, int, int]]:
    """(time s, lane left, lane entered) of every change of lanes beside each other that stays."""
    held = [set(lanes) for lanes in scene.ground.agreeing(track.xy, track.heading)]
    found = []
    lanes = set().union(*held) if held else set()
    for first in lanes:
        source = scene.ground.chain([first])
        for second in scene.ground.beside(first) & scene.ground.lanes.keys():
            target = scene.ground.chain([second])
            common = source & target
            on_source = np.array([bool(one & (source - common)) for one in held])
            on_target = np.array([bool(one & (target - common)) for one in held])
            found += [
                (at_s, first, second)
                for at_s, row in _changes(track, on_source, on_target)
                if any({first, second} & one for one in held[max(0, row - STAYS) : row + STAYS])
            ]
    return found


def _changes(track: SecondTrack, before: Bools, after: Bools) -> Iterator[tuple[float, int]]:
    """Time (s) and row of each moment at which one ground is left for another one, 0.5 s on each side."""
    old, new = before & ~after, after & ~before
    for row in np.flatnonzero(old[:-1] & ~old[1:]):
        later = np.flatnonzero(new[row + 1 : row + 2 + BETWEEN])
        if not len(later):
            continue
        enters = row + 1 + int(later[0])
        if old[max(0, row - STAYS + 1) : row + 1].sum() == STAYS and new[enters : enters + STAYS].sum() == STAYS:
            yield (float(track.steps[row]) + float(track.steps[enters])) / 2 * DT_S, int(row)


def _lane_change(scene: SecondScene, track: SecondTrack, one: dict[str, Any]) -> tuple[float, float]:
    claimed = one["crossing_s"]
    if claimed is None:
        return math.inf, float(one["start_s"] or 0.0)
    source = scene.ground.chain([one["source_lane"]] if one["source_lane"] is not None else [])
    target = scene.ground.chain([one["target_lane"]] if one["target_lane"] is not None else [])
    times = [at_s for at_s, first, second in crossings(scene, track) if first in source and second in target]
    return min((abs(at_s - claimed) for at_s in times), default=math.inf), float(claimed)


def _turn(scene: SecondScene, track: SecondTrack, one: dict[str, Any]) -> tuple[float, float]:
    start, end = float(one["start_s"] or 0.0), one["end_s"]
    last = float(track.steps[-1]) * DT_S if end is None else float(end)
    sign = 1.0 if one["kind"] == "left_turn" else -1.0
    rows = np.flatnonzero(
        (track.steps * DT_S >= start - CLAIM_S - 1e-9) & (track.steps * DT_S <= last + CLAIM_S + 1e-9)
    )
    if not len(rows):
        return math.inf, start
    turns = any(
        sign * scene.ground.lanes[lane].turn_deg >= TURN_DEG and scene.ground.lanes[lane].in_intersection
        for lanes in scene.ground.holding(track.xy[rows]) for lane in lanes
    )  # fmt: skip
    heading = np.unwrap(track.heading)[rows]
    turned_deg = math.degrees(sign * float(heading[-1] - heading[0]))
    return (0.0 if turns and turned_deg >= TURNED_DEG else math.inf), start


def _beside(scene: SecondScene, track: SecondTrack, leader: SecondTrack) -> tuple[Floats, Floats, Floats] | None:
    """Times (P,) s at which both are there, and how far the track is ahead of its leader and left of its path, m."""
    steps, own, theirs = np.intersect1d(track.steps, leader.steps, assume_unique=True, return_indices=True)
    path = _whole_path(scene, leader, track)
    if not len(steps) or path is None:
        return None
    s, d = path.project(track.xy[own])
    leader_s, _ = path.project(leader.xy[theirs])
    return np.asarray(steps * DT_S, dtype=np.float64), s - leader_s, d


def _whole_path(scene: SecondScene, track: SecondTrack, follower: SecondTrack) -> Line | None:
    """The path of a track, with the lanes before its first and after its last step, 100 m or so each way.

    follower: where the track may be on several lanes, or have come from them, those that the follower drives on count.
    """
    ahead = scene.driven_line(track)
    driven = scene.lanes_of(follower)
    lanes = sorted(scene.ground.agreeing(track.xy[:1], track.heading[:1])[0], key=lambda n: n not in driven)
    before: list[Floats] = []
    if lanes:
        lane_id, left_m, seen = lanes[0], 100.0, set()
        s, d = scene.ground.lanes[lane_id].line.project(track.xy[:1])
        until = float(s[0]) - 1.0
        while left_m > 0.0 and lane_id not in seen:
            seen.add(lane_id)
            line = scene.ground.lanes[lane_id].line
            until = line.length_m if until is math.inf else until
            xy, direction = line.at(np.arange(0.0, max(until, 0.0), 1.0))
            before.insert(0, xy + d[0] * np.column_stack([-np.sin(direction), np.cos(direction)]))
            left_m -= line.length_m
            ways = sorted(
                scene.ground.predecessors[lane_id], key=lambda n: (n not in driven, abs(scene.ground.lanes[n].turn_deg))
            )
            if not ways:
                break
            lane_id, until = ways[0], math.inf
    after = track.xy[:1] if ahead is None else ahead.line.xy
    return line_of(np.vstack([*before, after]))


def _overtake_seen(times: Floats, ahead: Floats, d: Floats, reach_m: float) -> tuple[float, float, float] | None:
    """When it leaves the leader's lane from behind, is abreast, and is back ahead, s; None where it is no overtake."""
    out = np.abs(d) > IN_LANE_M
    abreast = np.flatnonzero(out & (np.abs(ahead) < reach_m))
    if not len(abreast):
        return None
    first, last = int(abreast[0]), int(abreast[-1])
    behind = np.flatnonzero(~out[:first] & (ahead[:first] < 0.0))
    back = last + 1 + np.flatnonzero(~out[last + 1 :] & (ahead[last + 1 :] > 0.0))
    if not len(behind) or not len(back):
        return None
    return float(times[behind[-1]]), float(times[first]), float(times[back[0]])


def _overtake(scene: SecondScene, track: SecondTrack, one: dict[str, Any]) -> tuple[float, float]:
    leader = scene.by_id.get(str(one["leader_track_id"]))
    start = float(one["start_s"] or 0.0)
    if leader is None:
        return math.inf, start
    seen = _beside(scene, track, leader)
    moments = None if seen is None else _overtake_seen(*seen, (track.length_m + leader.length_m) / 2)
    if moments is None:
        return math.inf, start
    left, _, back = moments
    # the crossing by the ground of the lanes, as of any lane change: the leader's own line may lie beside their middle
    off = [_lane_change(scene, track, one)[0]] if one["crossing_s"] is not None else [max(0.0, start - left)]
    if one["end_s"] is not None:
        off.append(max(0.0, back - float(one["end_s"])))
    return max(off), start


def _event_overtake(scene: SecondScene, track: SecondTrack, target: SecondTrack, one: dict[str, Any]) -> float:
    first, second = (track, target) if one["ahead"] is not False else (target, track)
    seen = _beside(scene, first, second)
    moments = None if seen is None else _overtake_seen(*seen, (track.length_m + target.length_m) / 2)
    if moments is None:
        return math.inf
    left, _, back = moments
    at = float(one["at_s"])
    return max(0.0, left - at, at - back)


def _own_lanes(scene: SecondScene, target: SecondTrack, row: int) -> set[int]:
    """The lanes of the target's own path, seen from where it is at a row: those it is on, and those on from them."""
    held = scene.ground.agreeing(target.xy, target.heading)
    first = set(held[row])
    drives = set().union(*held[row:])
    own, front = set(first), set(first)
    for _ in range(6):
        nexts = {
            after for lane in front for after in scene.ground.lanes[lane].successors if after in scene.ground.lanes
        }
        on_path = {after for after in nexts if after in drives}
        front = (on_path or nexts) - own
        own |= front
    behind = {before for lane in first for before in scene.ground.predecessors[lane]}
    return own | behind


def _event_cut_in(scene: SecondScene, track: SecondTrack, target: SecondTrack, one: dict[str, Any]) -> float:
    at = float(one["at_s"])
    row = target.row_of.get(round(at / DT_S))
    if row is None:
        return math.inf
    own = _own_lanes(scene, target, row)
    held = [set(lanes) for lanes in scene.ground.agreeing(track.xy, track.heading)]
    inside = np.array([bool(lanes & own) for lanes in held])
    beside = np.array([bool(lanes) and not lanes & own for lanes in held])
    offs = []
    seen = _beside(scene, track, target)
    if seen is None:
        return math.inf
    ahead = dict(zip(np.round(seen[0] / DT_S).astype(int).tolist(), seen[1].tolist(), strict=True))
    for moment, crossed in _changes(track, beside, inside):
        step = int(track.steps[crossed])
        mps = float(np.hypot(*target.moved[target.row_of[step]])) if step in target.row_of else 0.0
        near_m = max(1.8 * mps, 4.7 * (mps - float(np.hypot(*track.moved[crossed]))))
        near_m = 1.05 * near_m + 0.5 * (track.length_m + target.length_m) + 1.0  # by centres, and its own moment
        if 0.0 < ahead.get(step, -1.0) < near_m and _from_beside(scene, held[crossed], track.xy[crossed], own):
            offs.append(abs(moment - at))
    return min(offs, default=math.inf)


def _from_beside(scene: SecondScene, lanes: set[int], xy: Floats, own: set[int]) -> bool:
    """Whether one of the lanes lies beside one of the target's at a point and runs its way, within 30 degrees."""
    for lane_id in lanes:
        s, _ = scene.ground.lanes[lane_id].line.project(xy)
        direction = scene.ground.lanes[lane_id].line.at(s)[1]
        for other in own:
            line = scene.ground.lanes[other].line
            s, d = line.project(xy)
            inside = -1.0 <= s[0] <= line.length_m + 1.0
            if inside and abs(d[0]) < 6.0 and abs(float(turned(line.at(s)[1] - direction)[0])) < math.radians(30.0):
                return True
    return False


def _event_order(
    scene: SecondScene, track: SecondTrack, target: SecondTrack, one: dict[str, Any], within_m: float = IN_LANE_M
) -> float:
    """How far off the moment is at which the one is ahead on the path that the other one drives."""
    ahead = one["ahead"] if one["ahead"] is not None else one["kind"] == "lead"
    rear, front = (target, track) if ahead else (track, target)
    path = scene.driven_line(rear)
    steps, own, theirs = np.intersect1d(rear.steps, front.steps, assume_unique=True, return_indices=True)
    if path is None or not len(steps):
        return math.inf
    s, d = path.line.project(front.xy[theirs])
    follows = (np.abs(d) < within_m) & (s > path.own_m[own])
    return float(np.abs(steps[follows] * DT_S - float(one["at_s"])).min()) if follows.any() else math.inf


def _driven_lanes(scene: SecondScene, track: SecondTrack) -> Counter[int]:
    """Steps by the lane that it drives: the one that its centre is nearest to, with its heading."""
    driven: Counter[int] = Counter()
    for row, lanes in enumerate(scene.ground.agreeing(track.xy, track.heading)):
        here, heading = track.xy[row : row + 1], track.heading[row : row + 1]
        off = {
            lane: abs(float(scene.ground.lanes[lane].line.project(here)[1][0]))
            + 5.0 * math.radians(float(scene.ground.off_lane_deg(lane, here, heading)[0]))
            for lane in lanes
        }
        if off:
            driven[min(off, key=lambda lane: off[lane])] += 1
    return driven


def _event_merge(scene: SecondScene, track: SecondTrack, target: SecondTrack, one: dict[str, Any]) -> float:
    mine, theirs = _driven_lanes(scene, track), _driven_lanes(scene, target)
    for lane in mine.keys() & theirs.keys():
        ways = [[n for n in scene.ground.predecessors[lane] if n in driven] for driven in (mine, theirs)]
        if all(ways) and max(ways[0], key=lambda n: mine[n]) != max(ways[1], key=lambda n: theirs[n]):
            return _event_order(scene, track, target, one, within_m=2 * IN_LANE_M)
    return math.inf


def _event_cross(scene: SecondScene, track: SecondTrack, target: SecondTrack, one: dict[str, Any]) -> float:
    own, theirs = shapely.STRtree(target.boxes).query(track.boxes, predicate="intersects")
    crosses = np.abs(turned(track.heading[own] - target.heading[theirs])) >= math.radians(PET_DEG)
    if not crosses.any():
        return math.inf
    times = np.concatenate([track.steps[own[crosses]], target.steps[theirs[crosses]]]) * DT_S
    at = float(one["at_s"])
    return max(0.0, float(times.min()) - at, at - float(times.max()))


MANEUVERS = {"lane_change": _lane_change, "left_turn": _turn, "right_turn": _turn, "overtake": _overtake}
EVENTS = {
    "cut_in": _event_cut_in, "overtake": _event_overtake, "lead": _event_order, "follow": _event_order,
    "merge": _event_merge, "cross": _event_cross,
}  # fmt: skip


def seen(scene: SecondScene, track: SecondTrack) -> set[str]:
    """Kinds of manoeuvres that a vehicle is seen to do at some time, whatever is claimed."""
    whole = {"start_s": 0.0, "end_s": None}
    found = {kind for kind in ("left_turn", "right_turn") if _turn(scene, track, {**whole, "kind": kind})[0] == 0.0}
    if crossings(scene, track):
        found.add("lane_change")
    for leader in scene.tracks:
        if leader is not track and leader.object_type in DRIVEN_TYPES and leader.moves:
            beside = _beside(scene, track, leader)
            if beside is not None and _overtake_seen(*beside, (track.length_m + leader.length_m) / 2):
                found.add("overtake")
    return found
