"""Random maps, random traffic, random requests: whatever is generated breaks no rule of safety or motion.

Maps are drawn as a trunk of one to three lanes, straight or bent, cut into segments; it may split or merge at one end,
and another road may cross it. Traffic drives, stands, appears late, crosses on foot, and does not care about anybody.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import shapely
from hypothesis import HealthCheck, Phase, assume, given, settings
from hypothesis import strategies as st
from judged import check_generated

from bridge.generation.generate import generate
from bridge.recordings.map_rules import graph_of
from bridge.recordings.recording import Recording
from bridge.recordings.scenario import table_of
from hid2.agents import DEFAULT_SIZES, Track
from hid2.params import Config, Driving, Request, SourceChecks
from netconvert.lane_graph import LaneGraph

Floats = npt.NDArray[np.float64]
LANE_M = 3.5


@dataclass
class Draft:
    """A map in the making: points, links and marks by lane id."""

    points: dict[int, Floats] = field(default_factory=dict)
    successors: dict[int, list[int]] = field(default_factory=dict)
    left: dict[int, int] = field(default_factory=dict)
    crossing: set[int] = field(default_factory=set)
    solid: bool = False

    def add(self, points: Floats, *, crossing: bool = False) -> int:
        lane_id = len(self.points) + 1
        self.points[lane_id] = points
        self.successors[lane_id] = []
        if crossing:
            self.crossing.add(lane_id)
        return lane_id

    def document(self) -> dict[str, Any]:
        """The map as Argoverse 2 has it."""
        right = {target: source for source, target in self.left.items()}
        mark = "SOLID_WHITE" if self.solid else "DASHED_WHITE"
        segments = {
            str(lane_id): {
                "id": lane_id, "lane_type": "VEHICLE", "is_intersection": lane_id in self.crossing,
                "centerline": written(points), "left_lane_boundary": written(offset(points, LANE_M / 2)),
                "right_lane_boundary": written(offset(points, -LANE_M / 2)), "left_lane_mark_type": mark,
                "right_lane_mark_type": mark, "left_neighbor_id": self.left.get(lane_id),
                "right_neighbor_id": right.get(lane_id), "successors": self.successors[lane_id],
                "predecessors": [one for one, after in self.successors.items() if lane_id in after],
            }
            for lane_id, points in self.points.items()
        }  # fmt: skip
        ground = shapely.union_all(
            [shapely.LineString(points).buffer(LANE_M / 2 + 0.4) for points in self.points.values()]
        )
        areas = {
            str(number): {"id": number, "area_boundary": written(np.array(part.exterior.coords))}
            for number, part in enumerate(shapely.get_parts(ground))
        }
        return {"drivable_areas": areas, "lane_segments": segments, "pedestrian_crossings": {}}


def written(points: Floats) -> list[dict[str, float]]:
    """Points of a map's document."""
    return [{"x": x, "y": y, "z": 0.0} for x, y in points.tolist()]


def offset(base: Floats, by: float) -> Floats:
    """The line at a distance to the left of another."""
    direction = np.gradient(base, axis=0)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return base + by * np.column_stack([-direction[:, 1], direction[:, 0]])


def bent(length_m: float, curvature: float) -> Floats:
    """A line from the origin eastwards, of constant curvature, a point every 2 m."""
    s = np.linspace(0.0, length_m, int(length_m / 2) + 1)
    if abs(curvature) < 1e-6:
        return np.column_stack([s, np.zeros_like(s)])
    return np.column_stack([np.sin(curvature * s), 1 - np.cos(curvature * s)]) / curvature


def branch(start: Floats, toward: Floats, length_m: float, aside_m: float) -> Floats:
    """A line from a point along a direction that drifts aside smoothly, as ramps do."""
    u = np.linspace(0.0, 1.0, int(length_m / 2) + 1)
    normal = np.array([-toward[1], toward[0]])
    drift = aside_m * u * u * u * (10 + u * (6 * u - 15))
    return start + length_m * u[:, None] * toward + drift[:, None] * normal


@st.composite
def maps(draw: st.DrawFn) -> dict[str, Any]:
    draft = Draft(solid=draw(st.booleans()))
    count = draw(st.integers(1, 3))
    length = draw(st.sampled_from([120.0, 180.0, 240.0]))
    trunk = bent(length, draw(st.sampled_from([0.0, 0.0, 1 / 150, -1 / 80, 1 / 60])))
    pieces = draw(st.integers(1, 3))
    cuts = np.linspace(0, len(trunk) - 1, pieces + 1).astype(int)
    rows: list[list[int]] = []
    for piece in range(pieces):
        part = slice(cuts[piece], cuts[piece + 1] + 1)
        rows.append([draft.add(offset(trunk, LANE_M * i)[part]) for i in range(count)])
        for right, left in zip(rows[-1], rows[-1][1:], strict=False):
            draft.left[right] = left
        if piece:
            for before, after in zip(rows[-2], rows[-1], strict=True):
                draft.successors[before].append(after)
    if draw(st.booleans()):  # a split at the end of the rightmost lane
        last = draft.points[rows[-1][0]]
        toward = (last[-1] - last[-2]) / np.linalg.norm(last[-1] - last[-2])
        for aside in (0.0, -14.0):
            draft.successors[rows[-1][0]].append(draft.add(branch(last[-1], toward, 70.0, aside)))
    if draw(st.booleans()):  # a ramp that merges into the start of the rightmost lane
        first = draft.points[rows[0][0]]
        back = (first[0] - first[1]) / np.linalg.norm(first[1] - first[0])
        for aside in (0.0, 14.0):
            ramp = draft.add(branch(first[0], back, 70.0, aside)[::-1])
            draft.successors[ramp].append(rows[0][0])
    if draw(st.booleans()):  # a road that crosses
        middle = trunk[len(trunk) // 2]
        angle = draw(st.sampled_from([1.2, np.pi / 2, -2.0]))
        ahead = np.array([np.cos(angle), np.sin(angle)])
        along = np.linspace(-70.0, 70.0, 71)
        draft.add(middle + along[:, None] * ahead, crossing=True)
    return draft.document()


@st.composite
def traffic(draw: st.DrawFn, graph: LaneGraph, steps: int) -> tuple[Track, ...]:
    tracks = []
    for number in range(draw(st.integers(0, 8))):
        lane = graph.lanes[draw(st.sampled_from(sorted(graph.lanes)))]
        kind = draw(st.sampled_from(["vehicle", "vehicle", "vehicle", "bus", "cyclist", "pedestrian"]))
        speed = draw(st.sampled_from([0.0, 0.0, 1.5, 5.0, 9.0, 13.0])) if kind != "pedestrian" else 1.3
        start = draw(st.floats(0.0, 0.8)) * lane.length_m
        s = start + 0.1 * speed * np.arange(steps)
        first = draw(st.sampled_from([0, 0, 0, 30, 70])) % steps
        present = (s <= lane.length_m + 20.0) & (np.arange(steps) >= first)
        if present.sum() < 2:
            continue
        if kind == "pedestrian":
            at, heading = lane.path.xy(np.array([start]), 0.0)[0], float(lane.path.heading(np.array([start]))[0])
            across = np.array([-np.sin(heading), np.cos(heading)])
            position = at + (s - start - 6.0)[:, None] * across
            headings = np.full(steps, heading + np.pi / 2)
        else:
            position = lane.path.xy(s, draw(st.sampled_from([0.0, 0.0, 0.3, -0.6])))
            headings = lane.path.heading(np.minimum(s, lane.length_m))
        tracks.append(
            Track(
                str(number), kind, 1, np.flatnonzero(present), position[present], headings[present],
                np.gradient(position, 0.1, axis=0)[present], DEFAULT_SIZES[kind],
            )
        )  # fmt: skip
    return tuple(tracks)


@st.composite
def scenes(draw: st.DrawFn) -> Recording:
    document = draw(maps())
    graph = graph_of(document, name="map")
    steps = draw(st.sampled_from([50, 110, 110]))
    tracks = draw(traffic(graph, steps))
    assume(tracks)  # every recording has a focal track
    same = {
        "scenario_id": "0" * 8, "start_timestamp": 0.0, "end_timestamp": 0.1 * steps,
        "num_timestamps": steps, "focal_track_id": tracks[0].track_id, "city": "synthetic",
    }  # fmt: skip
    table = table_of(tracks, same, observed_steps=50)
    return Recording(
        scenario_id="0" * 8, city="synthetic", focal_track_id=tracks[0].track_id, num_steps=steps, tracks=tracks,
        graph=graph, table=table, folder=Path("nowhere"), map_path=Path("nowhere"), split=None,
        observed_steps=50, step_s=0.1, map_json=json.dumps(document).encode(),
    )  # fmt: skip


MIXES: tuple[dict[str, Any], ...] = (
    {},
    {"straight": 0, "lane_change": 1, "left_turn": 0, "right_turn": 0, "overtake": 0},
    {"straight": 0, "lane_change": 0.3, "left_turn": 0, "right_turn": 0, "overtake": 0.7, "bus_share": 0.3},
)


USUAL = settings(
    derandomize=True, database=None, deadline=None, max_examples=15, print_blob=True,
    phases=[Phase.explicit, Phase.generate], suppress_health_check=list(HealthCheck),
)  # fmt: skip
ANY_REQUEST = given(scene=scenes(), agents=st.integers(1, 14), mix=st.sampled_from(MIXES), seed=st.integers(0, 999))


def check(scene: Recording, agents: int, mix: dict[str, Any], seed: int) -> None:
    request, driving = Request(agents=agents, seed=seed, **mix), Driving(check_replay=True)
    generated = generate(scene, Config(source=SourceChecks(plausible=False), request=request, driving=driving))
    assert len(generated.generated) == generated.sidecar.placed.agents <= agents
    assert len({track.track_id for track in generated.generated}) == len(generated.generated)
    if len(generated.generated) < agents:
        assert generated.sidecar.rejected, "fewer than asked for, and no reason"
    assert check_generated(generated) == []


@USUAL
@ANY_REQUEST
def test_nothing_unsafe_is_ever_generated(scene: Recording, agents: int, mix: dict[str, Any], seed: int) -> None:
    check(scene, agents, mix, seed)


@pytest.mark.slow
@settings(USUAL, max_examples=200)
@ANY_REQUEST
def test_nothing_unsafe_is_generated_in_many(scene: Recording, agents: int, mix: dict[str, Any], seed: int) -> None:
    check(scene, agents, mix, seed)
