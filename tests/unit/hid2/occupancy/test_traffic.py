from dataclasses import replace

import numpy as np
import pytest
from hand_drawn import draw_box, draw_road, draw_track
from inserted import CAR, recorded, scene_on

from hid2.agents import BoxSize
from hid2.occupancy.traffic import traffic_of


def test_gap_inside_a_track_is_filled_on_the_straight_between() -> None:
    """States at 1 and 3 only: x = 0 and 4, so x = 2 at step 2; nothing before step 1 or after step 3. One state stands.

    step      0   1   2   3   4
    x         -   0  (2)  4   -
    """
    traffic = traffic_of([draw_track([1, 3], [0.0, 4.0])], 5, step_s=0.1)
    assert traffic.present[0].tolist() == [False, True, True, True, False]
    assert traffic.position[0, 1:4, 0].tolist() == [0.0, 2.0, 4.0]
    traffic = traffic_of([draw_track([2], [7.0])], 4, step_s=0.1)
    assert traffic.present[0].tolist() == [False, False, True, False]
    assert traffic.velocity[0, 2].tolist() == [0.0, 0.0]


def test_agent_is_there_a_little_before_it_is_seen_and_after() -> None:
    """Seen at steps 3 to 5, 1 m apart: two steps more on each side, those within the scene."""
    seen = traffic_of([draw_track([3, 4, 5], [3.0, 4.0, 5.0])], 7, step_s=0.1)
    found = seen.lasting(2, step_s=0.1)
    assert found.present[0].tolist() == [False, *[True] * 6]
    assert found.position[0, 1:, 0] == pytest.approx([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    assert seen.present[0].sum() == 3


def test_heading_in_a_gap_turns_the_short_way_round() -> None:
    """From 170 to -170 degrees through 180, not through 0."""
    heading = np.radians([170.0, -170.0])
    traffic = traffic_of([draw_track([0, 2], [0.0, -1.0], 0.0, heading)], 3, step_s=0.1)
    assert np.cos(traffic.heading[0, 1]) == pytest.approx(-1.0)


def test_box_that_a_tracker_has_turned_round_points_along_its_motion() -> None:
    """Turned round over 6 m of 10 m driven. What stands stays as it is, also where it drifts 2 m backwards for 1 s."""
    heading, back = np.radians([*[10.0] * 4, *[-170.0] * 7]), np.interp(np.arange(40), [20, 30], [0.0, -2.0])
    moves, stands = (draw_track(range(11), x * np.arange(11), 0.0, heading) for x in (1.0, 0.0))
    drifts = draw_track(range(40), back, 0.0, np.full(40, 0.1))
    traffic = traffic_of([moves, stands, drifts], 40, step_s=0.1)
    assert np.degrees(traffic.heading[0, :11]) == pytest.approx([10.0] * 11)
    assert traffic.heading[1, :11].tolist() == heading.tolist()
    assert traffic.heading[2].tolist() == [0.1] * 40


def test_velocity_is_that_of_the_positions_over_up_to_half_a_second() -> None:
    """x = 0 1 2 3 5 m at 0.1 s. Inside: (5 - 0) / 0.4 s = 12.5 m/s. First step: (2 - 0) / 0.2 s = 10 m/s; last: 15.

    The recorded velocity, 99 m/s here, is not believed.
    """
    traffic = traffic_of([draw_track(range(5), [0.0, 1.0, 2.0, 3.0, 5.0])], 5, step_s=0.1)
    assert traffic.velocity[0, 2] == pytest.approx([12.5, 0.0])
    assert traffic.velocity[0, 0] == pytest.approx([10.0, 0.0])
    assert traffic.velocity[0, 4] == pytest.approx([15.0, 0.0])


@pytest.mark.parametrize(
    ("stated", "found", "other"), [(8.5, 8.5, 3.0), (11.9, 10.0, 3.0), (12.1, 10.0, 10.0), (0.0, 10.0, 10.0)]
)
def test_velocity_is_the_slower_of_what_is_stated_and_what_positions_show_if_that_is_believed(
    stated: float, found: float, other: float
) -> None:
    """10 m/s by the positions; up to 2 m/s off in the median the stated ones count, all of a recording, in gaps too."""
    steps = [0, 1, 2, 4, 5, 6]
    one = draw_track(steps, [1.0 * step for step in steps])
    one = replace(one, velocity=np.tile([stated, 0.0], (6, 1)))
    off = replace(draw_track([0, 1, 2], [0.0, 1.0, 2.0]), velocity=np.tile([3.0, 0.0], (3, 1)))
    traffic = traffic_of([one, off], 7, step_s=0.1)
    assert traffic.velocity[0, :, 0] == pytest.approx([found] * 7)
    assert traffic.velocity[1, :3, 0] == pytest.approx([other] * 3)


def test_box_covers_the_label_and_what_readers_assume() -> None:
    """Readers without the label take a vehicle for 4.5 x 1.9: a label of 4.2 x 2.1 becomes 4.5 x 2.1."""
    traffic = traffic_of([draw_track([0], [0.0], size=BoxSize(4.2, 2.1))], 1, step_s=0.1)
    assert (traffic.length_m[0], traffic.width_m[0]) == (4.5, 2.1)


def test_joined_rows_and_steps_keep_the_order() -> None:
    both = draw_box(1.0, 0.0, name="a").joined(draw_box(2.0, 0.0, 0.0, 10.0, name="b"))
    assert both.ids == ("a", "b")
    assert both.rows([1]).ids == ("b",)
    assert both.rows([1]).position[0, 3].tolist() == pytest.approx([5.0, 0.0])
    assert both.at(3).num_steps == 1
    assert both.at(3).position[:, 0, 0] == pytest.approx([1.0, 5.0])
    nobody = traffic_of([], 110, step_s=0.1)
    assert nobody.num_steps == 110
    assert nobody.joined(draw_box(0.0, 0.0)).ids == ("a",)


def test_what_is_known_of_joined_traffic_does_not_hold_for_it_elsewhere() -> None:
    scene = scene_on(draw_road())
    path, one = scene.paths.along((1,)), scene_on(draw_road(), recorded(50.0, 0.0)).future
    scene.met_on(path, CAR, one)
    moved = one.joined(scene_on(draw_road(), recorded(90.0, 0.0, name="b")).future)
    moved = replace(moved, position=moved.position + np.array([30.0, 0.0]))
    assert scene.met_on(path, CAR, moved).low[:, 0].tolist() == pytest.approx([75.0, 115.0], abs=0.6)
