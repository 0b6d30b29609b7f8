"""Which parameters change nothing: each number by 30 % to both sides, each choice to another value.

By hand: `python .ci/sensitivity.py ROOT... [--only drivers. --modes mix,events]`, some 10 s a parameter and scene.
A number that no mode feels is no parameter, unless a study, a limit or a safety case of its own speaks for it. Rules
and traffic of studies are not driven here.
"""

import argparse
import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bridge import find_scenarios, generate, read_scene
from bridge.config import config_from_dict, config_to_dict, describe_config
from hid2.params import Config
from netconvert.errors import Hid2Error

MODES: dict[str, dict[str, Any]] = {
    "mix": {},
    "turns": {"request": {"straight": 0.4, "left_turn": 0.3, "right_turn": 0.3, "entering": 0.5}},
    "shifts": {"request": {"straight": 0.0, "lane_change": 0.5, "overtake": 0.5}},
    "reactive": {"driving": {"replay": "reactive"}},
    "max": {"request": {"agents": "max"}},
    "events": {"event": [{"kind": kind, "target": "any"} for kind in ("cut_in", "lead", "follow", "merge", "cross")]},
}


def outcome(scenes: list[Any], values: dict[str, Any]) -> str:
    """Digest of motion and sidecar over scenes, without what names the configuration and the program."""
    digest = hashlib.sha256()
    for scene in scenes:
        try:
            made = generate(scene, config_from_dict(values))
        except Hid2Error as error:
            digest.update(repr(type(error)).encode())
            continue
        told = made.sidecar.model_dump(mode="json", exclude={"config", "config_sha256", "generator"})
        digest.update(json.dumps(told, sort_keys=True).encode())
        for track in made.recording.tracks:
            digest.update(track.position.tobytes() + track.heading.tobytes())
    return digest.hexdigest()[:16]


def others(value: Any, words: str) -> Iterator[Any]:  # noqa: ANN401  # a parameter's value
    """Values beside one: as they stand in a configuration."""
    if isinstance(value, bool):
        yield not value
    elif isinstance(value, int | float):
        yield from (type(value)(round(value * share, 9)) or type(value)(share > 1) for share in (0.7, 1.3))
    elif isinstance(value, list) and value and isinstance(value[0], float):
        yield from ([round(one * share, 9) for one in value] for share in (0.7, 1.3))
    elif isinstance(value, str):
        yield from (word for word in words.split(", ") if word != value and ":" not in word and " " not in word)


def main() -> None:
    """Print, a line each, what every parameter changes in which mode."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("roots", nargs="+", type=Path)
    parser.add_argument("--only", default="", help="begin of keys; 'none': only the digests as it is")
    parser.add_argument("--modes", default=",".join(MODES))
    parser.add_argument("--agents", type=int, default=10)
    given = parser.parse_args()
    scenes = [read_scene(folder) for root in given.roots for folder in find_scenarios(root)]
    start = {}
    for mode in given.modes.split(","):
        base = config_to_dict(Config())
        for section, own in MODES[mode].items():
            base[section] = own if section == "event" else base[section] | own
        if mode != "max":
            base["request"]["agents"] = given.agents
        start[mode] = base, outcome(scenes, base)
        print(f"{mode}: {start[mode][1]} as it is", flush=True)
    for row in describe_config():
        section, _, name = row.key.partition(".")
        if not name or not row.key.startswith(given.only):
            continue
        felt = set()
        for mode, (base, same) in start.items():
            for value in others(base[section][name], row.range):
                changed = base | {section: base[section] | {name: value}}
                try:
                    felt |= {mode} if outcome(scenes, changed) != same else set()
                except Hid2Error:  # out of range
                    continue
        print(f"{row.key}: {', '.join(sorted(felt)) or 'CHANGES NOTHING'}", flush=True)


if __name__ == "__main__":
    main()
