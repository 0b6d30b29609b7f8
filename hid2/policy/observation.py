"""What a vehicle observes at one step: adjacent lanes with the agents on them, its leader, and the path across."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hid2.agents import BoxSize, FloatArray
from hid2.conflicts.guard import transition_rejected
from hid2.drivers.driver import Driver
from hid2.kernels.polyline import frenet
from hid2.motion.lane_change_path import LateralTiming
from hid2.motion.route import DrivenPath, LateralMotion, is_drivable, shifted_path
from hid2.occupancy.along_path import look_along
from hid2.occupancy.gaps import gaps_from_pose, gaps_on_path
from hid2.occupancy.sigma import FREE, dwell_steps, is_agent_on
from hid2.occupancy.traffic import Traffic
from hid2.policy.lane_change import OPEN, Gap, LaneOption
from hid2.reasons import Reason
from hid2.scene import Scene
from netconvert.cells import Cell
from netconvert.lane_graph import Side, crossable

#: Share of the time left in the scene that a lateral motion may take, less _SPARE_S. No tunables: room for what a
#: driver does otherwise.
_TIME_SHARE = 0.95
_SPARE_S = 0.5
#: Share of the length of l' left that a lateral motion may take. No tunable: room for what a driver does otherwise.
_LENGTH_SHARE = 0.8
_HALF_LANE_M = 1.5  # largest distance of a centre on a lane path: half of the narrowest lane, the same for all


class Inserted(NamedTuple):
    """Inserted vehicles at a step. known: with known motion (T steps); driven: with this one, now (one step)."""

    step: int
    known: Traffic
    driven: Traffic


class Foreseen(NamedTuple):
    """A vehicle at arc length s m of a path at a step; speed_mps (M,): at steps to come, of which the last goes on."""

    path: DrivenPath
    s: float
    step: int
    speed_mps: FloatArray


def admissible_neighbor(scene: Scene, lane_id: int, side: Side) -> int | None:
    """Same-direction neighbour that a vehicle may change to: of a drivable type, and the marking allows it."""
    graph = scene.grid.graph
    if "topology" in scene.config.without:
        return None
    neighbor = graph.neighbor(lane_id, side)
    if neighbor is None or not is_drivable(graph, neighbor):
        return None
    return neighbor if graph.may_change(lane_id, side) else None


def lane_options(
    scene: Scene,
    path: DrivenPath,
    box: BoxSize,
    *,
    s: float,
    sides: Sequence[Side],
    inserted: Inserted,
    speed_mps: float,
    desired_mps: float,
) -> list[tuple[LaneOption, DrivenPath]]:
    """Adjacent lanes at arc length s of a path at one step, each with the path that continues on it.

    A transition into a cell that an original agent holds, now or when the vehicle (speed_mps) gets to the next one, is
    rejected (paper, conflict case 1). The corridor m * delta s ends with l' or at the first vehicle there that is
    slower than desired_mps: faster ones leave it.
    """
    graph, segment = scene.grid.graph, path.segment_at(s)
    xy = path.line.position(np.array([s]))
    found = []
    for side in sides:
        lane_id = admissible_neighbor(scene, segment.lane_id, side)
        if lane_id is None:
            continue
        lane = graph.lanes[lane_id].path
        lane_m = float(frenet(xy, lane.points, lane.s)[0][0])
        lane_m = min(max(lane_m, 0.0), graph.lanes[lane_id].length_m)
        target = target_path(scene, path, lane_id, s=s)
        at = next(one for one in target.segments if one.lane_id == lane_id).s_at(lane_m)
        cell = scene.grid.cell_at(lane_id, lane_m)
        remaining = target.exit_m - at
        before, following = _cells_along(scene, target, cell)
        free = _cells_free(scene, (before, cell, following), inserted) and not transition_rejected(
            _next_sigma(scene, cell, following, step=inserted.step, speed_mps=speed_mps)
        )
        front, rear = gaps_on(scene, target, box, at=at, inserted=inserted)
        slower = front
        if front.speed_mps >= desired_mps:
            slower, _ = gaps_on(scene, target, box, at=at, inserted=inserted, below_mps=desired_mps)
        option = LaneOption(side, cell, free, front, rear, remaining, min(remaining, slower.distance_m))
        found.append((option, target))
    return found


def target_path(scene: Scene, path: DrivenPath, lane_id: int, *, s: float) -> DrivenPath:
    """Path of l': lanes before it, for agents from behind, then on beside the own route where possible."""
    return scene.paths.beside(tuple(segment.lane_id for segment in path.segments if segment.end > s), lane_id)


def gaps_on(
    scene: Scene, target: DrivenPath, box: BoxSize, *, at: float, inserted: Inserted, below_mps: float = math.inf
) -> tuple[Gap, Gap]:
    """Bumper gaps ahead and behind at arc length `at` of a path, recorded and generated alike, Frenet metres.

    below_mps: only agents slower along the path count.
    """
    parts = (scene.future, inserted.step), (inserted.known, inserted.step), (inserted.driven, 0)
    every = [(traffic.ids, scene.met_on(target, box, traffic).at(step)) for traffic, step in parts]
    ids = [names[row] for names, seen in every for row in seen.agents]
    seen = every[0][1].joined(*(others for _, others in every[1:]))
    found = gaps_on_path(seen, np.array([at]), 0, among=seen.along < below_mps)
    front, rear = int(found.leader[0]), int(found.follower[0])
    return (
        Gap(float(found.lead_m[0]), float(found.lead_mps[0]), ids[front]) if front >= 0 else OPEN,
        Gap(float(found.lag_m[0]), float(found.lag_mps[0]), ids[rear]) if rear >= 0 else OPEN,
    )


def leader_on(path: DrivenPath, size: BoxSize, *, s: float, d_obs_m: float, here: Traffic) -> Gap | None:
    """Next vehicle on the lane path, of those that may be within d_obs; here: vehicles at this step (one step)."""
    own = path.line.position(np.array([s]))[0]
    near = here.present[:, 0] & (np.abs(here.position[:, 0] - own).max(axis=1) < d_obs_m + 15.0)
    here = here.rows(np.flatnonzero(near).tolist())
    seen = look_along(path.line, here, size.length_m, size.width_m)
    found = gaps_on_path(seen, np.array([s]), 0, among=seen.same_direction)
    if found.leader[0] < 0:
        return None
    return Gap(float(found.lead_m[0]), float(found.lead_mps[0]), here.ids[seen.agents[found.leader[0]]])


def is_on_lane(lane: DrivenPath, position: FloatArray) -> bool:
    """Whether a box centre (2,) m lies within half a lane of a lane path's middle."""
    offset = lane.line.table_xy - position
    return bool(np.hypot(offset[:, 0], offset[:, 1]).min() < _HALF_LANE_M)


def returns_to(lane: DrivenPath, path: DrivenPath) -> bool:
    """Whether the last lateral motion of a path ends on a lane path (the return of an overtake)."""
    return is_on_lane(lane, path.line.position(np.array([path.lateral_spans[-1].end]))[0])


def gap_to_passed(
    path: DrivenPath, size: BoxSize, *, s: float, lane: DrivenPath, passed_id: str, here: Traffic
) -> float:
    """Own rear bumper to the passed vehicle's front now, m, along the own heading; s m on the path.

    Negative while the boxes are side by side with its centre behind; inf: it has left the scene; -inf: it is not
    behind, or has turned off the lane path `lane`, that both were on.
    """
    row = here.ids.index(passed_id) if passed_id in here.ids else -1
    if row < 0 or not here.present[row, 0]:
        return math.inf
    if not is_on_lane(lane, here.position[row, 0]):
        return -math.inf
    xy, forward, _ = path.line.motion(np.array([s]))
    seen = gaps_from_pose(xy[0], forward[0], size, here.rows([row]))
    return float(seen.gap_m[0]) if seen.along_m[0] < 0.0 else -math.inf


def lay_across(
    scene: Scene, own: Foreseen, target: DrivenPath, *, side: Side, remaining_m: float, driver: Driver,
    ratio: float = 1.0,
) -> DrivenPath | Reason:  # fmt: skip
    """Path that shifts to `target`, on a side, from where a vehicle is, in the driver's time; or why there is none.

    ratio: of the usual durations. The motion is no longer than the lane and the scene have room for, and no shorter
    than the shortest duration.
    """
    change, step_s = scene.config.lane_change, scene.step_s
    speeds = np.maximum(own.speed_mps, change.min_speed_mps)
    driven = step_s * np.cumsum(speeds)
    beyond = max(0.0, _LENGTH_SHARE * remaining_m - float(driven[-1])) / float(speeds[-1])
    room_s = step_s * float(np.searchsorted(driven, _LENGTH_SHARE * remaining_m)) + beyond
    time_left_s = _TIME_SHARE * (scene.num_steps - 1 - own.step) * step_s - _SPARE_S
    motion, apart_m, along_m = None, 0.0, np.array([own.s])
    for _ in range(2):  # lanes may part: it is as far to the other one as it gets on the way
        _, aside_m = target.frenet(own.path.line.position(along_m))
        apart_m = max(apart_m, float(np.abs(aside_m).max()))
        timing = LateralTiming.of(ratio * driver.lane_change_s, apart_m, change)
        over_s = timing.lasting_s - min(time_left_s, room_s)
        if over_s > 0.0:
            shorter_s = max(driver.lane_change_s - over_s / ratio, change.min_duration_s)
            timing = LateralTiming.of(ratio * shorter_s, apart_m, change)
        motion = LateralMotion(own.path, target, timing, np.array([own.s]), np.zeros(1)).foreseen(speeds, step_s)
        along_m = motion.along_m
    assert motion is not None
    if motion.tau.size - 1 > scene.num_steps - 2 - own.step:
        return Reason.SCENE_ENDS
    if not _may_cross(scene, motion, side):
        return Reason.SOLID_LINE
    return shifted_path(motion, limits=scene.config.limits) or Reason.LANES_NOT_SIDE_BY_SIDE


def _may_cross(scene: Scene, motion: LateralMotion, side: Side) -> bool:
    """Whether no marking on a side forbids to leave the lanes along which a motion lies until it is half way across."""
    if "topology" in scene.config.without:
        return True
    path, lanes = motion.source, scene.grid.graph.lanes
    half_m = float(np.interp(0.5, motion.tau, motion.along_m))
    along = (one for one in path.segments if one.end > motion.along_m[0] and one.start < half_m)
    return all(crossable(lanes[one.lane_id].mark_type(side)) for one in along)


def _cells_along(scene: Scene, path: DrivenPath, cell: Cell) -> tuple[Cell | None, Cell | None]:
    """Cells j-1 and j+1 of a cell of a path, over the ends of its lane; None at those of the path."""
    grid, lanes = scene.grid, [segment.lane_id for segment in path.segments]
    at = lanes.index(cell.lane_id)
    ends = (Cell(one, grid.count(one) - 1) for one in reversed(lanes[:at]))
    before = Cell(cell.lane_id, cell.index - 1) if cell.index else next(ends, None)
    return before, grid.longitudinal(cell) or next((Cell(one, 0) for one in lanes[at + 1 :]), None)


def _next_sigma(scene: Scene, cell: Cell, following: Cell | None, *, step: int, speed_mps: float) -> int:
    """Sigma of the cell after a cell, when the vehicle gets there; free where it does not within the scene."""
    steps = dwell_steps(cell_m=scene.grid.length_m(cell), speed_mps=speed_mps, step_s=scene.step_s)
    if following is None or steps is None or step + steps >= scene.num_steps:
        return FREE
    return int(scene.occupancy.sigma[step + steps, scene.grid.index_of[following]])


def _cells_free(scene: Scene, cells: tuple[Cell | None, ...], inserted: Inserted) -> bool:
    """Cells j-1, j, j+1 of l' have sigma = 0 (paper, Lane Change); sigma = 2 where inserted ones are now."""
    step, wanted = inserted.step, np.array([scene.grid.index_of[cell] for cell in cells if cell is not None])
    if (scene.occupancy.sigma[step, wanted] != FREE).any():
        return False
    return not any(
        is_agent_on(scene.boxes, wanted, traffic, column)
        for traffic, column in ((inserted.known, step), (inserted.driven, 0))
        if traffic.ids
    )
