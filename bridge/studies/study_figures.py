"""The figures of a study: for each parameter what becomes of requests and gaps along it."""

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

_COLORS = {"cells": figures.SKY, "rule": figures.ORANGE, "guard": figures.GREEN, "sumo": figures.VERMILION}


def draw_parameter(
    path: Path, study: str, key: str, *, dose: pd.DataFrame, requests: pd.DataFrame, give_up_s: float
) -> None:
    """Four panels for one parameter: shares, durations and refusals by its value; waiting times. dose: its rows."""
    figures.style()
    values = sorted(requests[key].unique())
    numeric = not isinstance(values[0], str)
    at = {value: (float(value) if numeric else float(place)) for place, value in enumerate(values)}
    figure, axes = plt.subplots(2, 2, figsize=(9, 7), layout="constrained")

    by_value = (
        ("accepted, share", {"share_accepted": ("requests that got a gap", figures.BLUE),
                             "gaps_accepted": ("gaps that the rule took", figures.SKY)}),
        ("mean duration, s", {"mean_wait_s": (f"waiting, up to {give_up_s:g} s", figures.BLUE),
                              "lateral_s": ("lateral motion, once accepted", figures.ORANGE)}),
        ("gaps refused, share, by",
         {f"refused_by_{name}": (DECIDE[name], color) for name, color in _COLORS.items()}),
    )  # fmt: skip
    for panel, (panel_title, outcomes) in zip(axes.flat, by_value, strict=False):
        for outcome, (label, color) in outcomes.items():
            _dots(panel, dose, at, outcome, color, label)
        top = 1.03 if "share" in panel_title else None
        panel.set(title=panel_title, ylim=(0, top), xlabel=key)
        if panel.get_legend_handles_labels()[0]:  # no vehicle may have looked at a gap
            panel.legend(fontsize=8)
        if not numeric:
            panel.set_xticks(list(at.values()), [str(value) for value in values])

    survival, counted = axes[1, 1], requests[requests["counted"]]
    colors = plt.get_cmap("viridis")(np.linspace(0.0, 0.85, len(values)))
    for value, color in zip(values, colors, strict=True):
        mine = counted[counted[key] == value]
        if len(mine):
            curve = kaplan_meier(mine["waited_s"].to_numpy(float), mine["accepted"].to_numpy(float))
            level = np.concatenate([[1.0], curve.surv_prob])
            times = np.concatenate([[0.0], curve.surv_times, [give_up_s]])
            survival.step(times, [*level, level[-1]], where="post", color=color, label=str(value))
    survival.set(
        title="still waiting (Kaplan-Meier)", xlabel="time from the trigger, s", xlim=(0, give_up_s), ylim=(0, 1.03)
    )
    survival.legend(fontsize=7, title=key, title_fontsize=7)
    figure.suptitle(f"{study}; bars: 95 % intervals, runs drawn again", fontsize=10)
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
