"""A tracker's noise on inserted tracks: that of the scene's recorded vehicles, as far as it leaves all others clear."""

from dataclasses import replace

import numpy as np
import pytest
from hand_drawn import draw_road
from inserted import recorded, scene_on
from scipy.signal import savgol_filter

from hid2.agents import Track
from hid2.insertion.tracker_noise import TrackerErrors, tracker_errors, with_noise
from hid2.judge.findings import NOISE_BOUNDS, Bounds
from hid2.judge.states import of_end
from hid2.occupancy.agent_states import agent_states
from hid2.scene import Scene

T = 0.1 * np.arange(110)


def _moving(track_id: str, speed: float = 10.0, *, y: float = 0.0, x: float = 20.0) -> Track:
    """A car along x."""
    return recorded(x, y, speed, name=track_id)


def _smoothed(track: Track) -> Track:
    """As Argoverse 2 smooths positions: 19 steps, degree 2, the ends repeated."""
    return replace(track, position=savgol_filter(track.position, 19, 2, axis=0, mode="nearest"))


def _tracked(track: Track, *, faster: float = 0.0, turned: float = 0.0) -> Track:
    """With a stated speed that is off by `faster` m/s, as a sine of 2 s, and a heading that is off by `turned` rad."""
    wave = np.sin(np.pi * T)
    velocity = track.velocity * (1.0 + faster * wave / 10.0)[:, None]
    return replace(track, velocity=velocity, heading=track.heading + turned)


def scene_of(*tracks: Track) -> Scene:
    """Two lanes of 300 m."""
    return scene_on(draw_road(length_m=300.0), *tracks)


def _noise(scene: Scene, *tracks: Track, seed: int = 0) -> list[Track]:
    return with_noise(scene, tracks, [track.heading for track in tracks], [seed, 0])


def test_smoothed_positions_are_told_by_their_first_step() -> None:
    """A filter of 19 steps and degree 2 makes .56 of a constant speed at the first step; plain positions all of it."""
    plain = _moving("1")
    assert not tracker_errors([plain], step_s=0.1).is_smoothed
    assert tracker_errors([_smoothed(plain)], step_s=0.1).is_smoothed


def test_errors_are_those_of_recorded_vehicles_that_were_tracked_throughout() -> None:
    """A sine of .5 m/s has a deviation of .354, .02 rad at 10 m/s are .2 m/s to the side.

    The recording vehicle, fragments, lost tracks and those that a tracker turns round tell none.
    """
    one = _tracked(_moving("1"), faster=0.5, turned=0.02)
    (errors,) = tracker_errors([one], step_s=0.1).of_vehicles
    assert errors[1].std() == pytest.approx(0.354, abs=0.02)
    assert errors[2] == pytest.approx(np.full(errors.shape[1], 0.2), abs=1e-5)
    assert np.abs(errors[0]).max() == pytest.approx(0.0, abs=1e-6)
    kept = np.arange(110) != 50
    lost = replace(one, timesteps=one.timesteps[kept], position=one.position[kept], heading=one.heading[kept],
                   velocity=one.velocity[kept])  # fmt: skip
    others = [replace(one, track_id="AV"), replace(one, category=0), replace(one, object_type="pedestrian"), lost]
    others.append(replace(_moving("1"), heading=np.full(110, 1.9)))
    assert tracker_errors(others, step_s=0.1).of_vehicles == ()


def test_inserted_vehicle_begins_slowly_and_states_its_speed_as_recorded_ones_do() -> None:
    """The stated speed stays at 8 m/s, positions make .56 of it at first; far from the ends they are the clean ones."""
    scene = scene_of(_smoothed(_moving("1", y=3.5)), _smoothed(_moving("2", y=3.5, x=60.0)))
    clean = _moving("gen_0", 8.0, x=20.0)
    (noisy,) = _noise(scene, clean)
    steps = np.hypot(*np.diff(noisy.position, axis=0).T) / 0.1
    assert steps[0] == pytest.approx(0.559 * 8.0, abs=0.05)
    assert noisy.position[20:-20] == pytest.approx(clean.position[20:-20], abs=0.02)
    assert np.hypot(*noisy.velocity.T) == pytest.approx(8.0, abs=0.05)


def test_errors_are_as_large_as_recorded_ones_and_none_at_a_standstill() -> None:
    """.02 rad at 10 m/s are .2 m/s to the side, which turn a vehicle of 8 m/s by .025 rad."""
    scene = scene_of(_tracked(_moving("1", y=3.5), faster=0.5, turned=0.02))
    drives, stands = _moving("gen_0", 8.0), _moving("gen_1", 0.0, x=250.0)
    noisy, standing = _noise(scene, drives, stands)
    assert (np.hypot(*noisy.velocity.T) - 8.0).std() == pytest.approx(0.354, abs=0.05)
    assert np.abs(noisy.heading) == pytest.approx(np.full(110, 0.2 / 8.0), abs=1e-6)
    assert standing.position == pytest.approx(stands.position, abs=1e-9)
    assert np.abs(standing.velocity).max() == 0.0


def test_what_is_stated_follows_motion_late_and_never_early() -> None:
    """It weaves, and brakes 1 m/s2: headings are half a second late, velocities' directions a tenth more.

    The speed that it states was driven a quarter of a second before: it is .25 m/s too high.
    """
    scene = scene_of(_moving("1", y=3.5))
    speed, heading = 12.0 - T, 0.03 * np.sin(0.5 * np.pi * T)
    velocity = speed[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
    clean = replace(_moving("gen_0"), velocity=velocity, heading=heading, position=np.cumsum(0.1 * velocity, axis=0))
    (noisy,) = _noise(scene, clean)
    assert noisy.heading[5:] == pytest.approx(heading[:-5], abs=1e-6)
    assert np.arctan2(*noisy.velocity.T[::-1])[6:] == pytest.approx(heading[:-6], abs=1e-6)
    assert np.hypot(*noisy.velocity.T)[6:] == pytest.approx(speed[6:] + 0.25, abs=1e-6)


def test_errors_of_a_recorded_vehicle_run_on_as_recorded() -> None:
    """A saw that rises slowly and falls at once, four times in 8 s, is drawn so or mirrored, not backwards."""
    saw = np.tile(np.linspace(-1.0, 1.0, 20), (4, 4))
    errors = TrackerErrors(is_smoothed=False, of_vehicles=(saw,))
    for seed in range(6):
        steps = np.diff(errors.drawn(np.random.default_rng(seed), 160)[1])
        assert min((steps > 0.0).sum(), (steps < 0.0).sum()) <= 8, seed


def test_noise_is_cut_where_boxes_would_touch_and_stays_within_its_bounds() -> None:
    """One stands 1.9 m beside another's path: a heading off by .02 rad would turn a corner of 2.25 m into it."""
    loud = _tracked(_moving("1", y=3.5), faster=9.0, turned=0.3)
    beside = recorded(60.0, -1.92, name="2")
    clean = _moving("gen_0", 8.0)
    (free,) = _noise(scene_of(loud), clean)
    (held,) = _noise(scene_of(loud, beside), clean)
    assert np.abs(held.heading).max() < np.abs(free.heading).max() <= NOISE_BOUNDS.heading_rad + 1e-9
    assert np.hypot(*(free.velocity - clean.velocity).T).max() <= NOISE_BOUNDS.velocity_mps + 1e-9


def test_noise_depends_on_seed_and_vehicle_alone() -> None:
    scene = scene_of(_tracked(_moving("1", y=3.5), faster=0.5), _tracked(_moving("2", y=3.5, x=60.0), turned=0.02))
    clean = _moving("gen_0", 8.0)
    first, again, other = _noise(scene, clean)[0], _noise(scene, clean)[0], _noise(scene, clean, seed=1)[0]
    assert (first.velocity == again.velocity).all()
    assert (first.velocity != other.velocity).any()


def test_no_vehicle_ends_with_a_contact_by_the_noise_of_one_ahead() -> None:
    """Both drive 10 m/s, 10 m apart. Ends the leader at a stated 3.5 m/s, its follower meets it though it brakes.

    Within 1.54 s, of which it reacts for 1; then 3.5 m are left, and 3 m/s2 take 6.5^2 / 6 = 7 m.
    """
    loud = _tracked(_moving("1", y=3.5), faster=6.4)
    scene = scene_of(loud)
    follower, leader = _moving("gen_0"), _moving("gen_1", x=34.5)
    for seed in range(6):
        noisy = _noise(scene, follower, leader, seed=seed)
        states = agent_states(noisy, scene.states.lanes, num_steps=110, step_s=0.1, is_inserted=lambda _: True)
        assert not [*of_end(states, 0, np.array([1]), Bounds()), *of_end(states, 1, np.array([0]), Bounds())], seed
