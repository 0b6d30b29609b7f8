"""Forecasts scored by minADE, minFDE and miss rate with av2's own metrics, in bands of agents per scene; two baselines.

A forecast file is av2's challenge submission: 60 steps from timestep 50 for each mode of a track.
"""

import csv
import html
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from av2.datasets.motion_forecasting.eval.metrics import compute_ade, compute_fde, compute_is_missed_prediction
from av2.datasets.motion_forecasting.eval.submission import ChallengeSubmission

from bridge.evaluation import report
from bridge.files import make_folder, table_file, write_text
from bridge.recordings.scenario import (
    LAST_OBSERVED,
    MAX_STEPS,
    STEP_S,
    Scenario,
    find_scenarios,
    read_scenario,
    source_id,
)
from hid2.agents import FloatArray, Track
from netconvert.errors import ExportError, Hid2Error, ScenarioError

Baseline = Literal["constant-velocity", "constant-turn-rate"]
BASELINES: tuple[Baseline, ...] = ("constant-velocity", "constant-turn-rate")
#: Modes of a forecast that count, the most probable first.
KS = (1, 6)
#: A forecast whose end is further off misses.
MISS_M = 2.0
#: Bands of the paper: scenes with more agents than these.
BOUNDS = (50, 70, 90)
FUTURE_STEPS = MAX_STEPS - LAST_OBSERVED - 1
#: Speed, or turn rate, of each mode of a baseline as a share of the observed one, and how probable it is.
_MODES = ((1.0, 0.4), (0.75, 0.15), (1.25, 0.15), (0.5, 0.1), (1.5, 0.1), (0.0, 0.1))
#: A baseline's speed and turn rate are means over this many steps before the last observed one.
_HISTORY = 5

#: Modes (K, 60, 2) m and their probabilities (K,), by scenario and track.
Forecasts = Mapping[str, tuple[FloatArray, Mapping[str, FloatArray]]]


class Score(NamedTuple):
    """One track at one k: displacement errors, m, of the mode whose end is nearest, and whether it misses."""

    scenario_id: str
    track_id: str
    agents: int
    k: int
    min_ade_m: float
    min_fde_m: float
    missed: bool


@dataclass(frozen=True, slots=True)
class PredictionScores:
    """Scores of all tracks, bands of agents with their means, and what could not be scored with the reason."""

    scores: tuple[Score, ...]
    bands: tuple[dict[str, Any], ...]
    left_out: tuple[str, ...]

    def rows(self) -> list[tuple[str, ...]]:
        """A table of the bands."""
        return [
            (
                band["band"], str(band["k"]), str(band["tracks"]), report.number(band["min_ade_m"]),
                report.number(band["min_fde_m"]), report.number(band["miss_rate"]),
            )
            for band in self.bands
        ]  # fmt: skip


TABLE_HEAD = ("agents in the scene", "k", "tracks", "minADE, m", "minFDE, m", "MR at 2 m")


def score_predictions(
    out: Path,
    *,
    predictions: Path | Baseline,
    report_dir: Path | None = None,
    bounds: Sequence[int] = BOUNDS,
    on_scene: Callable[[int, int], None] | None = None,
) -> PredictionScores:
    """Score forecasts of the scenes below `out`; `predictions` is a submission file or the name of a baseline.

    A baseline forecasts the focal track of each scene. A scene that cannot be read is left out, with the reason. With
    `report_dir`, predictions.csv (one row per track and k), predictions.json and predictions.html are written. bounds:
    bands of scenes with more agents than each. Errors: ScenarioError for an unreadable file or where nothing can be
    scored, ExportError where the report cannot be written.
    """
    folders = find_scenarios(out)
    if report_dir is not None:
        make_folder(report_dir)
    forecasts = None if predictions in BASELINES else read_forecasts(Path(predictions))
    scores: list[Score] = []
    left_out: list[str] = []
    seen = set()
    for done, folder in enumerate(folders, 1):
        try:
            scenario = read_scenario(folder)
        except Hid2Error as error:
            seen.add(source_id(folder))
            left_out.append(str(error))
        else:
            seen.add(scenario.scenario_id)
            own = baseline(scenario, predictions) if forecasts is None else forecasts.get(scenario.scenario_id)  # type: ignore[arg-type]
            found, reasons = (
                ([], [f"{scenario.scenario_id}: no forecast"]) if own is None else _score_scene(scenario, own)
            )
            scores += found
            left_out += reasons
        if on_scene is not None:
            on_scene(done, len(folders))
    left_out += [f"{name}: no such scene" for name in sorted(set(forecasts or ()) - seen)]
    if not scores:
        raise ScenarioError(f"{out}: nothing to score, first of {len(left_out)} reasons: {left_out[0]}")
    result = PredictionScores(tuple(scores), tuple(_bands(scores, bounds)), tuple(left_out))
    if report_dir is not None:
        _write(result, report_dir)
    return result


def read_forecasts(path: Path) -> Forecasts:
    """Read a submission file. Errors: ScenarioError with what av2 says of it."""
    try:
        return ChallengeSubmission.from_parquet(path).predictions  # type: ignore[no-any-return]
    except FileNotFoundError:
        raise ScenarioError(
            f"{path}: no such file, expected a forecast file or one of {', '.join(BASELINES)}"
        ) from None
    except (ValueError, KeyError, OSError, IndexError) as error:
        said = str(error).split("\n")[0].split(". ")[0]  # pyarrow goes on for lines
        raise ScenarioError(f"{path}: not a forecast file of av2's submission format ({said})") from error


def baseline(scenario: Scenario, kind: Baseline) -> tuple[FloatArray, Mapping[str, FloatArray]]:
    """Probabilities (6,) and modes (6, 60, 2) m of the focal track, from what is observed of it."""
    track = scenario.track(scenario.focal_track_id)
    modes = np.stack([_forecast(track, kind, share) for share, _ in _MODES])
    return np.array([probability for _, probability in _MODES]), {track.track_id: modes}


def _forecast(track: Track, kind: Baseline, share: float) -> FloatArray:
    """(60, 2) m: on at the observed velocity, or at the observed speed and turn rate; `share` scales what is varied."""
    observed = np.flatnonzero(track.timesteps <= LAST_OBSERVED)[-_HISTORY - 1 :]
    last = observed[-1]
    seconds = (track.timesteps[last] - track.timesteps[observed[0]]) * STEP_S
    velocity = (track.position[last] - track.position[observed[0]]) / seconds if seconds > 0 else track.velocity[last]
    ahead = np.arange(1, FUTURE_STEPS + 1) * STEP_S
    if kind == "constant-velocity":
        return np.asarray(track.position[last] + share * ahead[:, None] * velocity, dtype=np.float64)
    heading = np.unwrap(track.heading[observed])
    rate = share * float(heading[-1] - heading[0]) / seconds if seconds > 0 else 0.0
    speed = float(np.hypot(*velocity))
    if abs(rate) < 1e-4:
        direction = np.array([np.cos(heading[-1]), np.sin(heading[-1])])
        return np.asarray(track.position[last] + speed * ahead[:, None] * direction, dtype=np.float64)
    angle = heading[-1] + rate * ahead
    along = np.stack([np.sin(angle) - np.sin(heading[-1]), np.cos(heading[-1]) - np.cos(angle)], axis=1)
    return np.asarray(track.position[last] + speed / rate * along, dtype=np.float64)


def _score_scene(
    scenario: Scenario, forecast: tuple[FloatArray, Mapping[str, FloatArray]]
) -> tuple[list[Score], list[str]]:
    probabilities, by_track = forecast
    order = np.argsort(-np.asarray(probabilities), kind="stable")
    tracks = {track.track_id: track for track in scenario.tracks}
    scores, reasons = [], []
    for track_id, modes in sorted(by_track.items()):
        track = tracks.get(str(track_id))
        future = np.empty((0, 2)) if track is None else track.position[track.timesteps > LAST_OBSERVED]
        if track is None or len(future) != FUTURE_STEPS:
            what = "no such track" if track is None else f"{len(future)} future steps, expected {FUTURE_STEPS}"
            reasons.append(f"{scenario.scenario_id}, track {track_id}: {what}")
            continue
        for k in KS:
            chosen = np.asarray(modes)[order[:k]]
            fde = compute_fde(chosen, future)
            best = int(np.argmin(fde))
            ade = compute_ade(chosen, future)
            missed = bool(np.all(compute_is_missed_prediction(chosen, future, MISS_M)))
            scores.append(
                Score(
                    scenario.scenario_id,
                    str(track_id),
                    len(scenario.tracks),
                    k,
                    float(ade[best]),
                    float(fde[best]),
                    missed,
                )
            )
    return scores, reasons


def _bands(scores: Sequence[Score], bounds: Sequence[int]) -> Iterable[dict[str, Any]]:
    for bound in (None, *bounds):
        for k in KS:
            inside = [score for score in scores if score.k == k and (bound is None or score.agents > bound)]
            yield {
                "band": "all scenes" if bound is None else f"more than {bound}",
                "k": k,
                "tracks": len(inside),
                "min_ade_m": float(np.mean([s.min_ade_m for s in inside])) if inside else None,
                "min_fde_m": float(np.mean([s.min_fde_m for s in inside])) if inside else None,
                "miss_rate": float(np.mean([s.missed for s in inside])) if inside else None,
            }


def _write(result: PredictionScores, report_dir: Path) -> None:
    content = {"bands": list(result.bands), "left_out": list(result.left_out)}
    left_out = "".join(f"<li>{html.escape(reason)}</li>" for reason in result.left_out[:50])
    about = (
        "<p>How far forecasts end up from where vehicles really went, 6 s after the last observed moment. minADE: mean "
        "distance of the best forecast over all steps; minFDE: its distance at the end; MR: share of vehicles whose "
        "best forecast ends more than 2 m off. Best is the one of the k most probable forecasts that ends nearest.</p>"
    )
    parts = [
        about,
        report.table(TABLE_HEAD, result.rows()),
        f"<p>Not scored ({len(result.left_out)}):</p><ul>{left_out}</ul>" if result.left_out else "",
    ]
    try:
        with table_file(report_dir / "predictions.csv") as stream:
            writer = csv.writer(stream)
            writer.writerow(Score._fields)
            writer.writerows(result.scores)
        text = json.dumps(content, indent=1, allow_nan=False)
        write_text(report_dir / "predictions.json", text + "\n")
        write_text(report_dir / "predictions.html", report.page("Forecasts, scored", parts))
    except OSError as error:
        raise ExportError(f"{report_dir}: cannot write the scores ({error})") from error
