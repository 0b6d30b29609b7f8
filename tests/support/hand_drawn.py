"""Lanes, boxes and tracks drawn by hand, for tests that need a road and no map: in metres, along +x unless bent."""

import itertools
from collections.abc import Sequence

import numpy as np

from hid2.agents import BoxSize, FloatArray, Track
from hid2.occupancy.traffic import Traffic
from netconvert.geometry import Polyline
from netconvert.lane_graph import LaneGraph, LaneSegment, turn_type

SMALL_CAR = BoxSize(4.0, 2.0)


def draw_lane(
    lane_id: int,
    points: Sequence[Sequence[float]],
    *,
    successors: tuple[int, ...] = (),
    left: int | None = None,
    right: int | None = None,
    lane_type: str = "VEHICLE",
    is_intersection: bool = False,
    left_mark: str = "DASHED_WHITE",
    right_mark: str = "DASHED_WHITE",
    width_m: float = 3.5,
) -> LaneSegment:
    """A lane segment along points (m), half a width to both sides; left, right: ids of its neighbours."""
    path = Polyline(np.array(points, dtype=np.float64))
    return LaneSegment(
        lane_id=lane_id,
        centerline=path.points,
        left_boundary=path.xy(path.s, width_m / 2.0),
        right_boundary=path.xy(path.s, -width_m / 2.0),
        lane_type=lane_type,
        is_intersection=is_intersection,
        successors=successors,
        left_neighbor_id=left,
        right_neighbor_id=right,
        left_mark_type=left_mark,
        right_mark_type=right_mark,
        width_m=width_m,
        turn=turn_type(path.points, is_intersection=is_intersection),
    )


def draw_road(*, lanes: int = 2, length_m: float = 200.0, mark: str = "DASHED_WHITE") -> LaneGraph:
    """Lanes 1, 2, ... along +x from the right, 3.5 m apart, lane 1 at y = 0, on drivable ground."""
    row = [
        draw_lane(
            i + 1,
            [(0.0, 3.5 * i), (length_m, 3.5 * i)],
            left=i + 2 if i + 1 < lanes else None,
            right=i if i else None,
            left_mark=mark,
            right_mark=mark,
        )
        for i in range(lanes)
    ]
    top = 3.5 * lanes - 1.75
    return graph_of(*row, ground=[(-20.0, -1.75), (length_m + 20.0, -1.75), (length_m + 20.0, top), (-20.0, top)])


def graph_of(*lanes: LaneSegment, ground: Sequence[Sequence[float]] | None = None) -> LaneGraph:
    """A map of lanes; ground: corners of its drivable area (none where it is left out)."""
    areas = () if ground is None else (np.array([*ground, ground[0]]),)
    return LaneGraph({one.lane_id: one for one in lanes}, drivable_areas=areas)


def draw_chain(*ends_m: float, crossing: int | None = None) -> LaneGraph:
    """Lanes 1, 2, ... along +x, each from where the one before ends; crossing: the one in an intersection."""
    lanes = []
    for k, (begin, end) in enumerate(itertools.pairwise((0.0, *ends_m)), start=1):
        after = (k + 1,) if k < len(ends_m) else ()
        lanes.append(draw_lane(k, [(begin, 0.0), (end, 0.0)], successors=after, is_intersection=k == crossing))
    return graph_of(*lanes)


def draw_box(
    x: float,
    y: float,
    heading: float = 0.0,
    speed: float = 0.0,
    *,
    steps: int = 110,
    first: int = 0,
    length_m: float = 4.5,
    width_m: float = 1.9,
    name: str = "a",
) -> Traffic:
    """One box that moves straight ahead at constant speed."""
    time = 0.1 * np.arange(steps)
    ahead = np.array([np.cos(heading), np.sin(heading)])
    return Traffic(
        ids=(name,),
        position=(np.array([x, y]) + speed * time[:, None] * ahead)[None],
        heading=np.full((1, steps), heading),
        velocity=np.broadcast_to(speed * ahead, (1, steps, 2)).copy(),
        present=(np.arange(steps) >= first)[None],
        length_m=np.array([length_m]),
        width_m=np.array([width_m]),
    )


def draw_track(
    timesteps: Sequence[int],
    x: Sequence[float],
    y: Sequence[float] | float = 0.0,
    heading: Sequence[float] | float = 0.0,
    *,
    track_id: str = "t",
    object_type: str = "vehicle",
    category: int = 1,
    size: BoxSize | None = None,
) -> Track:
    """Track of a vehicle; velocity is not that of the positions."""
    count = len(timesteps)
    return Track(
        track_id=track_id,
        object_type=object_type,
        category=category,
        timesteps=np.array(timesteps, dtype=np.int64),
        position=np.column_stack([np.array(x, dtype=np.float64), np.broadcast_to(y, count)]),
        heading=np.broadcast_to(np.asarray(heading, dtype=np.float64), count).copy(),
        velocity=np.full((count, 2), 99.0),
        size=size or BoxSize(4.5, 1.9),
    )


def draw_driven(name: str, position: FloatArray, *, kind: str = "vehicle", size: BoxSize = SMALL_CAR) -> Track:
    """A track at positions (T, 2) m, a step of 0.1 s after the other, with velocity and heading along its motion."""
    velocity = np.gradient(position, 0.1, axis=0)
    heading = np.arctan2(velocity[:, 1], velocity[:, 0])
    return Track(name, kind, 1, np.arange(len(position)), position, heading, velocity, size)


def draw_crossing(*, end_m: float = 200.0, zebra: bool = False) -> LaneGraph:
    """Lanes 1 (0 .. 60 m), 2 (the intersection, 60 .. 80 m), 3 (to end_m) along the x axis; 4, 5, 6 cross at x = 70.

    zebra: a pedestrian crossing lies over lane 3 from x = 100 to 103 m.
    """
    lanes = (
        draw_lane(1, [(0.0, 0.0), (60.0, 0.0)], successors=(2,)),
        draw_lane(2, [(60.0, 0.0), (80.0, 0.0)], successors=(3,), is_intersection=True),
        draw_lane(3, [(80.0, 0.0), (end_m, 0.0)]),
        draw_lane(4, [(70.0, -90.0), (70.0, -10.0)], successors=(5,)),
        draw_lane(5, [(70.0, -10.0), (70.0, 10.0)], successors=(6,), is_intersection=True),
        draw_lane(6, [(70.0, 10.0), (70.0, 90.0)]),
    )
    stripes = np.array([(100.0, -6.0), (100.0, 6.0), (103.0, 6.0), (103.0, -6.0)])
    return LaneGraph({one.lane_id: one for one in lanes}, pedestrian_crossings=(stripes,) if zebra else ())


def draw_two_lanes(length_m: float = 300.0) -> LaneGraph:
    """Lane 1 at y = 0, lane 2 to its left at y = 3.5, on drivable ground."""
    ground = [(-20.0, -3.0), (length_m + 20.0, -3.0), (length_m + 20.0, 7.0), (-20.0, 7.0)]
    return graph_of(*draw_road(length_m=length_m).lanes.values(), ground=ground)
