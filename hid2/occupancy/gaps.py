"""The gap function: which agents are next ahead and behind on a path at a step, how far, and how fast.

      [ follower ]<-- lag -->[  own  ]<-- lead -->[ leader ]        bumper to bumper, along the path

Of places on a path, to the next ones (`gaps_on_path`) or to all (`gaps_to_all`); where there is no path, as before the
map's edge, of a pose (`gaps_from_pose`).
"""

from typing import NamedTuple

import numpy as np

from hid2.agents import BoxSize, FloatArray, IntArray
from hid2.kernels.gaps import all_on_path, next_on_path
from hid2.occupancy.along_path import PathOccupancy
from hid2.occupancy.traffic import BoolArray, Traffic


class Gaps(NamedTuple):
    """Leaders and followers of places (N,) on a path.

    leader, follower (N,): rows of the intervals, -1 for none; lead_m, lag_m (N,) m: bumper to bumper, negative side by
    side, inf for none; lead_mps, lag_mps (N,) m/s: their speeds along the path, 0 for one that comes back or none.
    """

    leader: IntArray
    lead_m: FloatArray
    lead_mps: FloatArray
    follower: IntArray
    lag_m: FloatArray
    lag_mps: FloatArray


def gaps_on_path(seen: PathOccupancy, s: FloatArray, steps: IntArray | int, *, among: BoolArray | None = None) -> Gaps:
    """Leaders and followers at places (N,) m on a path, all at one step or each at its own (N,).

    An agent is ahead where the middle of its interval is, and behind otherwise. among (R, T): which agents
    count at which steps; all that touch the path unless told, as `seen.same_direction` those that move along it.
    """
    counts = np.ones(seen.low.shape, dtype=np.bool_) if among is None else among
    return Gaps(*next_on_path(*_where(seen), np.ascontiguousarray(counts), *_places(s, steps)))


class AllGaps(NamedTuple):
    """Every agent on a path as seen from places (N,) on it.

    lead_m, lag_m (R, N) m: bumper to bumper to those ahead and to those behind, negative side by side, inf for others;
    along_mps (R, N) m/s: speeds along the path, 0 for one that comes back.
    """

    lead_m: FloatArray
    lag_m: FloatArray
    along_mps: FloatArray


def gaps_to_all(seen: PathOccupancy, s: FloatArray, steps: IntArray | int) -> AllGaps:
    """Gaps of places (N,) m on a path to all agents on it, as in `gaps_on_path`."""
    return AllGaps(*all_on_path(*_where(seen), *_places(s, steps)))


def _where(seen: PathOccupancy) -> tuple[FloatArray, FloatArray, FloatArray]:
    return np.ascontiguousarray(seen.low), np.ascontiguousarray(seen.high), np.ascontiguousarray(seen.along)


def _places(s: FloatArray, steps: IntArray | int) -> tuple[FloatArray, IntArray]:
    return np.ascontiguousarray(s), np.full(s.size, steps) if isinstance(steps, int) else steps


class PoseGaps(NamedTuple):
    """Agents (A,), or (A, T) over steps, as seen from a pose with a path that is taken as straight.

    along_m: their centres ahead of its own, negative behind; gap_m: bumper to bumper; aside_m: between the sides,
    negative where they overlap across; along_mps: their speeds in its direction.
    """

    along_m: FloatArray
    gap_m: FloatArray
    aside_m: FloatArray
    along_mps: FloatArray


def gaps_from_poses(
    xy: FloatArray, forward: FloatArray, box: tuple[FloatArray | float, FloatArray | float], others: Traffic
) -> PoseGaps:
    """Gaps from a box at xy (T, 2) m along unit vectors forward (T, 2), or (A, T, 2), to agents (A, T).

    Or from boxes (A, 1) at xy (A, T, 2), to one agent (1, T).
    """
    offset, (length_m, width_m) = others.position - xy, box
    along, mps = (one[..., 0] * forward[..., 0] + one[..., 1] * forward[..., 1] for one in (offset, others.velocity))
    aside = np.abs(offset[..., 1] * forward[..., 0] - offset[..., 0] * forward[..., 1])
    return PoseGaps(
        along,
        np.abs(along) - 0.5 * (others.length_m[:, None] + length_m),
        aside - 0.5 * (others.width_m[:, None] + width_m),
        mps,
    )


def gaps_from_pose(xy: FloatArray, forward: FloatArray, box: BoxSize, here: Traffic) -> PoseGaps:
    """The same to the agents of one step, (A,), from xy, forward (2,), or from elsewhere for each of them (A, 2)."""
    return PoseGaps(*(one[:, 0] for one in gaps_from_poses(xy[..., None, :], forward[..., None, :], box, here)))
