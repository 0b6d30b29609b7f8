"""What of a request a scene can never meet, known before anything is driven."""

from collections.abc import Collection

from hid2.agents import Policy
from hid2.insertion.event_objective import MOMENT_S
from hid2.insertion.event_targets import candidate_rows, target_of
from hid2.insertion.meetings import named_rows, target_rows
from hid2.insertion.routes import Routes
from hid2.policy.behaviours import BEHAVIOURS, load_own
from hid2.policy.overtake import SHIFT_RATIO
from hid2.scene import Scene

_IDS = 5  # ids named in a sentence, at most; no tunable
#: Least share of the shortest lane change left as the centre crosses, by event. No tunable: .3 off both lanes' middles.
_LEFT_SHARE = {"cut_in": 0.25, "overtake": 0.25 * SHIFT_RATIO}


def impossible(scene: Scene, named: Collection[Policy]) -> dict[str, str]:
    """What is asked for and cannot come about in a scene, with the reason and what was expected.

    named: behaviours that were asked for by name.
    """
    request, found, routes = scene.config.request, dict[str, str](), Routes(scene)
    load_own(request.own_behaviours)
    ends, ids = f"the scene ends at {scene.last_s:g} s, expected an earlier time", scene.traffic.ids
    if not target_rows(scene).size and request.is_near_agents:
        known = "av, focal, scored, traffic, anywhere or one of its"
        found[f"near {request.near!r}"] = f"no such track, expected {known} {len(ids)} track ids ({_few(ids)})"
    if request.agents != 0 and request.lane_change + request.overtake > 0 and request.first_trigger_s > scene.last_s:
        found[f"trigger time {request.first_trigger_s:g} s for lane changes and overtakes"] = ends
    for event in scene.config.event:
        (low_s, high_s), share = event.at_band_s, _LEFT_SHARE.get(event.kind, 0.0)
        if low_s - MOMENT_S > scene.last_s - share * scene.config.lane_change.min_duration_s:
            found[f"event {event.kind} at {low_s:g}:{high_s:g} s"] = (
                ends if share == 0.0 else f"{ends}, to be across by then"
            )
        if all(target_of(scene, row) is None for row in candidate_rows(scene, event.target)):
            meant = [ids[row] for row in candidate_rows(scene, "any") if target_of(scene, row) is not None]
            no_target = "not moving, on no lane, no vehicle, a tracker fragment, or its box points backwards"
            found[f"event {event.kind} with target {event.target!r}"] = (
                f"{no_target if event.target == 'any' or named_rows(scene, event.target).size else 'not there'}, "
                f"expected av, focal, any or one of its {len(meant)} vehicles that move on a lane, but for tracker "
                f"fragments ({_few(meant)})"
            )
    for policy in named if request.agents != 0 else ():
        if not routes.map_offers(policy):
            reason = BEHAVIOURS[policy].no_map.text.rstrip(".")
            found[f"behaviour {policy.value}"] = f"{reason}, expected another behaviour or other scenes (see hid2 scan)"
    return found


def _few(ids: Collection[str]) -> str:
    named = [*ids][:_IDS]
    return ", ".join(named if len(ids) <= _IDS else [*named, "..."])
