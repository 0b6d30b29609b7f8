"""report.html: what an evaluation found, in one file that needs neither the paper nor the code to be understood.

The prose is in templates/ (jinja2); here are the figures, the tables, and what is to be seen in them.
"""

import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from markupsafe import Markup

from bridge.evaluation.charts import diversity_figure
from bridge.evaluation.pages import Section, linked, macro, number, page, picture, table, with_interval
from bridge.evaluation.realism_page import realism_section
from bridge.evaluation.totals import Evaluation
from bridge.files import write_text
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


class Term(NamedTuple):
    """A word that tables link to: its anchor, the word and its definition."""

    key: str
    name: str
    text: str


_TERMS = (
    Term(
        "motion",
        "LO, LA, JE",
        "magnitude of longitudinal acceleration, lateral acceleration and jerk, from positions.",
    ),
    Term(
        "scr",
        "SCR",
        "scenario collision rate: vehicles whose box overlaps another one’s (IoU above 0.02) at any step, as a share "
        "of the vehicles of the scene; mean over scenes.",
    ),
    Term(
        "orr", "ORR", "off-road rate: positions outside the drivable area of the map, as a share of all of the group."
    ),
    Term(
        "footprint",
        "footprint ORR",
        "positions at which a corner of the box is more than 0.3 m outside the drivable area, as a share of the "
        "group’s.",
    ),
    Term("ttc", "TTC", "time until two boxes touch if both keep their velocity; looked at up to 5 s."),
    Term("gap", "time gap", "gap to the vehicle ahead in the lane, divided by the own speed."),
    Term(
        "pet",
        "PET",
        "post-encroachment time: from the moment at which one vehicle leaves ground that two paths share to the moment "
        "at which the other arrives there.",
    ),
    Term(
        "js",
        "Jensen-Shannon distance",
        "root of the Jensen-Shannon divergence of two histograms, to base 2: 0 for equal ones, 1 without overlap.",
    ),
    Term(
        "wasserstein",
        "Wasserstein distance",
        "mean distance by which the values of one sample would have to be shifted to become the other.",
    ),
    Term(
        "auc",
        "AUC",
        "how often a critic finds the generated one of a generated and a recorded window: 0.5 by guessing, 1 always; "
        "below 0.5 what it learned on the other scenes does not hold on these.",
    ),
    Term(
        "overtake",
        "overtake, pass, obstacle avoidance",
        "driving past a slower vehicle by the lane beside it and back; the same without coming back; past one that "
        "stands.",
    ),
    Term(
        "manoeuvre",
        "lane change, turn",
        "the centre crosses to a lane beside that runs the same way, and stays at least 0.5 s on each side; a turning "
        "lane of an intersection is driven and the direction changes by as much as makes a turn.",
    ),
    Term("contact", "touching, any contact", "two boxes share ground at some step, by however little."),
    Term(
        "smooth",
        "speed, acceleration, jerk, yaw rate, offset",
        "of the smooth curve through four seconds of positions of a moving vehicle, along and across its lane; the "
        "offset is the distance from the lane’s middle, left positive.",
    ),
    Term(
        "duration", "lane-change duration", "from where the lateral speed passes 0.1 m/s to where it falls below again."
    ),
    Term("iou", "IoU", "area shared by two boxes over the area covered by either."),
    Term("moving", "moving", "a vehicle whose path extends over more than 5 m, seen at more than 10 steps."),
    Term("fragment", "fragment", "a short, poor track; the data set marks it so."),
)


def _section(name: str, *arguments: object) -> Markup:
    return macro("sections.html.j2", name, *arguments)


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
        Section("words", "Words", _section("words", _TERMS, _described(metrics), _reasons_of(evaluation))),
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


def _glance(metrics: Mapping[str, Any]) -> str:
    safety, pairs = metrics["safety"], metrics["safety"]["pairs"]
    if not metrics["scenes"]["generated_vehicles"]:
        return ""
    hits = pairs["touching_all"]["generated_generated"] + pairs["touching_all"]["generated_original"]
    limits = metrics["kinematics"]["limits"].values()
    beyond = [entry for entry in limits if entry["generated"]["value"]]
    named = "".join(f"<br>{entry['label']}: {entry['generated']['value']:.1e} of driving" for entry in beyond)

    def defined(key: str, name: str) -> str:
        return f'<a href="#metric-{key}">{name}</a>'

    rows = [
        (linked("generated vehicles that touch anything, pairs"), hits == 0, str(hits)),
        (
            defined("footprint_orr", "share of boxes with a corner over 0.3 m off the road"),
            not safety["footprint_orr"]["generated"]["value"],
            number(safety["footprint_orr"]["generated"]["value"], 4),
        ),
        (
            defined("wrong_way", "share of driving against the lane"),
            not safety["wrong_way"]["generated"]["value"],
            number(safety["wrong_way"]["generated"]["value"], 4),
        ),
        (
            '<a href="#motion">limits of motion</a> that some step exceeds',
            not beyond,
            f"{len(beyond)} of {len(limits)}{named}",
        ),
        (
            defined("leader_ttc_critical", "time to collision (TTC) with the leader below 1.5 s, share of driving"),
            not safety["leader_ttc_critical"]["generated"]["value"],
            number(safety["leader_ttc_critical"]["generated"]["value"], 4),
        ),
        (
            defined(
                "end_ttc_critical", "contact within 1 s after the last step at constant velocity, share of vehicles"
            ),
            not safety["end_ttc_critical"]["generated"]["value"],
            number(safety["end_ttc_critical"]["generated"]["value"], 4),
        ),
    ]
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
    agent = _busiest(agents)
    if agent is not None:
        caption = f"The same moment around the path of {html.escape(agent.track_id)}, one of the generated vehicles."
        parts.append(picture(scene_figure(folder, agent=agent.track_id), caption, _deeds(agent)))
    return "".join(parts)


def _deeds(agent: AgentRecord) -> str:
    """What a vehicle does, in a sentence."""
    done = [maneuver.kind.replace("_", " ") for maneuver in agent.maneuvers if maneuver.status == "done"]
    what = f"does what it was asked for: {', '.join(done)}" if done else "keeps to its lane path"
    return html.escape(f"{agent.track_id}, in the ring, {what}.")


def _busiest(agents: Sequence[AgentRecord]) -> AgentRecord | None:
    """A generated vehicle to look at: one that overtook, else changed lanes, else any."""

    def shown(agent: AgentRecord) -> tuple[bool, bool]:
        done = {maneuver.kind for maneuver in agent.maneuvers if maneuver.status == "done"}
        return "overtake" in done, "lane_change" in done

    return max(agents, key=shown, default=None)


def _encounters(metrics: Mapping[str, Any]) -> str:
    """What inserted vehicles meet, beside what recorded ones meet among themselves."""
    rows = [
        (_name(key, entry), *(with_interval(entry[group]) for group in ("original", "generated")))
        for key, entry in metrics["encounters"].items()
    ]
    head = ("share of vehicles that …", _GROUP_NAMES["original"], _GROUP_NAMES["generated"])
    return _section("encounters", metrics["scenes"], table(head, rows))


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
    safety = metrics["safety"]
    rows = [
        (_name(key, entry), *(with_interval(entry[group], 4) for group in _GROUP_NAMES), *_paper(key))
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
    head = ("share of …", *_GROUP_NAMES.values(), "paper: recorded", "paper: combined")
    kinds = map(linked, ("vehicles, IoU > 0.02", "any type, IoU > 0.02", "any contact", "crossing paths", "PET < 1 s"))
    return _section("safety", metrics["scenes"], table(head, rows), table(("pairs", *kinds), pair_rows))


def _paper(key: str) -> tuple[str, str]:
    if key not in PAPER_ORIGINAL:
        return "", ""
    return number(PAPER_ORIGINAL[key]), number(PAPER_HID2[key])


def _kinematics(metrics: Mapping[str, Any]) -> str:
    kinematics = metrics["kinematics"]
    rows = [
        (
            f"{_name(key, entry)}, {entry['unit']}",
            *(with_interval(entry[group]) for group in _GROUP_NAMES),
            *_paper(key),
        )
        for section in ("paper", "clean")
        for key, entry in kinematics[section].items()
    ]
    limits = [
        (_name(key, entry), *(number(entry[group]["value"], 4) for group in _GROUP_NAMES))
        for key, entry in kinematics["limits"].items()
    ]
    head = ("", *_GROUP_NAMES.values(), "paper: recorded", "paper: combined")
    limited = table(("limit", *_GROUP_NAMES.values()), limits)
    return _section("motion", metrics["scenes"], table(head, rows), limited)


def diversity_parts(diversity: Mapping[str, Any]) -> list[str]:
    """Figure and tables of scenes by density and behaviour, before and after."""
    bands = [
        (
            f"share of scenes with more than {bound}",
            *(number(part[bound][when], 2) for part in _shares(diversity) for when in ("before", "after")),
        )
        for bound in diversity["density"]["tracks"]["share_above"]
    ]
    means = (
        "mean",
        *(
            number(diversity["density"][name][f"mean_{when}"], 1)
            for name in ("tracks", "tracks_at_49")
            for when in ("before", "after")
        ),
    )
    behaviours = diversity["behaviours"]
    kinds = [
        (
            linked(kind.replace("_", " ")),
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
            _denser(diversity),
        ),
        Markup("<p class=of>Before: {} source scenes. After: {} scenes.</p>").format(
            *(diversity["scenes"][when] for when in ("before", "after"))
        ),
        table(("agents in a scene", "tracks, before", "after", "at 4.9 s, before", "after"), [means, *bands]),
        Markup("<p>Manoeuvres per scene, as a detector sees them in the positions (before: recorded; after: all):</p>"),
        table(("manoeuvre", "before", "generated", "after"), kinds),
    ]


def _denser(diversity: Mapping[str, Any]) -> str:
    """How density and behaviours change, in a sentence."""
    tracks, part = diversity["density"]["tracks"], diversity["behaviours"]
    if tracks["mean_before"] is None or tracks["mean_after"] is None:
        return ""
    shares = {
        kind: tuple(part[when]["scenes_with"][kind] / max(1, part[when]["scenes"]) for when in ("before", "after"))
        for kind in part["before"]["scenes_with"]
    }
    grown = max(shares, key=lambda kind: shares[kind][1] - shares[kind][0])
    before, after = shares[grown]
    more = (
        f"; scenes with {grown.replace('_', ' ')} grow most, from {before:.2f} to {after:.2f}" if after > before else ""
    )
    return f"the mean number of agents goes from {tracks['mean_before']:.1f} to {tracks['mean_after']:.1f}{more}."


def _shares(diversity: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    return [diversity["density"][name]["share_above"] for name in ("tracks", "tracks_at_49")]


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
    return _section("requests", requests, table(head, maneuvers, numbers=6), tried)


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
