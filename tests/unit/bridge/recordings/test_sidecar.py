"""The sidecar: round trip, and what is said about files that are no sidecar."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from written import edit_json, fake_generated

from bridge.recordings.scenario import read_scenario
from bridge.recordings.sidecar import read_sidecar, sidecar_bytes, sidecar_path
from netconvert.errors import ScenarioError


def test_sidecar_and_back(tmp_path: Path, data_scenes: dict[str, Path]) -> None:
    _, sidecar, _ = fake_generated(read_scenario(data_scenes["arterial"]))
    path = sidecar_path(tmp_path, "x")
    path.write_bytes(sidecar_bytes(sidecar))
    assert path.name == "hid2_x.json"
    assert read_sidecar(path) == sidecar


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d.pop("seed"), "seed: Field required"),
        (lambda d: d.update(speed=1), "speed: Extra inputs are not permitted"),
        (lambda d: d["agents"][0].update(policy="to fly"), "agents.0.policy: .*'to fly'"),
        (lambda d: d["agents"][0]["maneuvers"][0].update(status="maybe"), "agents.0.maneuvers.0.status: .*'maybe'"),
        (lambda d: d.update(schema_version="3", later=1), r"schema_version: .* '2' \(got '3'\); of another"),
        (lambda d: d["generator"].update(code_sha256="abc"), "generator.code_sha256"),
        (lambda d: d["generator"].update(libraries={"numpy": "2\x1b[2J"}), "generator.libraries.numpy"),
        (lambda d: d.update(sumo_version="1" * 101), "sumo_version: .*at most 100"),
        (lambda d: d["agents"][0].update(length_m=0), "agents.0.length_m: .*greater than 0"),
    ],
)
def test_a_field_that_is_wrong_is_named(
    tmp_path: Path, data_scenes: dict[str, Path], change: Callable[[dict[str, Any]], Any], said: str
) -> None:
    _, sidecar, _ = fake_generated(read_scenario(data_scenes["arterial"]))
    path = sidecar_path(tmp_path, "x")
    path.write_bytes(sidecar_bytes(sidecar))
    edit_json(path, change)
    with pytest.raises(ScenarioError, match=said) as caught:
        read_sidecar(path)
    assert "hid2_x.json" in str(caught.value)
