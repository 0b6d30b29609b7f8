"""The tables of the paper's experiments: its own figures, and ours beside them, line by line."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from bridge.evaluation import report
from bridge.evaluation.experiments import Experiment, Outcome
from bridge.evaluation.scene_metrics import Row
from bridge.evaluation.totals import SourceSums, estimate
from hid2.evaluation.metrics import METRICS, Metric
from hid2.resampling import Estimate

#: LO, LA, JE, SCR, ORR: what the paper reports.
COLUMNS: tuple[Metric, ...] = tuple(metric for metric in METRICS if metric.key in report.PAPER_ORIGINAL)
#: The same, and a column that the paper does not have.
SHOWN: tuple[Metric, ...] = (*COLUMNS, *(metric for metric in METRICS if metric.key == "footprint_orr"))
#: The paper's ablation table: component switched off, LO, LA, JE, SCR, ORR.
PAPER_ABLATION: Mapping[str, Mapping[str, float]] = {
    "full": report.PAPER_HID2,
    "topology": {"lo": 1.491, "la": 0.483, "je": 7.842, "scr": 0.101, "orr": 0.225},
    "collision": {"lo": 1.449, "la": 0.433, "je": 7.087, "scr": 0.282, "orr": 0.125},
    "smoothing": {"lo": 2.379, "la": 1.188, "je": 9.156, "scr": 0.072, "orr": 0.141},
}
#: The lower half of the paper's Table 1: Argoverse 1, recorded and with HiD2's vehicles.
PAPER_ARGOVERSE1 = {"lo": 1.414, "la": 0.838, "je": 11.192, "scr": 0.030, "orr": 0.009}
PAPER_HID2_ARGOVERSE1 = {"lo": 1.378, "la": 0.976, "je": 11.031, "scr": 0.020, "orr": 0.007}


class Line(NamedTuple):
    """A line of a table: its label, then value and interval (or the paper's figure) by metric key."""

    label: str
    values: Mapping[str, Mapping[str, float | None]]


def _ours(label: str, rows: Sequence[Row], group: str) -> Line:
    sums = SourceSums.of(rows)
    return Line(label, {m.key: estimate(sums, m, group)._asdict() for m in SHOWN})


def _papers(label: str, figures: Mapping[str, float]) -> Line:
    return Line(label, {key: Estimate(value)._asdict() for key, value in figures.items()})


def lines_of(name: Experiment, outcomes: Sequence[Outcome]) -> list[Line]:
    """The lines of an experiment's table, but for diversity, which has none."""
    if name == "table1":
        rows = outcomes[0].rows
        first = [row for row in rows if row["format"] == "argoverse1"]
        second = [row for row in rows if row["format"] != "argoverse1"]
        return [*_table1_lines(second), *_table1_argoverse1_lines(first, outcomes[1].rows, outcomes[2].rows)]
    if name == "ablation":
        lines = []
        for outcome in outcomes:
            what = "everything on" if outcome.setting.name == "full" else f"without {outcome.setting.name}"
            lines += [
                _papers(f"paper: {what}", PAPER_ABLATION[outcome.setting.name]),
                _ours(f"ours: {what}, recorded and generated", outcome.rows, "combined"),
                _ours(f"ours: {what}, generated alone", outcome.rows, "generated"),
            ]
        return lines
    lines = []
    for outcome in outcomes:
        lines.append(_ours(f"{outcome.setting.name} asked for: recorded and generated", outcome.rows, "combined"))
        if outcome.setting.config is not None:
            lines.append(_ours(f"{outcome.setting.name} asked for: generated alone", outcome.rows, "generated"))
    return lines


def _table1_lines(rows: Sequence[Row]) -> list[Line]:
    """The upper half: scenes of Argoverse 2; where some are tracked and some labelled by people, each apart as well."""
    if not rows:
        return []
    made = {
        what: [row for row in rows if row["provenance"] == provenance]
        for what, provenance in (("tracked on board", "tracker"), ("labelled by people", "human"))
    }
    parts = made if all(made.values()) else {}

    def ours(label: str, group: str) -> list[Line]:
        lines = [_ours(label, rows, group)]
        for what, own in parts.items():
            count = len({row["source"] for row in own})
            lines.append(_ours(f"{label}, {what} ({count} scene{'' if count == 1 else 's'})", own, group))
        return lines

    return [
        _papers("paper: Argoverse 2", report.PAPER_ORIGINAL),
        *ours("ours: recorded scenes", "original"),
        _papers("paper: HiD2", report.PAPER_HID2),
        *ours("ours: recorded and generated", "combined"),
        _ours("ours: generated vehicles alone", rows, "generated"),
    ]


def _table1_argoverse1_lines(rows: Sequence[Row], filtered: Sequence[Row], whole: Sequence[Row]) -> list[Line]:
    """The lower half: sequences of Argoverse 1, with positions as they are, smoothed, and of whole tracks smoothed."""
    if not rows:
        return []
    return [
        _papers("paper: Argoverse 1", PAPER_ARGOVERSE1),
        _ours("ours: Argoverse 1, recorded, positions as they are", rows, "original"),
        _ours("ours: Argoverse 1, recorded, positions smoothed", filtered, "original"),
        _ours("ours: Argoverse 1, recorded, smoothed, tracks seen at every step", whole, "original"),
        _papers("paper: HiD2 on Argoverse 1", PAPER_HID2_ARGOVERSE1),
        _ours("ours: Argoverse 1, recorded and generated, positions as they are", rows, "combined"),
        _ours("ours: Argoverse 1, recorded and generated, recorded positions smoothed", filtered, "combined"),
        _ours("ours: Argoverse 1, recorded and generated, smoothed, tracks seen at every step", whole, "combined"),
        _ours("ours: Argoverse 1, generated vehicles alone", rows, "generated"),
    ]


def flat(line: Line) -> Row:
    """A line for the CSV file."""
    row: Row = {"row": line.label}
    for metric in SHOWN:
        value, low, high = line.values.get(metric.key, Estimate(None)._asdict()).values()
        row |= {metric.key: value, f"{metric.key}_low": low, f"{metric.key}_high": high}
    return row
