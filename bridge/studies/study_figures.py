"""The figures of a study: for each parameter that varies, what becomes of the manoeuvres along it."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from bridge.evaluation.aggregate import Estimate, ratio_estimate
from bridge.evaluation.charts import reason_words
from bridge.pictures import figures
from hid2.params import Conflict

#: Values of a parameter beyond this many are put into this many groups of equal size.
_GROUPS = 8
#: Reasons shown apart; the others are one.
_REASONS = 6
_REASON_COLORS = (
    figures.VERMILION, figures.ORANGE, figures.SKY, figures.GREEN, figures.PURPLE, figures.BLACK, figures.GREY,
)  # fmt: skip
#: Critical values, whatever a run was made with.
_CRITICAL = Conflict()

Record = Mapping[str, Any]
LABELS = {
    "trigger_s": "trigger time, s",
    "request.agents": "vehicles requested",
    "lane_change.time_gap_front_s": "smallest time gap to the new leader, s",
    "lane_change.time_gap_rear_s": "smallest time gap to the new follower, s",
    "lane_change.max_duration_s": "longest lane change allowed, s",
    "overtake.d_obs_m": "observation horizon d_obs, m",
}


class DrawnStudy(Protocol):
    """What the figures read of a study."""

    @property
    def name(self) -> str:
        """As in the names of the files."""

    @property
    def kind(self) -> str:
        """The manoeuvre that is drawn."""

    @property
    def points(self) -> Sequence[Mapping[str, Any]]:
        """Values of the parameters that vary, one mapping for each run."""


def draw_study(study: DrawnStudy, maneuvers: Sequence[Record], out_dir: Path) -> list[Path]:
    """Draw one figure for each numeric parameter that varies; returns the files."""
    mine = [record for record in maneuvers if record["kind"] == study.kind]
    keys = [key for key in study.points[0] if len({point[key] for point in study.points}) > 1]
    files = []
    for key in keys:
        if mine and all(isinstance(record[key], int | float) for record in mine):
            path = out_dir / f"{study.name}_{key.replace('.', '_')}.png"
            _draw(study, mine, key, path)
            files.append(path)
    return files


def _draw(study: DrawnStudy, records: Sequence[Record], key: str, path: Path) -> None:
    figures.style()
    groups = _groups(records, key)
    x = np.array([np.mean([record[key] for record in group]) for group in groups])
    figure, axes = plt.subplots(2, 3, figsize=(12, 6.8), layout="constrained")
    panels: list[tuple[Axes, str, list[tuple[str, str, Callable[[Record], tuple[float, float]]]]]] = [
        (axes[0, 0], "share of requests", [
            ("a vehicle was there for it", figures.GREY, lambda r: (r["triggered_s"] is not None, 1)),
            ("started", figures.SKY, lambda r: (r["start_s"] is not None, 1)),
            ("done", figures.BLUE, lambda r: (r["status"] == "done", 1)),
        ]),
        (axes[0, 1], "from trigger to start, mean, s", [("", figures.BLUE, _mean_of("wait_s"))]),
        (axes[0, 2], "smallest TTC from start to end, mean, s\n(values above 5 s count as 5 s)", [
            ("to anything", figures.BLUE, _mean_of("window_ttc_s")),
        ]),
        (axes[1, 0], "smallest PET of the vehicle, mean, s\n(where paths cross within 5 s)", [
            ("", figures.BLUE, _mean_of("pet_s")),
        ]),
        (axes[1, 1], "bumper gap at the start, mean, m", [
            ("to the new leader", figures.BLUE, _mean_of("gap_front_m")),
            ("to the new follower", figures.ORANGE, _mean_of("gap_rear_m")),
        ]),
    ]  # fmt: skip
    for panel, title, lines in panels:
        for label, color, value in lines:
            _line(panel, x, [_estimate(group, value) for group in groups], color=color, label=label)
        panel.set_title(title)
        panel.set_ylim(bottom=0)
        if len(lines) > 1:
            panel.legend(fontsize=8)
        if not panel.lines:
            panel.annotate("none", (0.5, 0.5), xycoords="axes fraction", ha="center", color=figures.GREY)
    axes[0, 0].set_ylim(0, 1.03)
    for panel, critical in ((axes[0, 2], _CRITICAL.ttc_min_s), (axes[1, 0], _CRITICAL.pet_min_s)):
        panel.set_ylim(0, max(panel.get_ylim()[1], 1.5 * critical))
        panel.axhline(critical, color=figures.VERMILION, linewidth=0.8, linestyle=":")
        panel.annotate(
            "critical", (1, critical), xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize=7
        )
    _reasons(axes[1, 2], x, groups)
    label = LABELS.get(key, key)
    margin = 0.06 * max(float(np.ptp(x)), 1e-9) + (0.4 * float(np.diff(x).min()) if len(x) > 1 else 0.5)
    for panel in axes.flat:
        panel.set_xlabel(label)
        panel.set_xlim(x.min() - margin, x.max() + margin)
    scenes = len({record["scene"] for record in records})
    runs = len({(record["scene"], record["point"], record["seed"]) for record in records})
    figure.suptitle(
        f"{study.name.replace('_', ' ')}: {study.kind.replace('_', ' ')}, {len(records)} requests in {runs} runs on "
        f"{scenes} scene{'s' if scenes > 1 else ''}; bars: 95 % intervals, bootstrap over runs",
        fontsize=10,
    )
    figures.save(figure, path)


def _mean_of(column: str) -> Callable[[Record], tuple[float, float]]:
    return lambda record: (0.0, 0.0) if record[column] is None else (float(record[column]), 1.0)


def _groups(records: Sequence[Record], key: str) -> list[list[Record]]:
    """Records by value of a parameter; by intervals with as many records each where it has many values."""
    values = sorted({record[key] for record in records})
    if len(values) <= _GROUPS:
        return [[record for record in records if record[key] == value] for value in values]
    ordered = sorted(records, key=lambda record: float(record[key]))
    return [[ordered[i] for i in part] for part in np.array_split(np.arange(len(ordered)), _GROUPS)]


def _estimate(group: Sequence[Record], value: Callable[[Record], tuple[float, float]]) -> Estimate:
    """Ratio of sums, resampled by run: the vehicles of one run are not independent."""
    sums: dict[tuple[str, int, int], list[float]] = {}
    for record in group:
        total = sums.setdefault((record["scene"], record["point"], record["seed"]), [0.0, 0.0])
        above, below = value(record)
        total[0] += above
        total[1] += below
    table = np.array([sums[key] for key in sorted(sums)]).reshape(-1, 2)
    return ratio_estimate(table[:, 0], table[:, 1])


def _line(
    axes: Axes, x: "np.typing.NDArray[np.float64]", estimates: Sequence[Estimate], *, color: str, label: str
) -> None:
    known = [(at, e.value, e.low, e.high) for at, e in zip(x, estimates, strict=True) if e.value is not None]
    if not known:
        return
    at = [k[0] for k in known]
    middle = [k[1] for k in known]
    low = [k[1] - (k[1] if k[2] is None else k[2]) for k in known]
    high = [(k[1] if k[3] is None else k[3]) - k[1] for k in known]
    axes.errorbar(
        at, middle, yerr=np.maximum([low, high], 0), color=color, marker="o", markersize=4, linewidth=1.2,
        capsize=2, label=label or None,
    )  # fmt: skip


def _reasons(axes: Axes, x: "np.typing.NDArray[np.float64]", groups: Sequence[Sequence[Record]]) -> None:
    """Stacked shares of requests that were not done, by reason."""
    failed = [[r for r in group if r["status"] != "done"] for group in groups]
    counts = Counter(_reason(record) for group in failed for record in group)
    shown = [reason for reason, _ in counts.most_common(_REASONS)]
    width = 0.8 * float(np.diff(x).min()) if len(x) > 1 else 0.5
    bottom = np.zeros(len(x))
    for number, reason in enumerate([*shown, "other"]):
        share = np.array(
            [
                sum((_reason(r) if _reason(r) in shown else "other") == reason for r in bad) / max(len(group), 1)
                for bad, group in zip(failed, groups, strict=True)
            ]
        )
        if share.any():
            axes.bar(x, share, width, bottom=bottom, color=_REASON_COLORS[number], label=reason_words(reason))
            bottom += share
    axes.set_title("not done, share of requests by reason")
    axes.set_ylim(0, 1)
    if bottom.any():
        axes.legend(fontsize=7, loc="upper left")


def _reason(record: Record) -> str:
    return str(record["reason"] or record["status"])
