"""Stop lines: entrances that are red, and pedestrian crossings that are used."""

from dataclasses import replace

import numpy as np
import pytest
from hand_drawn import draw_crossing
from inserted import CAR, DRIVER, recorded, scene_on

from hid2.agents import BoxSize, Track
from hid2.conflicts.stop_lines import ClosedLines, StopLines
from hid2.kernels.guard import ROLLS_UP_SHARE, stop_ahead
from hid2.kernels.steering import CAUSES
from hid2.params import Config, Signals

#: Every value that a number below is worked from; the defaults may be tuned.
CONFIG = Config(signals=Signals(before_s=2.0, after_s=3.0))
UP = np.pi / 2
#: The line of the entrance at 60 m: half a car and the margin before it, 60 - 2.25 - 1.
STOP_M = 56.75


def lines_of(*recorded: Track, box: BoxSize = CAR) -> ClosedLines:
    """Of the path along lanes 1 (0 .. 60 m), 2 (the intersection, 60 .. 80 m) and 3 on the x axis.

    Lanes 4, 5 and 6 cross it at x = 70, and a pedestrian crossing lies over lane 3 from x = 100 to 103 m.
    """
    scene = scene_on(draw_crossing(zebra=True), *recorded, config=CONFIG)
    return StopLines(scene).on(scene.paths.along((1, 2, 3)), box)


def brake(*recorded: Track, s: float, v: float, step: int) -> tuple[float, str] | None:
    """Acceleration, m/s2, that stops a driver at the next closed line, and its cause; None for none."""
    lines = lines_of(*recorded)
    row, accel = stop_ahead(lines.stops_m(DRIVER), lines.closed, s, v, step, DRIVER.accel_mps2, DRIVER.decel_mps2)
    return None if row < 0 else (float(accel), CAUSES[lines.cause[row]])


#: Crosses lane 2 at 10 m/s, its centre at y = 0 after 5 s: on lane 2's ground from about 4.6 to 5.4 s.
CROSSING = recorded(70.0, -50.0, 10.0, heading=UP)


def _closed(lines: ClosedLines, cause: str) -> tuple[float, int, int]:
    (row,) = np.flatnonzero(lines.cause == CAUSES.index(cause))
    steps = np.flatnonzero(lines.closed[row])
    return float(lines.stops_m(DRIVER)[row]), int(steps[0]), int(steps[-1])


def test_entrance_is_closed_while_recorded_traffic_flows_across() -> None:
    """From 2 s and amber before the crossing to 3 s after it; nothing is closed where nobody crosses.

    A bus of 12 m stands farther back: 60 - 6 - 1 = 53 m.
    """
    stop_m, first, last = _closed(lines_of(CROSSING), "signal")
    assert stop_m == pytest.approx(STOP_M)
    assert (first, last) == (pytest.approx(11, abs=3), pytest.approx(84, abs=3))
    assert lines_of().line_m.size == 0
    assert lines_of(CROSSING, box=BoxSize(12.0, 2.9)).stops_m(DRIVER).tolist() == pytest.approx([53.0])


def test_driver_brakes_as_the_red_line_asks_for() -> None:
    """From 32.25 m before it at 10 m/s 10^2 / (2 * 32.25) = 1.55 m/s2 would do, less than .85 times the comfortable 2.

    As that is more than usual, 1.3 times as much; 40 m before it at 9 m/s, where 1.01 m/s2 would do, .87 times as much.
    """
    found = brake(CROSSING, s=24.5, v=10.0, step=40)
    assert found == (pytest.approx(-1.3 * 1.5504, abs=1e-3), "signal")
    early = brake(CROSSING, s=16.75, v=9.0, step=40)
    assert early == (pytest.approx(-0.8725 * 1.0125, abs=1e-3), "signal")


@pytest.mark.parametrize("speed_mps", [6.0, 9.0])
def test_braking_for_a_line_builds_up_and_eases(speed_mps: float) -> None:
    """From 60 m before it: gentle at first, hardest in between, gentle as it comes to stand, at the line."""
    line_m, closed, s, v = np.array([60.0]), np.ones((1, 1), dtype=np.bool_), 0.0, speed_mps
    braked = []
    while v > 0.5:
        _, accel = stop_ahead(line_m, closed, s, v, 0, DRIVER.accel_mps2, DRIVER.decel_mps2)
        s, v = s + 0.1 * v, v + 0.1 * min(accel, 0.0)
        braked.append(-accel)
    harder = np.array(braked)[np.array(braked) > 0.1]
    assert s == pytest.approx(60.0, abs=0.5)
    assert 0.2 * harder.size < harder.argmax() < 0.95 * harder.size
    assert max(harder[0], harder[-1]) < 0.95 * harder.max() < 0.95 * 1.3 * ROLLS_UP_SHARE * DRIVER.decel_mps2


def test_driver_brakes_neither_far_before_nor_behind_nor_when_it_is_too_late_and_stands_at_the_line() -> None:
    """50 m before it at 5 m/s comfortable braking (1.2 m/s2) would do from 11 m/s: no braking yet.

    10 m before it at 10 m/s: 5 m/s2, more than .85 * 2: as at an amber light. At the line it stays until it opens.
    """
    found = brake(CROSSING, s=6.75, v=5.0, step=40)
    assert found is None or found[0] > 0.0
    assert brake(CROSSING, s=46.75, v=10.0, step=40) is None
    assert brake(CROSSING, s=58.0, v=3.0, step=40) is None
    found = brake(CROSSING, s=STOP_M, v=0.0, step=60)
    assert found is not None
    assert found[0] < 0.0
    assert brake(CROSSING, s=STOP_M, v=0.0, step=100) is None


def test_pedestrian_on_a_crossing_is_yielded_to() -> None:
    """A walker at 1.3 m/s goes over the crossing at x = 101.5 from y = -6 on; the line is 100 - 2.25 - 1 = 96.75 m.

    20 m before it at 8 m/s 8^2 / 40 = 1.6 m/s2 would do: 1.3 times that. Once the walker is across, none waits.
    """
    walker = recorded(101.5, -6.0, 1.3, heading=UP, kind="pedestrian", size=BoxSize(0.6, 0.6))
    stop_m, first, last = _closed(lines_of(walker), "crossing")
    assert stop_m == pytest.approx(96.75, abs=0.5)
    assert first < 40
    assert last < 75
    found = brake(walker, s=76.75, v=8.0, step=40)
    assert found == (pytest.approx(-1.3 * 1.6, abs=0.07), "crossing")
    assert brake(walker, s=76.75, v=8.0, step=100) is None


def test_drivers_stand_where_they_like_but_short_of_pedestrians() -> None:
    """One that stands 1.2 m past the line, front at 61.2 m, has 2.2 m more room; at a crossing it keeps .5 m."""
    bold = replace(DRIVER, line_gap_m=-1.2)
    walker = recorded(101.5, -6.0, 1.3, heading=UP, kind="pedestrian", size=BoxSize(0.6, 0.6))
    lines = lines_of(CROSSING, walker)
    usual, its = lines.stops_m(DRIVER), lines.stops_m(bold)
    assert (its - usual).tolist() == pytest.approx([2.2, 0.5])
    assert its[0] + CAR.length_m / 2 == pytest.approx(61.2)
    past = np.linspace(its[0] - 5.0, its[0] + 0.9, 60)
    assert not lines.is_passed(past, bold, first=0, closed_steps=0)
    assert lines.is_passed(past, DRIVER, first=0, closed_steps=0)


def test_room_before_a_closed_line_and_none_on_what_it_is_before() -> None:
    """Red at step 40: 20 m before the line there are 20 m; past it, up to 80 m on lane 2, a vehicle came on red.

    Towards it a driver brakes with .6 of its deceleration: v = sqrt(2 x .6 x b x 20 m).
    """
    lines = lines_of(CROSSING)
    assert lines.room_m(36.75, 40, DRIVER) == pytest.approx(20.0)
    assert [lines.room_m(s, 40, DRIVER) for s in (58.0, 79.0)] == [-1.0, -1.0]
    assert [lines.room_m(s, step, DRIVER) for s, step in ((81.0, 40), (58.0, 0), (36.75, 0))] == [np.inf] * 3
    assert lines.towards_mps(DRIVER, 20.0) == pytest.approx(np.sqrt(2.0 * ROLLS_UP_SHARE * DRIVER.decel_mps2 * 20.0))
    assert lines.towards_mps(DRIVER, np.inf) == np.inf
