"""The data dictionary of a study: what each column of each table says, and the outcomes that are made of them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import get_type_hints

from bridge.generation.gaps import GAP_COLUMNS
from hid2.measures.conflicts import TrafficConflict
from hid2.measures.lane_changes import LaneChangeRow

_RUN: Mapping[str, str] = {
    "scene": "folder of the source scene",
    "city": "its city",
    "point": "number of the point of the design",
    "seed": "seed: the same vehicles, drivers, sites and traffic for every point",
    "replay": "fixed: recorded vehicles drive as recorded; reactive: they yield, which was not recorded",
}

#: Columns of the table of requests, in their order.
REQUEST_COLUMNS: Mapping[str, str] = {
    "vehicle": "id in the simulation; the same id is the same vehicle at every point",
    "source": "start: begins in the scene; flow: enters at the map's edge",
    "kind": "what is asked for",
    "status": "done, aborted, not_feasible, not_triggered, or not_placed (no site on this map, or never let in)",
    "reason": "last reason where it was not done",
    "exported": "whether it passes the last check and could be exported: yes, or the reason; flows: empty",
    "entered_s": "time of its first step",
    "desired_mps": "the driver's desired speed",
    "trigger_s": "trigger time, from the scene's first step",
    "counted": "enters the statistics: it was triggered with time left for a change, and not in the warm-up; of paired "
    "vehicles at every point",
    "observed_to_s": "time of the acceptance, else until when it could have accepted: given up, left, or no time left",
    "accepted_s": "time at which SUMO was asked for the change that it carried out",
    "waited_s": "observed_to_s - trigger_s; censored where not accepted",
    "accepted": "whether SUMO carried out the change; false, too, where no site was found",
    "looks": "looks at gaps",
    "lead_gap_m": "gap to the new leader at the acceptance, between clearance boxes: some .5 m (.1 to 1.0) less than "
    "between bumpers",
    "lag_gap_m": "the same to the new follower",
    "lead_time_gap_s": "lead gap over the own speed",
    "lag_time_gap_s": "lag gap over the follower's speed",
    "speed_mps": "own speed at the acceptance",
    "start_s": "start of the lateral motion (|d'| above 0.1 m/s); of one that never crossed: accepted_s",
    "crossing_s": "half way between the lanes",
    "end_s": "end of the lateral motion",
    "lateral_s": "end_s - start_s: its duration, which is no part of waited_s",
    "min_ttc_s": "smallest two-dimensional TTC to anything from start to end; empty: none below 5 s",
    "overlaps": "whether its box meets another one from start to end",
    "lag_drac_mps2": "largest DRAC of the new follower from start to end: closing speed squared over twice the gap",
    "lag_headway_s": "its least time headway, front to front",
    "lag_brakes_mps2": "its hardest braking",
}


@dataclass(frozen=True, slots=True)
class Merit:
    """A figure of merit: its column in dose_response.csv, what it says, the table and columns that it is made of."""

    name: str
    says: str
    table: str
    above: str | None
    below: str | None = None


#: What may refuse a gap: column `gaps.refused_by`, and in words.
DECIDE = {
    "rule": "the rule",
    "cells": "taken cells",
    "road": "the road",
    "end": "the scene's end",
    "guard": "the guard",
    "sumo": "SUMO",
}
#: Those that are asked about every gap; guard and SUMO are asked about what the rule took.
AT_LAST = ("rule", "cells", "road", "end")
#: What a study tells of each value of a parameter.
OUTCOMES = (
    Merit("share_accepted", "share of the requests counted that got a gap", "requests", "accepted"),
    Merit("mean_wait_s", "mean waiting time from the trigger, s, up to the shortest time observed at every value",
            "requests", None),
    Merit("gaps_accepted", "share of the gaps looked at that the rule took", "gaps", "accepted"),
    Merit("gaps_taken", "share of the gaps that the rule took and vehicles changed into", "gaps", "taken", "accepted"),
    *(
        Merit(f"refused_by_{name}", f"share of the gaps that {DECIDE[name]} refused at last", "gaps",
                f"refused_by_{name}")
        for name in AT_LAST
    ),
    *(
        Merit(f"refused_by_{name}", f"share of the gaps that {DECIDE[name]} was asked about, to which it said no at "
                "some look and that were not taken", "gaps", f"refused_{name}", f"asked_{name}")
        for name in ("guard", "sumo")
    ),
    Merit("share_overlapping", "share of the changes begun in which boxes meet", "requests", "overlaps"),
    Merit("lag_drac_mps2", "mean of the largest DRAC of the new follower, m/s2", "requests", "lag_drac_mps2"),
    Merit("lag_headway_s", "mean of the least time headway of the new follower, s", "requests", "lag_headway_s"),
    Merit("lag_brakes_mps2", "mean of the hardest braking of the new follower, m/s2", "requests", "lag_brakes_mps2"),
    Merit("lateral_s", "mean duration of the lateral motion, s", "requests", "lateral_s"),
    Merit("lag_time_gap_s", "mean lag time gap taken (above 10 s: 10 s), s", "requests", "lag_time_gap_s"),
    Merit("share_ttc_below_critical", "share of the changes begun with a TTC below 1.5 s", "requests", "ttc_critical"),
)  # fmt: skip


def _said(row: type) -> dict[str, str]:
    """What the fields of a row say."""
    return {name: said.__metadata__[0] for name, said in get_type_hints(row, include_extras=True).items()}


#: Table -> column -> what it says. Columns that vary in the study have the names of their parameters.
DICTIONARY: Mapping[str, Mapping[str, str]] = {
    "runs": {
        **_RUN,
        "status": "done, or quarantined",
        "reason": "why a run has no result",
        "vehicles": "vehicles driven",
        "requests": "requests of the kind that is studied",
        "accepted": "of these, how many got a gap",
        "seconds": "time that the run took",
        "folder": "where what was measured lies, trajectories.trj too",
    },
    "requests": {**_RUN, "trigger_after_s": "where the trigger time varies: its value", **REQUEST_COLUMNS},
    "looks": {**_RUN, **{name: says for name, says in GAP_COLUMNS.items() if name not in ("round", "track_id")}},
    "gaps": {
        **_RUN,
        "vehicle": "what looked",
        "side": "left or right",
        "lead_id": "new leader; empty: none",
        "lag_id": "new follower; empty: none",
        "accepted": "whether the rule took it at some look",
        "taken": "whether SUMO carried out the change",
        "refused_by": "what said no at the last look: cells, road, end (of the scene), rule (too_slow, too), guard or "
        "sumo; empty: taken",
        "refused_guard, refused_sumo": "whether it said no at some look, and the gap was not taken",
        "asked_guard, asked_sumo": "whether at some look it came to the guard, and to SUMO; safety = rule: they agree",
        "accepted_s": "first look at which the rule took it",
        "lag_refused_s": "largest lag time gap that the rule refused for it alone, before the vehicle took any gap",
        "lead_refused_s": "the same to the new leader",
        "from_s": "first look at it",
        "to_s": "last look at it",
        "lag_time_gap_s": "at the acceptance; of a gap that was not taken: the largest",
        "lead_time_gap_s": "the same to the new leader",
    },
    "flow": {
        **_RUN,
        "lane": "lane segment where traffic enters",
        "from_s, to_s": "a minute after the warm-up; the last one may be half as long, or the whole of a short scene",
        "flow_veh_per_h_lane": "distance driven over length and time (Edie)",
        "density_veh_per_km_lane": "time spent over length and time",
        "speed_kmph": "flow over density",
        "waiting_to_enter_s": "mean wait before the map of the vehicles that entered in the interval",
    },
    "lane_changes": {**_RUN, **_said(LaneChangeRow)},
    "conflicts": {**_RUN, **_said(TrafficConflict)},
    "dose_response": {
        "parameter": "what varies",
        "value": "its value; of more than 12 the mean of each of six classes of neighbouring ones",
        "outcome": "; ".join(f"{outcome.name}: {outcome.says}" for outcome in OUTCOMES),
        "rows": "requests or gaps at this value that the outcome is of: those asked about, those that changed, ...",
        "estimate": "the outcome",
        "within_s": "of mean_wait_s: the shortest time observed at every value, up to which it is the mean",
        "low_runs, high_runs": "95 % interval, runs drawn again",
        "low_scenes, high_scenes": "95 % interval, scenes drawn again; where there are at least three",
        "trend": "slope of the outcome over all values of a numeric parameter, least squares",
        "trend_low, trend_high": "its 95 % interval, runs drawn again",
        "p": "two-sided, of no trend: signs of the clusters' own trends are changed (Canay, Romano and Shaikh 2017)",
        "clusters": "how many tell of two values: scenes, or runs of fewer than three; k give p of 2 / 2^k at least",
        "p_holm": f"the same, adjusted for all outcomes but {OUTCOMES[0].name} that vary at all (Holm)",
        "difference": "estimate less that of the first value: the least number, or the name that the study has first",
        "difference_low_runs, difference_high_runs": "its 95 % interval: the same draw of runs for both values",
        "difference_low_scenes, difference_high_scenes": "the same with scenes",
    },
    "critical_gaps": {
        "parameter": "what varies",
        "value": "its value",
        "side": "lag: gap to the new follower over its speed; lead: to the new leader over the own speed",
        "mean_s": "mean critical time gap, lognormal, maximum likelihood (Troutbeck)",
        "mean_low_s, mean_high_s": "its 95 % interval",
        "sd_s": "standard deviation between drivers",
        "drivers": "drivers that took or refused a gap for this side of it, and are used",
        "inconsistent": "drivers left out: they had refused a larger gap than the one taken",
    },
}
