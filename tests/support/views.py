"""Agents by the lanes that they drive, and what others are to a vehicle that drives along a line."""

from hid2.agents import BoxSize
from hid2.measures.arrays import SceneArrays
from hid2.measures.driven_lanes import LaneView
from hid2.measures.lane_matching import flatten_lanes, match_lanes
from hid2.motion.reference_line import ReferenceLine
from hid2.occupancy.along_path import PathOccupancy, path_occupancy
from hid2.occupancy.traffic import Traffic
from netconvert.lane_graph import LaneGraph

#: Box of the vehicle itself, and of others where they are given it too, m.
SIZE = BoxSize(4.0, 2.0)


def occupancy_of(line: ReferenceLine, traffic: Traffic, *, margin_m: float = 0.0) -> PathOccupancy:
    """Intervals of others for a box of SIZE."""
    return path_occupancy(line, traffic, SIZE, margin_m=margin_m)


def lane_view(arrays: SceneArrays, graph: LaneGraph) -> LaneView:
    """Agents matched to the lanes of a map."""
    lanes = flatten_lanes(graph)
    return LaneView(arrays, lanes, match_lanes(arrays, lanes))
