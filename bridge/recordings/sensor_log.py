"""Argoverse 2 sensor logs: boxes that people labelled, poses of the egovehicle, and a vector map without centrelines.

What becomes of a log, step for step:

- A window of 110 sweeps, 0.1 s apart to within 10 ms; its first 50 are observed, as in the forecasting scenes.
- Boxes are taken to the city frame with the pose of their own sweep. Positions and headings are not smoothed: people
  have. Velocities are the derivative of a Savitzky-Golay filter (7 samples, degree 2) over each unbroken run.
- Categories become object types of the forecasting scenes (`OBJECT_TYPES`). Tracks of fewer than 5 sweeps are left
  out; the others are numbered from 10000 by first appearance.
- Track AV is the pose, moved 1.4 m ahead: from the rear axle to the centre of the box, as recorded scenes have it.
- Focal is the vehicle with the longest path of those seen at every step. Scored are the other road users seen at every
  step that move 2 m or more and come within 35 m of the AV. What else is seen at every step is context, the rest
  fragments.
- Sizes are the medians of the labelled boxes.
- The map gets a centreline for each lane, midway between its boundaries, and the predecessors that successors imply.

The constants are rules of this reader and no parameters of the method: another value would be another recording.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow import feather
from scipy.spatial.transform import Rotation

from bridge.files import one_line
from bridge.recordings import limits
from bridge.recordings.folders import ANNOTATIONS, LOG_MAP_NAME, POSES, Source, log_maps
from bridge.recordings.map_rules import graph_of, read_document
from bridge.recordings.recording import Recording, velocity_of
from bridge.recordings.scenario import SCHEMA, check_columns, check_size, read_arrow, recording_of, split_rows
from hid2.agents import AV_ID, FOCAL_CATEGORY, BoxSize, FloatArray, IntArray
from netconvert.errors import MapError, ScenarioError
from netconvert.geometry import arc_length
from netconvert.lane_graph import LaneSegment

#: Steps of a window, those of them that are observed, seconds from one to the next, and tolerance of that in sweeps.
NUM_STEPS, OBSERVED_STEPS, STEP_S, _OFF_S = 110, 50, 0.1, 0.01
_MIN_STEPS, _AV_AHEAD_M, _FIRST_ID = 5, 1.4, 10_000
#: Length, width, height of the egovehicle where a log does not tell, m.
_AV_SIZE = (4.877, 2.0, 1.473)
_SCORED_PATH_M, _SCORED_NEAR_M, _PATH_EVERY = 2.0, 35.0, 10
_VELOCITY_SAMPLES = 7
#: Distance of points of a centreline, and places at which boundaries are paired for it.
_CENTERLINE_STEP_M, _LADDER = 2.0, 100
_CITIES = {"ATX": "austin", "DTW": "dearborn", "MIA": "miami"}
_CITIES |= {"PAO": "palo-alto", "PIT": "pittsburgh", "WDC": "washington-dc"}
_CATEGORIES = {
    "vehicle": "REGULAR_VEHICLE LARGE_VEHICLE BOX_TRUCK TRUCK TRUCK_CAB VEHICULAR_TRAILER RAILED_VEHICLE",
    "bus": "BUS SCHOOL_BUS ARTICULATED_BUS",
    "pedestrian": "PEDESTRIAN OFFICIAL_SIGNALER WHEELCHAIR",
    "cyclist": "BICYCLIST WHEELED_RIDER",
    "motorcyclist": "MOTORCYCLIST",
    "riderless_bicycle": "BICYCLE",
    "construction": "CONSTRUCTION_CONE CONSTRUCTION_BARREL",
    "static": "BOLLARD SIGN STOP_SIGN MOBILE_PEDESTRIAN_CROSSING_SIGN MOTORCYCLE MESSAGE_BOARD_TRAILER "
    "TRAFFIC_LIGHT_TRAILER",
}
#: Object type by category of the annotations; any other category is "unknown".
OBJECT_TYPES = {source: target for target, sources in _CATEGORIES.items() for source in sources.split()}
_ROAD_USERS = ("vehicle", "bus", "pedestrian", "cyclist", "motorcyclist")
_EGO = "EGO_VEHICLE"
_QUATERNION = ["qx", "qy", "qz", "qw"]
_POSE = ["tx_m", "ty_m", "tz_m", *_QUATERNION]
_SIZE = ["length_m", "width_m", "height_m"]
_INTEGERS, _FLOATS = (pa.int64(), pa.uint64()), (pa.float64(), pa.float32(), pa.float16())
_STRINGS = (pa.string(), pa.large_string())


def read(source: Source) -> Recording:
    """Read one window of a log. Errors: ScenarioError, MapError with file, id, value and what was expected."""
    log = source.path
    map_path, map_id, log_id, city = _map_of(log)
    states, sweeps = _states(log, source.start)
    states, focal = _with_tracks(states, log, source.start)
    same: dict[str, Any] = {
        "scenario_id": source.scenario_id, "start_timestamp": float(sweeps[0]), "end_timestamp": float(sweeps[-1]),
        "num_timestamps": NUM_STEPS, "focal_track_id": focal, "city": city, "map_id": map_id, "slice_id": log_id,
    }  # fmt: skip
    states = states.assign(observed=states.timestep < OBSERVED_STEPS, **same)
    schema = pa.schema([*SCHEMA, ("map_id", pa.uint64()), ("slice_id", pa.string())])
    table = pa.Table.from_pandas(states[schema.names], schema=schema, preserve_index=False)
    table = table.replace_schema_metadata(None)
    medians = states.groupby("track_id")[["length_m", "width_m"]].median().round(3)
    sizes = {str(track): BoxSize(*row) for track, row in zip(medians.index, medians.to_numpy().tolist(), strict=True)}
    rows = split_rows(table, name=str(source), sizes=sizes, observed_steps=OBSERVED_STEPS)
    document = _completed(read_document(map_path), name=str(map_path))
    graph = graph_of(document, name=str(map_path))
    source, written = replace(source, map_path=map_path), json.dumps(document).encode()
    return recording_of(source, rows, graph, provenance="human", map_json=written)


def last_start(log: Path) -> int:
    """First sweep of the last window that a log holds; below 0 where it holds none, or cannot be read."""
    if not (found := sorted(log.glob(ANNOTATIONS))):
        return -1
    try:
        return len(_table(found[0], {"timestamp_ns": _INTEGERS}).timestamp_ns.unique()) - NUM_STEPS
    except ScenarioError:  # reading a window says why
        return -1


def _map_of(log: Path) -> tuple[Path, int, str, str]:
    """Map file, number of the map, log id and city. Errors: MapError."""
    found = log_maps(log)
    wanted = "log_map_archive_<log>____<CITY>_city_<n>.json"
    if len(found) != 1:
        raise MapError(f"{log}: {len(found) or 'no'} {wanted} in it or in its folder map, expected exactly one")
    named = LOG_MAP_NAME.fullmatch(found[0].stem)
    if named is None or named[2] not in _CITIES:
        raise MapError(f"{found[0]}: expected a name {wanted}, CITY one of {', '.join(_CITIES)}")
    return found[0], int(named[3]), named[1], _CITIES[named[2]]


def _table(path: Path, columns: Mapping[str, Sequence[pa.DataType]]) -> pd.DataFrame:
    """Columns of a feather file, each of one of its types, finite, without nulls. Errors: ScenarioError."""
    read = partial(feather.read_table, use_threads=False)
    table = read_arrow(path, read, kind="feather", wanted="it in a sensor log")
    check_size(str(path), rows=table.num_rows, columns=table.num_columns)
    plain = [field.type.value_type if pa.types.is_dictionary(field.type) else field.type for field in table.schema]
    table = table.cast(pa.schema(list(zip(table.column_names, plain, strict=True))))
    check_columns(table, str(path), columns)
    frame: pd.DataFrame = table.select(columns).to_pandas()
    for column in [column for column, types in columns.items() if types is _FLOATS]:
        frame[column] = frame[column].astype(np.float64)
        for row in np.flatnonzero(~np.isfinite(frame[column]))[:1].tolist():
            raise ScenarioError(f"{path}: row {row}: {column} is {frame[column][row]}, expected a finite number")
    return frame


def _states(log: Path, start: int) -> tuple[pd.DataFrame, list[int]]:
    """One row for each object and sweep of the window, in the city frame; the AV is the last object."""
    if not (found := sorted(log.glob(ANNOTATIONS))):
        raise ScenarioError(f"{log}: no annotations.feather, expected the labelled boxes of a sensor log")
    path, pose_path = found[0], log / POSES
    kinds = {"timestamp_ns": _INTEGERS, "track_uuid": _STRINGS, "category": _STRINGS}
    annotations = _table(path, kinds | dict.fromkeys([*_POSE, *_SIZE], _FLOATS))
    poses = _table(pose_path, {"timestamp_ns": _INTEGERS} | dict.fromkeys(_POSE, _FLOATS))
    poses = poses.drop_duplicates().set_index("timestamp_ns")
    sweeps = _window(np.sort(annotations.timestamp_ns.unique()), start, path)
    lacking = np.setdiff1d(sweeps, poses.index.to_numpy())
    if len(lacking):
        said = f"no pose at {len(lacking)} of {NUM_STEPS} sweeps, the first at timestamp {lacking[0]}"
        raise ScenarioError(f"{pose_path}: {said}, expected one for each annotated sweep")
    ego = annotations[annotations.category == _EGO]
    boxes = annotations[annotations.timestamp_ns.isin(sweeps) & (annotations.category != _EGO)].copy()
    poses = poses.loc[sweeps]
    if again := poses.index[poses.index.duplicated()].tolist():
        raise ScenarioError(f"{pose_path}: timestamp {again[0]}: two poses, expected one")
    _check_boxes(boxes, path)
    _check_rotations(boxes, path)
    _check_rotations(poses, pose_path)

    at = poses.loc[boxes.timestamp_ns]
    in_city = _rotations(at).apply(boxes[["tx_m", "ty_m", "tz_m"]].to_numpy(copy=True))
    boxes["position_x"], boxes["position_y"] = (in_city[:, :2] + at[["tx_m", "ty_m"]].to_numpy()).T
    boxes["heading"] = _yaw(_rotations(at) * _rotations(boxes))
    boxes["object_type"] = boxes.category.map(OBJECT_TYPES).fillna("unknown")
    ahead = _rotations(poses).apply([_AV_AHEAD_M, 0.0, 0.0])
    av = pd.DataFrame({"timestamp_ns": sweeps, "track_uuid": AV_ID, "category": _EGO, "object_type": "vehicle"})
    av["position_x"] = poses.tx_m.to_numpy() + ahead[:, 0]
    av["position_y"] = poses.ty_m.to_numpy() + ahead[:, 1]
    av["heading"] = _yaw(_rotations(poses))
    av[_SIZE] = ego[_SIZE].median().to_list() if len(ego) else _AV_SIZE
    states = pd.concat([boxes, av], ignore_index=True)
    states["timestep"] = np.searchsorted(sweeps, states.timestamp_ns)
    return states, sweeps.tolist()


def _window(every: IntArray, start: int, path: Path) -> IntArray:
    """The time stamps of a window among all of a log. Errors: ScenarioError."""
    last, sweeps = len(every) - NUM_STEPS, every[start : start + NUM_STEPS]
    if last < 0:
        raise ScenarioError(f"{path}: {len(every)} sweeps, expected at least {NUM_STEPS}")
    if start > last:
        said = f"no {NUM_STEPS} of {len(every)} sweeps from {start} on"
        raise ScenarioError(f"{path}: {said}, expected --window 0 to {last}")
    apart_s = np.diff(sweeps) / 1e9
    worst = int(np.abs(apart_s - STEP_S).argmax())
    if abs(apart_s[worst] - STEP_S) > _OFF_S:
        which = f"sweeps {start + worst} and {start + worst + 1} are {apart_s[worst]:.3f} s apart"
        raise ScenarioError(f"{path}: {which}, expected {STEP_S} s: choose a --window without the gap")
    return sweeps


def _check_boxes(boxes: pd.DataFrame, path: Path) -> None:
    if not len(boxes):
        raise ScenarioError(f"{path}: no box in the window, expected those of a scene")
    usual = boxes.length_m.between(0, 50, inclusive="neither") & boxes.width_m.between(0, 10, inclusive="neither")
    for wrong, said in (
        (boxes.duplicated(["track_uuid", "timestamp_ns"]), ", timestamp {0.timestamp_ns}: two boxes, expected one"),
        (~usual, ": box {0.length_m:.4g} x {0.width_m:.4g} m, expected above 0 and below 50 x 10 m"),
    ):
        for first in boxes[wrong][:1].itertuples():
            track = one_line(str(first.track_uuid), most=60)
            raise ScenarioError(f"{path}: track {track!r}{said.format(first)}")
    if (boxes.track_uuid == AV_ID).any():
        raise ScenarioError(f"{path}: a box of track {AV_ID!r}, expected that of the egovehicle as {_EGO}")


def _check_rotations(frame: pd.DataFrame, path: Path) -> None:
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(frame[_QUATERNION].to_numpy(), axis=1)
    worst = int(np.abs(norm - 1.0).argmax())
    if not abs(norm[worst] - 1.0) < 0.01:
        raise ScenarioError(f"{path}: a quaternion of norm {norm[worst]:.4g} (row {worst} of the window), expected 1")


def _rotations(table: pd.DataFrame) -> Any:  # noqa: ANN401  # scipy has no types
    return Rotation.from_quat(table[_QUATERNION].to_numpy(copy=True))


def _yaw(rotation: Any) -> FloatArray:  # noqa: ANN401  # scipy has no types
    """Heading about the vertical, in (-pi, pi]."""
    angle = rotation.as_euler("ZYX")[:, 0]
    return np.where(angle <= -np.pi, np.pi, angle)


def _with_tracks(states: pd.DataFrame, log: Path, start: int) -> tuple[pd.DataFrame, str]:
    """Number the tracks by first appearance, add velocity and category; the rows and the focal track's id."""
    states = states[states.groupby("track_uuid").timestep.transform("size") >= _MIN_STEPS]
    first = states[states.track_uuid != AV_ID].groupby("track_uuid").timestep.min()
    order = first.reset_index().sort_values(["timestep", "track_uuid"]).track_uuid
    names = {track: str(_FIRST_ID + number) for number, track in enumerate(order)} | {AV_ID: AV_ID}
    states = states.assign(track_id=states.track_uuid.map(names)).sort_values(["track_id", "timestep"])
    states = states.reset_index(drop=True)
    run = ((states.track_id != states.track_id.shift()) | (states.timestep.diff() != 1)).cumsum()
    position = states[["position_x", "position_y"]]
    velocities = [velocity_of(part.to_numpy(), _VELOCITY_SAMPLES, step_s=STEP_S) for _, part in position.groupby(run)]
    states[["velocity_x", "velocity_y"]] = np.vstack(velocities)

    whole = states[states.groupby("track_id").timestep.transform("size") == NUM_STEPS]
    ids, kinds = (whole[column].to_numpy()[::NUM_STEPS] for column in ("track_id", "object_type"))
    place = whole[["position_x", "position_y"]].to_numpy().reshape(-1, NUM_STEPS, 2)
    length_m = np.linalg.norm(np.diff(place[:, ::_PATH_EVERY], axis=1), axis=2).sum(axis=1)
    near_m = np.linalg.norm(place - place[ids == AV_ID], axis=2).min(axis=1)
    scored = (length_m >= _SCORED_PATH_M) & (near_m <= _SCORED_NEAR_M) & np.isin(kinds, _ROAD_USERS) & (ids != AV_ID)
    vehicles = np.flatnonzero((kinds == "vehicle") & (ids != AV_ID))
    if not len(vehicles):
        said = f"no vehicle is labelled at every one of the {NUM_STEPS} sweeps from {start} on"
        raise ScenarioError(f"{log}: {said}, expected one as focal track: choose another --window")
    focal = str(ids[vehicles[np.argmax(length_m[vehicles])]])
    category = dict.fromkeys(names.values(), 0) | dict(zip(ids, 1 + scored, strict=True)) | {focal: FOCAL_CATEGORY}
    return states.assign(object_category=states.track_id.map(category)), focal


def _completed(document: dict[str, Any], *, name: str) -> dict[str, Any]:
    """A map in the key order of forecasting maps, with centrelines and every predecessor. Errors: MapError."""
    graph, lanes = graph_of(document, name=name), document["lane_segments"]
    for key, lane in lanes.items():
        if not lane.get("centerline"):
            lane["centerline"] = _centerline(graph.lanes[lane["id"]], where=f"{name}: lane segment {key}")
        for successor in lane["successors"]:
            other = lanes.get(str(successor))
            if other is not None and lane["id"] not in other["predecessors"]:
                other["predecessors"].append(lane["id"])
    return {
        layer: {key: dict(sorted(item.items())) for key, item in document[layer].items()}
        for layer in ("drivable_areas", "lane_segments", "pedestrian_crossings")
    }


def _centerline(lane: LaneSegment, *, where: str) -> list[dict[str, float]]:
    """Midway between the boundaries, at equal steps of at most 2 m, z = 0, centimetres: as forecasting maps have it."""
    left, right = (_resampled(side, _LADDER) for side in lane.sides)
    middle = (left + right) / 2
    length_m = float(arc_length(middle)[-1])
    if length_m > limits.MAX_LANE_M:
        raise MapError(f"{where}: {length_m:.0f} m long, expected at most {limits.MAX_LANE_M:.0f} m")
    points = _resampled(middle, max(1, math.ceil(length_m / _CENTERLINE_STEP_M)) + 1)
    return [{"x": round(x, 2), "y": round(y, 2), "z": 0.0} for x, y in points.tolist()]


def _resampled(line: FloatArray, count: int) -> FloatArray:
    """So many points at equal distances along a polyline, which may have no length."""
    s = arc_length(line)
    at = np.linspace(0.0, 1.0, count) * s[-1]
    return np.column_stack([np.interp(at, s, axis) for axis in line.T])
