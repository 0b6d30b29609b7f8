"""What of a request a scene can never meet, known before anything is driven."""

from collections.abc import Collection

from hid2.agents import Policy
from hid2.insertion.event_objective import MOMENT_S
from hid2.insertion.event_targets import candidate_rows, target_of
from hid2.insertion.meetings import moving_vehicles, target_rows
from hid2.insertion.routes import Routes
from hid2.policy.behaviours import BEHAVIOURS, load_own
from hid2.scene import Scene

_IDS = 5  # named in a sentence; no tunable


def impossible(scene: Scene, named: Collection[Policy]) -> dict[str, str]:
    """What is asked for and cannot come about in a scene, with the reason and what was expected.

    named: behaviours that were asked for by name.
    """
    request, found = scene.config.request, {}
    load_own(request.own_behaviours)
    ends, ids = f"the scene ends at {scene.last_s:g} s, expected an earlier time", scene.traffic.ids
    if not target_rows(scene).size and request.is_near_agents:
        found[f"near {request.near!r}"] = (
            f"no such track, expected av, focal, scored, traffic, anywhere or one of its {len(ids)} track ids "
            f"({', '.join(ids[:_IDS])}, ...)"
        )
    changes = request.agents != 0 and request.lane_change + request.overtake > 0
    if changes and request.first_trigger_s > scene.last_s:
        found[f"trigger time {request.first_trigger_s:g} s for lane changes and overtakes"] = ends
    for event in scene.config.event:
        low_s, high_s = event.at_band_s
        if low_s - MOMENT_S > scene.last_s:
            found[f"event {event.kind} at {low_s:g}:{high_s:g} s"] = ends
        if all(target_of(scene, row) is None for row in candidate_rows(scene, event.target)):
            moving = [ids[row] for row in moving_vehicles(scene).tolist()]
            found[f"event {event.kind} with target {event.target!r}"] = (
                "not there, not moving, or no vehicle on a lane, expected av, focal, any or one of its "
                f"{len(moving)} moving vehicles ({', '.join(moving[:_IDS])}, ...)"
            )
    routes = Routes(scene)
    for policy in named if request.agents != 0 else ():
        if not routes.map_offers(policy):
            reason = BEHAVIOURS[policy].no_map.text.rstrip(".")
            found[f"behaviour {policy.value}"] = f"{reason}, expected another behaviour or other scenes (see hid2 scan)"
    return found
