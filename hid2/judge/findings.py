"""What the judge holds the states of inserted vehicles to: each quantity with its limit, and what it finds."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum, auto
from typing import Any, NamedTuple

import numpy as np

from hid2.agents import FloatArray
from hid2.measures.arrays import MOVES_MPS
from hid2.params import Config, Conflict, Limits
from hid2.reasons import Reason

#: Way over the scene below which an agent stands throughout, m. No tunable: what standing throughout is.
MOVES_M = 2.0
#: Least clearance between an exported box and any other, m. No tunable: of 333 recorded pairs of moving vehicles none
#: is .1 to .3 m apart at the nearest (some overlap, by boxes of usual size).
_SPARE_BOX_M = 0.2
#: Spare that the final check keeps above the TTC at the end, s. No tunable: rounding alone, so that no reader's
#: rounding finds what the final check did not.
_SPARE_END_S = 0.1
#: Share of the drivable area's tolerance that the final check uses. No tunable: rounding alone, as _SPARE_END_S.
_DRIVABLE_KEPT = 0.9
#: Share of 1 / R_min that the final check, and starts, use. No tunable: rounding alone, as _SPARE_END_S.
CURVATURE_KEPT = 0.98
#: Tolerance of the time of a claim, s, and least time before a cut-in that its target has been on its path.
CLAIM_S = 0.5
#: Tolerance of a claimed figure against that of the states, in its unit.
FIGURE_OFF = 0.01
#: Least time headway of a follower, s (of a recorded one unless it kept less to its own leader).
FOLLOWER_HEADWAY_S = 0.8
#: Largest braking that a recorded follower lacks behind an inserted leader, m/s2: behind recorded leaders 6 of 112 lack
#: more (fourteen scenes), 4 of them with boxes that touch.
FOLLOWER_LACKS_MPS2 = 1.5
#: Largest part of a headway, (gap + leader's length) / speed, that the length counts for (`sustained_headway`), s: at
#: least .6 s are left from bumper to bumper, as 130 recorded followers in their lanes have.
LEADER_LENGTH_S = 0.2
#: Share of 1 / R_min above which a curve cannot be driven.
CURVATURE_SHARE = 1.1


class NoiseBounds(NamedTuple):
    """Exported minus clean states, with `export.noise = tracker`: at most what trackers of Argoverse 2 have.

    place_m, heading_rad, velocity_mps: 99.9 % of what 36 tracks have around smooth motion, of headings without tracks
    that are turned round; late_s: how far positions are off at the ends of tracks, which are smoothed.
    """

    place_m: float = 0.3
    late_s: float = 0.09
    heading_rad: float = 0.37
    velocity_mps: float = 6.5

    def place_of(self, speed_mps: FloatArray) -> FloatArray:
        """The same of place, m, at speeds (N,) m/s."""
        return self.place_m + self.late_s * speed_mps


NOISE_BOUNDS = NoiseBounds()


@dataclass(frozen=True, slots=True)
class Bounds:
    """What states are held to, and what the final check keeps beyond it; `export_bounds` has those of the final check.

    spare_*: added to each side of a box, m; to each side of the path driven, m; to the TTC at the end, s.
    drivable_share, curvature_share: of limits.drivable_tolerance_m, and of 1 / limits.min_radius_m; end_rows: states
    left out at both ends of a track, where derivatives are one-sided; by_stated: whether the velocities that a file
    states are held to the limits of motion too.
    """

    limits: Limits = Limits()  # noqa: RUF009  # frozen
    conflict: Conflict = Conflict()  # noqa: RUF009  # frozen
    spare_box_m: float = 0.0
    spare_aside_m: float = 0.0
    spare_end_s: float = 0.0
    drivable_share: float = 1.0
    curvature_share: float = CURVATURE_SHARE
    end_rows: int = 2
    by_stated: bool = False


def export_bounds(config: Config) -> Bounds:
    """The bounds of what is exported: a little inside those of a reader, so that no rounding brings it beyond them."""
    return Bounds(
        config.limits, config.conflict, _SPARE_BOX_M, config.conflict.margin_lateral_m, _SPARE_END_S,
        _DRIVABLE_KEPT, CURVATURE_KEPT, end_rows=0, by_stated=True,
    )  # fmt: skip


class Quantity(StrEnum):
    """What is judged, by the name that findings have; unit, what is said of it, and why a vehicle is not exported."""

    unit: str
    sentence: str
    reason: Reason | None

    def __new__(cls, value: str, unit: str = "", sentence: str = "", reason: Reason | None = None) -> "Quantity":
        """A member with its unit, sentence and reason."""
        member = str.__new__(cls, value)
        member._value_, member.unit, member.sentence, member.reason = value, unit, sentence, reason
        return member

    ACCEL = auto(), "m/s2", "acceleration along the heading", Reason.LIMIT_ACCEL
    DECEL = auto(), "m/s2", "deceleration along the heading", Reason.LIMIT_DECEL
    LATERAL_ACCEL = auto(), "m/s2", "acceleration across the heading", Reason.LIMIT_LATERAL_ACCEL
    LONGITUDINAL_JERK = auto(), "m/s3", "change of the acceleration along the heading", Reason.LIMIT_LONGITUDINAL_JERK
    JERK = auto(), "m/s3", "change of the acceleration", Reason.LIMIT_JERK
    YAW_RATE = auto(), "rad/s", "change of the heading", Reason.LIMIT_YAW_RATE
    YAW_ACCEL = auto(), "rad/s2", "change of the yaw rate", Reason.LIMIT_YAW_ACCEL
    CURVATURE = auto(), "1/m", "yaw rate over speed", Reason.LIMIT_CURVATURE
    AGAINST_LANE = auto(), "deg", "angle to every lane below the centre", Reason.AGAINST_LANE
    SOLID_LINE = auto(), "line", "lines that are solid where lanes are changed across them", Reason.SOLID_LINE
    OFF_ROAD = auto(), "m", "distance of the box's outline from the drivable area", Reason.OFF_ROAD
    OVERLAP = auto(), "m2", "ground shared with another box"
    TTC_LEADER = auto(), "s", "time to collision with what leads on the path driven", Reason.TTC_LANE_LEADER
    TTC_FOLLOWER = (
        "ttc_recorded_follower", "s", "time to collision of a recorded follower", Reason.TTC_RECORDED_FOLLOWER
    )  # fmt: skip
    PET = auto(), "s", "post-encroachment time where paths cross", Reason.PET
    END_TTC = auto(), "s", "time to collision after the last step, all at constant velocity", Reason.TTC_AT_END
    END_CONTACT = auto(), "s", "contact after the last step that braking does not avoid", Reason.TTC_AT_END
    CLAIM = auto(), "s", "time between what is claimed and what the states show"
    CLAIMED_GAP = auto(), "m", "difference to the gap that is claimed of an event"
    CLAIMED_SPEED = "claimed_speed_difference", "m/s", "difference to the speed difference that is claimed of an event"
    CLAIMED_TTC = auto(), "s", "difference to the least time to collision that is claimed of an event"
    CLAIMED_TTC_TIME = auto(), "s", "difference to the time of the least time to collision of an event"
    CLAIMED_HEADWAY = auto(), "s", "difference to the least headway that is claimed of an event's target"
    CLAIMED_BRAKING = auto(), "m/s2", "difference to the braking that is claimed of an event's vehicle"
    CLAIMED_PET = auto(), "s", "difference to the post-encroachment time that is claimed of an event"
    CLAIMED_DRAC = auto(), "m/s2", "difference to the DRAC that is claimed of an event"
    FOLLOWER_HEADWAY = (
        "follower_headway",
        "s",
        "time headway of a follower, where it or its leader is inserted",
        Reason.FOLLOWER_HEADWAY,
    )
    FOLLOWER_BRAKING = (
        "follower_braking",
        "m/s2",
        "braking that a recorded follower would need, and does not do",
        Reason.FOLLOWER_BRAKING,
    )
    NOISE = auto(), "", "exported minus clean state, over what trackers have"


@dataclass(frozen=True, eq=False, slots=True)
class MotionProfile:
    """What a reader of positions would compute, by differences at the steps, each (N,): the names say the units."""

    speed_mps: FloatArray
    accel_mps2: FloatArray
    lateral_accel_mps2: FloatArray
    longitudinal_jerk_mps3: FloatArray
    jerk_mps3: FloatArray
    yaw_rate_radps: FloatArray
    yaw_accel_radps2: FloatArray

    @classmethod
    def of(
        cls, velocity: FloatArray, heading: FloatArray, derivative: Callable[[FloatArray], FloatArray]
    ) -> "MotionProfile":
        """By velocities (N, 2) m/s, headings (N,) rad without jumps, and what gives the derivative of any (N, ...)."""
        accel, yaw_rate, cos, sin = derivative(velocity), derivative(heading), np.cos(heading), np.sin(heading)
        along = accel[:, 0] * cos + accel[:, 1] * sin
        return cls(
            np.hypot(*velocity.T), along, accel[:, 1] * cos - accel[:, 0] * sin, derivative(along),
            np.hypot(*derivative(accel).T), yaw_rate, derivative(yaw_rate),
        )  # fmt: skip

    @property
    def curvature_1pm(self) -> FloatArray:
        """Yaw rate over speed, 1/m; 0 where it is slow."""
        fast = self.speed_mps > MOVES_MPS
        return np.where(fast, np.abs(self.yaw_rate_radps) / np.where(fast, self.speed_mps, 1.0), 0.0)


#: Value of a profile and the bound that it must not exceed, in the order in which the final check names a first breach.
MOTION_LIMITS: Mapping[Quantity, tuple[Callable[[MotionProfile], FloatArray], Callable[[Bounds], float]]] = {
    Quantity.ACCEL: (lambda p: p.accel_mps2, lambda b: b.limits.accel_max_mps2),
    Quantity.DECEL: (lambda p: -p.accel_mps2, lambda b: -b.limits.accel_min_mps2),
    Quantity.LATERAL_ACCEL: (lambda p: np.abs(p.lateral_accel_mps2), lambda b: b.limits.lateral_accel_mps2),
    Quantity.LONGITUDINAL_JERK: (lambda p: np.abs(p.longitudinal_jerk_mps3), lambda b: b.limits.longitudinal_jerk_mps3),
    Quantity.JERK: (lambda p: p.jerk_mps3, lambda b: b.limits.jerk_mps3),
    Quantity.YAW_RATE: (lambda p: np.abs(p.yaw_rate_radps), lambda b: b.limits.yaw_rate_radps),
    Quantity.YAW_ACCEL: (lambda p: np.abs(p.yaw_accel_radps2), lambda b: b.limits.yaw_accel_radps2),
    Quantity.CURVATURE: (lambda p: p.curvature_1pm, lambda b: b.curvature_share / b.limits.min_radius_m),
}
#: Quantities judged on exported states also where these have a tracker's noise; all others on the clean states.
ON_EXPORTED = frozenset({Quantity.OVERLAP, Quantity.OFF_ROAD, Quantity.END_TTC, Quantity.END_CONTACT})

#: What an event's bands of criticality are about.
_BANDS = {"ttc_s": (Quantity.TTC_LEADER, Quantity.TTC_FOLLOWER), "pet_s": (Quantity.PET,)}
#: Least values that are no finding of a vehicle, by the other agent and the quantity.
Allowed = Mapping[tuple[str | None, Quantity], float]


def allowed_to(target_id: str | None, event: Mapping[str, Any]) -> Allowed:
    """Least values of an event's vehicle towards its target that are no finding: of its bands, and any headway."""
    asked = {one: float(event[band][0]) for band in _BANDS if event.get(band) for one in _BANDS[band]}
    asked |= dict.fromkeys((Quantity.FOLLOWER_HEADWAY, Quantity.FOLLOWER_BRAKING), float("-inf"))
    return {(target_id, quantity): least for quantity, least in asked.items()}


#: Quantities with a least value as their limit.
LEAST = frozenset({
    Quantity.TTC_LEADER, Quantity.TTC_FOLLOWER, Quantity.PET, Quantity.END_TTC, Quantity.END_CONTACT,
    Quantity.FOLLOWER_HEADWAY,
})  # fmt: skip


class Finding(NamedTuple):
    """One breach: the inserted track and the step, the value and its limit, and the other track it is about.

    step: of the worst value; of an overlap the first one, of a headway the last of the time for which it lasts, of a
    claim the one claimed.
    """

    track_id: str
    step: int
    quantity: Quantity
    value: float
    limit: float
    other: str | None = None

    @property
    def reason(self) -> Reason:
        """Why the vehicle is not exported, but for boxes that meet, which their agents tell apart."""
        assert self.quantity.reason is not None, self.quantity
        return self.quantity.reason
