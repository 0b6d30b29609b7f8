"""What a rule of lane changes is shown."""

from hid2.policy.lane_change import OPEN
from hid2.policy.rules import GapView

#: 10 m/s of 10 wished for; IDM with a = 1, b = 1, T = 1 s, s0 = 2 m.
VIEW = GapView(
    time_s=3.0, waited_s=1.0, side="left", speed_mps=10.0, desired_mps=10.0, length_m=4.0, tau_s=1.0, accel_mps2=1.0,
    decel_mps2=1.0, min_gap_m=2.0, cells_free=True, front=OPEN, rear=OPEN, own_front=OPEN, own_rear=OPEN,
    remaining_m=200.0,
)  # fmt: skip
