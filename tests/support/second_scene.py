"""A scene folder as the second checker reads it: tracks with boxes, the sidecar as plain JSON, the map.

Decisions: without a sidecar the tracks gen_* are the inserted ones; a size is the sidecar's (its agents, then its
recording.sizes), else the one in agent_sizes.csv beside the source or the scene, else the object type's of method.md.
"""

import json
import math
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import shapely
from second_map import Bools, Floats, Line, SecondMap, box_corners, line_of

DT_S = 0.1
#: Length and width by object type, m: method.md, "Vehicle sizes".
TYPE_SIZES = {
    "vehicle": (4.5, 1.9), "bus": (11.0, 2.8), "motorcyclist": (2.2, 0.9), "cyclist": (1.8, 0.6),
    "riderless_bicycle": (1.6, 0.5), "pedestrian": (0.6, 0.6),
}  # fmt: skip
SMALL_THING = (0.8, 0.8)
#: What drives in lanes: leaders, followers, and both sides of a PET.
DRIVEN_TYPES = ("vehicle", "bus", "motorcyclist", "cyclist")
#: A difference of positions that is so far off the stated velocity is a jump of the tracker, m/s.
JUMP_MPS = 10.0
#: A heading at a track's end that is so far off the course over the last steps is noise, degrees.
END_DEG, END_STEPS = 20.0, 10
#: A track moves that has a longer path than this, m, and is seen at more steps than that.
MOVES_M, MOVES_STEPS = 5.0, 10


@dataclass(frozen=True, eq=False)
class SecondTrack:
    """One track. steps: (T,); xy, velocity: (T, 2) m and m/s; heading: (T,) rad."""

    track_id: str
    object_type: str
    category: int
    steps: npt.NDArray[np.int64]
    xy: Floats
    heading: Floats
    velocity: Floats
    length_m: float
    width_m: float

    @cached_property
    def row_of(self) -> dict[int, int]:
        return {int(step): row for row, step in enumerate(self.steps)}

    @cached_property
    def moved(self) -> Floats:
        """(T, 2) m/s by differences of the positions, central but at the ends.

        As stated where there is one position alone, and where a tracker jumps by metres.
        """
        velocity = self.velocity.copy()
        for rows in self.runs:
            if rows.stop - rows.start > 1:
                moved = np.gradient(self.xy[rows], DT_S, axis=0)
                jumps = np.hypot(*(moved - velocity[rows]).T) > JUMP_MPS
                velocity[rows] = np.where(jumps[:, None], velocity[rows], moved)
        return velocity

    @cached_property
    def corners(self) -> Floats:
        """(T, 4, 2) m."""
        return box_corners(self.xy, self.heading, self.length_m, self.width_m)

    @cached_property
    def boxes(self) -> npt.NDArray[np.object_]:
        return np.asarray(shapely.polygons(self.corners))

    @cached_property
    def moves(self) -> bool:
        """Whether it drives over 5 m, straight from its first to its farthest place: noise of a tracker adds up.

        Pieces of a second or less are none, as in the definition of moving tracks beside the data.
        """
        return len(self.steps) > MOVES_STEPS and float(np.hypot(*(self.xy - self.xy[0]).T).max()) > MOVES_M

    @property
    def runs(self) -> list[slice]:
        """Rows without a gap in time between them."""
        ends = np.flatnonzero(np.diff(self.steps) != 1) + 1
        return [slice(a, b) for a, b in zip((0, *ends), (*ends, len(self.steps)), strict=True)]


@dataclass(frozen=True, eq=False)
class DrivenLine:
    """The path that a track drives and, beyond its last step, the lanes ahead. own_m: (T,) m, its place on it."""

    line: Line
    own_m: Floats
    driven_m: float


@dataclass(eq=False)
class SecondScene:
    """Everything that is judged of one folder."""

    scenario_id: str
    tracks: list[SecondTrack]
    inserted_ids: list[str]
    ground: SecondMap
    sidecar: dict[str, Any]
    _lines: dict[str, DrivenLine | None] = field(default_factory=dict)
    _lanes: dict[SecondTrack, set[int]] = field(default_factory=dict)
    least_ttc: dict[SecondTrack, dict[int, tuple[float, int]]] = field(default_factory=dict)

    @cached_property
    def by_id(self) -> dict[str, SecondTrack]:
        return {track.track_id: track for track in self.tracks}

    @property
    def inserted(self) -> list[SecondTrack]:
        return [self.by_id[track_id] for track_id in self.inserted_ids if track_id in self.by_id]

    @cached_property
    def agents(self) -> dict[str, dict[str, Any]]:
        return {agent["track_id"]: agent for agent in self.sidecar.get("agents", ())}

    @cached_property
    def owner(self) -> npt.NDArray[np.int64]:
        """(R,) index of the track of every row of the scene; the rows of xy_all and of corners_all."""
        return np.repeat(np.arange(len(self.tracks)), [len(track.steps) for track in self.tracks])

    @cached_property
    def step_all(self) -> npt.NDArray[np.int64]:
        return np.concatenate([track.steps for track in self.tracks])

    @cached_property
    def xy_all(self) -> Floats:
        return np.concatenate([track.xy for track in self.tracks])

    @cached_property
    def heading_all(self) -> Floats:
        return np.concatenate([track.heading for track in self.tracks])

    @cached_property
    def velocity_all(self) -> Floats:
        """By the positions."""
        return np.concatenate([track.moved for track in self.tracks])

    @cached_property
    def boxes_all(self) -> npt.NDArray[np.object_]:
        return np.concatenate([track.boxes for track in self.tracks])

    @cached_property
    def driven_all(self) -> Bools:
        """Rows of tracks of types that drive in lanes."""
        return np.array([track.object_type in DRIVEN_TYPES for track in self.tracks])[self.owner]

    @cached_property
    def moving_all(self) -> Bools:
        return np.array([track.moves for track in self.tracks])[self.owner]

    def lanes_of(self, track: SecondTrack) -> set[int]:
        """All lanes that a track is on at some time, with its heading."""
        if track not in self._lanes:
            self._lanes[track] = set().union(*self.ground.agreeing(track.xy, track.heading))
        return self._lanes[track]

    def driven_line(self, track: SecondTrack) -> DrivenLine | None:
        """The path of a track and 100 m of lane beyond; None for one that stands where no lane goes on."""
        if track.track_id not in self._lines:
            self._lines[track.track_id] = self._driven_line(track)
        return self._lines[track.track_id]

    def _driven_line(self, track: SecondTrack) -> DrivenLine | None:
        last = len(track.steps) - 1
        each = [np.arange(run.stop - run.start) for run in track.runs]  # no mean goes over a gap
        half = np.concatenate([np.minimum(np.minimum(run, run[::-1]), 2) for run in each])
        sums = np.vstack([np.zeros(2), np.cumsum(track.xy - track.xy[0], axis=0)])
        ends = np.arange(last + 1) + half + 1, np.arange(last + 1) - half
        path = track.xy[0] + (sums[ends[0]] - sums[ends[1]]) / (2 * half + 1)[:, None]  # raw tracks jitter by metres
        kept, rows = [path[0]], [0]
        for row, point in enumerate(path[1:], start=1):
            chord = path[min(row + 5, last)] - path[max(row - 5, 0)]
            if (point - kept[-1]) @ chord >= 0.2 * np.hypot(*chord) and chord.any():
                kept.append(point)
                rows.append(row)
        lengths = (
            np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(kept, axis=0).T))]) if len(kept) > 1 else np.zeros(1)
        )
        place = np.searchsorted(rows, np.arange(len(track.steps)), side="right") - 1
        since = np.hypot(*(path - np.array(kept)[place]).T)
        most = np.append(np.diff(lengths), 0.2)[place]
        line = line_of(np.vstack([np.array(kept), self._way_on(track)]))
        return None if line is None else DrivenLine(line, lengths[place] + np.minimum(since, most), float(lengths[-1]))

    def _way_on(self, track: SecondTrack, *, ahead_m: float = 100.0) -> Floats:
        """Points beyond the last step: along its lane, its route and the straightest successors, at its own offset."""
        end, heading = track.xy[-1:], track.heading[-1:]
        came = track.xy[-1] - track.xy[max(-1 - END_STEPS, -len(track.xy))]
        course = np.arctan2(came[1:], came[:1])
        if np.hypot(*came) >= 1.0 and np.cos(course - heading)[0] < np.cos(math.radians(END_DEG)):
            heading = course
        route = [int(lane) for lane in self.agents.get(track.track_id, {}).get("route", ())]
        lanes = self.ground.agreeing(end, heading)[0]
        lane_id = max(lanes, key=lambda n: (n in route, -self.ground.off_lane_deg(n, end, heading)[0]), default=None)
        points: list[Floats] = []
        at, aside = 0.0, 0.0
        if lane_id is not None:
            s, d = self.ground.lanes[lane_id].line.project(end)
            at, aside = float(s[0]) + 1.0, float(d[0])
        left_m = ahead_m
        while lane_id is not None and left_m > 0.0:
            line = self.ground.lanes[lane_id].line
            where = np.arange(at, line.length_m, 1.0)
            xy, direction = line.at(where)
            points.append(xy + aside * np.column_stack([-np.sin(direction), np.cos(direction)]))
            left_m -= max(line.length_m - at, 0.1)
            at = max(at - line.length_m, 0.0)
            named = [n for n in self.ground.lanes[lane_id].successors if n in route and n in self.ground.lanes]
            lane_id = named[0] if named else self.ground.onward(lane_id)
        reached = np.vstack(points) if points else np.empty((0, 2))
        if len(reached):
            return reached
        return end + np.array([[1.0], [5.0]]) * np.column_stack([np.cos(heading), np.sin(heading)])


def read_scene(folder: Path, source: Path | None = None) -> SecondScene:
    """The scene of a folder. source: the folder of the recording it was made from, for its agent_sizes.csv."""
    (table_path,) = folder.glob("scenario_*.parquet")
    scenario_id = table_path.stem.removeprefix("scenario_")
    sidecar_path = folder / f"hid2_{scenario_id}.json"
    sidecar = json.loads(sidecar_path.read_text()) if sidecar_path.is_file() else {}
    sizes = _measured_sizes(folder) | (_measured_sizes(source) if source is not None else {})
    sizes |= {track_id: tuple(size) for track_id, size in ((sidecar.get("recording") or {}).get("sizes") or {}).items()}
    sizes |= {agent["track_id"]: (agent["length_m"], agent["width_m"]) for agent in sidecar.get("agents", ())}
    tracks = _tracks(pd.read_parquet(table_path), sizes)
    agents = [agent["track_id"] for agent in sidecar.get("agents", ())]
    inserted = agents if sidecar else [t.track_id for t in tracks if t.track_id.startswith("gen_")]
    (map_path,) = folder.glob("log_map_archive_*.json")
    return SecondScene(scenario_id, tracks, inserted, SecondMap(map_path), sidecar)


def _tracks(table: pd.DataFrame, sizes: dict[str, tuple[float, float]]) -> list[SecondTrack]:
    names, which = np.unique(table["track_id"].astype(str).to_numpy(object), return_inverse=True)
    step = table["timestep"].to_numpy(np.int64)
    order = np.lexsort((step, which))
    kinds = table["object_type"].to_numpy(object)
    categories = table["object_category"].to_numpy(np.int64)
    states = table[["position_x", "position_y", "heading", "velocity_x", "velocity_y"]].to_numpy(np.float64)
    tracks = []
    for name, rows in zip(names, np.split(order, np.cumsum(np.bincount(which))[:-1]), strict=True):
        kind = str(kinds[rows[0]])
        length, width = sizes.get(str(name), TYPE_SIZES.get(kind, SMALL_THING))
        own = states[rows]
        tracks.append(
            SecondTrack(
                str(name), kind, int(categories[rows[0]]), step[rows], own[:, :2], own[:, 2], own[:, 3:],
                float(length), float(width),
            )
        )  # fmt: skip
    return tracks


def _measured_sizes(folder: Path) -> dict[str, tuple[float, float]]:
    path = folder / "agent_sizes.csv"
    if not path.is_file():
        return {}
    table = pd.read_csv(path, dtype={"track_id": str})
    return {str(row.track_id): (float(row.length_m), float(row.width_m)) for row in table.itertuples()}
