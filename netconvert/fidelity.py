"""How faithfully a SUMO net shows the lane graph that it was made from, measured on the net's XML."""

from collections import Counter
from itertools import pairwise
from typing import NamedTuple

import shapely
from lxml import etree

from netconvert.cells import CellGrid
from netconvert.lane_graph import REASON_OPPOSITE, SIDES, DroppedLink

#: Reason of a link that is missing although nothing stood against it: a defect of the conversion.
UNEXPLAINED = "no reason known"


class FidelityReport(NamedTuple):
    """What of a map is in its net. A link is counted once for each lane that states it.

    lanes: segments of the map; lanes_in_net: those with a cell at least; cells: SUMO lanes; edges: SUMO edges, rows of
    facing cells; largest_distance_m: Hausdorff, of a lane's centreline and its SUMO lanes, the largest of all lanes;
    links: how many are kept, lost and, of neighbours that run the opposite way and are none of the grid's, oncoming, by
    "successor" or "neighbor"; lost: every link that is not in the net, and why.
    """

    lanes: int
    lanes_in_net: int
    cells: int
    edges: int
    largest_distance_m: float
    links: Counter[tuple[str, str]]
    lost: tuple[DroppedLink, ...]

    def rows(self) -> list[tuple[str, str]]:
        """The report as a table of two columns."""
        kept = {
            kind: f"{self.links[kind, 'kept']} of {self.links[kind, 'kept'] + self.links[kind, 'lost']}"
            for kind in ("successor", "neighbor")
        }
        table = [
            ("lanes in / with cells", f"{self.lanes} / {self.lanes_in_net}"),
            ("cells out (SUMO lanes)", str(self.cells)),
            ("rows out (SUMO edges)", str(self.edges)),
            ("largest distance from the centreline", f"{self.largest_distance_m:.4f} m"),
            ("successor links kept", kept["successor"]),
            ("same-direction neighbour links kept", kept["neighbor"]),
            ("oncoming neighbours, not linked", str(self.links["neighbor", "oncoming"])),
        ]
        lost = sorted(Counter((link.kind.replace("_", " "), link.reason) for link in self.lost).items())
        return table + [(f"lost: {kind}", f"{count} x {reason}") for (kind, reason), count in lost]


def measure_fidelity(grid: CellGrid, net: bytes) -> FidelityReport:
    """Compare a grid's lane graph with the net written from it, reading the net's XML afresh."""
    graph, root = grid.graph, etree.fromstring(net)
    lane_of: dict[str, int] = {}
    drawn: dict[int, list[list[list[float]]]] = {}
    rows: set[tuple[int, int]] = set()
    for edge in root.iterfind("edge"):
        members = [int(param.get("value", "")) for param in edge.iterfind("lane/param")]
        for element, lane_id in zip(edge.iterfind("lane"), members, strict=True):
            lane_of[element.get("id", "")] = lane_id
            points = [[float(x) for x in point.split(",")] for point in element.get("shape", "").split()]
            drawn.setdefault(lane_id, []).append(points)
        rows.update(pairwise(members))
    ends = [
        [f"{one.get(end)}_{one.get(f'{end}Lane')}" for end in ("from", "to")] for one in root.iterfind("connection")
    ]
    within = [(source, target) for source, target in ends if lane_of.get(source) == lane_of.get(target)]
    left, reached = {source for source, _ in within}, {target for _, target in within}
    joined = {  # from the last cell of a lane to the first one of another
        (lane_of.get(source), lane_of.get(target))
        for source, target in ends
        if source not in left and target not in reached
    }
    apart_m = [
        shapely.hausdorff_distance(shapely.MultiLineString(lines), shapely.LineString(graph.lanes[lane_id].centerline))
        for lane_id, lines in drawn.items()
    ]
    reasons = {(link.kind, link.source, link.target): link.reason for link in grid.lost_links}
    lost = []
    links: Counter[tuple[str, str]] = Counter()
    for lane_id, lane in graph.lanes.items():
        stated = [("successor", target) for target in dict.fromkeys(lane.successors)]
        stated += [(f"{side}_neighbor", beside) for side in SIDES if (beside := lane.neighbor_id(side)) is not None]
        for kind, target in stated:
            reason = reasons.get((kind, lane_id, target), UNEXPLAINED)
            pair = (target, lane_id) if kind == "right_neighbor" else (lane_id, target)
            kept = pair in (joined if kind == "successor" else rows)
            what = "oncoming" if reason == REASON_OPPOSITE else "kept" if kept else "lost"
            links[kind.split("_")[-1], what] += 1
            if what == "lost":
                lost.append(DroppedLink(kind, lane_id, target, reason))
    sizes = len(graph.lanes), len(drawn), len(lane_of), len(root.findall("edge"))
    return FidelityReport(*sizes, float(max(apart_m, default=0.0)), links, tuple(lost))
