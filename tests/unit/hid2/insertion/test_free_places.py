"""Places on routes that are taken as the scene begins."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from hid2.agents import BoxSize
from hid2.insertion.free_places import _pose, taken
from hid2.motion.route import Route
from hid2.occupancy.sigma import GENERATED, UNDER_SHARE, cells_under
from hid2.occupancy.traffic import Traffic
from hid2.params import Config
from hid2.scene import World, build_world
from netconvert.cells import build_cell_grid
from netconvert.lane_graph import LaneGraph, LaneSegment

_SIZE = BoxSize(4.5, 2.0)


@pytest.fixture
def world(lane: Callable[..., LaneSegment]) -> World:
    """60 m east on lane 1, then 60 m north on lane 2; lane 3 of 40 m lies elsewhere, to the west."""
    graph = LaneGraph(
        {
            3: lane(3, [(-100.0, 50.0), (-140.0, 50.0)]),
            1: lane(1, [(0.0, 0.0), (60.0, 0.0)], successors=(2,)),
            2: lane(2, [(60.0, 0.0), (60.0, 20.0), (60.0, 60.0)]),
        }
    )
    return build_world(build_cell_grid(graph), (), config=Config(), num_steps=110, last_observed_step=49)


@pytest.fixture
def against(world: World, box: Callable[..., Traffic]) -> Callable[..., tuple[list[str | None], list[float]]]:
    """against(places, others=..., cells=..., back_m=...) -> reasons, where; nobody is there unless told."""
    nobody = box(0.0, 0.0).rows([])

    def look(
        places: Sequence[tuple[Route, float]],
        others: Traffic = nobody,
        cells: Sequence[int] = (),
        back_m: Sequence[float] = (),
    ) -> tuple[list[str | None], list[float]]:
        sigma = world.occupancy.sigma[0].copy()
        sigma[list(cells)] = GENERATED
        return taken(
            [world.way(route) for route, _ in places], [s0 for _, s0 in places], _SIZE, lanes=world.recorded.lanes,
            boxes=world.boxes, sigma=sigma, others=others, gap_m=1.7, back_m=back_m,
        )  # fmt: skip

    return look


def test_places_on_empty_roads_are_free(against: Callable[..., tuple[list[str | None], list[float]]]) -> None:
    places = [((1, 2), 10.0), ((2,), 10.0), ((3,), 20.0), ((1, 2), 70.0)]
    assert against(places) == ([None] * 4, [10.0, 10.0, 20.0, 70.0])


def test_somebody_takes_the_place_and_the_gap_before_and_behind(
    against: Callable[..., tuple[list[str | None], list[float]]], box: Callable[..., Traffic]
) -> None:
    """A car of 4.5 m at (60, 20), across lane 2, 80 m along 1 - 2: 1.9 / 2 + 4.5 / 2 + 1.7 m are 4.9."""
    places = [((1, 2), s0) for s0 in (75.0, 75.2, 80.0, 84.8, 85.0)] + [((2,), 20.0), ((1, 2), 20.0), ((3,), 20.0)]
    reasons, _ = against(places, box(60.0, 20.0))
    assert reasons == [None, *["box_too_close"] * 3, None, "box_too_close", None, None]


@pytest.mark.parametrize("s", [-1.0, 0.0, 25.0, 59.9, 60.0, 80.0, 100.0, 121.5])
def test_place_lies_on_the_middle_of_its_lane(world: World, s: float) -> None:
    """East for 60 m, north for 60 m, and straight on beyond both ends."""
    way, lanes = world.way((1, 2)), world.recorded.lanes
    x, y, heading = _pose(way.table, s, (lanes.points, lanes.s, lanes.first))
    lane_id, lane_s = way.on_lane(s)
    path = world.grid.graph.lanes[lane_id].path
    assert [x, y] == pytest.approx(path.point([lane_s])[0].tolist())
    assert heading == path.heading([lane_s])[0]


@pytest.mark.parametrize("s0", [3.0, 20.0, 59.0, 61.0, 85.0, 117.0])
def test_cell_under_the_box_is_not_free(
    world: World, against: Callable[..., tuple[list[str | None], list[float]]], s0: float
) -> None:
    """Each cell under the box takes the place, no other one does; so the box is where the path says."""
    lane_id, lane_s = world.way((1, 2)).on_lane(s0)
    path = world.grid.graph.lanes[lane_id].path
    (x, y), heading = path.point([lane_s])[0].tolist(), float(path.heading([lane_s])[0])
    under = cells_under(
        world.boxes, x, y, heading, length_m=_SIZE.length_m, width_m=UNDER_SHARE * _SIZE.width_m
    ).tolist()
    assert under
    for cell in range(len(world.grid.cells)):
        expected = "cells_occupied" if cell in under else None
        assert against([((1, 2), s0)], cells=[cell])[0] == [expected]


def test_taken_place_is_moved_back_until_it_is_free(
    against: Callable[..., tuple[list[str | None], list[float]]], box: Callable[..., Traffic]
) -> None:
    """A car at 20 m needs 4.5 + 1.7 m: 13.8 m is the nearest place behind it. At 3 m there is none on the road."""
    places = [((1, 2), 15.5), ((1, 2), 13.0), ((1, 2), 18.5)]
    reasons, s0 = against(places, box(20.0, 0.0), back_m=(1.0, 1.0, 1.0))
    assert reasons == [None, None, "box_too_close"]
    assert s0[:2] == [13.5, 13.0]
    assert against([((1, 2), 3.0)], box(6.0, 0.0), back_m=(0.5, 0.5, 5.0))[0] == ["box_too_close"]
    assert np.isclose(against([((1, 2), 62.0)], box(60.0, 6.0), back_m=(4.0, 4.0))[1], [58.0]).all()
