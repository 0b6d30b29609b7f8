"""What the tables of a study say: rates, waiting times, trends, with intervals.

Intervals are bootstrap intervals: runs (scene and seed) are drawn again, and scenes where there are at least three. The
same draw serves all values of what varies, because the same vehicles took part: differences are paired. Tests change
the signs of what each cluster says alone, which holds for few of them too (Canay, Romano and Shaikh 2017).
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pandas as pd

from bridge.studies.columns import AT_LAST, OUTCOMES, Merit
from hid2.agents import FloatArray, IntArray
from hid2.resampling import UNITS_LEAST, Estimate, interval, redrawn

_SAME = 1e-9  # size of differences, and their SD, up to which they are rounding
#: Cap of time gaps, s: behind a leader that hardly moves they grow without end.
LONG_GAP_S = 10.0


def resampled(
    frame: pd.DataFrame, statistic: Callable[[FloatArray], FloatArray], *, unit: Sequence[str]
) -> tuple[FloatArray, FloatArray]:
    """A statistic (K,) of the weights of rows, and (draws, K) of it with units drawn again; none of too few units."""
    code = pd.factorize(pd.MultiIndex.from_frame(frame[list(unit)]))[0]
    count, whole = int(code.max(initial=-1)) + 1, statistic(np.ones(len(frame)))
    if count < UNITS_LEAST:
        return whole, np.empty((0, whole.size))
    return whole, redrawn(lambda weights: statistic(weights[code]), count)


def estimates(
    frame: pd.DataFrame, statistic: Callable[[FloatArray], FloatArray], *, unit: Sequence[str]
) -> list[Estimate]:
    """A statistic (K,) of the weights of rows, with intervals by drawing units again."""
    whole, draws = resampled(frame, statistic, unit=unit)
    return [interval(float(one), drawn) for one, drawn in zip(whole, draws.T, strict=True)]


def units(frame: pd.DataFrame) -> dict[str, list[str]]:
    """What is drawn again: runs, and scenes where there are enough."""
    return {"runs": ["scene", "seed"]} | ({"scenes": ["scene"]} if frame["scene"].nunique() >= UNITS_LEAST else {})


# Waiting --------------------------------------------------------------------------------------------------------------


def kaplan_meier(waited_s: FloatArray, accepted: FloatArray, weights: FloatArray | None = None) -> Any:  # noqa: ANN401
    """Survival of the waiting time (statsmodels); given up, or cut off, is censored."""
    from statsmodels.duration.survfunc import SurvfuncRight

    # a change at the first look has waited for no time: a tenth of a step keeps it in
    return SurvfuncRight(np.maximum(waited_s, 0.01), accepted.astype(int), freq_weights=weights)


def mean_wait(waited_s: FloatArray, accepted: FloatArray, weights: FloatArray, *, within_s: float) -> float:
    """Restricted mean waiting time, s: the area below the survival curve up to within_s."""
    keep = weights > 0
    if within_s <= 0.0 or not keep.any():
        return math.nan
    # equal rows count together: looks are a tenth of a second apart
    rows, place = np.unique(np.column_stack([waited_s[keep], accepted[keep]]), axis=0, return_inverse=True)
    curve = kaplan_meier(rows[:, 0], rows[:, 1], np.bincount(place.ravel(), weights[keep]).astype(np.float64))
    times = np.concatenate([[0.0], np.minimum(curve.surv_times, within_s), [within_s]])
    return float((np.diff(times) * np.concatenate([[1.0], curve.surv_prob])).sum())


def observed_s(requests: pd.DataFrame, key: str, *, give_up_s: float) -> float:
    """The shortest time that waiting was observed for at every value of a parameter, s; give_up_s at most.

    At a value at which the one that waited longest accepted, all is known.
    """
    longest = requests.groupby([key, requests["accepted"].astype(bool)])["waited_s"].max().unstack()
    censored_s, accepted_s = (longest.get(accepted, pd.Series(np.nan, longest.index)) for accepted in (False, True))
    return float(np.nanmin([give_up_s, censored_s.mask(censored_s < accepted_s).min()]))


# Per value ------------------------------------------------------------------------------------------------------------


def _by_value(
    frame: pd.DataFrame, outcome: Merit, code: IntArray, count: int, *, within_s: float
) -> Callable[[FloatArray], FloatArray]:
    """An outcome by value (count,), as a function of the weights of the rows; code: the value's place of each row."""
    if outcome.above is None:
        waited, accepted = frame["waited_s"].to_numpy(float), frame["accepted"].to_numpy(float)
        mine = [code == place for place in range(count)]
        return lambda weight: np.array(
            [mean_wait(waited[own], accepted[own], weight[own], within_s=within_s) for own in mine]
        )
    above = frame[outcome.above].to_numpy(float)
    below = np.ones(len(frame)) if outcome.below is None else frame[outcome.below].to_numpy(float)
    known = np.isfinite(above)

    def ratio(weight: FloatArray) -> FloatArray:
        sums = (np.bincount(code[known], (part * weight)[known], count) for part in (above, below))
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.divide(*sums))

    return ratio


def in_order(requests: pd.DataFrame, key: str) -> list[Any]:
    """Values of a parameter: numbers by their size, names as the study has them."""
    return requests.sort_values(key if pd.api.types.is_numeric_dtype(requests[key]) else "point")[key].unique().tolist()


def dose_response(
    requests: pd.DataFrame, gaps: pd.DataFrame, key: str, *, give_up_s: float, critical_ttc_s: float
) -> pd.DataFrame:
    """For each value of a parameter each outcome with its intervals, and its difference to the first one, paired.

    give_up_s: the longest wait that every value allows.
    """
    counted = requests[requests["counted"]].copy()
    started = counted["start_s"].notna()
    counted["ttc_critical"] = np.where(started, (counted["min_ttc_s"] < critical_ttc_s).astype(float), np.nan)
    counted["lag_time_gap_s"] = counted["lag_time_gap_s"].clip(upper=LONG_GAP_S)
    if not gaps.empty:
        gaps = gaps.assign(**{f"refused_by_{name}": (gaps["refused_by"] == name).astype(float) for name in AT_LAST})
    frames = {"requests": counted, "gaps": gaps}
    within_s = observed_s(counted, key, give_up_s=give_up_s)
    rows: list[dict[str, Any]] = []
    for outcome in OUTCOMES:
        frame = frames[outcome.table]
        if frame.empty:
            continue
        values = [value for value in in_order(requests, key) if (frame[key] == value).any()]
        code = frame[key].map({value: place for place, value in enumerate(values)}).to_numpy()
        statistic = _by_value(frame, outcome, code, len(values), within_s=within_s)
        of = (frame[outcome.above or "vehicle"].notna() & frame[outcome.below or "vehicle"].ne(0.0)).to_numpy()
        clusters = pd.factorize(pd.MultiIndex.from_frame(frame[[*units(frame).values()][-1]]))[0]
        alone = np.array([statistic((clusters == one).astype(np.float64)) for one in range(clusters.max() + 1)])
        same = {"parameter": key, "outcome": outcome.name, "clusters": int((np.isfinite(alone).sum(axis=1) > 1).sum())}
        within = {"within_s": within_s} if outcome.above is None else {}
        own: list[dict[str, Any]] = [
            {**same, "value": value, "rows": int((of & (code == place)).sum()), **within}
            for place, value in enumerate(values)
        ]
        for unit, columns in units(frame).items():
            whole, draws = resampled(frame, statistic, unit=columns)
            if unit == "runs" and not isinstance(values[0], str):
                whole_slope, slopes, apart = (_slopes(values, part) for part in (whole[None], draws, alone))
                trend, low, high = interval(float(whole_slope[0]), slopes)
                if trend is not None:
                    told = {"trend": trend, "trend_low": low, "trend_high": high, "p": few_clusters_p(apart)}
                    own = [row | told for row in own]
            for place, row in enumerate(own):
                row["estimate"], row[f"low_{unit}"], row[f"high_{unit}"] = interval(whole[place], draws[:, place])
                row["difference"], *ends = interval(whole[place] - whole[0], draws[:, place] - draws[:, 0])
                row[f"difference_low_{unit}"], row[f"difference_high_{unit}"] = ends
        rows += own
    return _adjusted(pd.DataFrame(rows))


def _slopes(values: Sequence[float], outcomes: FloatArray) -> FloatArray:
    """Slope (N,) of outcomes (N, K) over the K values, least squares, of those known; NaN below two, 0 if all equal."""
    y = np.ma.masked_invalid(outcomes)
    x = np.ma.array(np.broadcast_to(np.array(values, dtype=np.float64), outcomes.shape), mask=np.ma.getmaskarray(y))
    away = x - x.mean(axis=1)[:, None]
    return np.ma.filled((away * (y - y.min(axis=1)[:, None])).sum(axis=1) / (away * away).sum(axis=1), np.nan)


def few_clusters_p(effects: FloatArray) -> float | None:
    """Two-sided p of no effect, from the effects of independent clusters: exact by changing signs, up to 9,999 draws.

    No assumption but that without an effect each cluster's is as likely of either sign: k clusters give 2 / 2^k at
    least. None of fewer than two.
    """
    from scipy.stats import permutation_test

    known = effects[np.isfinite(effects)]
    if known.size < UNITS_LEAST - 1:
        return None
    if (np.abs(known) <= _SAME).all():
        return 1.0
    found = permutation_test(
        (known,), np.mean, permutation_type="samples", vectorized=True, n_resamples=9999, rng=np.random.default_rng(0)
    )
    return float(found.pvalue)


def seeds_needed(sd: float, difference: float) -> int:
    """Runs at each value that tell a difference, by a t test of paired differences of runs with this SD.

    Two-sided level .05, power .8 (statsmodels).
    """
    from statsmodels.stats.power import TTestPower

    if sd <= _SAME:
        return 2
    if difference > 5.0 * sd:  # beyond what the solver can tell: the fewest runs that have a spread
        return 3
    return math.ceil(float(TTestPower().solve_power(effect_size=difference / sd, alpha=0.05, power=0.8)))


def difference_sd(requests: pd.DataFrame, key: str) -> tuple[float, int] | None:
    """SD over runs of a run's difference in the share accepted between a parameter's ends, and the runs; or None."""
    counted = requests[requests["counted"]]
    by_run = counted.groupby(["scene", "seed", key])["accepted"].mean().unstack(key)[in_order(counted, key)]
    apart = (by_run.iloc[:, -1] - by_run.iloc[:, 0]).dropna() if by_run.shape[1] > 1 else pd.Series(dtype=float)
    return (float(apart.std()), len(apart)) if len(apart) >= UNITS_LEAST else None


def _adjusted(table: pd.DataFrame) -> pd.DataFrame:
    """The same with p adjusted for all outcomes that vary at all (Holm), but the first, which a study is for."""
    from statsmodels.stats.multitest import multipletests

    varies = table.groupby("outcome")["estimate"].transform("nunique") > 1
    varies &= table["outcome"] != OUTCOMES[0].name
    if "p" not in table or table.loc[varies, "p"].isna().all():
        return table
    each = table[varies].dropna(subset="p").drop_duplicates("outcome").set_index("outcome")["p"]
    adjusted = dict(zip(each.index, multipletests(each, method="holm")[1], strict=True))
    return table.assign(p_holm=table["outcome"].map(adjusted))
