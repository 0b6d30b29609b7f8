"""Starts on a path, many at a time: what is found out there is what one search after the other would find."""

from collections.abc import Callable

import numpy as np
import pytest

from hid2.agents import BoxSize
from hid2.conflicts.cases import Prospect, prospect, road_most
from hid2.insertion.starts import Start, starts
from hid2.motion.route import DrivenPath
from hid2.occupancy.along_path import path_occupancy
from hid2.occupancy.traffic import Traffic
from hid2.params import Config, Limits, Turn
from hid2.policy.turns import RoadSpeeds, road_speeds
from netconvert.lane_graph import TurnType

CAR = BoxSize(4.5, 1.9)
CONFIG = Config()

Starts = Callable[..., list[Start | str]]


@pytest.fixture
def speeds(straight_path: DrivenPath) -> RoadSpeeds:
    return road_speeds(straight_path.line, [(0.0, 200.0, TurnType.STRAIGHT)], turn=Turn(), limits=Limits())


@pytest.fixture
def look(straight_path: DrivenPath) -> Callable[..., Prospect]:
    """look(recorded, *generated): what a car on the x axis has before it."""

    def make(recorded: Traffic, *generated: Traffic) -> Prospect:
        margin_m = CONFIG.conflict.margin_lateral_m
        known = path_occupancy(straight_path.line, recorded, length_m=4.5, width_m=1.9, margin_lateral_m=margin_m)
        desired = np.full(straight_path.line.table_xy.shape[0], 12.0)
        return prospect(
            straight_path, CAR, desired, road_most(straight_path.line, CONFIG), generated, config=CONFIG,
            num_steps=110, earliest_exit_step=51, known=known,
        )  # fmt: skip

    return make


@pytest.fixture
def found(speeds: RoadSpeeds) -> Starts:
    """found(look, s0, cruise=12, ...): starts with the desired speed wished for."""

    def make(
        ahead: Prospect,
        s0: list[float],
        *,
        cruise: float = 12.0,
        shares: tuple[float, ...] = (1.0,),
        gentle_from: int | None = None,
        plans: bool = True,
        turn_end: float = 0.0,
        turned_by: int = 0,
    ) -> list[Start | str]:
        wanted = np.full(len(s0), cruise)
        rows = ahead.recorded_rows if gentle_from is None else gentle_from
        return starts(
            ahead, speeds, np.array(s0), wanted, wanted, shares=shares, gentle_from=rows,
            turn_end=np.full(len(s0), turn_end), turned_by=turned_by, config=CONFIG, plans=plans,
        )  # fmt: skip

    return make


def test_many_starts_are_planned_as_each_of_them_alone(
    look: Callable[..., Prospect], found: Starts, box: Callable[..., Traffic]
) -> None:
    """Somebody drives ahead at 6 m/s, a bus crosses: plan by plan what `Prospect.plan` finds from there."""
    ahead = look(box(80.0, 0.0, 0.0, 6.0), box(150.0, -60.0, np.pi / 2, 8.0, length_m=11.0, width_m=2.8))
    places = [5.0, 20.0, 41.5, 60.0, 110.0]
    several = found(ahead, places)
    alone = [found(ahead, [s0])[0] for s0 in places]
    for s0, one, other in zip(places, several, alone, strict=True):
        assert isinstance(one, Start)
        assert isinstance(other, Start)
        assert one.plan is not None
        assert other.plan is not None
        plan = ahead.plan(s0=s0, v0=one.v0, a0=0.0, first_step=0, config=CONFIG)
        assert plan is not None
        assert np.array_equal(one.plan.s, other.plan.s)
        assert np.array_equal(one.plan.s, plan.s)
        assert np.array_equal(one.plan.v, plan.v)
        assert one.plan.cost == plan.cost


def test_starts_that_are_not_possible_say_why(
    look: Callable[..., Prospect], found: Starts, box: Callable[..., Traffic]
) -> None:
    """A car stands at 60 m: 3 m behind it is too close. One comes at 20 m/s from 90 m: at 100 m it would run up."""
    ahead = look(box(60.0, 0.0), box(90.0, 0.0, 0.0, 20.0))
    assert found(ahead, [53.0, 100.0], cruise=8.0) == ["box_too_close", "follower_too_fast"]


def test_nothing_starts_where_every_way_on_is_closed(
    look: Callable[..., Prospect], found: Starts, box: Callable[..., Traffic]
) -> None:
    """A car comes the wrong way: nobody in its lane can get out of its way."""
    assert found(look(box(120.0, 0.0, np.pi, 12.0)), [20.0, 60.0], shares=(1.0, 0.5, 0.0)) == ["no_safe_timing"] * 2


def test_slower_start_is_taken_where_the_fast_one_is_not_possible(
    look: Callable[..., Prospect], found: Starts, box: Callable[..., Traffic]
) -> None:
    """From 1 s on a bus stands across the road at 48 m: from 30 m nobody stops before it from 12 m/s, but from 6."""
    across = look(box(48.0, 0.0, np.pi / 2, 0.0, first=10, length_m=11.0, width_m=2.8))
    (fast,), (slow,) = found(across, [30.0]), found(across, [30.0], shares=(1.0, 0.5, 0.0))
    assert fast == "no_safe_timing"
    assert isinstance(slow, Start)
    assert slow.plan is not None
    assert slow.plan.v[0] < slow.v0


def test_without_plans_only_the_speed_is_found(
    look: Callable[..., Prospect], found: Starts, box: Callable[..., Traffic]
) -> None:
    """30 m behind who drives at 5 m/s, the gap of 25.5 m allows more than its speed, not more than the lane's."""
    ahead = look(box(60.0, 0.0, 0.0, 5.0))
    (start,) = found(ahead, [30.0], plans=False)
    assert isinstance(start, Start)
    assert start.plan is None
    assert 5.0 < start.v0 <= 12.0


def test_generated_followers_are_spared_only_where_asked(
    look: Callable[..., Prospect], found: Starts, box: Callable[..., Traffic], straight_path: DrivenPath
) -> None:
    """One at 11 m/s 14 m behind would brake at once for 6 m/s; with patience (nobody from row 1 on) it may."""
    ahead = look(box(199.0, 40.0), box(40.0, 0.0, 0.0, 11.0))
    rows = ahead.occupancy.low.shape[0]
    assert found(ahead, [58.5], cruise=6.0) == ["follower_too_fast"]
    (patient,) = found(ahead, [58.5], cruise=6.0, gentle_from=rows)
    assert patient != "follower_too_fast"


def test_turn_that_cannot_be_reached_is_not_planned(
    look: Callable[..., Prospect], found: Starts, box: Callable[..., Traffic]
) -> None:
    """Somebody stands at 100 m. Beyond him there is no way; within 2 s nobody gets 60 m on; in between all is well."""
    ahead = look(box(100.0, 0.0))

    def at(s0: float, turn_end: float, turned_by: int = 100) -> Start | str:
        return found(ahead, [s0], turn_end=turn_end, turned_by=turned_by)[0]

    assert at(40.0, 120.0) == "turn_not_reached"
    assert at(110.0, 170.0, turned_by=20) == "turn_not_reached"
    assert isinstance(at(40.0, 80.0), Start)
    assert isinstance(at(110.0, 170.0), Start)
    assert isinstance(at(40.0, 0.0), Start)
    between = look(box(100.0, 0.0), box(50.0, 0.0, 0.0, 10.0))
    assert found(between, [75.0], cruise=9.0, gentle_from=9, turn_end=90.0, turned_by=100) == ["no_safe_timing"]
