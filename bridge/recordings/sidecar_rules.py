"""The rules on the sidecar of a scenario: in agreement with itself, the rows and the map."""

import uuid
from collections.abc import Iterator, Mapping, Set

from bridge.config import config_from_dict, config_sha256, config_to_dict
from bridge.recordings.export import new_scenario_id
from bridge.recordings.sidecar import AgentRecord, Sidecar
from hid2.agents import Policy
from netconvert.av2_map import Breach
from netconvert.errors import ConfigError


def check_sidecar(
    sidecar: Sidecar, new_id: str, *, begins: Mapping[str, int] | None, generated_ids: Set[str],
    lanes: Set[str] | None,
) -> Iterator[Breach]:  # fmt: skip
    """A sidecar against its scene.

    begins: first timestep of each track of the rows, by its id; lanes: those of the map; None where these are missing.
    """
    track_ids = None if begins is None else begins.keys()
    try:
        if str(uuid.UUID(new_id)) != new_id:
            raise ValueError
    except ValueError:
        yield "scenario-id", f"folder {new_id!r}, expected a UUID of 36 characters"
    try:
        config = config_from_dict(sidecar.config)
    except ConfigError as error:
        yield "sidecar", f"config: {error}"
    else:
        if sidecar.config_sha256 != config_sha256(config) or config_to_dict(config) != sidecar.config:
            yield "sidecar", f"config_sha256 {sidecar.config_sha256[:12]}..., expected that of config"
        wanted = new_scenario_id(sidecar.source_scenario_id, config, sidecar.seed, sidecar.variant)
        if wanted != new_id:
            yield "scenario-id", f"{new_id}, expected {wanted} of this source, configuration, seed and variant"
    if sidecar.placed.agents != len(sidecar.agents):
        yield "sidecar", f"placed.agents {sidecar.placed.agents}, but {len(sidecar.agents)} agents"
    for policy in Policy:
        count = sum(agent.policy == policy for agent in sidecar.agents)
        if sidecar.placed.behaviours.get(policy, 0) != count:
            yield (
                "sidecar",
                f"placed.behaviours.{policy} {sidecar.placed.behaviours.get(policy, 0)}, but {count} agents",
            )
    listed = [agent.track_id for agent in sidecar.agents]
    if len(set(listed)) != len(listed):
        yield "sidecar", "two agents have the same track_id"
    if track_ids is not None and set(listed) != generated_ids & track_ids:
        missing = ", ".join(sorted(set(listed) ^ (generated_ids & track_ids)))
        yield "sidecar", f"agents and generated tracks differ: {missing}"
    for agent in sidecar.agents:
        yield from _check_agent(agent, track_ids, lanes)
        begin = agent.spawn.timestep if begins is None else begins.get(agent.track_id, agent.spawn.timestep)
        if begin != agent.spawn.timestep:
            yield "sidecar", f"agent {agent.track_id}: spawn.timestep {agent.spawn.timestep}, but it begins at {begin}"


def _check_agent(agent: AgentRecord, track_ids: Set[str] | None, lanes: Set[str] | None) -> Iterator[Breach]:
    name = f"agent {agent.track_id}"
    kinds = [maneuver.kind for maneuver in agent.maneuvers]
    if agent.policy is not Policy.STRAIGHT and agent.policy.value not in kinds:
        yield "sidecar", f"{name}: policy {agent.policy}, but no record of it"
    used = {agent.spawn.lane_segment_id, *agent.route}
    for maneuver in agent.maneuvers:
        used |= {lane for lane in (maneuver.source_lane, maneuver.target_lane) if lane is not None}
        times = [
            time
            for time in (maneuver.trigger_s, maneuver.start_s, maneuver.crossing_s, maneuver.end_s)
            if time is not None
        ]
        if times != sorted(times):
            yield "sidecar", f"{name}: {maneuver.kind}: times {times}, expected trigger, start, crossing, end in order"
        if maneuver.status == "done" and (maneuver.start_s is None or maneuver.end_s is None):
            yield "sidecar", f"{name}: {maneuver.kind}: done without start_s and end_s"
        if track_ids is not None and maneuver.leader_track_id not in (None, *track_ids):
            yield "sidecar", f"{name}: {maneuver.kind}: no leader {maneuver.leader_track_id!r}"
    if lanes is not None:
        for lane in sorted(lane for lane in used if str(lane) not in lanes):
            yield "sidecar", f"{name}: lane segment {lane} is not in the map"
