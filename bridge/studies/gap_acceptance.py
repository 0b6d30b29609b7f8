"""Gaps that vehicles of a study looked at: one row each, and critical gaps."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from hid2.agents import FloatArray
from hid2.resampling import Estimate, interval

_FEWEST = 8  # least number of drivers for which a critical gap is fitted
#: Columns of a gap's sizes; conditions of rules that are about one side of it.
_SIZES = ["lag_time_gap_s", "lead_time_gap_s"]
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
    frame = looks.sort_values("time_s", kind="stable").astype(dict.fromkeys(_SIZES, float))
    frame = frame.assign(accepted=frame["rule"] == "yes", taken=frame["sumo"] == "yes")
    frame[["lead_id", "lag_id"]] = frame[["lead_id", "lag_id"]].fillna("")
    waits = ~frame.groupby(driver, dropna=False)["accepted"].cummax()
    refusals = frame["refusals"].fillna("").str.split()
    for side, conditions in _CONDITIONS.items():
        # where anything else says no too, that this side would do is never seen, and refusals alone would count
        refused = waits & refusals.map(lambda said, conditions=conditions: bool(said) and conditions.issuperset(said))
        frame[f"{side}_refused_s"] = frame[f"{side}_time_gap_s"].where(refused)
    by_rule = frame["rule"].map({"cells_occupied": "cells", "lane_ends": "road"}).fillna("rule")
    after = frame["guard"].map({"yes": "sumo", "conflict_predicted": "guard", "scene_ends": "end"}).fillna("road")
    frame["refused_by"] = after.where(frame["accepted"], by_rule).mask(frame["taken"], "")
    frame["asked_guard"] = frame["guard"].isin(["yes", "conflict_predicted"])
    frame["asked_sumo"] = frame["sumo"].notna()
    grouped = frame.groupby(same, sort=False, dropna=False)
    found = grouped.agg(
        accepted=("accepted", "any"), taken=("taken", "any"), from_s=("time_s", "min"), to_s=("time_s", "max"),
        refused_by=("refused_by", "last"), asked_guard=("asked_guard", "any"), asked_sumo=("asked_sumo", "any"),
        lag_refused_s=("lag_refused_s", "max"), lead_refused_s=("lead_refused_s", "max"),
    )  # fmt: skip
    said_no = grouped["refused_by"].agg(set)
    for name in ("guard", "sumo"):  # what one says no to at a look may be another's at the last
        found[f"refused_{name}"] = ~found["taken"] & np.array([name in each for each in said_no], dtype=bool)
    first = frame[frame["accepted"]].drop_duplicates(same).set_index(same)
    found["accepted_s"] = first["time_s"].reindex(found.index)
    sizes = grouped[_SIZES].max().where(~found["accepted"], first[_SIZES].reindex(found.index))
    return found.join(sizes).reset_index()


def largest_rejected(gaps: pd.DataFrame, side: str) -> tuple[FloatArray, FloatArray, int]:
    """Largest time gap refused for this side and that taken, s, of each driver that looked; how many were left out.

    A gap that was refused for anything but this side of it is no refusal of it. inf: it took none, or one without a
    vehicle on this side; where it refused none either it tells nothing. A driver that refused a larger one than it took
    is left out: its rule asks for something else, too.
    """
    if gaps.empty:
        return np.empty(0), np.empty(0), 0
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
    largest critical gaps. Intervals: draws from the inverse information. None of fewer than eight taken, four refused.
    """
    if np.isfinite(accepted_s).sum() < _FEWEST or (rejected_s > 0.0).sum() < _FEWEST // 2:
        return Estimate(None), Estimate(None)
    low, high = float(rejected_s.max()), float(accepted_s.min())
    if low < high:  # one gap parts all drivers: anything between the two is as likely
        return Estimate(0.5 * (low + high), low, high), Estimate(0.0)
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


def critical_gap(gaps: pd.DataFrame, side: str) -> dict[str, Any] | None:
    """Critical time gap of the drivers in a table of gaps on one side, lag or lead: a row of critical_gaps.csv.

    mean_s, sd_s: lognormal, by maximum likelihood. None where too few took or refused one.
    """
    rejected, accepted, inconsistent = largest_rejected(gaps, side)
    mean, sd = troutbeck(rejected, accepted)
    if mean.value is None:
        return None
    return {
        "side": side, "mean_s": mean.value, "mean_low_s": mean.low, "mean_high_s": mean.high, "sd_s": sd.value,
        "drivers": accepted.size, "inconsistent": inconsistent,
    }  # fmt: skip
