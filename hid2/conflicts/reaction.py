"""Recorded vehicles that yield in time (`driving.replay = "reactive"`), each on the path that was recorded.

At every step a vehicle gets on as it did at that place of its recording, or less far where its car following has to
brake for an agent ahead on that path: it is late, and never catches up. Whatever is no car and no bus stays as
recorded, and so do the signals that are inferred from the recording.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hid2.agents import BoxSize, FloatArray, IntArray, Track
from hid2.kernels.path_intervals import SAME_WAY
from hid2.occupancy.along_path import look_along
from hid2.occupancy.gaps import gaps_from_pose, gaps_on_path
from hid2.occupancy.sigma import original_occupancy
from hid2.occupancy.traffic import BoolArray, Traffic, velocity_of
from hid2.once import once
from hid2.scene import Scene
from netconvert.geometry import arc_length, wrap_angle

#: Largest deceleration with which a follower is expected to yield, SUMO's decel, m/s2; largest distance of a leader
#: that is followed, m. No tunables: how recorded vehicles drive on is for the car-following model to say.
YIELDS_MPS2, AHEAD_M = 4.5, 80.0
#: Car following: row of the recorded agent, its speed m/s, bumper gap m and speed of its leader m/s -> speed, m/s.
FollowSpeed = Callable[[int, float, float, float], float]


def yielding(
    scene: Scene, rows: IntArray, step: int, *, xy: FloatArray, forward: FloatArray, half_m: float, speed_mps: float
) -> BoolArray:
    """Which of some recorded agents (K,) come from behind a vehicle at a step, as it drives, and can yield to it.

    xy (2,) m, forward (2,): centre and direction of the vehicle; half_m: half its length.
    """
    here = scene.traffic.at(step).rows(rows.tolist())
    seen = gaps_from_pose(xy, forward, BoxSize(2.0 * half_m, 0.0), here)
    same_way = np.cos(here.heading[:, 0]) * forward[0] + np.sin(here.heading[:, 0]) * forward[1] > SAME_WAY
    closing = np.maximum(seen.along_mps - speed_mps, 0.0)
    brakes = np.square(closing) / (2.0 * np.maximum(seen.gap_m, 1e-6))
    able = (seen.along_m < 0.0) & (seen.gap_m > 0.0) & (brakes <= YIELDS_MPS2)
    return np.asarray(able & same_way & here.present[:, 0] & np.isin(rows, scene.vehicle_rows))


@dataclass(frozen=True, eq=False, slots=True)
class _OwnPath:
    """Path of one recorded agent. s (K,) m driven at its steps first, first + 1, ..."""

    first: int
    s: FloatArray

    @property
    def last(self) -> int:
        """Its last recorded step."""
        return self.first + self.s.size - 1

    def s_at(self, place: float) -> float:
        """Driven at a recorded time, steps."""
        return float(np.interp(place - self.first, np.arange(self.s.size), self.s))

    def place_at(self, s: float, *, since: float) -> float:
        """Recorded time, steps, at which s was reached, not before `since` and not more than a step after it."""
        low = int(since - self.first)
        steps = np.arange(low, min(low + 3, self.s.size))
        found = float(np.interp(s, self.s[steps], steps)) + self.first
        return min(max(found, since), since + 1.0)


class Reactions:
    """The recorded vehicles of one simulation. scene: as it has become; follow_mps: their car following.

    late (A,): how many steps each recorded agent is behind its recording by now.
    """

    def __init__(self, scene: Scene, follow_mps: FollowSpeed) -> None:
        self.scene, self.follow_mps, self._recorded = scene, follow_mps, scene.future
        self.late, self._speed = np.zeros((2, len(scene.future.ids)))

    def advance(self, step: int, others: Traffic) -> bool:
        """Let all agents get on to `step`; whether any is later. others: generated vehicles a step before (T = 1)."""
        here = self.scene.traffic.at(step - 1).joined(others) if others.ids else self.scene.traffic.at(step - 1)
        yields = [row for row in self.scene.vehicle_rows.tolist() if here.present[row, 0]]
        later = {row: late for row in yields if (late := self._late_after(row, step, here)) > self.late[row]}
        if not later:
            return False
        for row, late in later.items():
            self.late[row] = late
        self._move(sorted(later), step)
        return True

    def _late_after(self, row: int, step: int, here: Traffic) -> float:
        """How late an agent is at a step, by the agents ahead of it at the step before."""
        late, path = float(self.late[row]), self._path(row)
        place = step - 1 - late
        at = path.s_at(place)
        free_m = path.s_at(min(place + 1.0, path.last)) - at
        leader = self._leader(row, place, here) if free_m > 0.0 else None
        if late == 0.0 and leader is None:
            return late
        wanted = free_m / self.scene.step_s
        # trackers jitter: an agent that drives as recorded need not be able to accelerate as its track does
        speed = float(self._speed[row]) if late > 0.0 else max(wanted, float(np.hypot(*here.velocity[row, 0])))
        gap_m, leader_mps = leader or (AHEAD_M, wanted)
        driven_m = min(free_m, max(0.0, self.follow_mps(row, speed, gap_m, leader_mps)) * self.scene.step_s)
        self._speed[row] = driven_m / self.scene.step_s
        if driven_m >= free_m:
            return late
        return step - path.place_at(at + driven_m, since=place)

    def _leader(self, row: int, place: float, here: Traffic) -> tuple[float, float] | None:
        """Bumper gap m and speed along the path m/s of the next one on an agent's path; None near enough.

        place: the recorded time, steps, at which the agent was where it is. For an agent that drives as recorded: of
        generated ones and of those that are late; all others keep out of its way as they did.
        """
        count, own = len(self._recorded.ids), self._recorded
        counts = here.present[:, 0].copy()
        counts[row] = False
        if self.late[row] == 0.0:
            counts[:count] &= self.late > 0.0
        apart = np.hypot(*(here.position[:, 0] - here.position[row, 0]).T)
        others = np.flatnonzero(counts & (apart < AHEAD_M))
        driven = self.scene.states.line(row) if others.size else None
        if driven is None:
            return None
        seen = look_along(driven.line, here.rows(others.tolist()), float(own.length_m[row]), float(own.width_m[row]))
        steps = np.flatnonzero(np.isfinite(driven.s))
        found = gaps_on_path(seen, np.interp([place], steps, driven.s[steps]), 0)
        return None if found.leader[0] < 0 else (max(0.0, float(found.lead_m[0])), float(found.lead_mps[0]))

    @once
    def _path(self, row: int) -> _OwnPath:
        there = np.flatnonzero(self._recorded.present[row])
        return _OwnPath(int(there[0]), arc_length(self._recorded.position[row, there]))

    def _move(self, rows: Sequence[int], step: int) -> None:
        """The scene with some agents later from a step on: they are expected to go on as recorded, so much later."""
        scene, recorded = self.scene, self._recorded
        position, heading = scene.future.position.copy(), scene.future.heading.copy()
        velocity, present = scene.future.velocity.copy(), scene.future.present.copy()
        for row in rows:
            path = self._path(row)
            steps = np.arange(path.first, path.last + 1)
            ahead = np.arange(max(step, path.first), recorded.num_steps)
            ahead = ahead[ahead - self.late[row] <= path.last]
            at = ahead - self.late[row]
            for axis in (0, 1):
                position[row, ahead, axis] = np.interp(at, steps, recorded.position[row, steps, axis])
            heading[row, ahead] = wrap_angle(np.interp(at, steps, np.unwrap(recorded.heading[row, steps])))
            present[row, ahead] = True
            velocity[row, present[row]] = velocity_of(position[row, present[row]], scene.step_s)
        future = replace(scene.future, position=position, heading=heading, velocity=velocity, present=present)
        traffic = future.span(slice(scene.num_steps))
        occupancy = original_occupancy(scene.boxes, traffic)
        self.scene = replace(scene, traffic=traffic, future=future, occupancy=occupancy)

    @property
    def late_s(self) -> dict[str, float]:
        """Seconds behind the recording, by track id, of those that are late."""
        rows = np.flatnonzero(self.late > 0.0).tolist()
        return {self._recorded.ids[row]: round(float(self.late[row]) * self.scene.step_s, 6) for row in rows}

    def tracks(self, recorded: Sequence[Track]) -> list[Track]:
        """The tracks that the scene was made of, those of agents that are late as they were driven."""
        found, traffic = list(recorded), self.scene.traffic
        for row in np.flatnonzero(self.late > 0.0).tolist():
            steps = np.flatnonzero(traffic.present[row])
            found[row] = replace(
                found[row], timesteps=steps, position=traffic.position[row, steps], heading=traffic.heading[row, steps],
                velocity=traffic.velocity[row, steps],
            )  # fmt: skip
        return found
