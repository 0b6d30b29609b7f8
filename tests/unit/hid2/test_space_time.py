from collections.abc import Callable

import pytest
from views import SIZE, tables_of

from hid2.reference_line import TABLE_STEP_M, ReferenceLine
from hid2.traffic import Traffic


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
