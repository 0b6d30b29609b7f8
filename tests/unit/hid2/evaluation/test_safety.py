"""Boxes, TTC, PET, footprint, leaders and lanes of the evaluation."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hand_drawn import draw_lane, draw_road
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.affinity import rotate, translate
from shapely.geometry import box as rectangle
from views import lane_view

from hid2.agents import BoxSize, Track
from hid2.evaluation.safety import FOOTPRINT_TOLERANCE_M, off_footprint, overlaps, safety, ttc_after_last_step
from hid2.kernels.boxes import contact_time
from hid2.measures.arrays import SceneArrays, stack
from hid2.measures.following import leaders
from hid2.measures.lane_matching import flatten_lanes, match_lanes
from hid2.measures.surrogates import encroachments
from netconvert.lane_graph import LaneGraph


def safe_of(arrays, graph):
    return safety(lane_view(arrays, graph))


def drive(x, y=0.0, heading=0.0, *, speed=0.0, steps=60, first=0, name="t", size=(4.0, 2.0), kind="vehicle"):
    """A vehicle straight ahead at constant speed from (x, y)."""
    time = 0.1 * np.arange(steps)
    ahead = np.array([math.cos(heading), math.sin(heading)])
    position = np.array([x, y]) + speed * time[:, None] * ahead
    velocity = np.tile(speed * ahead, (steps, 1))
    return Track(
        name, kind, 1, np.arange(first, first + steps), position, np.full(steps, heading), velocity, BoxSize(*size)
    )


def shapely_box(x, y, heading, length, width):
    return translate(rotate(rectangle(-length / 2, -width / 2, length / 2, width / 2), math.degrees(heading)), x, y)


angles = st.floats(-math.pi, math.pi)
places = st.floats(-6, 6)
sizes = st.floats(0.5, 12)


@settings(deadline=None)  # the first call may compile
@given(places, places, angles, angles, st.tuples(sizes, sizes), st.tuples(sizes, sizes))
def test_iou_of_boxes_at_any_angle(x, y, first, second, size_a, size_b):
    arrays = stack(
        [drive(0.0, 0.0, first, steps=1, name="a", size=size_a), drive(x, y, second, steps=1, name="b", size=size_b)],
        num_steps=1, step_s=0.1,
    )  # fmt: skip
    a, b = shapely_box(0, 0, first, *size_a), shapely_box(x, y, second, *size_b)
    iou = next((pair.iou for pair in overlaps(arrays)), 0.0)
    assert iou == pytest.approx(a.intersection(b).area / a.union(b).area, abs=1e-9)


@settings(deadline=None)  # the first call may compile
@given(st.floats(-40, 40), st.floats(-40, 40), st.floats(-15, 15), st.floats(-15, 15), angles, angles)
def test_contact_time_equals_moving_the_boxes_by_small_steps(x, y, vx, vy, first, second):
    """Boxes 4 x 2 m: at the time found they touch, and a little before they do not."""
    ahead_a, ahead_b = (math.cos(first), math.sin(first)), (math.cos(second), math.sin(second))
    seconds = contact_time(x, y, vx, vy, *ahead_a, 2.0, 1.0, *ahead_b, 2.0, 1.0)
    still = shapely_box(0, 0, first, 4, 2)

    def distance(time):
        return still.distance(shapely_box(x + vx * time, y + vy * time, second, 4, 2))

    if math.isinf(seconds):
        assert min(distance(time) for time in np.arange(0, 6, 0.05)) > 0
    elif seconds < 10:
        assert distance(seconds) == pytest.approx(0.0, abs=1e-6)
        if seconds > 1e-3:
            assert distance(seconds - 1e-3) > 0


def test_ttc_of_a_car_that_closes_on_a_standing_one():
    """Gap 20 - 4 = 16 m at 8 m/s: 2 s at the first step, then 0.1 s less a step; capped at 5 s to a far one."""
    arrays = stack(
        [drive(0, speed=8.0, steps=10, name="a"), drive(20, steps=10, name="b"), drive(100, 3.5, steps=10, name="c")],
        step_s=0.1,
    )
    safe = safe_of(arrays, draw_road())
    np.testing.assert_allclose(safe.ttc_s[:10], 2.0 - 0.1 * np.arange(10), atol=1e-9)
    np.testing.assert_allclose(safe.ttc_s[10:20], safe.ttc_s[:10])
    np.testing.assert_allclose(safe.ttc_s[20:], 5.0)
    nobody = safe_of(stack([], num_steps=110, step_s=0.1), draw_road())
    assert nobody.overlaps == ()
    assert len(nobody.ttc_s) == 0


def test_pet_is_the_time_between_leaving_and_reaching_the_shared_ground():
    """a crosses y = 0 northwards, b drives along it and comes later.

    a (width 2) covers x from -1 to 1; its rear (length 4) leaves y = 1 when its centre is at y = 3. From y = -20 at
    10 m/s: after 2.3 s. b's front reaches x = -1 with its centre at x = -3, from x = -50 at 10 m/s: after 4.7 s.
    PET 2.4 s. A third car crosses b's path 1 s later; asked for those of the last one, only it is named.
    """
    a = drive(0, -20, math.pi / 2, speed=10.0, name="a")
    b = drive(-50, 0, 0.0, speed=10.0, name="b")
    (found,) = encroachments(stack([a, b], step_s=0.1))
    assert found.pet_s == pytest.approx(2.4)
    scene = stack([a, b, drive(8, -30, math.pi / 2, speed=10.0, name="c")], step_s=0.1)
    assert {(c.first, c.second) for c in encroachments(scene)} == {(0, 1), (1, 2)}
    assert {(c.first, c.second) for c in encroachments(scene, first_row=2)} == {(1, 2)}
    assert encroachments(scene, first_row=2, cap_s=0.5) == ()


def test_oncoming_car_that_has_not_turned_yet_counts_where_its_path_crosses_later():
    """a drives along y = 0 and reaches to y = 1. b is there from 3.0 s on, 160 degrees against a, and turns later.

    Its front left corner is at x = 20 - 2 cos 20 + sin 20 = 18.46, y = 2.2 - 2 sin 20 - cos 20 = 0.58; its side is
    below y = 1 up to x = 18.46 + 0.42 / tan 20 = 19.61. a's rear, half a step's way longer, leaves that with its centre
    at 22.1, after 2.2 s: PET 0.8 s.
    """
    a = drive(0, 0, 0.0, speed=10.0, name="a")
    time = 0.1 * np.arange(80)
    heading = np.where(time < 5.0, math.radians(-160.0), math.radians(-110.0))
    driven = np.maximum(time - 5.0, 0.0)[:, None] * 5.0 * np.column_stack([np.cos(heading), np.sin(heading)])
    velocity = np.gradient(driven, 0.1, axis=0)
    b = Track(
        "b", "vehicle", 1, 30 + np.arange(80), np.array([20.0, 2.2]) + driven, heading, velocity, BoxSize(4.0, 2.0)
    )
    (found,) = encroachments(stack([a, b], step_s=0.1))
    assert found.pet_s == pytest.approx(0.8)


def test_following_and_meeting_are_no_crossings():
    follower, leader = drive(0, speed=10.0, name="a"), drive(12, speed=10.0, name="b")
    oncoming = drive(60, 0.5, math.pi, speed=10.0, name="c")
    assert encroachments(stack([follower, leader, oncoming], step_s=0.1)) == ()


def test_footprint_allows_thirty_centimetres():
    """Right edge of the area at y = -1.75. A box of 2 m width at y = -1.0 reaches -2.0 (0.25 m out), at -1.1 0.35 m."""
    arrays = stack([drive(50, -1.0, steps=1, name="a"), drive(80, -1.1, steps=1, name="b")], step_s=0.1)
    assert off_footprint(arrays, draw_road()).tolist() == [False, True]


@pytest.mark.parametrize("beyond_m", [-1e-3, -1e-5, 1e-5, 1e-3])
def test_footprint_round_a_convex_corner_is_measured_by_distance(beyond_m):
    """The area's corner (x, -1.75): a point beside it is off where it is over 0.3 m away, whatever the direction.

    Vehicles almost without extent, at 0.3 m and a little, all round the corner that points away from the area.
    """
    graph = draw_road()
    corner = np.array(graph.drivable.bounds[2:0:-1])  # right, lower
    angle = np.linspace(-math.pi / 2, 0.0, 61)
    places = corner + (FOOTPRINT_TOLERANCE_M + beyond_m) * np.column_stack([np.cos(angle), np.sin(angle)])
    arrays = stack(
        [drive(x, y, steps=1, name=f"{k}", size=(1e-9, 1e-9)) for k, (x, y) in enumerate(places)], step_s=0.1
    )
    assert (off_footprint(arrays, graph) == (beyond_m > 0)).all()


def test_leader_gap_time_gap_headway_and_ttc():
    """Lane 1: a at x = 0 with 10 m/s, b at x = 24 with 6 m/s, both 4 m long: gap 20 m, 2.0 s, front to front 2.4 s.

    Closing at 4 m/s: TTC 5 s. c drives beside them in lane 2 and leads nobody.
    """
    moving = ("a", 0, 0.0, 10.0), ("b", 24, 0.0, 6.0), ("c", 10, 3.5, 8.0)
    tracks = [drive(x, y, speed=speed, steps=20, name=name) for name, x, y, speed in moving]
    found = leaders(lane_view(stack(tracks, step_s=0.1), draw_road()))
    assert found.agent[0] == 1
    assert found.agent[20] == found.agent[40] == -1
    assert found.gap_m[0] == pytest.approx(20.0)
    assert found.time_gap_s[0] == pytest.approx(2.0)
    assert found.ttc_s[0] == pytest.approx(5.0)
    assert math.isinf(found.gap_m[20])


def test_leader_is_found_through_successors_and_on_the_way_driven():
    """Lane 1 forks into 2 (straight on) and 3 (bends off). a takes 3 later: b on 3 leads, c on 2 does not.

    1 ------> 2 ----- c
        \\---> 3 b
    """
    bend = [(50.0 + 5 * k, 0.08 * (5 * k) ** 2 / 5) for k in range(9)]
    graph = LaneGraph(
        {
            1: draw_lane(1, [(0, 0), (50, 0)], successors=(2, 3)),
            2: draw_lane(2, [(50, 0), (100, 0)]),
            3: draw_lane(3, bend),
        }
    )
    steps = np.arange(80)
    along = np.array([[0.0, 0.0], *bend])
    length = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(along, axis=0).T))])
    x, y = (np.interp(steps * 1.0, length, along[:, axis]) for axis in (0, 1))
    heading = np.arctan2(np.gradient(y), np.gradient(x))
    a = Track("a", "vehicle", 1, steps, np.column_stack([x, y]), heading, np.full((80, 2), 7.0), BoxSize(4, 2))
    end = along[-2]
    tracks = [a, drive(*end, 0.6, steps=80, name="b"), drive(62, 0, steps=80, name="c")]
    assert leaders(lane_view(stack(tracks, step_s=0.1), graph)).agent[20] == 1


def test_driving_against_the_lane_is_seen_and_parking_across_it_is_not():
    graph = draw_road(length_m=200.0)
    wrong = drive(150, 0, math.pi, speed=8.0, name="wrong")
    right = drive(50, 3.5, 0.0, speed=8.0, name="right")
    parked = drive(180, 0, math.pi, name="parked")
    arrays = stack([wrong, right, parked], step_s=0.1)
    share = arrays.mean_per_agent(safe_of(arrays, graph).against_lane.astype(float))
    assert share.tolist() == [1.0, 0.0, 0.0]


def test_a_sliver_between_two_lanes_is_not_driving_against_one_that_crosses_them():
    """Lanes 1 and 2 side by side, 0.4 m apart; 3 crosses both back and across. x keeps to 1, then drives between.

    At y = 1.95 x is 0.2 m beside 1 and 2, on 3, which points 135 degrees away; at y = -2.2 it is 0.45 m beside 1.
    """
    graph = LaneGraph(
        {
            1: draw_lane(1, [(0, 0), (200, 0)]),
            2: draw_lane(2, [(0, 3.9), (200, 3.9)]),
            3: draw_lane(3, [(130, -30), (70, 30)]),
        }
    )
    for y, expected in ((0.0, False), (1.95, False), (-2.2, True)):
        arrays = stack([drive(60, y, 0.0, speed=8.0, name="x")], step_s=0.1)
        assert safe_of(arrays, graph).against_lane.any() == expected, y


def test_scene_with_one_more_track_is_the_scene_of_all_tracks():
    tracks = [drive(0, -20, math.pi / 2, speed=10.0, name="a"), drive(9, steps=3, name="b")]
    more = drive(-50, 0, 0.0, speed=10.0, name="gen_0")
    whole = stack([*tracks, more], step_s=0.1)
    parts = [stack(some, num_steps=whole.num_steps, step_s=0.1) for some in (tracks, [more])]
    one = SceneArrays.joined(parts)
    for name in SceneArrays.__dataclass_fields__:
        got, wanted = getattr(one, name), getattr(whole, name)
        assert np.array_equal(got, wanted), name
        assert getattr(got, "dtype", None) == getattr(wanted, "dtype", None), name
        assert np.array_equal(getattr(whole.agents([0, 1]), name), getattr(parts[0], name)), name


def test_a_track_is_looked_at_from_its_own_last_step_among_those_present_then() -> None:
    """gen_0 ends at step 20 at x = 20, 10 m/s: front at 22, the wall's rear at 32: 1 s. "late" is not there yet."""
    wall, late = drive(34.0, steps=110, name="wall"), drive(29.0, steps=89, first=21, name="late")
    scene = stack([drive(0.0, speed=10.0, steps=21, name="gen_0"), wall, late], step_s=0.1)
    everybody = np.ones(scene.num_agents, dtype=bool)
    assert ttc_after_last_step(scene, scene.generated, everybody) == pytest.approx([1.0, np.inf, np.inf])
    assert np.isinf(ttc_after_last_step(scene, everybody, scene.generated)).all()  # among a group of others


def test_ttc_sees_a_crossing_vehicle_that_no_lane_leads_to():
    """a at 10 m/s along x from 0, b at 10 m/s along y from (30, -30): the boxes touch in the corner.

    b's right-hand face is at x = 29 (width 2), a's front reaches it after 2.7 s; b's front (length 4) is at
    y = -28 + 27 = -1 then, and a's lower side is at y = -1: they touch at 2.7 s.
    """
    arrays = stack(
        [drive(0, speed=10.0, steps=2, name="a"), drive(30, -30, math.pi / 2, speed=10.0, steps=2, name="b")],
        step_s=0.1,
    )
    assert safe_of(arrays, draw_road()).ttc_s[0] == pytest.approx(2.7)


def test_lane_of_a_vehicle_near_the_marking_does_not_flicker():
    """y wanders from 1.6 to 1.9 and back (marking at 1.75) for 0.3 s: one lane all the way."""
    x = np.arange(60) * 1.0
    y = np.full(60, 1.5)
    y[30:33] = 1.95
    track = replace(drive(0.0, name="a"), position=np.column_stack([x, y]))
    matches = match_lanes(stack([track], step_s=0.1), flatten_lanes(draw_road()))
    assert set(matches.lane.tolist()) == {0}
