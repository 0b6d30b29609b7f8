"""A study from what its runs would cost to its results."""

import math
from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from bridge.batch.batch import OnRow, Options, run_batch, with_own
from bridge.batch.manifest import DONE, ManifestRow
from bridge.files import one_line
from bridge.studies.study import Study, tables
from netconvert.errors import ConfigError

#: What does the runs, and what also writes their trajectories for SSAM.
WORK, WORK_FOR_SSAM = "bridge.studies.paired:measure_runs", "bridge.studies.paired:measure_runs_for_ssam"


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
    study: Study, out_dir: Path | str, options: Options, *, trj: bool = False, on_row: OnRow | None = None
) -> RunsReport:
    """Do the runs that are not done yet, then write tables, figures and the page into out_dir.

    trj: beside each run that is done, its trajectories for SSAM. Errors: BatchError, ExportError, ConfigError where
    out_dir holds another study.
    """
    contents = f"study {study.name}: {study.kind} by {', '.join(study.points[0])}"
    options = replace(options, function=WORK_FOR_SSAM if trj else WORK, functions=study.rules, contents=contents)
    out_dir = Path(out_dir)
    rows = run_batch(study.jobs, out_dir, options, on_row=on_row)
    from bridge.studies.page import write_results  # pandas, statsmodels, matplotlib: at the end

    return RunsReport.of(write_results(study, tables(study, rows, out_dir), out_dir), rows)


def plan_text(study: Study, out_dir: Path, difference: float) -> Iterator[str]:
    """Lines on the runs of a study and on those that a difference in the share accepted between two values needs.

    By chance alone, and by the runs that out_dir has results of, such as a pilot of few seeds. Errors: ConfigError,
    ScenarioError, MapError, ExportError.
    """
    import pandas as pd

    from bridge.studies.statistics import difference_sd, seeds_needed

    if not 0.0 < difference < 1.0:
        raise ConfigError(f"--plan {difference:g}: expected a difference of shares between 0 and 1, as 0.05")
    with_own(study.jobs, study.rules)
    points, seeds, scenes = len(study.points), len(study.seeds), len(study.folders)
    yield f"{points * seeds * scenes} runs: points {points}, seeds {seeds}, scenes {scenes}"
    each = _requests_of_a_run(study)
    yield f"{each} requests of the kind {study.kind} count in the first run, as drawn"
    yield f"runs at each point for a difference of {difference:g} in the share that gets a gap (power .8, level .05):"
    if each:
        yield f"  {seeds_needed(math.sqrt(0.5 / each), difference)} by chance alone, at a share of .5 and unpaired"
    for known in out_dir.glob("requests.csv*"):  # compressed where there are many
        try:
            requests = pd.read_csv(known)
            spread = {key: difference_sd(requests, key) for key in study.keys if key in requests and len(requests)}
        except (OSError, EOFError, ValueError, KeyError) as error:  # damaged, or another table
            said = one_line(f"{type(error).__name__}: {error}", most=200)
            raise ConfigError(f"{known}: {said}, expected the requests of a study; take another folder") from error
        for key in study.keys:
            found = spread.get(key)
            if found is None:
                yield f"  {out_dir} has fewer than three runs with results at both ends of {key}: no spread to go by"
            else:
                sd, runs = found
                yield f"  {seeds_needed(sd, difference)} by the {runs} runs in {out_dir} ({key}: SD {sd:.3f})"


def _requests_of_a_run(study: Study) -> int:
    """Requests of the kind that is studied in the first run that are due after the warm-up, with time for a change."""
    from bridge.generation.generate import prepare  # SUMO
    from bridge.recordings.sources import read_recording
    from bridge.studies.paired import begins_by_s, draw, drawing_config, triggers
    from hid2.insertion.flow import trigger_after_s

    config = study.configs[0][0]
    drawn = draw(prepare(read_recording(study.folders[0]), config), drawing_config(config))
    last_s, trigger_s = drawn.scene.last_s, triggers(config, drawn)
    due = [trigger_s[one.request.number] for one in drawn.starts if one.request.policy.value == study.kind]
    comers = [one for one in drawn.arrivals if one.start.request.policy.value == study.kind]
    due += [one.due_s + trigger_after_s(one, config.request, drawn.seed, last_s) for one in comers]
    return sum(config.flow.counted_from_s <= at_s <= begins_by_s(last_s, config, study.kind) for at_s in due)
