"""Sites of vehicles that enter at the map's edge during the scene."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from hid2.agents import Policy
from hid2.insertion.meetings import by_weight
from hid2.insertion.rollout import SLOWEST_SHARE
from hid2.insertion.situations import Situation
from hid2.insertion.starts import CLEAR_GAP_M, Site, Starts, speed_behind
from hid2.insertion.surroundings import Surroundings
from hid2.measures.arrays import STANDS_MPS
from hid2.occupancy.gaps import gaps_from_pose
from hid2.occupancy.traffic import Traffic
from hid2.params import Config
from hid2.vehicle import Start, VehicleRequest

#: Sites that a round looks at in full for a request. Not a parameter, it saves time: `spawn.rounds` bounds the search.
TRIES = 80
#: Least time gap that an entering vehicle leaves to an inserted follower, s. No tunable: no driver keeps a shorter one.
_ENTRY_GAP_S = 1.0


@dataclass(slots=True)
class EntrySites:
    """Sites of the vehicles that enter in one round."""

    here: Surroundings
    starts: Starts

    def is_to_enter(self, request: VehicleRequest) -> bool:
        """Whether a vehicle is to enter at the map's edge if it can; a scored one is there from the first step on."""
        asked = self.here.scene.config.request
        if request.policy is not Policy.STRAIGHT or asked.generated_category > 1 or asked.entering == 0.0:
            return False
        return bool(self.starts.rng.random() < asked.entering)

    def starts_of(self, request: VehicleRequest, followed: list[int], wants: frozenset[Situation]) -> Iterator[Start]:
        """Starts at the map's edge during the scene: wanted ones first, in weighted random order."""
        scene, entries, rng = self.here.scene, self.here.entries, self.starts.rng
        leader, weight = entries.outlook.leader, entries.outlook.weight.copy()
        if scene.config.request.is_near_agents:
            weight[~entries.outlook.near] = 0.0
        order = by_weight(weight, rng)
        if wants:
            order = order[np.argsort(~entries.outlook.meets_any(wants, followed)[order], kind="stable")]
        for row in order[:TRIES].tolist():
            site = Site(entries.table[row].offer, None, entries.step(row, rng), int(leader[row]))
            start = self.starts.make(request, site)
            if isinstance(start, Start):
                yield start
            else:
                self.starts.refusals[start] += 1


def entry_speed(start: Start, fleet: Traffic, config: Config, *, step_s: float) -> float | None:
    """Speed at which a vehicle can enter at the map's edge among those that are driven, m/s; None: there is no room.

    fleet: where these were step_s before (one step). At most the speed of the start.
    """
    if not fleet.ids:
        return start.start_mps
    xy, tangent, _ = start.path.line.motion(np.array([start.start_m]))
    later = replace(fleet, position=fleet.position + step_s * fleet.velocity)
    seen, speed = gaps_from_pose(xy[0], tangent[0], start.box, later), start.start_mps
    for row in np.flatnonzero((seen.aside_m < config.conflict.margin_lateral_m) & fleet.present[:, 0]).tolist():
        gap, other_mps, leads = float(seen.gap_m[row]), float(seen.along_mps[row]), seen.along_m[row] > 0.0
        if gap < CLEAR_GAP_M or (not leads and gap < _ENTRY_GAP_S * other_mps):
            return None
        if leads:
            speed = min(speed, float(speed_behind(gap, max(0.0, other_mps), start.driver.following)))
    slowest_mps = max(STANDS_MPS, SLOWEST_SHARE * start.driver.desired_mps)
    return speed if speed >= slowest_mps else None
