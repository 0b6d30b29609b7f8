"""Scenes pooled: ratios of sums for each group, with bootstrap intervals over scenes."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from bridge.scene_metrics import GROUPS
from hid2.agents import FloatArray, Policy
from hid2.evaluation.behaviour import ManeuverKind
from hid2.params import Limits

#: Resamples of the bootstrap.
RESAMPLES = 2000
#: Bounds of the agent-count bands of the paper.
BANDS = (40, 50, 70, 90)
#: Indices drawn at a time: the memory of the bootstrap does not grow with the scenes.
_BLOCK = 2_000_000
#: Interval reported, percent.
INTERVAL = (2.5, 97.5)

Row = Mapping[str, Any]


class Metric(NamedTuple):
    """A ratio of two columns of the scene rows, pooled over scenes."""

    key: str
    label: str
    unit: str
    numerator: str
    denominator: str


KINEMATIC = (
    Metric("lo", "LO: |longitudinal acceleration|", "m/s²", "paper_lo", "paper_tracks"),
    Metric("la", "LA: |lateral acceleration|", "m/s²", "paper_la", "paper_tracks"),
    Metric("je", "JE: jerk", "m/s³", "paper_je", "paper_tracks"),
)
CLEAN = (
    Metric("clean_lo", "LO, moving vehicles without fragments", "m/s²", "clean_lo", "clean_tracks"),
    Metric("clean_la", "LA, moving vehicles without fragments", "m/s²", "clean_la", "clean_tracks"),
    Metric("clean_je", "JE, moving vehicles without fragments", "m/s³", "clean_je", "clean_tracks"),
)
SAFETY = (
    Metric("scr", "SCR: share of vehicles that collide", "share", "scr", "scr_scenes"),
    Metric("orr", "ORR: share of positions off the road", "share", "off_road", "rows"),
    Metric("footprint_orr", "footprint ORR: share of boxes over 0.3 m off", "share", "off_footprint", "rows"),
    Metric("wrong_way", "share of driving against the lane", "share", "against_lane", "moving_rows"),
    Metric("ttc_critical", "share of driving, TTC below 1.5 s to anything", "share", "ttc_critical", "moving_rows"),
    Metric(
        "leader_ttc_critical", "share of driving, TTC below 1.5 s to the leader", "share", "leader_ttc_critical",
        "moving_rows",
    ),
    Metric("short_gap", "share of following, time gap below 0.9 s", "share", "time_gap_below_0_9", "following_rows"),
)  # fmt: skip
LIMITS = tuple(
    Metric(f"limit_{name}", label, "share", f"limit_{name}", "moving_rows")
    for name, label in (
        ("acceleration", f"acceleration above {Limits().accel_max_mps2} m/s²"),
        ("braking", f"braking below {Limits().accel_min_mps2} m/s²"),
        ("lateral_acceleration", f"|lateral acceleration| above {Limits().lateral_accel_mps2} m/s²"),
        ("yaw_rate", f"|yaw rate| above {Limits().yaw_rate_radps} rad/s"),
        ("yaw_acceleration", f"|yaw acceleration| above {Limits().yaw_accel_radps2} rad/s²"),
        ("longitudinal_jerk", f"|longitudinal jerk| above {Limits().longitudinal_jerk_mps3} m/s³"),
        ("jerk", f"jerk above {Limits().jerk_mps3} m/s³"),
        ("radius", f"radius below {Limits().min_radius_m} m"),
    )
)
METRICS = (*KINEMATIC, *CLEAN, *SAFETY, *LIMITS)


class Estimate(NamedTuple):
    """A pooled ratio with its bootstrap interval; None where the denominator is 0."""

    value: float | None
    low: float | None
    high: float | None

    def as_dict(self) -> dict[str, float | None]:
        """For JSON."""
        return {"value": self.value, "low": self.low, "high": self.high}


def estimate(rows: Sequence[Row], metric: Metric, group: str, *, seed: int = 0) -> Estimate:
    """Pool a metric over scenes. The bootstrap draws source scenes: the variants of one scene are not independent."""
    numerator, denominator = sums_by_source(rows, f"{group}_{metric.numerator}", f"{group}_{metric.denominator}")
    return ratio_estimate(numerator, denominator, seed=seed)


def sums_by_source(rows: Sequence[Row], *columns: str) -> tuple[FloatArray, ...]:
    """Sums of columns over the rows of each source scene, in the order of the sources' names: (S,) each."""
    index = {source: k for k, source in enumerate(sorted({str(row["source"]) for row in rows}))}
    out = tuple(np.zeros(len(index)) for _ in columns)
    for row in rows:
        for total, column in zip(out, columns, strict=True):
            total[index[str(row["source"])]] += float(row[column])
    return out


def ratio_estimate(numerator: FloatArray, denominator: FloatArray, *, seed: int = 0) -> Estimate:
    """Ratio of sums with a percentile bootstrap over its parts."""
    if denominator.sum() <= 0:
        return Estimate(None, None, None)
    value = float(numerator.sum() / denominator.sum())
    if len(numerator) < 2:
        return Estimate(value, None, None)
    rng = np.random.default_rng(seed)
    ratios: list[FloatArray] = []
    block = max(1, _BLOCK // len(numerator))
    for start in range(0, RESAMPLES, block):
        drawn = rng.integers(0, len(numerator), size=(min(block, RESAMPLES - start), len(numerator)))
        below = denominator[drawn].sum(axis=1)
        ratios.append(numerator[drawn].sum(axis=1)[below > 0] / below[below > 0])
    low, high = np.percentile(np.concatenate(ratios), INTERVAL)
    return Estimate(value, float(low), float(high))


def table(rows: Sequence[Row], metrics: Sequence[Metric]) -> dict[str, Any]:
    """Every metric with its interval for every group, ready for JSON: table[metric.key][group]."""
    return {
        metric.key: {
            "label": metric.label,
            "unit": metric.unit,
            **{group: estimate(rows, metric, group).as_dict() for group in GROUPS},
        }
        for metric in metrics
    }


def diversity(rows: Sequence[Row], before: Sequence[Row]) -> dict[str, Any]:
    """Agents per scene and behaviours, before and after; before: source scenes, else what was recorded in each."""
    first = list(before) or list(rows)

    def counts(rows: Sequence[Row], *, after: bool, at_49: bool) -> list[int]:
        name = "_at_49" if at_49 else ""
        return [row[f"tracks{name}"] - (0 if after else row[f"generated{name}"]) for row in rows]

    def behaviours(rows: Sequence[Row], group: str) -> dict[str, Any]:
        return {
            "vehicles": {p.value: sum(row[f"{group}_policy_{p.value}"] for row in rows) for p in Policy},
            "scenes_with": {p.value: sum(row[f"{group}_policy_{p.value}"] > 0 for row in rows) for p in Policy},
            "maneuvers": {k.value: sum(row[f"{group}_seen_{k.value}"] for row in rows) for k in ManeuverKind},
            "scenes": len(rows),
        }

    density = {}
    for name, at_49 in (("tracks", False), ("tracks_at_49", True)):
        old, new = counts(first, after=False, at_49=at_49), counts(rows, after=True, at_49=at_49)
        density[name] = {
            "before": old,
            "after": new,
            "mean_before": float(np.mean(old)) if old else None,
            "mean_after": float(np.mean(new)) if new else None,
            "share_above": {str(b): {"before": _share(old, b), "after": _share(new, b)} for b in BANDS},
        }
    return {
        "density": density,
        "behaviours": {
            "before": behaviours(first, "original"),
            "generated": behaviours(rows, "generated"),
            "after": behaviours(rows, "combined"),
        },
    }


def _share(values: Sequence[int], bound: int) -> float | None:
    return sum(value > bound for value in values) / len(values) if values else None
