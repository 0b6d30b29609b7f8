"""The only file that imports libsumo: one simulation per process, as a context manager with an explicit seed."""

import contextlib
import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import ClassVar, Self

os.environ.setdefault("LIBSUMO_AS_TRACI", "quiet")  # read on import: silences a remark about pyarrow on stdout

import libsumo

from bridge.sumo.drivers import driver_attributes
from hid2.agents import BoxSize
from hid2.drivers.driver import Driver
from hid2.kernels.gaps import ASIDE_M
from netconvert.errors import SimulationError

#: TraCI lane-change mode: no change of SUMO's own; one asked for is refused where speeds and brake gaps forbid it.
_ONLY_ASKED_IF_SAFE = 512
_ASKED_ANYHOW = 0  # TraCI lane-change mode: no change of SUMO's own; one asked for is carried out
_OWN_WISH = 1621  # TraCI lane-change mode, SUMO's default: its model changes lanes as it likes
#: TraCI speed mode: a speed that is set is bounded by car following (1) and the greatest acceleration (2), so that it
#: limits what SUMO chooses; it may brake harder than is comfortable (4 is left out). 8 and 16: right of way and red
#: lights at junctions, of which a net of hid2 has none.
_SAFE_SPEED = 1 + 2 + 8 + 16
#: Motives of SUMO's lane-change model, as it names them.
_MOTIVES = frozenset({"strategic", "cooperative", "speedGain", "keepRight"})
_KEEP_ROUTE = 6  # TraCI moveToXY: exactly there, on a road or off it
_ASIDE_MATCH_M = 1e-9  # distance up to which a place is matched to a lane; no tunable: too little for any lane
_NET, _START, _TYPES = "scene.net.xml", "start.xml", "types.add.xml"
_DRIVEN = "driven"
#: What of a vehicle type libsumo sets while it runs: names, so that a file in its place is found where it is used.
_SAME = ("accel", "decel", "emergencyDecel", "tau", "minGap", "maxSpeed", "speedFactor")
_SETTERS = {name: f"set{name[0].upper()}{name[1:]}" for name in _SAME}
_SETTERS |= {"speedDev": "setSpeedDeviation", "sigma": "setImperfection"}


class Simulation:
    """A running SUMO. Use as `with Simulation(net, seed=0, step_s=0.1) as sumo:`.

    net: content of its file; model: car-following model of the vehicles that SUMO drives, as it is named in SUMO;
    parameters: its attributes; checks_gaps: whether SUMO refuses a lane change that its own gaps forbid; own_wish:
    whether its own model changes lanes, too. Errors: SimulationError for a net that SUMO refuses, and for a second
    simulation in one process.
    """

    _running: ClassVar[bool] = False

    def __init__(
        self, net: bytes, *, seed: int, step_s: float, model: str = "EIDM",
        parameters: Mapping[str, float] | None = None, checks_gaps: bool = True, own_wish: bool = False,
    ) -> None:  # fmt: skip
        self._net = net
        self._model, self._parameters = model, dict(parameters or {})
        self._change_mode = _OWN_WISH if own_wish else _ONLY_ASKED_IF_SAFE if checks_gaps else _ASKED_ANYHOW
        self._seed = seed
        self._step_s = step_s
        self._types: set[str] = set()
        self._routes = 0
        self._beside: tempfile.TemporaryDirectory[str] | None = None

    def __enter__(self) -> Self:
        """Start SUMO."""
        if Simulation._running:
            raise SimulationError("a simulation is already running in this process, expected one at a time")
        self._beside = tempfile.TemporaryDirectory(prefix="hid2-sumo-")
        net, types = Path(self._beside.name, _NET), Path(self._beside.name, _TYPES)
        net.write_bytes(self._net)
        extra = "".join(f' {name}="{value:g}"' for name, value in self._parameters.items())
        types.write_text(f'<additional><vType id="{_DRIVEN}" carFollowModel="{self._model}"{extra}/></additional>')
        command = [
            "sumo", "--net-file", str(net), "--additional-files", str(types),
            "--step-length", f"{self._step_s}", "--seed", str(self._seed),
            "--collision.action", "none", "--time-to-teleport", "-1", "--lanechange.duration", "0",
            "--no-step-log", "true", "--no-warnings", "true", "--duration-log.disable", "true",
        ]  # fmt: skip
        try:
            libsumo.start(command)
        except (libsumo.TraCIException, libsumo.FatalTraCIError) as error:
            self._beside.cleanup()
            raise SimulationError(f"SUMO does not load the net: {error}") from error
        Simulation._running = True
        libsumo.route.add("replay", [next(e for e in libsumo.edge.getIDList() if not e.startswith(":"))])
        libsumo.simulation.saveState(f"{self._beside.name}/{_START}")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close SUMO, also behind an error."""
        Simulation._running = False
        libsumo.close()
        if self._beside is not None:
            self._beside.cleanup()

    def rewind(self) -> None:
        """Back to the empty net at the start, as after a fresh start, but without loading the net again."""
        assert self._beside is not None
        libsumo.simulation.loadState(f"{self._beside.name}/{_START}")
        self._types.clear()

    @staticmethod
    def version() -> str:
        """SUMO's version as it names itself, e.g. `SUMO 1.28.0`."""
        return str(libsumo.getVersion()[1]) if Simulation._running else str(libsumo.__version__)

    def add_replayed(self, vehicle_id: str, *, length_m: float, width_m: float) -> None:
        """Add a vehicle that is placed by hand at every step from now on."""
        type_id = f"replay_{length_m:.3f}_{width_m:.3f}"
        if type_id not in self._types:
            libsumo.vehicletype.copy("DEFAULT_VEHTYPE", type_id)
            libsumo.vehicletype.setLength(type_id, length_m)
            libsumo.vehicletype.setWidth(type_id, width_m)
            libsumo.vehicletype.setSpeedDeviation(type_id, 0.0)  # replayed agents draw no random numbers from others
            libsumo.vehicletype.setVehicleClass(type_id, "ignoring")  # recorded agents are where they are, on any lane
            libsumo.vehicletype.setActionStepLength(type_id, 1000.0)  # s: SUMO never thinks about where they would go
            self._types.add(type_id)
        libsumo.vehicle.add(vehicle_id, "replay", typeID=type_id, depart="now")

    def place_all(self, poses: Sequence[tuple[str, float, float, float, tuple[str, int] | None]]) -> None:
        """Put replayed vehicles' front bumpers at their exact poses for the coming step.

        Each: (vehicle id, x, y, angle in degrees, lane). lane: edge and index on which it is seen; None: on no lane, so
        that no vehicle follows it.
        """
        move = libsumo.vehicle.moveToXY
        for vehicle_id, x, y, angle_deg, lane in poses:
            edge, index = lane or ("", -1)
            move(vehicle_id, edge, index, x, y, angle_deg, _KEEP_ROUTE, ASIDE_M if lane else _ASIDE_MATCH_M)

    def poses(self, vehicle_ids: Sequence[str]) -> list[tuple[float, float, float] | None]:
        """Front bumper x, y in m and angle in degrees, as SUMO has them now; None for vehicles not in the net."""
        position, angle = libsumo.vehicle.getPosition, libsumo.vehicle.getAngle
        inside = frozenset(libsumo.vehicle.getIDList())
        return [(*position(name), angle(name)) if name in inside else None for name in vehicle_ids]

    @staticmethod
    def follow_speed(vehicle_id: str, speed_mps: float, *, gap_m: float, leader_mps: float) -> float:
        """Speed for the coming step by a replayed vehicle's own car following (SUMO's default, Krauss), m/s.

        gap_m: bumper to bumper; its jam gap is taken off. Never above what it can accelerate to.
        """
        decel = libsumo.vehicle.getApparentDecel(vehicle_id)  # a leader brakes no harder than it would itself
        gap = gap_m - libsumo.vehicle.getMinGap(vehicle_id)
        return float(libsumo.vehicle.getFollowSpeed(vehicle_id, speed_mps, gap, leader_mps, decel, ""))

    def remove(self, vehicle_id: str) -> None:
        """Take a vehicle out."""
        libsumo.vehicle.remove(vehicle_id)

    def insert(
        self, vehicle_id: str, *, edges: Sequence[str], lane_id: str, front_m: float, speed_mps: float,
        driver: Driver, size: BoxSize, max_speed_mps: float,
    ) -> str | None:  # fmt: skip
        """Put a vehicle that SUMO drives on a lane of the first edge, now. Returns SUMO's message, None if accepted.

        SUMO's own insertion check is not asked: it knows neither crossing lanes nor what agents will do next, and the
        place was chosen with both.
        """
        try:
            self._add(vehicle_id, edges, driver, size, max_speed_mps, departSpeed=f"{speed_mps:.6f}")
            libsumo.vehicle.moveTo(vehicle_id, lane_id, front_m)
        except libsumo.TraCIException as error:
            with contextlib.suppress(libsumo.TraCIException):  # else what is added begins at the next step after all
                libsumo.vehicle.remove(vehicle_id)
            return str(error)
        return None

    def queue(self, vehicle_id: str, *, edges: Sequence[str], lane_index: int, driver: Driver, size: BoxSize) -> None:
        """Let a vehicle wait before the first edge until SUMO finds room for it, at the fastest speed that is safe."""
        departs = {"departLane": str(lane_index), "departPos": "base", "departSpeed": "avg"}
        self._add(vehicle_id, edges, driver, size, driver.desired_mps, **departs)

    def _add(
        self, vehicle_id: str, edges: Sequence[str], driver: Driver, size: BoxSize, max_speed_mps: float, **departs: str
    ) -> None:
        """A vehicle that SUMO drives, with a type of one driver's own."""
        type_id = f"driven_{vehicle_id}"
        if type_id not in self._types:  # a vehicle that was taken out may come again
            libsumo.vehicletype.copy(_DRIVEN, type_id)
            self._types.add(type_id)
        libsumo.vehicletype.setLength(type_id, size.length_m)
        libsumo.vehicletype.setWidth(type_id, size.width_m)
        of_driver = driver_attributes(driver, self._model) | self._parameters | {"maxSpeed": max_speed_mps}
        for attribute, value in of_driver.items():
            if attribute in _SETTERS:  # others are those of the type that is copied
                getattr(libsumo.vehicletype, _SETTERS[attribute])(type_id, value)
        self._routes += 1
        libsumo.route.add(f"route_{self._routes}", list(edges))
        libsumo.vehicle.add(vehicle_id, f"route_{self._routes}", typeID=type_id, depart="now", **departs)
        libsumo.vehicle.setLaneChangeMode(vehicle_id, self._change_mode)
        libsumo.vehicle.setSpeedMode(vehicle_id, _SAFE_SPEED)

    def disregard_others(self, vehicle_id: str) -> None:
        """Switch SUMO's regard for others off, in following and in changing lanes."""
        libsumo.vehicle.setSpeedMode(vehicle_id, 0)
        libsumo.vehicle.setLaneChangeMode(vehicle_id, _ASKED_ANYHOW)

    def drive(self, vehicle_id: str, *, desired_mps: float, limit_mps: float | None) -> None:
        """Desired speed for the coming step, and a limit on what SUMO chooses; None for no limit."""
        libsumo.vehicle.setMaxSpeed(vehicle_id, float(desired_mps))
        libsumo.vehicle.setSpeed(vehicle_id, -1.0 if limit_mps is None else float(limit_mps))

    def change_lane(self, vehicle_id: str, lane_index: int, *, edges: Sequence[str] = ()) -> None:
        """Ask for an instant change within the edge, onto a route that the new lane continues; none: its own."""
        if edges:
            self.set_route(vehicle_id, edges)
        libsumo.vehicle.changeLane(vehicle_id, lane_index, 0.0)  # else it makes up later what it refuses now

    @staticmethod
    def lane_change_answer(vehicle_id: str, side: str) -> tuple[frozenset[str], bool, bool]:
        """What SUMO's lane-change model made of a side at the last step: motives, blocked ahead, blocked behind."""
        words = libsumo.vehicle.getLaneChangeStatePretty(vehicle_id, 1 if side == "left" else -1)[0]
        ahead, behind = (any(w.startswith("blocked") and w.endswith(e) for w in words) for e in ("leader", "follower"))
        return _MOTIVES & frozenset(words) if side in words else frozenset(), ahead, behind

    def set_route(self, vehicle_id: str, edges: Sequence[str]) -> None:
        """Replace the route, from the current edge on."""
        libsumo.vehicle.setRoute(vehicle_id, list(edges))

    def step(self) -> None:
        """One step of step_s."""
        libsumo.simulationStep()

    def vehicle_ids(self) -> frozenset[str]:
        """Ids of all vehicles in the net."""
        return frozenset(libsumo.vehicle.getIDList())

    @staticmethod
    def states() -> list[tuple[str, str, float, float]]:
        """Every vehicle in the net: id, SUMO lane, front bumper on it, m, and speed, m/s."""
        one = libsumo.vehicle
        return [(name, one.getLaneID(name), one.getLanePosition(name), one.getSpeed(name)) for name in one.getIDList()]

    @staticmethod
    def limit_lane(lane_id: str, limit_mps: float) -> None:
        """Speed limit of a lane from now on."""
        libsumo.lane.setMaxSpeed(lane_id, limit_mps)

    def speed(self, vehicle_id: str) -> float:
        """Speed in m/s over the last step."""
        return float(libsumo.vehicle.getSpeed(vehicle_id))

    def lane(self, vehicle_id: str) -> tuple[str, float]:
        """SUMO lane id and position of the front bumper on it, m."""
        return libsumo.vehicle.getLaneID(vehicle_id), float(libsumo.vehicle.getLanePosition(vehicle_id))
