"""Before a study runs: how many runs there are, and how many a difference of a given size needs."""

import math
from collections.abc import Iterator
from pathlib import Path

from bridge.batch.batch import with_own
from bridge.files import one_line
from bridge.generation.generate import prepare
from bridge.recordings.sources import read_recording
from bridge.studies.paired import draw, drawing_config, triggers
from bridge.studies.statistics import difference_sd, seeds_needed
from bridge.studies.study import Study
from hid2.insertion.flow import trigger_after_s
from netconvert.errors import ConfigError


def plan_text(study: Study, out_dir: Path, difference: float) -> Iterator[str]:
    """Lines on the runs of a study and on those that a difference in the share accepted between two values needs.

    By chance alone, and by the runs that out_dir has results of, such as a pilot of few seeds. Errors: ConfigError,
    ScenarioError, MapError, ExportError.
    """
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
        import pandas as pd

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
                yield f"  {seeds_needed(sd, difference)} by the {runs} seeds in {out_dir} ({key}: SD {sd:.3f})"


def _requests_of_a_run(study: Study) -> int:
    """Requests of the kind that is studied in the first run that are due after the warm-up and before the end."""
    config = study.configs[0][0]
    prepared = prepare(read_recording(study.folders[0]), config)
    drawn = draw(prepared, drawing_config(config))
    last_s, trigger_s = drawn.scene.last_s, triggers(config, drawn)
    due = [trigger_s[one.request.number] for one in drawn.starts if one.request.policy.value == study.kind]
    comers = [one for one in drawn.arrivals if one.start.request.policy.value == study.kind]
    due += [one.due_s + trigger_after_s(one, config.request, drawn.seed, last_s) for one in comers]
    return sum(config.flow.counted_from_s <= at_s < last_s for at_s in due)
