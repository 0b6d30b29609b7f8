"""Entries: where and when vehicles may enter at the map's edge, and what they would meet from there."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hid2.insertion.flow import edge_lanes
from hid2.insertion.meetings import NEAR_WEIGHT, Meetings, Outlook
from hid2.insertion.routes import RouteOffer, Routes
from hid2.scene import ENTRY_STAYS_S, Scene
from netconvert.lane_graph import TurnType


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
