"""Vehicles on small roads, with SUMO at the wheel."""

from collections.abc import Callable, Mapping

from inserted import nobody

from bridge.sumo.driving import FleetSimulation
from bridge.sumo.fleet import Fleet
from bridge.sumo.simulation import Simulation
from hid2.conflicts.stop_lines import StopLines
from hid2.occupancy.traffic import Traffic
from hid2.policy.roads import Roads
from hid2.scene import Scene
from hid2.vehicle import Start
from netconvert.net_xml import net_bytes

#: Of EIDM, as the default configuration has them.
PARAMETERS = {"sigmaerror": 0.1, "treaction": 0.5}


def drive(
    scene: Scene,
    *starts: Start,
    kept: Traffic | None = None,
    model: str = "EIDM",
    parameters: Mapping[str, float] = PARAMETERS,
    seed: int = 0,
    patch: Callable[[Simulation], None] | None = None,
    checked: bool = True,
) -> FleetSimulation:
    """A simulation that has been run. patch: changes SUMO before; kept: vehicles of earlier rounds."""
    given = parameters if model == "EIDM" else {}
    with Simulation(net_bytes(scene.grid), seed=seed, step_s=0.1, model=model, parameters=given) as simulation:
        if patch is not None:
            patch(simulation)
        others = kept or nobody(scene.future.num_steps)
        driving = FleetSimulation(
            Fleet(scene, starts, others, Roads(scene), StopLines(scene)), simulation, checked=checked
        )
        driving.run()
    return driving
