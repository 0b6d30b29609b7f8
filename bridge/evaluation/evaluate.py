"""One pass over any number of scenes, recorded or generated: metrics.json, CSV tables and report.html.

Memory does not grow with the scenes but by their names: tables are written as scenes are done, the rest is in `Totals`.
"""

import contextlib
import logging
import pickle
import zlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import IO

from bridge.batch.engine import OnDone, work_on_each
from bridge.batch.isolation import Failure
from bridge.evaluation.scene_metrics import TABLES, Row, SceneMeasures, measure_folder
from bridge.evaluation.totals import Evaluation, Totals
from bridge.files import table_file, table_text, with_name, write_json, write_rows
from bridge.pages.parts import number, write_page
from bridge.recordings.folders import MAP_PATTERN, Address, Choices, is_generated, source_id
from bridge.recordings.sidecar import sidecar_in
from bridge.recordings.sources import find_recordings, find_scenarios, fitting, source_files
from hid2.evaluation.realism import FEATURES, GENERATED
from hid2.reasons import Reason
from netconvert.errors import ConfigError, ScenarioError

_LOG = logging.getLogger(__name__)


def evaluate_folder(
    out: Path | str, *, report_dir: Path | str, source: Path | str | Sequence[Path] = (),
    choices: Choices | None = None, control: Path | None = None, jobs: int = 1, on_scene: OnDone = None,
) -> Evaluation:  # fmt: skip
    """Measure every scene below `out`, recorded in any format or generated, and write the report into `report_dir`.

    Writes metrics.json, report.html, realism.csv and the tables of TABLES. "Before" is the source scenes of those in
    `out`, each once: as they lie below `source`, else the recorded tracks of the first scene made from each. A scene
    that cannot be read is listed and left out. choices: for recordings of formats that leave something open; control:
    scenes made from the same sources with drivers that the critics must tell, such as SUMO's default ones.
    on_scene(done, total) is called as scenes are done.
    Errors: ScenarioError where there is no scene; ConfigError for other scenes as control; ExportError where the report
    cannot be written.
    """
    # by map, so that each is read once, and large ones first: what a process needs at most it needs from the start
    folders = sorted(find_recordings([Path(out)], choices), key=_map_size, reverse=True)
    report_dir, roots = Path(report_dir), (Path(source),) if isinstance(source, str | Path) else source
    made_of = {*map(_made_of, folders)} - {""} if roots or control is not None else set()
    sources = _sources_of(made_of, roots, choices) if roots else {}
    fitting([*folders, *sources.values()], choices)
    controls = sorted(find_scenarios(control), key=_map_size, reverse=True) if control is not None else []
    if controls and made_of.isdisjoint(map(_made_of, filter(is_generated, controls))):
        raise ConfigError(f"--control {control}: no scene generated from a source of those in {out}, expected some")
    totals, failures = Totals(sources), list[tuple[Address, str]]()
    takes = [totals.add] * len(folders) + [totals.add_source] * len(sources) + [totals.add_control] * len(controls)
    with contextlib.ExitStack() as stack:
        tables: dict[str, tuple[IO[str], Sequence[str]]] = {}
        every = [*folders, *sources.values(), *controls]
        each = work_on_each(measure, every, frozenset(sources), jobs=jobs, chunk=40, timeout_s=120, on_item=on_scene)
        for take, (folder, packed) in zip(takes, each, strict=True):
            if isinstance(packed, Failure):
                failures.append((folder, packed.message))
                continue
            measures: SceneMeasures = pickle.loads(zlib.decompress(packed))  # noqa: S301  # our own child
            take(measures)
            if take != totals.add:  # tables are of the scenes themselves
                continue
            for name, rows in measures.tables.items():
                if name not in tables:  # no folder is made where no scene can be measured
                    stream = stack.enter_context(table_file(report_dir / f"{name}.csv"))
                    tables[name] = stream, TABLES[name] or [*rows[0]]
                    stream.write(table_text([tables[name][1]]))
                tables[name][0].write(table_text(_cells(rows, tables[name][1])))
        if set(folders) <= {folder for folder, _ in failures}:
            said = f"none of {len(folders)} scenes can be read, expected one at least"
            raise ScenarioError(f"{out}: {said}; {with_name(*failures[0])}")
    metrics = totals.content()
    metrics["scenes"]["failed"] = [{"folder": str(at), "reason": why} for at, why in failures]
    write_json(report_dir / "metrics.json", metrics)
    write_table(report_dir / "realism.csv", metrics["realism"]["distances"])
    evaluation = Evaluation(totals, failures, metrics)
    write_report(evaluation, report_dir / "report.html")
    return evaluation


def write_report(evaluation: Evaluation, path: Path) -> None:
    """Write report.html, a page that needs neither the paper nor the code to be understood. Errors: OSError."""
    from bridge.evaluation.paper import PAPER_HID2, PAPER_ORIGINAL  # matplotlib: only this half needs it
    from bridge.pages.charts import distribution_figure, diversity_figure
    from bridge.pictures import figures

    figures.style()
    metrics, totals = evaluation.metrics, evaluation.totals
    is_generated = totals.realism.of(FEATURES[0])[GENERATED].any()
    pictures = {
        "diversity": figures.data_uri(diversity_figure(metrics["diversity"])),
        "distributions": figures.data_uri(distribution_figure(totals.realism)) if is_generated else None,
    }
    write_page(
        path,
        "report.html.j2",
        metrics=metrics,
        pictures=pictures,
        events_listed=totals.events,
        reasons=list(Reason),
        features={feature.name: feature for feature in FEATURES},
        paper={key: (number(PAPER_ORIGINAL[key]), number(PAPER_HID2[key])) for key in PAPER_ORIGINAL},
    )


def _sources_of(ids: set[str], source: Sequence[Path], choices: Choices | None) -> dict[str, Address]:
    """Source scenes by id, as far as they lie below `source`; it is logged where some do not."""
    found = {source_id(one): one for one in find_recordings(source, Choices((choices or Choices()).map_path, stride=1))}
    if lacking := len(ids - found.keys()):
        where = ", ".join(map(str, source))
        _LOG.warning("%s: %d of %d source scenes are not there; their recorded tracks stand", where, lacking, len(ids))
    return {known: found[known] for known in sorted(ids & found.keys())}


def _made_of(folder: Address) -> str:
    """Id of the scene that one was made from, its own where it was recorded; "" where that cannot be read."""
    with contextlib.suppress(ScenarioError):  # reported with its scene
        sidecar = sidecar_in(folder) if isinstance(folder, Path) else None
        return sidecar.source_scenario_id if sidecar is not None else source_id(folder)
    return ""


def measure(sources: frozenset[str], folder: Address) -> bytes:
    """Measures of a scene, packed to a tenth: many may wait for one before them."""
    return zlib.compress(pickle.dumps(measure_folder(folder, sources)), 1)


def _map_size(folder: Address) -> int:
    """Bytes of a scene's map: scenes in this order have those of one map together, so that it is read once."""
    maps = folder.glob(MAP_PATTERN) if isinstance(folder, Path) else source_files(folder)[1:]
    return sum(path.stat().st_size for path in maps)


def write_table(path: Path, rows: Sequence[Row]) -> None:
    """Rows, one at least, as a CSV file. Errors: ExportError."""
    write_rows(path, [*rows[0]], _cells(rows, [*rows[0]]))


def _cells(rows: Iterable[Row], columns: Sequence[str]) -> Iterator[list[object]]:
    return ([_cell(row[column]) for column in columns] for row in rows)


def _cell(value: object) -> object:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, dict):
        return "; ".join(f"{key} ({count})" for key, count in value.items())
    return "" if value is None else value
