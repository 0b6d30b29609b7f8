"""Contacts after the last step, worked by hand: cars of 4 x 2 m along x, across it, and standing."""

import numpy as np
import pytest

from hid2.agents import BoxSize, Track
from hid2.measures.arrays import SceneArrays, stack
from hid2.measures.scene_end import BoxesAtStep, first_contact, ttc_after_last_step

Box = tuple[float, float, float, float]


def boxes(*rows: Box) -> BoxesAtStep:
    """Cars of 4 x 2 m, each x, y (m), heading (degrees) and speed (m/s)."""
    x, y, degrees, speed = np.array(rows, dtype=np.float64).T
    heading = np.radians(degrees)
    velocity = speed[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
    return BoxesAtStep(np.column_stack([x, y]), heading, velocity, np.full((len(rows), 2), (4.0, 2.0)))


@pytest.mark.parametrize(
    ("other", "ttc_s"),
    [
        # own car at the origin, eastward at 10 m/s; its front is at x = 2
        pytest.param((24.0, 0.0, 0.0, 0.0), 2.0, id="standing leader: 20 m at 10 m/s"),
        pytest.param((24.0, 0.0, 180.0, 10.0), 1.0, id="oncoming: 20 m at 20 m/s"),
        # front (y = -3) reaches own side (y = -1) at 0.4 s, but own front comes to x = 5 only at 0.3 s: 0.4
        pytest.param((6.0, -5.0, 90.0, 5.0), 0.4, id="crossing: 2 m at 5 m/s"),
        pytest.param((-14.0, 0.0, 0.0, 30.0), 0.5, id="follower: 10 m at 20 m/s"),
        pytest.param((3.0, 0.0, 0.0, 10.0), 0.0, id="overlap"),
    ],
)
def test_time_to_the_first_contact_is_that_of_the_boxes(other: Box, ttc_s: float) -> None:
    contact = first_contact(0, boxes((0, 0, 0, 10), other))
    assert contact is not None
    assert contact.other == 1
    assert contact.ttc_s == pytest.approx(ttc_s)


@pytest.mark.parametrize(
    "other",
    [
        pytest.param((24.0, 2.1, 180.0, 10.0), id="oncoming on the next lane"),
        pytest.param((35.0, 0.0, 0.0, 0.0), id="3.1 s away"),
        pytest.param((10.0, 0.0, 0.0, 10.0), id="leader at the same speed"),
        pytest.param((6.0, -40.0, 90.0, 5.0), id="crosses after the vehicle has passed"),
    ],
)
def test_no_contact_within_the_horizon_is_none(other: Box) -> None:
    assert first_contact(0, boxes((0, 0, 0, 10), other)) is None


def test_the_first_of_several_contacts_counts_for_each_vehicle() -> None:
    """The eastward car meets the oncoming one (20 m at 20 m/s) before the standing one; the fourth is far away."""
    scene = boxes((0, 0, 0, 10), (34, 0, 0, 0), (24, 0, 180, 10), (0, 500, 0, 10))
    found = [first_contact(own, scene) for own in range(4)]
    assert [contact and (contact.other, round(contact.ttc_s, 9)) for contact in found] == [
        (2, 1.0),
        (0, 3.0),
        (0, 1.0),
        None,
    ]


def drive(track_id: str, steps: range, x_at_zero: float, speed: float) -> Track:
    """A car of 4 x 2 m along x at constant speed, present at the steps."""
    timesteps = np.array(steps, dtype=np.int64)
    position = np.column_stack([x_at_zero + 0.1 * speed * timesteps, np.zeros(len(timesteps))])
    velocity = np.tile([speed, 0.0], (len(timesteps), 1))
    return Track(track_id, "vehicle", 1, timesteps, position, np.zeros(len(timesteps)), velocity, BoxSize(4.0, 2.0))


@pytest.fixture
def rear_end() -> SceneArrays:
    """gen_0 ends at step 20 at x = 20, 10 m/s; "wall" stands at x = 34, "late" at x = 29 from step 21 on."""
    return stack(
        [
            drive("gen_0", range(21), 0.0, 10.0),
            drive("wall", range(110), 34.0, 0.0),
            drive("late", range(21, 110), 29.0, 0.0),
        ],
        step_s=0.1,
    )


def test_a_track_is_looked_at_from_its_own_last_step_among_those_present_then(rear_end: SceneArrays) -> None:
    """Step 20: front at 22, the wall's rear at 32: 1 s. "late" is not there yet; step 109 knows no gen_0."""
    found = ttc_after_last_step(rear_end, rear_end.generated, np.ones(rear_end.num_agents, dtype=bool))
    assert found == pytest.approx([1.0, np.inf, np.inf])


def test_others_can_be_kept_to_a_group(rear_end: SceneArrays) -> None:
    everybody = np.ones(rear_end.num_agents, dtype=bool)
    found = ttc_after_last_step(rear_end, everybody, rear_end.generated)
    assert np.isinf(found).all()


def test_contact_is_the_same_from_any_place_and_direction() -> None:
    scene = boxes((0, 0, 0, 10), (6, -5, 90, 5), (24, 0, 180, 10))
    first, second = (
        [contact and contact.ttc_s for own in range(3) for contact in [first_contact(own, each)]]
        for each in (scene, rotated(scene))
    )
    assert first == pytest.approx(second, abs=1e-6)


def rotated(scene: BoxesAtStep) -> BoxesAtStep:
    """Turned by 2 rad and moved by kilometres, as city frames are."""
    c, s = np.cos(2.0), np.sin(2.0)
    matrix = np.array([[c, s], [-s, c]])
    return BoxesAtStep(
        scene.position @ matrix + [4000.0, -3000.0], scene.heading + 2.0, scene.velocity @ matrix, scene.size
    )
