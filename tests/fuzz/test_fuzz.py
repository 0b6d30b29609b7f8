"""Damaged scenes, bundles and manifests: each is read, or refused in one line; what is written of it is valid.

Some hundreds here, without SUMO; thousands by hand, generated and judged: tests/support/fuzz.py.
"""

import random
import shutil
import time
from pathlib import Path

import pytest
from fuzz import damaged
from mutations import mutate_bytes, mutate_scene
from written import made_up_sidecar, write_scene

from bridge.batch.isolation import Failure
from bridge.batch.manifest import QUARANTINED, Manifest, ManifestRow, read_manifest
from bridge.batch.quarantine import Bundle, read_bundle, write_bundle
from bridge.batch.validation import validate_folder
from bridge.recordings.export import new_scenario_id
from bridge.recordings.scenario import Scenario, read_scenario
from hid2.params import Config
from netconvert.errors import BatchError, Hid2Error

SCENES, SEEDS_A_TEST = 240, 40
#: Longest that reading a damaged scene may take, s; it takes 0.05 on an idle machine.
READ_S = 10.0


def written(scenario: Scenario, out: Path) -> Path:
    """The scene as generate writes it, with nobody inserted."""
    config = Config()
    sidecar = made_up_sidecar(scenario, config)
    new_id = new_scenario_id(scenario.scenario_id, config, config.request.seed, 0)
    return write_scene(scenario, [], sidecar, out, new_id=new_id, focal_track_id=scenario.focal_track_id)


@pytest.mark.parametrize("first", range(0, SCENES, SEEDS_A_TEST))
def test_damaged_scene_is_refused_in_one_line_or_written_and_valid(
    data_scenes: dict[str, Path], tmp_path: Path, first: int
) -> None:
    """Bit for bit: validate compares the recorded rows with those of the damaged source."""
    for seed in range(first, first + SEEDS_A_TEST):
        folder, said = damaged(sorted(data_scenes.values()), seed, tmp_path / "source")
        began = time.process_time()
        scenario, message = None, ""
        try:
            scenario = read_scenario(folder)
        except Hid2Error as error:
            message = str(error)
        except Exception as error:
            raise AssertionError(f"seed {seed} ({said}): {type(error).__name__}: {error}") from error
        assert time.process_time() - began < READ_S, f"seed {seed} ({said})"
        assert "\n" not in message, f"seed {seed} ({said})"
        assert len(message) < 1500, f"seed {seed} ({said})"
        if scenario is not None:
            out = tmp_path / f"out-{seed}"
            written(scenario, out)
            findings = [finding for finding in validate_folder(out, source=folder) if not finding.is_note]
            assert findings == [], f"seed {seed} ({said})"


def test_damaged_output_is_judged_and_not_stumbled_over(data_scenes: dict[str, Path], tmp_path: Path) -> None:
    """validate reads what others made."""
    folder = written(read_scenario(data_scenes["curve"]), tmp_path / "whole")
    found = 0
    for seed in range(60):
        copy = tmp_path / str(seed) / folder.name
        shutil.copytree(folder, copy)
        said = mutate_scene(copy, seed)
        try:
            findings = validate_folder(copy.parent)
        except Exception as error:
            raise AssertionError(f"seed {seed} ({said}): {type(error).__name__}: {error}") from error
        found += bool(findings)
    assert found > 30


def test_damaged_bundle_is_refused_in_one_line_or_read(data_scenes: dict[str, Path], tmp_path: Path) -> None:
    failure = Failure("error", "reason", "details")
    values = {"config": Config(), "variant": 0, "timeout_s": 5.0, "failure": failure, "version": "1"}
    function = "bridge.batch.scene_work:generate_runs"
    write_bundle(Bundle(folder=data_scenes["curve"], function=function, **values), tmp_path / "b.zip")
    raw = (tmp_path / "b.zip").read_bytes()
    refused = 0
    for seed in range(200):
        path, into = tmp_path / f"{seed}.zip", tmp_path / f"into-{seed}"
        path.write_bytes(mutate_bytes(raw, random.Random(seed)))
        message = ""
        try:
            assert read_bundle(path, into).folder.is_relative_to(into)
        except BatchError as error:
            message = str(error)
        except Exception as error:
            raise AssertionError(f"seed {seed}: {type(error).__name__}: {error}") from error
        assert "\n" not in message
        refused += bool(message)
        shutil.rmtree(into, ignore_errors=True)
    assert refused > 50


def test_damaged_manifest_gives_rows_that_were_written_and_no_others(tmp_path: Path) -> None:
    manifest = Manifest(tmp_path)
    for number in range(10):
        manifest.add(
            ManifestRow(f"s{number}", "val", 0, 0, QUARANTINED, reason='a, "b"', config_sha256="0" * 64, version="1")
        )
    raw, whole = manifest.path.read_bytes(), set(manifest.rows)
    lost = 0
    for seed in range(400):
        manifest.path.write_bytes(mutate_bytes(raw, random.Random(seed)))
        rows, unread = read_manifest(manifest.path)
        assert set(rows) <= whole, f"seed {seed}"
        lost += unread
    assert lost > 100
