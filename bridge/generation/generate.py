"""One recording -> a denser one: request, site, driver, [observe, decide, act, step], smooth, verify, export."""

import logging
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bridge.config import check_exportable, config_sha256, new_scenario_id
from bridge.generation import records
from bridge.generation.scene import TrafficScene, scene_of
from bridge.recordings.export import recording_record_of, with_generated, with_motion
from bridge.recordings.plausibility import implausible
from bridge.recordings.recording import Recording
from bridge.recordings.sidecar import PlacedRecord, ReplayRecord, RequestedRecord, Sidecar, StatesRecord
from bridge.sumo.drivers import model_parameters
from bridge.sumo.driving import FleetSimulation
from bridge.sumo.fleet import Fleet
from bridge.sumo.replay import ReplayErrors
from bridge.sumo.simulation import Simulation
from hid2.agents import Policy, Track
from hid2.conflicts.stop_lines import StopLines
from hid2.insertion.events import SceneEvents
from hid2.insertion.filling import Filling
from hid2.insertion.finalise import ExportedVehicle, traffic_of_exported
from hid2.insertion.surroundings import Surroundings
from hid2.insertion.tracker_noise import with_noise
from hid2.measures.arrays import is_generated_id
from hid2.occupancy.traffic import Traffic
from hid2.params import Config
from hid2.scene import Scene
from hid2.vehicle import DrivenVehicle, Start
from netconvert.cells import CellGrid, build_cell_grid
from netconvert.errors import ConfigError, ScenarioError
from netconvert.net_xml import net_bytes

#: Radius around a generated focal track in which tracks are its neighbours, m. No tunable: what a focal track is.
_FOCAL_RADIUS_M = 50.0
_LOG = logging.getLogger(__name__)

#: Variants that what vehicles find is kept for. No tunable, bounds memory: 20 MB more from each with 20 vehicles.
_VARIANTS_KEPT = 8


@dataclass(eq=False, slots=True, repr=False)
class PreparedScene:
    """What the variants of one scene share: grid, nets by their speed limit, and what vehicles find there.

    config: by whose `grid` and `source` it was prepared.
    """

    scenario: Recording
    grid: CellGrid
    config: Config
    _nets: dict[float, bytes] = field(default_factory=dict)
    _surroundings: Surroundings | None = None
    _asked: int = 0

    def net(self, config: Config) -> bytes:
        """The net on which the drivers of a configuration may drive as fast as they desire. Errors: NetError."""
        fastest_mps = config.spawn.max_speed_mps
        if fastest_mps not in self._nets:
            self._nets[fastest_mps] = net_bytes(self.grid, fastest_mps=fastest_mps)
        return self._nets[fastest_mps]

    def simulation(self, config: Config, seed: Sequence[int]) -> Simulation:
        """SUMO on the net of a configuration, with its drivers and gap check. Errors: NetError."""
        return Simulation(
            self.net(config), seed=sumo_seed(seed), step_s=self.scenario.step_s, model=config.car_following.model,
            parameters=model_parameters(config), checks_gaps=config.lane_change.safety == "sumo",
        )  # fmt: skip

    def surroundings(self, config: Config) -> Surroundings:
        """What vehicles find in the scene; kept for the next ones with the same configuration."""
        self._asked += 1
        worn = self._asked % _VARIANTS_KEPT == 0
        if self._surroundings is None or worn or self._surroundings.scene.config != config:
            self._surroundings = Surroundings(scene_of(self.scenario, config, self.grid))
        return self._surroundings


def prepare(source: Recording | TrafficScene, config: Config) -> PreparedScene:
    """Grid of a recorded scene.

    Errors: MapError; ScenarioError where it is not plausible, was generated or has ids gen_*; ConfigError for no scene.
    """
    scenario = source.recording if isinstance(source, TrafficScene) else source
    if not isinstance(scenario, Recording):  # a path, mostly
        raise ConfigError(f"source {str(source)[:200]!r}: expected a scene, as read_scene(path) gives it")
    if scenario.sidecar is not None:
        raise ScenarioError(f"{scenario.folder}: vehicles are inserted already; expected the recorded scene")
    if taken := [one.track_id for one in scenario.tracks if is_generated_id(one.track_id)]:
        raise ScenarioError(
            f"{scenario.folder}: track {taken[0]!r}: ids gen_* are inserted vehicles'; rename the track"
        )
    if config.source.plausible and (said := implausible(scenario)):
        raise ScenarioError(f"{scenario.folder}: {said}; --set source.plausible=false goes on all the same")
    return PreparedScene(scenario, build_cell_grid(scenario.graph, cell_m=config.grid.cell_m), config)


def generate(source: Recording | TrafficScene | PreparedScene, config: Config, *, variant: int = 0) -> TrafficScene:
    """Insert vehicles into a recorded scene as `config` asks; nothing is written.

    source: a scene as `read_scene` gives it or, for several variants of it, as `prepare` does. Same scenario,
    configuration and variant: the same result. Errors: MapError, NetError, SimulationError, ConfigError,
    ScenarioError where a generated focal track was asked for and no vehicle lives through the scene.
    """
    if not isinstance(config, Config):
        raise ConfigError(f"config {config!r:.200}: expected a Config, as load_config gives it")
    check_exportable(config)
    prepared = source if isinstance(source, PreparedScene) else prepare(source, config)
    if (prepared.config.grid, prepared.config.source) != (config.grid, config.source):
        prepared = prepare(prepared.scenario, config)
    scenario = prepared.scenario
    new_id = new_scenario_id(scenario.scenario_id, config, config.request.seed, variant)
    seed = [config.request.seed, variant, zlib.crc32(scenario.scenario_id.encode())]
    surroundings = prepared.surroundings(config)
    scene, filling = surroundings.scene, Filling(surroundings, seed)
    _LOG.debug("%s variant %d: %s vehicles asked for", scenario.scenario_id, variant, config.request.agents)
    with prepared.simulation(config, seed) as simulation:
        rounds = _Rounds(simulation, filling, scenario)
        if config.driving.replay == "reactive":
            filling.fill_together(rounds.drive)
            scenario = with_motion(scenario, rounds.late)
        else:
            filling.take_events(SceneEvents(surroundings, seed).run(rounds.drive_alone))
            filling.fill(rounds.drive)
        sumo_version = simulation.version()
    vehicles = sorted(filling.kept, key=lambda one: one.driven.start.request.number)
    tracks = [one.track(f"gen_{row}", config.request.generated_category) for row, one in enumerate(vehicles)]
    clean: list[Track] = []
    if config.export.adds_noise(scenario.provenance):
        clean, tracks = tracks, with_noise(scene, tracks, [one.course for one in vehicles], seed)
    elif config.export.noise != "none":
        _LOG.warning("%s: people labelled it, so export.noise adds nothing", scenario.folder)
    focal = scenario.focal_track_id
    if config.request.focal == "generated":
        focal = _focal(scenario, vehicles, tracks, filling)
    sidecar = _sidecar(prepared, filling, vehicles, clean, rounds, focal, variant=variant, sumo_version=sumo_version)
    made = with_generated(scenario, tracks, sidecar, new_id=new_id, focal_track_id=focal)
    return TrafficScene(made, scenario, tuple(vehicles), tuple(rounds.driven))


def sumo_seed(seed: Sequence[int]) -> int:
    """SUMO's seed from seed, variant and scene; rounds go on in its stream of random numbers."""
    return zlib.crc32(repr(list(seed)).encode()) & 0x7FFFFFFF


class _Rounds:
    """Drives the starts of each round in the one simulation of a scene.

    late: tracks of the recorded vehicles that yielded at last, late_s: how late that made them; where they react.
    """

    def __init__(self, simulation: Simulation, filling: Filling, scenario: Recording) -> None:
        self._simulation, self._filling, self._scenario = simulation, filling, scenario
        self.errors = ReplayErrors()
        self.driven: list[tuple[int, DrivenVehicle]] = []
        self.late: list[Track] = []
        self.late_s: Mapping[str, float] = {}

    def drive_alone(self, scene: Scene, stop_lines: StopLines, start: Start, kept: Traffic) -> DrivenVehicle:
        """One vehicle by the rules of a scene of its own, which may differ from the others': that of an event."""
        fleet = Fleet(scene, [start], kept, self._filling.surroundings.roads, stop_lines)
        (vehicle,) = FleetSimulation(fleet, self._simulation, checked=False).run()
        self.driven.append((0, vehicle))
        return vehicle

    def drive(self, starts: Sequence[Start], kept: Traffic, number: int) -> list[DrivenVehicle]:
        """One simulation, from the scene as it was recorded; where vehicles react the filling gets it as it became.

        Poses of recorded agents are measured, where that is asked for, in the first one, or, where they react, last.
        """
        here, scene = self._filling.surroundings, self._filling.surroundings.scene
        is_measured = number == 0 or scene.config.driving.replay == "reactive"
        fleet = Fleet(scene, starts, kept, here.roads, here.stop_lines)
        driving = FleetSimulation(fleet, self._simulation, checked=scene.config.driving.check_replay and is_measured)
        vehicles = driving.run()
        self.driven += [(number, vehicle) for vehicle in vehicles]
        if is_measured:
            self.errors = driving.replay_errors
        if driving.reactions is not None:
            self.late_s = driving.reactions.late_s
            tracks = driving.reactions.tracks(self._scenario.tracks)
            self.late = [track for track in tracks if track.track_id in self.late_s]
            self._filling.scene = scene_of(self._scenario, scene.config, scene.grid, tracks=tracks)
        return vehicles


def _focal(scenario: Recording, vehicles: Sequence[ExportedVehicle], tracks: Sequence[Track], filling: Filling) -> str:
    """Generated focal track: lives through the scene; a manoeuvre done before none, then more neighbours before fewer.

    Neighbours are all tracks within _FOCAL_RADIUS_M at the last observed step: what a forecaster of this track sees.
    """
    last = scenario.last_observed
    around = np.concatenate([track.position[track.timesteps == last] for track in (*scenario.tracks, *tracks)])
    done = {vehicle_id for vehicle_id, outcome in filling.outcomes.items() if outcome.done}
    through = [
        (
            one.driven.vehicle_id in done,
            int((np.hypot(*(around - track.position[last]).T) <= _FOCAL_RADIUS_M).sum()),
            track.path_m,
            track.track_id,
        )
        for one, track in zip(vehicles, tracks, strict=True)
        if track.timesteps.size == scenario.num_steps
    ]
    if not through:
        raise ScenarioError(f"{scenario.folder}: no generated vehicle lives to its end; expected one as focal track")
    return max(through)[-1]


def _sidecar(
    prepared: PreparedScene, filling: Filling, vehicles: Sequence[ExportedVehicle], clean: Sequence[Track],
    rounds: _Rounds, focal_track_id: str, *, variant: int, sumo_version: str,
) -> Sidecar:  # fmt: skip
    scene, config = filling.scene, filling.scene.config
    names = {one.driven.vehicle_id: f"gen_{row}" for row, one in enumerate(vehicles)}
    every = traffic_of_exported(vehicles, scene)
    agents = [
        records.agent_record(
            scene, one, filling.outcomes.get(one.driven.vehicle_id), names,
            every.rows([other for other in range(len(vehicles)) if other != row and one.driven.shifts]),
        ) for row, one in enumerate(vehicles)
    ]  # fmt: skip
    if clean:
        told = [StatesRecord.of(track) for track in clean]
        agents = [agent.model_copy(update={"clean": states}) for agent, states in zip(agents, told, strict=True)]
    placed, focal = Counter(record.policy for record in agents), None
    if (record := next((one for one in agents if one.track_id == focal_track_id), None)) is not None:
        focal = record.policy if any(one.status == "done" for one in record.maneuvers) else Policy.STRAIGHT
    # `max` asks for more than the road holds: what it could not hold was not wished for
    most_unmet = placed[Policy.STRAIGHT] if config.request.agents == "max" else None
    return Sidecar(
        source_scenario_id=prepared.scenario.scenario_id,
        generator=records.generator_record(),
        recording=recording_record_of(prepared.scenario),
        sumo_version=sumo_version,
        seed=config.request.seed,
        variant=variant,
        config=config.model_dump(mode="json"),
        config_sha256=config_sha256(config),
        replay=ReplayRecord(
            mode=config.driving.replay,
            late_s=rounds.late_s,
            checked=config.driving.check_replay,
            states=rounds.errors.states,
            max_position_error_m=round(rounds.errors.max_position_error_m, 9),
            max_heading_error_rad=round(rounds.errors.max_heading_error_rad, 9),
        ),
        requested=RequestedRecord(agents=config.request.agents, behaviours=config.request.behaviours),
        placed=PlacedRecord(
            agents=len(agents),
            behaviours={p: count for p in config.request.behaviours if (count := placed[p])},
            near=records.near_count(scene, vehicles),
            entered=sum(record.spawn.timestep > 0 for record in agents),
            focal=focal,
        ),
        agents=tuple(agents),
        unmet=tuple(records.unmet_record(one) for one in filling.unmet[:most_unmet]),
        events=tuple(records.event_record(one, names) for one in filling.events),
        rejected=records.rejected_records(filling),
        replaced=tuple(records.replaced_record(one) for one in filling.rejected),
        selection=records.selection_record(scene, filling),
        wanted={name: round(share, 3) for name, share in filling.surroundings.shares.items()},
    )
