"""Damaged files of every kind: each is read, or refused with an error that says why; what is written of it is valid."""

import random
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from baseline_file import write_baseline
from mutations import damage, mutate_bytes, mutate_scene
from recordings import LOG_ID, make_argoverse1, make_log
from written import copy_with_new_id, fake_generated, made_up_sidecar, write_scene

from bridge.batch.isolation import Failure
from bridge.batch.manifest import QUARANTINED, Manifest, ManifestRow, read_manifest
from bridge.batch.quarantine import Bundle, read_bundle, write_bundle
from bridge.batch.validation import validate_folder
from bridge.config import load_config, new_scenario_id
from bridge.forecasting.composition import Composition
from bridge.forecasting.predictions import score_predictions
from bridge.generation.generate import generate
from bridge.recordings.folders import Choices
from bridge.recordings.recording import Recording
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sidecar import read_sidecar
from bridge.recordings.sources import find_recordings, read_recording
from bridge.studies.study import read_study
from bridge.toml import read_toml_as
from hid2.params import Config, Request
from netconvert.errors import Hid2Error

#: Longest that reading a damaged file may take, s of processor time; it takes 0.05 on an idle machine.
READ_S = 10.0
SCENES, SEEDS_A_TEST, SEEDS = 240, 40, 40


def refused(read: Callable[[], object], what: str) -> bool:
    """Whether an error says what is wrong; it must be one that the command puts on a line, and come soon."""
    began, message = time.process_time(), ""
    try:
        with np.errstate(over="ignore"):  # of 1e308 on its way to the check that refuses it
            read()
    except Hid2Error as error:
        message = str(error)
        assert message, what
    except Exception as error:
        raise AssertionError(f"{what}: {type(error).__name__}: {error}") from error
    assert time.process_time() - began < READ_S, what
    return bool(message)


def written(scenario: Recording, out: Path) -> Path:
    """The scene as generate writes it, with nobody inserted."""
    config = Config()
    sidecar = made_up_sidecar(scenario, config)
    new_id = new_scenario_id(scenario.scenario_id, config, config.request.seed, 0)
    return write_scene(scenario, [], sidecar, out, new_id=new_id, focal_track_id=scenario.focal_track_id)


def damaged(scenes: dict[str, Path], seed: int, root: Path) -> tuple[Path, str]:
    """A copy of one of the scenes with an id of its own, damaged by its seed; and how."""
    source = sorted(scenes.values())[seed % len(scenes)]
    folder = copy_with_new_id(source, root / f"seed-{seed}", f"{seed:08d}-0000-4000-8000-000000000000")
    return folder, f"seed {seed} ({mutate_scene(folder, seed)})"


@pytest.mark.parametrize(
    "first", [0, 40, *(pytest.param(first, marks=pytest.mark.slow) for first in range(80, SCENES, SEEDS_A_TEST))]
)
def test_damaged_scene_is_refused_or_written_and_valid(
    data_scenes: dict[str, Path], tmp_path: Path, first: int
) -> None:
    """Bit for bit: validate compares the recorded rows with those of the damaged source."""
    for seed in range(first, first + SEEDS_A_TEST):
        folder, said = damaged(data_scenes, seed, tmp_path)
        if not refused(lambda folder=folder: read_scenario(folder), said):
            written(read_scenario(folder), tmp_path / f"out-{seed}")
            findings = validate_folder(tmp_path / f"out-{seed}", source=folder)
            assert [finding for finding in findings if not finding.is_note] == [], said


@pytest.mark.slow
def test_scene_generated_from_a_damaged_one_is_refused_or_valid(data_scenes: dict[str, Path], tmp_path: Path) -> None:
    config = Config(request=Request(agents=3))
    for seed in range(1000):
        folder, said = damaged(data_scenes, seed, tmp_path)
        out = tmp_path / f"out-{seed}"
        if not refused(lambda folder=folder, out=out: generate(read_scenario(folder), config).write(out), said):
            findings = validate_folder(out, source=folder)
            assert [finding for finding in findings if not finding.is_note] == [], said


def test_damaged_output_is_judged_and_not_stumbled_over(data_scenes: dict[str, Path], tmp_path: Path) -> None:
    """validate reads what others made."""
    folder = written(read_scenario(data_scenes["curve"]), tmp_path / "whole")
    found = 0
    for seed in range(30):
        copy = shutil.copytree(folder, tmp_path / str(seed) / folder.name)
        said = mutate_scene(copy, seed)
        try:
            found += bool(validate_folder(copy.parent))
        except Exception as error:
            raise AssertionError(f"seed {seed} ({said}): {type(error).__name__}: {error}") from error
    assert found > 15


def test_damaged_bundle_is_refused_or_read(data_scenes: dict[str, Path], tmp_path: Path) -> None:
    failure = Failure("error", "reason", "details")
    values = {"config": Config(), "variant": 0, "timeout_s": 5.0, "failure": failure, "version": "1"}
    function = "bridge.batch.scene_work:generate_runs"
    write_bundle(Bundle(folder=data_scenes["curve"], function=function, **values), tmp_path / "b.zip")
    raw = (tmp_path / "b.zip").read_bytes()

    def read(path: Path) -> None:
        assert read_bundle(path, path.with_suffix("")).folder.is_relative_to(path.with_suffix(""))

    count = 0
    for seed in range(100):
        path = tmp_path / f"{seed}.zip"
        path.write_bytes(mutate_bytes(raw, random.Random(seed)))
        count += refused(lambda path=path: read(path), f"seed {seed}")
    assert count > 25


def test_damaged_manifest_gives_rows_that_were_written_and_no_others(tmp_path: Path) -> None:
    manifest = Manifest(tmp_path)
    for number in range(10):
        manifest.add(
            ManifestRow(f"s{number}", "val", 0, 0, QUARANTINED, reason='a, "b"', config_sha256="0" * 64, version="1")
        )
    raw, whole = manifest.path.read_bytes(), set(manifest.rows)
    lost = 0
    for seed in range(200):
        manifest.path.write_bytes(mutate_bytes(raw, random.Random(seed)))
        rows, unread = read_manifest(manifest.path)
        assert set(rows) <= whole, f"seed {seed}"
        lost += unread
    assert lost > 50


CONFIG = """[request]
agents = 8
lane_change = 0.4
trigger_min_s = 1.0
focal = "generated"
[drivers]
tau_mean_s = 1.2
[[event]]
kind = "cut_in"
target = "av"
at_s = [5.0, 7.0]
gap_m = [6.0, 10.0]
count = 2
"""
STUDY = """scenes = ["{scene}"]
seeds = 2
kind = "lane_change"
[vary]
trigger_s = [1.0, 3.0]
"lane_change.give_up_s" = [5.0, 10.0]
[config.request]
agents = 4
"""
COMPOSITION = """layout = "av2"
seed = 1
[sources]
a = "{scene}"
[split]
val = 0.25
test = 0.25
[sets.all.take]
a = "all"
[validation.all.take]
a = 1
"""
#: Of each kind of file how it is read.
READERS: dict[str, Callable[[Path], object]] = {
    "config.toml": load_config,
    "study.toml": read_study,
    "composition.toml": lambda path: read_toml_as(Composition, path, "a composition"),
    "forecasts.parquet": lambda path: score_predictions(path.parent / "av2", predictions=path),
    "hid2_x.json": read_sidecar,
    "av1": lambda root: [read_recording(one) for one in find_recordings([root / "val/data/7.csv"], Choices())],
    "log": lambda root: [read_recording(one) for one in find_recordings([root / LOG_ID], Choices(stride=10))],
}


@pytest.fixture
def sound(request: pytest.FixtureRequest, data_root: Path, data_scenes: dict[str, Path], tmp_path: Path) -> Path:
    """A sound file of a kind, or a folder: one sequence on the map of its city, one log."""
    name, scene = request.param, data_scenes["curve"]
    path = tmp_path / name
    if name == "av1":
        made = make_argoverse1(tmp_path / "made")
        (path / "val" / "data").mkdir(parents=True)
        shutil.copyfile(made / "val/data/7.csv", path / "val/data/7.csv")
        shutil.copytree(made / "map_files", path / "map_files", ignore=shutil.ignore_patterns("*MIA*"))
    elif name == "log":
        make_log(scene, path, sweeps=112)
    elif name == "forecasts.parquet":
        (tmp_path / "av2").symlink_to(data_root)
        write_baseline(data_root, path, kind="constant-velocity")
    elif name == "hid2_x.json":
        _, sidecar, _ = fake_generated(read_scenario(scene))
        path.write_text(sidecar.model_dump_json(indent=1))
    else:
        text = {"config.toml": CONFIG, "study.toml": STUDY, "composition.toml": COMPOSITION}[name]
        path.write_text(text.format(scene=scene))
    return path


@pytest.mark.parametrize("sound", READERS, indirect=True)
def test_damaged_file_is_refused_or_read(sound: Path) -> None:
    read = READERS[sound.name]
    assert not refused(lambda: read(sound), "the sound file is read")
    files = {path: path.read_bytes() for path in sorted(sound.rglob("*.*") if sound.is_dir() else [sound])}
    count = 0
    for seed in range(SEEDS):
        rng = random.Random(seed)
        path = rng.choice(list(files))
        said = f"seed {seed} ({path.name}: {damage(path, rng)})"
        count += refused(lambda: read(sound), said)
        path.write_bytes(files[path])
    assert SEEDS > count > SEEDS // 4
