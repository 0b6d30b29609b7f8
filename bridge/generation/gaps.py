"""Every look at a gap as a row, and `gaps_<id>.csv.gz` beside a scene."""

import gzip
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from bridge.files import rounded, table_text
from hid2.policy.lane_change import Gap
from hid2.vehicle import DrivenVehicle, GapLook

#: Column -> what it says. The order of the file; empty cells: does not apply, or no agent is there.
GAP_COLUMNS: Mapping[str, str] = {
    "vehicle": "id in the simulation",
    "round": "round of the generation in which it was driven",
    "track_id": "id in the exported scene; empty: not exported",
    "policy": "what the vehicle is asked for: lane_change or overtake",
    "trigger_s": "trigger time, s from the scene's first step",
    "time_s": "time of the look, s",
    "side": "left or right",
    "lane_id": "lane that is looked at",
    "cell": "cell j of that lane, beside the vehicle",
    "cells_free": "true where sigma = 0 in cells j-1, j, j+1",
    "speed_mps": "own speed",
    "lead_id": "new leader",
    "lead_gap_m": "gap to the new leader, between clearance boxes: some .5 m (.1 to 1.0) less than between bumpers",
    "lead_speed_mps": "its speed",
    "lead_time_gap_s": "lead gap over the own speed; empty: it stands",
    "lead_ttc_s": "time to collision with the new leader at constant speeds; empty: not closing in",
    "lag_id": "new follower",
    "lag_gap_m": "the same to the new follower",
    "lag_speed_mps": "its speed",
    "lag_time_gap_s": "lag gap over the follower's speed; empty: it stands",
    "lag_ttc_s": "time to collision of the new follower at constant speeds; empty: not closing in",
    "remaining_m": "length of the lane left, through its successors",
    "rule": "answer of the lane-change rule: yes, or a reason",
    "refusals": "every condition of the rule that said no, parted by spaces; empty: none",
    "guard": "answer of conflict case 3 and of the path across: yes, a reason, or empty: not asked",
    "sumo": "answer of SUMO: yes, no, or empty: not asked",
}


def gap_rows(
    driven: Sequence[tuple[int, DrivenVehicle]], names: Mapping[str, str], *, step_s: float
) -> Iterator[dict[str, Any]]:
    """Rows of all looks, by `GAP_COLUMNS`; driven: round and vehicle; names: track ids of exported ones by id.

    A vehicle that is driven again has the same id: exported is what it did at last.
    """
    last = {vehicle.vehicle_id: number for number, vehicle in driven}
    for number, vehicle in driven:
        for look in vehicle.gaps:
            yield {
                "vehicle": vehicle.vehicle_id,
                "round": number,
                "track_id": names.get(vehicle.vehicle_id) if number == last[vehicle.vehicle_id] else None,
                "policy": vehicle.policy.value,
                "trigger_s": round(vehicle.start.request.trigger_s, 6),
                "time_s": round(look.step * step_s, 6),
                **look_row(look),
            }


def look_row(look: GapLook) -> dict[str, Any]:
    """What was seen of a gap, and the answers, by `GAP_COLUMNS`."""
    asked, seen = look.rule is None, look.seen
    return {
        "side": seen.side,
        "lane_id": seen.target.lane_id,
        "cell": seen.target.index,
        "cells_free": str(seen.cells_free).lower(),
        "speed_mps": rounded(look.own_mps),
        **neighbour_row("lead", seen.front, follower_mps=look.own_mps, leader_mps=seen.front.speed_mps),
        **neighbour_row("lag", seen.rear, follower_mps=seen.rear.speed_mps, leader_mps=look.own_mps),
        "remaining_m": rounded(seen.remaining_m),
        "rule": str(look.rule or "yes"),
        "refusals": " ".join(look.refusals) or None,
        "guard": str(look.guard or "yes") if asked else None,
        "sumo": None if look.sumo is None else "yes" if look.sumo else "no",
    }


def neighbour_row(name: str, gap: Gap, *, follower_mps: float, leader_mps: float) -> dict[str, Any]:
    """Columns of the new leader or the new follower."""
    gap_m, closing = gap.distance_m, follower_mps - leader_mps
    there = math.isfinite(gap_m)
    return {
        f"{name}_id": gap.track_id if there else None,
        f"{name}_gap_m": rounded(gap_m),
        f"{name}_speed_mps": rounded(gap.speed_mps) if there else None,
        f"{name}_time_gap_s": rounded(gap.time_gap_s(follower_mps)),
        f"{name}_ttc_s": rounded(max(gap_m, 0.0) / closing) if there and closing > 0.0 else None,
    }


def gaps_bytes(driven: Sequence[tuple[int, DrivenVehicle]], names: Mapping[str, str], *, step_s: float) -> bytes:
    """`gaps_<id>.csv.gz`. Same looks, same bytes."""
    looks = ([look.get(column) for column in GAP_COLUMNS] for look in gap_rows(driven, names, step_s=step_s))
    return gzip.compress(table_text([GAP_COLUMNS, *looks]).encode(), mtime=0)
