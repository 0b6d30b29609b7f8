"""Forecasts of several models on the same scenes, compared in pairs, with intervals over scenes and over seeds.

A model is one file of predictions for each seed it was trained with. Scenes are drawn as recorded scenes, with all that
was made of one, and seeds of each model on its own: what is left is what other scenes and another seed would give.
"""

import html
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from bridge.evaluation import pages
from bridge.evaluation.predictions import BASELINES, BOUNDS, PredictionScores, Score, bands, score_predictions
from bridge.files import explained, make_folder, write_json, write_rows, write_text
from bridge.recordings.scenario import find_scenarios, source_id
from hid2.agents import FloatArray
from hid2.params import Forecasting
from netconvert.errors import ConfigError, ScenarioError

MetricKey = Literal["min_ade_m", "min_fde_m", "missed", "brier_min_fde"]
#: Metrics by key, with their names.
METRICS: Mapping[MetricKey, str] = {
    "min_ade_m": "minADE, m", "min_fde_m": "minFDE, m", "missed": "MR", "brier_min_fde": "brier-minFDE, m",
}  # fmt: skip
#: Futures that count in comparisons, as in the paper's tables.
K = 6
#: Normal quantiles of a two-sided test at 5 %, and of a power of 80 %.
_Z_TEST, _Z_POWER = 1.959964, 0.841621
#: Weights drawn at a time: the memory of the bootstrap does not grow with the scenes.
_BLOCK = 4_000_000

#: Scores of a model, one sequence for each seed.
Runs = Sequence[Sequence[Score]]


class Estimate(NamedTuple):
    """A mean with its 95 % interval by bootstrap; None where there is nothing. se: standard error."""

    value: float | None
    low: float | None
    high: float | None
    se: float | None = None


NOTHING = Estimate(None, None, None)


class Difference(NamedTuple):
    """A model minus another one, on the tracks that all of their files forecast.

    sources: recorded scenes behind them, which are drawn; detectable: least difference that such a comparison finds
    four times in five (two-sided test at 5 %), None with fewer than two sources, or where all differ by the same.
    """

    model: str
    other: str
    band: str
    metric: MetricKey
    estimate: Estimate
    tracks: int
    sources: int
    seeds: tuple[int, int]
    detectable: float | None

    def sources_for(self, effect: float) -> int | None:
        """Recorded scenes that would be needed to find an effect four times in five, other things equal."""
        if self.detectable is None:
            return None
        return int(np.ceil(self.sources * (self.detectable / effect) ** 2))


class _Table(NamedTuple):
    """Scores of a model as arrays: values (seeds, tracks) and the number of the recorded scene of each track."""

    values: FloatArray
    source: npt.NDArray[np.int64]
    sources: int


def mean_of(runs: Runs, source_of: Mapping[str, str], metric: MetricKey, params: Forecasting) -> Estimate:
    """Mean of a metric of one model."""
    table = _table(runs, _common([runs]), source_of, metric)
    return NOTHING if table is None else _bootstrap([(table, 1.0)], params)


def difference_of(
    model: tuple[str, Runs], other: tuple[str, Runs], *, band: str, source_of: Mapping[str, str], metric: MetricKey,
    params: Forecasting,
) -> Difference:  # fmt: skip
    """One model minus the other, in pairs of the same track."""
    common = _common([model[1], other[1]])
    mine, theirs = (_table(runs, common, source_of, metric) for _, runs in (model, other))
    if mine is None or theirs is None:
        return Difference(model[0], other[0], band, metric, NOTHING, 0, 0, (len(model[1]), len(other[1])), None)
    estimate = _bootstrap([(mine, 1.0), (theirs, -1.0)], params)
    detectable = None if not estimate.se else (_Z_TEST + _Z_POWER) * estimate.se
    return Difference(
        model[0], other[0], band, metric, estimate, mine.values.shape[1], mine.sources, (len(model[1]), len(other[1])),
        detectable,
    )  # fmt: skip


def _common(models: Sequence[Runs]) -> list[tuple[str, str]]:
    """Tracks that every run of every model forecasts, sorted."""
    found = [{(s.scenario_id, s.track_id) for s in run if s.k == K} for runs in models for run in runs]
    return sorted(set.intersection(*found)) if found else []


def _table(
    runs: Runs, tracks: Sequence[tuple[str, str]], source_of: Mapping[str, str], metric: MetricKey
) -> _Table | None:
    if not tracks:
        return None
    row = {track: number for number, track in enumerate(tracks)}
    values = np.full((len(runs), len(tracks)), np.nan)
    for number, run in enumerate(runs):
        for score in run:
            if score.k == K and (score.scenario_id, score.track_id) in row:
                values[number, row[score.scenario_id, score.track_id]] = float(getattr(score, metric))
    names = sorted({source_of.get(scenario, scenario) for scenario, _ in tracks})
    number_of = {name: number for number, name in enumerate(names)}
    source = np.array([number_of[source_of.get(scenario, scenario)] for scenario, _ in tracks])
    return _Table(values, source, len(names))


def _bootstrap(parts: Sequence[tuple[_Table, float]], params: Forecasting) -> Estimate:
    """Weighted sum of means with its interval: scenes are drawn for all tables at once, seeds for each."""
    sources = parts[0][0].sources
    value = sum(sign * float(table.values.mean()) for table, sign in parts)
    if sources < 2:
        return Estimate(value, None, None)
    random = np.random.default_rng(0)
    counts = np.bincount(parts[0][0].source, minlength=sources).astype(np.float64)
    sums = []
    for table, _ in parts:
        per_seed = [np.bincount(table.source, weights=run, minlength=sources) for run in table.values]
        sums.append(np.array(per_seed))
    drawn = []
    left = params.resamples
    while left:
        number = min(left, max(1, _BLOCK // sources))
        left -= number
        weights = random.multinomial(sources, np.full(sources, 1 / sources), size=number).astype(np.float64)
        total = weights @ counts
        result = np.zeros(number)
        for (_, sign), own in zip(parts, sums, strict=True):
            seeds = random.integers(len(own), size=(number, len(own)))
            means = (weights @ own.T) / total[:, None]
            result += sign * np.take_along_axis(means, seeds, axis=1).mean(axis=1)
        drawn.append(result)
    every = np.concatenate(drawn)
    low, high = np.percentile(every, [2.5, 97.5])
    return Estimate(value, float(low), float(high), float(every.std(ddof=1)))


def in_band(runs: Runs, belongs: Callable[[Score], bool]) -> Runs:
    """The scores of a model that belong to a band."""
    return [[score for score in run if belongs(score)] for run in runs]


# Files of predictions, from the command line


def parse_models(texts: Sequence[str]) -> dict[str, list[Path]]:
    """Files by model of "FILE" or "NAME=FILE", as given; a name that comes again adds a seed. Errors: ConfigError."""
    models: dict[str, list[Path]] = {}
    for text in texts:
        name, separator, place = text.partition("=")
        if not separator or Path(text).is_file():
            name, place = (Path(text).stem if texts.count(text) == 1 else text), text
        path = Path(place)
        if not path.is_file():
            wrong = "a baseline is scored alone" if text in BASELINES else "no such file"
            raise ConfigError(f"--predictions {text}: {wrong}; expected FILE or NAME=FILE to compare")
        if path in models.get(name, []):
            raise ConfigError(f"--predictions {text}: given twice; give each file once")
        models.setdefault(name, []).append(path)
    return models


def compare_predictions(
    scenes: Path, models: Mapping[str, Sequence[Path]], report_dir: Path, *, bounds: Sequence[int] = BOUNDS,
    jobs: int = 1, on_scene: Callable[[int, int], None] | None = None,
) -> tuple[list[Difference], list[str]]:  # fmt: skip
    """Score the files of models on the scenes, and compare every model with the first one.

    Writes comparison.csv, comparison.json and comparison.html. Returns the differences, and a line for what could not
    be scored. Errors: as of `score_predictions`; ConfigError where there is nothing to compare.
    """
    if len(models) < 2:
        raise ConfigError("one model's predictions, expected two or more to compare (NAME=FILE, each with its NAME)")
    make_folder(report_dir)
    runs: dict[str, list[Sequence[Score]]] = {}
    left_out: list[str] = []
    for name, files in models.items():
        for file in files:
            scored: PredictionScores = score_predictions(
                scenes, predictions=file, bounds=bounds, jobs=jobs, on_scene=on_scene
            )
            runs.setdefault(name, []).append(scored.scores)
            left_out += [f"{name}: {reason}" for reason in scored.left_out]
    source_of = sources_of(scenes)
    params = Forecasting()
    first, *others = runs
    found = [
        difference_of(
            (name, in_band(runs[name], belongs)), (first, in_band(runs[first], belongs)), band=band,
            source_of=source_of, metric=metric, params=params,
        )
        for name in others
        for band, belongs in bands(bounds).items()
        for metric in METRICS
    ]  # fmt: skip
    if not any(difference.tracks for difference in found):
        raise ScenarioError(f"{scenes}: no track is forecast by every file, nothing to compare")
    _write(found, report_dir)
    return found, left_out


def sources_of(scenes: Path) -> dict[str, str]:
    """The recorded scene behind each generated one below a folder, by scenario id."""
    from bridge.forecasting.compose import origins_of
    from bridge.forecasting.places import recorded_source

    found: dict[str, str] = {}
    for folder in find_scenarios(scenes):
        source = recorded_source(folder)
        if source is not None:
            found[source_id(folder)] = source
    for root in (scenes, scenes.parent):
        found |= {name: origin.source_id for name, origin in origins_of(root).items()}
    return found


HEAD = ("model", "minus", "agents in the scene", "metric", "difference", "95 % interval", "tracks", "recorded scenes",
        "detectable")  # fmt: skip


def rows_of(differences: Sequence[Difference]) -> list[tuple[str, ...]]:
    """A table of differences with tracks."""
    return [
        (
            one.model, one.other, one.band, METRICS[one.metric], signed(one.estimate.value), interval(one.estimate),
            str(one.tracks), str(one.sources), "–" if one.detectable is None else f"{one.detectable:.3f}",
        )
        for one in differences
        if one.tracks
    ]  # fmt: skip


def signed(value: float | None) -> str:
    """A difference, with its sign."""
    return "–" if value is None else f"{value:+.3f}"


def interval(estimate: Estimate) -> str:
    """An interval of a difference."""
    if estimate.low is None or estimate.high is None:
        return "–"
    return f"{estimate.low:+.3f} to {estimate.high:+.3f}"


def as_dicts(differences: Sequence[Difference]) -> list[dict[str, Any]]:
    """For JSON."""
    return [{**one._asdict(), "estimate": one.estimate._asdict(), "seeds": list(one.seeds)} for one in differences]


ABOUT = (
    "<p>Each difference is over the same tracks, pair by pair; below 0 the first model is better. 95 % interval: "
    "bootstrap over recorded scenes, with all that was generated from one, and over the seeds of each model; with one "
    "seed it tells nothing of other seeds, and with fewer than some twenty recorded scenes it is too narrow. "
    "Detectable: the least true difference that a comparison like this one finds four times in five. A metric counts "
    "the six most probable futures of each track.</p>"
)


def _write(differences: Sequence[Difference], report_dir: Path) -> None:
    head = tuple(html.escape(name) for name in HEAD)
    with explained(report_dir):
        write_rows(
            report_dir / "comparison.csv",
            ("model", "minus", "band", "metric", "difference", "low", "high", "se", "tracks", "sources", "detectable"),
            ((one.model, one.other, one.band, one.metric, *one.estimate, one.tracks, one.sources, one.detectable)
             for one in differences),
        )  # fmt: skip
        write_json(report_dir / "comparison.json", as_dicts(differences))
        rows = [tuple(html.escape(cell) for cell in row) for row in rows_of(differences)]
        write_text(report_dir / "comparison.html", pages.page("Forecasts, compared", [ABOUT, pages.table(head, rows)]))
