"""A scene as it lies on disk before the judge: its tracks with their boxes, its map, what its sidecar claims."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import compress

import numpy as np

from bridge.recordings.recording import Recording
from bridge.recordings.sidecar import Sidecar
from hid2.agents import BoxSize, Track
from hid2.judge.claims import FIGURES, Claim, EventClaim, judge_claims
from hid2.judge.findings import NOISE_BOUNDS, ON_EXPORTED, Bounds, Finding, Quantity, allowed_to
from hid2.judge.states import judge
from hid2.measures.arrays import is_generated_id
from hid2.measures.lane_matching import FlatLanes, flatten_lanes
from hid2.measures.manoeuvres import ManeuverKind
from hid2.occupancy.agent_states import AgentStates, agent_states
from netconvert.geometry import wrap_angle

#: Tolerance of noise over its bound, as a share: noise that is cut there is beyond it by the rounding of sums.
_ROUNDING = 1e-6


#: Of the last maps: scenes with one map come one after the other.
_flat = lru_cache(maxsize=2)(flatten_lanes)


def recording_states(recording: Recording, tracks: Sequence[Track] | None = None) -> AgentStates:
    """The states of a recording's tracks, or of others on its map, inserted ones last."""
    every = recording.tracks if tracks is None else tracks
    recorded = set[str]() if recording.sidecar else {one.track_id for one in recording.tracks}
    inserted = {one.track_id for one in every if is_generated_id(one.track_id)} - recorded
    return states_of(every, _flat(recording.graph), inserted, num_steps=recording.num_steps, step_s=recording.step_s)


def states_of(
    tracks: Sequence[Track], lanes: FlatLanes, inserted: Collection[str], *, num_steps: int, step_s: float
) -> AgentStates:
    """The states of a scene's tracks, inserted ones last."""
    ordered = sorted(tracks, key=lambda track: track.track_id in inserted)
    return agent_states(ordered, lanes, num_steps=num_steps, step_s=step_s, is_inserted=inserted.__contains__)


def findings_of(states: AgentStates, sidecar: Sidecar | None) -> list[Finding]:
    """What the judge finds in a scene and in what its sidecar claims, by the limits that hold for every scene.

    A criticality that was asked for is no finding of an event's vehicle and its target, nor are the headway and the
    braking that it leaves to it: that gap is what the event is about. With a tracker's noise boxes, road and the
    scene's end are of the states exported, motion and claims of the clean ones, and the two are as near as a tracker's.
    """
    if sidecar is None:
        return judge(states, Bounds())
    clean = clean_states(states, sidecar)
    found = judge(clean, Bounds())
    if clean is not states:
        exported = [one for one in judge(states, Bounds()) if one.quantity in ON_EXPORTED]
        found = [*(one for one in found if one.quantity not in ON_EXPORTED), *exported, *_noise(states, clean)]
    allowed = _allowed(sidecar)
    found = [one for one in found if one.value < allowed.get((one.track_id, one.other, one.quantity), float("inf"))]
    return found + judge_claims(clean, *claims_of(sidecar, states))


def clean_states(states: AgentStates, sidecar: Sidecar) -> AgentStates:
    """The same agents, inserted ones as the sidecar has them without noise; the same object where it tells of none."""
    arrays = states.arrays
    told = {agent.track_id: agent.clean for agent in sidecar.agents if agent.clean is not None}
    tracks = []
    for row in np.flatnonzero(arrays.generated).tolist():
        name, steps = arrays.track_ids[row], arrays.step[states.row_span(row)]
        if name not in told or len(told[name].x) != steps.size:  # a finding of its own, or there is no noise
            return states
        motion, size = told[name].motion, BoxSize(float(arrays.length[row]), float(arrays.width[row]))
        kind, category = arrays.object_types[row], int(arrays.category[row])
        tracks.append(Track(name, kind, category, steps, motion[:, :2], motion[:, 2], motion[:, 3:], size))
    if not tracks:
        return states
    inserted = states_of(tracks, states.lanes, told, num_steps=arrays.num_steps, step_s=arrays.step_s)
    return states.rows(np.flatnonzero(~arrays.generated).tolist()).joined(inserted)


def _noise(states: AgentStates, clean: AgentStates) -> Iterator[Finding]:
    """Inserted agents with more noise than trackers make."""
    arrays, without = states.arrays, clean.arrays
    most_m = NOISE_BOUNDS.place_of(np.hypot(*without.velocity.T))
    worst = np.max([
        np.hypot(*(arrays.position - without.position).T) / most_m,
        np.abs(wrap_angle(arrays.heading - without.heading)) / NOISE_BOUNDS.heading_rad,
        np.hypot(*(arrays.velocity - without.velocity).T) / NOISE_BOUNDS.velocity_mps,
    ], axis=0)  # fmt: skip
    for row in np.flatnonzero(arrays.generated).tolist():
        rows = states.row_span(row)
        at = rows.start + int(np.argmax(worst[rows]))
        if worst[at] > 1.0 + _ROUNDING:
            yield Finding(arrays.track_ids[row], int(arrays.step[at]), Quantity.NOISE, float(worst[at]), 1.0)


def claims_of(sidecar: Sidecar, states: AgentStates) -> tuple[list[Claim], list[EventClaim]]:
    """Manoeuvres and events that a sidecar tells as done, but for those of its agents that are not judged here."""
    not_judged = set(compress(states.arrays.track_ids, ~states.arrays.generated))
    claims, left_out = [], not_judged & {agent.track_id for agent in sidecar.agents}
    for agent in (one for one in sidecar.agents if one.track_id not in left_out):
        for record in agent.maneuvers:
            at_s = record.start_s if record.crossing_s is None else record.crossing_s
            if record.status == "done" and at_s is not None:
                claims.append(Claim(agent.track_id, ManeuverKind(record.kind), at_s))
    events = [
        EventClaim(
            one.kind, one.track_id, one.target_track_id, one.at_s, bool(one.ahead),
            {name: getattr(one, name) for name in FIGURES},
        )
        for one in sidecar.events
        if one.status == "done" and one.track_id and one.target_track_id and one.at_s is not None
        if one.track_id not in left_out
    ]  # fmt: skip
    return claims, events


def _allowed(sidecar: Sidecar) -> Mapping[tuple[str, str | None, Quantity], float]:
    """Least values that events allow their vehicles towards their targets."""
    asked = [one for one in sidecar.config.get("event", ()) for _ in range(int(one.get("count", 1)))]
    return {
        (record.track_id, *what): least
        for event, record in zip(asked, sidecar.events, strict=False)
        if record.track_id is not None
        for what, least in allowed_to(record.target_track_id, event).items()
    }
