"""A scene as CommonRoad XML 2020a: lanelets, agents as dynamic obstacles, the recording vehicle as planning problem.

Ids of lanelets are those of the lane segments, obstacles are numbered behind them, each with its track's id in a
comment. Steps that a track lacks are between its neighbours. The format wants every obstacle at step 0: one that comes
later waits beside the map then, and is nowhere until its trajectory begins.
"""

import re
from hashlib import sha256
from itertools import count

import numpy as np
from lxml import etree
from lxml.builder import E

from bridge.recordings.recording import Recording
from hid2.agents import AV_ID, FloatArray
from hid2.occupancy.traffic import traffic_of
from netconvert.errors import NetError
from netconvert.geometry import arc_length, wrap_angle
from netconvert.gui_files import xml_bytes
from netconvert.lane_graph import SIDES, LaneGraph, LaneSegment
from netconvert.net_xml import SPEED_LIMIT_MPS

_OBSTACLES = {"vehicle": "car", "bus": "bus", "motorcyclist": "motorcycle", "cyclist": "bicycle"}
_OBSTACLES |= {"riderless_bicycle": "bicycle", "pedestrian": "pedestrian"}
_LANELETS = {"VEHICLE": "urban", "BUS": "busLane", "BIKE": "bicycleLane"}
#: Tolerances within which a planner has to come to where the recording vehicle was at last, m and rad.
_GOAL_M, _GOAL_RAD = 5.0, 0.5
#: Distance west of all lanes at which obstacles that come later wait, and distance between them, m.
_WEST_M, _APART_M = 100.0, 10.0


def commonroad_files(scene: Recording) -> dict[str, bytes]:
    """<id>.cr.xml by file name. Errors: NetError for the id of a lane that CommonRoad refuses."""
    if (least := min(scene.graph.lanes)) < 1:
        raise NetError(f"{scene.folder}: lane {least}: CommonRoad takes no such id, expected 1 or more; renumber it")
    name, ids = scene.scenario_id, count(max(scene.graph.lanes) + 1)
    traffic = traffic_of(scene.tracks, scene.num_steps, step_s=scene.step_s)
    agents: list[etree._Element] = []
    problem = []
    west, south = scene.graph.bounds[0] - _WEST_M
    for row, track in enumerate(scene.tracks):
        steps = np.flatnonzero(traffic.present[row])
        heading, speed = (np.interp(steps, track.timesteps, one) for one in (np.unwrap(track.heading), track.speed))
        states = np.column_stack([steps, traffic.position[row, steps], heading, speed])
        if track.track_id == AV_ID:
            problem.append(_problem(next(ids), states))
            continue
        box = E.rectangle(E.length(f"{track.size.length_m:.3f}"), E.width(f"{track.size.width_m:.3f}"))
        kind = E.type(_OBSTACLES.get(track.object_type, "unknown"))
        if steps[0] > 0:
            states = np.vstack([[0.0, west, south + _APART_M * row, 0.0, 0.0], states])
        obstacle = E.dynamicObstacle(kind, E.shape(box), _state("initialState", states[0]), id=str(next(ids)))
        if len(states) > 1:
            obstacle.append(E.trajectory(*(_state("state", state) for state in states[1:])))
        agents += [etree.Comment(f" track {re.sub('-(?=-)', '- ', track.track_id)} "), obstacle]  # XML: no "--"
    number = 1 + int.from_bytes(sha256(name.encode()).digest()[:6])  # which names of CommonRoad have
    known = {
        "commonRoadVersion": "2020a",
        "benchmarkID": f"ZAM_HID2-1_{number}_T-1",
        "date": "1970-01-01",
        "author": "hid2-sumo",
        "affiliation": "",
        "source": f"{scene.format} {name}",
        "timeStepSize": f"{scene.step_s:g}",
    }
    place = E.location(E.geoNameId("-999"), E.gpsLatitude("999"), E.gpsLongitude("999"))
    parts = (*(_lanelet(scene.graph, lane) for lane in scene.graph.lanes.values()), *agents, *problem)
    return {f"{name}.cr.xml": xml_bytes(E.commonRoad(known, place, E.scenarioTags(E.urban()), *parts))}


def _lanelet(graph: LaneGraph, lane: LaneSegment) -> etree._Element:
    lane_id, parts = lane.lane_id, []
    for side, bound in zip(SIDES, _bounds(lane), strict=True):
        mark = "dashed" if "DASH" in lane.mark_type(side) else "solid" if "SOLID" in lane.mark_type(side) else "unknown"
        points = (E.point(E.x(f"{x:.4f}"), E.y(f"{y:.4f}")) for x, y in bound.tolist())
        parts.append(E(f"{side}Bound", *points, E.lineMarking(mark)))
    parts += [E.predecessor(ref=str(other)) for other in graph.predecessors(lane_id)]
    parts += [E.successor(ref=str(other)) for other in graph.successors(lane_id)]
    for side in SIDES:
        beside = graph.neighbor(lane_id, side)
        if beside is not None:
            parts.append(E(f"adjacent{side.capitalize()}", ref=str(beside), drivingDir="same"))
    kinds = [_LANELETS[lane.lane_type], *(["intersection"] if lane.is_intersection else [])]
    return E.lanelet(*parts, *map(E.laneletType, kinds), id=str(lane_id))


def _bounds(lane: LaneSegment) -> tuple[FloatArray, FloatArray]:
    """Left and right bound with as many points, (N, 2) m, at equal shares of their lengths."""
    lines = [(points, arc_length(points)) for points in lane.sides]  # of which one may be a point
    shares = np.unique(np.round(np.concatenate([s / max(s[-1], 1e-9) for _, s in lines]), 6))
    left, right = (np.column_stack([np.interp(shares * s[-1], s, xy) for xy in points.T]) for points, s in lines)
    return left, right


def _state(tag: str, state: FloatArray) -> etree._Element:
    """A state: step, x, y m, heading rad, speed m/s."""
    step, x, y, heading, speed = state.tolist()
    place = E.position(E.point(E.x(f"{x:.6f}"), E.y(f"{y:.6f}")))
    known = {"orientation": f"{wrap_angle(heading):.6f}", "time": f"{step:.0f}", "velocity": f"{speed:.6f}"}
    return E(tag, place, *(E(key, E.exact(value)) for key, value in known.items()))


def _problem(number: int, states: FloatArray) -> etree._Element:
    """From where the recording vehicle was first to about where it was at last, at about that time."""
    start = _state("initialState", states[0])
    start.extend(E(key, E.exact("0.0")) for key in ("yawRate", "slipAngle"))
    last, x, y, heading, _ = states[-1].tolist()
    size, turned = f"{2 * _GOAL_M:g}", float(wrap_angle(heading))
    center = E.center(E.x(f"{x:.6f}"), E.y(f"{y:.6f}"))
    goal = E.goalState(E.position(E.rectangle(E.length(size), E.width(size), E.orientation(f"{heading:.6f}"), center)))
    for key, low, high in (
        ("orientation", f"{turned - _GOAL_RAD:.6f}", f"{turned + _GOAL_RAD:.6f}"),
        ("time", f"{states[0, 0] + 1:.0f}", f"{last:.0f}"),
        ("velocity", f"{0.0:.6f}", f"{SPEED_LIMIT_MPS:.6f}"),
    ):
        goal.append(E(key, E.intervalStart(low), E.intervalEnd(high)))
    return E.planningProblem(start, goal, id=str(number))
