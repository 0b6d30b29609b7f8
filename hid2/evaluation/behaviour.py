"""What each vehicle of a scene was about: one policy of the paper for each, by what detectors saw it do."""

from collections.abc import Sequence

import numpy as np

from hid2.agents import Policy
from hid2.measures.arrays import SceneArrays
from hid2.measures.manoeuvres import Maneuver
from hid2.policy.behaviours import BEHAVIOURS, behaviour_seen


def policies(arrays: SceneArrays, maneuvers: Sequence[Maneuver]) -> dict[str, Policy]:
    """One policy of the paper per moving vehicle, by track id: the rarest of what it did, else straight."""
    order = list(BEHAVIOURS)
    moving = np.flatnonzero(arrays.vehicle & arrays.moving)
    out = {arrays.track_ids[agent]: Policy.STRAIGHT for agent in moving}
    for maneuver in maneuvers:
        seen = behaviour_seen(maneuver.kind).policy
        out[maneuver.track_id] = max(out[maneuver.track_id], seen, key=order.index)
    return out
