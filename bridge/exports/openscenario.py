"""A scene as OpenSCENARIO 1.2, on the OpenDRIVE map beside it: every agent follows its track, the recording one is Ego.

Positions are those of rear axles, as the standard has it, behind the middle of the box by the centre of its bounding
box; what has no axles is where its middle is. An agent that is not there from the first step on, or not to the last, is
added and deleted. Between rows that a track lacks players interpolate.
"""

import numpy as np
from lxml import etree
from lxml.builder import E

from bridge.recordings.recording import Recording
from bridge.sumo.net import config_of
from hid2.agents import AV_ID, REAR_AXLE_SHARE, FloatArray, Track
from netconvert.errors import NetError
from netconvert.gui_files import xml_bytes
from netconvert.net_xml import CITY_ORIGINS
from netconvert.opendrive import opendrive_bytes

#: Name of the recording vehicle.
EGO = "Ego"
#: Vehicle categories, by object type; all others are pedestrians or obstacles.
_CATEGORIES = {"vehicle": "car", "bus": "bus", "motorcyclist": "motorbike", "cyclist": "bicycle"}
_CATEGORIES |= {"riderless_bicycle": "bicycle"}
# What no recording tells and the standard demands: usual values.
_HEIGHTS_M = {"vehicle": 1.6, "bus": 3.2, "static": 1.0, "background": 1.0, "construction": 1.0, "unknown": 1.0}
_HEIGHT_M, _WHEEL_M, _STEERING_RAD = 1.7, 0.6, 0.6
_PERFORMANCE = {"maxSpeed": "70", "maxAcceleration": "10", "maxDeceleration": "10"}
_MASS_KG = "80"


def openscenario_files(scene: Recording) -> dict[str, bytes]:
    """<id>.xosc and <id>.xodr by file name. Errors: NetError."""
    name = scene.scenario_id
    tracks = sorted(scene.tracks, key=lambda track: track.track_id != AV_ID)
    if {AV_ID, EGO} <= {track.track_id for track in tracks}:
        raise NetError(f"{scene.folder}: track {EGO!r}: expected another id, {AV_ID} is called so; rename the track")
    teleports = (
        E.Private(E.PrivateAction(E.TeleportAction(_position(_axle(track)[0]))), entityRef=_name(track))
        for track in tracks
        if track.timesteps[0] == 0
    )
    story = E.Story(
        E.Act(*(_acts(track, scene) for track in tracks), E.StartTrigger(_at(0.0)), name="tracks"), name=name
    )
    header = {"revMajor": "1", "revMinor": "2", "date": "1970-01-01T00:00:00", "author": "hid2-sumo"}
    document = E.OpenSCENARIO(
        E.FileHeader(header, description=f"scene {name}, {scene.city}"),
        E.CatalogLocations(),
        E.RoadNetwork(E.LogicFile(filepath=f"{name}.xodr")),
        E.Entities(*(E.ScenarioObject(_entity(track), name=_name(track)) for track in tracks)),
        E.Storyboard(E.Init(E.Actions(*teleports)), story, E.StopTrigger(_at((scene.num_steps - 1) * scene.step_s))),
    )
    return {f"{name}.xosc": xml_bytes(document), **opendrive_files(scene)}


def opendrive_files(scene: Recording) -> dict[str, bytes]:
    """<id>.xodr by file name. Errors: NetError."""
    name, fastest_mps = scene.scenario_id, config_of(scene).spawn.max_speed_mps
    origin = CITY_ORIGINS.get(scene.city)
    return {f"{name}.xodr": opendrive_bytes(scene.graph, name, origin=origin, fastest_mps=fastest_mps)}


def _name(track: Track) -> str:
    return EGO if track.track_id == AV_ID else track.track_id


def _behind_m(track: Track) -> float:
    """How far the rear axle is behind the middle of the box."""
    return REAR_AXLE_SHARE * track.size.length_m if track.object_type in _CATEGORIES else 0.0


def _axle(track: Track) -> FloatArray:
    """(T, 3): places that positions are told of, m, and headings that do not jump, rad."""
    ahead = np.stack([np.cos(track.heading), np.sin(track.heading)], axis=1)
    return np.column_stack([track.position - _behind_m(track) * ahead, np.unwrap(track.heading)])


def _position(pose: FloatArray) -> etree._Element:
    x, y, heading = pose.tolist()
    return E.Position(E.WorldPosition(x=f"{x:.4f}", y=f"{y:.4f}", z="0", h=f"{heading:.6f}"))


def _entity(track: Track) -> etree._Element:
    length_m, width_m = track.size
    height_m, kind = _HEIGHTS_M.get(track.object_type, _HEIGHT_M), track.object_type
    center = E.Center(x=f"{_behind_m(track):.3f}", y="0", z=f"{height_m / 2:.3f}")
    box = E.BoundingBox(center, E.Dimensions(length=f"{length_m:.3f}", width=f"{width_m:.3f}", height=f"{height_m:g}"))
    if kind in _CATEGORIES:
        axle = {"trackWidth": f"{width_m:.3f}", "wheelDiameter": f"{_WHEEL_M}", "positionZ": f"{_WHEEL_M / 2}"}
        front = {"maxSteering": f"{_STEERING_RAD}", "positionX": f"{2.0 * REAR_AXLE_SHARE * length_m:.3f}"}
        axles = E.Axles(E.FrontAxle(axle, front), E.RearAxle(axle, maxSteering="0", positionX="0"))
        made, more = E.Vehicle(name=kind, vehicleCategory=_CATEGORIES[kind]), [E.Performance(_PERFORMANCE), axles]
    elif kind == "pedestrian":
        made, more = E.Pedestrian(name=kind, mass=_MASS_KG, pedestrianCategory=kind), []
    else:
        made, more = E.MiscObject(name=kind, mass=_MASS_KG, miscObjectCategory="obstacle"), []
    named = (E.Property(name=key, value=value) for key, value in (("track_id", track.track_id), ("object_type", kind)))
    made.extend([E.ParameterDeclarations(), box, *more, E.Properties(*named)])
    return made


def _acts(track: Track, scene: Recording) -> etree._Element:
    """What an agent does: it comes, if it is not there from the beginning, follows its track, and goes."""
    name, times, poses = _name(track), track.timesteps * scene.step_s, _axle(track)
    first = []
    if track.timesteps[0] > 0:
        first.append(E.GlobalAction(E.EntityAction(E.AddEntityAction(_position(poses[0])), entityRef=name)))
    if len(times) > 1:
        vertices = (E.Vertex(_position(pose), time=f"{at:.4f}") for pose, at in zip(poses, times.tolist(), strict=True))
        path = E.Trajectory(E.ParameterDeclarations(), E.Shape(E.Polyline(*vertices)), name=name, closed="false")
        timing = E.Timing(domainAbsoluteRelative="absolute", scale="1", offset="0")
        follow = E.FollowTrajectoryAction(
            E.TrajectoryRef(path), E.TimeReference(timing), E.TrajectoryFollowingMode(followingMode="position")
        )
        first.append(E.PrivateAction(E.RoutingAction(follow)))
    events = [_event("follows", times[0], first)] if first else []
    if track.timesteps[-1] < scene.num_steps - 1:
        gone = E.GlobalAction(E.EntityAction(E.DeleteEntityAction(), entityRef=name))
        events.append(_event("goes", times[-1] + scene.step_s, [gone]))
    actors = E.Actors(E.EntityRef(entityRef=name), selectTriggeringEntities="false")
    maneuver = [E.Maneuver(*events, name=name)] if events else []
    return E.ManeuverGroup(actors, *maneuver, name=name, maximumExecutionCount="1")


def _event(name: str, when_s: float, actions: list[etree._Element]) -> etree._Element:
    named = (E.Action(action, name=f"{name} {number}") for number, action in enumerate(actions))
    return E.Event(*named, E.StartTrigger(_at(when_s)), name=name, priority="parallel", maximumExecutionCount="1")


def _at(when_s: float) -> etree._Element:
    """When the simulation's time has come to a value."""
    condition = E.ByValueCondition(E.SimulationTimeCondition(value=f"{when_s:.4f}", rule="greaterOrEqual"))
    return E.ConditionGroup(E.Condition(condition, name=f"at {when_s:.4f} s", delay="0", conditionEdge="none"))
