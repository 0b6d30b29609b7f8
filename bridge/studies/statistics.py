"""What the tables of a study say: rates, waiting times, acceptance curves, critical gaps, effects, with intervals.

Intervals are bootstrap intervals: runs (scene and seed) are drawn again, and scenes where there are at least three. The
same draw serves all values of what varies, because the same vehicles took part: differences are paired. Tests change
the signs of what each cluster says alone, which holds for few of them too (Canay, Romano and Shaikh 2017).
"""

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from hid2.agents import FloatArray, IntArray
from hid2.resampling import Estimate, interval, redrawn

_SCENES_LEAST, _UNITS_LEAST = 3, 3  # fewer scenes, or units at all, are not drawn again
_FEWEST = 8  # gaps of each answer, drivers: below, no curve and no critical gap is fitted
#: Coefficients beyond this say that a threshold parts the gaps without exception: no curve has an interval then.
_SEPARATED = 50.0
_SAME = 1e-9  # values that differ by less of themselves differ by rounding
#: Longer time gaps count as this, s: behind a leader that hardly moves they grow without end.
_LONG_GAP_S = 10.0


#: Columns of a gap's sizes; conditions of rules that are about one side of it.
_SIZES = ["lag_time_gap_s", "lead_time_gap_s", "lag_gap_m", "lead_gap_m"]
_CONDITIONS = {"lag": {"rear_gap", "mobil_unsafe", "rule_refuses"}, "lead": {"front_gap"}}


def gaps_of(looks: pd.DataFrame, keys: Sequence[str]) -> pd.DataFrame:
    """One row for each gap that a vehicle looked at: the same new leader and follower on the same side.

    Its size is that at which the rule first took it, else the largest while it was looked at; beside it the largest
    size that each side alone was refused at before the driver took any gap.
    """
    if looks.empty:
        return looks
    driver = ["scene", "city", "point", *keys, "seed", "replay", "vehicle"]
    same = [*driver, "side", "lead_id", "lag_id"]
    frame = looks.sort_values("time_s", kind="stable")
    frame = frame.assign(accepted=frame["rule"] == "yes", taken=frame["sumo"] == "yes")
    frame[["lead_id", "lag_id"]] = frame[["lead_id", "lag_id"]].fillna("")
    waits = ~frame.groupby(driver, dropna=False)["accepted"].cummax()
    refusals = frame["refusals"].fillna("").str.split()
    for side, conditions in _CONDITIONS.items():
        # where anything else says no too, that this side would do is never seen, and refusals alone would count
        refused = waits & refusals.map(lambda said, conditions=conditions: bool(said) and conditions.issuperset(said))
        frame[f"{side}_refused_s"] = frame[f"{side}_time_gap_s"].where(refused)
    on_the_way = frame["guard"].where(frame["sumo"].isna(), "sumo_refuses").where(~frame["taken"], "taken")
    frame["became"] = on_the_way.where(frame["accepted"], frame["rule"])
    grouped = frame.groupby(same, sort=False, dropna=False)
    found = grouped.agg(
        accepted=("accepted", "any"), taken=("taken", "any"), from_s=("time_s", "min"), to_s=("time_s", "max"),
        looks=("time_s", "size"), became=("became", "last"), trigger_s=("trigger_s", "first"),
        lag_refused_s=("lag_refused_s", "max"), lead_refused_s=("lead_refused_s", "max"),
    )  # fmt: skip
    first = frame[frame["accepted"]].drop_duplicates(same).set_index(same)
    found["accepted_s"] = first["time_s"].reindex(found.index)
    sizes = grouped[_SIZES].max().where(~found["accepted"], first[_SIZES].reindex(found.index))
    return found.join(sizes).reset_index()


def resampled(
    frame: pd.DataFrame, statistic: Callable[[FloatArray], FloatArray], *, unit: Sequence[str]
) -> tuple[FloatArray, FloatArray]:
    """A statistic (K,) of the weights of rows, and (draws, K) of it with units drawn again; none of too few units."""
    code = pd.factorize(pd.MultiIndex.from_frame(frame[list(unit)]))[0]
    count = int(code.max(initial=-1)) + 1
    whole = statistic(np.ones(len(frame)))
    if count < _UNITS_LEAST:
        return whole, np.empty((0, whole.size))
    return whole, redrawn(lambda weights: statistic(weights[code]), count)


def units(frame: pd.DataFrame) -> dict[str, list[str]]:
    """What is drawn again: runs, and scenes where there are enough."""
    found = {"runs": ["scene", "seed"]}
    if frame["scene"].nunique() >= _SCENES_LEAST:
        found["scenes"] = ["scene"]
    return found


# Waiting --------------------------------------------------------------------------------------------------------------


def kaplan_meier(waited_s: FloatArray, accepted: FloatArray, weights: FloatArray | None = None) -> Any:  # noqa: ANN401
    """Survival of the waiting time (statsmodels); given up, or cut off, is censored."""
    from statsmodels.duration.survfunc import SurvfuncRight

    # a change at the first look has waited for no time: a tenth of a step keeps it in
    return SurvfuncRight(np.maximum(waited_s, 0.01), accepted.astype(int), freq_weights=weights)


def mean_wait(waited_s: FloatArray, accepted: FloatArray, weights: FloatArray, *, within_s: float) -> float:
    """Restricted mean waiting time, s: the area below the survival curve up to within_s."""
    keep = weights > 0
    if not keep.any():
        return math.nan
    # equal rows count together: looks are a tenth of a second apart
    rows, place = np.unique(np.column_stack([waited_s[keep], accepted[keep]]), axis=0, return_inverse=True)
    curve = kaplan_meier(rows[:, 0], rows[:, 1], np.bincount(place.ravel(), weights[keep]).astype(np.float64))
    times = np.concatenate([[0.0], np.minimum(curve.surv_times, within_s), [within_s]])
    level = np.concatenate([[1.0], curve.surv_prob])
    return float((np.diff(times) * level).sum())


# Per value ------------------------------------------------------------------------------------------------------------


def _ratio(above: FloatArray, below: FloatArray, codes: IntArray, count: int) -> FloatArray:
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.bincount(codes, above, count) / np.bincount(codes, below, count)


@dataclass(frozen=True, slots=True)
class Outcome:
    """A figure of merit: its column in dose_response.csv, what it says, the table and columns that it is made of."""

    name: str
    says: str
    table: str
    above: str | None
    below: str | None = None


OUTCOMES = (
    Outcome("share_accepted", "share of the requests counted that got a gap", "requests", "accepted"),
    Outcome("share_accepted_of_looking", "the same of those that had a lane beside to look at", "requests", "accepted",
            "looked"),
    Outcome("mean_wait_s", "mean waiting time from the trigger, up to the longest allowed, s", "requests", None),
    Outcome("gaps_accepted", "share of the gaps looked at that were taken", "gaps", "accepted"),
    *(
        Outcome(f"refused_by_{name}", f"share that {words} refused of what it was asked", "requests",
                f"refused_by_{name}", f"asked_{name}")
        for name, words in (("rule", "the rule"), ("cells", "taken cells"), ("road", "the road"),
                            ("guard", "the guard"), ("sumo", "SUMO"))
    ),
    Outcome("share_overlapping", "share of the changes in which boxes meet", "requests", "overlaps"),
    Outcome("lag_drac_mps2", "mean of the largest DRAC of the new follower, m/s2", "requests", "lag_drac_mps2"),
    Outcome("lag_headway_s", "mean of the least time headway of the new follower, s", "requests", "lag_headway_s"),
    Outcome("lateral_s", "mean duration of the lateral motion, s", "requests", "lateral_s"),
    Outcome("lag_time_gap_s", "mean lag time gap taken (above 10 s: 10 s), s", "requests", "lag_time_gap_s"),
    Outcome("share_ttc_below_critical", "share of the changes with a TTC below 1.5 s", "requests", "ttc_critical"),
)  # fmt: skip


def _by_value(
    frame: pd.DataFrame,
    outcome: Outcome,
    code: IntArray,
    count: int,
    *,
    give_up_s: float,
) -> Callable[[FloatArray], FloatArray]:
    """An outcome by value (count,), as a function of the weights of the rows; code: the value's place of each row."""
    if outcome.above is None:
        waited, accepted = frame["waited_s"].to_numpy(float), frame["accepted"].to_numpy(float)
        mine = [code == place for place in range(count)]
        return lambda weight: np.array(
            [mean_wait(waited[own], accepted[own], weight[own], within_s=give_up_s) for own in mine]
        )
    above = frame[outcome.above].to_numpy(float)
    below = np.ones(len(frame)) if outcome.below is None else frame[outcome.below].to_numpy(float)
    known = np.isfinite(above)
    return lambda weight: _ratio((above * weight)[known], (below * weight)[known], code[known], count)


def dose_response(
    requests: pd.DataFrame, gaps: pd.DataFrame, key: str, *, give_up_s: float, critical_ttc_s: float
) -> pd.DataFrame:
    """For each value of a parameter each outcome with its intervals, and its difference to the first value, paired."""
    counted = requests[requests["counted"]].copy()
    started = counted["start_s"].notna()
    counted["ttc_critical"] = np.where(started, (counted["min_ttc_s"] < critical_ttc_s).astype(float), np.nan)
    counted["lag_time_gap_s"] = counted["lag_time_gap_s"].clip(upper=_LONG_GAP_S)
    counted["looked"] = (counted["looks"] > 0).astype(float)
    frames = {"requests": counted, "gaps": gaps}
    rows: list[dict[str, Any]] = []
    for outcome in OUTCOMES:
        frame = frames[outcome.table]
        if frame.empty:
            continue
        values, code = np.unique(frame[key].to_numpy(), return_inverse=True)
        statistic = _by_value(frame, outcome, code, len(values), give_up_s=give_up_s)
        own: list[dict[str, Any]] = [
            {"parameter": key, "value": value, "outcome": outcome.name, "rows": int((code == place).sum())}
            for place, value in enumerate(values.tolist())
        ]
        clusters = pd.factorize(pd.MultiIndex.from_frame(frame[[*units(frame).values()][-1]]))[0]
        alone = np.array([statistic((clusters == one).astype(np.float64)) for one in range(clusters.max() + 1)])
        for unit, columns in units(frame).items():
            whole, draws = resampled(frame, statistic, unit=columns)
            if unit == "runs" and pd.api.types.is_numeric_dtype(values):
                trend = _trend(values.astype(np.float64), whole, draws, alone)
                for row in own:
                    row |= trend
            for place, row in enumerate(own):
                row["estimate"], *row_interval = interval(whole[place], draws[:, place])
                row[f"low_{unit}"], row[f"high_{unit}"] = row_interval
                row["difference"], *apart = interval(whole[place] - whole[0], draws[:, place] - draws[:, 0])
                row[f"difference_low_{unit}"], row[f"difference_high_{unit}"] = apart
        rows += own
    return _adjusted(pd.DataFrame(rows))


def _slopes(values: FloatArray, outcomes: FloatArray) -> FloatArray:
    """Slope (N,) of outcomes (N, K) over the K values, least squares, of those that are known; NaN below two."""
    y = np.ma.masked_invalid(outcomes)
    x = np.ma.array(np.broadcast_to(values, outcomes.shape), mask=np.ma.getmaskarray(y))
    away = x - x.mean(axis=1)[:, None]
    return np.ma.filled((away * y).sum(axis=1) / (away * away).sum(axis=1), np.nan)


def _trend(values: FloatArray, whole: FloatArray, draws: FloatArray, alone: FloatArray) -> dict[str, Any]:
    """Slope of an outcome over all values of a parameter, with interval by draws and p by clusters alone (C, K)."""
    slope, slopes = float(_slopes(values, whole[None])[0]), _slopes(values, alone)
    found = interval(slope, _slopes(values, draws))
    if found.value is None:
        return {}
    told = {"trend": found.value, "trend_low": found.low, "trend_high": found.high}
    return told | {"p": few_clusters_p(slopes), "clusters": int(np.isfinite(slopes).sum())}


def few_clusters_p(effects: FloatArray) -> float | None:
    """Two-sided p of no effect, from the effects of independent clusters: exact by changing signs, up to 9,999 draws.

    No assumption but that without an effect each cluster's is as likely of either sign: k clusters give 2 / 2^k at
    least. None of fewer than two.
    """
    from scipy.stats import permutation_test

    known = effects[np.isfinite(effects)]
    if known.size < _UNITS_LEAST - 1:
        return None
    if (np.abs(known) <= _SAME).all():
        return 1.0
    found = permutation_test(
        (known,), lambda x, axis: x.mean(axis=axis), permutation_type="samples", vectorized=True, n_resamples=9999,
        rng=np.random.default_rng(0),
    )  # fmt: skip
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
    by_run = counted.groupby(["scene", "seed", key])["accepted"].mean().unstack(key)
    apart = (by_run.iloc[:, -1] - by_run.iloc[:, 0]).dropna() if by_run.shape[1] > 1 else pd.Series(dtype=float)
    return (float(apart.std()), len(apart)) if len(apart) >= _UNITS_LEAST else None


def _adjusted(table: pd.DataFrame) -> pd.DataFrame:
    """The same with p adjusted for the family of all outcomes of the parameter that vary at all (Holm)."""
    from statsmodels.stats.multitest import multipletests

    varies = table.groupby("outcome")["estimate"].transform("nunique") > 1
    if "p" not in table or table.loc[varies, "p"].isna().all():
        return table
    each = table[varies].dropna(subset="p").drop_duplicates("outcome").set_index("outcome")["p"]
    adjusted = dict(zip(each.index, multipletests(each, method="holm")[1], strict=True))
    return table.assign(p_holm=table["outcome"].map(adjusted))


# Acceptance and critical gaps -----------------------------------------------------------------------------------------


def acceptance_curve(gaps: pd.DataFrame) -> dict[str, Any] | None:
    """Logistic P(accepted | lag time gap, lead time gap) with standard errors clustered by run; None if not to be told.

    A gap without a leader counts as one of the largest lead time gap seen; gaps without a follower are left out.
    Returns a row of acceptance.csv, with the covariance (3, 3): intercept, lag (with its 95 % interval), lead, lead_s
    (median, at which curves are drawn); or why there is no curve (separated).
    """
    import statsmodels.api as sm

    frame = gaps[gaps["lag_time_gap_s"].notna()].copy()
    accepted = frame["accepted"].to_numpy(float)
    if accepted.sum() < _FEWEST or (1.0 - accepted).sum() < _FEWEST:
        return None
    frame["lead_time_gap_s"] = frame["lead_time_gap_s"].fillna(frame["lead_time_gap_s"].max())
    if frame["lead_time_gap_s"].isna().any():
        return None
    design = np.column_stack(
        [np.ones(len(frame)), frame["lag_time_gap_s"], frame["lead_time_gap_s"].clip(upper=_LONG_GAP_S)]
    )
    design[:, 1] = np.minimum(design[:, 1], _LONG_GAP_S)
    runs = pd.factorize(pd.MultiIndex.from_frame(frame[["scene", "seed"]]))[0]
    many = len(np.unique(runs)) > len(design[0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a separated sample is told by its coefficients below
        model = sm.GLM(accepted, design, family=sm.families.Binomial())
        try:
            fit = model.fit(cov_type="cluster", cov_kwds={"groups": runs}) if many else model.fit()
        except Exception as error:  # noqa: BLE001  # statsmodels has no class for a separated sample
            return {"separated": str(error)}
    if not np.isfinite(fit.params).all() or np.abs(fit.params).max() > _SEPARATED:
        return {"separated": "a threshold parts the gaps"}
    intercept, lag, lead = map(float, fit.params)
    covariance = np.asarray(fit.cov_params())
    apart = 1.96 * float(covariance[1, 1]) ** 0.5
    return {
        "intercept": intercept, "lag": lag, "lead": lead, "lead_s": float(np.median(design[:, 2])),
        "gaps": len(frame), "accepted": int(accepted.sum()), "lag_low": lag - apart, "lag_high": lag + apart,
        "separated": None, "covariance": covariance,
    }  # fmt: skip


def curve_at(curve: dict[str, Any], lag_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Probability (K,) of acceptance by lag time gap at the median lead time gap, with its 95 % band."""
    from scipy.special import expit

    x = np.column_stack([np.ones(lag_s.size), lag_s, np.full(lag_s.size, curve["lead_s"])])
    level = x @ np.array([curve["intercept"], curve["lag"], curve["lead"]])
    error = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", x, curve["covariance"], x), 0.0))
    return expit(level), expit(level - 1.96 * error), expit(level + 1.96 * error)


@dataclass(frozen=True, slots=True)
class CriticalGap:
    """Critical time gap of a group of drivers on one side of a gap, s. mean and sd: lognormal, by maximum likelihood.

    raff: Raff's.
    """

    mean: Estimate
    sd: Estimate
    raff: float | None
    drivers: int
    inconsistent: int


def largest_rejected(gaps: pd.DataFrame, side: str) -> tuple[FloatArray, FloatArray, int]:
    """Largest time gap refused for this side and that taken, s, of each driver that looked; how many were left out.

    A gap that was refused for anything but this side of it is no refusal of it. inf: it took none, or one without a
    vehicle on this side; where it refused none either it tells nothing. A driver that refused a larger one than it took
    is left out: its rule asks for something else, too.
    """
    driver = ["scene", "point", "seed", "vehicle"]
    first = gaps[gaps["accepted"]].sort_values("accepted_s", kind="stable").drop_duplicates(driver).set_index(driver)
    rejected = gaps.groupby(driver)[f"{side}_refused_s"].max().astype(float).fillna(0.0)
    r = rejected.to_numpy(float)
    a = first[f"{side}_time_gap_s"].reindex(rejected.index).fillna(np.inf).to_numpy(float)
    tells, consistent = np.isfinite(a) | (r > 0.0), (a > r) & (a > 0.0)
    return r[tells & consistent], a[tells & consistent], int((tells & ~consistent).sum())


def troutbeck(rejected_s: FloatArray, accepted_s: FloatArray) -> tuple[Estimate, Estimate]:
    """Mean and SD of a lognormal critical gap, s, by maximum likelihood (Troutbeck 1992).

    From each driver's largest rejected and accepted gap, inf where it took none: those that wait longest have the
    largest critical gaps. Intervals: draws from the inverse information.
    """
    from scipy.optimize import minimize
    from scipy.stats import norm
    from statsmodels.tools.numdiff import approx_hess

    log_a = np.log(accepted_s)
    log_r = np.where(rejected_s > 0.0, np.log(np.maximum(rejected_s, 1e-9)), -np.inf)

    def loss(p: FloatArray) -> float:
        sd = math.exp(p[1])
        share = norm.cdf((log_a - p[0]) / sd) - norm.cdf((log_r - p[0]) / sd)
        return -float(np.log(np.maximum(share, 1e-300)).sum())

    above_s = np.where(np.isfinite(accepted_s), accepted_s, 2.0 * rejected_s)
    middle = np.log(np.where(rejected_s > 0.0, np.sqrt(np.maximum(rejected_s, 1e-9) * above_s), 0.7 * above_s))
    start = np.array([float(middle.mean()), math.log(max(float(middle.std()), 0.1))])
    best = minimize(loss, start, method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-8, "maxiter": 4000}).x
    hessian = approx_hess(best, loss, epsilon=1e-3)

    def moments(p: FloatArray) -> tuple[FloatArray, FloatArray]:
        variance = np.exp(2.0 * p[..., 1])
        mean = np.exp(p[..., 0] + 0.5 * variance)
        return mean, mean * np.sqrt(np.expm1(variance))

    mean, sd = moments(best)
    try:
        covariance = np.linalg.inv(hessian)
        np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:  # the likelihood is flat: no interval
        return Estimate(float(mean)), Estimate(float(sd))
    drawn = moments(np.random.default_rng(0).multivariate_normal(best, covariance, size=4000))
    return interval(float(mean), drawn[0]), interval(float(sd), drawn[1])


def raff(rejected_s: FloatArray, accepted_s: FloatArray) -> float | None:
    """Raff's critical gap, s: as many accepted gaps are shorter as rejected ones are longer."""
    rejected = rejected_s[rejected_s > 0.0]
    if rejected.size == 0 or accepted_s.size == 0:
        return None
    at = np.unique(np.concatenate([rejected, accepted_s]))
    shorter = np.searchsorted(np.sort(accepted_s), at, side="right") / accepted_s.size
    longer = 1.0 - np.searchsorted(np.sort(rejected), at, side="right") / rejected.size
    crossed = np.flatnonzero(shorter >= longer)
    return float(at[crossed[0]]) if crossed.size else None


def critical_gap(gaps: pd.DataFrame, side: str) -> CriticalGap | None:
    """Critical time gap of the drivers in a table of gaps on one side, lag or lead; None where too few took one."""
    rejected, accepted, inconsistent = largest_rejected(gaps, side)
    taken = accepted[np.isfinite(accepted)]
    if taken.size < _FEWEST or (rejected > 0).sum() < _FEWEST // 2:
        return None
    refused = gaps[f"{side}_refused_s"].dropna().to_numpy(float)
    if rejected.max() < taken.min():  # one gap parts all drivers: anything between the two is as likely
        between = Estimate(float(0.5 * (rejected.max() + taken.min())), float(rejected.max()), float(taken.min()))
        return CriticalGap(between, Estimate(0.0), raff(refused, taken), accepted.size, inconsistent)
    mean, sd = troutbeck(rejected, accepted)
    return CriticalGap(mean, sd, raff(refused, taken), accepted.size, inconsistent)


# Effects --------------------------------------------------------------------------------------------------------------


def effects(requests: pd.DataFrame, keys: Sequence[str], *, give_up_s: float) -> pd.DataFrame:
    """Effect of each numeric parameter on each outcome, over the whole design.

    Standardised regression coefficient with its interval, and the first-order variance-based index (SALib, RBD-FAST)
    with its own where there are enough points.
    """
    counted = requests[requests["counted"]].copy()
    counted["lag_time_gap_s"] = counted["lag_time_gap_s"].clip(upper=_LONG_GAP_S)
    counted["waited_or_end_s"] = np.minimum(counted["waited_s"], give_up_s)
    numeric = [key for key in keys if pd.api.types.is_numeric_dtype(counted[key])]
    rows: list[dict[str, Any]] = []
    if not numeric:
        return pd.DataFrame(rows)
    for outcome in ("accepted", "waited_or_end_s", "lateral_s", "lag_time_gap_s", "min_ttc_s"):
        frame = counted[counted[outcome].notna()]
        if len(frame) < 10 * len(numeric):
            continue

        statistic = _standardised(frame[numeric].to_numpy(float), frame[outcome].to_numpy(float))
        sensitivity = _first_order(frame, numeric, outcome)
        for unit, columns in units(frame).items():
            whole, draws = resampled(frame, statistic, unit=columns)
            for number, key in enumerate(numeric):
                found = interval(whole[number], draws[:, number])
                rows.append(
                    {
                        "outcome": outcome, "parameter": key, "drawn_again": unit, "rows": len(frame),
                        "standardised_coefficient": found.value, "low": found.low, "high": found.high,
                        **(sensitivity.get(key, {"first_order": None, "first_order_interval": None})),
                    }
                )  # fmt: skip
    return pd.DataFrame(rows)


def _standardised(x: FloatArray, y: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Standardised coefficients (K,) of a linear regression of y (N,) on x (N, K), as a function of weights."""

    def statistic(weight: FloatArray) -> FloatArray:
        share = weight / weight.sum()
        xc, yc = x - share @ x, y - share @ y
        covariance = (xc * share[:, None]).T @ xc
        spread = np.sqrt(np.diag(covariance)), math.sqrt(float(share @ (yc * yc)))
        if (
            spread[1] <= _SAME * np.abs(y).max()
            or not spread[0].all()
            or np.linalg.matrix_rank(covariance) < x.shape[1]
        ):
            return np.full(x.shape[1], np.nan)
        return np.asarray(np.linalg.solve(covariance, (xc * share[:, None]).T @ yc) * spread[0] / spread[1])

    return statistic


def _first_order(frame: pd.DataFrame, keys: Sequence[str], outcome: str) -> dict[str, dict[str, float]]:
    """First-order index of each parameter on the mean outcome of each point of the design; RBD-FAST asks for many."""
    means = frame.groupby("point")[[*keys, outcome]].mean()
    if len(keys) < 2 or len(means) < _POINTS_LEAST or means[outcome].std() == 0.0:
        return {}
    from SALib.analyze import rbd_fast

    bounds = [[float(means[key].min()), float(means[key].max())] for key in keys]
    problem = {"num_vars": len(keys), "names": list(keys), "bounds": bounds}
    found = rbd_fast.analyze(problem, means[list(keys)].to_numpy(float), means[outcome].to_numpy(float), seed=0)
    return {
        key: {"first_order": float(found["S1"][row]), "first_order_interval": float(found["S1_conf"][row])}
        for row, key in enumerate(keys)
    }


#: RBD-FAST with its ten harmonics needs more points than twice as many.
_POINTS_LEAST = 40
