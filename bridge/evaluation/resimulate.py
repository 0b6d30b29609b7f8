"""`hid2 resimulate`: recorded vehicles taken out and driven by SUMO, scored as simulated agents are ("WOSAC-like")."""

import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from bridge.batch.engine import OnDone, sorted_out, work_on_each
from bridge.config import config_sha256, load_config, new_scenario_id
from bridge.evaluation.calibrate import observe_scene, scenes_below
from bridge.evaluation.evaluate import write_table
from bridge.files import explained, with_name
from bridge.generation.generate import sumo_seed
from bridge.generation.records import generator_record
from bridge.pages.parts import write_page
from bridge.recordings.export import recording_record_of, with_generated, with_motion, write_recording
from bridge.recordings.judging import recording_states
from bridge.recordings.recording import Recording
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sidecar import PlacedRecord, ReplayRecord, RequestedRecord, Sidecar
from bridge.sumo.drivers import model_parameters
from bridge.sumo.driving import FleetSimulation
from bridge.sumo.fleet import Fleet
from bridge.sumo.simulation import Simulation
from bridge.sumo.steering import Attempt
from hid2.agents import FloatArray, Track
from hid2.conflicts.stop_lines import StopLines
from hid2.evaluation import likelihood
from hid2.evaluation.calibration import calibrate, drivers_of
from hid2.evaluation.likelihood import FEATURES, GROUPS, LAST, NOW, Features, features, likelihoods, scene_scores
from hid2.evaluation.resimulated import TakenOut, begin, own_path, poses, taken_out
from hid2.measures.arrays import MOVES_MPS, BoolArray
from hid2.occupancy.along_path import PathOccupancy
from hid2.occupancy.traffic import Traffic, traffic_of, velocity_of
from hid2.params import CarFollowing, Config, Drivers
from hid2.policy.roads import Roads
from hid2.resampling import ratio
from hid2.scene import build_scene
from netconvert.cells import build_cell_grid
from netconvert.errors import ConfigError, ScenarioError, SimulationError
from netconvert.net_xml import net_bytes

TakeOut = Literal["all", "one"]
#: Calibrated drivers with guard, turns and stop lines; SUMO's default ones with none; none at all.
_Model = Literal["calibrated", "default", "constant velocity"]
MODELS = ("calibrated", "reference", "constant velocity", "default", "log")
_SCENE_S = 60.0  # longest time that a scene may take for a seed
#: Least vehicles moving at the present for a scene's pace that is not the prior. No tunable: what a recording tells.
_PACE_OF = 3


class ResimulationPlan(NamedTuple):
    """Rollouts of each scene and vehicle, which vehicles are driven at once, rollouts to write, seed."""

    seeds: int = 32
    take_out: TakeOut = "all"
    write: int = 0
    seed: int = 0


class SceneScores(NamedTuple):
    """Of one scene: ids of those driven; why the others were not; features as recorded; likelihoods (9, N) by model."""

    name: str
    driven: tuple[str, ...]
    left: Mapping[str, str]
    recorded: Features
    found: dict[str, FloatArray]


class _Unsteered(FleetSimulation):
    """SUMO alone: neither guard nor turns nor stop lines."""

    def _steer(self, step: int) -> tuple[dict[int, Attempt], dict[int, tuple[float, str]]]:
        return {}, {}


class Resimulation:
    """A recording with its vehicles taken out: logged (A, T) as it was, the vehicles that are driven, those left."""

    def __init__(self, recording: Recording) -> None:
        tracks = recording.tracks
        self.vehicles, self.left = taken_out(recording_states(recording), tracks, NOW)
        length_m, width_m = np.array([track.size for track in tracks]).T.copy()
        logged = traffic_of(tracks, recording.num_steps, step_s=recording.step_s, velocity_by=velocity_of)
        self.logged = replace(logged, length_m=length_m, width_m=width_m)
        self.recording, self._grid = recording, build_cell_grid(recording.graph)
        self._net = net_bytes(self._grid)

    def rollouts(self, config: Config, seeds: int, *, model: _Model, vehicles: Sequence[TakenOut]) -> Iterator[Traffic]:
        """A rollout for each seed, one for constant velocity: vehicles driven from the present on, others as recorded.

        Errors: SimulationError.
        """
        recording, rows = self.recording, {one.row for one in vehicles}
        if model == "constant velocity":
            ahead_s = recording.step_s * np.arange(recording.num_steps - NOW)[:, None]
            motion = [(one.position + ahead_s * one.velocity, np.full(ahead_s.size, one.heading)) for one in vehicles]
            yield self._with(vehicles, motion)
            return
        if model == "default":
            config = config.model_copy(update={"car_following": CarFollowing(model="Krauss")})
        others = (track for row, track in enumerate(recording.tracks) if row not in rows)
        kept = [_some(track, track.timesteps >= NOW) for track in others if track.timesteps[-1] >= NOW]
        steps, last = recording.num_steps - NOW, recording.last_observed - NOW
        scene = build_scene(
            self._grid, kept, config=config, num_steps=steps, step_s=recording.step_s, last_observed_step=last
        )
        roads, stop_lines, own = Roads(scene), StopLines(scene), [one.track.track_id for one in vehicles]
        paths = [own_path(scene, one) for one in vehicles]
        moving = [one.speed_mps for one in self.vehicles if one.speed_mps > MOVES_MPS]
        usual_mps = float(np.median(moving)) if len(moving) >= _PACE_OF else config.spawn.prior_speed_mps
        seed = [config.request.seed, zlib.crc32(" ".join([recording.scenario_id, *own]).encode())]
        law, parameters = config.car_following.model, {"sigma": 0.5} if model == "default" else model_parameters(config)
        with Simulation(
            self._net, seed=sumo_seed(seed), step_s=scene.step_s, model=law, parameters=parameters
        ) as simulation:
            for rollout in range(seeds):
                rng, pace_mps = np.random.default_rng([*seed, rollout]), None if model == "default" else usual_mps
                starts = [
                    begin(scene, roads, one, path, rng, number=number, usual_mps=pace_mps)
                    for number, (one, path) in enumerate(zip(vehicles, paths, strict=True))
                ]
                fleet = Fleet(scene, starts, Traffic.none(scene.future.num_steps), roads, stop_lines)
                for row, (context, start) in enumerate(zip(fleet.contexts, starts, strict=True)):
                    context.reroute_tried = True  # its route is its own
                    context.in_width = _ahead(fleet.in_width(row), start.start_m)
                    seen = fleet.obstacles(row, start.path)
                    context.obstacles = replace(seen, known=_ahead(seen.known, start.start_m))
                driving = (_Unsteered if model == "default" else FleetSimulation)(fleet, simulation, checked=False)
                driven = list(zip(driving.run(), vehicles, strict=True))
                for vehicle, one in driven:
                    if vehicle.not_inserted is not None:
                        raise SimulationError(f"{recording.folder}: {one.track.track_id}: {vehicle.not_inserted.text}")
                yield self._with(vehicles, [poses(scene, vehicle, one) for vehicle, one in driven])

    def _with(self, vehicles: Sequence[TakenOut], driven: Sequence[tuple[FloatArray, FloatArray]]) -> Traffic:
        """The recording with other positions and headings of some vehicles from the present on."""
        logged = self.logged
        position, heading = logged.position.copy(), logged.heading.copy()
        velocity, present = logged.velocity.copy(), logged.present.copy()
        for one, (xy, angle) in zip(vehicles, driven, strict=True):
            position[one.row, NOW + 1 :], heading[one.row, NOW + 1 :], present[one.row, NOW:] = xy[1:], angle[1:], True
            first = int(present[one.row].argmax())
            velocity[one.row, first:] = velocity_of(position[one.row, first:], self.recording.step_s)
        return replace(logged, position=position, heading=heading, velocity=velocity, present=present)

    def write(self, rollout: Traffic, config: Config, number: int, out: Path) -> Path:
        """Write a rollout as a scene, marked: its recorded vehicles drive otherwise. Errors: ExportError."""
        recording, tracks = self.recording, list[Track]()
        for one in self.vehicles:
            past, span = _some(one.track, one.track.timesteps <= NOW), slice(NOW + 1, rollout.num_steps)
            steps = np.concatenate([past.timesteps + NOW, np.arange(span.start, span.stop)])
            pairs = [(getattr(past, name), getattr(rollout, name)) for name in ("position", "heading", "velocity")]
            xy, angle, velocity = (np.concatenate([known, driven[one.row, span]]) for known, driven in pairs)
            tracks.append(replace(past, timesteps=steps, position=xy, heading=angle, velocity=velocity))
        config = config.model_copy(update={"driving": config.driving.model_copy(update={"replay": "reactive"})})
        late_s, seed = {track.track_id: 0.0 for track in tracks}, config.request.seed
        replay = ReplayRecord(
            mode="reactive", late_s=late_s, checked=False, states=0, max_position_error_m=0.0, max_heading_error_rad=0.0
        )
        sidecar = Sidecar(
            source_scenario_id=recording.scenario_id, recording=recording_record_of(recording), seed=seed,
            generator=generator_record(), sumo_version=Simulation.version(), variant=number, replay=replay,
            config=config.model_dump(mode="json"), config_sha256=config_sha256(config),
            requested=RequestedRecord(agents=0, behaviours={}), placed=PlacedRecord(agents=0, behaviours={}),
        )  # fmt: skip
        new_id, focal = new_scenario_id(recording.scenario_id, config, seed, number), recording.focal_track_id
        moved = with_generated(with_motion(recording, tracks), [], sidecar, new_id=new_id, focal_track_id=focal)
        return write_recording(moved, out)


def _some(track: Track, there: BoolArray) -> Track:
    """Some steps of a track, counted from the present."""
    motion = {name: getattr(track, name)[there] for name in ("position", "heading", "velocity")}
    return replace(track, timesteps=track.timesteps[there] - NOW, **motion)


def _ahead(known: PathOccupancy, start_m: float) -> PathOccupancy:
    """Without those that a vehicle was recorded beside: they left it room, whatever the boxes say."""
    return known.rows(~((known.low[:, 0] < start_m) & (start_m < known.high[:, 0])))


def resimulate_folders(
    paths: Sequence[Path], out: Path, plan: ResimulationPlan, *, jobs: int = 1, on_scene: OnDone = None
) -> list[tuple[Path, str]]:
    """Drive the recorded vehicles of scenes and score them: a page, two tables and `plan.write` rollouts of each scene.

    Each half of the scenes, every other one by id, is driven by drivers calibrated with the other half. Returns the
    scenes that failed. Errors: ConfigError, ScenarioError where fewer than two scenes have a vehicle to drive.
    """
    if plan.write and plan.take_out == "one":
        raise ConfigError("--write with --take-out one: in a scene that is written all are driven; expected all")
    if plan.write > plan.seeds:
        raise ConfigError(f"--write {plan.write}: of {plan.seeds} rollouts (--seeds), expected as many at most")
    if plan.write and (out / "scenes").exists():
        raise ConfigError(f"{out / 'scenes'}: is there already, expected a folder without it: choose another one")
    load_config(flags={"request.seed": plan.seed})  # before anything is driven
    folders = [*scenes_below(paths).values()]
    if len(folders) < 2:
        said = f"{paths[0]}: Argoverse 2 scenes: {len(folders)}, expected two at least"
        raise ConfigError(f"{said}: each half is driven as calibrated in the other")
    seen, failures = sorted_out(work_on_each(observe_scene, folders, LAST + 1, jobs=jobs, chunk=4, timeout_s=120))
    folders = [one for one in folders if one not in {failed for failed, _ in failures}]
    halves = [drivers_of(calibrate(seen[1 - half :: 2], prior=Drivers())) for half in (0, 1) if seen[1:]]
    drivers = {folder: halves[number % 2] for number, folder in enumerate(folders) if halves}
    shared, long_s = (plan, drivers, out), _SCENE_S * plan.seeds
    scenes, failed = sorted_out(
        work_on_each(score_scene, [*drivers], shared, jobs=jobs, chunk=1, timeout_s=long_s, on_item=on_scene)
    )
    failures += failed
    some = [scene for scene in scenes if scene.driven]
    if len(some) < 2:
        left = Counter(why for scene in scenes for why in scene.left.values())
        told = [*failures[:1], *((f"{number} vehicles", why) for why, number in left.most_common(1))]
        said = "".join(f"; {with_name(*one)}" for one in told)
        raise ScenarioError(f"{paths[0]}: {len(some)} scenes with a vehicle to drive, expected two at least{said}")
    for scene in some:  # the reference: in each rollout recorded vehicles of other scenes, drawn
        others = [[part[:, :, : LAST + 1] for part in one.recorded] for one in some if one is not scene]
        pool = Features(*map(np.hstack, zip(*others, strict=True)))  # recordings go on for different times
        rng = np.random.default_rng([plan.seed, zlib.crc32(scene.name.encode())])
        drawn = rng.integers(pool.values.shape[1], size=(plan.seeds, len(scene.driven)))
        scene.found["reference"] = likelihoods(scene.recorded, [pool.agents(rows) for rows in drawn])
    with explained(out):
        _write(scenes, some, failures, out, plan, halves)
    return failures


def score_scene(shared: tuple[ResimulationPlan, Mapping[Path, Mapping[str, float]], Path], folder: Path) -> SceneScores:
    """Rollouts of one scene and what they are worth. Errors: ScenarioError, MapError, SimulationError, ExportError."""
    (plan, drivers, out), recording = shared, read_scenario(folder)
    made, beyond, step_s = Resimulation(recording), likelihood.beyond_edge(recording.graph), recording.step_s
    config = Config.model_validate({"drivers": drivers[folder], "request": {"seed": plan.seed}})
    every = np.array([one.row for one in made.vehicles], dtype=np.int64)
    recorded = features(made.logged, every, beyond, step_s=step_s)
    found = {"log": likelihoods(recorded, [recorded] * plan.seeds)}
    groups = [made.vehicles] if plan.take_out == "all" else [[one] for one in made.vehicles]
    model: _Model
    for model in ("calibrated", "default", "constant velocity") if made.vehicles else ():
        columns, number = [], 0
        for vehicles in groups:
            rows, own = np.array([one.row for one in vehicles]), list[Features]()
            for rollout in made.rollouts(config, plan.seeds, model=model, vehicles=vehicles):
                if model == "calibrated" and len(own) < plan.write:
                    made.write(rollout, config, len(own), out / "scenes")
                own.append(features(rollout, rows, beyond, step_s=step_s))
            of = recorded.agents(np.arange(number, number := number + len(rows)))
            columns.append(likelihoods(of, own * (plan.seeds // len(own))))
        found[model] = np.concatenate(columns, axis=1)
    left = {track_id: str(why) for track_id, why in made.left.items()}
    return SceneScores(recording.scenario_id, tuple(one.track.track_id for one in made.vehicles), left, recorded, found)


def _write(
    scenes: Sequence[SceneScores], some: Sequence[SceneScores], failures: Sequence[tuple[Path, str]], out: Path,
    plan: ResimulationPlan, halves: Sequence[Mapping[str, float]],
) -> None:  # fmt: skip
    names = [*(one.name for one in FEATURES), *(f"all of {group}" for group in GROUPS), "sum"]
    scores = {model: np.array([scene_scores(scene.found[model]) for scene in some]) for model in MODELS}
    rows, ones = [], np.ones(len(some))
    for column, name in enumerate(names):
        by_model = {model: ratio(scores[model][:, column], ones)._asdict() for model in MODELS}
        over = ratio(scores["calibrated"][:, column], scores["reference"][:, column])._asdict()
        rows.append({"name": name, **by_model, "over": over})
    write_table(out / "scores.csv", [
        {"scene": scene.name, "model": model, **dict(zip(names, scores[model][place].tolist(), strict=True))}
        for place, scene in enumerate(some) for model in MODELS
    ])  # fmt: skip
    write_table(out / "vehicles.csv", [
        {"scene": scene.name, "track_id": track_id, "driven": not why, "why_not": why}
        for scene in scenes for track_id, why in [*((one, "") for one in scene.driven), *scene.left.items()]
    ])  # fmt: skip
    counts = {
        "measured": [len(half) for half in halves],
        "driven": sum(len(scene.driven) for scene in some),
        "left": Counter(why for scene in scenes for why in scene.left.values()).most_common(),
        "unscored": [*failures, *((scene.name, "no vehicle to drive") for scene in scenes if not scene.driven)],
    }
    said = {"plan": plan, "rows": rows, "models": MODELS, "features": FEATURES, "scenes": len(some)}
    write_page(out / "resimulation.html", "resimulation.html.j2", **said, **counts)
