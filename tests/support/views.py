"""What others are to a vehicle that drives along a line, for the tests of the space-time view and of plans in it."""

from hid2.conflicts.space_time import Follower, SpaceTime, space_time
from hid2.motion.reference_line import ReferenceLine
from hid2.occupancy.along_path import PathOccupancy, path_occupancy
from hid2.occupancy.traffic import Traffic

#: Box of the vehicle itself, and of others where they are given it too, m.
SIZE = {"length_m": 4.0, "width_m": 2.0}
MARGIN_M, TTC_S = 1.0, 1.7


def occupancy_of(line: ReferenceLine, traffic: Traffic, *, margin_m: float = 0.0) -> PathOccupancy:
    """Intervals of others for a box of SIZE."""
    return path_occupancy(line, traffic, **SIZE, margin_lateral_m=margin_m)


def tables_of(line: ReferenceLine, *others: Traffic, exit_s: float = 1e3, earliest: int = 0) -> SpaceTime:
    """The view of 110 steps, with a gap of MARGIN_M, a TTC of TTC_S and a time gap of 1 s."""
    occupancy = occupancy_of(line, others[0])
    for traffic in others[1:]:
        occupancy = occupancy.joined(occupancy_of(line, traffic))
    return space_time(
        occupancy, table_length=line.table_xy.shape[0], num_steps=110, margin_m=MARGIN_M, ttc_s=TTC_S, time_gap_s=1.0,
        follower=Follower(2.5, 2.5, 1.5), exit_s=min(exit_s, line.length_m), earliest_exit_step=earliest,
    )  # fmt: skip
