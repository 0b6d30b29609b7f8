"""`hid2 resimulate`: recorded vehicles taken out and driven by SUMO, scored as simulated agents are ("WOSAC-like")."""

import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from bridge.generation.generate import model_parameters, sumo_seed
from bridge.recordings.recording import Recording
from bridge.sumo.driving import Driving
from bridge.sumo.fleet import Fleet
from bridge.sumo.lane_changes import Attempt
from bridge.sumo.simulation import Simulation
from hid2.agents import FloatArray, IntArray, Track
from hid2.conflicts.stop_lines import StopLines
from hid2.evaluation.resimulated import Left, OwnWay, TakenOut, begin, begin_by_default, own_way, poses, taken_out
from hid2.measures.lane_matching import flatten_lanes
from hid2.motion.smoothing import smooth_motion
from hid2.occupancy.agent_states import agent_states
from hid2.occupancy.traffic import Traffic, traffic_of, velocity_of
from hid2.params import CarFollowing, Config
from hid2.policy.roads import Roads
from hid2.scene import Scene, build_scene
from hid2.vehicle import DrivenVehicle
from netconvert.cells import CellGrid, build_cell_grid
from netconvert.net_xml import net_bytes

#: The present, the last step of the history: as in the challenge, 11 steps are known, those up to 90 are scored.
NOW, LAST = 10, 90
Who = Literal["calibrated", "default", "constant velocity"]
#: Where fewer vehicles move at the present, at least so fast, m/s, the scene's pace is the prior.
_PACE_OF, _MOVES_MPS = 3, 2.0


class _Resimulated(Driving):
    """Vehicles on their own routes among recorded ones: they go on whatever they meet, which is what is scored."""

    def _take_out_struck(self, step: int) -> None:
        pass


class _Unsteered(_Resimulated):
    """SUMO alone: neither guard nor turns nor stop lines."""

    def _steer(self, step: int) -> tuple[dict[int, Attempt], dict[int, tuple[float, str]]]:
        return {}, {}


@dataclass(eq=False, slots=True)
class _Cast:
    """Vehicles that are driven together, in the scene of all others from the present on."""

    vehicles: Sequence[TakenOut]
    scene: Scene
    roads: Roads
    stop_lines: StopLines
    ways: list[OwnWay]


class Resimulation:
    """A recording whose vehicles are taken out: `logged` as it was (A, T), `vehicles` that are driven, `left` not."""

    def __init__(self, recording: Recording) -> None:
        self.recording, tracks = recording, recording.tracks
        states = agent_states(
            tracks, flatten_lanes(recording.graph), num_steps=recording.num_steps, step_s=recording.step_s
        )
        self.vehicles, self.left = taken_out(states, tracks, NOW)
        self.rows = np.array([one.row for one in self.vehicles], dtype=np.int64)
        sizes = np.array([track.size for track in tracks])
        logged = traffic_of(tracks, recording.num_steps, step_s=recording.step_s)
        self.logged = replace(logged, length_m=sizes[:, 0].copy(), width_m=sizes[:, 1].copy())
        self._grid: CellGrid = build_cell_grid(recording.graph)
        self._net = net_bytes(self._grid)

    def rollouts(self, config: Config, seeds: int, *, who: Who, vehicles: Sequence[TakenOut]) -> Iterator[Traffic]:
        """One rollout for each seed: all agents, those vehicles driven from the present on and the others as recorded.

        Errors: SimulationError.
        """
        if who == "constant velocity":
            yield from [self._at_constant_velocity(vehicles)] * seeds
            return
        if who == "default":
            config = config.model_copy(update={"car_following": CarFollowing(model="Krauss")})
        cast = self._cast(config, vehicles)
        own = "".join(one.track.track_id for one in vehicles) if len(vehicles) < len(self.vehicles) else ""
        seed = [config.request.seed, zlib.crc32((self.recording.scenario_id + own).encode())]
        parameters = {"sigma": 0.5} if who == "default" else model_parameters(config)
        with Simulation(
            self._net, seed=sumo_seed(seed), step_s=cast.scene.step_s, model=config.car_following.model,
            parameters=parameters,
        ) as simulation:  # fmt: skip
            for number in range(seeds):
                driven = _drive(cast, simulation, np.random.default_rng([*seed, number]), who=who)
                yield self._as_traffic(cast, driven)

    def _cast(self, config: Config, vehicles: Sequence[TakenOut]) -> _Cast:
        recording, out = self.recording, {one.row for one in vehicles}
        others = [
            _since(track, NOW) for row, track in enumerate(recording.tracks)
            if row not in out and track.timesteps[-1] >= NOW
        ]  # fmt: skip
        scene = build_scene(
            self._grid, others, config=config, num_steps=recording.num_steps - NOW, step_s=recording.step_s,
            last_observed_step=recording.last_observed - NOW,
        )  # fmt: skip
        return _Cast(vehicles, scene, Roads(scene), StopLines(scene), [own_way(scene, one) for one in vehicles])

    def _as_traffic(self, cast: _Cast, driven: Sequence[DrivenVehicle]) -> Traffic:
        scene, found = cast.scene, []
        for way, vehicle in zip(cast.ways, driven, strict=True):
            s = np.array(vehicle.s)
            missing = scene.num_steps - s.size  # beyond the end of its lanes it goes straight on
            s = np.concatenate([s, s[-1] + vehicle.v[-1] * scene.step_s * np.arange(1, missing + 1)])
            motion = smooth_motion(s, filter_s=scene.config.smoothing.filter_s, step_s=scene.step_s)
            motion = replace(motion, s=motion.s + s[0] - motion.s[0])
            xy, heading = poses(way, vehicle.start, motion)
            found.append((xy[1:], heading[1:]))
        return self._with(cast.vehicles, found)

    def _at_constant_velocity(self, vehicles: Sequence[TakenOut]) -> Traffic:
        ahead_s = self.recording.step_s * np.arange(1, self.recording.num_steps - NOW)
        found = []
        for one in vehicles:
            found.append((one.position + ahead_s[:, None] * one.velocity, np.full(ahead_s.size, one.heading)))
        return self._with(vehicles, found)

    def _with(self, vehicles: Sequence[TakenOut], driven: Sequence[tuple[FloatArray, FloatArray]]) -> Traffic:
        """The recording with other positions and headings of some vehicles from behind the present on."""
        logged, rows = self.logged, [one.row for one in vehicles]
        position, heading = logged.position.copy(), logged.heading.copy()
        velocity, present = logged.velocity.copy(), logged.present.copy()
        for row, (xy, angle) in zip(rows, driven, strict=True):
            position[row, NOW + 1 :], heading[row, NOW + 1 :], present[row, NOW + 1 :] = xy, angle, True
            first = int(present[row].argmax())
            velocity[row, first:] = velocity_of(position[row, first:], self.recording.step_s)
        return replace(logged, position=position, heading=heading, velocity=velocity, present=present)

    def tracks_of(self, rollout: Traffic) -> list[Track]:
        """The driven vehicles of a rollout as they are written: recorded up to the present."""
        return [_driven_track(one, rollout) for one in self.vehicles]


def _since(track: Track, first: int) -> Track:
    """A track from a step on, which is its step 0."""
    there = track.timesteps >= first
    columns = {name: getattr(track, name)[there] for name in ("position", "heading", "velocity")}
    return replace(track, timesteps=track.timesteps[there] - first, **columns)


def _driven_track(one: TakenOut, rollout: Traffic) -> Track:
    track, steps = one.track, np.arange(NOW + 1, rollout.num_steps)
    known = track.timesteps <= NOW
    columns = {
        name: np.concatenate([getattr(track, name)[known], getattr(rollout, name)[one.row, steps]])
        for name in ("position", "heading", "velocity")
    }
    return replace(track, timesteps=np.concatenate([track.timesteps[known], steps]), **columns)


def _drive(cast: _Cast, simulation: Simulation, rng: np.random.Generator, *, who: Who) -> list[DrivenVehicle]:
    scene, moving = cast.scene, [one.speed_mps for one in cast.vehicles if one.speed_mps > _MOVES_MPS]
    pace_mps = float(np.median(moving)) if len(moving) >= _PACE_OF else scene.config.spawn.prior_speed_mps
    starts = [
        begin_by_default(scene, way, rng, number) if who == "default"
        else begin(scene, cast.roads, way, pace_mps, rng, number)
        for number, way in enumerate(cast.ways)
    ]  # fmt: skip
    steps = scene.future.num_steps
    fleet = Fleet(scene, starts, Traffic.none(steps), cast.roads, cast.stop_lines)
    for row, (way, one) in enumerate(zip(fleet.ways, starts, strict=True)):
        way.reroute_tried = True  # its route is its own
        known, obstacles = fleet.known_on_way(row), fleet.obstacles(row, one.path)
        # what it was recorded beside leaves it room, whatever the boxes say
        way.known = known.rows(~((known.low[:, 0] < one.start_s) & (one.start_s < known.high[:, 0])))
        beside = (obstacles.known.low[:, 0] < one.start_s) & (one.start_s < obstacles.known.high[:, 0])
        way.obstacles = replace(obstacles, known=obstacles.known.rows(~beside))
    driving = (_Unsteered if who == "default" else _Resimulated)(fleet, simulation, checked=False)
    return driving.run()
