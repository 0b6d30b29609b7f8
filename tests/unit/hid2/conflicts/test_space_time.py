from collections.abc import Callable

import pytest
from views import SIZE, tables_of

from hid2.motion.reference_line import TABLE_STEP_M, ReferenceLine
from hid2.occupancy.traffic import Traffic


def test_speed_towards_a_leader_keeps_the_critical_ttc(
    straight_line: ReferenceLine, box: Callable[..., Traffic]
) -> None:
    """Leader at 60 m, 5 m/s: its interval begins near 56, less the margin 55. From 38 m: 5 + 17 / 1.7 = 15 m/s."""
    tables = tables_of(straight_line, box(60.0, 0.0, 0.0, 5.0, **SIZE))
    assert tables.fastest[0, int(38 / TABLE_STEP_M)] == pytest.approx(15.0, abs=0.4)
    assert tables.blocked[0, int(60 / TABLE_STEP_M)] == 1
    assert tables.blocked[0, int(50 / TABLE_STEP_M)] == 0


def test_exit_is_closed_until_the_earliest_step(straight_line: ReferenceLine, box: Callable[..., Traffic]) -> None:
    tables = tables_of(straight_line, box(0.0, 50.0), exit_s=150.0, earliest=51)
    assert tables.blocked[50, int(151 / TABLE_STEP_M)] == 1
    assert tables.blocked[51, int(151 / TABLE_STEP_M)] == 0


def test_speed_that_car_following_keeps_behind_a_leader(
    straight_line: ReferenceLine, box: Callable[..., Traffic]
) -> None:
    """Krauss: -b tau + sqrt((b tau)^2 + v_l^2 + 2 b (gap - gap_min)), with b 2.5, tau 1 and gap_min 1.5.

    A leader of 4.5 m at 60 m, 5 m/s; the own box is as long and begins to touch at 55.5 m. From 40 m the gap is
    15.5 m: -2.5 + sqrt(6.25 + 25 + 5 * 14) = 7.56 m/s. Behind the leader, and across, nothing holds one back.
    """
    tables = tables_of(straight_line, box(60.0, 0.0, 0.0, 5.0, length_m=4.5, width_m=1.9))
    assert tables.followed[0, int(40 / TABLE_STEP_M)] == pytest.approx(7.56, abs=0.25)
    assert tables.followed[0, int(80 / TABLE_STEP_M)] > 50.0
    across = tables_of(straight_line, box(60.0, 0.0, 1.57, 5.0, length_m=4.5, width_m=1.9))
    assert across.followed[0, int(40 / TABLE_STEP_M)] > 50.0
