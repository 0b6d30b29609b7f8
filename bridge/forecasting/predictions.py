"""Forecasts scored with av2's own metrics, in bands of agents per scene, and compared in pairs; two baselines.

minADE, minFDE, miss rate and brier-minFDE, each of the mode that ends nearest, as on av2's leaderboard. A forecast file
is av2's challenge submission: 60 steps from timestep 50 for each mode of a track.

A model that is compared is one file for each seed it was trained with. Scenes are drawn as recorded scenes, with all
that was made of one, and seeds of each model on its own: what is left is what other scenes and another seed would give.
"""

import itertools
import logging
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd
from av2.datasets.motion_forecasting.eval import metrics
from av2.datasets.motion_forecasting.eval.submission import ChallengeSubmission

from bridge.batch.engine import OnDone, sorted_out, work_on_each
from bridge.files import beside, make_folder, write_rows
from bridge.forecasting.compose import origins_of
from bridge.forecasting.places import generated_sidecar
from bridge.pages import parts as pages
from bridge.recordings.folders import SPLITS, source_id
from bridge.recordings.recording import Rows
from bridge.recordings.scenario import MAX_STEPS, OBSERVED_STEPS, read_rows
from bridge.recordings.sources import find_scenarios
from hid2.agents import FloatArray, IntArray
from hid2.params import Forecasting
from hid2.resampling import UNITS_LEAST, Estimate, draws, interval
from netconvert.errors import ConfigError, ScenarioError

_LOG = logging.getLogger(__name__)
Baseline = Literal["constant-velocity", "constant-turn-rate"]
MetricKey = Literal["min_ade_m", "min_fde_m", "missed", "brier_min_fde"]
BASELINES: tuple[Baseline, ...] = ("constant-velocity", "constant-turn-rate")
#: Numbers of modes of a forecast that count, the most probable first; that in comparisons, as in the paper's tables.
KS, K = (1, 6), 6
#: Distance of a forecast's end from the recorded one above which it misses, m.
MISS_M = 2.0
#: Numbers of agents above which scenes are in the bands of the paper.
BOUNDS = (50, 70, 90)
FUTURE_STEPS = MAX_STEPS - OBSERVED_STEPS
#: Speed, or turn rate, of each mode of a baseline as a share of the observed one, and how probable it is.
_MODES = ((1.0, 0.4), (0.75, 0.15), (1.25, 0.15), (0.5, 0.1), (1.5, 0.1), (0.0, 0.1))
#: Metrics, columns of scores, with their names: displacement errors, m, of the mode with the nearest end, whether it
#: misses, and m plus (1 - p)^2 with the probability p of that mode.
METRICS: Mapping[MetricKey, str] = {
    "min_ade_m": "minADE, m", "min_fde_m": "minFDE, m", "missed": "MR", "brier_min_fde": "brier-minFDE, m",
}  # fmt: skip
#: Columns of scores, a row for each track and k. agents: tracks of the scene in all; agents_observed: those present at
#: the last observed step.
SCORE_COLUMNS = ("scenario_id", "track_id", "agents", "agents_observed", "k", *METRICS)
#: Steps before the last observed one over which a baseline's speed and turn rate are means.
_HISTORY = 5
#: Normal quantiles of a two-sided test at 5 %, and of a power of 80 %.
_Z_TEST, _Z_POWER = 1.959964, 0.841621
#: Scenes per task: about as many as take the time that a process needs to begin.
_CHUNK = 128

#: Probabilities (K,) of a scene's modes, and the modes (K, 60, 2) m by track.
Forecast = tuple[FloatArray, Mapping[str, FloatArray]]
#: A row of scores, by SCORE_COLUMNS.
_ScoreRow = tuple[str, str, int, int, int, float, float, bool, float]
#: By scenario.
Forecasts = Mapping[str, Forecast]
#: Scores of a model, a table for each seed.
Runs = Sequence[pd.DataFrame]


def score_predictions(
    out: Path, *, predictions: Path | str, report_dir: Path | None = None, bounds: Sequence[int] = BOUNDS,
    jobs: int = 1, on_scene: OnDone = None,
) -> tuple[pd.DataFrame, list[str]]:  # fmt: skip
    """Score forecasts of the scenes below `out`; `predictions` is a submission file or the name of a baseline.

    A baseline forecasts the focal track of each scene. A scene that cannot be read is left out, with the reason, as is
    one that lies in a second folder, such as the validation scenes of each data set of a composed root. With
    `report_dir`, predictions.csv (one row per track and k) and predictions.html are written. bounds: bands of scenes
    with more agents than each. The same result with any number of jobs. Returns the scores, by SCORE_COLUMNS, and a
    line for what could not be scored. Errors: ScenarioError for an unreadable file, for a forecast that is not finite,
    or where nothing can be scored; ExportError where the report cannot be written.
    """
    first: dict[str, Path] = {}
    left_out = [
        f"{folder}: same scene as {there}, which is taken"
        for folder in find_scenarios(out)
        if (there := first.setdefault(source_id(folder), folder)) is not folder
    ]
    named = next((kind for kind in BASELINES if kind == predictions), None)
    forecasts = read_forecasts(Path(predictions)) if named is None else {}
    if few := sum(len(probabilities) < K for probabilities, _ in forecasts.values()):
        said = "%s: %d of %d scenarios have fewer than %d modes, and count with these as if they had as many"
        _LOG.warning(said, predictions, few, len(forecasts), K)
    if report_dir is not None:
        make_folder(report_dir)
    items = [(folder, named or forecasts.get(name)) for name, folder in first.items()]
    each = work_on_each(
        score_folder, items, None, jobs=jobs, chunk=_CHUNK, timeout_s=60, isolated=False, on_item=on_scene
    )
    scored, failed = sorted_out(each)
    rows = [row for own, _ in scored for row in own]
    left_out = [said for _, said in failed] + [said for _, own in scored for said in own] + left_out
    left_out += [f"{name}: no such scene" for name in sorted(set(forecasts) - set(first))]
    if not rows:
        first_said = next((said for said in left_out if not said.endswith(": no forecast")), left_out[0])
        raise ScenarioError(f"{out}: nothing to score by {predictions}, first of {len(left_out)} reasons: {first_said}")
    scores = pd.DataFrame(rows, columns=SCORE_COLUMNS)
    if report_dir is not None:
        write_rows(report_dir / "predictions.csv", SCORE_COLUMNS, rows)
        page, rows = report_dir / "predictions.html", shown(band_rows(scores, bounds))
        pages.write_page(page, "scored.html.j2", head=TABLE_HEAD, rows=rows, left_out=left_out)
    return scores, left_out


def read_forecasts(path: Path) -> Forecasts:
    """Read a submission file. Errors: ConfigError for another file; ScenarioError for a value that cannot be."""
    if not path.is_file():
        raise ConfigError(f"{path}: no such file, expected a forecast file or one of {', '.join(BASELINES)}")
    try:
        table = pd.read_parquet(path, columns=["scenario_id", "track_id", "probability"]).sort_values("probability")
        if lacking := int(table.isna().any(axis=1).sum()):  # av2 leaves them out
            raise ValueError(f"{lacking} rows without scenario_id, track_id or probability")
        with np.errstate(over="ignore", invalid="ignore"):  # values may be anything until they have been looked at
            read = ChallengeSubmission.from_parquet(path).predictions
        forecasts = {name: (p, {one: np.asarray(m, float) for one, m in by.items()}) for name, (p, by) in read.items()}
    except (ValueError, KeyError, OSError, IndexError, TypeError, AttributeError) as error:  # as av2 comes to them
        said = ("no column " if isinstance(error, KeyError) else "") + str(error).split("\n")[0].split(". ")[0]
        raise ConfigError(f"{path}: not a forecast file of av2's submission format ({said})") from error
    rank = table.groupby(["scenario_id", "track_id"]).cumcount()
    each = table.groupby(["scenario_id", rank])["probability"]  # av2 keeps those of one track
    for row in table[each.transform("max") - each.transform("min") > 1e-6].itertuples():
        raise ScenarioError(
            f"{path}: scenario {row.scenario_id}, track {row.track_id}: probability {row.probability}, expected the "
            "same probabilities for all tracks of a scenario; write a file for each track to score them alone"
        )
    for scenario_id, (probabilities, by_track) in forecasts.items():
        outside = ~((probabilities >= 0) & (probabilities <= 1))
        if outside.any():
            raise ScenarioError(f"{path}: {scenario_id}: probability {probabilities[outside][0]}, expected 0 to 1")
        for track_id, modes in by_track.items():
            for mode, step, axis in np.argwhere(~(np.abs(modes) < 1e9)).tolist():
                where = f"{path}: scenario {scenario_id}, track {track_id}, mode {mode} by probability, step {step}"
                raise ScenarioError(
                    f"{where}: {'xy'[axis]} is {modes[mode, step, axis]}, expected a number below 1e9; "
                    "leave the track out to score the others"
                )
    return forecasts


def write_forecasts(forecasts: Forecasts, path: Path) -> Path:
    """Write a submission file. Errors: ExportError; ScenarioError for forecasts that av2 refuses."""
    try:
        with beside(path) as hidden:
            ChallengeSubmission({name: (one[0], dict(one[1])) for name, one in forecasts.items()}).to_parquet(hidden)
    except ValueError as error:
        raise ScenarioError(f"{path}: forecasts that av2 refuses ({error})") from error
    return path


def baseline(scene: Rows, kind: Baseline) -> Forecast:
    """Probabilities (6,) and modes (6, N, 2) m of the focal track, from what is observed of it.

    N: steps that are not observed, 60 in scenes of 110.
    """
    track = next(track for track in scene.tracks if track.track_id == scene.focal_track_id)
    shares, probabilities = np.array(_MODES).T  # of the observed velocity, or of the turn rate at the observed speed
    observed = np.flatnonzero(track.timesteps <= scene.last_observed)[-_HISTORY - 1 :]
    last = observed[-1]
    seconds = (track.timesteps[last] - track.timesteps[observed[0]]) * scene.step_s
    velocity = (track.position[last] - track.position[observed[0]]) / seconds if seconds > 0 else track.velocity[last]
    ahead = np.arange(1, _future_steps(scene) + 1) * scene.step_s
    if kind == "constant-velocity":
        moved = shares[:, None, None] * ahead[:, None] * velocity
    else:
        heading = np.unwrap(track.heading[observed])
        rates = shares * (heading[-1] - heading[0]) / seconds if seconds > 0 else np.zeros(len(shares))
        half = 0.5 * rates[:, None] * ahead  # of the angle turned by: a chord has the direction of its middle
        chord_m, direction = np.hypot(*velocity) * ahead * np.sinc(half / np.pi), heading[-1] + half
        moved = np.stack([chord_m * np.cos(direction), chord_m * np.sin(direction)], axis=-1)
    return probabilities, {track.track_id: track.position[last] + moved}


def _future_steps(scene: Rows) -> int:
    """Steps that are forecast: what is not observed; of a scene without them those of the format."""
    return scene.num_steps - scene.observed_steps if scene.num_steps > scene.observed_steps else FUTURE_STEPS


def score_folder(_shared: None, item: tuple[Path, Forecast | Baseline | None]) -> tuple[list[_ScoreRow], list[str]]:
    """Scores of a scene by its forecast, and what of it cannot be scored."""
    (scene, *_), forecast = read_rows(item[0]), item[1]
    if forecast is None:
        return [], [f"{scene.scenario_id}: no forecast"]
    probabilities, by_track = baseline(scene, forecast) if isinstance(forecast, str) else forecast
    order = np.argsort(-np.asarray(probabilities), kind="stable")
    tracks = {track.track_id: track for track in scene.tracks}
    observed = sum(scene.last_observed in track.timesteps for track in scene.tracks)
    scores, reasons, wanted = [], [], _future_steps(scene)
    for track_id, modes in sorted(by_track.items()):
        track = tracks.get(str(track_id))
        future = np.empty((0, 2)) if track is None else track.position[track.timesteps > scene.last_observed]
        if track is None or len(future) != wanted:
            what = "no such track" if track is None else f"{len(future)} future steps, expected {wanted}"
            reasons.append(f"{scene.scenario_id}, track {track_id}: {what}")
            continue
        for k in KS:
            chosen = np.asarray(modes)[order[:k]]
            fde = metrics.compute_fde(chosen, future)
            best = int(np.argmin(fde))
            missed = bool(np.all(metrics.compute_is_missed_prediction(chosen, future, MISS_M)))
            brier = float(metrics.compute_brier_fde(chosen, future, probabilities[order[:k]])[best])
            ade, of = float(metrics.compute_ade(chosen, future)[best]), (scene.scenario_id, str(track_id))
            scores.append((*of, len(scene.tracks), observed, k, ade, float(fde[best]), missed, brier))
    return scores, reasons


def bands(bounds: Sequence[int]) -> dict[str, str]:
    """Queries of scores: all scenes, those of more tracks than each bound, and of more at the observation's end."""
    observed = {f"more than {bound} at the observation's end": f"agents_observed > {bound}" for bound in bounds}
    return {"all scenes": "agents > 0"} | {f"more than {bound}": f"agents > {bound}" for bound in bounds} | observed


TABLE_HEAD = ("agents in the scene", "k", "tracks", *METRICS.values())


def band_rows(scores: pd.DataFrame, bounds: Sequence[int]) -> list[tuple[str | float | None, ...]]:
    """A table, by TABLE_HEAD: of each band and k the number of tracks, and their mean of each metric."""
    found = []
    for (name, band), k in itertools.product(bands(bounds).items(), KS):
        own = scores.query(f"{band} and k == {k}")
        means = own[[*METRICS]].astype(float).mean().tolist() if len(own) else [None] * len(METRICS)
        found.append((name, k, len(own), *means))
    return found


def shown(rows: Iterable[tuple[Any, ...]]) -> list[tuple[Any, ...]]:
    """Rows by TABLE_HEAD for pages and terminals: rounded, a dash for what there is not."""
    return [(*row[:3], *map(pages.number, row[3:])) for row in rows]


# Models compared in pairs


class Difference(NamedTuple):
    """A model minus another one, on the tracks that all of their files forecast; se: its standard error.

    sources: recorded scenes behind them, which are drawn; detectable: least difference that such a comparison finds
    four times in five (two-sided test at 5 %), None with fewer than UNITS_LEAST, or where all differ by the same.
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
    return _bootstrap(*_aligned([runs], source_of, metric), params, metric)[0]


def differences_of(
    pairs: Iterable[tuple[str, str]], runs: Mapping[str, Runs], bands: Mapping[str, str],
    source_of: Mapping[str, str], params: Forecasting,
) -> list[Difference]:  # fmt: skip
    """Each pair of models compared in every band by every metric, in pairs of the same track."""
    found = []
    for (name, other), (called, band), metric in itertools.product(pairs, bands.items(), METRICS):
        mine, theirs = ([run.query(band) for run in runs[one]] for one in (name, other))
        values, source = _aligned([mine, theirs], source_of, metric)
        estimate, se = _bootstrap(values, source, params, metric)
        detectable = (_Z_TEST + _Z_POWER) * se if se else None
        counts, seeds = (len(source), len(np.unique(source))), (len(mine), len(theirs))
        found.append(Difference(name, other, called, metric, *estimate, se, *counts, detectable, seeds))
    return found


def _aligned(
    models: Sequence[Runs], source_of: Mapping[str, str], metric: MetricKey
) -> tuple[list[FloatArray], IntArray]:
    """Values (seeds, T) of each model on the T tracks that every run forecasts, and the number (T,) of their source."""
    each = [run.query(f"k == {K}").set_index(["scenario_id", "track_id"])[metric] for runs in models for run in runs]
    values = pd.concat(each, axis=1, join="inner").sort_index()
    _, source = np.unique([source_of.get(scenario, scenario) for scenario, _ in values.index], return_inverse=True)
    seeds = np.cumsum([len(runs) for runs in models])[:-1]
    return np.split(np.ascontiguousarray(values.to_numpy(float).T), seeds), source


def _bootstrap(
    values: Sequence[FloatArray], source: IntArray, params: Forecasting, metric: MetricKey
) -> tuple[Estimate, float | None]:
    """Mean of the first values less that of the others, and its standard error.

    Sources are drawn for all at once, seeds for each. Drawing S seeds again varies their mean by (S - 1) / S of what
    other seeds would: their deviations are stretched by the root of the inverse. The interval is cut to what there can
    be, a distance of 0 or more or a rate up to 1: no less often does it hold the truth. The error is of all draws.
    """
    if not len(source):
        return Estimate(None), None
    signs = (1.0, *[-1.0] * (len(values) - 1))
    value = sum(sign * float(each.mean()) for sign, each in zip(signs, values, strict=True))
    counts = np.bincount(source).astype(np.float64)
    if len(counts) < UNITS_LEAST:
        return Estimate(value), None
    random = np.random.default_rng(0)
    sums = [np.array([np.bincount(source, weights=run) for run in each]) for each in values]
    drawn: list[FloatArray] = []
    for weights in draws(len(counts), resamples=params.resamples, rng=random):
        result = np.zeros(len(weights))
        for sign, own in zip(signs, sums, strict=True):
            seeds = random.integers(len(own), size=(len(weights), len(own)))
            means = (weights @ own.T) / (weights @ counts)[:, None]
            chosen, middle = np.take_along_axis(means, seeds, axis=1).mean(axis=1), means.mean(axis=1)
            result += sign * (middle + (chosen - middle) * np.sqrt(len(own) / max(1, len(own) - 1)))
        drawn.append(result)
    every, most = np.concatenate(drawn), 1.0 if metric == "missed" else np.inf
    return interval(value, np.clip(every, 0.0 if len(values) == 1 else -most, most)), float(every.std(ddof=1))


def parse_models(texts: Sequence[str]) -> dict[str, list[Path]]:
    """Files by model of "FILE" (called by its path where that alone tells it) or "NAME=FILE". Errors: ConfigError."""
    models: dict[str, list[Path]] = {}
    given = [("", text) if text.find("=") < 1 or Path(text).is_file() else text.split("=", 1) for text in texts]
    names = [name or Path(place).stem for name, place in given]
    for text, (own, place), name in zip(texts, given, names, strict=True):
        path, files = Path(place), models.setdefault(name if own or names.count(name) == 1 else text, [])
        if not path.is_file():
            wrong = "a baseline is scored alone" if text in BASELINES else "no such file"
            raise ConfigError(f"{path}: {wrong}, expected a forecast file or, alone, one of {', '.join(BASELINES)}")
        if any(path.samefile(other) for other in itertools.chain(*models.values())):
            raise ConfigError(f"--predictions {text}: given twice; give each file once")
        files.append(path)
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
    runs, left_out = dict[str, list[pd.DataFrame]](), list[str]()
    for name, files in models.items():
        for file in files:
            scores, reasons = score_predictions(scenes, predictions=file, jobs=jobs, on_scene=on_scene)
            runs.setdefault(name, []).append(scores)
            left_out += [f"{name}, {file}: {reason}" for reason in reasons]
    first, *others = runs
    found = differences_of([(name, first) for name in others], runs, bands(bounds), sources_of(scenes), Forecasting())
    if not any(difference.tracks for difference in found):
        raise ScenarioError(f"{scenes}: no track is forecast by every file, nothing to compare")
    write_rows(report_dir / "comparison.csv", Difference._fields[:-1], (one[:-1] for one in found))
    rows = rows_of(found)
    pages.write_page(report_dir / "comparison.html", "comparison.html.j2", head=HEAD, rows=rows, left_out=left_out)
    return found, left_out


def sources_of(scenes: Path) -> dict[str, str]:
    """The recorded scene behind each generated one below a folder, by scenario id."""
    folders = find_scenarios(scenes)
    each = ((source_id(folder), generated_sidecar(folder)) for folder in folders)
    found = {name: sidecar.source_scenario_id for name, sidecar in each if sidecar is not None}
    for root in dict.fromkeys(up.parent for one in folders for up in one.absolute().parents[:2] if up.name in SPLITS):
        found |= origins_of(root)
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
