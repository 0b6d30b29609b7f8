"""Validation: a good data set has no findings; each way to spoil one is found under its rule."""

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from breaches import breaches
from written import edit_json, edit_rows, in_cell, in_first_lane, write_fake

from bridge.batch.validation import validate_folder
from bridge.config import load_config
from bridge.generation.generate import generate
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sources import find_scenarios
from hid2.judge.findings import Quantity
from netconvert.errors import ConfigError, ScenarioError

#: The page that says what each rule demands.
PAGE = Path(__file__).parents[4] / "bridge" / "recordings" / "README.md"
Change = Callable[[pd.DataFrame], pd.DataFrame]


@pytest.fixture
def written(tmp_path: Path, data_scenes: dict[str, Path]) -> Path:
    """A valid generated scene: the arterial and two made-up vehicles."""
    return write_fake(read_scenario(data_scenes["arterial"]), tmp_path / "out")


def rules(folder: Path, **arguments: Any) -> set[str]:
    findings = breaches(folder.parents[1], **arguments)
    first_cells = [row.split("|")[1] for row in PAGE.read_text().splitlines() if row.startswith("| `")]
    known = {name for cell in first_cells for name in re.findall(r"`([a-z-]+)`", cell)}
    assert {finding.rule for finding in findings} <= {*known, *Quantity}
    assert all(finding.message and finding.file.is_relative_to(folder.parents[1]) for finding in findings)
    return {finding.rule for finding in findings}


def test_a_good_data_set_has_no_findings(written: Path, data_root: Path) -> None:
    assert breaches(written.parents[1], source=data_root) == []
    assert breaches(written.parent, source=data_root / "train") == []
    assert breaches(written) == []


def test_a_scored_and_focal_generated_track_is_valid(
    tmp_path: Path, data_scenes: dict[str, Path], data_root: Path
) -> None:
    write_fake(read_scenario(data_scenes["curve"]), tmp_path, category=2, focal="gen_0")
    assert breaches(tmp_path, source=data_root) == []


def test_fifty_steps_and_a_single_agent_are_valid(tmp_path: Path, copy_scene: Callable[..., Path]) -> None:
    source, alone = copy_scene(), {"object_category": 3, "focal_track_id": "AV"}
    edit_rows(source, lambda rows: rows[(rows.track_id == "AV") & (rows.timestep < 50)].assign(**alone))
    write_fake(read_scenario(source), tmp_path / "out")
    assert breaches(tmp_path / "out", source=source) == []


def _track(track_id: str, column: str, value: Any) -> Change:
    def change(rows: pd.DataFrame) -> pd.DataFrame:
        rows.loc[rows.track_id == track_id, column] = value
        return rows

    return change


def _without(track_id: str, *steps: int) -> Change:
    return lambda rows: rows[(rows.track_id != track_id) | ~rows.timestep.isin(steps)]


FOCAL, SCORED = "310100", "310107"


@pytest.mark.parametrize(("change", "rule"), [
    (_without(FOCAL, *range(100, 110)), "recorded"),
    (lambda rows: _without("gen_1", 49)(_track("gen_1", "object_category", 2)(rows)), "scored"),
    (lambda rows: rows.assign(city="atlantis"), "recorded"),
    (lambda rows: rows.assign(city="a\nb"), "city"),
    (_track("AV", "object_type", "spaceship"), "object-type"),
    (lambda rows: rows.assign(scenario_id="other"), "scenario-id"),
    (in_cell("AV", 3, "heading", np.inf), "finite"),
    (in_cell("gen_1", 60, "position_x", 1e8), "columns"),  # no judge ever comes there
    (_track("gen_1", "track_id", "gen_x"), "generated"),
    (_track("gen_1", "object_type", "pedestrian"), "generated"),
    (_track("gen_1", "object_category", 0), "generated"),
    (_without("gen_1", 30), "generated"),
    (_without("gen_1", *range(49, 110)), "generated"),
    (lambda rows: _without("gen_1", 109)(_track("gen_1", "object_category", 2)(rows)), "generated"),
    (_track("gen_1", "velocity_x", 3.0), "velocity"),
    (in_cell("gen_1", 60, "position_x", 0.0), "velocity"),
    (in_cell("gen_1", 60, "heading", 4.0), "heading"),
    (lambda rows: rows.assign(heading=rows.heading - 0.3 * (rows.track_id == "gen_1")), "heading"),
    (_without("gen_1", *range(110)), "sidecar"),
    (lambda rows: _without("gen_1", 0)(_track("gen_1", "object_category", 2)(rows)), "generated"),
])  # fmt: skip
def test_a_spoiled_row_is_found(written: Path, change: Change, rule: str) -> None:
    """The first few stand for the rules of rows, which readers ask, too: all of them are in test_scenario.py."""
    edit_rows(written, change)
    assert rule in rules(written)


def test_an_index_that_is_no_range_from_zero_is_found(written: Path) -> None:
    (path,) = written.glob("scenario_*.parquet")
    rows = pd.read_parquet(path)
    rows.index = rows.index[::-1]
    rows.to_parquet(path)
    assert "columns" in rules(written)
    table = pq.read_table(path)
    pq.write_table(table.replace_schema_metadata({b"pandas": b"{"}), path)
    assert "columns" in rules(written)


def test_any_other_parquet_is_found(written: Path) -> None:
    extra = written.parent / ".left" / "over"
    extra.mkdir(parents=True)
    for path in (written.parents[1] / "x.parquet", extra / "y.parquet", written / "scenario_2.parquet"):
        path.write_bytes(b"")
    found = [finding.file.name for finding in validate_folder(written.parents[1]) if finding.rule == "other-parquet"]
    assert sorted(found) == ["scenario_2.parquet", "x.parquet", "y.parquet"]


@pytest.mark.parametrize("pattern", ["scenario_*.parquet", "log_map_archive_*.json"])
def test_a_missing_file_is_found(written: Path, pattern: str) -> None:
    next(written.glob(pattern)).unlink()
    assert "folder" in rules(written)


def test_a_recorded_scene_is_told_from_a_generated_one(data_scenes: dict[str, Path], written: Path) -> None:
    """No generated track is in it, so that it needs no sidecar; a generated scene that has lost its own is named."""
    assert breaches(data_scenes["curve"]) == []
    next(written.glob("hid2_*.json")).unlink()
    messages = [finding.message for finding in validate_folder(written) if finding.rule == "folder"]
    assert messages == ["no such file, which every generated scene has (a recorded one has none)"]


def test_a_renamed_folder_or_split_is_found(written: Path) -> None:
    renamed = written.rename(written.with_name("renamed"))
    assert {"folder", "other-parquet"} <= rules(renamed)
    shutil.move(renamed, written)
    split = written.parent.rename(written.parents[1] / "training")
    assert rules(split / written.name) == {"folder"}


@pytest.mark.parametrize(("change", "rule"), [
    (lambda document: document.pop("drivable_areas"), "map"),
    (in_first_lane(lambda lane: lane["left_lane_boundary"][1].update(y=float("nan"))), "map"),
    (in_first_lane(lambda lane: lane.update(right_lane_mark_type="CHALK")), "mark-type"),
    (in_first_lane(lambda lane: lane.update(lane_type="TRAM")), "lane-type"),
    (in_first_lane(lambda lane: lane.update(right_lane_boundary=lane["right_lane_boundary"][:1])), "boundary"),
    (in_first_lane(lambda lane: lane.pop("centerline")), "boundary"),
])  # fmt: skip
def test_a_spoiled_map_is_found(written: Path, change: Callable[[dict[str, Any]], Any], rule: str) -> None:
    edit_json(next(written.glob("log_map_archive_*.json")), change)
    assert rule in rules(written)


@pytest.mark.parametrize(("pattern", "said"), [("log_map*", "map: not JSON"), ("*.parquet", "columns: not a parquet")])
def test_a_file_that_cannot_be_read_is_found_and_named_once(written: Path, pattern: str, said: str) -> None:
    (path,) = written.glob(pattern)
    path.write_bytes(b"{")
    (found,) = breaches(written.parents[1])
    assert found.line().startswith(f"{path}: {said}")


def _agent(change: Callable[[dict[str, Any]], Any]) -> Callable[[dict[str, Any]], Any]:
    return lambda document: change(document["agents"][0])


def _event(**told: Any) -> Callable[[dict[str, Any]], Any]:
    return lambda document: document.update(events=[{"kind": "lead", "target": "av", "tries": 1, **told}])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda document: document.pop("replay"), "replay: Field required"),
        (lambda document: document["placed"].update(agents=3), "placed.agents 3, but 2 agents"),
        (lambda document: document["placed"].update(entered=1), "placed.entered 1, but 0 agents"),
        (lambda document: document["placed"]["behaviours"].update(straight=1), "placed.behaviours.straight 1, but 0"),
        (lambda document: document.update(config_sha256="0" * 64), "expected that of config"),
        (lambda document: document["config"]["request"].update(agents=-1), "request.agents = -1"),
        (lambda document: document.update(variant=1), "of this source, configuration, seed and variant"),
        (lambda document: document["recording"].update(step_s=5.0), "recording.step_s: "),
        (_agent(lambda agent: agent.update(length_m=1e308)), "length_m: "),
        (_agent(lambda agent: agent.update(track_id="gen_7")), "gen_0, gen_7"),
        (_agent(lambda agent: agent.update(track_id="gen_1")), "two agents have the same track_id"),
        (_agent(lambda agent: agent.update(route=[1])), "lane segment 1 is not in the map"),
        (_agent(lambda agent: agent.update(maneuvers=[])), "policy lane_change, but no record of it"),
        (_agent(lambda agent: agent["maneuvers"][0].update(start_s=9)), "expected trigger, start, crossing, end in"),
        (_agent(lambda agent: agent["maneuvers"][0].update(end_s=None)), "done without start_s and end_s"),
        (_agent(lambda agent: agent["maneuvers"][0].update(leader_track_id="nobody")), "no leader 'nobody'"),
        (_event(status="not_feasible", track_id="gen_0"), "event 0: not_feasible with av, but made by gen_0"),
        (_event(status="done", track_id="gen_0", target_track_id="x"), "done with av, but made by gen_0 with x"),
        (_event(status="not_feasible"), "events: expected those of config, []"),
        (_event(status="done", human_brakes=True), "event 0: human_brakes True, but TTC, DRAC (None, None)"),
    ],
)
def test_a_spoiled_sidecar_is_found(written: Path, change: Callable[[dict[str, Any]], Any], said: str) -> None:
    edit_json(next(written.glob("hid2_*.json")), change)
    assert said in "\n".join(finding.message for finding in validate_folder(written.parents[1]))


def test_claims_are_judged_of_tracks_that_are_judged_and_of_those_not_there(written: Path) -> None:
    """Both made-up vehicles drive circles and claim a lane change, the second also to lead AV."""

    def claims(*inserted: str) -> list[str | None]:
        return [one.vehicle for one in validate_folder(written, inserted=inserted) if one.rule == Quantity.CLAIM]

    event = _event(status="done", track_id="gen_1", target_track_id="AV", at_s=4.0, ahead=True)
    edit_json(next(written.glob("hid2_*.json")), event)
    assert claims() == claims("gen_0", "gen_1") == ["gen_0", "gen_1", "gen_1"]
    assert (claims("AV"), claims("AV", "gen_0")) == ([], ["gen_0"])
    edit_rows(written, _without("gen_1", *range(110)))
    assert claims("AV") == ["gen_1", "gen_1"]
    with pytest.raises(ConfigError, match="--inserted gen_999: no scene has it, expected one of gen_0, "):
        claims("gen_999", "AV")


@pytest.mark.parametrize("change", [
    lambda rows: rows.assign(position_x=rows.position_x.mask(rows.index == 17, np.nextafter(rows.position_x, 9e9))),
    lambda rows: rows.assign(velocity_y=rows.velocity_y.where(rows.velocity_y != 0, -0.0)),
    _track(SCORED, "object_category", 1),
    lambda rows: rows.iloc[1:],
    lambda rows: rows.iloc[::-1],
    lambda rows: rows.drop(columns="map_id"),
    lambda rows: rows.assign(start_timestamp=rows.start_timestamp + 64),
])  # fmt: skip
def test_recorded_rows_are_compared_bit_for_bit(written: Path, data_root: Path, change: Change) -> None:
    edit_rows(written, change)
    assert "source" in rules(written, source=data_root)


def test_first_column_that_differs_from_the_source_is_named(written: Path, data_root: Path) -> None:
    """As pandas writes it anew; what was moved is found all the same."""
    (path,) = written.glob("scenario_*.parquet")
    rows = pd.read_parquet(path)
    rows["position_x"] += rows["track_id"].eq("AV")
    rows.to_parquet(path)
    columns, moved = (one for one in breaches(written.parents[1], source=data_root) if one.rule == "source")
    assert columns.message == "column track_id (large_string), expected track_id (string), as the source has it"
    assert moved.message.startswith("track 'AV', timestep 0: position_x")


def test_nulls_in_columns_of_the_source_are_the_same_as_nulls_alone(
    tmp_path: Path, copy_scene: Callable[..., Path]
) -> None:
    """In numbers that are none, in integers and in texts that nobody asks for."""
    source = copy_scene()

    def change(rows: pd.DataFrame) -> pd.DataFrame:
        gone = rows.index % 3 == 0
        return rows.assign(map_id=rows.map_id.astype("Int64").mask(gone), mine=rows.heading.mask(gone), why=None)

    edit_rows(source, change)
    folder = write_fake(read_scenario(source), out := tmp_path / "out")
    assert breaches(out, source=source) == []
    edit_rows(folder, lambda rows: rows.assign(mine=rows.mine.fillna(0.0)))
    assert "source" in rules(folder, source=source)


def test_a_map_that_differs_from_the_source_is_found(written: Path, data_root: Path) -> None:
    edit_json(next(written.glob("log_map_archive_*.json")), lambda document: document)
    path = next(written.glob("log_map_archive_*.json"))
    path.write_bytes(path.read_bytes() + b"\n")
    assert rules(written, source=data_root) == {"source"}


def test_a_source_that_is_not_there_is_found(written: Path, data_root: Path, tmp_path: Path) -> None:
    assert rules(written, source=data_root / "val") == {"source"}
    with pytest.raises(ScenarioError, match="no such folder"):
        validate_folder(written, source=tmp_path / "nowhere")


def test_added_centrelines_are_no_difference(tmp_path: Path, copy_scene: Callable[..., Path]) -> None:
    source = copy_scene()
    (map_path,) = source.glob("log_map_archive_*.json")
    edit_json(map_path, lambda document: [lane.pop("centerline") for lane in document["lane_segments"].values()])
    folder = write_fake(read_scenario(source), out := tmp_path / "out")
    assert breaches(out, source=source) == []
    edit_json(
        next(folder.glob("log_map_archive_*.json")), in_first_lane(lambda lane: lane.update(is_intersection=True))
    )
    assert {finding.rule for finding in breaches(out, source=source)} == {"source"}


@pytest.fixture(scope="module")
def noisy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene that is generated with a tracker's noise."""
    source = find_scenarios(Path(__file__).parents[4] / "data" / "av2")[0]
    config = load_config(None, ["request.agents=3", "export.noise=tracker"])
    return generate(read_scenario(source), config).write(tmp_path_factory.mktemp("noisy"))


def _with_clean(folder: Path, out: Path, change: Callable[[dict[str, Any]], None]) -> set[str]:
    """Rules that a scene breaks of which the sidecar of the first inserted vehicle is changed."""
    copied = shutil.copytree(folder, out / "train" / folder.name)
    path = copied / f"hid2_{folder.name}.json"
    document = json.loads(path.read_text())
    change(document["agents"][0])
    path.write_text(json.dumps(document))
    return {one.rule for one in validate_folder(out) if not one.is_note}


@pytest.mark.parametrize(("change", "broken"), [
    (lambda agent: None, set()),  # as exported velocities are not the derivative of positions, which are smoothed
    (lambda agent: agent.update(clean=None), {"sidecar"}),
    (lambda agent: agent["clean"].update({name: of[:-1] for name, of in agent["clean"].items()}), {"generated"}),
    (lambda agent: agent["clean"].update(x=[x + 3.0 for x in agent["clean"]["x"]]), {"noise"}),
    (lambda agent: agent["clean"].update(vx=[5.0 + vx for vx in agent["clean"]["vx"]]), {"velocity"}),
], ids=["whole", "none", "too short", "too far off", "no derivative"])  # fmt: skip
def test_motion_of_a_scene_with_noise_is_judged_on_clean_states_which_are_those_of_the_vehicle(
    noisy: Path, tmp_path: Path, change: Callable[[dict[str, Any]], None], broken: set[str]
) -> None:
    found = _with_clean(noisy, tmp_path, change)
    assert broken <= found
    assert broken or not found


def test_a_recording_that_people_labelled_gets_no_noise_and_no_clean_states(
    data_scenes: dict[str, Path], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    source = replace(read_scenario(data_scenes["curve"]), provenance="human")
    asked = (load_config(None, ["request.agents=2", f"export.noise={noise}"]) for noise in ("none", "tracker"))
    plain, made = (generate(source, config) for config in asked)
    for one, other in zip(made.generated, plain.generated, strict=True):
        np.testing.assert_array_equal(one.velocity, other.velocity)
    assert "people labelled it, so export.noise adds nothing" in caplog.text
    assert [finding for finding in validate_folder(made.write(tmp_path)) if not finding.is_note] == []
