"""Charts of the report and of the paper's experiments."""

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from bridge.pictures import figures
from hid2.agents import Policy
from hid2.evaluation.realism import FEATURES, FINE, GENERATED, RECORDED, RealismCounts
from hid2.policy.behaviours import BEHAVIOURS
from hid2.resampling import Estimate


def distribution_figure(counts: RealismCounts) -> Figure:
    """Generated and recorded distribution of every feature as steps over the same bins."""
    figure, axes = plt.subplots(3, 4, figsize=(13, 8.4), layout="constrained")
    for ax, feature in zip(axes.flat, FEATURES, strict=False):
        edges = np.linspace(feature.low, feature.high, feature.bins + 1)
        for name, row, color, line in (
            ("recorded", RECORDED, figures.DARK_GREY, "-"),
            ("generated", GENERATED, figures.GENERATED, "--"),
        ):
            binned = counts.of(feature)[row].reshape(feature.bins, FINE).sum(axis=1)
            if binned.sum():
                ax.stairs(binned / binned.sum(), edges, color=color, linestyle=line, linewidth=1.8, label=name)
        ax.set(xlabel=f"{feature.label}, {feature.unit}", ylabel="share", ylim=(0, None))
    for ax in axes.flat[len(FEATURES) :]:
        ax.set_axis_off()
    axes.flat[0].legend(fontsize=8)
    return figure


def diversity_figure(diversity: Mapping[str, Any]) -> Figure:
    """The paper's diversity figure: scenes by density and by behaviour, before and after."""
    figure, axes = plt.subplots(1, 3, figsize=(13, 3.8), layout="constrained", width_ratios=[1, 1, 1.1])
    shown = {"tracks": "agents in the scene", "tracks_at_49": "agents when observation ends"}
    for ax, (name, axis_label) in zip(axes, shown.items(), strict=False):
        density = diversity["density"][name]
        top = max([10, *(int(number) for when in ("before", "after") for number in density[when])])
        edges, highest = np.arange(0, top + 20, 20), 0.0
        for when, color, hatch in (("before", figures.GREY, ""), ("after", figures.BLUE, "//")):
            scenes = list(density[when].values())
            # a bar from 40 to 60 holds more than 40 and up to 60, as in the table: nothing lies on an edge
            heights, _ = np.histogram([int(number) - 0.5 for number in density[when]], edges, weights=scenes)
            levels = heights / max(1, sum(scenes))
            label = f"{when}, {diversity['scenes'][when]} scenes"
            ax.stairs(levels, edges, fill=True, color=color, alpha=0.35, hatch=hatch, label=label)
            ax.stairs(levels, edges, color=color, linewidth=1.6)
            highest = max(highest, levels.max())
        ax.set(ylim=(0, 1.25 * highest), xlabel=axis_label, ylabel="share of scenes")  # room for the legend
    axes[0].legend(loc="upper left")
    place = np.arange(len(Policy))
    for offset, when, color, hatch in ((-0.2, "before", figures.GREY, ""), (0.2, "after", figures.BLUE, "//")):
        part = diversity["behaviours"][when]
        shares = [part["scenes_with"][policy.value] / max(1, part["scenes"]) for policy in Policy]
        bars = axes[2].bar(
            place + offset, shares, 0.4, color=color, alpha=0.7, hatch=hatch, edgecolor="white", label=when
        )
        axes[2].bar_label(bars, fmt="%.2f", fontsize=7)
    axes[2].set_xticks(place, [f"{BEHAVIOURS[p].short}\n{BEHAVIOURS[p].label}" for p in Policy], fontsize=8)
    axes[2].set(ylabel="share of scenes with it", ylim=(0, 1.1))
    return figure


def density_figure(series: Mapping[str, Mapping[str, Sequence[tuple[float, Estimate]]]], *, of: str) -> Figure:
    """The paper's figure of added agents: LO, LA, JE, SCR, ORR against the number placed; series[metric][group].

    of: how many scenes and vehicles it is of, in words.
    """
    figure, axes = plt.subplots(1, len(series), figsize=(3.0 * len(series), 3.4), layout="constrained")
    labels = {"lo": "LO, m/s²", "la": "LA, m/s²", "je": "JE, m/s³", "scr": "SCR, share", "orr": "ORR, share"}
    looks = {"combined": (figures.COMBINED, "-", "o"), "generated": (figures.GENERATED, "--", "s")}
    for ax, (metric, groups) in zip(axes, series.items(), strict=True):
        for group, points in groups.items():
            color, line, marker = looks[group]
            known = [(x, *e) for x, e in points if e.value is not None]
            name = "recorded and generated" if group == "combined" else "generated alone"
            x, values = [x for x, *_ in known], [value for _, value, *_ in known]
            ax.plot(x, values, color=color, linestyle=line, marker=marker, markersize=4, label=name)
            band = [(x, low, high) for x, _, low, high in known if low is not None and high is not None]
            if band and group == "combined":
                ax.fill_between(*zip(*band, strict=True), color=color, alpha=0.15)
        placed = sorted({x for points in groups.values() for x, _ in points})
        ax.set(xlabel="vehicles placed, mean", title=labels[metric], ylim=(0, None), xticks=placed)
    figure.suptitle(of, fontsize=9)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure
