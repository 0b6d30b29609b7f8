"""What is exported on real and synthetic scenes, judged by the checker in tests/support, which shares no code with it.

The default run takes 10 vehicles and seeds 0 and 1; `pytest -m slow tests/real` runs
10 and 20 vehicles and seeds 0 to 9.
"""

import hashlib
import math
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scene_checker import check_scene, with_tracks
from second_claims import seen
from second_scene import read_scene as read_second

from bridge.generation.generate import generate, prepare
from bridge.generation.scene import TrafficScene
from bridge.recordings.scenario import Scenario, read_scenario
from hid2.agents import VEHICLE_TYPES, Policy, Track
from hid2.params import Config, Driving, Request
from hid2.reasons import Reason

Make = Callable[[Path, int, int], TrafficScene]

#: Reasons that a record, a rejection or a replacement may name: `hid2.reasons` and nothing else.
REASONS = {reason.value for reason in Reason}


@pytest.fixture(scope="module")
def make() -> Make:
    """make(folder, agents, seed): generated once for all tests of this file."""
    scenarios: dict[Path, Scenario] = {}
    scenes: dict[tuple[Path, int, int], TrafficScene] = {}

    def once(folder: Path, agents: int, seed: int) -> TrafficScene:
        key = (folder, agents, seed)
        if key not in scenes:
            if folder not in scenarios:
                scenarios[folder] = read_scenario(folder)
            config = Config(request=Request(agents=agents, seed=seed), driving=Driving(check_replay=True))
            scenes[key] = generate(scenarios[folder], config)
        return scenes[key]

    return once


def manoeuvres_seen(scene: TrafficScene) -> dict[str, set[str]]:
    """Kinds that the second checker sees in the scene as it is written, by track id of the generated vehicles."""
    with tempfile.TemporaryDirectory() as out:
        second = read_second(scene.write(Path(out)), scene.source.folder)
    return {track.track_id: seen(second, track) for track in second.inserted}


def disagreements(scene: TrafficScene) -> list[str]:
    """Records of manoeuvres that say done where the second checker sees none, or the other way round.

    An overtake with a way back that has crossed the line but not come to its end is neither.
    """
    found = []
    kinds_of = manoeuvres_seen(scene)
    for agent in scene.sidecar.agents:
        for record in agent.maneuvers:
            is_seen = agent.policy.value == record.kind and record.kind in kinds_of[agent.track_id]
            if record.reason != Reason.SCENE_ENDED_RETURNING and (record.status == "done") != is_seen:
                found.append(f"{agent.track_id} {record.kind} {record.status} {record.reason}, seen: {is_seen}")
    return found


@pytest.mark.parametrize("seed", [0, 1])
def test_ten_vehicles_in_a_real_scene_break_no_rule(real_scene: Path, seed: int, make: Make) -> None:
    assert check_scene(make(real_scene, 10, seed)) == []


@pytest.mark.parametrize("seed", [0, 1])
def test_ten_vehicles_in_a_synthetic_scene_break_no_rule(data_scene: Path, seed: int, make: Make) -> None:
    assert check_scene(make(data_scene, 10, seed)) == []


def test_vehicles_that_enter_a_real_scene_break_no_rule(real_scene: Path) -> None:
    """Whoever goes straight enters if it can; somebody does, but for the dense 00a0ec58: its edges are seldom free."""
    prepared = prepare(read_scenario(real_scene), Config())
    config = Config(request=Request(agents=10, entering=1.0))
    scenes = [generate(prepared, config, variant=variant) for variant in range(2)]
    assert [check_scene(scene) for scene in scenes] == [[], []]
    entered = [(agent, track) for one in scenes for agent, track in zip(one.sidecar.agents, one.generated, strict=True)
               if agent.spawn.timestep > 0]  # fmt: skip
    assert entered or real_scene.name.startswith("00a0ec58")
    assert all(agent.policy is Policy.STRAIGHT and track.category == 1 for agent, track in entered)


def test_vehicles_that_enter_a_synthetic_scene_break_no_rule(data_scene: Path) -> None:
    scene = generate(read_scenario(data_scene), Config(request=Request(agents=10, entering=1.0, seed=1)))
    assert check_scene(scene) == []
    assert any(track.timesteps[0] > 0 for track in scene.generated)
    assert len(scene.generated) == 10


def test_ten_asked_for_are_ten_placed_but_in_one_dense_scene(
    real_scenes: list[Path], data_scenes: dict[str, Path], make: Make
) -> None:
    """Nine scenes, two seeds: ten each, but in 00a0ec58, which is dense and small: five, as its followers come close.

    A scene with fewer than asked for says why.
    """
    placed: dict[str, int] = {}
    for folder in (*real_scenes, *data_scenes.values()):
        for seed in (0, 1):
            scene = make(folder, 10, seed)
            placed[f"{folder.name[:8]}, seed {seed}"] = len(scene.generated)
            assert scene.sidecar.placed.agents == len(scene.generated) <= 10
            assert len(scene.generated) == 10 or scene.sidecar.rejected, "fewer than asked for, and no reason"
    dense = {name: placed.pop(name) for name in list(placed) if name.startswith("00a0ec58")}
    assert min(dense.values()) >= 5, dense
    assert sum(placed.values()) >= 0.98 * 10 * len(placed), placed


@pytest.mark.parametrize("seed", [0, 1])
def test_records_of_manoeuvres_agree_with_what_is_seen(real_scene: Path, seed: int, make: Make) -> None:
    assert disagreements(make(real_scene, 10, seed)) == []


@pytest.mark.parametrize("seed", [0, 1])
def test_every_reason_is_one_of_the_list_and_every_request_has_its_record(
    real_scene: Path, seed: int, make: Make
) -> None:
    """What is asked for beside going straight is done, or has a record that says why not; so is who was replaced."""
    sidecar = make(real_scene, 10, seed).sidecar
    named = {record.reason for record in sidecar.rejected} | {one.reason for one in sidecar.replaced}
    named |= {one.detail for one in sidecar.replaced if one.detail is not None}
    for agent in sidecar.agents:
        for record in agent.maneuvers:
            named |= set((record.reason or "no_site").split(":"))
            assert record.status == "done" or record.reason is not None
    assert named <= REASONS
    assert all(agent.maneuvers for agent in sidecar.agents if agent.policy is not Policy.STRAIGHT)


@pytest.mark.parametrize("seed", [0, 1])
def test_algorithm_1_decides_at_every_step_of_every_vehicle(real_scene: Path, seed: int, make: Make) -> None:
    """Shares of the steps by policy add up to 1: nobody drives a step that was not decided.

    A vehicle that leaves the map is decided for until SUMO takes it out, up to half its length farther on.
    """
    scene = make(real_scene, 10, seed)
    for agent in scene.sidecar.agents:
        decided = sum(agent.policies.values())
        rounded = 1e-6 * len(agent.policies)
        assert decided == pytest.approx(1.0, abs=rounded) if agent.end_reason is None else decided >= 1.0 - rounded


def test_exported_way_is_the_simulated_one(real_scenes: list[Path], make: Make) -> None:
    """Exported s(t) within 0.3 m of SUMO's in the median vehicle, 0.8 m at the 95th percentile, 2 m in all."""
    off = [
        float(np.abs(vehicle.simulated_off_m).max())
        for folder in real_scenes
        for seed in (0, 1)
        for vehicle in make(folder, 10, seed).vehicles
    ]
    assert statistics.median(off) <= 0.3
    assert np.percentile(off, 95) <= 0.8
    assert max(off) <= 2.0


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(("agents", "least", "share"), [(10, 10, 0.95), (20, 18, 0.5)])
def test_many_seeds_and_densities_break_no_rule(
    agents: int, least: int, share: float, real_scenes: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """Seeds 0 to 9 of all scenes: 10 of 10 in 95 % of them, 18 of 20 in half; two small maps are full before that."""
    broken: list[str] = []
    placed: list[int] = []
    for folder in real_scenes:
        prepared = prepare(read_scenario(folder), Config())
        for seed in range(10):
            scene = generate(prepared, Config(request=Request(agents=agents, seed=seed)))
            placed.append(len(scene.generated))
            broken += [f"{folder.name[:8]}, seed {seed}: {sentence}" for sentence in check_scene(scene)]
    with capsys.disabled():
        print(f"\n{agents} asked for, placed {placed}, {len(broken)} violations")
    assert broken == []
    assert np.mean(np.array(placed) >= least) >= share


NOTHING = {"straight": 0.0, "left_turn": 0.0, "right_turn": 0.0, "lane_change": 0.0, "overtake": 0.0}


def _asked(folder: Path, mix: dict[str, float], seeds: range) -> tuple[int, int, list[str]]:
    """Vehicles asked for, those seen to do it, and records that disagree, with 10 vehicles of a mix."""
    prepared = prepare(read_scenario(folder), Config())
    (kind,) = (name for name in mix if name != "straight")
    asked, done, wrong = 0, 0, []
    for seed in seeds:
        scene = generate(prepared, Config(request=Request(agents=10, seed=seed, **{**NOTHING, **mix})))
        asked += round(10 * mix[kind])
        policies = {agent.track_id: agent.policy.value for agent in scene.sidecar.agents}
        done += sum(kind in kinds and policies[name] == kind for name, kinds in manoeuvres_seen(scene).items())
        wrong += [f"seed {seed}: {sentence}" for sentence in disagreements(scene)]
    return asked, done, wrong


def test_lane_changes_asked_for_are_seen_where_the_lanes_are_long(data_scenes: dict[str, Path]) -> None:
    """The arterial has three lanes of some hundred metres: of 20 asked for 80 % come about."""
    asked, done, wrong = _asked(data_scenes["arterial"], {"lane_change": 1.0}, range(2))
    assert wrong == []
    assert (asked, done >= 16) == (20, True), done


def test_arterial_shows_complete_overtakes(data_scenes: dict[str, Path]) -> None:
    """Of 15 asked for two thirds are seen out, past and back in 11 s; 46 of 60 were when this was written."""
    asked, done, wrong = _asked(data_scenes["arterial"], {"straight": 0.7, "overtake": 0.3}, range(5))
    assert wrong == []
    assert (asked, done >= 9) == (15, True), done


def _digests(out: Path) -> Iterator[tuple[str, str]]:
    for path in sorted(p for p in out.rglob("*") if p.is_file()):
        yield str(path.relative_to(out)), hashlib.sha256(path.read_bytes()).hexdigest()


_WRITE = """
import sys
from pathlib import Path
from bridge.generation.generate import generate
from bridge.recordings.scenario import read_scenario
from hid2.params import Config, Request
generate(read_scenario(Path(sys.argv[1])), Config(request=Request(agents=10, seed=3))).write(Path(sys.argv[2]))
"""


def test_same_request_in_two_processes_gives_the_same_bytes(real_scenes: list[Path], tmp_path: Path) -> None:
    """A process of its own each time, and another hash seed, so that no order of a set can hide in the result."""
    digests = []
    for turn in ("1", "2"):
        out = tmp_path / turn
        run = subprocess.run(
            [sys.executable, "-c", _WRITE, str(real_scenes[5]), str(out)],
            env={"PYTHONHASHSEED": turn, "PATH": "/usr/bin:/bin"}, capture_output=True, text=True,
        )  # fmt: skip
        assert run.returncode == 0, run.stderr
        digests.append(list(_digests(out)))
    assert len(digests[0]) == 3
    assert digests[0] == digests[1]


def test_second_scene_of_a_process_is_that_of_a_process_of_its_own(real_scenes: list[Path], make: Make) -> None:
    """Nothing of a scene is left behind for the next one: the same vehicles whatever was generated before."""
    first = make(real_scenes[1], 10, 0)
    generate(read_scenario(real_scenes[5]), Config(request=Request(agents=3)))
    config = Config(request=Request(agents=10, seed=0), driving=Driving(check_replay=True))
    again = generate(first.source, config)
    assert again.sidecar == first.sidecar
    for one, other in zip(first.generated, again.generated, strict=True):
        assert np.array_equal(one.position, other.position)


def test_checker_finds_what_is_wrong(data_scenes: dict[str, Path], make: Make) -> None:
    """The checker itself: vehicles moved aside, with a leap, turned round, or doubled are found out."""
    scene = make(data_scenes["curve"], 10, 0)
    left = [np.column_stack([-np.sin(t.heading), np.cos(t.heading)]) for t in scene.generated]
    aside = tuple(replace(t, position=t.position + 12.0 * n) for t, n in zip(scene.generated, left, strict=True))
    leap = tuple(replace(t, position=t.position + 0.5 * (t.timesteps[:, None] > 20)) for t in scene.generated)
    back = tuple(replace(t, heading=t.heading + math.pi) for t in scene.generated)
    assert any("off road" in sentence for sentence in check_scene(with_tracks(scene, aside)))
    assert any("limit" in sentence for sentence in check_scene(with_tracks(scene, leap)))
    assert any("against the lane" in sentence for sentence in check_scene(with_tracks(scene, back)))
    twice = replace(scene.generated[0], track_id="gen_1")
    double = with_tracks(scene, (scene.generated[0], twice, *scene.generated[2:]))
    assert any("overlap" in sentence for sentence in check_scene(double))


def test_checker_finds_a_late_start_inside_the_map(data_scenes: dict[str, Path], make: Make) -> None:
    """A vehicle whose first two seconds are cut off begins where no lane does, and not when its record says."""
    scene = make(data_scenes["arterial"], 10, 0)
    own = scene.generated[0]
    late = Track(
        "gen_0", own.object_type, 1, own.timesteps[20:], own.position[20:], own.heading[20:], own.velocity[20:],
        own.size,
    )  # fmt: skip
    found = check_scene(with_tracks(scene, (late, *scene.generated[1:])))
    assert [sentence for sentence in found if sentence.startswith("gen_0 begins at timestep 20 by its record at 0")]
    assert [sentence for sentence in found if sentence.endswith("m from where lanes begin")]


def _ahead_by(track: Track, metres: float, speed_mps: float) -> Track:
    """A track that much ahead of another all along, stated to drive at a speed of its own."""
    forward = np.column_stack([np.cos(track.heading), np.sin(track.heading)])
    return replace(
        track, track_id="gen_1", position=track.position + metres * forward, velocity=speed_mps * forward
    )  # fmt: skip


def test_checker_finds_a_contact_behind_the_last_step(data_scenes: dict[str, Path], make: Make) -> None:
    """One stands 5 m of bumper gap ahead of one that drives on at its speed v: met after 5 / v, if v is above 5 m/s.

    At the same speed nobody is met, though the two are as near.
    """
    scene = make(data_scenes["arterial"], 10, 0)
    fastest = max(scene.generated, key=lambda track: float(np.hypot(*track.velocity[-1])))
    own = replace(fastest, track_id="gen_0")
    speed = float(np.hypot(*own.velocity[-1]))
    assert speed > 6.0
    length = own.size.length_m
    sizes = [a.model_copy(update={"length_m": length, "width_m": 1.9}) for a in scene.sidecar.agents[:2]]
    sidecar = scene.sidecar.model_copy(update={"agents": tuple(sizes)})
    two = replace(scene, recording=replace(scene.recording, sidecar=sidecar))
    for ahead_mps, is_found in ((0.0, True), (speed, False)):
        other = _ahead_by(own, length + 5.0, ahead_mps)
        found = check_scene(with_tracks(two, (own, other)))
        assert any(sentence.startswith("after the end gen_0 meets vehicle gen_1") for sentence in found) is is_found


def test_checker_looks_at_the_sides_of_a_footprint(data_scenes: dict[str, Path], make: Make) -> None:
    """A hole of 2 m in the ground, right beside the middle of a car: no corner is over it, one side is by 0.4 m."""
    import shapely
    from scene_checker import Verdict, check_drivable, moving_boxes

    scene = make(data_scenes["arterial"], 10, 0)
    track = replace(
        scene.generated[0], timesteps=np.array([0]), position=np.zeros((1, 2)), heading=np.zeros(1),
        velocity=np.zeros((1, 2)),
    )  # fmt: skip
    ground = shapely.box(-20.0, -20.0, 20.0, 20.0) - shapely.box(-1.0, 0.1, 1.0, 20.0)
    verdict = Verdict()
    check_drivable(moving_boxes(track, 4.5, 1.0, 1), ground, verdict)
    assert verdict.found == ["off road gen_0 by 0.4 m at timestep 0.0"]


def test_recorded_vehicles_are_among_the_checked_ones(real_scenes: list[Path], make: Make) -> None:
    """A generated vehicle put onto a recorded one is an overlap: recorded boxes are not left out by mistake."""
    scene = make(real_scenes[1], 10, 0)
    victim = next(t for t in scene.source.tracks if t.object_type in VEHICLE_TYPES and len(t.timesteps) == 110)
    fake = replace(victim, track_id="gen_0")
    found = check_scene(with_tracks(scene, (fake, *scene.generated[1:])))
    assert any(sentence.startswith(f"overlap gen_0 {victim.track_id}") for sentence in found)
