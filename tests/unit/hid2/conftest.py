"""Lines for the tests of the method: everything in metres, along +x."""

import numpy as np
import pytest
from hand_drawn import draw_road

from hid2.motion.reference_line import ReferenceLine, build_reference_line
from hid2.motion.route import DrivenPath, LanePaths
from hid2.params import Limits


@pytest.fixture(scope="session")
def straight_line() -> ReferenceLine:
    """The x axis from 0 to 200 m."""
    return build_reference_line(np.array([[0.0, 0.0], [200.0, 0.0]]), step_m=1.0, min_radius_m=5.0, max_offset_m=0.6)


@pytest.fixture(scope="session")
def straight_path() -> DrivenPath:
    """The middle of the right lane of a two-lane road of 200 m."""
    return LanePaths(draw_road(), Limits()).along((1,))
