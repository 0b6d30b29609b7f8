"""`hid2 validate`: everything that readers of a generated data set demand, also what they would not complain about.

The rules are in `rules`; what is checked of rows, map and sidecar in `row_rules`, `map_rules`, `sidecar_rules`.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa

from bridge.config import REACTIVE_PREFIX
from bridge.files import read_regular
from bridge.recordings.export import map_bytes, recording_record_of
from bridge.recordings.folders import (
    RAW,
    SPLITS,
    Address,
    Choices,
    Source,
    find_scenarios,
    sequence_path,
    source_id,
    split_of,
)
from bridge.recordings.limits import MAX_FILE_MB
from bridge.recordings.map_rules import compare_map, read_map
from bridge.recordings.recording import Recording
from bridge.recordings.row_rules import Rows, check_generated, check_rows, compare_rows
from bridge.recordings.rules import RECORDED, RULES
from bridge.recordings.scenario import read_sizes, read_table
from bridge.recordings.scene_end_rule import check_scene_end
from bridge.recordings.sequence_rules import check_written_sequence
from bridge.recordings.sidecar import REACTIVE, Sidecar, read_sidecar, sidecar_path
from bridge.recordings.sidecar_rules import check_sidecar
from bridge.recordings.sources import find_recordings, read_recording
from hid2.agents import BoxSize
from netconvert.errors import Hid2Error, MapError, ScenarioError


class Finding(NamedTuple):
    """One breach of one rule."""

    file: Path
    rule: str
    message: str

    @property
    def is_note(self) -> bool:
        """Whether it is about the source, which is kept as it is, and no fault of the scene."""
        return self.rule == RECORDED


def validate_folder(out: Path, *, source: Path | None = None, map_path: Path | None = None) -> list[Finding]:
    """Check every scenario under a data set that was generated, or mixed; source: where its recordings lie.

    out: a scenario folder, a split folder or a data-set root; source: recordings of any format; map_path: the map that
    was chosen for them. Returns what is wrong, and notes on what the source brings along; nothing if all is well.
    Errors: ScenarioError where out or source is no folder or holds no scenario.
    """
    folders = find_scenarios(out)
    sources = _index_sources(source, map_path) if source is not None else None
    findings = list(_check_tree(out, folders))
    for folder in folders:
        findings += validate_scene(folder, sources=sources, out=out)
    return findings


def validate_scene(
    folder: Path, *, sources: Mapping[str, Address] | None = None, out: Path | None = None
) -> list[Finding]:
    """Check one scenario folder, and its sequence of Argoverse 1 below out where there is one.

    sources: recordings by id, None for no comparison. A scene without sidecar in which no track is a generated one was
    recorded: it is held to the format alone.
    """
    findings: list[Finding] = []
    new_id = folder.name
    parquet_path = folder / f"scenario_{new_id}.parquet"
    map_path = folder / f"log_map_archive_{new_id}.json"
    wanted = (parquet_path, map_path)
    findings += [Finding(path, "folder", "no such file") for path in wanted if not path.is_file()]

    sidecar = None
    if sidecar_path(folder, new_id).is_file():
        try:
            sidecar = read_sidecar(sidecar_path(folder, new_id))
        except ScenarioError as error:
            findings.append(Finding(sidecar_path(folder, new_id), "sidecar", str(error)))
    document = None
    if map_path.is_file():
        document, breaches = read_map(map_path)
        findings += [Finding(map_path, *breach) for breach in breaches]
    rows = None
    if parquet_path.is_file():
        try:
            rows = _rows(parquet_path, sidecar)
        except ScenarioError as error:
            findings.append(Finding(parquet_path, "columns", str(error)))

    if new_id.startswith(REACTIVE_PREFIX) or (sidecar is not None and sidecar.replay.mode == "reactive"):
        return [Finding(folder, "replay", REACTIVE)]  # whatever else it is, it is no scene of Argoverse
    findings += _missing_sidecar(folder, rows)
    generated_ids: set[str] = {agent.track_id for agent in sidecar.agents} if sidecar is not None else set()
    if rows is not None:
        generated_ids |= {track_id for track_id in rows.ids if track_id.startswith("gen_")}
        breaches = list(check_rows(rows, new_id))
        for track_id in sorted(generated_ids & set(rows.ids)):
            breaches += check_generated(rows, track_id)
        if all(rule == RECORDED for rule, _ in breaches):  # what it reads is sound
            breaches += check_scene_end(rows, generated_ids, sizes=_sizes(sidecar, sources))
        findings += [Finding(parquet_path, *breach) for breach in breaches]
    if sidecar is not None:
        begins = rows.begins() if rows is not None else None
        lanes = {str(lane) for lane in document["lane_segments"]} if document is not None else None
        breaches = list(check_sidecar(sidecar, new_id, begins=begins, generated_ids=generated_ids, lanes=lanes))
        findings += [Finding(sidecar_path(folder, new_id), *breach) for breach in breaches]
    source = None
    if sources is not None and sidecar is not None:
        try:
            source = _compared(sources, sidecar.source_scenario_id)
        except Hid2Error as error:
            return [*findings, Finding(sidecar_path(folder, new_id), "source", str(error))]
        findings += _compare(source, sidecar, folder, rows=rows, document=document, generated_ids=generated_ids)
    if out is not None and rows is not None and sidecar is not None:
        findings += _check_sequence(out, folder, rows, generated_ids, source)
    return findings


def _rows(path: Path, sidecar: Sidecar | None) -> Rows:
    """The rows of a scene, with the steps of its recording. Errors: ScenarioError."""
    known = sidecar.recording if sidecar is not None else None
    table = read_table(path)
    return Rows(table) if known is None else Rows(table, observed_steps=known.observed_steps, step_s=known.step_s)


class _Compared(NamedTuple):
    """What a scene is compared with. recording: of a source in another format."""

    table: pa.Table
    map_json: bytes
    map_name: str
    recording: Recording | None


def _compared(sources: Mapping[str, Address], scenario_id: str) -> _Compared:
    """The source of a scene. Errors: ScenarioError, MapError."""
    address = sources.get(scenario_id)
    if address is None:
        raise ScenarioError(f"source scenario {scenario_id} is not among the {len(sources)} given")
    if isinstance(address, Source):
        recording = read_recording(address)
        return _Compared(recording.table, map_bytes(recording), recording.map_path.name, recording)
    table = read_table(address / f"scenario_{scenario_id}.parquet")
    path = address / f"log_map_archive_{scenario_id}.json"
    try:
        return _Compared(table, read_regular(path, most_mb=MAX_FILE_MB), path.name, None)
    except OSError as error:
        raise MapError(f"{path}: cannot be read ({error})") from error


def _compare(
    source: _Compared, sidecar: Sidecar, folder: Path, *, rows: Rows | None, document: Mapping[str, Any] | None,
    generated_ids: set[str],
) -> list[Finding]:  # fmt: skip
    """Rows, map and sidecar of a scene against its source."""
    findings = []
    if rows is not None:
        messages = compare_rows(rows.table, source.table, generated_ids)
        findings += [Finding(folder / f"scenario_{folder.name}.parquet", "source", message) for message in messages]
    if document is not None:
        path = folder / f"log_map_archive_{folder.name}.json"
        messages = compare_map(path, document, source.map_json, name=source.map_name)
        findings += [Finding(path, "source", message) for message in messages]
    if source.recording is not None and sidecar.recording != recording_record_of(source.recording):
        message = "recording: not that of the source"
        findings.append(Finding(sidecar_path(folder, folder.name), "source", message))
    return findings


def _missing_sidecar(folder: Path, rows: Rows | None) -> list[Finding]:
    """A finding where there is no sidecar, unless none of the tracks is a generated one: the scene was recorded."""
    path = sidecar_path(folder, folder.name)
    generated = rows is None or any(track_id.startswith("gen_") for track_id in rows.ids)
    message = "no such file, which every generated scene has (a recorded one has none)"
    return [Finding(path, "folder", message)] if generated and not path.is_file() else []


def _check_sequence(
    out: Path, folder: Path, rows: Rows, generated_ids: set[str], source: _Compared | None
) -> list[Finding]:
    path = sequence_path(out, split_of(folder), folder.name)
    if not path.is_file():
        return []
    recording = source.recording if source is not None else None
    return [Finding(path, *breach) for breach in check_written_sequence(path, rows, generated_ids, source=recording)]


def _sizes(sidecar: Sidecar | None, sources: Mapping[str, Address] | None) -> dict[str, BoxSize]:
    """Boxes by track id as far as they are known: of generated tracks, and of recorded ones beside their source."""
    if sidecar is None:
        return {}
    source = (sources or {}).get(sidecar.source_scenario_id)
    recorded = read_sizes(source) if isinstance(source, Path) else {}
    return recorded | sidecar.boxes


def _check_tree(out: Path, folders: Sequence[Path]) -> Iterator[Finding]:
    expected = {folder / f"scenario_{folder.name}.parquet" for folder in folders}
    for path in sorted(out.rglob("*.parquet")):
        if path not in expected:
            yield Finding(path, "other-parquet", RULES["other-parquet"])
    for folder in folders:
        depth = len(folder.relative_to(out).parts)
        split = folder.parent.parent.name if depth == 3 and folder.parent.name == RAW else folder.parent.name
        if depth > 1 and split not in SPLITS:
            yield Finding(folder, "folder", f"split {split!r}, expected one of {', '.join(SPLITS)}")


def _index_sources(source: Path, map_path: Path | None) -> dict[str, Address]:
    """Recordings by id, every window of a log among them."""
    return {source_id(address): address for address in find_recordings([source], Choices(map_path, stride=1))}
