"""How far generated motion is from recorded motion: distances of distributions, and their tails on both sides.

Motion is that of fits over 4 s (`windows.py`), so that tracker noise does not decide. Bins resolve what drivers do
(acceleration 0.25 m/s2); those of the Waymo sim-agents challenge, 2.2 m/s2 wide, do not, and this is no Waymo score.
Every distance stands beside its floor: the distance between two halves of the recorded tracks.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial.distance import jensenshannon

from hid2.agents import FloatArray, IntArray
from hid2.evaluation.safety import Safety
from hid2.evaluation.windows import SPLITS, Windows, compared, half_numbers, lateral_accel_mps2
from hid2.measures.arrays import SceneArrays
from hid2.measures.manoeuvres import Maneuver, whole_lane_changes
from hid2.measures.surrogates import CAP_S


class HistogramFeature(NamedTuple):
    """One quantity with the range and number of bins of its histogram; values outside count in the end bins."""

    name: str
    label: str
    unit: str
    low: float
    high: float
    bins: int


FEATURES = (
    HistogramFeature("speed", "speed", "m/s", 0.0, 25.0, 25),
    HistogramFeature("longitudinal_accel", "longitudinal acceleration", "m/s²", -5.0, 5.0, 40),
    HistogramFeature("jerk", "longitudinal jerk", "m/s³", -4.0, 4.0, 32),
    HistogramFeature("lateral_accel", "lateral acceleration outside turns", "m/s²", -4.0, 4.0, 32),
    HistogramFeature("yaw_rate", "yaw rate outside turns", "rad/s", -0.64, 0.64, 32),
    HistogramFeature("turn_lateral_accel", "lateral acceleration in turns", "m/s²", -4.0, 4.0, 32),
    HistogramFeature("offset", "offset from the lane's middle", "m", -2.0, 2.0, 32),
    HistogramFeature("ttc", "time to collision", "s", 0.0, CAP_S, 10),
    HistogramFeature("time_gap", "time gap to the leader", "s", 0.0, 5.0, 10),
    HistogramFeature("pet", "post-encroachment time", "s", 0.0, CAP_S, 10),
    HistogramFeature("lane_change_duration", "lane-change duration", "s", 0.0, 10.0, 10),
)
#: Quantities of which the tails are compared, on both sides: too cautious is as wrong as too bold.
TAILS = ("ttc", "pet", "time_gap", "longitudinal_accel")
#: Shares at which quantiles are compared.
TAIL_SHARES = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99)
#: Fine bins within each bin: Wasserstein distances are exact to a fine bin.
FINE = 40

#: First fine bin of each feature, and last the number of all fine bins: histograms lie one after the other.
_FIRST = np.cumsum([0, *(feature.bins * FINE for feature in FEATURES)]).tolist()
#: Rows of `RealismCounts.counts`; behind them those of the halves.
GENERATED, RECORDED = 0, 1


def histogram(feature: HistogramFeature, values: npt.ArrayLike) -> IntArray:
    """(bins * FINE,) counts of the values, those outside the range in the end bins."""
    share = (np.asarray(values, dtype=np.float64) - feature.low) / (feature.high - feature.low)
    last = feature.bins * FINE - 1
    place = np.clip((share * feature.bins * FINE).astype(np.int64), 0, last)
    return np.asarray(np.bincount(place, minlength=last + 1), dtype=np.int64)


def apart(feature: HistogramFeature, first: IntArray, second: IntArray) -> tuple[float, float] | None:
    """Distances of two histograms; None without samples.

    Jensen-Shannon (root of the divergence, base 2: 0 to 1), over the bins; Wasserstein-1 in the feature's unit, within
    its range.
    """
    if not first.any() or not second.any():
        return None
    p, q = (counts.reshape(feature.bins, FINE).sum(axis=1) for counts in (first, second))
    with np.errstate(invalid="ignore"):  # where rounding says less than 0
        diverging = float(np.nan_to_num(jensenshannon(p, q, base=2)))
    moved = np.cumsum(first) / first.sum() - np.cumsum(second) / second.sum()
    width = (feature.high - feature.low) / (feature.bins * FINE)
    return diverging, float(np.abs(moved).sum() * width)


class Distance(NamedTuple):
    """Distance of generated from recorded motion in a feature, and the floor; None where samples lack."""

    feature: str
    unit: str
    jensen_shannon: float | None
    jensen_shannon_floor: float | None
    jensen_shannon_ratio: float | None
    wasserstein: float | None
    wasserstein_floor: float | None
    generated_samples: int
    recorded_samples: int


@dataclass(eq=False, slots=True)
class RealismCounts:
    """Histograms of any number of scenes: all that the distances need, in constant memory.

    counts (2 + SPLITS, fine bins of all features): of generated vehicles, of recorded ones, and of the recorded ones in
    one half of each split; a track is in the same half in every copy of its scene.
    """

    counts: IntArray = field(default_factory=lambda: np.zeros((2 + SPLITS, _FIRST[-1]), dtype=np.int64))

    def of(self, feature: HistogramFeature) -> IntArray:
        """(2 + SPLITS, bins * FINE) of one feature."""
        number = FEATURES.index(feature)
        return self.counts[:, _FIRST[number] : _FIRST[number + 1]]

    def add(self, other: "RealismCounts", *, generated: bool = True, recorded: bool = True) -> None:
        """Take the samples of another batch in, or those of one kind of vehicle."""
        self.counts[:RECORDED] += generated * other.counts[:RECORDED]
        self.counts[RECORDED:] += recorded * other.counts[RECORDED:]

    def distances(self) -> list[Distance]:
        """Distance and floor for each feature."""
        every = []
        for feature in FEATURES:
            generated, recorded, *halves = self.of(feature)
            known = [pair for half in halves if (pair := apart(feature, half, recorded - half)) is not None]
            floor, way_floor = np.median(known, axis=0).tolist() if known else (None, None)
            js, way = apart(feature, generated, recorded) or (None, None)
            over = js / floor if js is not None and floor else None
            samples = int(generated.sum()), int(recorded.sum())
            every.append(Distance(feature.name, feature.unit, js, floor, over, way, way_floor, *samples))
        return every


def count_scene(
    arrays: SceneArrays, safe: Safety, found: Windows, maneuvers: Sequence[Maneuver], *, scene: str
) -> RealismCounts:
    """Histograms of the vehicles of one scene that are `compared`. scene: the name of the recorded scene."""
    vehicles = compared(arrays)
    member = np.zeros((2 + SPLITS, arrays.num_agents), dtype=np.bool_)  # which agents each row of counts is of
    member[GENERATED], member[RECORDED] = vehicles & arrays.generated, vehicles & ~arrays.generated
    member[2:] = half_numbers(scene, arrays.track_ids) >> np.arange(SPLITS)[:, None] & 1
    member[2:] &= member[RECORDED]
    counted, values = RealismCounts(), _values(arrays, safe, found, maneuvers)
    for feature in FEATURES:
        value, owner = values[feature.name]
        for counts, inside in zip(counted.of(feature), member[:, owner], strict=True):
            counts[:] = histogram(feature, value[inside])
    return counted


def _values(
    arrays: SceneArrays, safe: Safety, found: Windows, maneuvers: Sequence[Maneuver]
) -> dict[str, tuple[FloatArray, IntArray]]:
    """Values (V,) of every feature in a scene, and the agent of each.

    Motion and place in the lane at the middles of windows; TTC and time gap at every step where they are defined; a
    crossing counts for its generated vehicle, else for the first; durations are those of lane changes seen whole.
    """
    motion = {"speed": "speed_mps", "longitudinal_accel": "accel_mps2", "jerk": "jerk_mps3", "offset": "offset_m"}
    out = {name: (found[column], found["agent"]) for name, column in motion.items()}
    # as many turns as were asked for are no measure of how they are driven: apart
    straight, turns = found[~found["turning"]], found[found["turning"]]
    out["lateral_accel"] = (lateral_accel_mps2(straight), straight["agent"])
    out["yaw_rate"] = (straight["yaw_radps"], straight["agent"])
    out["turn_lateral_accel"] = (lateral_accel_mps2(turns), turns["agent"])
    for name, value in (("ttc", safe.ttc_s), ("time_gap", safe.leaders.time_gap_s)):
        # boxes that overlap already tell of a tracker, not of a driver
        defined = np.isfinite(value) & (value > 0.0) & ((value < CAP_S) | (name != "ttc"))
        out[name] = (value[defined], arrays.agent[defined])
    crossings = [(one.pet_s, one.second if arrays.generated[one.second] else one.first) for one in safe.encroachments]
    changes = [(one.duration_s, arrays.track_ids.index(one.track_id)) for one in whole_lane_changes(maneuvers)]
    for name, pairs in (("pet", crossings), ("lane_change_duration", changes)):
        values, agents = np.array(pairs, dtype=np.float64).reshape(-1, 2).T
        out[name] = values, agents.astype(np.int64)
    return out


def quantiles(feature: HistogramFeature, counts: IntArray, shares: Sequence[float]) -> list[float] | None:
    """Quantiles, to a fine bin, of a histogram; None without samples."""
    total = int(counts.sum())
    if not total:
        return None
    width = (feature.high - feature.low) / (feature.bins * FINE)
    place = np.searchsorted(np.cumsum(counts), np.asarray(shares) * total, side="left")
    return [float(feature.low + (k + 0.5) * width) for k in place]
