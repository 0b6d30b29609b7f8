"""A study from its runs to its results."""

from collections.abc import Collection, Iterable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from bridge.batch.batch import OnRow, Options, run_batch
from bridge.batch.manifest import DONE, ManifestRow
from bridge.studies.study import Study, tables

#: What does the runs, and what also writes their trajectories for SSAM.
WORK, WORK_FOR_SSAM = "bridge.studies.study_work:measure_runs", "bridge.studies.study_work:measure_runs_for_ssam"


class RunsReport(NamedTuple):
    """What a study or a page of public roads wrote, its runs, those without a result, and what they took, s."""

    files: tuple[Path, ...]
    runs: int
    failed: int
    seconds: float

    @classmethod
    def of(cls, files: Iterable[Path], rows: Collection[ManifestRow]) -> "RunsReport":
        """The report of some runs."""
        return cls(tuple(files), len(rows), sum(row.status != DONE for row in rows), sum(row.seconds for row in rows))


def run_study(
    study: Study, out_dir: Path, options: Options, *, trj: bool = False, on_row: OnRow | None = None
) -> RunsReport:
    """Do the runs that are not done yet, then write tables, figures and the page into out_dir.

    trj: beside each run that is done, its trajectories for SSAM. Errors: BatchError, ExportError.
    """
    options = replace(options, function=WORK_FOR_SSAM if trj else WORK, functions=study.rules)  # in the user's own file
    rows = run_batch(study.jobs, out_dir, options, on_row=on_row)
    from bridge.studies.page import write_results  # pandas, statsmodels, matplotlib: at the end

    return RunsReport.of(write_results(study, tables(study, rows, out_dir), out_dir), rows)
