"""A scene in SUMO's formats: FCD output is the exported positions, routes are ways of the net, which has a place."""

import json
import math
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import libsumo
import numpy as np
import pytest
import shapely
from av2.geometry.utm import CITY_ORIGIN_LATLONG_DICT, UTM_ZONE_MAP, CityName, convert_gps_to_utm
from lxml import etree
from written import edit_json

from bridge.exports.export import export_scene
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sidecar import read_sidecar, sidecar_path
from bridge.sumo.exchange import sumo_files
from bridge.sumo.net import convert
from bridge.sumo.poses import box_poses
from netconvert.errors import NetError, ScenarioError
from netconvert.net_xml import CITY_ORIGINS

_NAMES = {"austin": "ATX", "dearborn": "DTW", "miami": "MIA", "palo-alto": "PAO", "pittsburgh": "PIT"}
_NAMES |= {"washington-dc": "WDC"}


@pytest.fixture(scope="session")
def written(made_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of a generated scene."""
    out = tmp_path_factory.mktemp("sumo") / "deep" / "out"
    export_scene(made_scene, "sumo", out)
    return out


def _read(folder: Path, ending: str) -> etree._Element:
    (path,) = (path for path in folder.glob(f"*{ending}") if "_scene" not in path.name)
    return etree.parse(path).getroot()


def test_fcd_output_is_the_exported_positions_to_a_millimetre(written: Path, made_scene: Path) -> None:
    """Front bumpers and degrees, turned back into centres and headings: 1 mm, 0.001 degrees; nobody is left out."""
    scenario = read_scenario(made_scene)
    root = _read(written, ".fcd.xml")
    rows = 0
    tracks = {track.track_id: track for track in scenario.tracks}
    for step, timestep in enumerate(root.iter("timestep")):
        assert float(timestep.get("time")) == pytest.approx(step * scenario.step_s)
        for vehicle in timestep:
            track = tracks[vehicle.get("id")]
            (row,) = np.flatnonzero(track.timesteps == step)
            front = np.array([[float(vehicle.get("x")), float(vehicle.get("y"))]])
            length = np.array([track.size.length_m])
            center, heading = box_poses(front, np.array([float(vehicle.get("angle"))]), length)
            assert math.hypot(*(center[0] - track.position[row])) < 0.002
            assert abs(math.remainder(heading[0] - track.heading[row], math.tau)) < 1e-4
            assert float(vehicle.get("speed")) == pytest.approx(track.speed[row], abs=1e-3)
            rows += 1
    assert rows == sum(len(track.timesteps) for track in scenario.tracks)


def test_positions_along_lanes_are_where_the_front_bumpers_are_and_beyond_a_lane_on_the_next(written: Path) -> None:
    """lane and pos of the inserted vehicles, laid on the net's shapes, give x and y to half a lane's width.

    pos is at the end of a lane, and the bumper over .3 m ahead of it, only where no lane follows.
    """
    net = _read(written, ".net.xml")
    lines = {
        lane.get("id"): shapely.LineString([tuple(map(float, xy.split(","))) for xy in lane.get("shape").split()])
        for lane in net.iter("lane")
    }
    followed = {f"{link.get('from')}_{link.get('fromLane')}" for link in net.iter("connection")}
    ends = 0
    for vehicle in _read(written, ".fcd.xml").iter("vehicle"):
        front, line = shapely.Point(float(vehicle.get("x")), float(vehicle.get("y"))), lines.get(vehicle.get("lane"))
        if vehicle.get("id").startswith("gen_"):
            assert line.interpolate(float(vehicle.get("pos"))).distance(front) < 3.6
        if line is None or vehicle.get("lane") not in followed:
            continue
        last, end = (np.array(line.interpolate(at, normalized=True).coords[0]) for at in (0.9, 1.0))
        ahead = (end - last) / np.hypot(*(end - last))
        assert (np.array(front.coords[0]) - end) @ ahead < 0.3
        ends += float(vehicle.get("pos")) > line.length - 0.5
    assert ends > 0


def test_every_inserted_vehicle_has_a_route_that_the_net_has(written: Path, made_scene: Path) -> None:
    scenario = read_scenario(made_scene)
    sidecar = read_sidecar(sidecar_path(made_scene, scenario.scenario_id))
    net, routes = _read(written, ".net.xml"), _read(written, ".rou.xml")
    links = {(link.get("from"), link.get("to")) for link in net.iter("connection")}
    vehicles = {vehicle.get("id"): vehicle for vehicle in routes.iter("vehicle")}
    assert vehicles.keys() == {agent.track_id for agent in sidecar.agents}
    types = {kind.get("id"): kind for kind in routes.iter("vType")}
    for agent in sidecar.agents:
        vehicle = vehicles[agent.track_id]
        edges = vehicle.find("route").get("edges").split()
        assert all(pair in links for pair in pairwise(edges))
        assert edges[-1] not in {before for before, _ in links}  # to the map's edge
        assert float(vehicle.get("depart")) == pytest.approx(scenario.track(agent.track_id).timesteps[0] * 0.1)
        kind = types[vehicle.get("type")]
        assert (float(kind.get("length")), float(kind.get("width"))) == pytest.approx(
            (agent.length_m, agent.width_m), abs=0.006
        )
    departures = [float(vehicle.get("depart")) for vehicle in routes.iter("vehicle")]
    assert departures == sorted(departures)


@pytest.fixture
def driven(written: Path) -> Iterator[Path]:
    """The scene's own sumocfg, running in this process; the file of SUMO's messages."""
    (config,) = (path for path in written.glob("*.sumocfg") if "_scene" not in path.name)
    log = written / "messages.txt"
    libsumo.start(["sumo", "-c", str(config), "--no-step-log", "true", "--message-log", str(log)])
    yield log
    libsumo.close()


def test_sumo_knows_the_drivers_of_the_inserted_vehicles_and_drives_them(driven: Path, made_scene: Path) -> None:
    """Each type has the driver of the sidecar, and the car-following model its parameters. Without a warning all come,
    none faster than its driver desires, but for the errors of EIDM, which are a few cm/s.
    """
    sidecar = read_sidecar(sidecar_path(made_scene, read_scenario(made_scene).scenario_id))
    types = libsumo.vehicletype
    for agent in sidecar.agents:
        kind, own = f"{agent.object_type}_{agent.track_id}", agent.driver.parameters
        found = [
            get(kind) for get in (types.getAccel, types.getDecel, types.getTau, types.getMinGap, types.getMaxSpeed)
        ]
        asked = [own[name] for name in ("accel_mps2", "decel_mps2", "tau_s", "min_gap_m", "desired_mps")]
        assert found == pytest.approx(asked, rel=1e-4)
        assert (types.getSpeedFactor(kind), types.getSpeedDeviation(kind)) == (1.0, 0.0)
    routes = _read(driven.parent, ".rou.xml")
    for kind in routes.iter("vType"):
        assert {name: kind.get(name) for name in ("carFollowModel", "treaction", "sigmaerror")} == {
            "carFollowModel": "EIDM", "treaction": "0.5", "sigmaerror": "0.1"
        }  # fmt: skip
    desired = {agent.track_id: agent.driver.parameters["desired_mps"] for agent in sidecar.agents}
    seen = set()
    for _ in range(108):
        libsumo.simulationStep()
        for name in libsumo.vehicle.getIDList():
            seen.add(name)
            assert libsumo.vehicle.getSpeed(name) <= desired[name] + 0.1
    assert seen == desired.keys()
    assert driven.read_text() == ""


def test_a_driver_that_is_not_whole_is_refused_by_name(made_scene: Path, tmp_path: Path) -> None:
    scenario = read_scenario(made_scene)
    folder = tmp_path / made_scene.name
    shutil.copytree(made_scene, folder)
    path = sidecar_path(folder, scenario.scenario_id)
    content = json.loads(path.read_text())
    del content["agents"][0]["driver"]["parameters"]["tau_s"]
    path.write_text(json.dumps(content))
    with pytest.raises(ScenarioError, match=r"gen_0: the driver in the sidecar has desired_mps, .*expected"):
        sumo_files(read_scenario(folder))


def test_a_fast_scene_has_one_net_and_one_limit_whatever_command_writes_it(
    made_scene: Path, copy_scene: Callable[..., Path], tmp_path: Path
) -> None:
    """Driven with desires up to 30 m/s: so are the lanes. `hid2 net` behind it keeps the .sumocfg with routes."""
    folder, out = copy_scene(folder=made_scene), tmp_path / "out"

    def hasten(content: dict[str, Any]) -> None:
        content["config"]["spawn"]["max_speed_mps"] = 30.0

    name = read_scenario(folder).scenario_id
    edit_json(sidecar_path(folder, name), hasten)
    export_scene(folder, "sumo", out)
    net, config = (out / f"{name}{ending}" for ending in (".net.xml", ".sumocfg"))
    wanted = {path: path.read_bytes() for path in (net, config)}
    assert {lane.get("speed") for lane in etree.fromstring(wanted[net]).iter("lane")} == {"30"}
    assert b"route-files" in wanted[config]
    export_scene(folder, "fcd", out)
    assert net.read_bytes() == wanted[net]
    convert(folder, out)
    assert {path: path.read_bytes() for path in wanted} == wanted
    (roads,) = export_scene(folder, "opendrive", out)
    assert {limit.get("max") for limit in etree.parse(roads).iter("speed")} == {"30"}
    edit_json(sidecar_path(folder, name), lambda content: content["config"]["spawn"].update(max_speed_mps="fast"))
    with pytest.raises(ScenarioError, match=r"the sidecar's config: .*'fast'"):
        export_scene(folder, "fcd", out)


@pytest.mark.parametrize("track_id", ["my car", "a,b", "a;b", 'a<&"b', "a|b"])
def test_an_id_that_sumo_refuses_is_refused_by_name(data_scenes: dict[str, Path], track_id: str) -> None:
    scenario = read_scenario(data_scenes["curve"])
    tracks = (replace(scenario.tracks[0], track_id=track_id), *scenario.tracks[1:])
    with pytest.raises(
        NetError, match=rf"track {re.escape(repr(track_id))}: SUMO takes no such id, expected one without"
    ):
        sumo_files(replace(scenario, tracks=tracks))


def test_the_net_lies_on_a_map(written: Path, made_scene: Path) -> None:
    """netOffset takes the origin of the city off: UTM minus the offset is the city frame."""
    location = _read(written, ".net.xml").find("location")
    origin = CITY_ORIGINS[read_scenario(made_scene).city]
    east, north = (float(part) for part in location.get("netOffset").split(","))
    assert (-east, -north) == pytest.approx((origin.easting_m, origin.northing_m))
    assert f"+zone={origin.zone}" in location.get("projParameter")
    box, first = (list(map(float, location.get(name).split(","))) for name in ("origBoundary", "convBoundary"))
    assert np.array(box) - np.tile([-east, -north], 2) == pytest.approx(np.array(first), abs=0.02)


@pytest.mark.parametrize("city", CITY_ORIGINS)
def test_origins_are_those_of_av2(city: str) -> None:
    name = CityName(_NAMES[city])
    latitude, longitude = CITY_ORIGIN_LATLONG_DICT[name]
    theirs = convert_gps_to_utm(latitude, longitude, name)
    assert CITY_ORIGINS[city].zone == UTM_ZONE_MAP[name]
    assert (CITY_ORIGINS[city].easting_m, CITY_ORIGINS[city].northing_m) == pytest.approx(theirs, abs=1e-3)
