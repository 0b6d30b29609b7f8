"""How faithfully a SUMO net shows the lane graph that it was made from, measured on the net's XML."""

from collections import Counter
from dataclasses import dataclass
from itertools import pairwise

import shapely
from lxml import etree

from netconvert.cells import CellGrid
from netconvert.errors import NetError
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
    """Compare a grid's lane graph with the net written from it, reading the net's XML afresh.

    Errors: NetError if the net is not XML or has a lane without av2.lane_segment_id.
    """
    graph = grid.graph
    try:
        root = etree.fromstring(net)
    except etree.XMLSyntaxError as error:
        raise NetError(f"the net is not XML: {error}") from error
    lane_of, shapes, beside = _lanes(root)
    next_of: dict[str, set[str]] = {}
    for link in root.iterfind("connection"):
        source = f"{link.get('from')}_{link.get('fromLane')}"
        next_of.setdefault(source, set()).add(f"{link.get('to')}_{link.get('toLane')}")

    chains = _chains(lane_of, next_of)
    distances = {}
    for lane_id, chain in chains.items():
        drawn = shapely.LineString([point for sumo_id in chain for point in shapes[sumo_id]])
        line = shapely.LineString(graph.lanes[lane_id].centerline)
        distances[lane_id] = float(shapely.hausdorff_distance(drawn, line))
    farthest = max(distances, key=distances.__getitem__, default=None)

    reasons = {(link.kind, link.source, link.target): link.reason for link in grid.lost_links}
    lost: list[tuple[str, int, int]] = []
    counts: Counter[str] = Counter()
    for lane_id, lane in graph.lanes.items():
        ends = next_of.get(chains[lane_id][-1], set()) if lane_id in chains else set()
        for target in dict.fromkeys(lane.successors):
            counts["successors"] += 1
            if target in chains and chains[target][0] in ends:
                counts["successors kept"] += 1
            else:
                lost.append(("successor", lane_id, target))
        for side in SIDES:
            neighbor = lane.neighbor_id(side)
            if neighbor is None:
                continue
            kind = f"{side}_neighbor"
            if reasons.get((kind, lane_id, neighbor)) == REASON_OPPOSITE:
                counts["oncoming"] += 1
                continue
            counts["neighbors"] += 1
            if ((lane_id, neighbor) if side == "left" else (neighbor, lane_id)) in beside:
                counts["neighbors kept"] += 1
            else:
                lost.append((kind, lane_id, neighbor))
    return FidelityReport(
        lanes_in=len(graph.lanes),
        lanes_out=len(chains),
        cells_out=len(lane_of),
        edges_out=sum(1 for _ in root.iterfind("edge")),
        largest_distance_m=0.0 if farthest is None else distances[farthest],
        farthest_lane_id=farthest,
        successors_in=counts["successors"],
        successors_kept=counts["successors kept"],
        neighbors_in=counts["neighbors"],
        neighbors_kept=counts["neighbors kept"],
        oncoming=counts["oncoming"],
        lost=tuple(DroppedLink(*link, reasons.get(link, UNEXPLAINED)) for link in lost),
    )


def _lanes(
    root: etree._Element,
) -> tuple[dict[str, int], dict[str, list[list[float]]], set[tuple[int, int]]]:
    """Of a net's lanes by id: the lane segment and the shape; and the pairs of segments that lie side by side."""
    lane_of: dict[str, int] = {}
    shapes: dict[str, list[list[float]]] = {}
    beside: set[tuple[int, int]] = set()
    for edge in root.iterfind("edge"):
        members = []
        for element in sorted(edge.iterfind("lane"), key=lambda lane: int(lane.get("index", ""))):
            sumo_id = element.get("id", "")
            param = element.find("param[@key='av2.lane_segment_id']")
            if param is None:
                raise NetError(f"net lane {sumo_id} has no parameter av2.lane_segment_id")
            lane_of[sumo_id] = int(param.get("value", ""))
            shapes[sumo_id] = [[float(x) for x in point.split(",")] for point in element.get("shape", "").split()]
            members.append(lane_of[sumo_id])
        beside.update(pairwise(members))
    return lane_of, shapes, beside


def _chains(lane_of: dict[str, int], next_of: dict[str, set[str]]) -> dict[int, list[str]]:
    """SUMO lanes of each lane segment in driving direction: from the one that none of them leads to."""
    members: dict[int, list[str]] = {}
    for sumo_id, lane_id in lane_of.items():
        members.setdefault(lane_id, []).append(sumo_id)
    chains = {}
    for lane_id, sumo_ids in members.items():
        own = {lane: next((to for to in next_of.get(lane, ()) if lane_of[to] == lane_id), "") for lane in sumo_ids}
        chain = [lane for lane in sumo_ids if lane not in own.values()][:1]
        while chain and own[chain[-1]] and len(chain) <= len(sumo_ids):
            chain.append(own[chain[-1]])
        if len(chain) != len(sumo_ids):
            raise NetError(f"the net's lanes of lane segment {lane_id} are not one chain: {', '.join(sumo_ids)}")
        chains[lane_id] = chain
    return chains
