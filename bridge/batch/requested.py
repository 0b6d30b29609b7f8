"""What a command asks for: whether any of its scenes can meet it, before the first is driven, and whether one did."""

import contextlib
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bridge.batch.engine import work_on_each
from bridge.batch.isolation import Failure
from bridge.batch.manifest import DONE, MANIFEST_NAME, ManifestRow, read_manifest
from bridge.config import config_sha256, config_to_dict
from bridge.files import one_line
from bridge.recordings.folders import SIDECAR_PATTERN, Address
from hid2.params import Config, Request
from hid2.policies import Policy
from netconvert.errors import ConfigError, Hid2Error

#: Most scenes that are looked at for one that can meet what is asked for.
_LOOKED_AT = 100
#: Trigger time up to which no scene is looked at, s: the shortest recordings last longer.
_SHORTEST_S = 4.9


def named_behaviours(request: Request, *, by_option: bool) -> tuple[Policy, ...]:
    """Behaviours asked for by name: all in --behaviours, else those with another share than the usual; not straight."""
    usual = dict(Request().behaviours)
    return tuple(
        policy
        for policy, share in request.behaviours.items()
        if share > 0 and policy is not Policy.STRAIGHT and (by_option or share != usual.get(policy))
    )


def may_be_impossible(config: Config, named: Sequence[Policy]) -> bool:
    """Whether something is asked for that a scene may not offer: else none is looked at first."""
    return bool(named or config.event or config.request.is_near_agents or config.request.first_trigger_s > _SHORTEST_S)


def check_request(folders: Sequence[Address], config: Config, named: Sequence[Policy], *, jobs: int) -> None:
    """Look at the first scenes until each thing asked for can come about in one. Errors: ConfigError if none can."""
    if not may_be_impossible(config, named):
        return
    told, never = list[dict[str, str]](), dict[str, str]()
    each = work_on_each(never_in_scene, folders[:_LOOKED_AT], (config, named), jobs=jobs, chunk=1, timeout_s=60.0)
    with contextlib.closing(each):
        for folder, found in each:
            if isinstance(found, Failure):
                continue
            where = f"{folder}, for one" if len(folders) > 1 else f"{folder}"
            told.append({asked: f"{where}: {why}" for asked, why in found.items()})
            if not (never := {asked: why for asked, why in told[0].items() if all(asked in one for one in told)}):
                return
    for asked, why in never.items():
        looked = f"{len(told)} of {len(folders)}"
        raise ConfigError(f"{asked}: can come about in none of the scenes looked at ({looked}); {why}")


def never_in_scene(shared: tuple[Config, Sequence[Policy]], folder: Address) -> dict[str, str]:
    """What can never come about in a scene, each with the reason; `is_shown` of each behaviour is tried in it."""
    from bridge.generation.scene import scene_of
    from bridge.recordings.judging import recording_states
    from bridge.recordings.sources import read_recording
    from hid2.insertion.feasible import impossible
    from hid2.measures.manoeuvres import Maneuver
    from hid2.policy.behaviours import BEHAVIOURS, is_shown

    (config, named), recording = shared, read_recording(folder)
    found = impossible(scene_of(recording, config), named)
    track, lane = max(recording.tracks, key=lambda one: one.path_m), min(recording.graph.lanes)
    states = recording_states(recording, [track])
    for policy in named:
        made_up = Maneuver(track.track_id, BEHAVIOURS[policy].seen_as[0], 1.0, 2.0, 3.0, lane, lane, 1, complete=True)
        try:
            is_shown(policy, states, made_up)
        except ConfigError as error:
            found[f"behaviour {policy}"] = str(error)
    return found


def check_same_request(out: Path, config: Config) -> None:
    """Errors: ConfigError where a folder holds scenes, and none of this request."""
    rows = [row for row in read_manifest(out / MANIFEST_NAME)[0] if row.folder and (out / row.folder).is_dir()]
    digests = {row.config_sha256 for row in rows}
    # a batch that was killed may have left scenes without a row
    found = [out / row.folder for row in rows[-1:]] or [path.parent for path in out.glob(f"*/*/{SIDECAR_PATTERN}")]
    if not found or config_sha256(config) in digests:
        return
    from bridge.recordings.sidecar import read_sidecar

    before, now = dict[str, Any](), _flat(config_to_dict(config))
    with contextlib.suppress(Hid2Error, StopIteration):
        sidecar = read_sidecar(next(found[0].glob(SIDECAR_PATTERN)))
        before = _flat(sidecar.config)
        digests.add(sidecar.config_sha256)
    if not digests or config_sha256(config) in digests:
        return
    changed = [f"{key} was {before[key]}, is {now[key]}" for key in now if before.get(key, now[key]) != now[key]]
    said = one_line(", ".join(changed), most=300) or "its configuration has another digest"
    raise ConfigError(
        f"{out}: holds scenes of another request ({said}); expected another OUT, the same request, or --append to add "
        "scenes to those there"
    )


def _flat(values: Mapping[str, Any]) -> dict[str, Any]:
    parts = {key: value if isinstance(value, dict) else {"": value} for key, value in values.items()}
    return {f"{part}.{key}".rstrip("."): value for part, found in parts.items() for key, value in found.items()}


def came_about_nowhere(rows: Sequence[ManifestRow], config: Config, named: Sequence[Policy]) -> list[str]:
    """What was asked for and came about in none of the scenes that are done."""
    done, asked = [row for row in rows if row.status == DONE], Counter[str]()
    for event in config.event:
        asked[f"{event.kind} with {event.target}"] += event.count * len(done)
    nowhere = [name for name, count in asked.items() if 0 < count <= _not_done(done, name)]
    kinds = {one: one.value for one in named}
    if config.request.own:  # rows tell of these by what they are seen as
        from hid2.policy.behaviours import BEHAVIOURS  # slow to import, and loaded by now

        kinds = {one: BEHAVIOURS[one].seen_as[0].value for one in named}
    unseen = [one for one, kind in kinds.items() if not any(getattr(row, kind) for row in done)]
    nowhere += [one for one in unseen if _not_done(done, kinds[one])]
    is_empty = done and config.request.agents != 0 and not any(row.placed for row in done)
    return [*nowhere, *(["any vehicle"] if is_empty else [])]


def _not_done(rows: Sequence[ManifestRow], name: str) -> int:
    """How often something did not come about, by the texts "name: reason (count); ..."."""
    entry = re.compile(rf"(?:^|; ){re.escape(name)}: .*? \((\d+)\)(?=; |$)")
    return sum(int(count) for row in rows for count in entry.findall(row.not_done))
