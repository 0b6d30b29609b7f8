"""`hid2 validate`: everything that readers of a generated data set demand, also what they would not complain about.

The rules are in `rules`; what is checked of rows, map and sidecar in `row_rules`, `map_rules`, `sidecar_rules`.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from bridge.recordings.map_rules import compare_map, read_map
from bridge.recordings.row_rules import Rows, check_generated, check_rows, compare_rows
from bridge.recordings.rules import RECORDED, RULES
from bridge.recordings.scenario import RAW, SPLITS, find_scenarios, read_sizes, read_table
from bridge.recordings.scene_end_rule import check_scene_end
from bridge.recordings.sidecar import Sidecar, read_sidecar, sidecar_path
from bridge.recordings.sidecar_rules import check_sidecar
from hid2.agents import BoxSize
from netconvert.errors import ScenarioError


class Finding(NamedTuple):
    """One breach of one rule."""

    file: Path
    rule: str
    message: str

    @property
    def is_note(self) -> bool:
        """Whether it is about the source, which is kept as it is, and no fault of the scene."""
        return self.rule == RECORDED


def validate_folder(out: Path, *, source: Path | None = None) -> list[Finding]:
    """Check every scenario under a data set that was generated, or mixed; source: where its recorded scenes lie.

    out and source: a scenario folder, a split folder or a data-set root. Returns what is wrong, and notes on what the
    source brings along; nothing if all is well.
    Errors: ScenarioError where out or source is no folder or holds no scenario.
    """
    folders = find_scenarios(out)
    sources = _index_sources(source) if source is not None else None
    findings = list(_check_tree(out, folders))
    for folder in folders:
        findings += validate_scene(folder, sources=sources)
    return findings


def validate_scene(folder: Path, *, sources: Mapping[str, Path] | None = None) -> list[Finding]:
    """Check one scenario folder; sources: folders of recorded scenarios by id, None for no comparison.

    A scene without sidecar in which no track is a generated one was recorded: it is held to the format alone.
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
            rows = Rows(read_table(parquet_path))
        except ScenarioError as error:
            findings.append(Finding(parquet_path, "columns", str(error)))

    findings += _missing_sidecar(folder, rows)
    generated_ids: set[str] = {agent.track_id for agent in sidecar.agents} if sidecar is not None else set()
    if rows is not None:
        generated_ids |= {track_id for track_id in rows.ids if track_id.startswith("gen_")}
        breaches = list(check_rows(rows, new_id))
        for track_id in sorted(generated_ids & set(rows.ids)):
            breaches += check_generated(rows, track_id)
        if all(rule == RECORDED for rule, _ in breaches):  # what it reads is sound
            breaches += check_scene_end(rows.table, generated_ids, sizes=_sizes(sidecar, sources))
        findings += [Finding(parquet_path, *breach) for breach in breaches]
    if sidecar is not None:
        track_ids = set(rows.ids) if rows is not None else None
        lanes = {str(lane) for lane in document["lane_segments"]} if document is not None else None
        breaches = list(check_sidecar(sidecar, new_id, track_ids=track_ids, generated_ids=generated_ids, lanes=lanes))
        findings += [Finding(sidecar_path(folder, new_id), *breach) for breach in breaches]
    if sources is not None and sidecar is not None:
        source = sources.get(sidecar.source_scenario_id)
        if source is None:
            message = f"source scenario {sidecar.source_scenario_id} is not among the {len(sources)} given"
            return [*findings, Finding(sidecar_path(folder, new_id), "source", message)]
        source_id = sidecar.source_scenario_id
        if rows is not None:
            messages = compare_rows(rows.table, source / f"scenario_{source_id}.parquet", generated_ids)
            findings += [Finding(parquet_path, "source", message) for message in messages]
        if document is not None:
            messages = compare_map(map_path, document, source / f"log_map_archive_{source_id}.json")
            findings += [Finding(map_path, "source", message) for message in messages]
    return findings


def _missing_sidecar(folder: Path, rows: Rows | None) -> list[Finding]:
    """A finding where there is no sidecar, unless none of the tracks is a generated one: the scene was recorded."""
    path = sidecar_path(folder, folder.name)
    generated = rows is None or any(track_id.startswith("gen_") for track_id in rows.ids)
    message = "no such file, which every generated scene has (a recorded one has none)"
    return [Finding(path, "folder", message)] if generated and not path.is_file() else []


def _sizes(sidecar: Sidecar | None, sources: Mapping[str, Path] | None) -> dict[str, BoxSize]:
    """Boxes by track id as far as they are known: of generated tracks, and of recorded ones beside their source."""
    if sidecar is None:
        return {}
    source = (sources or {}).get(sidecar.source_scenario_id)
    recorded = read_sizes(source) if source is not None else {}
    return recorded | {agent.track_id: BoxSize(agent.length_m, agent.width_m) for agent in sidecar.agents}


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


def _index_sources(source: Path) -> dict[str, Path]:
    found = [path for folder in find_scenarios(source) for path in folder.glob("scenario_*.parquet")]
    return {path.stem.removeprefix("scenario_"): path.parent for path in found}
