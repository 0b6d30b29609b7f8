"""report.html: what an evaluation found, in one file that needs neither the paper nor the code to be understood.

The prose is in bridge/pages/templates (jinja2); here are the figures, the tables, and what is to be seen in them.
"""

import html
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from bridge.evaluation.diversity import DENSITIES
from bridge.evaluation.realism_page import realism_section
from bridge.evaluation.scene_metrics import PAIR_KINDS
from bridge.evaluation.totals import Evaluation
from bridge.files import write_text
from bridge.pages.charts import diversity_figure
from bridge.pages.parts import Section, linked, macro, number, page, picture, table, with_interval
from bridge.pictures import figures
from bridge.pictures.render import scene_figure
from bridge.recordings.sidecar import AgentRecord, sidecar_in
from hid2.reasons import Reason

_GROUP_NAMES = {"original": "original (recorded)", "generated": "generated", "combined": "combined"}
_PAIR_NAMES = {
    "original_original": "recorded with recorded",
    "generated_original": "generated with recorded",
    "generated_generated": "generated with generated",
}
#: The paper's Table 1, Argoverse 2.
PAPER_ORIGINAL = {"lo": 1.648, "la": 0.476, "je": 8.106, "scr": 0.072, "orr": 0.142}
PAPER_HID2 = {"lo": 1.465, "la": 0.486, "je": 7.801, "scr": 0.051, "orr": 0.114}

#: Events with a picture in the table; each takes some 60 kB.
_EVENT_PICTURES = 12


def _section(name: str, *arguments: object) -> Markup:
    return macro("report.html.j2", name, *arguments)


def write_report(evaluation: Evaluation, path: Path) -> None:
    """Write the report of an evaluation. Errors: OSError."""
    figures.style()
    metrics = evaluation.metrics
    sections = [
        Section("glance", "At a glance: are the generated vehicles safe?", _glance(metrics)),
        Section("encounters", "Encounters", _encounters(metrics)),
        Section("realism", "Realism", realism_section(evaluation)),
        Section("events", "Events asked for", _events(evaluation)),
        Section("safety", "Safety", _safety(metrics)),
        Section("example", "One of the scenes", _example(evaluation)),
        Section("motion", "Motion", _kinematics(metrics)),
        Section("diversity", "Diversity", Markup("\n").join(diversity_parts(metrics["diversity"]))),
        Section("requests", "Asked for and delivered", _requests(metrics)),
        Section("fidelity", "Fidelity of replay and road network", _fidelity(metrics)),
        Section("words", "Words", _section("words", _described(metrics), _reasons_of(evaluation))),
    ]
    intro = _section("intro", metrics["scenes"])
    write_text(path, page("Generated traffic scenes: evaluation", [intro], [s for s in sections if s.body]))


def _name(key: str, entry: Mapping[str, Any]) -> str:
    """The name of a metric, which leads to its sentence where it has one, else to the words in it."""
    if entry.get("sentence"):
        return f'<a href="#metric-{key}">{html.escape(entry["label"])}</a>'
    return linked(entry["label"])


def _described(metrics: Mapping[str, Any]) -> list[dict[str, str]]:
    """Key, label and sentence of every metric that has a sentence."""
    tables = [metrics["safety"], metrics["encounters"], *metrics["kinematics"].values()]
    return [
        {"key": key, "label": entry["label"], "sentence": entry["sentence"]}
        for part in tables
        for key, entry in part.items()
        if entry.get("sentence")
    ]


def _reason(text: str) -> str:
    """A reason of a sidecar in words, as HTML that leads to its sentence."""
    words = html.escape(text.replace("_", " "))
    name = _reason_in(text)
    return words if name is None else f'<a href="#reason-{name}">{words}</a>'


def _reason_in(text: str) -> Reason | None:
    return next((reason for reason in Reason if reason.value in text.split(": ")), None)


def _reasons_of(evaluation: Evaluation) -> list[Reason]:
    """The reasons that the page names."""
    requests = evaluation.metrics["requests"]
    named = [*requests["rejected"], *(text for entry in requests["maneuvers"].values() for text in entry["reasons"])]
    named += [row["reason"] for row in evaluation.totals.events if row["reason"]]
    found = {_reason_in(text) for text in named}
    return [reason for reason in Reason if reason in found]


#: Shares that a glance is cast at, and how they are named there: those of vehicles and boxes, and of driving.
_GLANCE = {
    "footprint_orr": "share of boxes with a corner over 0.3 m off the road",
    "wrong_way": "share of driving against the lane",
    "leader_ttc_critical": "time to collision (TTC) with the leader below 1.5 s, share of driving",
    "end_ttc_critical": "contact within 1 s after the last step at constant velocity, share of vehicles",
}


def _glance(metrics: Mapping[str, Any]) -> str:
    safety, pairs = metrics["safety"], metrics["safety"]["pairs"]
    if not metrics["scenes"]["generated_vehicles"]:
        return ""
    hits = pairs["touching_all"]["generated_generated"] + pairs["touching_all"]["generated_original"]
    limits = metrics["kinematics"]["limits"].values()
    beyond = [entry for entry in limits if entry["generated"]["value"]]
    named = "".join(f"<br>{entry['label']}: {entry['generated']['value']:.1e} of driving" for entry in beyond)
    shares = {key: safety[key]["generated"]["value"] for key in _GLANCE}
    rows = [
        (f'<a href="#metric-{key}">{_GLANCE[key]}</a>', not share, number(share, 4)) for key, share in shares.items()
    ]
    rows.insert(0, (linked("generated vehicles that touch anything, pairs"), hits == 0, str(hits)))
    exceeded = '<a href="#motion">limits of motion</a> that some step exceeds'
    rows.insert(3, (exceeded, not beyond, f"{len(beyond)} of {len(limits)}{named}"))
    cells = [
        (name, value, '<span class="good">none</span>' if good else '<span class="bad">some</span>')
        for name, good, value in rows
    ]
    return _section("of", metrics["scenes"]) + table(("", "value", ""), cells)


def _example(evaluation: Evaluation) -> str:
    example = evaluation.totals.example
    if example is None:
        return ""
    folder = Path(example.folder)
    sidecar = sidecar_in(folder, example.scenario_id)
    agents = sidecar.agents if sidecar is not None else ()
    caption = (
        f"Scene {html.escape(example.scenario_id)} from above at its last observed moment. Boxes are road users, "
        "lines the way they came; a thin line is the whole path of a generated vehicle, and a mark the place where "
        "it changes lanes, overtakes or turns."
    )
    see = f"{len(agents)} generated vehicles, coloured, drive among the recorded ones, grey." if agents else ""
    parts = [picture(scene_figure(folder), caption, see)]
    # one to look at: it overtook, else changed lanes, else any
    agent = max(agents, key=lambda one: [kind in _done(one) for kind in ("overtake", "lane_change")], default=None)
    if agent is not None:
        track_id, done = html.escape(agent.track_id), [kind.replace("_", " ") for kind in _done(agent)]
        what = f"does what it was asked for: {', '.join(done)}" if done else "keeps to its lane path"
        caption = f"The same moment around the path of {track_id}, one of the generated vehicles."
        shown = scene_figure(folder, agent=agent.track_id)
        parts.append(picture(shown, caption, f"{track_id}, in the ring, {html.escape(what)}."))
    return "".join(parts)


def _done(agent: AgentRecord) -> list[str]:
    """Kinds of manoeuvres that a vehicle was asked for and did."""
    return [maneuver.kind for maneuver in agent.maneuvers if maneuver.status == "done"]


def _encounters(metrics: Mapping[str, Any]) -> str:
    """What inserted vehicles meet, beside what recorded ones meet among themselves."""
    names = {group: _GROUP_NAMES[group] for group in ("original", "generated")}
    rows = _metric_rows(metrics["encounters"], names)
    return _section("encounters", metrics["scenes"], table(("share of vehicles that …", *names.values()), rows))


def _metric_rows(entries: Mapping[str, Any], groups: Iterable[str], digits: int = 3) -> list[tuple[str, ...]]:
    """For each metric its name, and its value with the interval for each group."""
    return [
        (_name(key, entry), *(with_interval(entry[group], digits) for group in groups))
        for key, entry in entries.items()
    ]


def _papers(entries: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """The paper's figures of each metric; without those that it does not have."""
    for key in entries:
        yield (number(PAPER_ORIGINAL[key]), number(PAPER_HID2[key])) if key in PAPER_ORIGINAL else ("", "")


def _events(evaluation: Evaluation) -> str:
    """Every event that was asked for, with a small picture of those that came about."""
    events = evaluation.totals.events
    if not events:
        return ""
    rows = [
        (
            html.escape(f"{row['scenario_id'][:8]}: {row['kind'].replace('_', ' ')}, {row['target']}"),
            number(row["at_s"], 1), number(row["gap_m"], 1), number(row["speed_difference_mps"], 1),
            number(row["min_ttc_s"], 1), number(row["pet_s"], 1), number(row["drac_mps2"], 2),
            "–" if row["human_brakes"] is None else "yes" if row["human_brakes"] else "no",
            _reason(row["reason"]) if row["reason"] else html.escape(f"{row['track_id']}, done"),
            _event_picture(row, shown),
        )
        for shown, row in enumerate(events)
    ]  # fmt: skip
    head = (
        "event, target", "at, s", "gap, m", "speed difference, m/s", linked("TTC, s"), linked("PET, s"), "DRAC, m/s²",
        "a human would have braked", "what became of it", "",
    )  # fmt: skip
    return _section("events", evaluation.metrics["events"], table(head, rows, numbers=7))


def _event_picture(row: Mapping[str, Any], shown: int) -> str:
    """A small picture of an event at its last observed step, for the first of them."""
    if row["track_id"] is None or shown >= _EVENT_PICTURES:
        return ""
    figure = scene_figure(Path(row["folder"]), agent=row["track_id"])
    name = html.escape(f"{row['kind']} by {row['track_id']}")
    return f'<img src="{figures.data_uri(figure)}" alt="{name}" style="width: 22em">'


def _safety(metrics: Mapping[str, Any]) -> str:
    pairs = metrics["safety"]["pairs"]
    shares = {key: entry for key, entry in metrics["safety"].items() if key != "pairs"}
    rows = [(*row, *paper) for row, paper in zip(_metric_rows(shares, _GROUP_NAMES, 4), _papers(shares), strict=True)]
    pair_rows = [(name, *(str(pairs[kind][key]) for kind in PAIR_KINDS)) for key, name in _PAIR_NAMES.items()]
    head = ("share of …", *_GROUP_NAMES.values(), "paper: recorded", "paper: combined")
    kinds = map(linked, ("vehicles, IoU > 0.02", "any type, IoU > 0.02", "any contact", "crossing paths", "PET < 1 s"))
    judged = [
        (name.replace("_", " "), entry["limit"], entry["kind"], str(entry["findings"]))
        for name, entry in metrics["judge"].items()
    ] or [("none", "", "", "0")]
    found = table(("what is judged of inserted vehicles", "what it is", "", linked("findings")), judged)
    return _section("safety", metrics["scenes"], table(head, rows), table(("pairs", *kinds), pair_rows), found)


def _kinematics(metrics: Mapping[str, Any]) -> str:
    parts = metrics["kinematics"]
    shown = parts["paper"] | parts["clean"]
    rows = [
        (f"{name}, {entry['unit']}", *values, *paper)
        for (name, *values), entry, paper in zip(
            _metric_rows(shown, _GROUP_NAMES), shown.values(), _papers(shown), strict=True
        )
    ]
    limits = [
        (_name(key, entry), *(number(entry[group]["value"], 4) for group in _GROUP_NAMES))
        for key, entry in parts["limits"].items()
    ]
    head = ("", *_GROUP_NAMES.values(), "paper: recorded", "paper: combined")
    return _section("motion", metrics["scenes"], table(head, rows), table(("limit", *_GROUP_NAMES.values()), limits))


def diversity_parts(diversity: Mapping[str, Any]) -> list[str]:
    """Figure and tables of scenes by density and behaviour, before and after."""
    densities = [diversity["density"][name] for name in DENSITIES]
    moments = ("before", "after")
    rows = [("mean", *(number(part[f"mean_{when}"], 1) for part in densities for when in moments))]
    rows += [
        (
            f"share of scenes with more than {bound}",
            *(number(part["share_above"][bound][when], 2) for part in densities for when in moments),
        )
        for bound in densities[0]["share_above"]
    ]
    behaviours = diversity["behaviours"]
    kinds = [
        (
            linked(kind.replace("_", " ")),
            *(number(part["maneuvers"][kind] / max(1, part["scenes"]), 2) for part in behaviours.values()),
        )
        for kind in behaviours["before"]["maneuvers"]
    ]
    return [
        picture(diversity_figure(diversity), _section("diversity_caption"), _denser(diversity)),
        _section("diversity_of", diversity["scenes"]),
        table(("agents in a scene", "tracks, before", "after", "at 4.9 s, before", "after"), rows),
        _section("manoeuvres_seen"),
        table(("manoeuvre", *behaviours), kinds),
    ]


def _denser(diversity: Mapping[str, Any]) -> str:
    """How density and behaviours change, in a sentence."""
    tracks, behaviours = diversity["density"]["tracks"], diversity["behaviours"]
    if tracks["mean_before"] is None or tracks["mean_after"] is None:
        return ""
    before, after = (
        {kind: count / max(1, part["scenes"]) for kind, count in part["scenes_with"].items()}
        for part in (behaviours["before"], behaviours["after"])
    )
    grown = max(before, key=lambda kind: after[kind] - before[kind])
    text = f"the mean number of agents goes from {tracks['mean_before']:.1f} to {tracks['mean_after']:.1f}"
    if after[grown] > before[grown]:
        kind = grown.replace("_", " ")
        text += f"; scenes with {kind} grow most, from {before[grown]:.2f} to {after[grown]:.2f}"
    return f"{text}."


def _requests(metrics: Mapping[str, Any]) -> str:
    requests = metrics["requests"]
    if not requests["placed"] and not requests["requested"]:
        return ""
    maneuvers = [
        (
            linked(kind.replace("_", " ")),
            *(str(entry[status]) for status in ("done", "done_and_seen", "aborted", "not_feasible", "not_triggered")),
            number(entry["median_trigger_to_start_s"], 1),
            "<br>".join(f"{_reason(reason)} ({count})" for reason, count in entry["reasons"].items()) or "–",
        )
        for kind, entry in requests["maneuvers"].items()
    ]
    rejected = [(_reason(reason), f"{count:,}") for reason, count in requests["rejected"].items()]
    head = (
        "manoeuvre", "done", "of these seen", "aborted", "not feasible", "not triggered", "trigger to start, s",
        "reasons",
    )  # fmt: skip
    tried = table(("reason", "candidates"), rejected) if rejected else ""
    return _section("requests", requests, table(head, maneuvers, numbers=6), tried, _selection(requests["selection"]))


def _selection(selection: Mapping[str, Mapping[str, int]]) -> str:
    """How vehicles drive that are kept, that are dropped, and recorded ones; "" where no sidecar tells."""
    rows = [
        (
            name,
            str(told["vehicles"]),
            *(number(told[what] / max(1, told["vehicles"]), 2) for what in ("braking", "standing")),
            "–" if name == "recorded" else number(told["limited"] / max(1, told["steps"]), 2),
        )
        for name, told in selection.items()
    ]
    head = (
        '<a href="#word-selection">vehicles</a>', "number", "brake harder than 3 m/s²", "stand at some time",
        "steps limited for conflicts",
    )  # fmt: skip
    return table(head, rows) if rows else ""


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
    head = ("map of scene", "lanes", "cells", "largest distance, mm", "successor links", "neighbour links")
    return _section("fidelity", replay, table(head, rows))
