"""What a recorded scene may be at most: anything beyond is refused at reading, in one line.

A real scene is far below each of these (the figures are those of Argoverse 2's motion-forecasting scenes). They are
there so that a file from anywhere costs bounded time and memory: what follows grows with the cells of the map, the
pairs of tracks, and the ground that both lie on.
"""

from collections.abc import Sequence

import numpy as np

from bridge.files import MAX_FILE_MB as MAX_FILE_MB
from hid2.agents import FloatArray, Track
from netconvert.errors import ScenarioError
from netconvert.lane_graph import LaneGraph

#: Each map file of a whole city, MB.
MAX_CITY_MB = 128
#: A sidecar, MB. Real: 0.11 with 62 vehicles. What is read of JSON takes up to 400 times the memory of the file.
MAX_SIDECAR_MB = 2
#: Parquet: rows, columns, and bytes that the columns unpack to, MB. Real: 10,000 rows, 18 columns, 2 MB.
MAX_ROWS, MAX_COLUMNS, MAX_TABLE_MB = 200_000, 200, 256
#: Timesteps of a synthetic corridor: an hour.
MAX_CORRIDOR_STEPS = 36_000
#: Tracks of a scene. Real: below 300.
MAX_TRACKS = 2_000
#: Length of an id or a name in a scene, characters. Real: 36.
MAX_NAME = 200
#: Lane segments and drivable areas of a map, and points of one line of it. Real: below 400, 50 and 3,000.
MAX_LANES, MAX_AREAS, MAX_POINTS = 3_000, 1_000, 20_000
#: A lane, and all lanes of a map together, m. Real: 200 and 15,000.
MAX_LANE_M, MAX_LANES_M = 5_000.0, 100_000.0
#: Width and height of the ground that the map and all tracks lie on, m. Real: below 1,000.
MAX_EXTENT_M = 10_000.0
#: Distance from the origin, m: UTM coordinates are below.
MAX_COORDINATE_M = 1e7
#: Speed of anything, m/s: the format's fastest trains are below 100.
MAX_SPEED_MPS = 1_000.0
#: Lane ids are 64-bit integers with a sign.
MAX_LANE_ID = 2**63 - 1


def too_large(graph: LaneGraph) -> str:
    """What of a map is too large for a scene, with lane, value and limit; "" where nothing is."""
    lanes, rings = list(graph.lanes.values()), graph.drivable_areas
    lines, lane_ids = list(rings), {lane.lane_id for lane in lanes}
    sizes: list[tuple[str, float, float]] = [("lane segments", len(lanes), MAX_LANES)]
    sizes.append(("drivable areas", len(rings), MAX_AREAS))
    sizes += [("points of a drivable area", len(ring), MAX_POINTS) for ring in rings]
    for lane in lanes:
        own, where = (lane.centerline, *lane.sides), f"lane {lane.lane_id}"
        sizes += [(f"{where}: points of a line", len(line), MAX_POINTS) for line in own]
        sizes.append((f"{where}: length, m", lane.length_m, MAX_LANE_M))
        lines += own
        lane_ids |= {*lane.successors, lane.left_neighbor_id or 0, lane.right_neighbor_id or 0}
    sizes.append(("length of all lanes, m", sum(lane.length_m for lane in lanes), MAX_LANES_M))
    most = max(lane_ids, key=abs)
    if abs(most) > MAX_LANE_ID:
        return f"lane id {str(most)[:40]}, expected an integer of 64 bit"
    beyond = (f"{what}: {size:.0f}, expected at most {limit:.0f}" for what, size, limit in sizes if not size <= limit)
    return next(beyond, "") or _extent_breach(lines)


def check_ground(tracks: Sequence[Track], graph: LaneGraph, name: str) -> None:
    """Refuse tracks that do not lie on the ground of the map. Errors: ScenarioError with track and value."""
    ends = np.array(graph.bounds)
    for track in tracks:
        if said := _extent_breach([ends, track.position]):
            raise ScenarioError(f"{name}: track {track.track_id!r} and the map: {said}")


def _extent_breach(lines: Sequence[FloatArray]) -> str:
    points = np.concatenate(lines)
    low, high = points.min(axis=0), points.max(axis=0)
    with np.errstate(over="ignore"):  # of coordinates near the largest double: infinity is too far as well
        (x, y), far = high - low, float(np.abs([low, high]).max())
    if not max(x, y) <= MAX_EXTENT_M:
        return f"spread over {x:.6g} x {y:.6g} m, expected at most {MAX_EXTENT_M:.0f} m each way"
    if far > MAX_COORDINATE_M:
        return f"a coordinate of {far:.6g} m, expected at most {MAX_COORDINATE_M:.0e} m"
    return ""
