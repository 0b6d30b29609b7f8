"""Scenes pooled: ratios of sums for each group, with bootstrap intervals over scenes."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from bridge.evaluation.scene_metrics import GROUPS
from hid2.agents import FloatArray
from hid2.params import Limits

#: Resamples of the bootstrap.
RESAMPLES = 2000
#: Sums are kept of at most this many source scenes; of more, they are kept of this many groups of sources.
MOST_SOURCES = 1000
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
    Metric(
        "end_ttc_critical", "share of vehicles, TTC below 1 s after the last step", "share", "end_ttc_critical", "ends"
    ),
    Metric(
        "end_scenes_critical", "share of scenes with such a vehicle", "share", "end_scenes_critical", "end_scenes"
    ),
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
#: Columns of the scene rows that the metrics are made of.
COLUMNS = tuple(
    dict.fromkeys(f"{group}_{name}" for group in GROUPS for m in METRICS for name in (m.numerator, m.denominator))
)


class Estimate(NamedTuple):
    """A pooled ratio with its bootstrap interval; None where the denominator is 0."""

    value: float | None
    low: float | None
    high: float | None

    def as_dict(self) -> dict[str, float | None]:
        """For JSON."""
        return {"value": self.value, "low": self.low, "high": self.high}


class SourceSums:
    """Sums of columns over the scenes of each source scene: what a bootstrap over source scenes draws from.

    Memory does not grow with scenes, and not with source scenes beyond `most`: then the sources are pooled in `most`
    groups by a hash of their names, and groups are drawn. Totals stay exact, intervals are as good as from `most`
    scenes, and the order of the scenes does not matter.
    """

    def __init__(self, columns: Sequence[str] = COLUMNS, *, most: int = MOST_SOURCES) -> None:
        self._columns = {name: k for k, name in enumerate(columns)}
        self._most = most
        self._grouped = False
        self._sums: dict[str, FloatArray] = {}

    @classmethod
    def of(cls, rows: Iterable[Row]) -> "SourceSums":
        """Sums over scene rows."""
        sums = cls()
        for row in rows:
            sums.add(row)
        return sums

    def __len__(self) -> int:
        return len(self._sums)

    def add(self, row: Row) -> None:
        """Take a scene row in. Errors: KeyError where it lacks a column."""
        self._add(str(row["source"]), np.array([float(row[name]) for name in self._columns]))

    def of_columns(self, *columns: str) -> tuple[FloatArray, ...]:
        """Sums (S,) of each column, in the order of the sources' names. Errors: KeyError for an unknown column."""
        table = np.array([self._sums[name] for name in sorted(self._sums)]).reshape(-1, len(self._columns))
        return tuple(table[:, self._columns[name]] for name in columns)

    def _add(self, source: str, values: FloatArray) -> None:
        name = self._group_of(source) if self._grouped else source
        if name in self._sums:
            self._sums[name] = self._sums[name] + values
            return
        self._sums[name] = values
        if len(self._sums) > self._most:
            known, self._sums, self._grouped = self._sums, {}, True
            for each in sorted(known):
                self._add(each, known[each])

    def _group_of(self, source: str) -> str:
        digest = hashlib.blake2b(source.encode(), digest_size=8).digest()
        return f"{int.from_bytes(digest) % self._most:09d}"


def estimate(sums: SourceSums, metric: Metric, group: str, *, seed: int = 0) -> Estimate:
    """Pool a metric over scenes. The bootstrap draws source scenes: the variants of one scene are not independent."""
    numerator, denominator = sums.of_columns(f"{group}_{metric.numerator}", f"{group}_{metric.denominator}")
    return ratio_estimate(numerator, denominator, seed=seed)


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


def table(sums: SourceSums, metrics: Sequence[Metric]) -> dict[str, Any]:
    """Every metric with its interval for every group, ready for JSON: table[metric.key][group]."""
    return {
        metric.key: {
            "label": metric.label,
            "unit": metric.unit,
            **{group: estimate(sums, metric, group).as_dict() for group in GROUPS},
        }
        for metric in metrics
    }
