"""The states of agents as a file has them, the lanes that they drive, and what is ahead of them on the path driven."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hid2.agents import FloatArray, IntArray, Track
from hid2.kernels.polyline import frenet
from hid2.measures.arrays import BoolArray, SceneArrays, is_generated_id, stack
from hid2.measures.driven_lanes import LaneView, points_ahead
from hid2.measures.following import HORIZON_M
from hid2.measures.lane_matching import FlatLanes, Matches, lane_along, match_lanes
from hid2.motion.reference_line import ReferenceLine, build_reference_line
from hid2.occupancy.along_path import look_along
from hid2.occupancy.gaps import gaps_to_all
from hid2.occupancy.traffic import Traffic, are_believed, traffic_of
from hid2.once import once
from netconvert.geometry import Polyline, arc_length, differences

#: Overlap along a path above which boxes are side by side, m: neither leads the other.
SIDE_BY_SIDE_M = 1.0
#: Smallest gap that braking is worked out for, m. No tunable: a smaller one is a contact, which the judge forbids.
_TOUCHES_M = 0.1
#: Spacing of the points of a driven line, least radius of its curves, and its largest distance from the positions, m.
#: No tunables: the shape of a driven line.
_POINTS_M, _RADIUS_M, _STRAYS_M = 1.0, 3.0, 0.2


class DrivenLine(NamedTuple):
    """The path that an agent drives. s (T,): its arc length at the steps of the scene, m, NaN where it is absent."""

    line: ReferenceLine
    s: FloatArray


class PathLeaders(NamedTuple):
    """Agents that lead on a driven path, agents (R,); gap (R, T) m, inf where one does not lead; closing (R, T) m/s."""

    agents: IntArray
    gap_m: FloatArray
    closing_mps: FloatArray

    def next_ones(self) -> tuple[IntArray, FloatArray]:
        """(T,) which agent leads next, -1 for none, and its gap, m, inf for none."""
        gap_m = np.vstack([np.full(self.gap_m.shape[1], np.inf), self.gap_m])  # none is first: it is where none leads
        return np.append(-1, self.agents)[gap_m.argmin(axis=0)], gap_m.min(axis=0)

    @property
    def ttc_s(self) -> FloatArray:
        """(R, T) s, inf where the gap does not close."""
        closes = np.isfinite(self.gap_m) & (self.closing_mps > 1e-3)
        return np.where(closes, np.maximum(self.gap_m, 0.0) / np.where(closes, self.closing_mps, 1.0), np.inf)

    @property
    def drac_mps2(self) -> FloatArray:
        """(R, T) m/s2, deceleration rate to avoid a crash: constant, until the gap closes no more; 0 for no need."""
        closing_mps = np.where(np.isfinite(self.gap_m), np.maximum(self.closing_mps, 0.0), 0.0)
        return np.asarray(closing_mps**2 / (2.0 * np.maximum(self.gap_m, _TOUCHES_M)))


@dataclass(frozen=True, eq=False)
class AgentStates(LaneView):
    """Agents of a scene: row by row in `arrays`, as stated, step by step in `traffic`; joined_of: its parts."""

    traffic: Traffic
    joined_of: tuple["AgentStates", ...] = field(default=(), repr=False)

    def joined(self, *others: "AgentStates") -> "AgentStates":
        """The agents of all, of the same scene, in this order."""
        every = [self, *(other for other in others if other.arrays.num_agents)]
        if len(every) == 1:
            return self
        matches = Matches(
            *(np.concatenate([getattr(one.matches, part.name) for one in every]) for part in fields(Matches))
        )
        arrays, traffic = SceneArrays.joined([one.arrays for one in every]), (one.traffic for one in every[1:])
        return AgentStates(arrays, self.lanes, matches, self.traffic.joined(*traffic), tuple(every))

    def rows(self, agents: Sequence[int]) -> "AgentStates":
        """Some of the agents, in the order given."""
        arrays, matches = self.arrays, self.matches
        index = np.concatenate([np.arange(arrays.first[agent], arrays.first[agent + 1]) for agent in agents])
        chosen = Matches(*(getattr(matches, part.name)[index] for part in fields(Matches)))
        return AgentStates(arrays.agents(agents), self.lanes, chosen, self.traffic.rows(agents))

    @cached_property
    def row_speed(self) -> FloatArray:
        """(N,) how fast agents are at most, m/s, row by row: as stated, if that is believed, or by their positions."""
        by_positions, stated, apart = self._speeds
        return np.maximum(by_positions, stated) if are_believed(apart) else by_positions

    @cached_property
    def _speeds(self) -> list[FloatArray]:
        """(N,) m/s each, row by row: by positions, as stated, and how far the two velocities are apart."""
        if self.joined_of:
            return [np.concatenate(parts) for parts in zip(*(one._speeds for one in self.joined_of), strict=True)]
        stated, by_positions = self.arrays.velocity, self.traffic.velocity[self.arrays.agent, self.arrays.step]
        return [np.hypot(*one.T) for one in (by_positions, stated, stated - by_positions)]

    @once
    def speed(self, agent: int) -> FloatArray:
        """(T,) how fast an agent is at most, m/s, at the steps of the scene."""
        rows, found = self.row_span(agent), np.hypot(*self.traffic.velocity[agent].T)
        found[self.arrays.step[rows]] = self.row_speed[rows]
        return np.asarray(found)

    def span(self, agent: int) -> slice:
        """The steps of an agent, from its first to its last."""
        steps = self.arrays.step[self.row_span(agent)]
        return slice(int(steps[0]), int(steps[-1]) + 1)

    def row_span(self, agent: int) -> slice:
        """The rows of an agent in `arrays`."""
        return slice(int(self.arrays.first[agent]), int(self.arrays.first[agent + 1]))

    @once
    def line(self, agent: int) -> DrivenLine | None:
        """The path that a vehicle drives and, behind its last position, its lane; None where it has neither."""
        for part in self.joined_of:
            if agent < part.arrays.num_agents:
                return part.line(agent)
            agent -= part.arrays.num_agents
        rows = self.row_span(agent)
        position, last = self.arrays.position[rows], rows.stop - 1
        points = position[np.flatnonzero(np.diff(np.floor(arc_length(position) / _POINTS_M), prepend=-1.0) > 0)]
        goes_on = int(self.matches.lane[last]), float(self.matches.s[last]), float(self.matches.d[last])
        if goes_on[0] >= 0:
            held = lane_along(self.lanes, position[-1], float(self.matches.direction[last]))
            goes_on = goes_on if held[0] < 0 else held
        points = np.concatenate([points, points_ahead(self.lanes, *goes_on, HORIZON_M, beyond_m=_POINTS_M)])
        if len(points) < 2:
            return None
        line = build_reference_line(points, step_m=_POINTS_M, min_radius_m=_RADIUS_M, max_offset_m=_STRAYS_M)
        chords = Polyline(line.points)
        s = np.full(self.arrays.num_steps, np.nan)
        along, _ = frenet(np.ascontiguousarray(position), chords.points, chords.s)
        s[self.arrays.step[rows]] = np.interp(along, chords.s, line.points_m)
        return DrivenLine(line, s)

    def leaders_on_path(self, agent: int, others: IntArray, *, aside_m: float = 0.0) -> PathLeaders:
        """Which of the agents `others` lead a vehicle on the path that it drives, whatever their object type.

        aside_m: added to each side of the own box. An agent leads where it heads along the path, ahead of the vehicle
        by at most HORIZON_M and not beside it; one that rolls back, or that a tracker shifts back, stands.
        """
        found = self.leaders_among(agent, self.traffic.rows(others.tolist()), aside_m=aside_m)
        return found._replace(agents=others[found.agents])

    def leaders_among(self, agent: int, others: Traffic, *, aside_m: float = 0.0) -> PathLeaders:
        """The same of other agents than these, by the rows of their traffic (T steps)."""
        driven, steps, traffic = self.line(agent), self.arrays.num_steps, self.traffic
        length_m, width_m = float(traffic.length_m[agent]), float(traffic.width_m[agent]) + 2 * aside_m
        if driven is None or not (seen := look_along(driven.line, others, length_m, width_m)).agents.size:
            return PathLeaders(np.zeros(0, dtype=np.int64), *np.zeros((2, 0, steps)))
        found = gaps_to_all(seen, driven.s, np.arange(steps))
        leads = seen.same_direction & (found.lead_m > -SIDE_BY_SIDE_M) & (found.lead_m < HORIZON_M)
        return PathLeaders(seen.agents, np.where(leads, found.lead_m, np.inf), self.speed(agent) - found.along_mps)


def agent_states(
    tracks: Sequence[Track], lanes: FlatLanes, *, num_steps: int, step_s: float,
    is_inserted: Callable[[str], bool] = is_generated_id,
) -> AgentStates:  # fmt: skip
    """The states of tracks, with the boxes that the tracks have. is_inserted: tells inserted tracks by their id."""
    arrays = stack(tracks, num_steps=num_steps, step_s=step_s, is_generated=is_inserted)
    present = [track for track in tracks if track.timesteps.size]
    traffic = traffic_of(present, arrays.num_steps, step_s=step_s, velocity_by=differences)
    traffic = replace(traffic, length_m=arrays.length, width_m=arrays.width)
    return AgentStates(arrays, lanes, match_lanes(arrays, lanes), traffic)


def parked(states: AgentStates) -> BoolArray:
    """(A,) agents that never move and are never in the middle third of a lane: they stand, and not in a queue."""
    arrays, matches = states.arrays, states.matches
    middle = (matches.lane >= 0) & (np.abs(matches.d) <= states.lanes.half_width[matches.lane] / 3)
    in_lane = np.zeros(arrays.num_agents, dtype=np.bool_)
    in_lane[arrays.agent[middle]] = True
    return ~(arrays.moving | in_lane)
