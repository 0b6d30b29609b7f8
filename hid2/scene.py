"""What is shared by all parts that use one scene: grid, recorded agents and their future, occupancy, speeds, paths."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from statistics import median

import numpy as np

from hid2.agents import VEHICLE_TYPES, BoxSize, FloatArray, IntArray, Track
from hid2.drivers.driver import OFFSET_MAX_M, place_of_lane
from hid2.measures.arrays import MOVES_MPS, MOVING_S, STANDS_MPS
from hid2.measures.driven_lanes import STRETCH_M, recorded_places
from hid2.measures.lane_matching import flatten_lanes
from hid2.measures.surrogates import END_HORIZON_S
from hid2.motion.route import DrivenPath, LanePaths
from hid2.motion.smoothing import Trajectory
from hid2.occupancy.agent_states import AgentStates, agent_states, parked
from hid2.occupancy.along_path import PathOccupancy, look_along, path_occupancy
from hid2.occupancy.shown import Shown, shown_on
from hid2.occupancy.sigma import CellBoxes, OriginalOccupancy, cell_boxes, original_occupancy
from hid2.occupancy.traffic import BoolArray, Traffic, covering, traffic_of
from hid2.once import once
from hid2.params import Config
from netconvert.cells import Cell, CellGrid
from netconvert.lane_graph import TurnType

#: Least stay of a vehicle that enters at the map's edge, s. No tunable: shorter tracks tell no behaviour.
ENTRY_STAYS_S = 3.0
#: Look-ahead for agents on the way across, also from behind, s. No tunable: as long as a lane change takes, and some.
ACROSS_S = 8.0
#: Desired speed of an added leader over the usual speed of its lane, least and largest of a uniform draw. No tunable:
#: never a crawl on a free road, and no leader that is not worth an overtake.
SLOW_LEADER_SHARE = 0.5, 0.7
_RUN_ON_M = 250.0  # path straight on behind its last lane, without topology; no tunable: farther than any scene lasts
#: Time before its first state and after its last for which a recorded agent is kept clear of, as if it drove on, s.
#: No tunable: a vehicle that is nearer in time is seen to drive through the agent.
_UNSEEN_S = 0.5
#: Least time for which a vehicle that stands is seen to be there unseen too, s. No tunable: what trackers see for less
#: may not be there.
_SEEN_STANDING_S = 1.0
#: Steps to which length and width of a clearance box are rounded up, m: vehicles of about one size share what is known
#: of a path. Not parameters, they save time: a box that is larger by less than a step is clear of a little more.
_LENGTH_STEP_M, _WIDTH_STEP_M = 0.5, 0.1


def clearance_box(size: BoxSize, assumed: BoxSize) -> BoxSize:
    """Box that covers a vehicle and the one that readers without the sidecar assume, rounded up."""
    length, width = max(size.length_m, assumed.length_m), max(size.width_m, assumed.width_m)
    return BoxSize(
        math.ceil(length / _LENGTH_STEP_M - 1e-9) * _LENGTH_STEP_M,
        math.ceil(width / _WIDTH_STEP_M - 1e-9) * _WIDTH_STEP_M,
    )


@dataclass(eq=False)
class Scene:
    """Everything about a scene that does not change while vehicles are inserted.

    traffic: recorded agents over the scene's T steps; future: the same, and beyond the last step at constant velocity,
    T + E steps. step_s: from one step of the recording to the next, and of the simulation: the only one that there is.
    first_exit_step: a generated vehicle may leave the map only from this step on, and enter it by last_observed_step.
    vehicle_rows: rows of the recorded cars and buses, which an overtaker may pass. tracks: the recorded ones; states:
    as a reader has them, with boxes that cover those that the reader assumes; paths: those on the middle of lanes.
    """

    grid: CellGrid
    config: Config
    traffic: Traffic
    future: Traffic
    tracks: tuple[Track, ...]
    states: AgentStates
    paths: LanePaths
    vehicle_rows: IntArray
    occupancy: OriginalOccupancy
    boxes: CellBoxes
    num_steps: int
    step_s: float
    first_exit_step: int
    last_observed_step: int
    lane_speeds: dict[int, list[float]]
    scene_speeds: list[float]

    @cached_property
    def states_as_written(self) -> AgentStates:
        """The recorded agents as a reader has them, with the boxes that they have."""
        return agent_states(
            self.tracks, self.states.lanes, num_steps=self.num_steps, step_s=self.step_s, is_inserted=lambda _: False
        )

    @cached_property
    def movers(self) -> tuple[IntArray, Traffic, FloatArray]:
        """Rows (M,) of those recorded that move on roads, these alone, at most as fast, and directions (M, T, 2)."""
        rows = np.flatnonzero(self.states.arrays.moving_on_roads)
        alone = self.traffic.rows(rows.tolist())
        speed = np.array([self.states.speed(row) for row in rows.tolist()]).reshape(alone.heading.shape)
        forward = np.stack([np.cos(alone.heading), np.sin(alone.heading)], axis=-1)
        return rows, replace(alone, velocity=speed[..., None] * forward), forward

    @cached_property
    def parked(self) -> BoolArray:
        """(A,) which of the recorded agents are parked."""
        return parked(self.states)

    def met_on(self, path: DrivenPath, box: BoxSize, traffic: Traffic) -> PathOccupancy:
        """Intervals of agents on a path, with the lateral margin; rows of their traffic, as `future`, (A, T + E)."""
        return path_occupancy(path.line, traffic, box, margin_m=self.config.conflict.margin_lateral_m)

    def kept_clear_on(
        self, path: DrivenPath, box: BoxSize, traffic: Traffic, *, at_least_s: float = 0.0
    ) -> PathOccupancy:
        """The same, with the place of crossing agents taken for the critical PET before and after, or longer."""
        steps = max(math.ceil(self.config.conflict.pet_min_s / self.step_s) + 1, self.steps_in(at_least_s))
        margin_m = self.config.conflict.margin_lateral_m
        return path_occupancy(path.line, traffic, box, margin_m=margin_m, clear_steps=steps)

    @cached_property
    def lasting(self) -> Traffic:
        """`future`, with each agent there a little before it is seen and after, too: it comes from somewhere."""
        return self.future.lasting(self.steps_in(_UNSEEN_S), step_s=self.step_s)

    @cached_property
    def unseen(self) -> Traffic:
        """Recorded vehicles that stand whenever they are seen, at the other steps: as if they stood there all along."""
        stand = ~(self.traffic.present & (self.traffic.speed > STANDS_MPS)).any(axis=1)
        stand &= self.states.arrays.vehicle & (self.states.arrays.rows_per_agent >= self.steps_in(_SEEN_STANDING_S))
        seen = self.traffic.rows(np.flatnonzero(stand).tolist())
        return replace(seen.lasting(self.num_steps, step_s=0.0), present=~seen.present)

    @once
    def unseen_on(self, path: DrivenPath, box: BoxSize) -> PathOccupancy:
        """Intervals of those on the width driven on a path."""
        return look_along(path.line, self.unseen, box.length_m, box.width_m)

    @property
    def num_recorded(self) -> int:
        """How many agents are recorded: rows of recorded and inserted ones together begin with theirs."""
        return len(self.traffic.ids)

    def with_inserted(self, recorded: PathOccupancy, inserted: PathOccupancy) -> PathOccupancy:
        """Intervals of both on one path, recorded ones first; rows of inserted ones are counted on from those."""
        return recorded.joined(inserted._replace(agents=inserted.agents + self.num_recorded))

    @once
    def in_driving_width(self, path: DrivenPath, box: BoxSize) -> PathOccupancy:
        """Intervals of the recorded agents with boxes that reach into the width driven, without margins."""
        wide = self.met_on(path, box, self.lasting)  # what touches no margin touches no box; the guard knows it, too
        near = self.future.rows(wide.agents.tolist())
        near = replace(near, present=near.present & np.isfinite(wide.low))
        found = look_along(path.line, near, box.length_m, box.width_m)
        return found._replace(agents=wide.agents[found.agents])

    @once
    def shown_on(self, path: DrivenPath, box: BoxSize) -> Shown:
        """The same as SUMO is shown them."""
        return shown_on(path, self.future, self.in_driving_width(path, box), step_s=self.step_s)

    def known_traffic(self, vehicle_id: str, box: BoxSize, parts: Iterable[tuple[int, Trajectory]]) -> Traffic:
        """A vehicle with parts of its motion from a step on each, beyond the end at constant velocity (one agent)."""
        shape = 1, self.num_steps
        position, velocity = np.zeros((*shape, 2)), np.zeros((*shape, 2))
        heading, present = np.zeros(shape), np.zeros(shape, dtype=np.bool_)
        for step, driven in parts:
            span = slice(step, step + len(driven.heading))
            position[0, span], velocity[0, span] = driven.position, driven.velocity
            heading[0, span], present[0, span] = driven.heading, True
        length_m, width_m = np.array([box.length_m]), np.array([box.width_m])
        alone = Traffic((vehicle_id,), position, heading, velocity, present, length_m, width_m)
        return alone.extended(self.future.num_steps - self.num_steps, step_s=self.step_s)

    @property
    def last_s(self) -> float:
        """Time of the last step, s from the first."""
        return (self.num_steps - 1) * self.step_s

    def steps_to_stay(self, step: int) -> int:
        """Steps that a generated vehicle which is there from a step on stays at least."""
        until = self.first_exit_step - step
        return until if step == 0 else max(until, self.steps_in(ENTRY_STAYS_S))

    def steps_in(self, seconds: float) -> int:
        """The number of steps nearest to a duration, at least one."""
        return max(1, round(seconds / self.step_s))

    @cached_property
    def _places(self) -> dict[int, FloatArray]:
        return recorded_places(self.states, within_m=OFFSET_MAX_M)

    def place_on(self, path: DrivenPath, s: FloatArray) -> FloatArray:
        """Usual place in the lane, d m, of vehicles at arc lengths (N,) m of a path, left positive.

        That of recorded vehicles within `STRETCH_M`; elsewhere one drawn for the lane, the same for all that drive it.
        """
        (of, lane_m), (places, first) = path.all_lane_m(s), self._places_along(path)
        return places[np.minimum(first[of] + (lane_m / STRETCH_M).astype(np.int64), first[of + 1] - 1)]

    @once
    def _places_along(self, path: DrivenPath) -> tuple[FloatArray, IntArray]:
        """The same of the stretches of a path's lanes, one lane after another, and where those of each begin."""
        each = [self._places_on(segment.lane_id) for segment in path.segments]
        return np.concatenate(each), np.cumsum([0, *(places.size for places in each)])

    @once
    def _places_on(self, lane_id: int) -> FloatArray:
        """The same of the stretches of a lane, or one for all of it."""
        drawn = place_of_lane(self.config.drivers, lane_id)
        recorded = self._places.get(lane_id, np.array([drawn]))
        return np.where(np.isnan(recorded), drawn, recorded)

    def cell_at(self, path: DrivenPath, s: float) -> Cell:
        """Cell of a path's lane at arc length s."""
        segment = path.segment_at(s)
        return self.grid.cell_at(segment.lane_id, segment.lane_m(s))

    @once
    def _speeds_on(self, lane_id: int) -> list[float]:
        """Speeds of a lane's traffic, m/s: of recorded moving traffic there, else where its street is driven nearest.

        Where none drives on its street: of the scene, else the prior. A street: lanes beside, before and behind.
        """
        graph, seen, here = self.grid.graph, {lane_id}, [lane_id]
        while here:
            known = [speed for lane in here for speed in self.lane_speeds.get(lane, ())]
            if known:
                return known
            near = {
                other for lane in here
                for other in (
                    graph.neighbor(lane, "left"), graph.neighbor(lane, "right"), *graph.successors(lane),
                    *graph.predecessors(lane),
                )
                if other is not None and graph.lanes[other].turn is TurnType.STRAIGHT
            }  # fmt: skip
            here = sorted(near - seen)
            seen |= near
        return self.scene_speeds or [self.config.spawn.prior_speed_mps]

    @once
    def usual_speed(self, lane_id: int) -> float:
        """Median speed of a lane's traffic, m/s."""
        return median(self._speeds_on(lane_id))

    def lane_speed(self, lane_id: int, rng: np.random.Generator) -> float:
        """Speed of a vehicle of a lane's traffic, m/s; no slower than the fastest leader that is added: none crawls."""
        pool = self._speeds_on(lane_id)
        return max(pool[int(rng.integers(len(pool)))], SLOW_LEADER_SHARE[1] * self.usual_speed(lane_id))


def future_of(traffic: Traffic, config: Config, *, step_s: float) -> Traffic:
    """Traffic with the steps beyond its last one that a configuration may look at."""
    looks_s = max(END_HORIZON_S + config.conflict.horizon_s, ACROSS_S)
    return traffic.extended(math.ceil(looks_s / step_s), step_s=step_s)


def build_scene(
    grid: CellGrid, tracks: Sequence[Track], *, config: Config, num_steps: int, step_s: float, last_observed_step: int
) -> Scene:
    """Scene of recorded tracks, step_s apart. last_observed_step: generated vehicles are there at least until then."""
    traffic = traffic_of(tracks, num_steps, step_s=step_s)
    boxes = cell_boxes(grid)
    occupancy = original_occupancy(boxes, traffic)
    through = config.request.focal == "generated" or config.request.generated_category >= 2
    covered, lanes = [replace(track, size=covering(track)) for track in tracks], flatten_lanes(grid.graph)
    states = agent_states(covered, lanes, num_steps=num_steps, step_s=step_s, is_inserted=lambda _: False)
    lane_speeds, scene_speeds = _speeds(grid, states, traffic, occupancy, step_s=step_s)
    rows = [row for row, track in enumerate(tracks) if track.object_type in VEHICLE_TYPES]
    run_on_m = _RUN_ON_M if "topology" in config.without else 0.0
    return Scene(
        grid=grid,
        config=config,
        traffic=traffic,
        future=future_of(traffic, config, step_s=step_s),
        tracks=tuple(tracks),
        states=states,
        paths=LanePaths(grid.graph, config.limits, run_on_m, config.spawn.max_speed_mps * num_steps * step_s),
        vehicle_rows=np.array(rows, dtype=np.int64),
        occupancy=occupancy,
        boxes=boxes,
        num_steps=num_steps,
        step_s=step_s,
        first_exit_step=num_steps if through else min(last_observed_step + 1, num_steps),
        last_observed_step=last_observed_step,
        lane_speeds=lane_speeds,
        scene_speeds=scene_speeds,
    )


def cruising_mps(traffic: Traffic, row: int) -> float:
    """Speed of a recorded agent while it moves, 90th percentile, m/s; 0 where it never does."""
    speed = np.hypot(*traffic.velocity[row, traffic.present[row]].T)
    moves = speed > MOVES_MPS
    return float(np.percentile(speed[moves], 90)) if moves.any() else 0.0


def _speeds(
    grid: CellGrid, states: AgentStates, traffic: Traffic, occupancy: OriginalOccupancy, *, step_s: float
) -> tuple[dict[int, list[float]], list[float]]:
    """Cruising speed of each moving vehicle: over the scene, and by lane driven on."""
    lane_of = np.array([cell.lane_id for cell in grid.cells])
    by_lane, scene, speed = dict[int, list[float]](), list[float](), traffic.speed
    for row in np.flatnonzero(states.arrays.clean).tolist():
        moving = traffic.present[row] & (speed[row] > MOVES_MPS)
        if moving.sum() < round(MOVING_S / step_s):
            continue
        usual_mps = cruising_mps(traffic, row)
        scene.append(usual_mps)
        for lane_id in np.unique(lane_of[occupancy.cell[row, moving & (occupancy.cell[row] >= 0)]]):
            by_lane.setdefault(int(lane_id), []).append(usual_mps)
    return by_lane, scene
