"""The figures of a study: for each parameter what becomes of requests and gaps along it; the fundamental diagram."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from bridge.pictures import figures
from bridge.studies.columns import DECIDE
from bridge.studies.statistics import kaplan_meier
from hid2.params import Conflict

#: Critical values, whatever a run was made with.
CRITICAL = Conflict()
LABELS = {
    "trigger_after_s": "trigger time, s",
    "lane_change.time_gap_front_s": "smallest time gap to the new leader, s",
    "lane_change.time_gap_rear_s": "smallest time gap to the new follower, s",
    "lane_change.mobil_politeness": "MOBIL politeness p",
    "lane_change.lc_strategic": "LC2013 lcStrategic",
    "lane_change.lc_cooperative": "LC2013 lcCooperative",
    "lane_change.lc_speed_gain": "LC2013 lcSpeedGain",
    "lane_change.rule": "lane-change rule",
    "car_following.model": "car-following model",
    "driving.replay": "recorded vehicles",
    "flow.veh_per_h_lane": "flow asked for, veh/h per lane",
}
_COLORS = {"cells": figures.SKY, "rule": figures.ORANGE, "guard": figures.GREEN, "sumo": figures.VERMILION}


def label_of(key: str) -> str:
    """A parameter as a reader would say it."""
    return LABELS.get(key, f"argument {key[5:]} of the rule" if key.startswith("rule.") else key)


def draw_parameter(
    path: Path, title: str, key: str, *, dose: pd.DataFrame, requests: pd.DataFrame,
    curves: Mapping[Any, dict[str, Any] | None], give_up_s: float,
) -> None:  # fmt: skip
    """Six panels for one parameter. dose: its rows; curves: logistic acceptance by value."""
    figures.style()
    values = list(curves)
    numeric = not isinstance(values[0], str)
    at = {value: (float(value) if numeric else float(place)) for place, value in enumerate(values)}
    colors = plt.get_cmap("viridis")(np.linspace(0.0, 0.85, len(values)))
    figure, axes = plt.subplots(2, 3, figsize=(12.5, 7), layout="constrained")

    upper = (
        ("accepted, share", {"share_accepted": ("requests that got a gap", figures.BLUE),
                             "gaps_accepted": ("gaps that the rule took", figures.SKY)}),
        ("mean duration, s", {"mean_wait_s": (f"waiting, up to {give_up_s:g} s", figures.BLUE),
                              "lateral_s": ("lateral motion, once accepted", figures.ORANGE)}),
        ("gaps refused, share, by",
         {f"refused_by_{name}": (DECIDE[name], color) for name, color in _COLORS.items()}),
    )  # fmt: skip
    for panel, (panel_title, outcomes) in zip(axes[0], upper, strict=True):
        for outcome, (label, color) in outcomes.items():
            _dots(panel, dose, at, outcome, color, label)
        top = 1.03 if "share" in panel_title else None
        panel.set(title=panel_title, ylim=(0, top), xlabel=label_of(key))
        if panel.get_legend_handles_labels()[0]:  # no vehicle may have looked at a gap
            panel.legend(fontsize=8)
        if not numeric:
            panel.set_xticks(list(at.values()), [str(value) for value in values])

    counted, lag = requests[requests["counted"]], np.linspace(0.0, 5.0, 101)
    for value, color in zip(values, colors, strict=True):
        mine, curve = counted[counted[key] == value], curves[value]
        if len(mine):
            curve_of = kaplan_meier(mine["waited_s"].to_numpy(float), mine["accepted"].to_numpy(float))
            level = np.concatenate([[1.0], curve_of.surv_prob])
            times = np.concatenate([[0.0], curve_of.surv_times, [give_up_s]])
            axes[1, 0].step(times, [*level, level[-1]], where="post", color=color, label=str(value))
        if curve is not None and not curve["separated"]:
            x = np.column_stack([np.ones(lag.size), lag, np.full(lag.size, curve["lead_s"])])
            found = curve["fit"].get_prediction(x).summary_frame()  # the mean and its 95 % band
            axes[1, 1].plot(lag, found["mean"], color=color, label=str(value))
            band = found["mean_ci_lower"], found["mean_ci_upper"]
            axes[1, 1].fill_between(lag, *band, color=color, alpha=0.12, linewidth=0)
        started = mine[mine["start_s"].notna()]
        axes[1, 2].plot([], [], color=color, label=str(value))
        _distribution(axes[1, 2], started["min_ttc_s"], color, "-")
        _distribution(axes[1, 2], started["min_pet_s"], color, ":")
    survival, acceptance, critical = axes[1]
    survival.set(
        title="still waiting (Kaplan-Meier)", xlabel="time from the trigger, s", xlim=(0, give_up_s), ylim=(0, 1.03)
    )
    acceptance.set(
        title="gap taken by the rule, logistic, at the median lead gap", xlabel="lag time gap, s", ylim=(0, 1.03)
    )
    critical.set(title="changes with a TTC (line), PET (dots) below", xlabel="s", xlim=(0, 5), ylim=(0, None))
    critical.axvline(CRITICAL.ttc_min_s, color=figures.VERMILION, linewidth=0.8)
    for panel in (survival, critical):
        panel.legend(fontsize=7, title=label_of(key), title_fontsize=7)
    if acceptance.lines:
        acceptance.legend(fontsize=7)
    else:
        acceptance.annotate("too few gaps, or parted by a threshold", (0.5, 0.5), xycoords="axes fraction", ha="center")
    figure.suptitle(title, fontsize=10)
    figures.save(figure, path)


def draw_fundamental(path: Path, title: str, flow: pd.DataFrame, key: str | None) -> None:
    """Flow and speed by density; key: what colours the dots."""
    figures.style()
    figure, axes = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
    values = [None] if key is None else sorted(flow[key].unique())
    colors = plt.get_cmap("viridis")(np.linspace(0.0, 0.85, len(values)))
    for value, color in zip(values, colors, strict=True):
        mine = flow if key is None else flow[flow[key] == value]
        for panel, column in ((axes[0], "flow_veh_per_h_lane"), (axes[1], "speed_kmph")):
            panel.plot(mine["density_veh_per_km_lane"], mine[column], "o", markersize=3, color=color, label=str(value))
    for panel, label in zip(axes, ("flow, veh/h per lane", "speed, km/h"), strict=True):
        panel.set(ylabel=label, xlabel="density, veh/km per lane", xlim=(0, None), ylim=(0, None))
    if key is not None:
        axes[1].legend(fontsize=7, title=label_of(key), title_fontsize=7)
    figure.suptitle(title, fontsize=10)
    figures.save(figure, path)


def _dots(axes: Axes, dose: pd.DataFrame, at: Mapping[Any, float], outcome: str, color: str, label: str) -> None:
    """Estimates with the intervals of runs."""
    mine = dose[(dose["outcome"] == outcome) & dose["estimate"].notna()]
    if mine.empty:
        return
    x = np.array([at[value] for value in mine["value"]])
    middle = mine["estimate"].to_numpy(float)
    low, high = (mine[end].astype(float).fillna(mine["estimate"]).to_numpy() for end in ("low_runs", "high_runs"))
    error = np.maximum([middle - low, high - middle], 0.0)
    axes.errorbar(x, middle, yerr=error, color=color, marker="o", markersize=4, linewidth=1.2, capsize=2, label=label)


def _distribution(axes: Axes, values: "pd.Series[float]", color: Any, style: str) -> None:  # noqa: ANN401
    """Share of the changes below each value; those without one, which have none below 5 s, count too."""
    known = np.sort(values.dropna().to_numpy(float))
    if known.size:
        share = np.arange(1, known.size + 1) / len(values)
        axes.step([0.0, *known, 5.0], [0.0, *share, share[-1]], where="post", color=color, linestyle=style)
