"""Forecasts scored with av2's own metrics, in bands of agents per scene; two baselines.

minADE, minFDE, miss rate and brier-minFDE, each of the mode that ends nearest, as on av2's leaderboard. A forecast file
is av2's challenge submission: 60 steps from timestep 50 for each mode of a track.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from av2.datasets.motion_forecasting.eval import metrics
from av2.datasets.motion_forecasting.eval.submission import ChallengeSubmission

from bridge.batch.engine import OnDone, work_on_each
from bridge.batch.isolation import Failure
from bridge.files import beside, make_folder, write_rows, write_text
from bridge.pages import parts as pages
from bridge.recordings.scenario import MAX_STEPS, OBSERVED_STEPS, Rows, find_scenarios, read_rows, source_id
from hid2.agents import FloatArray, Track
from netconvert.errors import ConfigError, ScenarioError

Baseline = Literal["constant-velocity", "constant-turn-rate"]
MetricKey = Literal["min_ade_m", "min_fde_m", "missed", "brier_min_fde"]
BASELINES: tuple[Baseline, ...] = ("constant-velocity", "constant-turn-rate")
#: Modes of a forecast that count, the most probable first.
KS = (1, 6)
#: A forecast with its end further off misses.
MISS_M = 2.0
#: Bands of the paper: scenes with more agents than these.
BOUNDS = (50, 70, 90)
FUTURE_STEPS = MAX_STEPS - OBSERVED_STEPS
#: Speed, or turn rate, of each mode of a baseline as a share of the observed one, and how probable it is.
_MODES = ((1.0, 0.4), (0.75, 0.15), (1.25, 0.15), (0.5, 0.1), (1.5, 0.1), (0.0, 0.1))
#: Metrics, fields of scores, with their names.
METRICS: Mapping[MetricKey, str] = {
    "min_ade_m": "minADE, m", "min_fde_m": "minFDE, m", "missed": "MR", "brier_min_fde": "brier-minFDE, m",
}  # fmt: skip
#: A baseline's speed and turn rate are means over this many steps before the last observed one.
_HISTORY = 5

#: Scenes per task: about as many as take the time that a process needs to begin.
_CHUNK = 128

#: Probabilities (K,) of a scene's modes, and the modes (K, 60, 2) m by track.
Forecast = tuple[FloatArray, Mapping[str, FloatArray]]
#: By scenario.
Forecasts = Mapping[str, Forecast]


class Score(NamedTuple):
    """One track at one k: displacement errors, m, of the mode with the nearest end, and whether it misses.

    agents: tracks of the scene in all; agents_observed: those present at the last observed step; brier_min_fde: m,
    plus (1 - p)^2 with the probability p of that mode.
    """

    scenario_id: str
    track_id: str
    agents: int
    agents_observed: int
    k: int
    min_ade_m: float
    min_fde_m: float
    missed: bool
    brier_min_fde: float


class Band(NamedTuple):
    """Scenes of more tracks than a bound, in all or at the observation's end."""

    more_than: int
    tracks: Literal["agents", "agents_observed"] = "agents"

    def of(self, scores: Sequence[Score]) -> list[Score]:
        """Those in such scenes."""
        return [score for score in scores if getattr(score, self.tracks) > self.more_than]


@dataclass(frozen=True, slots=True)
class PredictionScores:
    """Scores of all tracks, bands of agents with their means, and what could not be scored with the reason."""

    scores: tuple[Score, ...]
    bands: tuple[dict[str, Any], ...]
    left_out: tuple[str, ...]

    def rows(self) -> list[tuple[str, ...]]:
        """A table of the bands."""
        return [
            (band["band"], str(band["k"]), str(band["tracks"]), *(pages.number(band[name]) for name in METRICS))
            for band in self.bands
        ]


TABLE_HEAD = ("agents in the scene", "k", "tracks", *METRICS.values())


def score_predictions(
    out: Path,
    *,
    predictions: Path | str,
    report_dir: Path | None = None,
    bounds: Sequence[int] = BOUNDS,
    jobs: int = 1,
    on_scene: OnDone = None,
) -> PredictionScores:
    """Score forecasts of the scenes below `out`; `predictions` is a submission file or the name of a baseline.

    A baseline forecasts the focal track of each scene. A scene that cannot be read is left out, with the reason. With
    `report_dir`, predictions.csv (one row per track and k) and predictions.html are written. bounds: bands of scenes
    with more agents than each. The same result with any number of jobs. Errors: ScenarioError for an unreadable file,
    for a forecast that is not finite, or where nothing can be scored; ExportError where the report cannot be written.
    """
    folders = find_scenarios(out)
    named = next((kind for kind in BASELINES if kind == predictions), None)
    forecasts = read_forecasts(Path(predictions)) if named is None else {}
    if report_dir is not None:
        make_folder(report_dir)
    items = [(folder, named or forecasts.get(source_id(folder))) for folder in folders]
    each = work_on_each(
        score_folder, items, shared=None, jobs=jobs, chunk=_CHUNK, timeout_s=60, isolated=False, on_item=on_scene
    )
    scores: list[Score] = []
    left_out: list[str] = []
    for _, found in each:
        if isinstance(found, Failure):
            left_out.append(found.message)
        else:
            scores += found[0]
            left_out += found[1]
    left_out += [f"{name}: no such scene" for name in sorted(set(forecasts) - set(map(source_id, folders)))]
    if not scores:
        raise ScenarioError(f"{out}: nothing to score, first of {len(left_out)} reasons: {left_out[0]}")
    scored = PredictionScores(tuple(scores), tuple(_means(scores, bounds)), tuple(left_out))
    if report_dir is not None:
        parts = [pages.macro("forecasts.html.j2", "scored", TABLE_HEAD, scored.rows(), left_out)]
        write_rows(report_dir / "predictions.csv", Score._fields, scores)
        write_text(report_dir / "predictions.html", pages.page("Forecasts, scored", parts))
    return scored


def score_folder(_shared: None, item: tuple[Path, Forecast | Baseline | None]) -> tuple[list[Score], list[str]]:
    """Scores of a scene by its forecast, and what of it cannot be scored."""
    rows, forecast = read_rows(item[0]), item[1]
    own = baseline(rows, forecast) if isinstance(forecast, str) else forecast
    return ([], [f"{rows.scenario_id}: no forecast"]) if own is None else _score_scene(rows, own)


def read_forecasts(path: Path) -> Forecasts:
    """Read a submission file. Errors: ConfigError for another file; ScenarioError for a value that is not finite."""
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # values may be anything until they have been looked at
            forecasts: Forecasts = ChallengeSubmission.from_parquet(path).predictions
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file, expected a forecast file or one of {', '.join(BASELINES)}") from None
    except (ValueError, KeyError, OSError, IndexError, TypeError, AttributeError) as error:  # as av2 comes to them
        said = str(error).split("\n")[0].split(". ")[0]  # pyarrow goes on for lines
        raise ConfigError(f"{path}: not a forecast file of av2's submission format ({said})") from error
    for scenario_id, (probabilities, by_track) in forecasts.items():
        outside = ~((probabilities >= 0) & (probabilities <= 1))
        if outside.any():
            where = f"{path}: scenario {scenario_id}, mode {int(np.argmax(outside))}"
            raise ScenarioError(f"{where}: probability {probabilities[outside][0]}, expected 0 to 1")
        for track_id, modes in by_track.items():
            for mode, step, axis in np.argwhere(~np.isfinite(modes)).tolist():
                where = f"{path}: scenario {scenario_id}, track {track_id}, mode {mode}, step {step}"
                raise ScenarioError(
                    f"{where}: {'xy'[axis]} is {modes[mode, step, axis]}, expected a finite number; "
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
    modes = np.stack([_forecast(track, kind, share, scene) for share, _ in _MODES])
    return np.array([probability for _, probability in _MODES]), {track.track_id: modes}


def _forecast(track: Track, kind: Baseline, share: float, scene: Rows) -> FloatArray:
    """(N, 2) m: on at the observed velocity, or at the observed speed and turn rate; `share` scales what is varied."""
    observed = np.flatnonzero(track.timesteps <= scene.last_observed)[-_HISTORY - 1 :]
    last = observed[-1]
    seconds = (track.timesteps[last] - track.timesteps[observed[0]]) * scene.step_s
    velocity = (track.position[last] - track.position[observed[0]]) / seconds if seconds > 0 else track.velocity[last]
    ahead = np.arange(1, _future_steps(scene) + 1) * scene.step_s
    if kind == "constant-velocity":
        return np.asarray(track.position[last] + share * ahead[:, None] * velocity, dtype=np.float64)
    heading = np.unwrap(track.heading[observed])
    rate = share * float(heading[-1] - heading[0]) / seconds if seconds > 0 else 0.0
    half = 0.5 * rate * ahead  # of the angle turned by: a chord has the direction of its middle
    chord_m, direction = np.hypot(*velocity) * ahead * np.sinc(half / np.pi), heading[-1] + half
    moved = np.column_stack([chord_m * np.cos(direction), chord_m * np.sin(direction)])
    return np.asarray(track.position[last] + moved, dtype=np.float64)


def _future_steps(scene: Rows) -> int:
    """Steps that are forecast: what is not observed; of a scene without them those of the format."""
    return scene.num_steps - scene.observed_steps if scene.num_steps > scene.observed_steps else FUTURE_STEPS


def _score_scene(scene: Rows, forecast: Forecast) -> tuple[list[Score], list[str]]:
    probabilities, by_track = forecast
    order = np.argsort(-np.asarray(probabilities), kind="stable")
    tracks = {track.track_id: track for track in scene.tracks}
    observed = sum(scene.last_observed in track.timesteps for track in scene.tracks)
    scores, reasons = [], []
    wanted = _future_steps(scene)
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
            scores.append(Score(*of, len(scene.tracks), observed, k, ade, float(fde[best]), missed, brier))
    return scores, reasons


def bands(bounds: Sequence[int]) -> dict[str, Band]:
    """All scenes, and those of more tracks than each bound, in all and at the observation's end."""
    observed = {f"more than {bound} at the observation's end": Band(bound, "agents_observed") for bound in bounds}
    return {"all scenes": Band(0)} | {f"more than {bound}": Band(bound) for bound in bounds} | observed


def _means(scores: Sequence[Score], bounds: Sequence[int]) -> Iterable[dict[str, Any]]:
    """Of each band and k the number of tracks and their mean of each metric, None where there is none."""
    for name, band in bands(bounds).items():
        inside = band.of(scores)
        for k in KS:
            own = [score for score in inside if score.k == k]
            means = {key: float(np.mean([getattr(one, key) for one in own])) if own else None for key in METRICS}
            yield {"band": name, "k": k, "tracks": len(own)} | means
