"""Facts of a data set, scene by scene, and the choice of scenes on these facts."""

import logging
import random
from collections.abc import Callable, Sequence
from typing import Annotated, NamedTuple, get_args

from bridge.batch.engine import OnDone, sorted_out, work_on_each
from bridge.config import find_in_working_folder
from bridge.generation.scene import scene_of
from bridge.recordings.folders import Address
from bridge.recordings.plausibility import figures_of
from bridge.recordings.sources import read_recording
from hid2.agents import VEHICLE_TYPES, Policy
from hid2.insertion.events import offered_events
from hid2.insertion.routes import Routes
from hid2.insertion.surroundings import Surroundings
from hid2.measures.arrays import stack
from hid2.params import Config, Event
from hid2.policy.behaviours import load_own
from hid2.policy.overtake import stretch_m
from netconvert.errors import ConfigError
from netconvert.lane_graph import SIDES, LaneSegment, TurnType

_LOG = logging.getLogger(__name__)
#: Most scenes that a process gets at a time.
_CHUNK = 16
#: Events that may be looked for, as `kind:target`: with the recording vehicle and the focal track.
EVENTS = tuple(
    f"{kind}:{target}" for kind in get_args(Event.model_fields["kind"].annotation) for target in ("av", "focal")
)


class SceneFacts(NamedTuple):
    """One row of `hid2 scan`. What is called room is room on the map, whatever the traffic."""

    folder: Annotated[Address, "where the scene is; in the file and with `--json` alone"]
    scenario: Annotated[str, "its id"]
    split: Annotated[str, "`train`, `val` or `test`, by its folder; empty: none"]
    city: Annotated[str, "its city"]
    steps: Annotated[int, "timesteps of 0.1 s"]
    tracks: Annotated[int, "recorded tracks, of any type"]
    at_49: Annotated[int, "of them present at the last observed timestep, 49 in Argoverse 2"]
    vehicles: Annotated[int, "tracks of type vehicle or bus"]
    moving: Annotated[int, "vehicles with a path that extends over 5 m, seen for over 1 s"]
    lanes: Annotated[int, "lane segments of the map"]
    vehicle_lanes: Annotated[int, "of them of type VEHICLE"]
    same_direction: Annotated[int, "neighbours of the same direction, counted over the two sides of all VEHICLE lanes"]
    straight_m: Annotated[float, "length of all VEHICLE lanes, m"]
    lane_change_m: Annotated[float, "room for a lane change: m of VEHICLE lane from which one has the length it needs"]
    overtake_m: Annotated[float, "room for an overtake: the same for out, past and back"]
    left_turns: Annotated[int, "room for left turns: lanes that turn left, with lanes before and behind"]
    right_turns: Annotated[int, "the same to the right"]
    events: Annotated[
        str,
        "events looked for that a rolled-out vehicle brings about, as `cut_in:av lead:focal`, and of behaviours "
        "of your own what the map offers, as `mine:keep_right`",
    ]
    shift_m: Annotated[float, "how far tracks lie beside the lanes, m; `source.plausible` looks at it"]


#: What tells the room for a policy, metres or lanes, 0 where there is none; by the policy's name.
ROOM = {
    "straight": "straight_m",
    "left_turn": "left_turns",
    "right_turn": "right_turns",
    "lane_change": "lane_change_m",
    "overtake": "overtake_m",
}


class Selection(NamedTuple):
    """Which scenes are wanted; empty fields ask for nothing.

    min_agents counts tracks; can names policies, events as `cut_in:av`, and behaviours of a user's own as `mine:name`.
    """

    min_agents: int = 0
    cities: Sequence[str] = ()
    splits: Sequence[str] = ()
    can: Sequence[str] = ()
    sample: int | None = None
    seed: int = 0


def facts_of(
    folders: Sequence[Address], can: Sequence[str] = (), *, jobs: int = 1, on_scene: OnDone = None
) -> tuple[list[SceneFacts], list[tuple[Address, str]]]:
    """Facts of scenes in the order of folders, and the scenes that cannot be read with the reason.

    can: what `Selection` has; its events are looked for, which takes tenths of a second each, or seconds where none is.
    Errors: ConfigError for what can names and does not exist.
    """
    known = (*ROOM, *EVENTS)
    for name in can:
        kind = name.partition(":")[0].replace("-", "_")
        near = [one for one in known if one.partition(":")[0] == kind]
        if name not in known and (near or ":" not in name):
            raise ConfigError(f"--can {name!r}: expected one of {', '.join(near or (*known, 'MODULE:BEHAVIOUR'))}")
    asked = tuple(dict.fromkeys((*(name for name in EVENTS if name in can), *_own_in(can))))
    long_s = 60 * (1 + len(asked))  # on a busy machine each search takes as long as all else may
    each = work_on_each(describe_scene, folders, asked, jobs=jobs, chunk=_CHUNK, timeout_s=long_s, on_item=on_scene)
    return sorted_out(each)


def _own_in(can: Sequence[str]) -> dict[str, Policy]:
    """Policies of the behaviours of a user's own among the names of `Selection.can`, loaded. Errors: ConfigError."""
    if own := [name for name in can if ":" in name and name not in EVENTS]:
        find_in_working_folder()
    return load_own(own)


def describe_scene(asked: Sequence[str], folder: Address) -> SceneFacts:
    """Read one scene and count; asked: events and behaviours of a user's own. Errors: ScenarioError, MapError."""
    own = _own_in(asked)
    config, scenario = Config(), read_recording(folder)
    here = Surroundings(scene_of(scenario, config))
    graph, routes = scenario.graph, here.routes
    vehicles = [track for track in scenario.tracks if track.object_type in VEHICLE_TYPES]
    lanes = [lane for lane in graph.lanes.values() if lane.lane_type == "VEHICLE"]
    drivable = {lane.lane_id for lane in lanes}
    within = [lane for lane in lanes if graph.predecessors(lane.lane_id) and graph.successors(lane.lane_id)]
    room, mine = rooms(routes), [name for name, policy in own.items() if routes.map_offers(policy)]
    return SceneFacts(
        folder=folder,
        scenario=scenario.scenario_id,
        split=scenario.split or "",
        city=scenario.city,
        steps=scenario.num_steps,
        tracks=len(scenario.tracks),
        at_49=sum(scenario.last_observed in track.timesteps for track in scenario.tracks),
        vehicles=len(vehicles),
        moving=int(stack(vehicles, step_s=scenario.step_s).moving.sum()),
        lanes=len(graph.lanes),
        vehicle_lanes=len(lanes),
        same_direction=sum(graph.neighbor(lane.lane_id, side) in drivable for lane in lanes for side in SIDES),
        straight_m=round(sum(lane.length_m for lane in lanes), 1),
        lane_change_m=room[Policy.LANE_CHANGE],
        overtake_m=room[Policy.OVERTAKE],
        left_turns=sum(lane.turn is TurnType.LEFT for lane in within),
        right_turns=sum(lane.turn is TurnType.RIGHT for lane in within),
        events=" ".join([*offered_events(here, [name for name in asked if name not in own]), *mine]),
        shift_m=round(figures_of(scenario).shift_m, 1),
    )


def rooms(routes: Routes) -> dict[Policy, float]:
    """Metres of lane from which a change, or an overtake, has the length that the configuration of the scene asks."""
    lanes = [lane for lane in routes.scene.grid.graph.lanes.values() if lane.lane_type == "VEHICLE"]

    def beside(lane: LaneSegment) -> list[float]:
        """How far each neighbour that may be changed to goes on beside the whole lane."""
        offers = routes.offers(lane.lane_id)
        return [one.remaining_m for offer in offers for one in offer.beside if one.start == offer.start_m]

    def to_pass(lane: LaneSegment) -> list[float]:
        """How far another lane goes on beside from the start of this one, where one may change to it and back."""
        pairs = [(offer, routes.together(offer, side)) for offer in routes.offers(lane.lane_id) for side in SIDES]
        return [found[1] - found[0] for offer, found in pairs if found is not None and found[0] <= offer.start_m]

    def metres(ways: Callable[[LaneSegment], list[float]], needed_m: float) -> float:
        return round(sum(min(lane.length_m, max(0.0, max(ways(lane), default=0.0) - needed_m)) for lane in lanes), 1)

    change_m, overtake_m = routes.scene.config.lane_change.min_remaining_m, stretch_m(routes.scene.config)
    return {Policy.LANE_CHANGE: metres(beside, change_m), Policy.OVERTAKE: metres(to_pass, overtake_m)}


def select(facts: Sequence[SceneFacts], selection: Selection) -> list[SceneFacts]:
    """The scenes that are wanted, in their order; cities in any case. Errors: ConfigError for a city with no scene."""
    there = {fact.city.casefold(): fact.city for fact in facts}
    cities = {city.casefold(): city for city in selection.cities}
    for unknown in cities.keys() - there.keys() if facts else ():
        known = ", ".join(sorted(there.values()))
        raise ConfigError(f"--city {cities[unknown]!r}: no scene is there, expected one of {known}")
    chosen = [
        fact
        for fact in facts
        if fact.tracks >= selection.min_agents
        and (not cities or fact.city.casefold() in cities)
        and (not selection.splits or fact.split in selection.splits)
        and all(getattr(fact, ROOM[one]) > 0 if one in ROOM else one in fact.events.split() for one in selection.can)
    ]
    if selection.sample is not None and selection.sample > len(chosen):
        _LOG.warning("--sample %d: only %d scenes are there to draw from, all are taken", selection.sample, len(chosen))
    elif selection.sample is not None:
        # drawn by scenario, so that the choice depends neither on where the data set lies nor on the order of paths
        ordered = sorted(chosen, key=lambda fact: fact.scenario)
        drawn = {fact.folder for fact in random.Random(selection.seed).sample(ordered, selection.sample)}  # noqa: S311
        chosen = [fact for fact in chosen if fact.folder in drawn]
    return chosen


def wanted(
    folders: Sequence[Address], selection: Selection, *, jobs: int = 1, on_scene: OnDone = None
) -> tuple[list[Address], list[tuple[Address, str]]]:
    """The scenes that are wanted, in the order of folders, and those that cannot be read with the reason.

    Those are among the wanted too, but for a sample: their reasons are told. Errors: ConfigError where none is left.
    """
    facts, unread = facts_of(folders, selection.can, jobs=jobs, on_scene=on_scene)
    if not (chosen := {fact.folder for fact in select(facts, selection)}):
        raise ConfigError(f"none of {len(folders)} scenes is left by the selection (see `hid2 scan`)")
    if selection.sample is None:
        chosen |= {folder for folder, _ in unread}
    return [folder for folder in folders if folder in chosen], unread
