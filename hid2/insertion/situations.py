"""Situations: what recorded vehicles meet of each other, and which of it a vehicle is to meet, so that as many do."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from hid2.agents import BoxSize
from hid2.insertion.rollout import Rollout, World
from hid2.measures.encounters import LASTS_S, WITHIN_S, acceleration, encounters, lasts, meets_at
from hid2.measures.following import leaders
from hid2.occupancy.gaps import gaps_on_path
from hid2.scene import Scene
from hid2.vehicle import Start


class Situation(StrEnum):
    """What a vehicle meets at some time, by the names and definitions of `measures/encounters.py`."""

    FOLLOWS = "follows_recorded"
    BRAKES = "brakes_recorded"
    CROSSES = "crosses_recorded"
    STANDS = "stands"


#: Situations that a vehicle's own motion and its leader tell, with their names in `meets_at`.
_BY_ITSELF = {Situation.FOLLOWS: "follows", Situation.BRAKES: "brakes", Situation.STANDS: "stands"}
#: Shares of recorded vehicles, 86 of fourteen scenes, that meet a situation. No tunables: a scene's own count for more.
_PRIOR = {Situation.FOLLOWS: 0.29, Situation.BRAKES: 0.19, Situation.CROSSES: 0.05, Situation.STANDS: 0.31}
#: Weight of _PRIOR, in vehicles of the scene itself: as many as a scene has in the mean.
_PRIOR_VEHICLES = 6


def recorded_shares(scene: Scene) -> dict[Situation, float]:
    """Share of the driven vehicles of a recording that meet something; a small recording is told by others too."""
    arrays = scene.states.arrays
    seen, driven = encounters(arrays, leaders(scene.states)), arrays.clean
    count = int(driven.sum()) + _PRIOR_VEHICLES
    return {one: (int(seen[one][driven].sum()) + _PRIOR_VEHICLES * share) / count for one, share in _PRIOR.items()}


@dataclass(frozen=True, slots=True)
class Wanted:
    """Shares of the inserted vehicles that are to meet something; over: what rounds the numbers, each from [0, 1)."""

    shares: Mapping[Situation, float]
    over: Mapping[Situation, float]

    @classmethod
    def of(cls, shares: Mapping[Situation, float], rng: np.random.Generator) -> "Wanted":
        """Rounded at random: in the mean over seeds the shares hold for few vehicles too."""
        return cls(shares, {one: float(rng.random()) for one in shares})

    def lacking(self, vehicles: Collection[Start]) -> frozenset[Situation]:
        """What one more vehicle is to meet, as too few of those that are there do."""
        count = len(vehicles) + 1
        return frozenset(
            one for one, share in self.shares.items()
            if sum(one in each.situations for each in vehicles) < int(share * count + self.over[one])
        )  # fmt: skip


NONE_WANTED = Wanted({}, {})


def foreseen(world: World, start: Start, parts: tuple[Rollout, ...]) -> frozenset[Situation]:
    """What a vehicle meets by its rollout."""
    return frozenset(one for part in parts for one in _foreseen(world, start.box, part.on_path))


def _foreseen(world: World, box: BoxSize, part: Rollout) -> Iterator[Situation]:
    scene, steps = world.scene, part.step + np.arange(part.s.size)
    counts = np.append(scene.states.arrays.whole_vehicles, False)  # the last for none, and for inserted ones
    known = world.guard.known_on(part.path, box)
    seen = gaps_on_path(known, part.s, steps, among=known.same_direction)
    leader = np.append(np.minimum(known.agents, scene.num_recorded), scene.num_recorded)[seen.leader]
    gap_m = np.where(counts[leader], seen.lead_m, np.inf)
    at = meets_at(part.v, acceleration(part.s, steps, scene.step_s), gap_m)
    for one, name in _BY_ITSELF.items():
        if at[name].any() and lasts(at[name], LASTS_S[name], scene.step_s, np.zeros_like(steps), 1)[0]:
            yield one
    met = scene.met_on(part.path, box, scene.lasting)
    seen_then = scene.future.present[met.agents]
    crossing = (met.crossing & seen_then)[:, : scene.num_steps] & counts[met.agents, None]
    # one that comes onto the path, or leaves it, crosses none
    for row in np.flatnonzero(crossing.any(axis=1) & ~(met.same_direction & seen_then).any(axis=1)).tolist():
        then = np.flatnonzero(crossing[row])
        on = (met.low[row, then, None] < part.s) & (part.s < met.high[row, then, None])
        if np.abs(then[:, None] - steps)[on].min(initial=scene.num_steps) < scene.steps_in(WITHIN_S):
            yield Situation.CROSSES
