"""Lane graphs as roads and junctions, as whole-lane nets and OpenDRIVE have them.

Lanes side by side are a road. Lanes of an intersection are ways through its junction, from the end of a road's lane to
the start of another's; those that begin or end at the map's edge lie on no way and are roads.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from netconvert.errors import NetError
from netconvert.lane_graph import LaneGraph, joined

#: Most ways from one lane through an intersection. Real maps: 6.
_MOST_WAYS = 200


@dataclass(frozen=True, slots=True)
class Way:
    """From the end of a road's lane to the start of another's, through the lanes of an intersection if any."""

    source: int
    target: int
    through: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class RoadGraph:
    """Roads, as lanes from the right; ways between lanes; the junctions at start (2 k) and end (2 k + 1) of road k."""

    rows: tuple[tuple[int, ...], ...]
    ways: tuple[Way, ...]
    junctions: tuple[int, ...]

    @cached_property
    def place(self) -> Mapping[int, tuple[int, int]]:
        """Road and index, from the right, of each lane that is a road's."""
        return {lane_id: (road, index) for road, row in enumerate(self.rows) for index, lane_id in enumerate(row)}

    @cached_property
    def ways_of(self) -> Mapping[int, tuple[Way, ...]]:
        """Ways through each junction that has any."""
        found: dict[int, list[Way]] = {}
        for way in self.ways:
            found.setdefault(self.junctions[2 * self.place[way.source][0] + 1], []).append(way)
        return {junction: tuple(ways) for junction, ways in found.items()}

    def joint(self, junction: int) -> tuple[int, int] | None:
        """The roads before and behind where all lanes of one simply go on as those of another; None elsewhere."""
        ends = sorted((k for k, at in enumerate(self.junctions) if at == junction), key=lambda end: end % 2 == 0)
        if len(ends) != 2:
            return None
        one, other = (end // 2 for end in ends)
        before, behind = self.rows[one], self.rows[other]
        straight = {Way(source, target, ()) for source, target in zip(before, behind, strict=False)}
        same = one != other and len(before) == len(behind) and straight == set(self.ways_of.get(junction, ()))
        return (one, other) if same else None


def roads_of(graph: LaneGraph, *, apart: Collection[int] = ()) -> RoadGraph:
    """The roads of a graph. apart: lanes that are roads of their own. Errors: NetError for endless ways from a lane."""
    lanes = graph.lanes
    inside = {i for i, lane in lanes.items() if lane.is_intersection and graph.predecessors(i) and graph.successors(i)}
    while True:
        rows = tuple(graph.rows(without=inside, apart=apart))
        begins = {lane_id: 2 * road for road, row in enumerate(rows) for lane_id in row}
        ways = [way for lane_id in begins for way in _ways(graph, lane_id, inside)]
        junctions = _joined(graph, ways, begins, 2 * len(rows))
        # A road within an intersection, from which it leads back into it, is a part of it.
        back = [row for road, row in enumerate(rows) if junctions[2 * road] == junctions[2 * road + 1]]
        loops = {i for row in back for i in row if graph.predecessors(i) and graph.successors(i)}
        if not loops:
            return RoadGraph(rows, tuple(dict.fromkeys(ways)), junctions)
        inside |= loops


def _joined(graph: LaneGraph, ways: Sequence[Way], begins: Mapping[int, int], count: int) -> tuple[int, ...]:
    """Ends of roads that are in one junction: by a way, by ways over the same lane, or by ways that cross."""
    pairs = []
    owner: dict[int, int] = {}
    for way in ways:
        target = begins[way.target]
        pairs.append((begins[way.source] + 1, target))
        pairs += [(owner.setdefault(lane_id, target), target) for lane_id in way.through]
    pairs += [(owner[one], owner[other]) for one in owner for other in graph.touching[one] if other in owner]
    return tuple(joined(count, pairs))


def _ways(graph: LaneGraph, lane_id: int, inside: Collection[int]) -> list[Way]:
    found: list[Way] = []
    stack: list[tuple[int, ...]] = [(lane_id,)]
    while stack:
        path = stack.pop()
        for target in graph.successors(path[-1]):
            if target not in inside:
                found.append(Way(lane_id, target, path[1:]))
            elif target not in path:
                stack.append((*path, target))
        if len(found) + len(stack) > _MOST_WAYS:
            raise NetError(f"lane {lane_id}: more than {_MOST_WAYS} ways from it through an intersection")
    return found
