"""report.html: what an evaluation found, in one file that needs neither the paper nor the code to be understood."""

import html
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from bridge.evaluation.charts import distribution_figure, diversity_figure, reason_words
from bridge.evaluation.totals import Evaluation
from bridge.files import write_text
from bridge.pictures import figures
from bridge.pictures.render import scene_figure
from bridge.recordings.sidecar import AgentRecord, sidecar_in
from hid2.evaluation.realism import FEATURES

_GROUP_NAMES = {"original": "original (recorded)", "generated": "generated", "combined": "combined"}
_PAIR_NAMES = {
    "original_original": "recorded with recorded",
    "generated_original": "generated with recorded",
    "generated_generated": "generated with generated",
}
#: The paper's Table 1, Argoverse 2.
PAPER_ORIGINAL = {"lo": 1.648, "la": 0.476, "je": 8.106, "scr": 0.072, "orr": 0.142}
PAPER_HID2 = {"lo": 1.465, "la": 0.486, "je": 7.801, "scr": 0.051, "orr": 0.114}

_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#222;max-width:1080px;margin:2em auto;padding:0 1em}
h1{font-size:1.6em}h2{font-size:1.25em;margin-top:2.2em;border-bottom:1px solid #ccc}
table{border-collapse:collapse;margin:.8em 0;font-size:.92em}
th,td{padding:.25em .8em;border-bottom:1px solid #e4e4e4;text-align:left;vertical-align:top}
td.n,th.n{text-align:right;font-variant-numeric:tabular-nums}small{color:#666;white-space:nowrap}
img{max-width:100%;margin:.5em 0}figcaption{color:#555;font-size:.92em}figure{margin:1em 0}
.good{color:#00684c;font-weight:600}.bad{color:#a03c00;font-weight:600}
"""


def write_report(evaluation: Evaluation, path: Path) -> None:
    """Write the report of an evaluation. Errors: OSError."""
    figures.style()
    metrics = evaluation.metrics
    parts = [
        _intro(metrics),
        _glance(metrics),
        _example(evaluation),
        _safety(metrics),
        _kinematics(metrics),
        _realism(evaluation),
        "<h2>Diversity</h2>",
        *diversity_parts(metrics["diversity"]),
        _requests(metrics),
        _fidelity(metrics),
        _words(),
    ]
    write_text(path, page("Generated traffic scenes: evaluation", parts))


def page(title: str, parts: Iterable[str]) -> str:
    """A whole HTML page without outside references."""
    body = "\n".join(part for part in parts if part)
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title>'
        f"<style>{_STYLE}</style></head><body><h1>{html.escape(title)}</h1>\n{body}\n</body></html>\n"
    )


def table(head: Sequence[str], rows: Iterable[Sequence[str]], *, numbers: int | None = None) -> str:
    """An HTML table: the first column is text, the `numbers` next ones (None: all) are numbers. Cells are HTML."""
    last = len(head) if numbers is None else numbers

    def cells(tag: str, row: Sequence[str]) -> str:
        return "".join(f"<{tag}{' class=n' if 0 < k <= last else ''}>{cell}</{tag}>" for k, cell in enumerate(row))

    heading = cells("th", head)
    lines = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return f"<table><tr>{heading}</tr>{lines}</table>"


def picture(figure: Figure, caption: str) -> str:
    """A figure with a caption, inside the page."""
    image = f'<img alt="{html.escape(caption)}" src="{figures.data_uri(figure)}">'
    return f"<figure>{image}<figcaption>{caption}</figcaption></figure>"


def number(value: float | None, digits: int = 3) -> str:
    """A figure for a table; a dash where there is none. What is more than 0 does not look like 0."""
    if value is None:
        return "–"
    least = 10.0**-digits
    return f"&lt; {least:.{digits}f}" if 0 < value < least / 2 else f"{value:.{digits}f}"


def with_interval(entry: Mapping[str, float | None], digits: int = 3) -> str:
    """A value with its 95 % interval in small print."""
    text = number(entry["value"], digits)
    if entry["low"] is None or entry["high"] is None:
        return text
    return f"{text}<br><small>{number(entry['low'], digits)} to {number(entry['high'], digits)}</small>"


def _intro(metrics: Mapping[str, Any]) -> str:
    scenes = metrics["scenes"]
    failed = "".join(
        f"<li>{html.escape(item['folder'])}: {html.escape(item['reason'])}</li>" for item in scenes["failed"]
    )
    return (
        f"<p>{scenes['scenes']} scenes of up to 11 s of city traffic, made from {scenes['sources']} recorded ones; "
        f"{scenes['generated_scenes']} of them hold {scenes['generated_vehicles']} generated vehicles "
        "beside those that "
        "were recorded. Three groups are kept apart on this page: <b>original</b> are the recorded road users, "
        "<b>generated</b> the vehicles that were added, <b>combined</b> both. A mean over all hides what was added, "
        "because recorded tracks carry the noise of the sensors that saw them.</p>"
        + (f"<p class=bad>Not readable, left out:</p><ul>{failed}</ul>" if failed else "")
    )


def _glance(metrics: Mapping[str, Any]) -> str:
    safety, pairs = metrics["safety"], metrics["safety"]["pairs"]
    if not metrics["scenes"]["generated_vehicles"]:
        return ""
    hits = pairs["touching_all"]["generated_generated"] + pairs["touching_all"]["generated_original"]
    limits = metrics["kinematics"]["limits"].values()
    beyond = [entry for entry in limits if entry["generated"]["value"]]
    named = "".join(f"<br>{entry['label']}: {entry['generated']['value']:.1e} of driving" for entry in beyond)
    rows = [
        ("generated vehicles that touch anything, pairs", hits == 0, str(hits)),
        (
            "share of boxes with a corner over 0.3 m off the road",
            not safety["footprint_orr"]["generated"]["value"],
            number(safety["footprint_orr"]["generated"]["value"], 4),
        ),
        (
            "share of driving against the lane",
            not safety["wrong_way"]["generated"]["value"],
            number(safety["wrong_way"]["generated"]["value"], 4),
        ),
        ("limits of motion that some step exceeds", not beyond, f"{len(beyond)} of {len(limits)}{named}"),
        (
            "time to collision with the leader below 1.5 s, share of driving",
            not safety["leader_ttc_critical"]["generated"]["value"],
            number(safety["leader_ttc_critical"]["generated"]["value"], 4),
        ),
        (
            "contact within 1 s after the last step at constant velocity, share of vehicles",
            not safety["end_ttc_critical"]["generated"]["value"],
            number(safety["end_ttc_critical"]["generated"]["value"], 4),
        ),
    ]
    cells = [
        (name, value, '<span class="good">none</span>' if good else '<span class="bad">some</span>')
        for name, good, value in rows
    ]
    return "<h2>At a glance: are the generated vehicles safe?</h2>" + table(("", "value", ""), cells)


def _example(evaluation: Evaluation) -> str:
    example = evaluation.totals.example
    if example is None:
        return ""
    folder = Path(example.folder)
    parts = [
        "<h2>One of the scenes</h2>",
        picture(
            scene_figure(folder),
            f"Scene {html.escape(example.scenario_id)} from above at its last observed moment. Boxes are road users, "
            "lines the way they came; a thin line is the whole path of a generated vehicle, and a mark the place where "
            "it changes lanes, overtakes or turns.",
        ),
    ]
    agent = _busiest(folder, example.scenario_id)
    if agent is not None:
        caption = f"The same moment around the path of {html.escape(agent)}, one of the generated vehicles."
        parts.append(picture(scene_figure(folder, agent=agent), caption))
    return "".join(parts)


def _busiest(folder: Path, scenario_id: str) -> str | None:
    """A generated vehicle to look at: one that overtook, else changed lanes, else any."""
    sidecar = sidecar_in(folder, scenario_id)
    agents = sidecar.agents if sidecar is not None else ()
    if not agents:
        return None

    def shown(agent: AgentRecord) -> tuple[bool, bool]:
        done = {maneuver.kind for maneuver in agent.maneuvers if maneuver.status == "done"}
        return "overtake" in done, "lane_change" in done

    return max(agents, key=shown).track_id


def _safety(metrics: Mapping[str, Any]) -> str:
    safety = metrics["safety"]
    rows = [
        (_name(entry), *(with_interval(entry[group], 4) for group in _GROUP_NAMES), *_paper(key))
        for key, entry in safety.items()
        if key != "pairs"
    ]
    pair_rows = [
        (
            name,
            str(safety["pairs"]["pairs_vehicles"][key]),
            str(safety["pairs"]["pairs_all"][key]),
            str(safety["pairs"]["touching_all"][key]),
            str(safety["pairs"]["crossings"][key]),
            str(safety["pairs"]["pet_critical"][key]),
        )
        for key, name in _PAIR_NAMES.items()
    ]
    return (
        "<h2>Safety</h2><p>Small print: 95 % interval, by drawing source scenes again (bootstrap). Recorded vehicles "
        "“collide” and leave the road mostly where a tracker saw one car twice or a car was parked; "
        "generated ones must "
        "not. Generated vehicles are held against every road user of the scene, the other two columns against vehicles "
        "of their own group, as in the paper. The last two columns are the paper’s own figures on its own scenes, for "
        "orientation.</p>"
        + table(("share of …", *_GROUP_NAMES.values(), "paper: recorded", "paper: combined"), rows)
        + "<p>Who collides with whom, in pairs; crossing paths with less than 1 s between the first leaving the shared "
        "ground and the second arriving (post-encroachment time, PET) are close calls.</p>"
        + table(
            ("", "vehicles, IoU &gt; 0.02", "any type, IoU &gt; 0.02", "any contact", "crossing paths", "PET &lt; 1 s"),
            pair_rows,
        )
    )


def _name(metric: Mapping[str, Any]) -> str:
    """The name of a metric, which its sentence explains where the pointer rests on it."""
    return f'<span title="{html.escape(metric["sentence"])}">{html.escape(metric["label"])}</span>'


def _paper(key: str) -> tuple[str, str]:
    if key not in PAPER_ORIGINAL:
        return "", ""
    return number(PAPER_ORIGINAL[key]), number(PAPER_HID2[key])


def _kinematics(metrics: Mapping[str, Any]) -> str:
    kinematics = metrics["kinematics"]
    rows = [
        (f"{_name(entry)}, {entry['unit']}", *(with_interval(entry[group]) for group in _GROUP_NAMES), *_paper(key))
        for section in ("paper", "clean")
        for key, entry in kinematics[section].items()
    ]
    limits = [
        (_name(entry), *(number(entry[group]["value"], 4) for group in _GROUP_NAMES))
        for entry in kinematics["limits"].values()
    ]
    return (
        "<h2>Motion</h2><p>Mean over each track, then over tracks. The first three rows follow the "
        "paper: every road user, "
        "tracker fragments too. The other three look at moving vehicles that are no fragments. Lower is smoother, not "
        "better by itself: vehicles labelled by people have LO 0.31, LA 0.11, JE 0.94.</p>"
        + table(("", *_GROUP_NAMES.values(), "paper: recorded", "paper: combined"), rows)
        + "<p>Share of driving beyond what drivers accept (nuPlan’s bounds of comfort):</p>"
        + table(("", *_GROUP_NAMES.values()), limits)
    )


def _realism(evaluation: Evaluation) -> str:
    realism = evaluation.metrics["realism"]
    if not evaluation.totals.realism.generated["speed"].sum():
        return ""
    names = {feature.name: feature for feature in FEATURES}
    rows = [
        (
            f"{names[item['feature']].label}, {item['unit']}",
            number(item["jensen_shannon"]),
            number(item["jensen_shannon_floor"]),
            number(item["jensen_shannon_ratio"], 1),
            number(item["wasserstein"]),
            number(item["wasserstein_floor"]),
            f"{item['generated_samples']:,}",
            f"{item['recorded_samples']:,}",
        )
        for item in realism["distances"]
    ]
    return (
        "<h2>Realism</h2><p>Generated moving vehicles against recorded moving vehicles that are no tracker fragments. "
        "The Jensen-Shannon distance is 0 for equal distributions and 1 for distributions without overlap; the "
        "Wasserstein distance says how far values would have to be shifted, in their unit. The <b>floor</b> is the "
        "distance between two halves of the recorded vehicles: no generator can be expected to come below it.</p>"
        + table(
            (
                "",
                "Jensen-Shannon",
                "floor",
                "times the floor",
                "Wasserstein",
                "floor",
                "generated samples",
                "recorded samples",
            ),
            rows,
        )
        + picture(
            distribution_figure(evaluation.totals.realism),
            "Distributions behind the table; end bins hold what lies beyond.",
        )
        + "<p>Can a classifier tell generated from recorded vehicles? 0.5 is a coin toss, 1.0 "
        "always. From speeds, gaps and "
        f"place in the lane: <b>{number(realism['classifier_auc_driving'], 2)}</b>; from "
        "accelerations, yaw rates and jerk "
        f"too, which tracker noise gives away: <b>{number(realism['classifier_auc'], 2)}</b> (area "
        "under the ROC curve, logistic regression, trained and tested on different source scenes). Above 0.8 the two "
        "are told apart with ease: by the speeds and gaps that the figure shows to differ, or because few source "
        "scenes are a poor sample of traffic.</p>"
    )


def diversity_parts(diversity: Mapping[str, Any]) -> list[str]:
    """Figure and tables of scenes by density and behaviour, before and after."""
    bands = [
        (
            f"more than {bound}",
            *(number(part[bound][when], 2) for part in _shares(diversity) for when in ("before", "after")),
        )
        for bound in diversity["density"]["tracks"]["share_above"]
    ]
    means = (
        "mean number of agents",
        *(
            number(diversity["density"][name][f"mean_{when}"], 1)
            for name in ("tracks", "tracks_at_49")
            for when in ("before", "after")
        ),
    )
    behaviours = diversity["behaviours"]
    kinds = [
        (
            kind.replace("_", " "),
            *(
                number(behaviours[when]["maneuvers"][kind] / max(1, behaviours[when]["scenes"]), 2)
                for when in ("before", "generated", "after")
            ),
        )
        for kind in behaviours["before"]["maneuvers"]
    ]
    return [
        picture(
            diversity_figure(diversity),
            "Left: scenes by number of agents, before and after vehicles were added (all tracks of a scene, and those "
            "present at the last observed moment); a bar from 40 to 60 holds more than 40 and up to 60. Right: share "
            "of scenes that have a moving vehicle of the kind; a vehicle is of one kind, the rarest that it shows: one "
            "that changes lanes on its way to a turn, or passes another and stays, counts as a lane change.",
        ),
        f"<p>Before: {diversity['scenes']['before']} source scenes. After: {diversity['scenes']['after']} scenes.</p>",
        table(
            ("share of scenes with agents …", "tracks, before", "after", "at 4.9 s, before", "after"), [means, *bands]
        ),
        "<p>Manoeuvres per scene, as a detector sees them in the positions (before: recorded; after: all):</p>",
        table(("", "before", "generated", "after"), kinds),
    ]


def _shares(diversity: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    return [diversity["density"][name]["share_above"] for name in ("tracks", "tracks_at_49")]


def _requests(metrics: Mapping[str, Any]) -> str:
    requests = metrics["requests"]
    if not requests["placed"] and not requests["requested"]:
        return ""
    maneuvers = [
        (
            kind.replace("_", " "),
            *(str(entry[status]) for status in ("done", "done_and_seen", "aborted", "not_feasible", "not_triggered")),
            number(entry["median_trigger_to_start_s"], 1),
            "<br>".join(html.escape(f"{reason_words(reason)} ({count})") for reason, count in entry["reasons"].items())
            or "–",
        )
        for kind, entry in requests["maneuvers"].items()
    ]
    rejected = [(html.escape(reason_words(reason)), f"{count:,}") for reason, count in requests["rejected"].items()]
    return (
        f"<h2>Asked for and delivered</h2><p>{requests['placed_of_requested']} vehicles placed of "
        f"{requests['requested']} "
        "asked for. Every manoeuvre asked for, what became of it, and whether the detector sees it "
        "in the positions. Aborted: begun and given up. Not feasible: never possible, with the reason. Not triggered: "
        "the scene ended first. Trigger to start: median time from the moment at which the manoeuvre was asked for to "
        "its begin, while it waited for a gap.</p>"
        + table(
            (
                "manoeuvre",
                "done",
                "of these seen",
                "aborted",
                "not feasible",
                "not triggered",
                "trigger to start, s",
                "reasons",
            ),
            maneuvers,
            numbers=6,
        )
        + (
            "<p>Candidates that were tried and not placed, by reason:</p>" + table(("reason", "candidates"), rejected)
            if rejected
            else ""
        )
    )


def _fidelity(metrics: Mapping[str, Any]) -> str:
    replay, nets = metrics["replay"], metrics["nets"]
    rows = [
        (
            html.escape(source[:8]),
            f"{net['lanes_in_net']} of {net['lanes']}",
            str(net["cells"]),
            f"{net['largest_distance_m'] * 1000:.1f}",
            f"{net['successors_kept']} of {net['successors']}",
            f"{net['neighbors_kept']} of {net['neighbors']}",
        )
        for source, net in nets.items()
        if "failed" not in net
    ]
    text = (
        f"<p>{replay['states']:,} recorded states were replayed in SUMO, at most "
        f"{replay['max_position_error_m'] * 1000:.3f} mm "
        "from where they were recorded.</p>"
        if replay["states"]
        else ""
    )
    return (
        "<h2>Fidelity of replay and road network</h2>"
        + text
        + "<p>Each map as a SUMO network of cells of at most 4 m; links that lead out of the map cannot be kept, nor "
        "neighbours that only one of the two lanes names.</p>"
        + table(("map of scene", "lanes", "cells", "largest distance, mm", "successor links", "neighbour links"), rows)
    )


def _words() -> str:
    return (
        "<h2>Words</h2><dl>"
        "<dt>LO, LA, JE</dt><dd>magnitude of longitudinal acceleration, lateral acceleration and "
        "jerk, from positions.</dd>"
        "<dt>SCR</dt><dd>scenario collision rate: vehicles whose box overlaps another one’s (IoU "
        "above 0.02) at any step, as a "
        "share of the vehicles of the scene; mean over scenes.</dd>"
        "<dt>ORR</dt><dd>off-road rate: positions outside the drivable area of the map, as a share of all.</dd>"
        "<dt>footprint ORR</dt><dd>positions at which a corner of the box is more than 0.3 m outside it, as a share "
        "of all.</dd>"
        "<dt>TTC</dt><dd>time until two boxes touch if both keep their velocity; looked at up to 5 s.</dd>"
        "<dt>time gap</dt><dd>gap to the vehicle ahead in the lane, divided by the own speed.</dd>"
        "<dt>PET</dt><dd>post-encroachment time: from the moment at which one vehicle leaves ground that two paths "
        "share to the moment at which the other arrives there.</dd>"
        "<dt>overtake, pass, obstacle avoidance</dt><dd>driving past a slower vehicle by the lane beside it and back; "
        "the same without coming back; past one that stands.</dd>"
        "<dt>IoU</dt><dd>area shared by two boxes over the area covered by either.</dd>"
        "<dt>moving</dt><dd>a vehicle whose path extends over more than 5 m, seen at more than 10 steps.</dd>"
        "<dt>fragment</dt><dd>a short, poor track; the data set marks it so.</dd></dl>"
    )
