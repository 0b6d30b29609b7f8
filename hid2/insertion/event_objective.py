"""The objective of an event: whether the judge sees it in a vehicle's states, and how far from what is asked.

Asked of candidates that are rolled out and of vehicles that SUMO has driven, in the same words.
"""

import math
from dataclasses import dataclass

import numpy as np

from hid2.agents import FloatArray, Track
from hid2.insertion.event_targets import Target
from hid2.judge.claims import EventClaim, event_step
from hid2.judge.events import EventMeasures, crossing_steps, is_ahead, measure_event
from hid2.occupancy.agent_states import AgentStates, agent_states
from hid2.params import Event
from hid2.reasons import Reason
from hid2.scene import Scene

#: Tolerance of an event's time, before and after that asked for, s; least share of the braking asked for (the largest
#: is as far above 1), and that at which it begins. No tunables: as positions are smoothed, none is met exactly.
MOMENT_S, _BRAKES_SHARE, _BEGINS_SHARE = 0.5, 0.8, 0.5
#: Largest lateral offset to the target in lead and follow, m. Not a parameter, it saves time: the judge looks again.
_ASIDE_M = 2.5


@dataclass(frozen=True, eq=False, slots=True)
class Seen:
    """An event as the judge sees it in the states of a vehicle and its target.

    order: 1 where the vehicle is ahead of the target, or crosses first, else -1.
    """

    at_step: int
    order: int
    measures: EventMeasures


@dataclass(frozen=True, eq=False, slots=True)
class Objective:
    """What is asked for of a vehicle and a target: whether its states show it, and how near to the middle.

    others: recorded agents, with the target, and vehicles of events before, with the boxes that they have.
    """

    scene: Scene
    event: Event
    target: Target
    others: AgentStates

    @property
    def _at_band_s(self) -> tuple[float, float]:
        return self.event.at_band_s[0] - MOMENT_S, self.event.at_band_s[1] + MOMENT_S

    def likely_step(self, track: Track) -> int | None:
        """The step nearest to the middle of what is asked at which a vehicle may bring the event about; None for never.

        By centres, boxes and speeds alone: a cheap look before the judge's.
        """
        event, target, at = self.event, self.target, track.timesteps
        forward = np.stack([np.cos(target.heading[at]), np.sin(target.heading[at])], axis=1)
        offset = track.position - target.position[at]
        ahead = (offset * forward).sum(axis=1)
        gap_m = np.abs(ahead) - 0.5 * (track.size.length_m + target.track.size.length_m)
        bands = [(np.asarray(at * self.scene.step_s, dtype=np.float64), self._at_band_s)]
        if event.kind != "cross":
            bands.append((np.asarray(track.speed - target.speed[at], dtype=np.float64), event.difference_band_mps))
            if event.kind != "merge":  # the gaps of these are not along the target's heading
                bands.append((gap_m, event.gap_band_m))
        if event.kind in ("cut_in", "overtake"):
            bands.append((ahead, (0.0, math.inf)))
        if event.kind in ("lead", "follow"):
            aside = np.abs(offset[:, 1] * forward[:, 0] - offset[:, 0] * forward[:, 1])
            bands += [(aside, (0.0, _ASIDE_M)), (ahead if event.kind == "lead" else -ahead, (0.0, math.inf))]
        if event.brakes_mps2 and at.size > 1:  # it brakes from the moment on
            hard = np.flatnonzero(-np.gradient(track.speed, self.scene.step_s) > _BEGINS_SHARE * event.brakes_mps2)
            wait_s = ((hard[0] if hard.size else np.arange(at.size)) - np.arange(at.size)) * self.scene.step_s
            bands.append((np.asarray(wait_s, dtype=np.float64), (0.0, MOMENT_S)))
        within = target.present[at] & np.logical_and.reduce([(low <= x) & (x <= high) for x, (low, high) in bands])
        off = np.max([_off(x, band) for x, band in bands[:3]], axis=0)
        return int(at[np.argmin(np.where(within, off, np.inf))]) if within.any() else None

    def seen(self, track: Track) -> Seen | None:
        """The event as the judge sees it; None where it does not."""
        scene, kind, target, near = self.scene, self.event.kind, self.target, self.likely_step(track)
        if near is None:
            return None
        followed = kind in ("lead", "follow")  # by the next vehicle, of all that there are
        states = agent_states(
            [track] if followed else [target.track, track], scene.states.lanes, num_steps=scene.num_steps,
            step_s=scene.step_s, is_inserted=track.track_id.__eq__,
        )  # fmt: skip
        states = self.others.joined(states) if followed else states
        own, there = states.arrays.num_agents - 1, states.arrays.track_ids.index(target.track.track_id)
        order = -1 if kind == "follow" else 1
        if kind == "cross":
            crossed = crossing_steps(states, own, there)
            order = 1 if crossed is not None and crossed[0] < crossed[1] else -1
        claim = EventClaim(kind, track.track_id, target.track.track_id, near * scene.step_s, ahead=order > 0)
        at = event_step(states, claim)
        if at is None or at not in target.track.timesteps or at not in track.timesteps:
            return None
        found = measure_event(states, kind, own, there, at_step=at)
        if kind == "merge":
            order = 1 if is_ahead(states, own, there, at) else -1
        return Seen(at, order, found)

    def cost(self, seen: Seen) -> float:
        """How far from the middle of what is asked, over half of each band; above 1 where it is not as asked."""
        return max(self._off_place(seen), self._off_criticality(seen))

    def missed_by(self, seen: Seen) -> Reason | None:
        """Why what is seen is not what is asked: where and when, or how critical; None where it is."""
        if self._off_place(seen) > 1.0:
            return Reason.EVENT_NOT_THERE
        return Reason.EVENT_CRITICALITY if self._off_criticality(seen) > 1.0 else None

    def _off_place(self, seen: Seen) -> float:
        event, found = self.event, seen.measures
        return max(
            _off_by(seen.at_step * self.scene.step_s, self._at_band_s), _off_by(found.gap_m, event.gap_band_m),
            _off_by(found.speed_difference_mps, event.difference_band_mps),
        )  # fmt: skip

    def _off_criticality(self, seen: Seen) -> float:
        event, found = self.event, seen.measures
        braking = abs(found.brakes_mps2 / event.brakes_mps2 - 1.0) / (1.0 - _BRAKES_SHARE) if event.brakes_mps2 else 0.0
        return max(
            braking, _off_by(found.min_ttc_s, event.ttc_s), _off_by(found.pet_s, event.pet_s),
            _off_by(found.drac_mps2, event.drac_mps2),
        )  # fmt: skip


def _off_by(value: float | None, band: tuple[float, float] | None) -> float:
    return 0.0 if band is None else float(_off(np.array(math.inf if value is None else value), band))


def _off(value: FloatArray, band: tuple[float, float]) -> FloatArray:
    """Distance from the middle of a band, over half of it."""
    return np.abs(value - 0.5 * (band[0] + band[1])) / max(0.5 * (band[1] - band[0]), 1e-6)
