"""Lane change: feasibility on the grid and in metres (paper, Lane Change)."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

from hid2.params import LaneChange
from hid2.reasons import Reason
from netconvert.cells import Cell
from netconvert.lane_graph import Side


@dataclass(frozen=True, slots=True)
class Gap:
    """A neighbour on a lane path: bumper gap in m, its speed in m/s, its id."""

    distance_m: float
    speed_mps: float
    track_id: str | None = field(default=None, compare=False)

    def time_gap_s(self, follower_mps: float) -> float:
        """Of a follower that stands (0.1 m/s or less), or of none: inf."""
        return self.distance_m / follower_mps if follower_mps > 0.1 else math.inf


#: Gap to no neighbour: any lane change fits in.
OPEN = Gap(math.inf, 0.0)


@dataclass(frozen=True, slots=True)
class SumoAnswer:
    """What SUMO's LC2013 makes of one side: its motives (none: it does not want to), and agents in the way."""

    motives: frozenset[str]
    blocked_ahead: bool
    blocked_behind: bool


@dataclass(frozen=True, slots=True)
class LaneOption:
    """An adjacent lane l' that the marking lets the agent change to, as it sees it at one step.

    target: cell g_{l',j}; cells_free: sigma = 0 in j-1, j, j+1; gaps to the vehicles ahead and behind there, Frenet m;
    remaining_m: length of l' left through its successors; corridor_m: its free stretch m * delta s.
    """

    side: Side
    target: Cell
    cells_free: bool
    front: Gap
    rear: Gap
    remaining_m: float
    corridor_m: float
    sumo: SumoAnswer | None = None


def safe_gap_m(follower_mps: float, leader_mps: float, *, time_gap_s: float, params: LaneChange) -> float:
    """Smallest bumper gap behind a leader: time gap plus what braking away the speed difference takes."""
    closing = max(0.0, follower_mps - leader_mps)
    return max(params.min_gap_m, time_gap_s * follower_mps) + closing * closing / (2 * params.braking_mps2)


def gap_refusals(*, speed_mps: float, cells_free: bool, front: Gap, rear: Gap, params: LaneChange) -> Iterator[Reason]:
    """Conditions of the paper that a gap on l' (Frenet metres, cells j-1, j, j+1) does not meet; none if feasible."""
    if not cells_free:
        yield Reason.CELLS_OCCUPIED
    if front.distance_m < safe_gap_m(speed_mps, front.speed_mps, time_gap_s=params.time_gap_front_s, params=params):
        yield Reason.FRONT_GAP
    if rear.distance_m < safe_gap_m(rear.speed_mps, speed_mps, time_gap_s=params.time_gap_rear_s, params=params):
        yield Reason.REAR_GAP
