"""`hid2 validate`: scenes are checked in the order of their folders, with several jobs in processes of their own."""

from collections.abc import Sequence
from contextlib import suppress
from difflib import get_close_matches
from pathlib import Path

from bridge.batch.engine import OnDone, work_on_each
from bridge.batch.isolation import Failure
from bridge.recordings.folders import Choices, source_id
from bridge.recordings.scenario import read_table
from bridge.recordings.sources import find_recordings, find_scenarios, fitting
from bridge.recordings.validate import Against, FileBreach, check_tree, validate_scene
from netconvert.errors import ConfigError, ScenarioError


def validate_folder(
    out: Path | str,
    *,
    source: Path | str | Sequence[Path] = (),
    map_path: Path | None = None,
    inserted: Sequence[str] = (),
    jobs: int = 1,
    on_scene: OnDone = None,
) -> list[FileBreach]:
    """Check every scenario under a data set that was generated, or mixed; what is wrong, and notes.

    out: a scenario folder, a split folder or a data-set root; source: where its recordings lie; map_path: the map that
    was chosen for them; inserted: ids of the tracks that are judged, those that hid2 inserted unless told.
    Errors: ScenarioError where out or source is no folder or holds no scenario; ConfigError for a track of no scene.
    """
    out, sources = Path(out), [Path(source)] if isinstance(source, str | Path) else [*source]
    folders = find_scenarios(out)
    _check_known(inserted, folders)
    given = find_recordings(sources, Choices(map_path, stride=1)) if sources else []  # every window of a log
    recorded = {source_id(one): one for one in fitting(given, Choices(map_path))}
    against = Against(out, recorded if sources else None, frozenset(inserted) or None)
    findings = check_tree(out, folders)
    # starting a process takes as long as checking 50
    each = work_on_each(
        validate_scene, folders, against, jobs=jobs, chunk=50, timeout_s=120, isolated=jobs > 1, on_item=on_scene
    )
    for folder, found in each:
        findings += [FileBreach(folder, "folder", found.message)] if isinstance(found, Failure) else found
    return findings


def _check_known(inserted: Sequence[str], folders: Sequence[Path]) -> None:
    """Errors: ConfigError for ids of tracks that no scene has; those read first mostly have them all."""
    ids, left = set[str](), iter(folders)
    with suppress(ScenarioError):  # a finding, and its scene may have the track
        while (unknown := sorted({*inserted} - ids)) and (folder := next(left, None)):
            ids.update(read_table(folder / f"scenario_{folder.name}.parquet")["track_id"].to_pylist())
        if unknown:
            few = ", ".join(get_close_matches(unknown[0], ids, 5, 0.0))
            raise ConfigError(f"--inserted {', '.join(unknown)}: no scene has it, expected one of {few}, ...")
