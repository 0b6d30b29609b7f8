import numpy as np
import pytest

from hid2.agents import BoxSize, Track


def test_speed_and_path_of_a_track() -> None:
    """Velocity (3, 4) is 5 m/s; from (0, 0) by (3, 4) and (0, 6) the path is 5 + 6 = 11 m."""
    position, velocity = np.array([(0.0, 0.0), (3.0, 4.0), (3.0, 10.0)]), np.array([(3.0, 4.0), (0.0, 0.0), (0.0, 2.0)])
    track = Track("1", "vehicle", 1, np.arange(3), position, np.zeros(3), velocity, BoxSize(4.5, 1.9))
    assert track.speed.tolist() == [5.0, 0.0, 2.0]
    assert track.path_m == pytest.approx(11.0)
