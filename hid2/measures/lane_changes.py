"""A row for each lane change: when, how fast, the gaps before and after, and what the new follower had to do."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hid2.measures.conflicts import pair_course
from hid2.measures.driven_lanes import LaneView
from hid2.measures.following import LaneLeaders
from hid2.measures.lane_matching import CHANGES_LANES
from hid2.measures.manoeuvres import Maneuver, ManeuverKind


@dataclass(frozen=True, slots=True)
class LaneChangeRow:
    """One lane change. Gaps are bumper to bumper on the lane path, up to 100 m; None: no vehicle there."""

    track_id: Annotated[str, "what changed lanes: an id in the simulation, or of a recorded vehicle"]
    source_lane: Annotated[int, "lane segment left"]
    target_lane: Annotated[int, "lane segment entered"]
    side: Annotated[int, "1: to the left, -1: to the right"]
    complete: Annotated[bool, "whether start and end were seen"]
    start_s: Annotated[float, "from when the lateral speed is above 0.1 m/s"]
    crossing_s: Annotated[float, "when it is between the lanes"]
    end_s: Annotated[float, "until when the lateral speed is above 0.1 m/s"]
    duration_s: Annotated[float, "end_s - start_s"]
    start_mps: Annotated[float, "speed at start_s"]
    crossing_mps: Annotated[float, "speed at crossing_s"]
    end_mps: Annotated[float, "speed at end_s"]
    lead_before_id: Annotated[str | None, "leader on the lane left, at the start"]
    lead_before_m: Annotated[float | None, "bumper gap to it on the lane path, up to 100 m"]
    lag_before_id: Annotated[str | None, "follower there"]
    lag_before_m: Annotated[float | None, "its gap"]
    lead_after_id: Annotated[str | None, "leader on the lane entered, at the end"]
    lead_after_m: Annotated[float | None, "gap to it"]
    lag_id: Annotated[str | None, "new follower, at the end or else at the crossing"]
    lag_after_m: Annotated[float | None, "its gap at the end"]
    lag_brakes_mps2: Annotated[float | None, "hardest braking of the new follower from start to end"] = None
    lag_drac_mps2: Annotated[float | None, "its largest DRAC: closing speed squared over twice the gap"] = None
    lag_headway_s: Annotated[float | None, "its least time headway, front to front"] = None


def lane_changes(view: LaneView, led: LaneLeaders, seen: Iterable[Maneuver]) -> Iterator[LaneChangeRow]:
    """The lane changes among manoeuvres seen. led: leaders of the same rows."""
    arrays = view.arrays
    numbers = {track_id: number for number, track_id in enumerate(arrays.track_ids)}
    speed = np.hypot(*arrays.velocity.T)
    for one in seen:
        if one.kind is not ManeuverKind.LANE_CHANGE:
            continue
        own = numbers[one.track_id]
        first, middle, last = (round(at / arrays.step_s) for at in (one.start_s, one.crossing_s, one.end_s))
        before, after = (_neighbours(view, led, own, at) for at in (first, last))
        lag = after[2] if after[2] is not None else _neighbours(view, led, own, middle)[2]
        names = [None if agent is None else arrays.track_ids[agent] for agent in (before[0], before[2], after[0], lag)]
        of_lag = {} if lag is None else pair_course(arrays, lag, own).during(first, last).of_follower()
        start_mps, crossing_mps, end_mps = (float(speed[arrays.row_of[own, at]]) for at in (first, middle, last))
        yield LaneChangeRow(
            one.track_id, one.source_lane, one.target_lane, one.side, one.complete, one.start_s, one.crossing_s,
            one.end_s, one.duration_s, start_mps, crossing_mps, end_mps, names[0], before[1], names[1], before[3],
            names[2], after[1], names[3], after[3], **of_lag,
        )  # fmt: skip


def _neighbours(
    view: LaneView, led: LaneLeaders, own: int, step: int
) -> tuple[int | None, float | None, int | None, float | None]:
    """Leader and follower of a vehicle at a step on the lane path, each with its gap, m; none on a lane beside."""
    arrays, lane = view.arrays, view.matches.lane
    row, rows = int(arrays.row_of[own, step]), arrays.row_of[:, step]

    def apart(at: int) -> bool:
        """Whether a row is on no lane beside that of the vehicle, from or to which it may change."""
        return lane[at] < 0 or lane[row] < 0 or int(view.lanes.link[lane[at], lane[row]]) != CHANGES_LANES

    ahead = led.agent[row]
    leads = ahead >= 0 and apart(int(rows[ahead]))
    behind = [int(at) for at in rows[rows >= 0] if led.agent[at] == own and apart(int(at))]
    nearest = min(behind, key=lambda at: float(led.gap_m[at]), default=None)
    return (
        *((int(ahead), float(led.gap_m[row])) if leads else (None, None)),
        *((None, None) if nearest is None else (int(arrays.agent[nearest]), float(led.gap_m[nearest]))),
    )
