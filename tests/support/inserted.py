"""Inserted vehicles by hand: a driver, a start on a route, a vehicle that SUMO is said to have driven."""

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from hand_drawn import draw_lane, draw_road, graph_of

from hid2.agents import BoxSize, Policy, Track
from hid2.conflicts.guard import Guard
from hid2.drivers.driver import MIDDLE, Driver
from hid2.insertion.sites import InsertionSites
from hid2.insertion.situations import Situation, Wanted
from hid2.insertion.surroundings import Surroundings
from hid2.motion.route import DrivenPath, Route
from hid2.occupancy.traffic import Traffic
from hid2.params import Config, Request, Spawn
from hid2.policy.observation import Foreseen, lay_across, target_path
from hid2.policy.overtake import Stage
from hid2.scene import Scene, build_scene
from hid2.vehicle import DrivenVehicle, Shift, Start, VehicleRequest
from netconvert.cells import build_cell_grid
from netconvert.lane_graph import LaneGraph, Side

CAR = BoxSize(4.5, 1.9)
#: Round numbers, from which the tests work theirs.
DRIVER = Driver(
    desired_mps=10.0, tau_s=1.0, accel_mps2=1.6, decel_mps2=2.0, min_gap_m=2.0, turn_lateral_mps2=2.0, offset_m=0.0,
    lane_change_s=5.0,
)  # fmt: skip


def nobody(steps: int = 110) -> Traffic:
    """Traffic without anybody in it."""
    return Traffic.none(steps)


def recorded(
    x: float, y: float, speed: float = 0.0, *, heading: float = 0.0, first: int = 0, kind: str = "vehicle",
    name: str = "r", size: BoxSize = CAR,
) -> Track:  # fmt: skip
    """A recorded agent at (x, y) at step 0, straight ahead at constant speed, with states from step `first` on."""
    steps = np.arange(first, 110)
    ahead = np.array([np.cos(heading), np.sin(heading)])
    position = np.array([x, y]) + 0.1 * speed * steps[:, None] * ahead
    velocity = np.broadcast_to(speed * ahead, position.shape).copy()
    return Track(name, kind, 2, steps, position, np.full(steps.size, heading), velocity, size)


def scene_on(graph: LaneGraph, *tracks: Track, config: Config | None = None) -> Scene:
    """A scene of 110 steps on a road."""
    return build_scene(
        build_cell_grid(graph), tracks, config=config or Config(), num_steps=110, last_observed_step=49, step_s=0.1
    )


def guard_of(here: Surroundings) -> Guard:
    """With no vehicle inserted."""
    return Guard(here.scene, nobody(here.scene.future.num_steps), here.stop_lines)


def sites_of(scene: Scene, seed: int = 0, *wants: Situation) -> InsertionSites:
    """Sites of a scene without inserted vehicles; wants: what all vehicles are to meet."""
    here, wanted = Surroundings(scene), Wanted(dict.fromkeys(wants, 1.0), dict.fromkeys(wants, 0.0))
    return InsertionSites(here, guard_of(here), np.random.default_rng(seed), 0, wanted)


def start_on(scene: Scene, route: Route, s: float, speed: float, **changes: Any) -> Start:
    """A start at arc length s of a route's path; number, policy and trigger_s make its request."""
    number = changes.pop("number", 0)
    policy, trigger_s = changes.pop("policy", Policy.STRAIGHT), changes.pop("trigger_s", 0.0)
    request = VehicleRequest(number, policy, trigger_s, size=changes.pop("size", CAR))
    driver = changes.get("driver", DRIVER)
    return Start(**{
        "vehicle_id": f"v{number}_0", "request": request, "box": CAR,
        "route": route, "path": scene.paths.along(route), "start_m": s, "start_mps": speed, "driver": driver,
        "desired": np.full(scene.num_steps, driver.desired_mps), "offset": MIDDLE, "sides": ("left", "right"),
        **changes,
    })  # fmt: skip


def driven(start: Start, v: npt.ArrayLike, **changes: Any) -> DrivenVehicle:
    """A vehicle with the speeds v (T,) m/s, as SUMO moves it: by the new speed of every step."""
    speed = np.asarray(v, dtype=np.float64)
    s = start.start_m + np.concatenate([[0.0], np.cumsum(0.1 * speed[1:])])
    where = {"s": s.tolist(), "v": speed.tolist(), "jumped_m": [0.0] * s.size}
    return DrivenVehicle(**{"start": start, "path": start.path, **where, **changes})


def changing(scene: Scene, start: Start, v: npt.ArrayLike, *, to: int, at_step: int, wanted_s: float) -> DrivenVehicle:
    """The same, changing to a lane beside from a step on, as SUMO carried it out."""
    vehicle = driven(start, v)
    s = vehicle.s[at_step]
    target = target_path(scene, start.path, to, s=s)
    side: Side = "left" if target.line.position(np.array([s]))[0, 1] > 0.0 else "right"
    own, driver = Foreseen(start.path, s, at_step, np.array([vehicle.v[at_step]])), start.driver
    path = lay_across(scene, own, target, side=side, remaining_m=200.0, driver=replace(driver, lane_change_s=wanted_s))
    assert isinstance(path, DrivenPath), path
    vehicle.path, vehicle.stage = path, Stage.DONE
    vehicle.shifts.append(Shift(side, start.route[0], to, at_step, target))
    return vehicle


#: Length of the roads of `road_scene`, m.
ROAD_M = 300.0


def request_of(number: int = 0, policy: Policy = Policy.STRAIGHT, trigger_s: float = 0.0) -> VehicleRequest:
    return VehicleRequest(number, policy, trigger_s, size=CAR)


def road_scene(
    *tracks: Track, sites: str = "promising", lanes: int = 2, length_m: float = ROAD_M, **spawn: Any
) -> Scene:
    """Two lanes of 300 m."""
    config = Config(request=Request(sites=sites), spawn=Spawn(prior_speed_mps=9.0, **spawn))
    return scene_on(draw_road(lanes=lanes, length_m=length_m), *tracks, config=config)


def left_turn_scene(at_m: float, on_m: float = 185.0) -> Scene:
    """One lane that turns to the left at so many metres and goes on for on_m, and no recorded vehicle."""
    bend = [(at_m + 15.0 * np.sin(a), 15.0 - 15.0 * np.cos(a)) for a in np.linspace(0.0, np.pi / 2, 12)]
    lanes = [
        draw_lane(1, [(0.0, 0.0), (at_m, 0.0)], successors=(2,)),
        draw_lane(2, bend, successors=(3,), is_intersection=True),
    ]
    return scene_on(graph_of(*lanes, *[draw_lane(3, [bend[-1], (at_m + 15.0, 15.0 + on_m)])] * (on_m > 0.0)))
