"""Entries: where and when vehicles may enter at the map's edge, and what they would meet from there."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import shapely

from hid2.insertion.flow import entry_lanes
from hid2.insertion.meetings import NEAR_WEIGHT, Meetings, Outlook
from hid2.insertion.routes import RouteOffer, Routes
from hid2.scene import ENTRY_STAYS_S, Scene
from netconvert.lane_graph import TurnType

#: Largest distance of a lane that begins at the map's edge to the hull of all lanes, m. No tunable: what the edge is.
_EDGE_M = 15.0


class Entry(NamedTuple):
    """From the beginning of a route, which lies at the map's edge, at a step."""

    offer: RouteOffer
    step: int


@dataclass(frozen=True, eq=False)
class Entries:
    """Entries of one scene."""

    scene: Scene
    routes: Routes
    meetings: Meetings

    def step(self, row: int, rng: np.random.Generator) -> int:
        """A step of an entry, drawn from its own to the one before the next look."""
        first, between = self.table[row].step, int(np.diff(self.meetings.looks[:2]).sum()) or 1
        return int(rng.integers(first, min(first + between - 1, self._last) + 1))

    @property
    def table(self) -> list[Entry]:
        """All of them, at every look of `Meetings` after the first, up to the last observed step."""
        return self._looked[0]

    @property
    def outlook(self) -> Outlook:
        """Of all of them. From where no agent is met there is no weight if vehicles are asked for near to agents."""
        return self._looked[1]

    @cached_property
    def _looked(self) -> tuple[list[Entry], Outlook]:
        scene, rows, found = self.scene, list[Entry](), [Outlook.none(0)]
        looks = [(look, step) for look, step in enumerate(self.meetings.looks.tolist()) if 0 < step <= self._last]
        for lane_id in edge_lanes(scene, self.routes):
            offers = self.meetings.offers_towards(lane_id, TurnType.STRAIGHT)
            for offer in offers:
                for look, step in looks:
                    met = self.meetings.from_edge(lane_id, offer, look)
                    weighs = scene.config.request.near == "anywhere" or met.weight[0] >= NEAR_WEIGHT
                    found.append(met._replace(weight=met.weight * weighs / len(offers)))
                    rows.append(Entry(self.routes.offers(lane_id)[offer], step))
        return rows, Outlook.joined(found)

    @property
    def _last(self) -> int:
        """The last step at which a vehicle enters: an observed one, and not just before the scene ends."""
        scene = self.scene
        return min(scene.last_observed_step, scene.num_steps - scene.steps_in(ENTRY_STAYS_S))


def edge_lanes(scene: Scene, routes: Routes) -> list[int]:
    """Entry lanes that begin at the map's edge: near to the hull of all lanes, and no lane of their row goes on before.

    Elsewhere a lane without predecessors is a turn pocket or a driveway: no vehicle appears there at traffic's speed.
    """
    graph = scene.grid.graph
    hull = shapely.convex_hull(shapely.multipoints(np.concatenate([lane.centerline for lane in graph.lanes.values()])))
    begin = {lane_id for row in graph.rows() if not any(map(graph.predecessors, row)) for lane_id in row}
    starts = {lane_id: shapely.points(graph.lanes[lane_id].centerline[0]) for lane_id in entry_lanes(scene, routes)}
    return [n for n, at in starts.items() if n in begin and shapely.distance(hull.boundary, at) <= _EDGE_M]
