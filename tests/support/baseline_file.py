"""A baseline's forecasts as a file, as another forecaster's are."""

from pathlib import Path

from bridge.forecasting.predictions import Baseline, baseline, write_forecasts
from bridge.recordings.scenario import read_rows
from bridge.recordings.sources import find_scenarios


def write_baseline(out: Path, path: Path, *, kind: Baseline) -> Path:
    """Forecasts of the focal tracks below `out`, in a submission file."""
    scenes = (read_rows(folder)[0] for folder in find_scenarios(out))
    return write_forecasts({rows.scenario_id: baseline(rows, kind) for rows in scenes}, path)
