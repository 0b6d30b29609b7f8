"""The data dictionary of a study: what each column of each table says."""

from collections.abc import Mapping

from bridge.generation.gaps import GAP_COLUMNS
from bridge.studies.statistics import OUTCOMES

_RUN: Mapping[str, str] = {
    "scene": "folder of the source scene",
    "city": "its city",
    "point": "number of the point of the design",
    "seed": "seed: the same vehicles, drivers, sites and traffic for every point",
    "replay": "fixed: recorded vehicles drive as recorded; reactive: they yield, which was not recorded",
}

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
    },
    "requests": {
        **_RUN,
        "trigger_after_s": "where the trigger time varies: its value",
        "vehicle": "id in the simulation; the same id is the same vehicle at every point",
        "source": "start: begins in the scene; flow: enters at the map's edge",
        "kind": "what is asked for",
        "status": "done, aborted, not_feasible, not_triggered, or not_placed (no site on this map)",
        "reason": "last reason where it was not done",
        "exported": "whether it passes the last check and could be exported: yes, or the reason; flows: empty",
        "entered_s": "time of its first step",
        "desired_mps": "the driver's desired speed",
        "trigger_s": "trigger time, from the scene's first step",
        "counted": "enters the statistics: it was triggered, and not in the warm-up",
        "observed_to_s": "time of the acceptance, else until when it could have accepted: given up, left, or the end",
        "accepted_s": "time at which SUMO was asked for the change that it carried out",
        "waited_s": "observed_to_s - trigger_s; censored where not accepted",
        "accepted": "whether SUMO carried out the change; false, too, where no site was found",
        "looks": "looks at gaps",
        "refused_by_rule": "looks that the lane-change rule refused",
        "refused_by_guard": "looks that the rule accepted, and the guard or the path across refused",
        "refused_by_sumo": "looks that both accepted, and SUMO refused",
        "lead_gap_m": "bumper gap to the new leader at the acceptance",
        "lag_gap_m": "bumper gap to the new follower at the acceptance",
        "lead_time_gap_s": "lead gap over the own speed",
        "lag_time_gap_s": "lag gap over the follower's speed",
        "speed_mps": "own speed at the acceptance",
        "start_s": "start of the lateral motion (|d'| above 0.1 m/s)",
        "crossing_s": "half way between the lanes",
        "end_s": "end of the lateral motion",
        "lateral_s": "end_s - start_s: its duration, which is no part of waited_s",
        "min_ttc_s": "smallest two-dimensional TTC to anything from start to end; empty: none below 5 s",
        "min_pet_s": "smallest PET at a crossing of paths from start to end; empty: none below 5 s",
    },
    "looks": {**_RUN, **{name: says for name, says in GAP_COLUMNS.items() if name not in ("round", "track_id")}},
    "gaps": {
        **_RUN,
        "vehicle": "the vehicle that looked",
        "side": "left or right",
        "lead_id": "new leader; empty: none",
        "lag_id": "new follower; empty: none",
        "accepted": "whether the gap was taken",
        "from_s": "first look at it",
        "to_s": "last look at it",
        "looks": "how many",
        "answer": "the rule's last answer",
        "trigger_s": "trigger time",
        "lag_time_gap_s": "at the acceptance; of a gap that was not taken: the largest",
        "lead_time_gap_s": "the same to the new leader",
        "lag_gap_m": "the same, m",
        "lead_gap_m": "the same, m",
    },
    "flow": {
        **_RUN,
        "from_s": "begin of an interval of 30 s, or of the whole scene where it is shorter",
        "flow_veh_per_h_lane": "distance driven over length and time (Edie), on the lanes where traffic enters",
        "density_veh_per_km_lane": "time spent over length and time",
        "speed_kmph": "flow over density",
        "waiting_to_enter_s": "mean wait before the map of the vehicles that entered in the interval",
    },
    "dose_response": {
        "parameter": "what varies",
        "value": "its value",
        "outcome": "; ".join(f"{outcome.name}: {outcome.says}" for outcome in OUTCOMES),
        "rows": "requests or gaps at this value",
        "estimate": "the outcome",
        "low_runs, high_runs": "95 % interval, runs drawn again",
        "low_scenes, high_scenes": "95 % interval, scenes drawn again; where there are at least three",
        "difference": "estimate less that of the first value",
        "difference_low_runs, difference_high_runs": "its 95 % interval: the same draw of runs for both values",
        "difference_low_scenes, difference_high_scenes": "the same with scenes",
    },
    "critical_gaps": {
        "parameter": "what varies",
        "value": "its value",
        "mean_s": "mean critical lag time gap, lognormal, maximum likelihood (Troutbeck)",
        "mean_low_s, mean_high_s": "its 95 % interval",
        "sd_s": "standard deviation between drivers",
        "raff_s": "Raff's critical gap",
        "drivers": "drivers that accepted a gap and are used",
        "inconsistent": "drivers left out: they had refused a larger lag gap than the one taken",
    },
    "acceptance": {
        "parameter": "what varies",
        "value": "its value",
        "intercept, lag, lead": "logistic regression of accepted on lag and lead time gap, s (above 10 s: 10 s)",
        "lag_low, lag_high": "95 % interval of the coefficient of the lag time gap, clustered by run",
        "lead_s": "median lead time gap, at which the curve is drawn",
        "gaps, accepted": "gaps looked at, and taken",
        "separated": "why there is no curve: a threshold parts the gaps without exception",
    },
    "effects": {
        "outcome": "accepted (0, 1), waited_or_end_s (waited_s up to the longest), or a column of requests",
        "parameter": "what varies",
        "drawn_again": "unit of the bootstrap: runs or scenes",
        "rows": "requests with that outcome",
        "standardised_coefficient": "standard deviations of the outcome for one of the parameter, all others held",
        "low, high": "its 95 % interval",
        "first_order": "first-order variance-based index on the means of the points (SALib, RBD-FAST)",
        "first_order_interval": "half width of its 95 % interval",
    },
}


def dictionary_rows() -> list[tuple[str, str, str]]:
    """Table, column, what it says."""
    return [(table, column, says) for table, columns in DICTIONARY.items() for column, says in columns.items()]
