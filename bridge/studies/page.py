"""The results of a study: tables as CSV and parquet with a data dictionary, figures, and a page of text."""

import gzip
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from bridge.files import beside, explained, write_rows, write_text
from bridge.studies.columns import dictionary_rows
from bridge.studies.statistics import (
    OUTCOMES,
    CriticalGap,
    acceptance_curve,
    critical_gap,
    dose_response,
    effects,
    gaps_of,
)
from bridge.studies.study import Study, Tables
from bridge.studies.study_figures import CRITICAL, draw_fundamental, draw_parameter, label_of
from hid2.agents import FloatArray

_SAYS = {outcome.name: outcome.says for outcome in OUTCOMES}
#: Outcomes that the page speaks of, in this order.
_TOLD = (
    "share_accepted",
    "share_accepted_of_looking",
    "mean_wait_s",
    "gaps_accepted",
    "looks_refused_by_sumo",
    "lateral_s",
    "lag_time_gap_s",
    "share_ttc_below_critical",
)


def write_results(study: Study, tables: Tables, out_dir: Path) -> list[Path]:
    """Write everything that a study says into out_dir; returns the files. Errors: ExportError."""
    keys = ["trigger_after_s" if key == "trigger_s" else key for key in study.keys]
    give_up_s = study.configs[0][0].lane_change.give_up_s
    gaps = gaps_of(tables.looks, keys)
    if not gaps.empty and not tables.requests.empty:
        counted = tables.requests.loc[tables.requests["counted"], ["scene", "point", "seed", "vehicle"]]
        gaps = gaps.merge(counted, on=["scene", "point", "seed", "vehicle"])
    files: list[Path] = []
    named: dict[str, pd.DataFrame] = {
        "runs": tables.runs, "requests": tables.requests, "looks": tables.looks, "gaps": gaps, "flow": tables.flow,
    }  # fmt: skip
    dose, acceptance, critical = pd.DataFrame(), [], []
    if not tables.requests.empty and tables.requests["counted"].any():
        parts = [
            dose_response(
                tables.requests, gaps, key, give_up_s=give_up_s, critical_ttc_s=CRITICAL.ttc_min_s
            ) for key in keys if tables.requests[key].nunique() <= _MOST_VALUES
        ]  # fmt: skip
        dose = pd.concat(parts) if parts else dose
        for key in keys:
            if tables.requests[key].nunique() > _MOST_VALUES:
                continue
            values = sorted(tables.requests[key].unique())
            curves = {value: acceptance_curve(gaps[gaps[key] == value]) if len(gaps) else None for value in values}
            acceptance += [_curve_row(key, value, curve) for value, curve in curves.items() if curve is not None]
            for value in values:
                found = critical_gap(gaps[gaps[key] == value]) if len(gaps) else None
                if found is not None:
                    critical.append(_critical_row(key, value, found))
            path = out_dir / f"{study.name}_{key.replace('.', '_')}.png"
            title = f"{_title(study, tables)}; bars: 95 % intervals, runs drawn again"
            draw_parameter(
                path, title, key, dose=dose[dose["parameter"] == key], requests=tables.requests,
                curves=curves, give_up_s=give_up_s,
            )  # fmt: skip
            files.append(path)
        named["effects"] = effects(tables.requests, keys, give_up_s=give_up_s)
    named |= {
        "dose_response": dose, "acceptance": pd.DataFrame(acceptance), "critical_gaps": pd.DataFrame(critical),
    }  # fmt: skip
    if not tables.flow.empty:
        path = out_dir / f"{study.name}_fundamental.png"
        varied = next((key for key in keys if 1 < tables.flow[key].nunique() <= _MOST_VALUES), None)
        draw_fundamental(path, _title(study, tables), tables.flow, varied)
        files.append(path)
    written = []
    for name, table in named.items():
        if not table.empty:
            written += _write_table(out_dir, name, table)
    dictionary = out_dir / "columns.csv"
    with explained(dictionary):
        write_rows(dictionary, ("table", "column", "says"), dictionary_rows())
    page = out_dir / "study.md"
    with explained(page):
        write_text(page, page_text(study, tables, named, keys))
    return [page, *files, dictionary, *written]


#: A parameter with more values than this has no dose-response of its own: its effect is in effects.csv.
_MOST_VALUES = 12
#: A larger share of requests that are cut off is spoken of.
_CUT_SHARE = 0.02
#: Tables of more rows are compressed.
_LONG = 50_000


def _write_table(out_dir: Path, name: str, table: pd.DataFrame) -> list[Path]:
    """CSV (compressed where it is long) and parquet."""
    long = len(table) > _LONG
    csv_path = out_dir / (f"{name}.csv.gz" if long else f"{name}.csv")
    parquet_path = out_dir / f"{name}.parquet"
    mixed = [column for column in table.columns if table[column].dtype == object]
    tidy = table.assign(**{column: table[column].astype("string") for column in mixed})
    arrow = pa.Table.from_pandas(tidy, preserve_index=False).replace_schema_metadata(None)
    text, columnar = io.BytesIO(), io.BytesIO()
    pa_csv.write_csv(arrow, text, pa_csv.WriteOptions(quoting_style="needed"))
    pq.write_table(arrow, columnar)
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


def _curve_row(key: str, value: Any, curve: Mapping[str, Any]) -> dict[str, Any]:  # noqa: ANN401
    row: dict[str, Any] = {"parameter": key, "value": value}
    if "separated" in curve:
        return {**row, "separated": curve["separated"]}
    error = float(curve["covariance"][1, 1]) ** 0.5
    return {
        **row, **{name: curve[name] for name in ("intercept", "lag", "lead", "lead_s", "gaps", "accepted")},
        "lag_low": curve["lag"] - 1.96 * error, "lag_high": curve["lag"] + 1.96 * error, "separated": None,
    }  # fmt: skip


def _critical_row(key: str, value: Any, found: CriticalGap) -> dict[str, Any]:  # noqa: ANN401
    return {
        "parameter": key, "value": value, "mean_s": found.mean.value, "mean_low_s": found.mean.low,
        "mean_high_s": found.mean.high, "sd_s": found.sd.value, "raff_s": found.raff, "drivers": found.drivers,
        "inconsistent": found.inconsistent,
    }  # fmt: skip


# The page -------------------------------------------------------------------------------------------------------------


def page_text(
    study: Study, tables: Tables, named: Mapping[str, pd.DataFrame], keys: Sequence[str]
) -> str:  # fmt: skip
    """What the study shows and what it does not; behind each claim the table and column that it is read from."""
    requests, runs = tables.requests, tables.runs
    if requests.empty:
        return f"# {study.name}\n\nNo run has a request of the kind {study.kind}: nothing can be said.\n"
    counted = requests[requests["counted"]]
    config = study.configs[0][0]
    failed = int((runs["status"] != "done").sum())
    scenes = requests["scene"].nunique()
    begun = (
        f"{len(runs)} runs ({failed} without a result) of {len(study.points)} points with {len(study.seeds)} seeds on "
        f"{scenes} scene{'s' if scenes > 1 else ''} [runs.status, requests.scene]. {len(requests)} requests for a "
        f"{study.kind.replace('_', ' ')}, {len(counted)} of them counted [requests.counted]."
    )
    paired = (
        "Paired: vehicles, drivers, sites, traffic and SUMO's seed are the same at every point, and only what is "
        "varied differs. Sites are drawn from all that are admissible, whether or not the manoeuvre can come off "
        "there; nothing is replaced."
    )
    unpaired = "Not paired along what changes the traffic itself: its values are compared between different vehicles."
    cut_off = _not_counted(requests, config.flow.warm_up_s if config.flow.veh_per_h_lane > 0.0 else None)
    lines = [
        f"# {study.name.replace('_', ' ')}",
        "",
        begun,
        "",
        "## Design",
        "",
        f"Varied: {', '.join(label_of(key) for key in keys)}. {paired if study.paired else unpaired}",
        "",
        f"All is measured as simulated. {cut_off}",
    ]
    exported = counted["exported"].dropna()
    if len(exported):
        share = 100 * float((exported == "yes").mean())
        text = (
            f"{share:.0f} % of those counted that start in a scene could be exported as they are; the rest would be "
            "replaced by `hid2 generate`, and is kept here [requests.exported]."
        )
        lines += ["", text]
    dose = named["dose_response"]
    for key in keys:
        mine = dose[dose["parameter"] == key] if not dose.empty else dose
        if mine.empty:
            continue
        lines += ["", f"## {label_of(key)}", ""]
        lines += [f"- {line}" for line in _told(mine)]
        lines += _critical_lines(named["critical_gaps"], key)
        lines += _curve_lines(named["acceptance"], key)
    lines += _effect_lines(named.get("effects", pd.DataFrame()), keys)
    lines += _flow_lines(tables.flow)
    reasons = counted.loc[~counted["accepted"].astype(bool), "reason"].value_counts()
    if len(reasons):
        named_reasons = ", ".join(f"{reason} {count}" for reason, count in reasons.head(6).items())
        lines += ["", "## Not accepted", "", f"Last reasons [requests.reason]: {named_reasons}."]
    lines += ["", "## What it does not show", "", *(f"- {line}" for line in _limits(study, requests))]
    return "\n".join(lines) + "\n"


def _not_counted(requests: pd.DataFrame, warm_up_s: float | None) -> str:
    """How many requests are left out, and why. warm_up_s: of a flow, None without one."""
    never = int(requests["waited_s"].isna().sum())
    text = f"Not counted: {never} requests that were never due (no site, or gone before the trigger)"
    if warm_up_s is not None:
        warm = int((~requests["counted"] & requests["waited_s"].notna()).sum())
        text += f", and {warm} from the warm-up of {warm_up_s:g} s, which is cut off"
    return text + " [requests.counted]."


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
        found.append(f"{text} [dose_response.estimate of {outcome}].")
    return found


def _course(steps: FloatArray) -> str:
    """How an outcome goes from value to value."""
    if (np.abs(steps) <= _SAME).all():
        return "the same at every step"
    if (steps <= _SAME).all():
        return "does not rise at any step"
    return "does not fall at any step" if (steps >= -_SAME).all() else "goes up and down"


_SAME = 1e-9


def _critical_lines(critical: pd.DataFrame, key: str) -> list[str]:
    mine = critical[critical["parameter"] == key] if not critical.empty else critical
    return [
        f"- critical lag time gap at {row['value']}: {row['mean_s']:.2f} s"
        + (f" ({row['mean_low_s']:.2f} to {row['mean_high_s']:.2f})" if pd.notna(row["mean_low_s"]) else "")
        + (f", Raff's {row['raff_s']:.2f} s" if pd.notna(row["raff_s"]) else "")
        + f", {row['drivers']} drivers [critical_gaps.mean_s, critical_gaps.raff_s, critical_gaps.drivers]."
        for _, row in mine.iterrows()
    ]


def _curve_lines(acceptance: pd.DataFrame, key: str) -> list[str]:
    mine = acceptance[acceptance["parameter"] == key] if not acceptance.empty else acceptance
    if "lag" not in mine:
        return []
    lines = []
    for _, row in mine[mine["lag"].notna()].iterrows():
        odds, low, high = (math.exp(row[name]) for name in ("lag", "lag_low", "lag_high"))
        lines.append(
            f"- at {row['value']} a second more of lag time gap multiplies the odds of acceptance by {odds:.2g} "
            f"({low:.2g} to {high:.2g}) [acceptance.lag]."
        )
    return lines


def _effect_lines(found: pd.DataFrame, keys: Sequence[str]) -> list[str]:
    if found.empty or len(keys) < 2:
        return []
    lines = ["", "## Effects over the whole design", ""]
    told = found[(found["drawn_again"] == "runs") & found["standardised_coefficient"].notna()]
    for _, row in told.iterrows():
        index = row.get("first_order")
        lines.append(
            f"- {row['outcome']} by {label_of(row['parameter'])}: standardised coefficient "
            f"{row['standardised_coefficient']:+.2f}"
            + (f" ({row['low']:+.2f} to {row['high']:+.2f})" if pd.notna(row["low"]) else "")
            + " [effects.standardised_coefficient]"
            + (
                f"; first-order index {index:.2f} +- {row['first_order_interval']:.2f} [effects.first_order]"
                if pd.notna(index)
                else ""
            )
            + "."
        )
    return lines


def _flow_lines(flow: pd.DataFrame) -> list[str]:
    if flow.empty:
        return []
    flow_mean, density, speed, wait = (
        flow[column].mean()
        for column in ("flow_veh_per_h_lane", "density_veh_per_km_lane", "speed_kmph", "waiting_to_enter_s")
    )
    text = (
        f"Flow {flow_mean:.0f} veh/h per lane, density {density:.0f} veh/km per lane, speed {speed:.0f} km/h, "
        f"mean over intervals of 30 s after the warm-up; wait before the map {wait:.1f} s "
        "[flow.flow_veh_per_h_lane, flow.density_veh_per_km_lane, flow.speed_kmph, flow.waiting_to_enter_s]."
    )
    return ["", "## Traffic", "", text]


def _limits(study: Study, requests: pd.DataFrame) -> list[str]:
    decide = "How people decide: rules and car-following models decide here, with drivers drawn from distributions"
    found = [f"{decide} (`hid2 config`)."]
    if study.configs[0][0].flow.veh_per_h_lane > 0.0:
        found.append("Real traffic: the flow is simulated, its headways are a shifted exponential distribution.")
    modes = set(requests["replay"])
    if "reactive" in modes:
        found.append(
            "Traffic as it was recorded: with driving.replay = reactive recorded vehicles keep their path and yield in "
            "time by SUMO's car following (Krauss); nobody drove so [requests.replay]."
        )
    if "fixed" in modes and study.configs[0][0].flow.veh_per_h_lane == 0.0:
        found.append("Followers that react: recorded vehicles drive as recorded, whoever changes lanes before them.")
    counted = requests[requests["counted"]]
    cut = (~counted["accepted"].astype(bool)) & (counted["waited_s"] < study.configs[0][0].lane_change.give_up_s - 0.05)
    if len(counted) and cut.mean() > _CUT_SHARE:
        found.append(
            f"Chances of one length: {100 * cut.mean():.0f} % of the requests counted ended without a gap before the "
            "longest wait, because the vehicle left or the scene ended; shares accepted compare what was left of it, "
            "waiting times take it as censored [requests.observed_to_s]."
        )
    scenes = requests["scene"].nunique()
    if scenes < 3:
        found.append(
            f"Other roads: {scenes} scene{'s were' if scenes > 1 else ' was'} studied; intervals are over runs "
            "[requests.scene]."
        )
    elif scenes < 10:
        found.append(f"Other roads, with much confidence: {scenes} scenes were drawn again [requests.scene].")
    return found
