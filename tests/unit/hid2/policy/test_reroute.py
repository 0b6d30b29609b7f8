"""Other ways at the next split: which there are, and that the way so far is the same on them."""

import numpy as np
import pytest
from hand_drawn import draw_lane
from inserted import scene_on

from hid2.params import Config
from hid2.policy.roads import ways_at_next_split
from hid2.scene import Scene
from netconvert.lane_graph import LaneGraph


def _tree(config: Config | None = None) -> Scene:
    """Lane 1 splits at x = 50 into 2 (straight on) and 3; lane 2 at x = 100 into 4 (straight on), 5, and 6 (bikes)."""

    def off(x0: float, bend: float) -> list[tuple[float, float]]:
        return [(x0 + x, bend * x**2) for x in np.linspace(0.0, 60.0, 30)]

    lanes = {
        1: draw_lane(1, [(0.0, 0.0), (50.0, 0.0)], successors=(2, 3)),
        2: draw_lane(2, [(50.0, 0.0), (100.0, 0.0)], successors=(4, 5, 6)),
        3: draw_lane(3, off(50.0, 0.01)),
        4: draw_lane(4, [(100.0, 0.0), (200.0, 0.0)]),
        5: draw_lane(5, off(100.0, -0.01)),
        6: draw_lane(6, off(100.0, 0.02), lane_type="BIKE"),
    }
    ring = np.array([(-20.0, -90.0), (220.0, -90.0), (220.0, 90.0), (-20.0, 90.0), (-20.0, -90.0)])
    return scene_on(LaneGraph(lanes, drivable_areas=(ring,)), config=config)


def _routes(scene: Scene, s: float, route: tuple[int, ...] = (1, 2, 4)) -> list[list[int]]:
    ways = ways_at_next_split(scene, scene.paths.along(route), s=s, from_m=s + 5.0)
    return [[segment.lane_id for segment in way.segments] for way in ways]


@pytest.mark.parametrize(
    ("s", "ways"), [(10.0, [[1, 3]]), (44.0, [[1, 3]]), (46.0, [[1, 2, 5]]), (80.0, [[1, 2, 5]]), (96.0, [])]
)
def test_the_next_split_ahead_offers_every_other_lane_for_vehicles(s: float, ways: list[list[int]]) -> None:
    """5 m before a split nobody turns off there any more."""
    assert _routes(_tree(), s) == ways


def test_split_at_the_place_from_which_it_may_turn_off_is_offered_and_straight_on_comes_first() -> None:
    """From the end of lane 1 on: the split there counts, 1 mm farther on it does not. Without topology nothing does."""
    scene = _tree()
    path = scene.paths.along((1, 2, 4))
    at = path.segments[0].end
    routes = [
        [segment.lane_id for way in ways_at_next_split(scene, path, s=40.0, from_m=from_m) for segment in way.segments]
        for from_m in (at, at + 1e-3)
    ]
    assert routes == [[1, 3], [1, 2, 5]]
    assert _routes(scene, 10.0, (1, 3)) == [[1, 2, 4]]
    assert _routes(scene, 60.0, (1, 2, 5)) == [[1, 2, 4]]
    assert _routes(_tree(Config(without=frozenset({"topology"}))), 10.0) == []


def test_way_so_far_is_the_same_on_both() -> None:
    scene = _tree()
    path = scene.paths.along((1, 2, 4))
    (other,) = ways_at_next_split(scene, path, s=30.0, from_m=35.0)
    s = np.linspace(0.0, 30.0, 31)
    at = other.all_to_line(path.all_to_raw(s))
    assert other.line.position(at) == pytest.approx(path.line.position(s), abs=0.02)
