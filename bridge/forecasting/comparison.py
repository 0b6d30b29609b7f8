"""Forecasts of several models on the same scenes, compared in pairs, with intervals over scenes and over seeds.

A model is one file of predictions for each seed it was trained with. Scenes are drawn as recorded scenes, with all that
was made of one, and seeds of each model on its own: what is left is what other scenes and another seed would give.
"""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bridge.batch.engine import OnDone
from bridge.evaluation.predictions import BASELINES, BOUNDS, METRICS, Band, MetricKey, Score, bands, score_predictions
from bridge.files import make_folder, write_rows, write_text
from bridge.pages import parts as pages
from bridge.recordings.scenario import find_scenarios, source_id
from hid2.agents import FloatArray, IntArray
from hid2.params import Forecasting
from hid2.resampling import Estimate, draws, interval
from netconvert.errors import ConfigError, ScenarioError

#: Futures that count in comparisons, as in the paper's tables.
K = 6
#: Normal quantiles of a two-sided test at 5 %, and of a power of 80 %.
_Z_TEST, _Z_POWER = 1.959964, 0.841621

#: Scores of a model, one sequence for each seed.
Runs = Sequence[Sequence[Score]]


class Difference(NamedTuple):
    """A model minus another one, on the tracks that all of their files forecast; se: its standard error.

    sources: recorded scenes behind them, which are drawn; detectable: least difference that such a comparison finds
    four times in five (two-sided test at 5 %), None with fewer than two sources, or where all differ by the same.
    """

    model: str
    minus: str
    band: str
    metric: MetricKey
    difference: float | None
    low: float | None
    high: float | None
    se: float | None
    tracks: int
    sources: int
    detectable: float | None
    seeds: tuple[int, int]


def mean_of(runs: Runs, source_of: Mapping[str, str], metric: MetricKey, params: Forecasting) -> Estimate:
    """Mean of a metric of one model."""
    return _bootstrap(*_aligned([runs], source_of, metric), params)[0]


def differences_of(
    pairs: Iterable[tuple[str, str]], runs: Mapping[str, Runs], bands: Mapping[str, Band],
    source_of: Mapping[str, str], params: Forecasting,
) -> list[Difference]:  # fmt: skip
    """Each pair of models compared in every band by every metric, in pairs of the same track."""
    found = []
    for (name, other), (called, band), metric in itertools.product(pairs, bands.items(), METRICS):
        mine, theirs = ([band.of(run) for run in runs[one]] for one in (name, other))
        values, source = _aligned([mine, theirs], source_of, metric)
        estimate, se = _bootstrap(values, source, params)
        detectable = (_Z_TEST + _Z_POWER) * se if se else None
        counts = len(source), len(np.unique(source))
        seeds = len(mine), len(theirs)
        found.append(Difference(name, other, called, metric, *estimate, se, *counts, detectable, seeds))
    return found


def _aligned(
    models: Sequence[Runs], source_of: Mapping[str, str], metric: MetricKey
) -> tuple[list[FloatArray], IntArray]:
    """Values (seeds, T) of each model on the T tracks that every run forecasts, and the number (T,) of their source."""
    found = [
        [{(one.scenario_id, one.track_id): float(getattr(one, metric)) for one in run if one.k == K} for run in runs]
        for runs in models
    ]
    tracks = sorted(set.intersection(*(set(run) for runs in found for run in runs)))
    _, source = np.unique([source_of.get(scenario, scenario) for scenario, _ in tracks], return_inverse=True)
    return [np.array([[run[track] for track in tracks] for run in runs]) for runs in found], source


def _bootstrap(values: Sequence[FloatArray], source: IntArray, params: Forecasting) -> tuple[Estimate, float | None]:
    """Mean of the first values less that of the others, and its standard error.

    Sources are drawn for all at once, seeds for each.
    """
    if not len(source):
        return Estimate(None), None
    signs = (1.0, *[-1.0] * (len(values) - 1))
    value = sum(sign * float(each.mean()) for sign, each in zip(signs, values, strict=True))
    counts = np.bincount(source).astype(np.float64)
    if len(counts) < 2:
        return Estimate(value), None
    random = np.random.default_rng(0)
    sums = [np.array([np.bincount(source, weights=run) for run in each]) for each in values]
    drawn: list[FloatArray] = []
    for weights in draws(len(counts), resamples=params.resamples, rng=random):
        result = np.zeros(len(weights))
        for sign, own in zip(signs, sums, strict=True):
            seeds = random.integers(len(own), size=(len(weights), len(own)))
            means = (weights @ own.T) / (weights @ counts)[:, None]
            result += sign * np.take_along_axis(means, seeds, axis=1).mean(axis=1)
        drawn.append(result)
    every = np.concatenate(drawn)
    return interval(value, every), float(every.std(ddof=1))


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
    jobs: int = 1, on_scene: OnDone = None,
) -> tuple[list[Difference], list[str]]:  # fmt: skip
    """Score the files of models on the scenes, and compare every model with the first one.

    Writes comparison.csv and comparison.html. Returns the differences, and a line for what could not
    be scored. Errors: as of `score_predictions`; ConfigError where there is nothing to compare.
    """
    if len(models) < 2:
        raise ConfigError("one model's predictions, expected two or more to compare (NAME=FILE, each with its NAME)")
    make_folder(report_dir)
    runs: dict[str, list[Sequence[Score]]] = {}
    left_out: list[str] = []
    for name, files in models.items():
        for file in files:
            scored = score_predictions(scenes, predictions=file, bounds=bounds, jobs=jobs, on_scene=on_scene)
            runs.setdefault(name, []).append(scored.scores)
            left_out += [f"{name}: {reason}" for reason in scored.left_out]
    first, *others = runs
    pairs = [(name, first) for name in others]
    found = differences_of(pairs, runs, bands(bounds), sources_of(scenes), Forecasting())
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
        found |= {name: origin["source_id"] for name, origin in origins_of(root).items()}
    return found


HEAD = ("model", "minus", "agents in the scene", "metric", "difference", "95 % interval", "tracks", "recorded scenes",
        "detectable")  # fmt: skip


def rows_of(differences: Sequence[Difference]) -> list[tuple[str, ...]]:
    """A table of differences with tracks."""
    return [
        (
            one.model, one.minus, one.band, METRICS[one.metric], _signed(one.difference),
            "–" if one.low is None else f"{_signed(one.low)} to {_signed(one.high)}",
            str(one.tracks), str(one.sources), "–" if one.detectable is None else f"{one.detectable:.3f}",
        )
        for one in differences
        if one.tracks
    ]  # fmt: skip


def _signed(value: float | None) -> str:
    return "–" if value is None else f"{value:+.3f}"


def _write(differences: Sequence[Difference], report_dir: Path) -> None:
    *head, _ = Difference._fields
    write_rows(report_dir / "comparison.csv", head, (one[:-1] for one in differences))
    part = pages.macro("forecasts.html.j2", "differences", HEAD, rows_of(differences))
    write_text(report_dir / "comparison.html", pages.page("Forecasts, compared", [part]))
