"""Which parameters change what, by 30 % or another choice: `python .ci/sensitivity.py BEGIN_OF_KEYS ROOT...`.

What no mode feels is no parameter, unless a study, a limit or a case of its own speaks for it. Studies are not driven.
"""

import hashlib
import sys
from contextlib import suppress
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
        made = generate(scene, config_from_dict(values))
        digest.update(made.sidecar.model_dump_json(exclude={"config", "config_sha256", "generator"}).encode())
        for track in made.recording.tracks:
            digest.update(track.position.tobytes() + track.heading.tobytes())
    return digest.hexdigest()[:16]


def others(value: Any, words: str) -> list[Any]:  # noqa: ANN401  # a parameter's value
    """Values beside one: as they stand in a configuration."""
    if isinstance(value, bool | None):
        return [] if value is None else [not value]
    if isinstance(value, str):
        return [word for word in words.split(", ") if word != value and ":" not in word and " " not in word]
    if isinstance(value, list):
        return [[round(one * share, 9) for one in value] for share in (0.7, 1.3)]
    return [type(value)(round(value * share, 9)) or type(value)(share > 1) for share in (0.7, 1.3)]


if __name__ == "__main__":
    begins, *roots = sys.argv[1:]
    scenes = [read_scene(folder) for root in roots for folder in find_scenarios(Path(root))]
    usual = config_to_dict(Config())
    bases = {m: usual | {k: v if k == "event" else usual[k] | v for k, v in own.items()} for m, own in MODES.items()}
    as_is = {mode: outcome(scenes, base) for mode, base in bases.items()}
    print(*(f"{mode}: {digest}" for mode, digest in as_is.items()), sep="\n", flush=True)
    for row in describe_config():
        section, dot, name = row.key.partition(".")
        if dot and row.key.startswith(begins):
            felt = list[str]()
            for mode, base in bases.items():
                for value in others(base[section][name], row.range):
                    with suppress(Hid2Error):  # out of range
                        now = outcome(scenes, base | {section: base[section] | {name: value}})
                        felt += [mode] * (now != as_is[mode] and mode not in felt)
            print(f"{row.key}: {', '.join(felt) or 'CHANGES NOTHING'}", flush=True)
