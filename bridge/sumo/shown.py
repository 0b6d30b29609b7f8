"""Agents that SUMO is shown: those ahead of vehicles in time and place, and no others."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bridge.sumo.fleet import Fleet
from hid2.kernels.gaps import SHOWN_M, shown_ahead
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.occupancy.along_path import PathOccupancy
from hid2.occupancy.shown import UNSEEN_STEPS
from hid2.occupancy.traffic import BoolArray, Traffic
from hid2.policy.behaviours import BEHAVIOURS
from hid2.vehicle import Start

#: Distance from the way of a vehicle that may change lanes beyond which agents need not be shown, m. Not a parameter,
#: it saves time: lanes beside are nearer, and SUMO brakes for no agent farther aside.
_NEAR_M = 12.0
#: Largest ratio of a vehicle's speed to its desired speed: no tunable, a bound that spares time.
_PACE_MOST = 1.1


def shown_at(fleet: Fleet, step: int) -> dict[int, tuple[str, int]]:
    """Agents that SUMO's car following is shown: row (recorded, then kept) -> edge and lane index of its place there.

    Those that reach into the driving width on the present path of some vehicle and move along it or stand.
    Crossing agents are the guard's business: to SUMO they would appear out of nowhere.
    """
    seen: dict[int, tuple[str, int]] = {}
    scene = fleet.scene
    if "collision" in scene.config.without:
        return seen
    (known, first), length_m = fleet.all_in_width, np.concatenate([scene.traffic.length_m, fleet.kept.length_m])
    found = shown_ahead(
        known.low, known.high, known.along, known.same_direction, known.crossing, known.agents, first,
        length_m, scene.traffic.position, fleet.kept.position, step, fleet.along_m, fleet.centre, fleet.length_m,
    )  # fmt: skip
    for agent, row, middle in zip(*(column.tolist() for column in found), strict=True):
        cell = scene.cell_at(fleet.vehicles[row].path, middle)
        seen[agent] = scene.grid.edge_id(cell), scene.grid.lane_index(cell)
    return seen


def ever_shown(fleet: Fleet) -> Traffic:
    """Recorded agents and those kept, present only while SUMO may have to be shown them to a fleet before its start."""
    traffic, count = fleet.recorded_and_kept, fleet.scene.num_recorded
    starts = [vehicle.start for vehicle in fleet.vehicles]
    in_widths = [fleet.in_width(row) for row in range(len(starts))]
    present = shown_when(traffic, starts, in_widths, step_s=fleet.scene.step_s)
    if any(BEHAVIOURS[start.request.policy].changes_lanes for start in starts):
        present[count:] = traffic.present[count:]  # kept ones are few, any may come to lead
    return replace(traffic, present=present)


def shown_when(
    traffic: Traffic, starts: Sequence[Start], known: Sequence[PathOccupancy], *, step_s: float
) -> BoolArray:
    """(A, T) when agents have to be in SUMO, each for one stretch, so that a vehicle that starts is shown its leaders.

    known: of each start intervals of those in its driving width, on its path. A vehicle with lane changes may leave
    that path: shown are those near to it, on its lanes or those beside.
    """
    num_steps = traffic.num_steps
    needed = np.zeros((len(traffic.ids), num_steps), dtype=np.bool_)
    for start, found in zip(starts, known, strict=True):
        if BEHAVIOURS[start.request.policy].changes_lanes:
            ahead = max(0, int((start.start_m - _NEAR_M) / TABLE_STEP_M))
            needed |= start.path.line.near(_NEAR_M)[0].last_near(traffic.position) >= ahead
            continue
        fastest_mps = _PACE_MOST * max(float(start.desired.max()), start.start_mps)
        lasting_s = step_s * (np.arange(num_steps) - start.step)
        reach_m = start.start_m + start.box.length_m + SHOWN_M + fastest_mps * lasting_s
        low, high = found.low[:, :num_steps], found.high[:, :num_steps]
        needed[found.agents] |= np.isfinite(low) & (high > start.start_m) & (low < reach_m) & (lasting_s >= 0.0)
    needed &= traffic.present
    steps, first = np.arange(num_steps), needed.argmax(axis=1) - UNSEEN_STEPS - 1
    last = num_steps - needed[:, ::-1].argmax(axis=1)
    ever = np.asarray(needed.any(axis=1)).reshape(-1, 1)
    return np.asarray(ever & (steps >= first[:, None]) & (steps <= last[:, None]) & traffic.present)
