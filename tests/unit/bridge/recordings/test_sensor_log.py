"""Argoverse 2 sensor logs in: a log made of a synthetic scene gives that scene back, and damaged ones are refused."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from pyarrow import feather
from recordings import LOG_ID, make_log, write_feather
from written import edit_json

from bridge.recordings.folders import Choices, Source
from bridge.recordings.recording import Recording, velocity_of
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sources import described, find_recordings, read_recording, window_id
from netconvert.errors import Hid2Error, MapError, ScenarioError

ANNOTATIONS, POSES = "annotations.feather", "city_SE3_egovehicle.feather"
MAP = f"map/log_map_archive_{LOG_ID}____PIT_city_47896.json"


@pytest.fixture(scope="session")
def log(data_scenes: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_log(data_scenes["intersection"], tmp_path_factory.mktemp("sensor") / "val")


def window(log: Path, start: int = 0) -> Recording:
    (address,) = find_recordings([log], Choices(window=start))
    return read_recording(address)


def test_the_log_of_a_scene_gives_the_scene_back(log: Path, data_scenes: dict[str, Path]) -> None:
    """Positions and headings to a micrometre though the egovehicle is tilted, the AV from its pose 1.4 m behind."""
    truth, found = read_scenario(data_scenes["intersection"]), window(log)
    assert (found.scenario_id, found.city, found.split) == (LOG_ID, "pittsburgh", "val")
    assert (found.num_steps, found.observed_steps, found.provenance) == (110, 50, "human")
    by_first = {tuple(np.round(track.position[0], 5)): track for track in found.tracks}
    long = [track for track in truth.tracks if len(track.timesteps) >= 5]
    assert len(long) == len(found.tracks)
    for track in long:
        same = found.track("AV") if track.track_id == "AV" else by_first[tuple(np.round(track.position[0], 5))]
        assert same.timesteps.tolist() == track.timesteps.tolist()
        assert np.abs(same.position - track.position).max() < 1e-6
        assert np.abs(np.angle(np.exp(1j * (same.heading - track.heading)))).max() < 2e-3
        if track.track_id != "AV":
            assert same.object_type == (track.object_type if track.object_type != "unknown" else "static")
            assert same.size.length_m == pytest.approx(track.size.length_m + 0.1)
    assert found.graph.lanes.keys() == truth.graph.lanes.keys()
    for lane_id, lane in found.graph.lanes.items():
        assert abs(lane.length_m - truth.graph.lanes[lane_id].length_m) < 0.2


def test_centrelines_and_predecessors_are_added_to_the_map(log: Path) -> None:
    found = window(log)
    assert found.map_json is not None
    lanes = json.loads(found.map_json)["lane_segments"]
    assert all(len(lane["centerline"]) >= 2 for lane in lanes.values())
    for lane in lanes.values():
        for successor in lane["successors"]:
            if str(successor) in lanes:
                assert lane["id"] in lanes[str(successor)]["predecessors"]


def test_windows_slide_over_the_log_with_ids_of_their_own(log: Path) -> None:
    """130 sweeps hold windows from 0 to 20."""
    found = find_recordings([log], Choices(stride=10))
    assert [address.start for address in found if isinstance(address, Source)] == [0, 10, 20]
    assert len({address.name for address in found}) == 3
    assert found[1].name == window_id(LOG_ID, 10)
    assert described(found)[0] == "Windows of Argoverse 2 sensor logs: 3 found"
    first, second = window(log), window(log, 10)
    assert second.start == 10
    one, other = first.track("AV"), second.track("AV")
    assert (one.position[10:] == other.position[:100]).all()
    with pytest.raises(ScenarioError, match="no 110 of 130 sweeps from 21 on, expected --window 0 to 20"):
        window(log, 21)


def test_velocity_is_the_derivative_of_a_run() -> None:
    """x = t^2 in steps of 0.1 s: v = 2 t, also of runs of one, two and three samples as far as they tell."""
    t = 0.1 * np.arange(12)
    xy = np.column_stack([t**2, 3 * t])
    assert velocity_of(xy, 7, step_s=0.1) == pytest.approx(np.column_stack([2 * t, np.full(12, 3.0)]))
    assert velocity_of(xy[:1], 7, step_s=0.1) == pytest.approx(np.zeros((1, 2)))
    assert velocity_of(xy[:2], 7, step_s=0.1) == pytest.approx(np.array([[0.1, 3.0], [0.1, 3.0]]))


# What is wrong

Frame = pd.DataFrame
Change = Callable[[Path], object]


def _table(name: str, change: Callable[[Frame], Frame]) -> Change:
    return lambda log: write_feather(change(feather.read_feather(log / name)), log / name)


def _cell(name: str, column: str, value: object) -> Change:
    def change(frame: Frame) -> Frame:
        frame.loc[frame.index[3], column] = value
        return frame

    return _table(name, change)


def _map(change: Callable[[dict[str, Any]], object]) -> Change:
    return lambda log: edit_json(log / MAP, change)


def _gap(frame: Frame) -> Frame:
    return frame[~frame.timestamp_ns.isin(sorted(frame.timestamp_ns.unique())[40:45])]


def _only_short(frame: Frame) -> Frame:
    vehicles = frame.category.isin(["REGULAR_VEHICLE", "BUS"])
    return frame[~(vehicles & (frame.timestamp_ns == frame.timestamp_ns.min()))]


def _scaled(frame: Frame) -> Frame:
    return frame.assign(qw=frame.qw * 2, qx=frame.qx * 2, qy=frame.qy * 2, qz=frame.qz * 2)


def _first_sweeps(count: int) -> Callable[[Frame], Frame]:
    return lambda frame: frame[frame.timestamp_ns.isin(sorted(frame.timestamp_ns.unique())[:count])]


WRONG: dict[str, tuple[Change, str]] = {
    "no-annotations": (lambda log: (log / ANNOTATIONS).unlink(), "no annotations.feather"),
    "no-poses": (lambda log: (log / POSES).unlink(), "city_SE3_egovehicle.feather: no such file"),
    "no-map": (lambda log: shutil.rmtree(log / "map"), "no log_map_archive_<log>"),
    "two-maps": (lambda log: shutil.copyfile(log / MAP, log / MAP.replace("PIT", "MIA")), "2 log_map_archive_<log>"),
    "map-of-no-city": (lambda log: (log / MAP).rename(log / MAP.replace("PIT", "NYC")), "CITY one of ATX"),
    "map-name": (lambda log: (log / MAP).rename(log / "map" / "log_map_archive_x.json"), "expected a name"),
    "not-feather": (lambda log: (log / ANNOTATIONS).write_text("boxes"), "not a feather file"),
    "cut-off": (lambda log: (log / POSES).write_bytes((log / POSES).read_bytes()[:1000]), "not a feather file"),
    "missing-column": (_table(ANNOTATIONS, lambda frame: frame.drop(columns="qw")), "no column 'qw'"),
    "column-is-text": (_table(POSES, lambda frame: frame.assign(tx_m="far")), "'tx_m' is .*expected double"),
    "nan": (_cell(ANNOTATIONS, "tx_m", np.nan), r"row 3 \(.*\): tx_m is null or NaN|row 3: tx_m is nan"),
    "infinite-pose": (_cell(POSES, "ty_m", np.inf), "row 3: ty_m is inf"),
    "no-category": (_cell(ANNOTATIONS, "category", None), r"row 3 \(.*track_uuid .*\): category is null"),
    "box-of-no-length": (_cell(ANNOTATIONS, "length_m", 0.0), "box 0 x"),
    "box-as-wide-as-a-street": (_cell(ANNOTATIONS, "width_m", 30.0), "expected above 0 and below 50 x 10 m"),
    "two-boxes": (_table(ANNOTATIONS, lambda frame: pd.concat([frame, frame.iloc[:1]])), "two boxes, expected one"),
    "quaternion": (_table(ANNOTATIONS, _scaled), "quaternion of norm 2"),
    "few-sweeps": (_table(ANNOTATIONS, _first_sweeps(109)), "109 sweeps, expected at least 110"),
    "gap": (_table(ANNOTATIONS, _gap), "sweeps 39 and 40 are 0.6"),
    "two-poses": (
        _table(POSES, lambda frame: pd.concat([frame, frame.iloc[7:8].assign(tx_m=0.0)])),
        "two poses, expected one",
    ),
    "pose-missing": (_table(POSES, lambda frame: frame.drop(index=7)), "no pose at 1 of 110 sweeps"),
    "nobody-throughout": (_table(ANNOTATIONS, _only_short), "no vehicle is labelled at every one"),
    "no-boxes": (_table(ANNOTATIONS, lambda frame: frame.iloc[:0]), "no rows"),
    "track-named-av": (
        _table(ANNOTATIONS, lambda frame: frame.replace({"track_uuid": {frame.track_uuid.iloc[0]: "AV"}})),
        "a box of track 'AV'",
    ),
    "map-without-lanes": (_map(lambda document: document.pop("lane_segments")), "no object 'lane_segments'"),
    "no-drivable-area": (_map(lambda document: document.update(drivable_areas={})), "no drivable area"),
}


@pytest.mark.parametrize(("change", "said"), WRONG.values(), ids=WRONG)
def test_a_wrong_log_is_refused_in_one_line(log: Path, tmp_path: Path, change: Change, said: str) -> None:
    copy = shutil.copytree(log, tmp_path / log.name)
    change(copy)
    with pytest.raises(Hid2Error, match=said) as caught:
        window(copy)
    assert isinstance(caught.value, ScenarioError | MapError)
    assert "\n" not in str(caught.value)
