"""Argoverse 1 forecasting sequences (format 1.1): positions of tracks, 5 s at about 10 Hz, on the map of a city.

What becomes of a sequence, step for step:

- Its 50 time stamps (20 in test_obs) are timesteps of 0.1 s, as the data set defines and every reader of it takes them;
  the first 20 are observed. Positions stay as they are, to the last bit. The stamps themselves are 0.1 to 0.2 s apart
  in the mean, and the AV's way from one to the next goes with them: by the data set's own clock the vehicles of such a
  sequence are slower than they look.
- Track AV keeps its type as its id. AGENT is the focal track; others seen at every step are context, shorter ones
  fragments. Types are not told: each track is a vehicle of that type's usual size.
- Velocities are the derivative of a Savitzky-Golay filter (11 samples, degree 2) over each unbroken run of a track:
  positions are a tracker's, and their differences are mostly noise.
- Headings are the direction of these velocities where a vehicle moves: 1 m/s and faster, of tracks that get 1.5 m away
  from where they begin. In between a vehicle keeps its last heading, before its first motion it has its next. One that
  never moves has the direction of the nearest lane.
- The map is cut from that of the city, 30 m around the tracks, or is the Argoverse 2 map that the user chose: both data
  sets have the same city frames.

Out goes a sequence with its recorded lines text for text and inserted vehicles as OTHERS among them, where loaders of
Argoverse 1 look for it.

The constants are rules of this reader and no parameters of the method: another value would be another recording.
"""

import csv
import io
import json
import math
import warnings
from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path
from tokenize import TokenError
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd
import shapely
from pydantic import FailFast, FiniteFloat, TypeAdapter
from typing_extensions import TypedDict

from bridge.files import beside, one_line, read_received
from bridge.recordings import limits
from bridge.recordings.folders import Source, only_file, sequence_path
from bridge.recordings.map_rules import graph_of, read_source_map
from bridge.recordings.recording import Recording, velocity_of
from bridge.recordings.scenario import recording_of, split_rows, table_of, typed
from hid2.agents import AV_ID, DEFAULT_SIZES, FOCAL_CATEGORY, FloatArray, IntArray, Track
from netconvert.av1_map import CityLane, cut_city, drivable_raster, read_city_lanes
from netconvert.errors import ExportError, MapError, ScenarioError
from netconvert.lane_graph import LaneGraph

AV, AGENT, OTHERS = "AV", "AGENT", "OTHERS"
#: Beginning of inserted vehicles' TRACK_IDs; recorded ones have 0000 before the last part.
INSERTED = "00000000-0000-0000-0001-"
#: Steps of a sequence, those of them that are observed (all of a test_obs sequence), seconds from one to the next.
NUM_STEPS, OBSERVED_STEPS, STEP_S = 50, 20, 0.1
#: Range of the mean distance of time stamps, and largest distance, s. Of 60 real sequences: 0.1 to 0.2, and 0.27.
_MEAN_S, _MOST_S = (0.05, 0.3), 0.6
_CITIES = {"MIA": "miami", "PIT": "pittsburgh"}
_SAMPLES = 11
_MOVES_MPS, _MOVES_M = 1.0, 1.5
_MARGIN_M = 30.0
#: Share of the AGENT's positions that has to lie on the map's drivable area: on another city's map none does.
_ON_MAP = 0.5
_RASTERS = ("driveable_area_mat", "npyimage_to_city_se2")


class _Row(TypedDict):
    TIMESTAMP: FiniteFloat
    TRACK_ID: str
    OBJECT_TYPE: Literal["AV", "AGENT", "OTHERS"]
    X: FiniteFloat
    Y: FiniteFloat
    CITY_NAME: Literal["MIA", "PIT"]


COLUMNS = tuple(_Row.__annotations__)
_ROWS = TypeAdapter(Annotated[list[_Row], FailFast()])


def read(source: Source) -> Recording:
    """Read one sequence. Errors: ScenarioError, MapError with file, id, value and what was expected."""
    path, name = source.path, str(source.path)
    content = read_received(path, ScenarioError, wanted="an Argoverse 1 sequence")
    rows = check_sequence(content, name)
    assert source.map_path is not None
    graph, map_json = _map(source.map_path, rows, name)
    agent, city = rows[rows.OBJECT_TYPE == AGENT], rows.CITY_NAME.iloc[0]
    on_map = float(np.mean(shapely.contains_xy(graph.drivable, agent.X, agent.Y)))
    if on_map < _ON_MAP:
        raise MapError(
            f"{source.map_path}: {on_map:.0%} of the AGENT of {path.name} ({city}) is on its drivable area, "
            f"expected {_ON_MAP:.0%} or more: a map of the place"
        )
    stamps, tracks = agent.TIMESTAMP.to_list(), []
    for _, own in rows.groupby("code"):
        position, steps, kind = np.column_stack([own.X, own.Y]), own.timestep.to_numpy(), own.OBJECT_TYPE.iloc[0]
        velocity, heading = motion_of(position, steps, graph)
        track_id = AV_ID if kind == AV else own.TRACK_ID.iloc[0]
        category = FOCAL_CATEGORY if kind == AGENT else int(len(own) == len(stamps))
        size = DEFAULT_SIZES["vehicle"]
        tracks.append(Track(track_id, "vehicle", category, steps, position, heading, velocity, size))
    same = {"scenario_id": source.scenario_id, "city": _CITIES[city], "num_timestamps": len(stamps)}
    same |= {"start_timestamp": stamps[0] * 1e9, "end_timestamp": stamps[-1] * 1e9}
    table = table_of(tracks, same | {"focal_track_id": agent.TRACK_ID.iloc[0]}, observed_steps=OBSERVED_STEPS)
    checked = split_rows(table, name=name, sizes={}, observed_steps=OBSERVED_STEPS)
    return recording_of(source, checked, graph, provenance="tracker", map_json=map_json, sequence=content)


def check_sequence(content: bytes, name: str) -> pd.DataFrame:
    """The rows of a CSV file, checked but for what `split_rows` asks, by track, in the order of first appearance.

    Its columns, timestep and a number by track, code; quotes are letters. name: for messages. Errors: ScenarioError.
    """
    try:
        header, *lines = [*csv.reader(io.StringIO(content.decode("ascii"), newline=""), quoting=csv.QUOTE_NONE)] or [[]]
    except (ValueError, csv.Error) as error:  # no ASCII, or a line without an end
        raise ScenarioError(f"{name}: not a CSV file ({error}), expected columns {','.join(COLUMNS)}") from error
    if sorted(header) != sorted(COLUMNS):
        shown = one_line(",".join(header), most=120)
        raise ScenarioError(f"{name}: columns {shown!r}, expected {','.join(COLUMNS)} of Argoverse 1")
    if not 0 < len(lines) <= limits.MAX_ROWS:
        raise ScenarioError(f"{name}: {len(lines)} rows, expected 1 to {limits.MAX_ROWS}")
    for number, line in enumerate(lines, start=2):
        if len(line) != len(header):
            raise ScenarioError(f"{name} line {number}: {len(line)} values, expected {len(header)}")
    checked = typed(_ROWS, [dict(zip(header, line, strict=True)) for line in lines], name)
    rows = pd.DataFrame(checked)
    stamps, rows["timestep"] = np.unique(rows.TIMESTAMP, return_inverse=True)
    _check_stamps(stamps, name)
    types, of_type = rows.groupby("TRACK_ID").OBJECT_TYPE.unique(), rows.groupby("OBJECT_TYPE").TRACK_ID
    for track_id, kinds in types[types.map(len) > 1].items():
        raise ScenarioError(f"{name}: track {track_id!r:.60}: OBJECT_TYPE {' and '.join(kinds)}, expected one")
    for kind in (AV, AGENT):
        count, seen = of_type.nunique().get(kind, 0), of_type.size().get(kind, 0)
        if count != 1:
            raise ScenarioError(f"{name}: {count or 'no'} tracks of OBJECT_TYPE {kind}, expected exactly one")
        if seen < len(stamps):
            said = f"track {kind} at {seen} of {len(stamps)} time stamps"
            raise ScenarioError(f"{name}: {said}, expected it at every one")
    if rows.CITY_NAME.nunique() > 1:
        raise ScenarioError(f"{name}: CITY_NAME {', '.join(rows.CITY_NAME.unique())}, expected one in every row")
    rows["code"] = pd.factorize(rows.TRACK_ID)[0]
    return rows.sort_values(["code", "timestep"], kind="stable")


def _check_stamps(stamps: FloatArray, name: str) -> None:
    if len(stamps) not in (NUM_STEPS, OBSERVED_STEPS):
        raise ScenarioError(f"{name}: {len(stamps)} time stamps, expected {NUM_STEPS} ({OBSERVED_STEPS} in test_obs)")
    apart_s = np.diff(stamps)
    if not (_MEAN_S[0] <= apart_s.mean() <= _MEAN_S[1] and apart_s.max() <= _MOST_S):
        said = f"time stamps {apart_s.mean():.3f} s apart in the mean and {apart_s.max():.3f} s at most"
        raise ScenarioError(f"{name}: {said}, expected about {STEP_S} s and at most {_MOST_S} s")


def motion_of(position: FloatArray, timestep: IntArray, graph: LaneGraph) -> tuple[FloatArray, FloatArray]:
    """Velocities (N, 2) m/s and headings (N,) rad in (-pi, pi] of a track from its positions (N, 2) m."""
    breaks = np.flatnonzero(np.diff(timestep) != 1) + 1
    velocity = np.vstack([velocity_of(run, _SAMPLES, step_s=STEP_S, shortest=5) for run in np.split(position, breaks)])
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    away_m = float(np.hypot(*(position - position[0]).T).max())
    moves = np.flatnonzero(speed >= _MOVES_MPS) if away_m >= _MOVES_M else np.empty(0, dtype=np.int64)
    if not len(moves):
        return velocity, np.full(len(position), _lane_heading(graph, position.mean(axis=0)))
    last = np.maximum(np.searchsorted(moves, np.arange(len(position)), side="right") - 1, 0)
    moving = velocity[moves[last]]
    return velocity, np.arctan2(moving[:, 1], moving[:, 0])


def _lane_heading(graph: LaneGraph, point: FloatArray) -> float:
    """Direction of the nearest lane at a point (2,) m."""
    lines = [lane.centerline for lane in graph.lanes.values()]
    steps = np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in lines])
    start, end = steps[shapely.distance(shapely.linestrings(steps), shapely.Point(point)).argmin()]
    return math.atan2(*(end - start)[::-1])


# Maps


def _map(path: Path, rows: pd.DataFrame, name: str) -> tuple[LaneGraph, bytes | None]:
    """Lane graph, and the document that is written for it; None for a map of Argoverse 2, which is copied."""
    if path.is_file():
        return read_source_map(path), None
    city, position = rows.CITY_NAME.iloc[0], rows[["X", "Y"]].to_numpy()
    vector = only_file(path, f"pruned_argoverse_{city}_*_vector_map.xml", MapError)
    number = vector.name.split("_")[3]
    pixels, se2 = (only_file(path, f"{city}_{number}_{what}_*.npy", MapError) for what in _RASTERS)
    lanes = _city_lanes(read_received(vector, MapError, wanted="the map of a city", most_mb=limits.MAX_CITY_MB), vector)
    raster = drivable_raster(_array(pixels), _array(se2), name=str(pixels), se2_name=str(se2))
    low, high = position.min(axis=0) - _MARGIN_M, position.max(axis=0) + _MARGIN_M
    if not (high - low).max() <= limits.MAX_EXTENT_M:
        spread = (high - low).max() - 2 * _MARGIN_M
        raise ScenarioError(f"{name}: tracks spread over {spread:.6g} m, expected at most {limits.MAX_EXTENT_M:.0f} m")
    document = cut_city(lanes, raster, low=low, high=high, name=str(vector))
    return graph_of(document, name=str(vector)), json.dumps(document).encode()


@lru_cache(maxsize=2)  # a city-wide map is read once by each process
def _city_lanes(content: bytes, path: Path) -> dict[int, CityLane]:
    return read_city_lanes(content, name=str(path))


def _array(path: Path) -> npt.NDArray[np.generic]:
    """The array of an npy file; objects, which could be anything, are refused. Errors: MapError."""
    try:
        content = io.BytesIO(read_received(path, MapError, wanted="an npy file", most_mb=limits.MAX_CITY_MB))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of headers that Python 2 wrote
            return np.asarray(np.lib.format.read_array(content, allow_pickle=False))
    except (EOFError, KeyError, MemoryError, OverflowError, SyntaxError, TokenError, TypeError, ValueError) as error:
        raise MapError(f"{path}: not an npy file of numbers ({one_line(str(error), most=200)})") from error


# Sequences out


def write_sequence(scenario: Recording, generated: Sequence[Track], out_dir: Path, *, new_id: str) -> Path:
    """Write the sequence of a scene that was made from one; returns its path. Errors: ExportError."""
    if scenario.sequence is None:
        raise ExportError(f"{scenario.folder}: no Argoverse 1 sequence, expected one to write one")
    path = sequence_path(out_dir, scenario.split, new_id)
    content = sequence_bytes(scenario.sequence, [(track.timesteps, track.position) for track in generated])
    with beside(path) as hidden:
        hidden.write_bytes(content)
    return path


def sequence_bytes(recorded: bytes, inserted: Iterable[tuple[IntArray, FloatArray]]) -> bytes:
    """Recorded lines, and behind those of each time stamp the inserted vehicles. inserted: steps and positions, m.

    Errors: ExportError where one of their TRACK_IDs is taken.
    """
    lines = recorded.decode("ascii").splitlines(keepends=True)
    ending = "\r\n" if lines[0].endswith("\r\n") else "\n"
    lines[-1] = lines[-1].rstrip("\r\n") + ending
    rows = list(csv.reader(lines, quoting=csv.QUOTE_NONE))
    at = {column: rows[0].index(column) for column in COLUMNS}
    last = {float(row[at["TIMESTAMP"]]): line for line, row in enumerate(rows[1:], start=1)}
    of_step = [last[stamp] for stamp in sorted(last)]
    taken = {row[at["TRACK_ID"]] for row in rows[1:]}
    behind: list[list[str]] = [[] for _ in lines]
    for number, (steps, places) in enumerate(inserted):
        name = f"{INSERTED}{number:012d}"
        if name in taken:
            raise ExportError(f"TRACK_ID {name} is taken in the sequence, expected it free for gen_{number}")
        for step, (x, y) in zip(steps.tolist(), places.tolist(), strict=True):
            same = {name: rows[of_step[step]][at[name]] for name in ("TIMESTAMP", "CITY_NAME")}
            values = {**same, "TRACK_ID": name, "OBJECT_TYPE": OTHERS, "X": repr(x), "Y": repr(y)}
            behind[of_step[step]].append(",".join(values[column] for column in rows[0]) + ending)
    return "".join(part for line, ours in zip(lines, behind, strict=True) for part in (line, *ours)).encode("ascii")
