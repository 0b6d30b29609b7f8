"""What `hid2 view` holds and shows of a generated scene, against the files of the scene, read without hid2's help."""

import csv
import gzip
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from browser import Page

#: Half a quantum of the page, and what a decimal of its texts rounds, of metres and of radians.
METRES, RADIANS = 0.00051, 0.00006
#: All states that the page holds, of every track at every step.
STATES = """Object.fromEntries(now.scene.tracks.map((track) => [track.id,
    Array.from({ length: now.scene.steps }, (_, step) => stateOf(now.scene, track.id, step))]))"""
#: What the panel shows of the agent that is chosen.
PANEL = """(() => {
    const panel = $("panel"), cells = (row) => [...row.children].map((cell) => cell.textContent);
    const rows = (title) => {
        let node = [...panel.querySelectorAll("h3")].find((one) => one.textContent === title), found = [];
        while ((node = node?.nextElementSibling) && !["H3", "DETAILS"].includes(node.tagName))
            found.push(...[...node.querySelectorAll("tr")].slice(1).map(cells));
        return found;
    };
    return { name: panel.querySelector("h2").textContent, text: panel.textContent.replace(/\\s+/g, " "),
        limits: rows("Held below SUMO's own speed"), looks: rows("Looks at gaps") };
})()"""


def differences(page: Page, folder: Path) -> Iterator[str]:
    """What the page, on which the scene is open, has otherwise than parquet, sidecar and table of looks."""
    name = folder.name
    assert page.js("now.scene.id") == name
    rows = pd.read_parquet(folder / f"scenario_{name}.parquet")
    yield from _states(page.js(STATES), rows)
    sidecar = json.loads((folder / f"hid2_{name}.json").read_text())
    with gzip.open(folder / f"gaps_{name}.csv.gz", "rt", newline="") as stream:
        looks = list(csv.DictReader(stream))
    assert sidecar["agents"], "a scene without inserted vehicles compares nothing"
    for agent in sidecar["agents"]:
        page.js(f"choose({json.dumps(agent['track_id'])})")
        yield from _panel(page.js(PANEL), agent, [row for row in looks if row["track_id"] == agent["track_id"]])


def _states(held: dict[str, Any], rows: pd.DataFrame) -> Iterator[str]:
    if set(held) != set(rows["track_id"]):
        yield f"tracks: {sorted(set(held) ^ set(rows['track_id']))}"
    for track_id, track in rows.groupby("track_id"):
        states = held[str(track_id)]
        there = [step for step, state in enumerate(states) if state is not None]
        if there != track["timestep"].tolist():
            yield f"{track_id}: there at {there}"
            continue
        for column, value, most in (
            ("x", track["position_x"], METRES), ("y", track["position_y"], METRES),
            ("speed", np.hypot(track["velocity_x"], track["velocity_y"]), METRES),
        ):  # fmt: skip
            off = np.abs(np.array([states[step][column] for step in there]) - value.to_numpy()).max()
            if off > most:
                yield f"{track_id}: {column} is off by {off}"
        turn = np.array([states[step]["heading"] for step in there]) - track["heading"].to_numpy()
        if np.abs(np.arctan2(np.sin(turn), np.cos(turn))).max() > RADIANS:
            yield f"{track_id}: heading is off"


def _panel(shown: dict[str, Any], agent: dict[str, Any], looks: list[dict[str, str]]) -> Iterator[str]:
    name = agent["track_id"]
    if shown["name"] != name:
        yield f"{name}: the panel is of {shown['name']}"
    for one in agent["maneuvers"]:
        wanted = [f"{one['kind']} {one['status']}".replace("_", " ")]
        wanted += [] if one["reason"] is None else [one["reason"].replace("_", " ")]
        wanted += [
            f"{moment} {one[f'{moment}_s']:.1f} s"
            for moment in ("trigger", "start", "crossing", "end")
            if one[f"{moment}_s"] is not None and abs(one[f"{moment}_s"] * 100 % 10 - 5) > 0.1  # one that rounds alike
        ]
        yield from (f"{name}: {text!r} is not shown" for text in wanted if text not in shown["text"])
    limits = {cause: share for cause, share in agent["limited"].items() if share > 0}
    told = {cause.replace(" ", "_"): float(share.removesuffix(" %")) / 100 for cause, share in shown["limits"]}
    if set(limits) != set(told) or any(abs(limits[cause] - told[cause]) > 0.00051 for cause in limits):
        yield f"{name}: limits {told}, in the sidecar {limits}"
    if len(shown["looks"]) != len(looks) or agent["gaps"]["looked_at"] != len(looks):
        yield f"{name}: {len(shown['looks'])} looks, in the table {len(looks)}"
    for row, look in zip(shown["looks"], looks, strict=False):
        refusals = ", ".join(look["refusals"].split()) or look["rule"]
        answer = refusals if look["rule"] != "yes" else look["guard"] if look["guard"] != "yes" else None
        answer = answer or {"no": "refused by SUMO", "yes": "taken", "": "SUMO not asked"}[look["sumo"]]
        gaps = [f"{float(look[gap]):.1f}" if look[gap] else "–" for gap in ("lead_gap_m", "lag_gap_m")]
        near = all(a == b or abs(float(a) - float(b)) < 0.11 for a, b in zip(row[2:4], gaps, strict=True))
        if (row[0], row[1], row[4]) != (
            f"{float(look['time_s']):.1f}",
            look["side"],
            answer.replace("_", " "),
        ) or not near:
            yield f"{name}: look {row}, in the table {look}"
