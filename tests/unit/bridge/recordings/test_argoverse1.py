"""Argoverse 1 in and out: sequences and city maps; the synthetic data set of support/recordings.py has the format."""

import csv
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely

from bridge.batch.batch import Options, plan, run_batch
from bridge.batch.validation import validate_folder
from bridge.config import load_config
from bridge.recordings.argoverse1 import INSERTED, motion_of, sequence_bytes, write_sequence
from bridge.recordings.folders import Choices, Source, sequence_path
from bridge.recordings.recording import Recording
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sources import _city_maps, described, find_recordings, find_sources, read_recording
from netconvert.av1_map import LANE_WIDTH_M, boundaries, cut_city, drivable_raster, read_city_lanes
from netconvert.errors import ExportError, Hid2Error, MapError, NoSceneError, ScenarioError

Change = Callable[[list[list[str]]], object]
HEADER = ["TIMESTAMP", "TRACK_ID", "OBJECT_TYPE", "X", "Y", "CITY_NAME"]


@pytest.fixture
def copy(argoverse1: Path, tmp_path: Path) -> Path:
    shutil.copytree(argoverse1, tmp_path / "copy")
    return tmp_path / "copy"


def sequence(argoverse1: Path, name: str = "train/data/1.csv") -> Recording:
    (address,) = find_recordings([argoverse1 / name])
    return read_recording(address)


def rows_of(path: Path) -> list[list[str]]:
    return list(csv.reader(path.read_text().splitlines()))


def write_rows(path: Path, rows: list[list[str]]) -> None:
    path.write_text("\n".join(",".join(row) for row in rows) + "\n")


# The format


def test_a_sequence_is_fifty_steps_of_which_twenty_are_observed(argoverse1: Path) -> None:
    found = sequence(argoverse1)
    assert (found.num_steps, found.observed_steps, found.step_s, found.last_observed) == (50, 20, 0.1, 19)
    assert (found.format, found.provenance, found.city, found.split) == ("argoverse1", "tracker", "miami", "train")
    assert found.track("AV").category == 1
    focal = found.track(found.focal_track_id)
    assert (focal.category, len(focal.timesteps)) == (3, 50)
    assert {track.category for track in found.tracks if len(track.timesteps) < 50} <= {0}
    assert {track.object_type for track in found.tracks} == {"vehicle"}
    last = sequence(argoverse1, "test_obs/data/4.csv")
    assert (last.num_steps, last.observed_steps, last.split) == (20, 20, "test")


def test_positions_are_those_of_the_file_to_the_last_bit(argoverse1: Path) -> None:
    path = argoverse1 / "val/data/7.csv"
    found = sequence(argoverse1, "val/data/7.csv")
    _, *rows = rows_of(path)
    stamps = sorted({float(row[0]) for row in rows})
    wanted = {(row[1] if row[2] != "AV" else "AV", stamps.index(float(row[0]))): (row[3], row[4]) for row in rows}
    assert len(wanted) == found.table.num_rows == len(rows)
    for track in found.tracks:
        for step, xy in zip(track.timesteps.tolist(), track.position.tolist(), strict=True):
            assert tuple(map(float, wanted[track.track_id, step])) == tuple(xy)


def test_headings_and_velocities_come_from_positions(argoverse1: Path, data_scenes: dict[str, Path]) -> None:
    """Against those of the scene that the sequence is made of: 3 degrees and 0.3 m/s for all that move."""
    truth = read_scenario(data_scenes["arterial"])
    found = sequence(argoverse1)
    by_place = {tuple(np.round(track.position[0], 6)): track for track in truth.tracks}
    compared = 0
    for track in found.tracks:
        same = by_place.get(tuple(np.round(track.position[0], 6)))
        if same is None or track.speed.min() < 2.0 or len(track.timesteps) < 50:
            continue
        heading, velocity = same.heading[:50], same.velocity[:50]
        assert np.abs(np.angle(np.exp(1j * (track.heading - heading)))).max() < np.radians(3)
        assert np.hypot(*(track.velocity - velocity).T).max() < 0.3
        compared += 1
    assert compared >= 5


def test_who_stands_keeps_the_heading_or_has_that_of_the_lane(argoverse1: Path) -> None:
    """A vehicle drives east, stops and stays east while its position jitters; one that never moved has the lane's."""
    graph = sequence(argoverse1).graph
    rng = np.random.default_rng(0)
    x = np.concatenate([np.linspace(0, 20, 25), np.full(25, 20.0)])
    xy = np.column_stack([x, np.zeros(50)]) + rng.normal(0, 0.03, (50, 2))
    _, heading = motion_of(xy, np.arange(50), graph)
    assert np.abs(heading[30:]).max() < np.radians(10)
    lane = next(iter(graph.lanes.values()))
    middle = lane.path.point(lane.length_m / 2)
    _, heading = motion_of(middle + rng.normal(0, 0.03, (50, 2)), np.arange(50), graph)
    assert np.unique(heading).size == 1
    assert abs(np.angle(np.exp(1j * (heading[0] - float(lane.path.heading(lane.length_m / 2)))))) < 0.1


def test_the_map_is_that_of_the_scene_with_lanes_of_the_data_sets_width(
    argoverse1: Path, data_scenes: dict[str, Path]
) -> None:
    """Centrelines to a micrometre, links as they are, the drivable area to a metre's pixels."""
    truth, found = read_scenario(data_scenes["intersection"]).graph, sequence(argoverse1, "val/data/7.csv").graph
    assert found.lanes.keys() == truth.lanes.keys()
    assert not set(found.lanes) & set(sequence(argoverse1, "test_obs/data/4.csv").graph.lanes), "a city is cut"
    for lane_id, lane in found.lanes.items():
        assert np.abs(lane.centerline - truth.lanes[lane_id].centerline).max() < 1e-6
        assert lane.width_m == pytest.approx(LANE_WIDTH_M, abs=0.1)
        assert found.successors(lane_id) == truth.successors(lane_id)
        assert lane.turn is truth.lanes[lane_id].turn
    assert found.drivable.intersection(truth.drivable).area / found.drivable.union(truth.drivable).area > 0.95


def test_holes_of_the_drivable_area_stay_holes() -> None:
    """
    A ring road of pixels around a block, in a rotated image:

        11111
        10001      area 12 m2, the block of 3 m2 is not drivable
        11111
    """
    pixels = np.array([[1, 1, 1, 1, 1], [1, 0, 0, 0, 1], [1, 1, 1, 1, 1]])
    turned = np.array([[0.0, -1.0, 10.0], [1.0, 0.0, 20.0], [0.0, 0.0, 1.0]])
    raster = drivable_raster(pixels, turned, name="r", se2_name="s")
    xml = (
        '<A><node id="0" x="-21" y="9"/><node id="1" x="-16" y="9"/><way lane_id="7">'
        '<tag k="has_traffic_control" v="False"/><tag k="turn_direction" v="NONE"/>'
        '<tag k="is_intersection" v="False"/><tag k="l_neighbor_id" v="None"/><tag k="r_neighbor_id" v="None"/>'
        '<nd ref="0"/><nd ref="1"/></way></A>'
    )
    lanes = read_city_lanes(xml.encode(), name="m")
    low, high = np.array([-30.0, 0.0]), np.array([0.0, 20.0])
    document = cut_city(lanes, raster, low=low, high=high, name="m")
    rings = [[(p["x"], p["y"]) for p in area["area_boundary"]] for area in document["drivable_areas"].values()]
    ground = shapely.union_all([shapely.Polygon(ring) for ring in rings])
    assert ground.area == pytest.approx(12.0)
    for row, column in ((0, 0), (1, 2), (2, 4)):
        city = turned[:2, :2].T @ (np.array([column + 0.5, row + 0.5]) - turned[:2, 2])
        assert shapely.contains_xy(ground, *city) == bool(pixels[row, column])


def test_boundaries_lie_half_a_width_to_each_side() -> None:
    """East, then north: at the corner they lie on the bisector.

          |  |
    ______|  |      left is inside the turn
    ________/
    """
    left, right = boundaries(np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]]))
    assert left.tolist() == [[0.0, 1.9], [pytest.approx(8.1), pytest.approx(1.9)], [8.1, 10.0]]
    assert right.tolist() == [[0.0, -1.9], [pytest.approx(11.9), pytest.approx(-1.9)], [11.9, 10.0]]


def test_a_map_of_argoverse_2_takes_the_place_of_the_citys(argoverse1: Path, data_scenes: dict[str, Path]) -> None:
    (address,) = find_sources([argoverse1 / "val/data/7.csv"], Choices(map_path=data_scenes["intersection"]))
    found = read_recording(address)
    assert found.scenario_id == f"argoverse1-val-7-on-{data_scenes['intersection'].name}"
    assert found.map_json is None
    assert found.map_path == next(data_scenes["intersection"].glob("log_map_archive_*.json"))
    assert found.graph.lanes.keys() == read_scenario(data_scenes["intersection"]).graph.lanes.keys()


def test_what_a_folder_holds_is_found_and_said(argoverse1: Path, data_scenes: dict[str, Path], tmp_path: Path) -> None:
    (tmp_path / "mixed").mkdir()
    shutil.copytree(data_scenes["curve"], tmp_path / "mixed" / data_scenes["curve"].name)
    shutil.copytree(argoverse1, tmp_path / "mixed" / "av1")
    found = find_sources([tmp_path / "mixed"])
    assert sum(isinstance(address, Source) for address in found) == 9
    assert len(found) == 10
    lines = described(found)
    assert lines[0] == "Argoverse 1 sequences: 9 found"
    assert "headings" in lines[1]
    (tmp_path / "mixed" / "av1").rename(tmp_path / "mixed" / "argoverse1")
    (tmp_path / "mixed" / "manifest.csv").touch()  # as beside those that hid2 writes for loaders
    assert find_sources([tmp_path / "mixed"]) == [tmp_path / "mixed" / data_scenes["curve"].name]


# What is wrong


def _set(row: int | None, column: str, value: str) -> Change:
    """In one row, or in all."""

    def change(rows: list[list[str]]) -> None:
        for one in rows[1:] if row is None else [rows[row]]:
            one[HEADER.index(column)] = value

    return change


def _last_stamp_gone(rows: list[list[str]]) -> None:
    last = max(row[0] for row in rows[1:])
    rows[:] = [row for row in rows if row[0] != last]


def _one_of_agent_gone(rows: list[list[str]]) -> None:
    rows.remove(next(row for row in rows if row[2] == "AGENT"))


def _stretched(rows: list[list[str]]) -> None:
    first = min(float(row[0]) for row in rows[1:])
    for row in rows[1:]:
        row[0] = repr(first + 20 * (float(row[0]) - first))


def _second_agent(rows: list[list[str]]) -> None:
    name = next(row[1] for row in rows[1:] if row[2] == "OTHERS")
    for row in rows[1:]:
        if row[1] == name:
            row[2] = "AGENT"


WRONG_SEQUENCES: dict[str, tuple[Change, str]] = {
    "forty-nine-steps": (_last_stamp_gone, "49 time stamps, expected 50"),
    "two-agents": (_second_agent, "2 tracks of OBJECT_TYPE AGENT"),
    "agent-with-a-gap": (_one_of_agent_gone, "AGENT at 49 of 50"),
    "duplicate-stamp": (lambda rows: rows.append(list(rows[1])), "more than one row"),
    "slow-clock": (_stretched, "apart in the mean"),
    "stray-quote": (_set(5, "CITY_NAME", '"MIA'), "line 6: CITY_NAME '\"MIA', expected 'MIA' or 'PIT'"),
    "no-header": (lambda rows: rows.pop(0), "columns .* expected TIMESTAMP"),
    "short-line": (lambda rows: rows[5].pop(), "line 6: 5 values, expected 6"),
    "x-is-text": (_set(7, "X", "east"), "line 8: X 'east', expected a valid number"),
    "stamp-is-infinite": (_set(3, "TIMESTAMP", "inf"), "TIMESTAMP 'inf'"),
    "unknown-type": (_set(4, "OBJECT_TYPE", "CAR"), "OBJECT_TYPE 'CAR'"),
    "unknown-city": (_set(None, "CITY_NAME", "NYC"), "CITY_NAME 'NYC', expected 'MIA' or 'PIT'"),
    "two-cities": (_set(4, "CITY_NAME", "PIT"), "CITY_NAME"),
    "no-rows": (lambda rows: rows.__delitem__(slice(1, None)), "0 rows"),
    "wrong-city": (_set(None, "CITY_NAME", "PIT"), "no lane within .* the map of their city"),
    "track-id-does-not-print": (_set(4, "TRACK_ID", "\x1b[2J"), "characters that can be printed"),
    "too-fast": (_set(9, "X", "1e9"), "spread over|velocity|no lane"),
}


@pytest.mark.parametrize(("change", "said"), WRONG_SEQUENCES.values(), ids=WRONG_SEQUENCES)
def test_a_wrong_sequence_is_refused_in_one_line(copy: Path, change: Change, said: str) -> None:
    path = copy / "train/data/1.csv"
    rows = rows_of(path)
    change(rows)
    write_rows(path, rows)
    with pytest.raises(Hid2Error, match=said) as caught:
        sequence(copy)
    assert isinstance(caught.value, ScenarioError | MapError)
    assert "\n" not in str(caught.value)


def _replace(name: str, old: str, new: str) -> Callable[[Path], None]:
    def change(maps: Path) -> None:
        path = maps / name
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))

    return change


VECTOR = "pruned_argoverse_MIA_10316_vector_map.xml"
RASTER = "MIA_10316_driveable_area_mat_2019_05_28.npy"
SE2 = "MIA_10316_npyimage_to_city_se2_2019_05_28.npy"


def _save(name: str, array: np.ndarray, *, pickled: bool = False) -> Callable[[Path], None]:
    return lambda maps: np.save(maps / name, array, allow_pickle=pickled)


WRONG_MAPS: dict[str, tuple[Callable[[Path], object], str]] = {
    "no-vector-map": (lambda maps: (maps / VECTOR).unlink(), "no pruned_argoverse_MIA_<id>_vector_map.xml"),
    "no-raster": (lambda maps: (maps / RASTER).unlink(), "no MIA_10316_driveable_area_mat_<id>.npy"),
    "two-rasters": (
        lambda maps: shutil.copyfile(maps / RASTER, maps / RASTER.replace("2019", "2020")), "2 files MIA_10316_drive"
    ),
    "not-xml": (lambda maps: (maps / VECTOR).write_text("lanes"), "not XML"),
    "entities": (
        _replace(VECTOR, "<ArgoverseVectorMap>", '<!DOCTYPE a [<!ENTITY e "x">]><ArgoverseVectorMap>'), "document type"
    ),
    "node-missing": (_replace(VECTOR, '<node id="0"', '<node id="987654"'), "node 0 is not in the file"),
    "node-is-text": (_replace(VECTOR, '<nd ref="0"', '<nd ref="first"'), "'first', expected an integer"),
    "coordinate-is-text": (_replace(VECTOR, ' x="', ' x="w'), "expected metres"),
    "boolean-is-a-number": (
        _replace(VECTOR, 'k="is_intersection" v="False"', 'k="is_intersection" v="0"'), "expected True or False"
    ),
    "tag-missing": (_replace(VECTOR, 'k="l_neighbor_id"', 'k="left"'), "no tag l_neighbor_id"),
    "lane-twice": (
        lambda maps: (maps / VECTOR).write_text(_twice((maps / VECTOR).read_text())), "appears twice, expected one way"
    ),
    "no-lanes": (lambda maps: (maps / VECTOR).write_text("<A/>"), "no way among"),
    "another-element": (_replace(VECTOR, "<node ", "<relation/><node "), "element 'relation'"),
    "raster-of-objects": (_save(RASTER, np.array([[{}]], dtype=object), pickled=True), "not an npy file of numbers"),
    "raster-is-flat": (_save(RASTER, np.ones(9)), "pixels of shape"),
    "raster-is-empty": (_save(RASTER, np.zeros((50, 50))), "no drivable area within"),
    "transformation-is-small": (_save(SE2, np.eye(2)), "se2.*expected numbers \\(3, 3\\)"),
    "transformation-is-nan": (_save(SE2, np.full((3, 3), np.nan)), "se2.*expected a rotation"),
    "transformation-scales": (_save(SE2, np.diag([2.0, 2.0, 1.0])), "se2.*expected a rotation"),
}  # fmt: skip


def _twice(text: str) -> str:
    start, stop = text.index("  <way"), text.index("</way>") + len("</way>\n")
    return text[:stop] + text[start:stop] + text[stop:]


@pytest.mark.parametrize(("change", "said"), WRONG_MAPS.values(), ids=WRONG_MAPS)
def test_a_wrong_city_map_is_refused_in_one_line(copy: Path, change: Callable[[Path], object], said: str) -> None:
    change(copy / "map_files")
    with pytest.raises(MapError, match=said) as caught:
        sequence(copy)
    assert "\n" not in str(caught.value)


def test_map_files_that_are_not_there_are_said_with_the_way_out_and_files_without_a_number(
    copy: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (copy / "train/data/mine.csv").touch()
    assert not any(one.path.name == "mine.csv" for one in find_recordings([copy]))
    assert "1 .csv passed over, expected a number as name: mine.csv" in caplog.text
    shutil.rmtree(copy / "map_files")
    with pytest.raises(
        NoSceneError, match=r"this is Argoverse 1: its map files are missing, .*map_files; or give --map"
    ):
        find_recordings([copy])
    with pytest.raises(NoSceneError, match=r" in /map_files; or give --map"):  # at the root of the disk
        _city_maps(Path("/hid2-test"))


def test_a_chosen_map_of_another_place_is_refused(argoverse1: Path, data_scenes: dict[str, Path]) -> None:
    (address,) = find_sources([argoverse1 / "val/data/7.csv"], Choices(map_path=data_scenes["curve"]))
    with pytest.raises(MapError, match=r"0% of the AGENT of 7\.csv"):
        read_recording(address)
    with pytest.raises(NoSceneError, match=r"no log_map_archive_<id>.json in .*7\.csv; expected exactly one"):
        find_sources([argoverse1 / "val/data/7.csv"], Choices(map_path=argoverse1 / "val/data/7.csv"))


# Out: recorded lines text for text, inserted vehicles among them, and what validate says of it


@pytest.fixture
def written(argoverse1: Path, tmp_path: Path, here: None) -> Path:
    """A scene with one inserted vehicle and its sequence; the folder that they are in."""
    found = find_recordings([argoverse1 / "val/data/7.csv"])
    run_batch(plan(found, load_config(flags={"request.agents": 1})), tmp_path / "out", Options(argoverse1=True))
    return tmp_path / "out"


def the_file(out: Path) -> Path:
    (path,) = out.glob("argoverse1/val/data/*.csv")
    return path


def test_recorded_lines_stay_text_for_text_and_inserted_ones_come_behind_their_time(argoverse1: Path) -> None:
    """A vehicle that drives 5 m/s along x from step 10 on."""
    source = (argoverse1 / "val/data/7.csv").read_bytes()
    steps = np.arange(10, 50)
    position = np.column_stack([0.5 * steps, np.full(40, 0.1)])
    lines = sequence_bytes(source, [(steps, position)]).decode().splitlines()
    mine = [line for line in lines if INSERTED in line]
    assert [line for line in lines if INSERTED not in line] == source.decode().splitlines()
    assert len(mine) == 40
    assert {line.split(",")[2] for line in mine} == {"OTHERS"}
    stamps = [float(line.split(",")[0]) for line in lines[1:]]
    assert stamps == sorted(stamps)
    assert [float(value) for value in mine[3].split(",")[3:5]] == [6.5, 0.1]


def test_the_files_number_is_that_of_the_scenes_id(tmp_path: Path) -> None:
    """48 bits: 0x0000000000ff is 255."""
    path = sequence_path(tmp_path, "val", "00000000-00ff-5000-8000-000000000000")
    assert path == tmp_path / "argoverse1" / "val" / "data" / "255.csv"
    assert sequence_path(tmp_path, "test", "0" * 36).parts[-3] == "test_obs"
    assert sequence_path(tmp_path, None, "0" * 36).parent == tmp_path / "argoverse1" / "data"


def test_what_is_no_sequence_is_not_written_as_one(argoverse1: Path, tmp_path: Path) -> None:
    lacking = replace(sequence(argoverse1), sequence=None)
    with pytest.raises(ExportError, match="no Argoverse 1 sequence"):
        write_sequence(lacking, [], tmp_path, new_id="0" * 36)
    assert list(tmp_path.iterdir()) == []


def test_scene_and_sequence_are_valid_and_the_loader_of_argoverse_1_would_read_it(
    written: Path, argoverse1: Path
) -> None:
    """As argoverse_forecasting_loader does: every file of the folder, int(stem), one AGENT with X and Y."""
    assert validate_folder(written, source=argoverse1) == []
    for path in the_file(written).parent.iterdir():
        assert int(path.stem) > 0
        rows = list(csv.DictReader(path.read_text().splitlines()))
        agent = np.array([(float(row["X"]), float(row["Y"])) for row in rows if row["OBJECT_TYPE"] == "AGENT"])
        assert agent.shape == (50, 2)


def _first(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new, 1)


@pytest.mark.parametrize(
    ("change", "rule", "said"),
    [
        (lambda text: text.replace(f"{INSERTED}{0:012d}", f"{INSERTED}{7:012d}"), "sequence", "line .* is not as"),
        (lambda text: _first(text, "AGENT", "OTHERS"), "sequence", "and .*expected one"),
        (lambda text: "\n".join(text.splitlines()[:-1]) + "\n", "sequence|source", "is not as|recorded line"),
        (lambda text: _first(text, ",PIT\n", ",MIA\n"), "sequence", "CITY_NAME"),
        (lambda text: _first(text, ".", ".0"), "source|sequence", "recorded line 2|time stamps"),
        (lambda text: "", "sequence", "columns"),
    ],
    ids=["renamed", "no-agent", "cut", "city", "one-digit", "empty"],
)
def test_a_sequence_that_was_changed_is_found(
    written: Path, argoverse1: Path, change: Callable[[str], str], rule: str, said: str
) -> None:
    path = the_file(written)
    path.write_text(change(path.read_text()))
    findings = validate_folder(written, source=argoverse1)
    assert findings
    assert all(finding.file == path for finding in findings)
    assert any(finding.rule in rule.split("|") for finding in findings)
    assert any(re.search(said, finding.message) for finding in findings)
