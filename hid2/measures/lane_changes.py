"""A row for each lane change: when, how fast, the gaps before and after, and what the new follower had to do."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from hid2.measures.conflicts import pair_course
from hid2.measures.driven_lanes import LaneView
from hid2.measures.following import Leaders
from hid2.measures.manoeuvres import Maneuver, ManeuverKind


@dataclass(frozen=True, slots=True)
class LaneChangeRow:
    """One lane change. Gaps are bumper to bumper on the lane path, up to 100 m; None: no vehicle there.

    before: on the lane left, at the start; after: on the lane entered, at the end. lag_id: the new follower, at the end
    or else at the crossing; lag_brakes_mps2, lag_drac_mps2, lag_headway_s: its hardest braking, largest DRAC and least
    headway, front to front, from start to end.
    """

    track_id: str
    source_lane: int
    target_lane: int
    side: int
    complete: bool
    start_s: float
    crossing_s: float
    end_s: float
    duration_s: float
    start_mps: float
    crossing_mps: float
    end_mps: float
    lead_before_id: str | None
    lead_before_m: float | None
    lag_before_id: str | None
    lag_before_m: float | None
    lead_after_id: str | None
    lead_after_m: float | None
    lag_id: str | None
    lag_after_m: float | None
    lag_brakes_mps2: float | None
    lag_drac_mps2: float | None
    lag_headway_s: float | None


def lane_changes(view: LaneView, led: Leaders, seen: Iterable[Maneuver]) -> Iterator[LaneChangeRow]:
    """The lane changes among manoeuvres seen. led: leaders of the same rows."""
    arrays = view.arrays
    numbers = {track_id: number for number, track_id in enumerate(arrays.track_ids)}
    speed = np.hypot(*arrays.velocity.T)
    for one in seen:
        if one.kind is not ManeuverKind.LANE_CHANGE:
            continue
        own = numbers[one.track_id]
        first, middle, last = (round(at / arrays.step_s) for at in (one.start_s, one.crossing_s, one.end_s))
        lead_before, lag_before = _neighbours(view, led, own, first)
        lead_after, lag_after = _neighbours(view, led, own, last)
        lag = lag_after[0] if lag_after[0] is not None else _neighbours(view, led, own, middle)[1][0]
        names = [
            None if agent is None else arrays.track_ids[agent]
            for agent in (lead_before[0], lag_before[0], lead_after[0], lag)
        ]
        brakes = drac = headway = None
        if lag is not None:
            course = pair_course(arrays, lag, own).during(first, last)
            if course.step.size > 1:
                brakes, drac = float(course.brakes_mps2.max()), float(course.drac_mps2.max())
                headway = float(course.headway_s.min())
        start_mps, crossing_mps, end_mps = (float(speed[arrays.row_of[own, at]]) for at in (first, middle, last))
        yield LaneChangeRow(
            one.track_id, one.source_lane, one.target_lane, one.side, one.complete, one.start_s, one.crossing_s,
            one.end_s, one.duration_s, start_mps, crossing_mps, end_mps, names[0], lead_before[1], names[1],
            lag_before[1], names[2], lead_after[1], names[3], lag_after[1], brakes, drac, headway,
        )  # fmt: skip


def _neighbours(
    view: LaneView, led: Leaders, own: int, step: int
) -> tuple[tuple[int | None, float | None], tuple[int | None, float | None]]:
    """Leader and follower of a vehicle at a step on the lane path, each with its gap, m; none on a lane beside."""
    arrays, lane = view.arrays, view.matches.lane
    row = int(arrays.row_of[own, step])

    def beside(at: int) -> bool:
        """Whether a row is on a lane beside that of the vehicle, from or to which it may change."""
        return lane[at] >= 0 and lane[row] >= 0 and int(view.lanes.link[lane[at], lane[row]]) == 1

    lead: tuple[int | None, float | None] = (None, None)
    if led.agent[row] >= 0 and not beside(int(arrays.row_of[led.agent[row], step])):
        lead = int(led.agent[row]), float(led.gap_m[row])
    rows = arrays.row_of[:, step]
    behind = [int(at) for at in rows[rows >= 0] if led.agent[at] == own and not beside(int(at))]
    if not behind:
        return lead, (None, None)
    nearest = min(behind, key=lambda at: float(led.gap_m[at]))
    return lead, (int(arrays.agent[nearest]), float(led.gap_m[nearest]))
