"""The results of a study: tables as CSV with a data dictionary, figures, and a page of text."""

import logging
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from pandas.api.types import is_numeric_dtype

from bridge.batch.manifest import DONE
from bridge.files import beside, explained, table_cell, write_rows, write_text
from bridge.pages.parts import text
from bridge.pictures import figures
from bridge.studies.columns import DECIDE, DICTIONARY, OUTCOMES
from bridge.studies.gap_acceptance import critical_gap, gaps_of
from bridge.studies.statistics import difference_sd, dose_response, in_order, kaplan_meier, seeds_needed
from bridge.studies.study import Study
from hid2.params import Conflict

#: Most values of a parameter told one by one, and number of classes of neighbouring values of more, as of a hypercube.
_MOST_VALUES, _CLASSES = 12, 6
#: Differences of shares for which the page says how many seeds they need.
_SIZES_TOLD = (0.02, 0.05, 0.1)
_COLORS = (figures.ORANGE, figures.SKY, figures.GREY, figures.PURPLE, figures.GREEN, figures.VERMILION)
_LOG = logging.getLogger(__name__)


def write_results(study: Study, tables: Mapping[str, pd.DataFrame], out_dir: Path) -> list[Path]:
    """Write everything that a study says into out_dir; returns the files. Errors: ExportError."""
    keys = ["trigger_after_s" if key == "trigger_s" else key for key in study.keys]
    give_up_s = give_up_of(study)
    requests, gaps = tables["requests"], gaps_of(tables["looks"], keys)
    if not gaps.empty and not requests.empty:
        counted = requests.loc[requests["counted"], ["scene", "point", "seed", "vehicle"]]
        gaps = gaps.merge(counted, on=["scene", "point", "seed", "vehicle"])
    any_counted = not requests.empty and bool(requests["counted"].any())
    if not any_counted:
        said = "expected a share of it in request, more traffic, more time, or a shorter flow.warm_up_s"
        _LOG.warning("%s: no run has a request that counts (%s); %s", out_dir, study.kind, said)
    files: list[Path] = []
    doses, critical = [], []
    for key in keys if any_counted else ():
        if never := sorted(set(requests[key]) - set(requests.loc[requests["counted"], key]), key=str):
            said = "%s: no request was due at %s = %s; expected earlier trigger times, or longer scenes"
            _LOG.warning(said, out_dir, key, ", ".join(map(str, never)))
        told_as = _classes(requests[key])
        asked, looked = (one.assign(**{key: one[key].map(told_as)}) if len(one) else one for one in (requests, gaps))
        dose = dose_response(asked, looked, key, give_up_s=min(give_up_s), critical_ttc_s=Conflict().ttc_min_s)
        doses.append(dose)
        for value, own in looked.groupby(key) if len(looked) else ():
            found = (critical_gap(own, side) for side in ("lag", "lead"))
            critical += [{"parameter": key, "value": value, **one} for one in found if one]
        files.append(out_dir / f"{study.name}_{key.replace('.', '_')}.png")
        draw_parameter(files[-1], study.name, key, dose=dose, requests=asked, give_up_s=max(give_up_s))
    named = {
        **tables,
        "gaps": gaps,
        "dose_response": pd.concat(doses) if doses else pd.DataFrame(),
        "critical_gaps": pd.DataFrame(critical),
    }
    said_of = {name: ", ".join(columns).split(", ") for name, columns in DICTIONARY.items()}
    named |= {name: pd.DataFrame(columns=columns) for name, columns in said_of.items() if named[name].empty}
    written = [_write_table(out_dir, name, named[name]) for name in DICTIONARY]
    dictionary, page = out_dir / "columns.csv", out_dir / "study.md"
    says = ((table, *said) for table, columns in DICTIONARY.items() for said in columns.items())
    write_rows(dictionary, ("table", "column", "says"), says)
    write_text(page, page_text(study, named, keys, drawn=[path.name for path in files]))
    return [page, *files, dictionary, *written]


def give_up_of(study: Study) -> list[float]:
    """The longest wait of each point of a study, s."""
    return [configs[0].lane_change.give_up_s for configs in study.configs]


def _classes(values: "pd.Series[Any]") -> dict[Any, Any]:
    """What each value is told as: itself, or, of many numbers, the mean of its class, all classes as large."""
    known = np.sort(values.unique())
    if len(known) <= _MOST_VALUES or not is_numeric_dtype(values):
        return {value: value for value in known.tolist()}
    return {value: float(f"{part.mean():.4g}") for part in np.array_split(known, _CLASSES) for value in part.tolist()}


def _write_table(out_dir: Path, name: str, table: pd.DataFrame) -> Path:
    """A table as CSV, compressed where it is long; of an earlier one in the other form nothing is left."""
    long = len(table) > 50_000  # rows: it is compressed
    path, other = (out_dir / f"{name}.{ending}" for ending in (("csv.gz", "csv") if long else ("csv", "csv.gz")))
    texts = table.select_dtypes(exclude=["number", "bool"]).columns
    safe = table.assign(**{column: table[column].map(table_cell, na_action="ignore") for column in texts})
    packed: Any = {"method": "gzip", "mtime": 0} if long else None
    with beside(path) as hidden:
        safe.to_csv(hidden, index=False, lineterminator="\n", compression=packed)
    with explained(other):
        other.unlink(missing_ok=True)
    return path


# Figures --------------------------------------------------------------------------------------------------------------


def draw_parameter(
    path: Path, study: str, key: str, *, dose: pd.DataFrame, requests: pd.DataFrame, give_up_s: float
) -> None:
    """Four panels for one parameter: shares, durations and refusals by its value; waiting times. dose: its rows.

    give_up_s: the longest wait of all.
    """
    figures.style()
    values = in_order(requests, key)
    numeric = not isinstance(values[0], str)
    at = {value: (float(value) if numeric else float(place)) for place, value in enumerate(values)}
    figure, axes = plt.subplots(2, 2, figsize=(9, 7), layout="constrained")

    within_s = dose.loc[dose["outcome"] == "mean_wait_s", "within_s"].min()
    by_value = {
        "accepted, share": {
            "share_accepted": ("requests that got a gap", figures.BLUE),
            "gaps_accepted": ("gaps that the rule took", figures.SKY),
        },
        "mean duration, s": {
            "mean_wait_s": (f"waiting, up to {within_s:g} s", figures.BLUE),
            "lateral_s": ("lateral motion, once accepted", figures.ORANGE),
        },
        "gaps refused, share, by": {
            f"refused_by_{name}": (said, color) for (name, said), color in zip(DECIDE.items(), _COLORS, strict=True)
        },
    }
    for panel, (panel_title, outcomes) in zip(axes.flat, by_value.items(), strict=False):
        for outcome, (label, color) in outcomes.items():
            _dots(panel, dose, at, outcome, color, label)
        panel.set(title=panel_title, ylim=(0, 1.03 if "share" in panel_title else None), xlabel=key)
        if panel.get_legend_handles_labels()[0]:  # no vehicle may have looked at a gap
            panel.legend(fontsize=8)
        if not numeric:
            panel.set_xticks(list(at.values()), [str(value) for value in values])

    survival, counted = axes[1, 1], requests[requests["counted"]]
    for value, color in zip(values, plt.get_cmap("viridis")(np.linspace(0.0, 0.85, len(values))), strict=True):
        mine = counted[counted[key] == value]
        if len(mine):
            curve = kaplan_meier(mine["waited_s"].to_numpy(float), mine["accepted"].to_numpy(float))
            level = np.concatenate([[1.0], curve.surv_prob])
            times = np.concatenate([[0.0], curve.surv_times, [max(mine["waited_s"].max(), 0.01)]])
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


# The page -------------------------------------------------------------------------------------------------------------


def page_text(study: Study, named: Mapping[str, pd.DataFrame], keys: Sequence[str], drawn: Sequence[str] = ()) -> str:
    """What the study shows and what it does not; behind each claim the table and column that it is read from."""
    requests, runs, dose = named["requests"], named["runs"], named["dose_response"]
    if requests.empty:
        return f"# {study.name}\n\nNo run has a request of the kind {study.kind}: nothing can be said.\n"
    counted, due = requests[requests["counted"]], requests["waited_s"].notna()
    config = study.configs[0][0]
    accepted, exported = counted["accepted"].astype(bool), counted["exported"].dropna()
    gives_up_s = counted["point"].map(dict(enumerate(give_up_of(study))))
    cut_off = ~accepted & (counted["waited_s"] < gives_up_s - 0.05)
    return text(
        "study.md.j2",
        study=study,
        config=config,
        runs={"all": len(runs), "failed": int((runs["status"] != DONE).sum())},
        requests={
            "all": len(requests),
            "counted": len(counted),
            "accepted": int(accepted.sum()),
            "never": int((~due).sum()),
            "other": int((~requests["counted"] & due).sum()),
        },
        scenes=counted["scene"].nunique(),
        flows=config.flow.veh_per_h_lane > 0.0,
        replays=set(requests["replay"]),
        keys=keys,
        told={key: _told(dose[dose["parameter"] == key]) for key in keys if key in set(dose.get("parameter", ()))},
        seeds=[line for key in keys if (line := _seeds_line(requests, key))],
        clusters=int(dose["clusters"].max()) if len(dose) else 0,
        critical=_records(named["critical_gaps"]),
        changes=named["lane_changes"],
        conflicts=named["conflicts"],
        rising=_rising(named["flow"]),
        flow=named["flow"],
        reasons=counted.loc[~accepted, "reason"].value_counts().to_dict(),
        exported_share=None if exported.empty else float((exported == "yes").mean()),
        crossed=len(study.points) == math.prod(len({point[key] for point in study.points}) for key in study.keys),
        uncrossed=int((accepted & counted["crossing_s"].isna()).sum()),
        overlapping=int(counted["overlaps"].isin([True]).sum()),
        cut_share=float(cut_off.mean()) if len(counted) else 0.0,
        figures=drawn,
    )


def _rising(flow: pd.DataFrame) -> tuple[float, float] | None:
    """Flow in the first minute counted and after it, veh/h per lane, where it still rises by more than a tenth."""
    if flow.empty or flow["from_s"].nunique() < 2:
        return None
    is_first = flow["from_s"] == flow["from_s"].min()
    first, later = (float(flow.loc[rows, "flow_veh_per_h_lane"].mean()) for rows in (is_first, ~is_first))
    return (first, later) if first < 0.9 * later else None


def _records(table: pd.DataFrame) -> list[dict[Any, Any]]:
    """The rows of a table; what is missing is None."""
    return table.astype(object).where(table.notna(), None).to_dict("records")


def _told(dose: pd.DataFrame) -> dict[str, Any]:
    """Of a parameter: rows of each outcome known at two values; of requests, where they differ in number."""
    counts, known = dose[dose["outcome"] == OUTCOMES[0].name], dose[dose["estimate"].notna()]
    rows = [(one, _records(known[known["outcome"] == one.name])) for one in OUTCOMES]
    return {
        "counts": _records(counts) if counts["rows"].nunique() > 1 else [],
        "outcomes": [(one, own) for one, own in rows if len(own) > 1],
    }


def _seeds_line(requests: pd.DataFrame, key: str) -> str | None:
    """How many seeds differences of some sizes in the share accepted need, by the runs that there are."""
    found = difference_sd(requests, key)
    if found is None:
        return None
    (sd, runs), seeds = found, requests["seed"].nunique()
    needed = (f"{math.ceil(seeds_needed(sd, size) * seeds / runs)} for {size:g}" for size in _SIZES_TOLD)
    return (
        f"{key}: the difference of the share between first and last value has an SD of {sd:.3f} from run to "
        f"run ({runs} runs). Seeds needed at power .8, by a paired t test, which assumes more than the signs above: "
        f"{', '.join(needed)} [requests.accepted]."
    )
