"""What follows a vehicle's last step if all agents keep their velocity: the first contact of boxes.

Nothing is recorded beyond the last step, so nothing else would tell that a track ends a moment before a collision.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hid2.agents import FloatArray, IntArray
from hid2.kernels.constant_velocity import earliest_contact
from hid2.measures.arrays import BoolArray, SceneArrays

#: Beyond its last step a vehicle is looked at so long, s. No tunable: what generator and judge look at.
END_HORIZON_S = 3.0


class Contact(NamedTuple):
    """The first contact of a vehicle: time to collision, s, and the row of the other one."""

    ttc_s: float
    other: int


@dataclass(frozen=True, eq=False, slots=True)
class BoxesAtStep:
    """The boxes that are present at one step, (A,) of them, city frame.

    position (A, 2) m, centres; heading (A,) rad; velocity (A, 2) m/s; size (A, 2) m, length and width.
    """

    position: FloatArray
    heading: FloatArray
    velocity: FloatArray
    size: FloatArray

    def rows(self, rows: IntArray) -> "BoxesAtStep":
        """Some of them."""
        return BoxesAtStep(self.position[rows], self.heading[rows], self.velocity[rows], self.size[rows])


def first_contact(own: int, boxes: BoxesAtStep) -> Contact | None:
    """The other box that row `own` touches first within END_HORIZON_S, all at constant velocity; None if none.

    Two-dimensional: leaders, followers, oncoming and crossing ones alike. A TTC of 0 is an overlap at the step.
    """
    ttc_s, other = earliest_contact(own, boxes.position, boxes.heading, boxes.velocity, boxes.size, END_HORIZON_S)
    return None if other < 0 else Contact(float(ttc_s), int(other))


def ttc_after_last_step(arrays: SceneArrays, members: BoolArray, among: BoolArray) -> FloatArray:
    """(A,) s from the last step of each member (A,) to its first contact within END_HORIZON_S; inf for all else.

    among: the agents (A,) that count as others; of these those present at that very step.
    """
    found = np.full(arrays.num_agents, np.inf)
    for agent in np.flatnonzero(members).tolist():
        step = int(arrays.step[arrays.first[agent + 1] - 1])
        agents = np.union1d(np.flatnonzero((arrays.row_of[:, step] >= 0) & among), agent)
        rows, sizes = arrays.row_of[agents, step], np.column_stack([arrays.length[agents], arrays.width[agents]])
        boxes = BoxesAtStep(arrays.position[rows], arrays.heading[rows], arrays.velocity[rows], sizes)
        contact = first_contact(int(np.searchsorted(agents, agent)), boxes)
        found[agent] = np.inf if contact is None else contact.ttc_s
    return found
