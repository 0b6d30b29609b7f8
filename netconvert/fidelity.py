"""How faithfully a SUMO net shows the lane graph that it was made from, measured on the net's XML."""

from collections import Counter
from dataclasses import dataclass
from itertools import pairwise

import shapely
from lxml import etree

from netconvert.cells import CellGrid
from netconvert.lane_graph import REASON_OPPOSITE, SIDES, DroppedLink

#: The reason of a link that is missing although nothing stood against it: a defect of the conversion.
UNEXPLAINED = "no reason known"


@dataclass(frozen=True, slots=True)
class FidelityReport:
    """What of a map is in its net. A link is counted once for each lane that states it."""

    lanes_in: int
    """Lane segments of the map."""
    lanes_out: int
    """Lane segments that have at least one cell in the net."""
    cells_out: int
    """SUMO lanes."""
    edges_out: int
    """SUMO edges: rows of facing cells."""
    largest_distance_m: float
    """Hausdorff distance between a lane's centreline and its SUMO lanes, the largest of all lanes."""
    farthest_lane_id: int | None
    """The lane it was found at."""
    successors_in: int
    successors_kept: int
    neighbors_in: int
    """Links to neighbours that run the same way, or that are not in the map, so that it is unknown."""
    neighbors_kept: int
    oncoming: int
    """Neighbour links to lanes that run the opposite way, which are none of the grid's."""
    lost: tuple[DroppedLink, ...]
    """Every successor and same-direction neighbour link that is not in the net, and why."""

    def rows(self) -> list[tuple[str, str]]:
        """The report as a table of two columns."""
        at = "" if self.farthest_lane_id is None else f" (lane {self.farthest_lane_id})"
        table = [
            ("lanes in / with cells", f"{self.lanes_in} / {self.lanes_out}"),
            ("cells out (SUMO lanes)", str(self.cells_out)),
            ("rows out (SUMO edges)", str(self.edges_out)),
            ("largest distance from the centreline", f"{self.largest_distance_m:.4f} m{at}"),
            ("successor links kept", f"{self.successors_kept} of {self.successors_in}"),
            ("same-direction neighbour links kept", f"{self.neighbors_kept} of {self.neighbors_in}"),
            ("oncoming neighbours, not linked", str(self.oncoming)),
        ]
        table += [
            (f"lost: {kind.replace('_', ' ')}", f"{count} x {reason}")
            for (kind, reason), count in sorted(Counter((link.kind, link.reason) for link in self.lost).items())
        ]
        return table


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
    links = [
        tuple(f"{link.get(end)}_{link.get(f'{end}Lane')}" for end in ("from", "to"))
        for link in root.iterfind("connection")
    ]
    within = [(source, target) for source, target in links if lane_of.get(source) == lane_of.get(target)]
    left, reached = {source for source, _ in within}, {target for _, target in within}
    joined = {
        (lane_of.get(source), lane_of.get(target))
        for source, target in links
        if source not in left and target not in reached
    }
    distances = {}
    for lane_id, lines in drawn.items():
        line = shapely.LineString(graph.lanes[lane_id].centerline)
        distances[lane_id] = float(shapely.hausdorff_distance(shapely.MultiLineString(lines), line))
    farthest = max(distances, key=distances.__getitem__, default=None)

    reasons = {(link.kind, link.source, link.target): link.reason for link in grid.lost_links}
    lost = []
    counts: Counter[tuple[str, str]] = Counter()
    for lane_id, lane in graph.lanes.items():
        stated = [("successor", target) for target in dict.fromkeys(lane.successors)]
        stated += [(f"{side}_neighbor", beside) for side in SIDES if (beside := lane.neighbor_id(side)) is not None]
        for kind, target in stated:
            reason = reasons.get((kind, lane_id, target), UNEXPLAINED)
            pair = (target, lane_id) if kind == "right_neighbor" else (lane_id, target)
            kept = pair in (joined if kind == "successor" else rows)
            what = "oncoming" if reason == REASON_OPPOSITE else "kept" if kept else "lost"
            counts[kind.split("_")[-1], what] += 1
            if what == "lost":
                lost.append(DroppedLink(kind, lane_id, target, reason))
    return FidelityReport(
        lanes_in=len(graph.lanes),
        lanes_out=len(drawn),
        cells_out=len(lane_of),
        edges_out=sum(1 for _ in root.iterfind("edge")),
        largest_distance_m=0.0 if farthest is None else distances[farthest],
        farthest_lane_id=farthest,
        successors_in=counts["successor", "kept"] + counts["successor", "lost"],
        successors_kept=counts["successor", "kept"],
        neighbors_in=counts["neighbor", "kept"] + counts["neighbor", "lost"],
        neighbors_kept=counts["neighbor", "kept"],
        oncoming=counts["neighbor", "oncoming"],
        lost=tuple(lost),
    )
