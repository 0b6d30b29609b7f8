"""How fast vehicles may drive where SUMO is blind: turns, predicted conflicts, stop lines, gaps to wait for."""

from typing import NamedTuple

from bridge.sumo.fleet import Fleet
from hid2.agents import FloatArray, IntArray
from hid2.conflicts.guard import STRIDE
from hid2.conflicts.stop_lines import STOPS
from hid2.kernels.steering import CAUSES, NO_LIMIT_MPS, speed_limits
from hid2.motion.reference_line import TABLE_STEP_M
from hid2.occupancy.traffic import BoolArray
from hid2.policy.overtake import Stage
from hid2.policy.roads import STRAIGHT
from hid2.reasons import Reason

#: A vehicle that waits for a gap slows down so for those beside, m/s2, to this share of its desired speed. No tunables:
#: what traffic behind does not notice.
_LET_PASS_MPS2, _LET_PASS_SHARE = 0.7, 0.8
_GAP = CAUSES.index("gap")
#: Refusals of a gap in which waiting for those beside to go ahead helps.
_LETS_PASS = frozenset({Reason.CELLS_OCCUPIED, Reason.FRONT_GAP})


class Limits(NamedTuple):
    """Of vehicles (M,) at a step, as the kernel `speed_limits` returns them."""

    mps: FloatArray
    cause: IntArray
    policy: IntArray
    waits_for: IntArray
    yields: BoolArray
    seeks: BoolArray


def limits_of(fleet: Fleet, rows: IntArray, now: int) -> Limits:
    """The lowest limit on the speed of the last of the vehicles that are `here` for the step after `now`.

    The road's, the guard's (case 3, timing), and those of stop lines.
    """
    guard = fleet.guard
    first, *along = fleet.along_ways(now)
    return Limits(*speed_limits(
        rows, now, fleet.state, fleet.desired_mps, fleet.drivers, fleet.yielding, STRAIGHT,
        guard.horizon, STRIDE, fleet.scene.step_s, TABLE_STEP_M, guard.brakes,
        guard.predicted, STOPS, guard.rules, first[-rows.size - 1 :], *along,
    ))  # fmt: skip


def let_pass(fleet: Fleet, row: int, now: int, limits: Limits, place: int) -> None:
    """Where a vehicle waits for a gap, the limit at which it slows down for those beside, if that is the lowest."""
    vehicle, step_s = fleet.vehicles[row], fleet.scene.step_s
    if vehicle.stage is Stage.WAITING and vehicle.reason in _LETS_PASS:
        desired, v = fleet.desired_mps[row, now], vehicle.v[-1]
        slower = max(_LET_PASS_SHARE * desired, v - _LET_PASS_MPS2 * step_s)
        if slower < desired - NO_LIMIT_MPS and (slower, _GAP) < (limits.mps[place], limits.cause[place]):
            limits.mps[place], limits.cause[place] = slower, _GAP
