"""A generated scene made again from its sidecar and its recorded scene, and compared bit for bit."""

import filecmp
from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from bridge.batch.batch import Options, Run, SceneJob, run_batch
from bridge.batch.manifest import DONE
from bridge.config import config_from_dict, config_sha256
from bridge.recordings.folders import PARQUET_PATTERN, SIDECAR_PATTERN, Choices, source_id, split_of
from bridge.recordings.sidecar import read_sidecar
from bridge.recordings.sources import find_recordings, fitting
from netconvert.errors import BatchError, ConfigError, NoSceneError


class MadeAgain(NamedTuple):
    """Where the scene was written; a line for each file that differs; whether files lay beside the sidecar at all."""

    folder: Path
    differences: tuple[str, ...]
    compared: bool
    program: str = ""  # what is other than in the one that made it; that alone is no difference of a sidecar


def make_again(
    sidecar_path: Path, source: Path, out: Path, *, map_path: Path | None = None, functions: Collection[str] = ()
) -> MadeAgain:
    """Make a scene again into `out`; `source`: where its recording lies, map_path: the map that was chosen for it.

    functions: of a user's own that the sidecar may name. Errors: ScenarioError for what is no sidecar; ConfigError
    where its configuration is of another version, or OUT is where the scene lies; NoSceneError; BatchError.
    """
    sidecar = read_sidecar(sidecar_path)
    then = "made by " + ", ".join(f"{name} {version}" for name, version in sidecar.program.items())
    try:
        config = config_from_dict(sidecar.config, source=f"{sidecar_path}: config")
    except ConfigError as error:
        raise ConfigError(f"{error}; {then}: use that program") from error
    if config_sha256(config) != sidecar.config_sha256:
        raise ConfigError(
            f"{sidecar_path}: config_sha256 {sidecar.config_sha256[:12]}..., expected {config_sha256(config)[:12]}..., "
            f"that of its configuration: edited, or of another version ({then}): use that program"
        )
    wanted = sidecar.source_scenario_id
    choices = Choices(map_path, sidecar.recording.first_step)
    there = fitting(find_recordings([source], choices), Choices(map_path))
    found = [place for place in there if source_id(place) == wanted]
    if len(found) != 1:
        have = f"{len(found)} scenes {wanted}, expected one" if found else f"no recorded scene {wanted}"
        raise NoSceneError(f"{source}: {have}, of which {sidecar_path} was made; give the ROOT that it lies in")
    beside = sidecar_path.parent.resolve()
    if (out / (split_of(found[0]) or "") / beside.name).resolve() == beside:
        raise ConfigError(f"{out}: holds the scene of {sidecar_path} itself; choose another output folder")
    job, options = SceneJob(found[0], (Run(config, sidecar.variant),)), Options(timeout_s=600, functions=functions)
    (row,) = run_batch([job], out, options)
    if row.status != DONE:
        raise BatchError(f"{found[0]}: could not be made again: {row.reason}")
    folder = out / row.folder
    if not any(beside.glob(PARQUET_PATTERN)):
        return MadeAgain(folder, (), compared=False)
    (made_path,) = folder.glob(SIDECAR_PATTERN)
    made = read_sidecar(made_path)
    was, here = sidecar.program, made.program
    changed = [name for name in here if was.get(name) != here[name]]
    program = ", ".join(f"{name} {was.get(name, 'not said')} then and {here[name]} now" for name in changed)
    apart = {"schema_version", "generator", "sumo_version"}
    differences = []
    for path in sorted([*folder.glob(PARQUET_PATTERN), *folder.glob("log_map_archive_*.json"), made_path]):
        old = beside / path.name
        if changed and path == made_path and made.model_dump(exclude=apart) == sidecar.model_dump(exclude=apart):
            continue
        if not old.is_file():
            differences.append(f"{old}: no such file, to compare {path} with")
        elif not filecmp.cmp(old, path, shallow=False):
            differences.append(f"{path}: differs from {old}; {program or 'code and libraries were the same'}")
    return MadeAgain(folder, tuple(differences), compared=True, program=program)
