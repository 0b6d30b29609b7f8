"""`hid2 validate`: scenes are checked in the order of their folders, with several jobs in processes of their own."""

from collections.abc import Sequence
from pathlib import Path

from bridge.batch.engine import OnDone, work_on_each
from bridge.batch.isolation import Failure
from bridge.recordings.folders import Choices, find_scenarios, source_id
from bridge.recordings.sources import find_recordings
from bridge.recordings.validate import Against, FileBreach, check_tree, validate_scene

#: Scenes that a process gets at a time; no tunable: starting one takes as long as checking so many.
_CHUNK = 50


def validate_folder(
    out: Path,
    *,
    source: Path | Sequence[Path] = (),
    map_path: Path | None = None,
    inserted: Sequence[str] = (),
    jobs: int = 1,
    on_scene: OnDone = None,
) -> list[FileBreach]:
    """Check every scenario under a data set that was generated, or mixed; what is wrong, and notes.

    out: a scenario folder, a split folder or a data-set root; source: where its recordings lie; map_path: the map that
    was chosen for them; inserted: ids of the tracks that are judged, those that hid2 inserted unless told.
    Errors: ScenarioError where out or source is no folder or holds no scenario.
    """
    folders, sources = find_scenarios(out), [source] if isinstance(source, Path) else [*source]
    recorded = None
    if sources:  # every window of a log among them
        recorded = {source_id(one): one for one in find_recordings(sources, Choices(map_path, stride=1))}
    against = Against(out, recorded, frozenset(inserted) or None)
    findings = check_tree(out, folders)
    each = work_on_each(
        validate_scene, folders, shared=against, jobs=jobs, chunk=_CHUNK, timeout_s=120, isolated=jobs > 1,
        on_item=on_scene,
    )  # fmt: skip
    for folder, found in each:
        findings += [FileBreach(folder, "folder", found.message)] if isinstance(found, Failure) else found
    return findings
