"""Argoverse 1 out: recorded lines text for text, inserted vehicles among them, and what validate says of it."""

import csv
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recordings import make_argoverse1
from written import made_up_sidecar, write_scene

from bridge.batch.validation import validate_folder
from bridge.recordings.argoverse1 import INSERTED, sequence_bytes, write_sequence
from bridge.recordings.export import new_scenario_id
from bridge.recordings.folders import sequence_path
from bridge.recordings.recording import Recording
from bridge.recordings.sidecar import (
    AgentRecord,
    PlacedRecord,
    RequestedRecord,
    SpawnRecord,
)
from bridge.recordings.sources import find_recordings, read_recording
from hid2.agents import BoxSize, Policy, Track
from hid2.params import Config
from netconvert.errors import ExportError
from netconvert.lane_graph import LaneSegment


@pytest.fixture(scope="session")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_argoverse1(tmp_path_factory.mktemp("sequences") / "made")


@pytest.fixture
def scenario(root: Path) -> Recording:
    return read_recording(find_recordings([root / "test_obs/data/4.csv"])[0])


def lonely_lane(scenario: Recording) -> LaneSegment:
    """The lane of 15 m and more that is farthest from every track."""
    places = np.concatenate([track.position for track in scenario.tracks])

    def apart_m(lane: LaneSegment) -> float:
        points = lane.path.point(np.linspace(0.0, lane.length_m, 20))
        return float(np.hypot(*(points[:, None] - places).T).min())

    return max((lane for lane in scenario.graph.lanes.values() if lane.length_m > 15.0), key=apart_m)


def inserted(scenario: Recording, number: int = 0) -> Track:
    """It drives along a lane at 5 m/s, far from everybody."""
    lane = lonely_lane(scenario)
    s = 1.0 + 0.5 * np.arange(20)
    heading = lane.path.heading(s)
    velocity = 5.0 * np.column_stack([np.cos(heading), np.sin(heading)])
    position = lane.path.point(s)
    return Track(f"gen_{number}", "vehicle", 1, np.arange(20), position, heading, velocity, BoxSize(4.0, 1.8))


@pytest.fixture
def written(scenario: Recording, tmp_path: Path) -> Iterator[Path]:
    """A scene with one inserted vehicle and its sequence; the folder that they are in."""
    config, track = Config(), inserted(scenario)
    lane = lonely_lane(scenario)
    agent = AgentRecord(
        track_id="gen_0", length_m=4.0, width_m=1.8, policy=Policy.STRAIGHT, route=(lane.lane_id,),
        spawn=SpawnRecord(lane_segment_id=lane.lane_id, cell=0, speed_mps=5.0),
    )  # fmt: skip
    sidecar = made_up_sidecar(
        scenario,
        config,
        requested=RequestedRecord(agents=1, behaviours={}),
        placed=PlacedRecord(agents=1, behaviours={Policy.STRAIGHT: 1}),
        agents=(agent,),
    )
    new_id = new_scenario_id(scenario.scenario_id, config, 0, 0)
    out = tmp_path / "out"
    write_scene(scenario, [track], sidecar, out, new_id=new_id, focal_track_id=scenario.focal_track_id)
    write_sequence(scenario, [track], out, new_id=new_id)
    return out


def the_file(out: Path) -> Path:
    (path,) = out.glob("argoverse1/test_obs/data/*.csv")
    return path


def test_recorded_lines_stay_text_for_text_and_inserted_ones_come_behind_their_time(scenario: Recording) -> None:
    assert scenario.sequence is not None
    source = scenario.sequence.decode().splitlines()
    track = inserted(scenario)
    assert scenario.sequence is not None
    lines = sequence_bytes(scenario.sequence, [(track.timesteps, track.position)]).decode().splitlines()
    mine = [line for line in lines if INSERTED in line]
    assert [line for line in lines if INSERTED not in line] == source
    assert len(mine) == 20
    assert {line.split(",")[2] for line in mine} == {"OTHERS"}
    stamps = [float(line.split(",")[0]) for line in lines[1:]]
    assert stamps == sorted(stamps)
    x, y = inserted(scenario).position[3]
    assert (float(mine[3].split(",")[3]), float(mine[3].split(",")[4])) == (x, y)


def test_the_files_number_is_that_of_the_scenes_id(tmp_path: Path) -> None:
    """48 bits: 0x0000000000ff is 255."""
    path = sequence_path(tmp_path, "val", "00000000-00ff-5000-8000-000000000000")
    assert path == tmp_path / "argoverse1" / "val" / "data" / "255.csv"
    assert sequence_path(tmp_path, "test", "0" * 36).parts[-3] == "test_obs"
    assert sequence_path(tmp_path, None, "0" * 36).parent == tmp_path / "argoverse1" / "data"


def test_what_is_no_sequence_is_not_written_as_one(scenario: Recording, tmp_path: Path) -> None:
    lacking = replace(scenario, sequence=None)
    with pytest.raises(ExportError, match="no Argoverse 1 sequence"):
        write_sequence(lacking, [], tmp_path, new_id="0" * 36)
    assert list(tmp_path.iterdir()) == []


def test_scene_and_sequence_are_valid_beside_their_source(written: Path, root: Path) -> None:
    assert validate_folder(written, source=root) == []


def test_the_loader_of_argoverse_1_would_read_it(written: Path) -> None:
    """As argoverse_forecasting_loader does: every file of the folder, int(stem), one AGENT with X and Y."""
    for path in the_file(written).parent.iterdir():
        assert int(path.stem) > 0
        rows = list(csv.DictReader(path.read_text().splitlines()))
        agent = np.array([(float(row["X"]), float(row["Y"])) for row in rows if row["OBJECT_TYPE"] == "AGENT"])
        assert agent.shape == (20, 2)


def _first(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new, 1)


@pytest.mark.parametrize(
    ("change", "rule", "said"),
    [
        (lambda text: text.replace(f"{INSERTED}{0:012d}", f"{INSERTED}{7:012d}"), "sequence", "line .* is not as"),
        (lambda text: _first(text, "AGENT", "OTHERS"), "sequence", "and .*expected one"),
        (lambda text: "\n".join(text.splitlines()[:-1]) + "\n", "sequence|source", "is not as|recorded line"),
        (lambda text: _first(text, ",MIA\n", ",PIT\n"), "sequence", "CITY_NAME"),
        (lambda text: _first(text, ".", ".0"), "source|sequence", "recorded line 2|time stamps"),
        (lambda text: "", "sequence", "columns"),
    ],
    ids=["renamed", "no-agent", "cut", "city", "one-digit", "empty"],
)
def test_a_sequence_that_was_changed_is_found(
    written: Path, root: Path, change: Callable[[str], str], rule: str, said: str
) -> None:
    path = the_file(written)
    path.write_text(change(path.read_text()))
    findings = validate_folder(written, source=root)
    assert findings
    assert all(finding.file == path for finding in findings)
    assert any(finding.rule in rule.split("|") for finding in findings)
    assert any(re.search(said, finding.message) for finding in findings)
