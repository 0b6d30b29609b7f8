"""One scenario: observe, plan, insert, decide, step, record, smooth, verify, export."""

import tempfile
import zlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from bridge.config import config_sha256
from bridge.generation.records import agent_record, with_unmet
from bridge.generation.rounds import Rounds, Settled, exported_track
from bridge.recordings.export import new_scenario_id, write_scene
from bridge.recordings.scenario import LAST_OBSERVED, Scenario
from bridge.recordings.sidecar import (
    GeneratorRecord,
    PlacedRecord,
    RejectedRecord,
    ReplayRecord,
    RequestedRecord,
    Sidecar,
)
from bridge.sumo.simulation import Simulation
from hid2.agents import Policy, Track
from hid2.conflicts.cases import DT_S
from hid2.motion.repair import SettledVehicle
from hid2.params import Config
from hid2.scene import World, build_world
from netconvert.cells import CellGrid, build_cell_grid
from netconvert.errors import ScenarioError
from netconvert.net_xml import net_bytes


@dataclass(frozen=True, eq=False, slots=True)
class GeneratedScene:
    """A recorded scene with generated vehicles in it, before it is written.

    generated: tracks gen_0, gen_1, ...; vehicles: their paths and motion, in the same order.
    """

    scenario: Scenario
    generated: tuple[Track, ...]
    sidecar: Sidecar
    focal_track_id: str
    new_id: str
    vehicles: tuple[SettledVehicle, ...]


@dataclass(frozen=True, eq=False, slots=True)
class PreparedScene:
    """What the variants of one scene share: grid and net."""

    scenario: Scenario
    grid: CellGrid
    net: bytes


def prepare(scenario: Scenario, config: Config) -> PreparedScene:
    """Grid and net of a scenario. Errors: MapError, NetError."""
    grid = build_cell_grid(scenario.graph, cell_m=config.grid.cell_m, max_skew_m=config.grid.max_skew_m)
    return PreparedScene(scenario=scenario, grid=grid, net=net_bytes(grid))


def generate(scenario: Scenario | PreparedScene, config: Config, *, variant: int = 0) -> GeneratedScene:
    """Insert vehicles into a recorded scene as `config` asks; nothing is written.

    Same scenario, configuration and variant: the same result. Errors: MapError, NetError, SimulationError,
    ScenarioError where a generated focal track was asked for and no vehicle lives through the scene.
    """
    prepared = scenario if isinstance(scenario, PreparedScene) else prepare(scenario, config)
    scene = prepared.scenario
    new_id = new_scenario_id(scene.scenario_id, config, config.request.seed, variant)
    seed = [config.request.seed, variant, zlib.crc32(scene.scenario_id.encode())]
    world = build_world(
        prepared.grid, scene.tracks, config=config, num_steps=scene.num_steps,
        last_observed_step=min(LAST_OBSERVED, scene.num_steps - 1),
    )  # fmt: skip
    with tempfile.TemporaryDirectory(prefix="hid2-") as folder:
        net = Path(folder) / "scene.net.xml"
        net.write_bytes(prepared.net)
        braking = config.car_following.decel_mps2
        with Simulation(net, seed=config.request.seed, step_s=DT_S, expected_decel_mps2=braking) as simulation:
            run = Rounds(world, simulation, seed)
            run.fill()
    run.credit_turns()
    vehicles = sorted(run.settled, key=lambda item: int(item.vehicle.driven.spec.vehicle_id.removeprefix("v")))
    tracks = [
        exported_track(item.vehicle, f"gen_{row}", config.request.generated_category)
        for row, item in enumerate(vehicles)
    ]
    focal = scene.focal_track_id
    if config.request.focal == "generated":
        focal = _focal(scene, vehicles, tracks)
        tracks = [_with_category(t, 3) if t.track_id == focal else t for t in tracks]
    sidecar = _sidecar(prepared, world, run, vehicles, variant=variant, sumo_version=run.sumo_version)
    return GeneratedScene(
        scenario=scene, generated=tuple(tracks), sidecar=sidecar, focal_track_id=focal, new_id=new_id,
        vehicles=tuple(item.vehicle for item in vehicles),
    )  # fmt: skip


def write(scene: GeneratedScene, out_dir: Path) -> Path:
    """Write a generated scene; returns its folder. Errors: ExportError."""
    return write_scene(
        scene.scenario,
        scene.generated,
        scene.sidecar,
        out_dir,
        new_id=scene.new_id,
        focal_track_id=scene.focal_track_id,
    )


def _with_category(track: Track, category: int) -> Track:
    return Track(
        track.track_id,
        track.object_type,
        category,
        track.timesteps,
        track.position,
        track.heading,
        track.velocity,
        track.size,
    )


def _focal(scene: Scenario, vehicles: Sequence[Settled], tracks: Sequence[Track]) -> str:
    """Generated focal track: lives through the scene; a manoeuvre done before none, a longer path before a shorter."""
    through = [
        (bool(item.driver.shifts) or item.driver.spec.policy is not Policy.STRAIGHT, track.path_m, track.track_id)
        for item, track in zip(vehicles, tracks, strict=True)
        if track.timesteps.size == scene.num_steps
    ]
    if not through:
        raise ScenarioError(f"{scene.folder}: no generated vehicle lives through the scene, want one as focal track")
    return max(through)[2]


def _sidecar(
    prepared: PreparedScene, world: World, run: Rounds, vehicles: Sequence[Settled], *, variant: int, sumo_version: str
) -> Sidecar:
    config = world.config
    traffic = world.traffic.joined(run.fixed)
    names = {item.vehicle.driven.spec.vehicle_id: f"gen_{row}" for row, item in enumerate(vehicles)}
    agents = [agent_record(item.vehicle, item.driver, world, traffic, names) for item in vehicles]
    agents = with_unmet(agents, run.unmet)
    placed = Counter(record.policy for record in agents)
    return Sidecar(
        source_scenario_id=prepared.scenario.scenario_id,
        generator=GeneratorRecord(version=version("hid2-sumo")),
        sumo_version=sumo_version,
        seed=config.request.seed,
        variant=variant,
        config=config.model_dump(mode="json"),
        config_sha256=config_sha256(config),
        replay=ReplayRecord(
            states=run.replay_errors.states,
            max_position_error_m=round(run.replay_errors.max_position_error_m, 9),
            max_heading_error_rad=round(run.replay_errors.max_heading_error_rad, 9),
        ),
        requested=RequestedRecord(agents=config.request.agents, behaviours=config.request.behaviours),
        placed=PlacedRecord(agents=len(agents), behaviours={p: placed[p] for p in Policy if placed[p]}),
        agents=tuple(agents),
        rejected=tuple(RejectedRecord(reason=reason, count=count) for reason, count in sorted(run.reasons.items())),
    )  # fmt: skip
