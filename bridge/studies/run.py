"""A study from its runs to its results."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from bridge.batch.batch import Options, Progress, run_batch
from bridge.batch.manifest import DONE, ManifestRow
from bridge.studies.study import Study, tables

#: What does the runs, and what also writes their trajectories for SSAM.
WORK, WORK_FOR_SSAM = "bridge.studies.study_work:measure_runs", "bridge.studies.study_work:measure_runs_for_ssam"


@dataclass(frozen=True, slots=True)
class StudyReport:
    """What a study wrote. failed: runs without a result."""

    files: tuple[Path, ...]
    runs: int
    failed: int


def run_study(
    study: Study,
    out_dir: Path,
    options: Options,
    *,
    trj: bool = False,
    on_row: Callable[[ManifestRow, Progress], None] | None = None,
) -> StudyReport:
    """Do the runs that are not done yet, then write tables, figures and the page into out_dir.

    trj: beside each run that is done, its trajectories for SSAM. Errors: BatchError, ExportError.
    """
    named = {config.lane_change.rule for configs in study.configs for config in configs}  # in the user's own file
    options = replace(options, function=WORK_FOR_SSAM if trj else WORK, functions=named)
    rows = run_batch(study.jobs, out_dir, options, on_row=on_row)
    from bridge.studies.page import write_results  # pandas, statsmodels, matplotlib: at the end

    files = write_results(study, tables(study, rows, out_dir), out_dir)
    return StudyReport(tuple(files), len(rows), sum(row.status != DONE for row in rows))
