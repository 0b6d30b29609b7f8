"""Flows: what enters at the map's edges, when, with which driver and request. Drawn before anything is driven.

Each vehicle is drawn from a stream of its own, by its lane and number: the same vehicles whatever is varied.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from hid2.agents import DEFAULT_SIZES, Policy
from hid2.drivers.driver import MIDDLE, desired_speeds, draw_driver
from hid2.insertion.requests import draw_size, draw_trigger
from hid2.insertion.routes import Routes
from hid2.params import Flow, Request
from hid2.scene import Scene, clearance_box
from hid2.vehicle import Start, VehicleRequest
from netconvert.lane_graph import Side

#: Largest distance of a lane that begins at the map's edge to the hull of all lanes, m. No tunable: what the edge is.
_EDGE_M = 15.0
_STREAM, _TRIGGERS = 77, 78  # random streams, apart from those of the rounds; no tunables: names


@dataclass(frozen=True, eq=False, slots=True)
class Arrival:
    """A vehicle that enters lane_id at the map's edge at due_s, or as soon after as there is room.

    start: without its place and speed, which it has when it enters, and its trigger, which counts from then.
    """

    lane_id: int
    due_s: float
    start: Start

    @property
    def vehicle_id(self) -> str:
        """Its id in the simulation."""
        return self.start.vehicle_id


def edge_lanes(scene: Scene, routes: Routes) -> list[int]:
    """Lanes for general motor traffic that begin at the map's edge, in order of their ids.

    No lane leads to one, nor to any of its row, and it begins near to the hull of all lanes. Elsewhere it is a turn
    pocket or a driveway: no vehicle appears there at traffic's speed.
    """
    graph = scene.grid.graph
    hull = shapely.convex_hull(shapely.multipoints(np.concatenate([lane.centerline for lane in graph.lanes.values()])))
    rows = (row for row in graph.rows() if not any(map(graph.predecessors, row)))
    begin = sorted(n for row in rows for n in row if n in routes.lanes and not graph.lanes[n].is_intersection)
    edge_m = shapely.distance(hull.boundary, shapely.points([graph.lanes[n].centerline[0] for n in begin]))
    return [n for n, off_m in zip(begin, edge_m.tolist(), strict=True) if off_m <= _EDGE_M]


def headway_s(veh_per_h: float, flow: Flow, rng: np.random.Generator) -> float:
    """Time to the next vehicle of a lane at a rate, s: a least headway, and an exponential one beyond."""
    mean_s = 3600.0 / veh_per_h
    least_s = min(flow.min_headway_s, 0.9 * mean_s)
    return least_s + (mean_s - least_s) * float(rng.exponential())


def arrivals(scene: Scene, routes: Routes, seed: Sequence[int]) -> list[Arrival]:
    """All that enter in the time of the scene, by time: shifted exponential headways on each entry lane.

    A vehicle is asked for a lane change with the share `request.lane_change` over those of lane change and straight.
    """
    config, flow = scene.config, scene.config.flow
    if flow.veh_per_h_lane <= 0.0:
        return []
    request = config.request
    changing = request.lane_change / max(request.lane_change + request.straight, 1e-9)
    found: list[Arrival] = []
    for lane_id in edge_lanes(scene, routes):
        offers = routes.offers(lane_id)
        due_s, number = 0.0, 0
        while offers:
            rng = np.random.default_rng([*seed, _STREAM, lane_id, number])
            due_s += headway_s(flow.veh_per_h_lane, flow, rng)
            if due_s >= scene.last_s:
                break
            offer = offers[int(rng.integers(len(offers)))]
            policy = Policy.LANE_CHANGE if rng.random() < changing else Policy.STRAIGHT
            sides: tuple[Side, ...] = ("left", "right") if rng.random() < 0.5 else ("right", "left")
            object_type, size = draw_size(request, rng)
            driver = draw_driver(config, rng, lane_speed_mps=scene.lane_speed(lane_id, rng))
            desired = desired_speeds(
                driver, config, rng, num_steps=scene.num_steps, step_s=scene.step_s, at_least_mps=driver.desired_mps
            )
            start = Start(
                vehicle_id=f"f{lane_id}_{number}", request=VehicleRequest(number, policy, 0.0, object_type, size),
                box=clearance_box(size, DEFAULT_SIZES[object_type]), route=offer.route,
                path=scene.paths.along(offer.route), start_m=0.0, start_mps=0.0, driver=driver, desired=desired,
                offset=MIDDLE, sides=sides,
            )  # fmt: skip
            found.append(Arrival(lane_id, due_s, start))
            number += 1
    return sorted(found, key=lambda one: (one.due_s, one.lane_id))


def trigger_after_s(arrival: Arrival, request: Request, seed: Sequence[int], duration_s: float) -> float:
    """t_trigger of an arrival, s from its entry, in a scene of some duration, s; from a stream of its own."""
    rng = np.random.default_rng([*seed, _TRIGGERS, arrival.lane_id, arrival.start.request.number])
    return draw_trigger(request, rng, duration_s)
