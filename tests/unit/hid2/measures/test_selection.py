"""How vehicles drive, by their speeds."""

import numpy as np
import pytest

from hid2.measures.selection import Drives, drives


def test_vehicles_that_brake_hard_and_that_stand_are_counted() -> None:
    """Steps of 0.1 s. The first brakes with 4 m/s2 for 1 s, the second with 2 m/s2 for 5 s and stands then for 1 s, the
    third loses 1 m/s in one step, as a tracker has it, and the fourth has one state.
    """
    hard = np.concatenate([np.full(20, 10.0), 10.0 - 0.4 * np.arange(1, 11), np.full(20, 6.0)])
    soft = np.concatenate([10.0 - 0.2 * np.arange(51), np.zeros(10)])
    noisy = np.concatenate([np.full(20, 10.0), np.full(20, 9.0)])
    found = drives([hard, soft, noisy, np.array([5.0])], step_s=0.1, limited=7)
    assert found == Drives(vehicles=4, braking=1, standing=1, steps=49 + 60 + 39, limited=7)


@pytest.mark.parametrize(("decel", "expected"), [(2.9, 0), (3.1, 1)])
def test_hard_braking_is_harder_than_three(decel: float, expected: int) -> None:
    """Half a second of it, at steps of 0.1 s and of 0.25 s; at the end of a track it is a tracker's."""
    for step_s, half in ((0.1, 5), (0.25, 2)):
        speed = 12.0 - decel * step_s * np.clip(np.arange(3 * half + 1) - half, 0, half)
        found = [drives([speed[:end]], step_s=step_s).braking for end in (None, 2 * half + 1)]
        assert found == [expected, 0]


def test_no_vehicle_drives_at_all() -> None:
    assert drives([], step_s=0.1) == Drives(vehicles=0, braking=0, standing=0, steps=0, limited=0)
