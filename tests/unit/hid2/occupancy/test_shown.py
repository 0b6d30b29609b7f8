"""What SUMO has of agents on a path: where, how fast, and which of them as leaders."""

import numpy as np
import pytest
from hand_drawn import draw_box
from views import occupancy_of

from hid2.motion.route import DrivenPath
from hid2.occupancy.shown import Shown, shown_on
from hid2.occupancy.traffic import Traffic


def _shown(path: DrivenPath, traffic: Traffic) -> Shown:
    return shown_on(path, traffic, occupancy_of(path.line, traffic), step_s=0.1)


def test_agent_is_shown_in_the_middle_of_its_interval_from_the_third_step_after_its_first_on(
    straight_path: DrivenPath,
) -> None:
    """At 6 m/s from x = 50: at step 20 at 62. With states from step 10 on SUMO knows its speed at step 13."""
    shown = _shown(straight_path, draw_box(50.0, 0.0, 0.0, 6.0, first=10))
    assert shown.middle[0, 20] == pytest.approx(62.0, abs=0.26)
    assert shown.speed[0, 20] == pytest.approx(6.0)
    assert np.flatnonzero(shown.leads[0])[0] == 13
    assert _shown(straight_path, draw_box(50.0, 0.0, 0.0, 6.0)).leads.all()  # of step 0: they come in before it


@pytest.mark.parametrize(("x", "leads"), [(197.0, True), (198.0, False)])
def test_one_whose_front_is_beyond_the_end_of_the_lane_leads_nothing(
    straight_path: DrivenPath, x: float, leads: bool
) -> None:
    """A lane of 200 m, a box of 4.5 m: its front is 2.25 m ahead of its middle, at 199.25 or 200.25 m."""
    assert _shown(straight_path, draw_box(x, 0.0, steps=5)).leads.all() == leads


@pytest.mark.parametrize(("degrees", "leads"), [(25.0, False), (-25.0, True)])
def test_one_leads_where_its_front_is_on_the_path(straight_path: DrivenPath, degrees: float, leads: bool) -> None:
    """A bus of 12 m at y = 1, turned by 25 degrees: its front is 6 sin(25) = 2.54 m to a side, at y = 3.54 or -1.54."""
    bus = draw_box(100.0, 1.0, np.radians(degrees), 5.0, steps=2, length_m=12.0)
    assert _shown(straight_path, bus).leads[0, 0] == leads
