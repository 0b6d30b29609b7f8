"""The results of a study: tables as CSV and parquet with a data dictionary, figures, and a page of text."""

import gzip
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from bridge.batch.manifest import DONE
from bridge.files import beside, explained, table_cell, write_rows, write_text
from bridge.pages.parts import text
from bridge.studies.columns import OUTCOMES, dictionary_rows
from bridge.studies.gap_acceptance import acceptance_curve, critical_gap, gaps_of
from bridge.studies.statistics import difference_sd, dose_response, effects, seeds_needed
from bridge.studies.study import Study, Tables
from bridge.studies.study_figures import CRITICAL, draw_fundamental, draw_parameter, label_of
from hid2.agents import FloatArray
from hid2.measures.conflicts import CONFLICT_TTC_S, TrafficConflict
from hid2.measures.lane_changes import LaneChangeRow

_SAYS = {outcome.name: outcome.says for outcome in OUTCOMES}
#: Outcomes that the page speaks of, in this order.
_TOLD = (
    "share_accepted",
    "share_accepted_of_looking",
    "mean_wait_s",
    "gaps_accepted",
    "refused_by_rule",
    "refused_by_cells",
    "refused_by_guard",
    "refused_by_sumo",
    "lateral_s",
    "lag_time_gap_s",
    "share_ttc_below_critical",
    "share_overlapping",
    "lag_drac_mps2",
    "lag_brakes_mps2",
)


def write_results(study: Study, tables: Tables, out_dir: Path) -> list[Path]:
    """Write everything that a study says into out_dir; returns the files. Errors: ExportError."""
    keys = ["trigger_after_s" if key == "trigger_s" else key for key in study.keys]
    give_up_s = study.configs[0][0].lane_change.give_up_s
    requests, gaps = tables.requests, gaps_of(tables.looks, keys)
    if not gaps.empty and not requests.empty:
        counted = requests.loc[requests["counted"], ["scene", "point", "seed", "vehicle"]]
        gaps = gaps.merge(counted, on=["scene", "point", "seed", "vehicle"])
    files: list[Path] = []
    named = {
        "runs": tables.runs, "requests": requests, "looks": tables.looks, "gaps": gaps, "flow": tables.flow,
        "lane_changes": tables.lane_changes, "conflicts": tables.conflicts,
    }  # fmt: skip
    doses, acceptance, critical = [], [], []
    any_counted = not requests.empty and bool(requests["counted"].any())
    for key in keys:
        if not any_counted or requests[key].nunique() > _MOST_VALUES:
            continue
        dose = dose_response(requests, gaps, key, give_up_s=give_up_s, critical_ttc_s=CRITICAL.ttc_min_s)
        doses.append(dose)
        curves: dict[Any, dict[str, Any] | None] = {}
        for value in sorted(requests[key].unique()):
            own = gaps[gaps[key] == value] if len(gaps) else gaps
            curves[value] = curve = acceptance_curve(own) if len(own) else None
            acceptance += [{"parameter": key, "value": value, **curve}] if curve is not None else []
            for side in ("lag", "lead"):
                found = critical_gap(own, side) if len(own) else None
                critical += [{"parameter": key, "value": value, **found}] if found is not None else []
        path = out_dir / f"{study.name}_{key.replace('.', '_')}.png"
        title = f"{_title(study, tables)}; bars: 95 % intervals, runs drawn again"
        draw_parameter(path, title, key, dose=dose, requests=requests, curves=curves, give_up_s=give_up_s)
        files.append(path)
    if any_counted:
        named["effects"] = effects(requests, keys, give_up_s=give_up_s)
    named |= {
        "dose_response": pd.concat(doses) if doses else pd.DataFrame(),
        "acceptance": pd.DataFrame(acceptance).drop(columns="fit", errors="ignore"),
        "critical_gaps": pd.DataFrame(critical),
    }
    if not tables.flow.empty:
        path = out_dir / f"{study.name}_fundamental.png"
        varied = next((key for key in keys if 1 < tables.flow[key].nunique() <= _MOST_VALUES), None)
        draw_fundamental(path, _title(study, tables), tables.flow, varied)
        files.append(path)
    for name, row in (("lane_changes", LaneChangeRow), ("conflicts", TrafficConflict)):
        if named[name].empty:  # the table says so
            named[name] = pd.DataFrame(columns=[field.name for field in fields(row)])
    written = [
        path for name, table in named.items() if len(table.columns) for path in _write_table(out_dir, name, table)
    ]
    dictionary, page = out_dir / "columns.csv", out_dir / "study.md"
    with explained(dictionary):
        write_rows(dictionary, ("table", "column", "says"), dictionary_rows())
    with explained(page):
        write_text(page, page_text(study, tables, named, keys, figures=[path.name for path in files]))
    return [page, *files, dictionary, *written]


#: A parameter with more values than this has no dose-response of its own: its effect is in effects.csv.
_MOST_VALUES = 12
#: Tables of more rows are compressed.
_LONG = 50_000


def _write_table(out_dir: Path, name: str, table: pd.DataFrame) -> list[Path]:
    """CSV (compressed where it is long) and parquet."""
    long = len(table) > _LONG
    csv_path = out_dir / (f"{name}.csv.gz" if long else f"{name}.csv")
    parquet_path = out_dir / f"{name}.parquet"
    mixed = [column for column in table.columns if table[column].dtype == object]
    texts_of = {column: table[column].map(lambda cell: str(cell).lower() if isinstance(cell, bool) else cell)
                for column in mixed}  # fmt: skip
    tidy = table.assign(**{column: cells.astype("string") for column, cells in texts_of.items()})
    texts = tidy.select_dtypes(exclude=["number", "bool"]).columns
    safe = tidy.assign(**{column: tidy[column].map(table_cell, na_action="ignore") for column in texts})
    each = (pa.Table.from_pandas(one, preserve_index=False) for one in (tidy, safe))
    exact, shown = (one.replace_schema_metadata(None) for one in each)
    text, columnar = io.BytesIO(), io.BytesIO()
    pa_csv.write_csv(shown, text, pa_csv.WriteOptions(quoting_style="needed"))
    pq.write_table(exact, columnar)
    csv_bytes = gzip.compress(text.getvalue(), mtime=0) if long else text.getvalue()
    for path, content in ((csv_path, csv_bytes), (parquet_path, columnar.getvalue())):
        with explained(path), beside(path) as hidden:
            hidden.write_bytes(content)
    return [csv_path, parquet_path]


def _title(study: Study, tables: Tables) -> str:
    counted = int(tables.requests["counted"].sum())
    scenes = tables.requests["scene"].nunique()
    return (
        f"{study.name.replace('_', ' ')}: {counted} requests counted in {len(tables.runs)} runs on {scenes} "
        f"scene{'s' if scenes > 1 else ''}"
    ) + ("; recorded vehicles react" if set(tables.requests["replay"]) == {"reactive"} else "")


# The page -------------------------------------------------------------------------------------------------------------


_FLOW = ("flow_veh_per_h_lane", "density_veh_per_km_lane", "speed_kmph", "waiting_to_enter_s")


def page_text(
    study: Study, tables: Tables, named: Mapping[str, pd.DataFrame], keys: Sequence[str], figures: Sequence[str] = ()
) -> str:
    """What the study shows and what it does not; behind each claim the table and column that it is read from."""
    requests, runs, flow = tables.requests, tables.runs, tables.flow
    if requests.empty:
        return f"# {study.name}\n\nNo run has a request of the kind {study.kind}: nothing can be said.\n"
    counted, due = requests[requests["counted"]], requests["waited_s"].notna()
    config = study.configs[0][0]
    accepted, exported = counted["accepted"].astype(bool), counted["exported"].dropna()
    cut_off = ~accepted & (counted["waited_s"] < config.lane_change.give_up_s - 0.05)
    dose, effects_found = named["dose_response"], named.get("effects", pd.DataFrame())
    return text(
        "study.md.j2",
        study=study,
        config=config,
        runs={"all": len(runs), "failed": int((runs["status"] != DONE).sum())},
        requests={
            "all": len(requests), "counted": len(counted), "never": int((~due).sum()),
            "warm": int((~requests["counted"] & due).sum()),
        },
        scenes=requests["scene"].nunique(),
        flows=config.flow.veh_per_h_lane > 0.0,
        replays=set(requests["replay"]),
        labels={key: label_of(key) for key in keys},
        told={key: _told(dose[dose["parameter"] == key]) for key in keys if key in set(dose.get("parameter", ()))},
        seeds=[line for key in keys if (line := _seeds_line(requests, key))],
        clusters=_few_clusters(dose),
        critical=_records(named["critical_gaps"]),
        curves=_records(named["acceptance"]),
        effects=_effect_lines(effects_found, keys),
        changes=tables.lane_changes,
        conflicts=_conflict_counts(tables.conflicts),
        flow={} if flow.empty else {column: flow[column].mean() for column in _FLOW},
        reasons=_last_reasons(counted[~accepted], named["gaps"]),
        by_value={key: _by_value(named, key) for key in keys if 1 < requests[key].nunique() <= _MOST_VALUES},
        exported_share=None if exported.empty else float((exported == "yes").mean()),
        cut_share=float(cut_off.mean()) if len(counted) else 0.0,
        exp=math.exp,
        figures=figures,
    )  # fmt: skip


def _last_reasons(refused: pd.DataFrame, gaps: pd.DataFrame) -> list[str]:
    """The most frequent answers to the last gap that vehicles without one looked at, or why they looked at none."""
    same = ["scene", "point", "seed", "vehicle"]
    reasons = refused.set_index(same)["reason"]
    if not gaps.empty:
        last = gaps.sort_values("to_s", kind="stable").drop_duplicates(same, keep="last").set_index(same)["became"]
        reasons = last.reindex(reasons.index).fillna(reasons)
    return [f"{reason} {count}" for reason, count in reasons.value_counts()[:6].items()]


def _by_value(named: Mapping[str, pd.DataFrame], key: str) -> list[str]:
    """One line for each value of a parameter: lane changes, conflicts, flow and speed of all traffic there."""
    lines = []
    for value in sorted(named["runs"][key].unique()):
        own = {name: table[table[key] == value] if key in table else table for name, table in named.items()}
        line = (
            f"at {value}: {len(own['lane_changes'])} lane changes and {len(own['conflicts'])} conflicts of any vehicle"
        )
        told = "lane_changes.track_id, conflicts.kind"
        if len(own["flow"]):
            flow, speed = (own["flow"][name].mean() for name in ("flow_veh_per_h_lane", "speed_kmph"))
            line += f", {flow:.0f} veh/h per lane at {speed:.0f} km/h"
            told += ", flow.flow_veh_per_h_lane, flow.speed_kmph"
        lines.append(f"{line} [{told}].")
    return lines


def _conflict_counts(found: pd.DataFrame) -> str | None:
    """Conflicts by class, and how many have a TTC below SSAM's threshold; None without any."""
    if found.empty:
        return None
    kinds = ", ".join(f"{kind} {count}" for kind, count in found["kind"].value_counts().items())
    return f"{kinds}; {int(found['ttc_s'].notna().sum())} with a TTC below {CONFLICT_TTC_S:g} s"


def _records(table: pd.DataFrame) -> list[dict[Any, Any]]:
    """The rows of a table; what is missing is None."""
    return table.astype(object).where(table.notna(), None).to_dict("records")


def _told(dose: pd.DataFrame) -> list[str]:
    """One sentence for each outcome: from the first value to the last, with the interval of the difference.

    Before them how many requests there were, where these are not as many at each value.
    """
    found = []
    counts = dose[dose["outcome"] == _TOLD[0]]
    if counts["rows"].nunique() > 1:
        found.append(
            "requests counted: "
            + ", ".join(f"{row['rows']} at {row['value']}" for _, row in counts.iterrows())
            + "; the others were not due any more when their vehicle left or the scene ended [dose_response.rows]."
        )
    for outcome in _TOLD:
        mine = dose[(dose["outcome"] == outcome) & dose["estimate"].notna()]
        if len(mine) < 2:
            continue
        first, last = mine.iloc[0], mine.iloc[-1]
        if mine["estimate"].nunique() == 1:
            found.append(
                f"{_SAYS[outcome]}: {first['estimate']:.3g} at every value [dose_response.estimate of {outcome}]."
            )
            continue
        course = _course(mine["estimate"].diff().dropna().to_numpy(float))
        unit = "scenes" if "difference_low_scenes" in mine and pd.notna(last.get("difference_low_scenes")) else "runs"
        low, high = last[f"difference_low_{unit}"], last[f"difference_high_{unit}"]
        text = (
            f"{_SAYS[outcome]}: {first['estimate']:.3g} at {first['value']}, {last['estimate']:.3g} at "
            f"{last['value']}; {course}"
        )
        if pd.notna(low):
            low, high = (0.0 if abs(bound) <= _SAME else bound for bound in (low, high))
            sure = "which excludes no effect" if low > 0 or high < 0 else "which includes no effect"
            text += f"; difference {last['difference']:+.3g}, 95 % interval {low:+.3g} to {high:+.3g} ({unit}), {sure}"
        if pd.notna(last.get("p_holm")):
            text += f"; trend {last['trend']:+.3g} for one more of {label_of(last['parameter'])}"
            text += f" ({last['trend_low']:+.3g} to {last['trend_high']:+.3g})" if pd.notna(last["trend_low"]) else ""
            text += f", p {last['p']:.2g} by signs of {last['clusters']:.0f} {unit}"
            text += f", {last['p_holm']:.2g} of all outcomes (Holm)"
        found.append(f"{text} [dose_response.estimate of {outcome}].")
    return found


def _seeds_line(requests: pd.DataFrame, key: str) -> str | None:
    """How many seeds differences of some sizes in the share accepted need, by the runs that there are."""
    found = difference_sd(requests, key)
    if found is None:
        return None
    (sd, runs), scenes = found, requests["scene"].nunique()
    needed = (f"{math.ceil(seeds_needed(sd, size) / scenes)} for {size:g}" for size in _SIZES_TOLD)
    return (
        f"{label_of(key)}: the difference of the share between first and last value has an SD of {sd:.3f} from run to "
        f"run ({runs} runs). Seeds needed for a difference at power .8: {', '.join(needed)} [requests.accepted]."
    )


def _few_clusters(dose: pd.DataFrame) -> tuple[int, int] | None:
    """How many clusters there are, and from how many a test by signs can be sure; None where there are enough."""
    if "p_holm" not in dose:
        return None
    told = dose.dropna(subset="p_holm")
    there, family = int(told["clusters"].min()), told.groupby("parameter")["outcome"].nunique().max()
    least = math.ceil(1.0 + math.log2(family / 0.05))
    return (there, least) if there < least else None


#: Differences of shares for which the page says how many seeds they need.
_SIZES_TOLD = (0.02, 0.05, 0.1)


def _course(steps: FloatArray) -> str:
    """How an outcome goes from value to value."""
    if (np.abs(steps) <= _SAME).all():
        return "the same at every step"
    if (steps <= _SAME).all():
        return "does not rise at any step"
    return "does not fall at any step" if (steps >= -_SAME).all() else "goes up and down"


_SAME = 1e-9


def _effect_lines(found: pd.DataFrame, keys: Sequence[str]) -> list[str]:
    if found.empty or len(keys) < 2:
        return []
    lines = []
    told = found[(found["drawn_again"] == "runs") & found["standardised_coefficient"].notna()]
    for _, row in told.iterrows():
        line = f"{row['outcome']} by {label_of(row['parameter'])}: standardised coefficient "
        line += f"{row['standardised_coefficient']:+.2f}"
        line += f" ({row['low']:+.2f} to {row['high']:+.2f})" if pd.notna(row["low"]) else ""
        line += " [effects.standardised_coefficient]"
        if pd.notna(row.get("first_order")):
            line += f"; first-order index {row['first_order']:.2f} +- {row['first_order_interval']:.2f}"
            line += " [effects.first_order]"
        lines.append(f"{line}.")
    return lines
