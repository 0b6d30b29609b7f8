"""Whether the states of inserted vehicles are safe and can be driven: positions, headings, velocities, boxes, the map.

`judge` takes all of a scene, as `hid2 validate` and `hid2 evaluate` do; the final check (`insertion/finalise.py`) asks
the same functions of each vehicle.
What leads is asked twice, of the path that an agent drives and of the lanes (`ttc_on_lanes`): a path misses what is on
the lane beside its box, lanes miss what has just left for another one.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import shapely

from hid2.agents import BoxSize, FloatArray, IntArray
from hid2.judge.findings import (
    FOLLOWER_HEADWAY_S,
    FOLLOWER_LACKS_MPS2,
    LEADER_LENGTH_S,
    LEAST,
    MOTION_LIMITS,
    Bounds,
    Finding,
    MotionProfile,
    Quantity,
)
from hid2.kernels.lane_matching import SLIVER_M
from hid2.kernels.path_intervals import SAME_WAY
from hid2.kernels.trajectory import first_overlapping
from hid2.measures.arrays import BoolArray
from hid2.measures.driven_lanes import LaneView
from hid2.measures.following import LaneLeaders, leaders
from hid2.measures.manoeuvres import ManeuverKind, detect
from hid2.measures.surrogates import END_HORIZON_S, earliest_contact, encroachments
from hid2.occupancy.agent_states import AgentStates, PathLeaders
from hid2.occupancy.traffic import Traffic
from netconvert.geometry import box_corners, differences, wrap_angle
from netconvert.lane_graph import LaneGraph, crossable

# No tunables from here to _INTERSECTION_DEG: what states are held to.
_FOLLOWER_MPS = 3.0  # speed above which FOLLOWER_HEADWAY_S is asked of a follower, m/s
_FOLLOWER_FOR_S = 1.0  # least duration of a headway below FOLLOWER_HEADWAY_S that counts, s
_LACKS_FOR_S = 0.5  # least duration of a follower's lack of braking that counts, s
_BRAKES_WITHIN_S = 1.0  # time that a follower has to brake, s: its mean braking in that time is no lack
_END_DECEL_MPS2 = 3.0  # deceleration of a driver after the last step, m/s2
_END_REACTION_S = 1.0  # time from the last step until a driver brakes, s
_LANE_DEG = 60.0  # largest angle of a vehicle to the lane below it outside intersections, degrees
_INTERSECTION_DEG = 90.0  # largest angle of a vehicle to the lane below it in intersections, degrees
_OUTLINE_STEP_M = 0.5  # point spacing; no tunable: between two a side leaves the road by less than the tolerance spares


def judge(states: AgentStates, bounds: Bounds) -> list[Finding]:
    """Worst findings on inserted vehicles, by quantity and other agent. Inserted ones are the last agents of states."""
    arrays = states.arrays
    inserted = np.flatnonzero(arrays.generated)
    found: list[Finding] = []
    for agent in inserted.tolist():
        found += of_motion(states, agent, bounds)
        found += of_road(states, agent, BoxSize(arrays.length[agent], arrays.width[agent]), bounds)
        others = np.delete(np.arange(arrays.num_agents), agent)
        found += of_boxes(states, agent, others, spare_m=bounds.spare_box_m)
        led_by = states.leaders_on_path(agent, others, aside_m=bounds.spare_aside_m)
        found += ttc_on_driven_path(states, agent, led_by, bounds)
        found += headway_on_driven_path(states, agent, led_by)
        found += of_end(states, agent, others, bounds)
    led = leaders(states)
    found += ttc_on_lanes(states, led, bounds)
    found += of_recorded_followers(states, inserted, bounds)
    found += of_crossings(states, bounds, first_row=int(inserted[0]) if inserted.size else arrays.num_agents)
    found += headways(states, led)
    # the worst of each comes last: of times the shortest
    found.sort(key=lambda one: -one.value if one.quantity in LEAST else one.value)
    worst = {(one.track_id, one.quantity, one.other): one for one in found}
    return sorted(worst.values(), key=lambda one: (one.track_id, one.step, one.quantity, one.other or ""))


# what a vehicle does by itself


def of_motion(states: AgentStates, agent: int, bounds: Bounds) -> Iterator[Finding]:
    """Limits of motion, by central differences of position and heading, each at its worst step; also by velocities."""
    arrays, rows, ends = states.arrays, states.row_span(agent), bounds.end_rows
    heading, derivative = np.unwrap(arrays.heading[rows]), partial(differences, step=arrays.step_s)
    stated = [arrays.velocity[rows]] if bounds.by_stated else []
    for velocity in (derivative(arrays.position[rows]), *stated):
        profile = MotionProfile.of(velocity, heading, derivative)
        for quantity, (value_of, bound_of) in MOTION_LIMITS.items():
            values = value_of(profile)[ends : len(heading) - ends]
            yield from _worst(states, rows.start + ends, quantity, values, bound_of(bounds))


def of_road(states: AgentStates, agent: int, size: BoxSize, bounds: Bounds) -> Iterator[Finding]:
    """The footprint of a vehicle of a size on the drivable area, its heading with the lane, the lines it crosses."""
    rows, graph = states.row_span(agent), states.lanes.graph
    tolerance_m = bounds.drivable_share * bounds.limits.drivable_tolerance_m
    position, heading = states.arrays.position[rows], states.arrays.heading[rows]
    outside = outside_m(position, heading, *size, graph, tolerance_m=tolerance_m)
    yield from _worst(states, rows.start, Quantity.OFF_ROAD, outside, tolerance_m)
    angle, limit = against_lane_deg(states, np.arange(rows.start, rows.stop))
    yield from _worst(states, rows.start, Quantity.AGAINST_LANE, angle, limit)
    yield from (
        Finding(one.track_id, round(one.crossing_s / states.arrays.step_s), Quantity.SOLID_LINE, 1.0, 0.0)
        for one in detect(states, among=[agent])
        if one.kind is ManeuverKind.LANE_CHANGE
        and not crossable(graph.lanes[one.source_lane].mark_type("left" if one.side > 0 else "right"))
    )


def _worst(
    states: AgentStates, first: int, quantity: Quantity, values: FloatArray, limit: FloatArray | float
) -> Iterator[Finding]:
    """Where values of one agent, at row `first` and those behind it, are most above their limit, if anywhere."""
    over = values - limit
    if over.max(initial=0.0) > 0.0:
        at = int(np.argmax(over))
        of = states.arrays.track_ids[states.arrays.agent[first]], int(states.arrays.step[first + at])
        yield Finding(*of, quantity, float(values[at]), float(np.broadcast_to(limit, over.shape)[at]))


def outside_m(
    position: FloatArray, heading: FloatArray, length_m: FloatArray | float, width_m: FloatArray | float,
    graph: LaneGraph, *, tolerance_m: float,
) -> FloatArray:  # fmt: skip
    """How far the outlines of boxes (N,), sides too, reach out of the drivable area, m; 0 up to tolerance_m."""
    corners = box_corners(position, heading, length_m=length_m, width_m=width_m)
    out = np.zeros(len(corners))
    off = np.flatnonzero(~shapely.contains(graph.drivable, shapely.polygons(corners)))
    if not off.size:
        return out
    rings = shapely.linearrings(corners[off])
    xy, box = shapely.get_coordinates(shapely.segmentize(rings, _OUTLINE_STEP_M), return_index=True)
    far = ~shapely.contains_xy(graph.drivable, xy[:, 0], xy[:, 1])
    far[far] = ~shapely.dwithin(graph.drivable, shapely.points(xy[far]), tolerance_m)
    away = shapely.distance(graph.drivable, shapely.points(xy[far]))
    np.maximum.at(out, off[box[far]], np.where(np.isnan(away), np.inf, away))  # inf where there is no area at all
    return out


def against_lane_deg(view: LaneView, rows: IntArray) -> tuple[FloatArray, FloatArray]:
    """Least angle (R,) to the lanes that hold the centres, degrees, 0 off every lane; and its limit.

    rows: of the arrays. The angle is that of the heading, or of the motion where it is larger. A vehicle that keeps to
    the lane matched to it is looked at no further.
    """
    arrays, lanes, matches = view.arrays, view.lanes, view.matches
    if not lanes.lane_ids.size:
        return np.zeros(len(rows)), np.full(len(rows), _LANE_DEG)
    lane, position, heading = matches.lane[rows], arrays.position[rows], arrays.heading[rows]
    turned = np.degrees(np.abs(wrap_angle(heading - lanes.heading(lane, matches.s[rows]))))
    keeps = (lane >= 0) & (np.abs(matches.d[rows]) <= lanes.half_width[lane] + SLIVER_M) & (turned <= _LANE_DEG)
    angle, limit = np.where(keeps, turned, 0.0), np.full(len(rows), _LANE_DEG)
    doubtful = np.flatnonzero(~keeps)
    if not doubtful.size:
        return angle, limit
    position, heading, direction = position[doubtful], heading[doubtful], matches.direction[rows][doubtful]
    least, held = np.full(doubtful.size, np.inf), np.zeros(doubtful.size, dtype=np.bool_)
    low, high, box = position.min(axis=0), position.max(axis=0), lanes.box
    near = (box[:, 0] <= high[0]) & (box[:, 1] <= high[1]) & (box[:, 2] >= low[0]) & (box[:, 3] >= low[1])
    for k in np.flatnonzero(near).tolist():
        one = lanes.graph.lanes[int(lanes.lane_ids[k])]
        s, d = one.path.frenet(position)
        beside = (s >= 0.0) & (s <= one.path.length_m) & (np.abs(d) <= lanes.half_width[k] + SLIVER_M)
        inside = beside & (np.abs(d) <= lanes.half_width[k])
        turned = np.degrees(np.abs(wrap_angle(np.stack([heading, direction]) - one.path.heading(s))).max(axis=0))
        least[beside] = np.minimum(least[beside], turned[beside])
        held |= inside
        if one.is_intersection:
            limit[doubtful[inside]] = _INTERSECTION_DEG
    angle[doubtful] = np.where(held, least, 0.0)
    return angle, limit


# what a vehicle does to others


def of_boxes(states: AgentStates, agent: int, others: IntArray, *, spare_m: float) -> Iterator[Finding]:
    """Every other box that a vehicle's own meets, at the steps and halfway between them, at the first time."""
    traffic, span, left = states.traffic, states.span(agent), others
    own, heading = traffic.position[agent, span], traffic.heading[agent, span]
    length, width = traffic.length_m[agent] + 2 * spare_m, traffic.width_m[agent] + 2 * spare_m
    while left.size:
        k, step = first_overlapping(own, heading, length, width, *traffic.rows(left.tolist()).span(span).boxes)
        if k < 0:
            return
        other = int(left[k])
        boxes = [agent, other], [length, traffic.length_m[other]], [width, traffic.width_m[other]]
        shared_m2 = _shared_m2(traffic, *boxes, step=span.start + step)
        yield _finding(states, (agent, other), span.start + step, Quantity.OVERLAP, shared_m2, 0.0)
        left = np.delete(left, k)


def _shared_m2(traffic: Traffic, agents: list[int], length_m: list[float], width_m: list[float], *, step: int) -> float:
    """Ground that the boxes of two agents share at a step or halfway to the next, m2."""
    position, heading = traffic.position[agents], traffic.heading[agents]
    following = min(step + 1, traffic.num_steps - 1)
    there = traffic.present[agents, following]
    way = np.where(there[:, None], position[:, following] - position[:, step], 0.0)
    turn = np.where(there, 0.5 * wrap_angle(2.0 * (heading[:, following] - heading[:, step])), 0.0)  # of a box, mod pi
    most = 0.0
    for share in (0.0, 0.5):
        at, angle = position[:, step] + share * way, heading[:, step] + share * turn
        own, other = shapely.polygons(box_corners(at, angle, length_m=length_m, width_m=width_m))
        most = max(most, float(shapely.area(shapely.intersection(own, other))))
    return most


def ttc_on_driven_path(states: AgentStates, agent: int, led: PathLeaders, bounds: Bounds) -> Iterator[Finding]:
    """The least TTC of a vehicle to each agent that leads on the path that it drives."""
    critical_s = bounds.conflict.ttc_min_s
    for other, ttc_s in zip(led.agents.tolist(), led.ttc_s, strict=True):
        step = int(np.argmin(ttc_s))
        if ttc_s[step] < critical_s:
            yield _finding(states, (agent, other), step, Quantity.TTC_LEADER, float(ttc_s[step]), critical_s)


def of_end(states: AgentStates, agent: int, others: IntArray, bounds: Bounds) -> Iterator[Finding]:
    """Contacts after a vehicle's last step, all at the velocities stated then: too soon, or not to be avoided.

    Not avoided: with an agent that it meets also when it brakes with _END_DECEL_MPS2 after _END_REACTION_S. A vehicle
    that comes from behind brakes itself: it counts for the TTC alone.
    """
    last = states.span(agent).stop - 1
    agents = np.append(agent, others[states.traffic.present[others, last]])
    here, at = states.traffic.at(last).rows(agents.tolist()), states.arrays.row_of[agents, last]
    stated = np.where((at >= 0)[:, None], states.arrays.velocity[at], here.velocity[:, 0])
    here = replace(here, velocity=stated[:, None])
    least_s = bounds.conflict.end_ttc_min_s + bounds.spare_end_s
    for quantity, other, ttc_s in contacts_at_end(here, bounds, step_s=states.arrays.step_s):
        limit = END_HORIZON_S if quantity is Quantity.END_CONTACT else least_s
        yield _finding(states, (agent, int(agents[other])), last, quantity, ttc_s, limit)


def contacts_at_end(here: Traffic, bounds: Bounds, *, step_s: float) -> Iterator[tuple[Quantity, int, float]]:
    """Contacts to come of the first of some agents, all from one step on at constant velocity: quantity, row, s.

    Of a contact that braking does not avoid, as `of_end` has it, the agent is the next one that it would meet.
    """
    ttc_s, other = _first_contact(here)
    if other < 0:
        return
    if ttc_s < bounds.conflict.end_ttc_min_s + bounds.spare_end_s:
        yield Quantity.END_TTC, other, ttc_s
    position, heading = here.position[:, 0], here.heading[:, 0]
    behind = (position - position[0]) @ np.array([math.cos(heading[0]), math.sin(heading[0])]) < 0.0
    no_followers = np.flatnonzero(~(behind & (np.cos(heading - heading[0]) > SAME_WAY)))  # 0 is the own box
    if not _meets_braking(here.rows(no_followers.tolist()), step_s):
        return
    for other in no_followers[1:].tolist():  # one met only because it brakes sees the brakes
        pair = here.rows([0, other])
        ttc_s, met = _first_contact(pair)
        if met > 0 and _meets_braking(pair, step_s):
            yield Quantity.END_CONTACT, other, ttc_s


def _first_contact(here: Traffic) -> tuple[float, int]:
    """As `earliest_contact`, of the first of some agents (one step)."""
    position, heading, velocity = here.position[:, 0], here.heading[:, 0], here.velocity[:, 0]
    return earliest_contact(0, position, heading, velocity, here.length_m, here.width_m)


def _meets_braking(here: Traffic, step_s: float) -> bool:
    """Whether the first of some agents (one step), which brakes after a while, meets one that keeps its velocity."""
    time_s = step_s * np.arange(1, round(END_HORIZON_S / step_s) + 1)
    speed = math.hypot(*here.velocity[0, 0])
    braking_s = np.minimum(np.maximum(time_s - _END_REACTION_S, 0.0), speed / _END_DECEL_MPS2)
    lost_s = 0.5 * _END_DECEL_MPS2 * braking_s**2 / max(speed, 1e-9)
    rolling_s = np.minimum(time_s, _END_REACTION_S) + braking_s - lost_s
    own = here.position[0] + rolling_s[:, None] * here.velocity[0]
    others = here.position[1:] + time_s[:, None] * here.velocity[1:]
    headings = np.repeat(here.heading, time_s.size, axis=1)
    met, _ = first_overlapping(
        own, headings[0], here.length_m[0], here.width_m[0], others, headings[1:],
        np.ones(others.shape[:2], dtype=np.bool_), here.length_m[1:], here.width_m[1:],
    )  # fmt: skip
    return bool(met >= 0)


# what lanes and crossing paths show of all


def ttc_on_lanes(states: AgentStates, led: LaneLeaders, bounds: Bounds) -> Iterator[Finding]:
    """TTC on the lane path: of inserted vehicles to their leaders, of recorded followers to inserted leaders."""
    arrays, conflict = states.arrays, bounds.conflict
    inserted = arrays.generated[arrays.agent]
    follows = ~inserted & arrays.moving[arrays.agent] & (led.agent >= 0) & arrays.generated[np.maximum(led.agent, 0)]
    for rows, critical_s, quantity in (
        (inserted, conflict.ttc_min_s, Quantity.TTC_LEADER),
        (follows, conflict.follower_ttc_min_s, Quantity.TTC_FOLLOWER),
    ):
        for at in np.flatnonzero(rows & (led.ttc_s < critical_s)).tolist():
            follower, leader = int(arrays.agent[at]), int(led.agent[at])
            pair = (follower, leader) if quantity is Quantity.TTC_LEADER else (leader, follower)
            yield _finding(states, pair, int(arrays.step[at]), quantity, float(led.ttc_s[at]), critical_s)


def of_recorded_followers(states: AgentStates, inserted: IntArray, bounds: Bounds) -> Iterator[Finding]:
    """TTC and braking of recorded followers behind inserted vehicles, also of other lanes, on their driven path."""
    arrays, critical_s = states.arrays, bounds.conflict.follower_ttc_min_s
    leaders_of = states.traffic.rows(inserted.tolist())
    for follower in np.flatnonzero(arrays.moving_on_roads & ~arrays.generated).tolist():
        led = states.leaders_among(follower, leaders_of)
        for leader, ttc_s in zip(inserted[led.agents].tolist(), led.ttc_s, strict=True):
            step = int(np.argmin(ttc_s))
            if ttc_s[step] < critical_s:
                pair = leader, follower
                yield _finding(states, pair, step, Quantity.TTC_FOLLOWER, float(ttc_s[step]), critical_s)
        lacks_mps2, at = lacked_braking(states, follower, led)
        for row in np.flatnonzero(lacks_mps2 > FOLLOWER_LACKS_MPS2).tolist():
            pair, value = (int(inserted[led.agents[row]]), follower), float(lacks_mps2[row])
            yield _finding(states, pair, int(at[row]), Quantity.FOLLOWER_BRAKING, value, FOLLOWER_LACKS_MPS2)


def lacked_braking(states: AgentStates, follower: int, led: PathLeaders) -> tuple[FloatArray, IntArray]:
    """Braking, m/s2, that a follower lacks for _LACKS_FOR_S behind each of its leaders (R,), and the last step of it.

    What it lacks: the constant braking that would do (DRAC), less what it brakes in the mean within _BRAKES_WITHIN_S.
    """
    span, step_s = states.span(follower), states.arrays.step_s
    steps, lasts = span.stop - span.start, round(_LACKS_FOR_S / step_s)
    within = min(round(_BRAKES_WITHIN_S / step_s), steps - 1)
    if not led.agents.size or steps < lasts or within < 1:
        return np.zeros(led.agents.size), np.zeros(led.agents.size, dtype=np.int64)
    speed = states.speed(follower)[span]
    brakes_mps2 = (speed[:-within] - speed[within:]) / (within * step_s)
    brakes_mps2 = np.append(brakes_mps2, np.full(within, brakes_mps2[-1]))  # to its end as shortly before
    lacks_mps2 = led.drac_mps2[:, span] - np.maximum(brakes_mps2, 0.0)
    lasting = np.lib.stride_tricks.sliding_window_view(lacks_mps2, lasts, axis=1).min(axis=2)
    return lasting.max(axis=1), span.start + lasting.argmax(axis=1) + lasts - 1


def of_crossings(states: AgentStates, bounds: Bounds, *, first_row: int) -> Iterator[Finding]:
    """PET of moving agents with crossing swept paths, of pairs with a second agent at `first_row` or later."""
    arrays, critical_s = states.arrays, bounds.conflict.pet_min_s
    moving = np.flatnonzero(arrays.moving)
    for first, second, pet_s, passed in encroachments(arrays, first_row=first_row, cap_s=critical_s, agents=moving):
        if pet_s < critical_s - 1e-9:
            yield _finding(states, (second, first), passed[1], Quantity.PET, pet_s, critical_s)


def headways(states: AgentStates, led: LaneLeaders, beyond_m: FloatArray | float = 0.0) -> Iterator[Finding]:
    """Recorded followers below FOLLOWER_HEADWAY_S to inserted leaders, and below what they kept in the recording.

    beyond_m (A,): by how much boxes of the states are longer, ahead, than exported.
    """
    least = _too_short_headways(states, led, states.arrays.generated[np.maximum(led.agent, 0)], beyond_m)
    recorded = recorded_headways(states) if least else {}
    for agent, (headway_s, at) in least.items():
        if recorded.get(agent, math.inf) > headway_s:
            leader, step = int(led.agent[at]), int(states.arrays.step[at])
            yield _finding(states, (leader, agent), step, Quantity.FOLLOWER_HEADWAY, headway_s, FOLLOWER_HEADWAY_S)


def headway_on_driven_path(
    states: AgentStates, agent: int, led: PathLeaders, beyond_m: FloatArray | float = 0.0
) -> Iterator[Finding]:
    """Too short a time headway of a vehicle to the next one of those that lead it on the path that it drives."""
    arrays = states.arrays
    vehicles = arrays.vehicle[led.agents]
    leader, gap_m = PathLeaders(led.agents[vehicles], led.gap_m[vehicles], led.closing_mps[vehicles]).next_ones()
    leader_m = (arrays.length - beyond_m)[leader]  # without a leader any: its gap is inf
    headway_s, at = sustained_headway(gap_m, leader_m, states.speed(agent), arrays.step_s)
    if headway_s < FOLLOWER_HEADWAY_S:
        pair = agent, int(leader[at])
        yield _finding(states, pair, at, Quantity.FOLLOWER_HEADWAY, headway_s, FOLLOWER_HEADWAY_S)


def recorded_headways(states: AgentStates) -> dict[int, float]:
    """Time headways, s, below the limit that recorded followers kept to leaders in the recording, by agent."""
    generated = states.arrays.generated[states.arrays.agent]
    alone = replace(states.matches, lane=np.where(generated, -1, states.matches.lane))
    found = _too_short_headways(states, leaders(replace(states, matches=alone)), ~generated)
    return {agent: headway_s for agent, (headway_s, _) in found.items()}


def sustained_headway(
    gap_m: FloatArray, leader_m: FloatArray | float, speed_mps: FloatArray, step_s: float
) -> tuple[float, int]:
    """Least headway, s, at or below which a follower stays for _FOLLOWER_FOR_S, and the last step of that; inf: never.

    Headway = (gap + min(leader's length, LEADER_LENGTH_S v)) / v: at 6 m/s a car's length alone would be .8 s.
    gap_m (T,): between bumpers, inf where it follows nothing; leader_m: the leader's length; speed_mps (T,): its own,
    above _FOLLOWER_MPS alone.
    """
    lasts = round(_FOLLOWER_FOR_S / step_s)
    if gap_m.size < lasts:
        return math.inf, 0
    front_m = gap_m + np.minimum(leader_m, LEADER_LENGTH_S * speed_mps)
    headway_s = np.where(speed_mps > _FOLLOWER_MPS, front_m / np.maximum(speed_mps, _FOLLOWER_MPS), np.inf)
    window_max_s = np.lib.stride_tricks.sliding_window_view(headway_s, lasts).max(axis=1)
    at = int(np.argmin(window_max_s))
    return float(window_max_s[at]), at + lasts - 1


def _too_short_headways(
    states: AgentStates, led: LaneLeaders, rows: BoolArray, beyond_m: FloatArray | float = 0.0
) -> dict[int, tuple[float, int]]:
    """By recorded agent its sustained headway, of rows (N,), to its lane leader, if too short, and its row."""
    arrays, speed = states.arrays, states.row_speed
    follower = (arrays.moving & ~arrays.generated)[arrays.agent]
    gap_m = np.where(rows & follower & (led.agent >= 0), led.gap_m, np.inf)
    leader_m = (arrays.length - beyond_m)[np.maximum(led.agent, 0)]
    found: dict[int, tuple[float, int]] = {}
    for agent in np.unique(arrays.agent[gap_m < FOLLOWER_HEADWAY_S * speed]).tolist():
        own = states.row_span(agent)
        headway_s, at = sustained_headway(gap_m[own], leader_m[own], speed[own], arrays.step_s)
        if headway_s < FOLLOWER_HEADWAY_S:
            found[agent] = headway_s, own.start + at
    return found


def _finding(
    states: AgentStates, pair: tuple[int, int], step: int, quantity: Quantity, value: float, limit: float
) -> Finding:
    """A finding on the first of a pair of agents, about the second."""
    ids = states.arrays.track_ids
    return Finding(ids[pair[0]], step, quantity, value, limit, ids[pair[1]])
