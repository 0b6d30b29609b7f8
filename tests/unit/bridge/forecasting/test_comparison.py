"""Models compared in pairs, on scores made by hand."""

import numpy as np
import pandas as pd
import pytest
from baseline_file import write_baseline

from bridge.forecasting.predictions import (
    SCORE_COLUMNS,
    compare_predictions,
    differences_of,
    mean_of,
    parse_models,
    write_forecasts,
)
from bridge.recordings.scenario import find_scenarios, read_scenario
from hid2.params import Forecasting
from netconvert.errors import ConfigError

PARAMS = Forecasting(resamples=4000)


def score(scene, fde, *, agents=60, k=6):
    return scene, "1", agents, agents, k, fde / 2, fde, fde > 2, fde + 0.5


def tables(runs):
    return [pd.DataFrame(run, columns=SCORE_COLUMNS) for run in runs]


def compared(mine, theirs, source_of=None, metric="min_fde_m"):
    runs = {"a": tables(mine), "b": tables(theirs)}
    found = differences_of([("a", "b")], runs, {"all": "agents > 0"}, source_of or {}, PARAMS)
    return next(one for one in found if one.metric == metric)


def test_a_difference_is_over_pairs():
    """Scenes differ by metres, the models by .1 m in each: the interval is that of the pairs, no wider."""
    levels = np.linspace(0.5, 8, 40)
    mine = [[score(f"s{n}", level - 0.1) for n, level in enumerate(levels)]]
    theirs = [[score(f"s{n}", level) for n, level in enumerate(levels)]]
    found = compared(mine, theirs)
    assert found.difference == pytest.approx(-0.1)
    assert (found.low, found.high) == (pytest.approx(-0.1), pytest.approx(-0.1))
    assert (found.tracks, found.sources, found.seeds) == (40, 40, (1, 1))


def test_the_standard_error_over_scenes_is_that_of_a_mean():
    """400 pairs with a standard deviation of .8 m: .04 m, and detectable are 2.80 of these."""
    random = np.random.default_rng(1)
    gaps = random.normal(0, 0.8, 400)
    gaps *= 0.8 / gaps.std()
    mine = [[score(f"s{n}", 5 + gap) for n, gap in enumerate(gaps)]]
    theirs = [[score(f"s{n}", 5.0) for n in range(400)]]
    found = compared(mine, theirs)
    assert found.se == pytest.approx(0.04, rel=0.05)
    assert found.detectable == pytest.approx(2.8016 * found.se, rel=1e-3)


def test_scenes_made_of_one_recorded_scene_are_drawn_together():
    """Ten scenes of each of four sources, equal within: as good as four scenes, not as forty."""
    values = (0.0, 1.0, 2.0, 3.0)
    mine = [[score(f"{s}-{n}", 5 + value) for s, value in enumerate(values) for n in range(10)]]
    theirs = [[score(f"{s}-{n}", 5.0) for s in range(4) for n in range(10)]]
    source_of = {f"{s}-{n}": str(s) for s in range(4) for n in range(10)}
    together, apart = compared(mine, theirs, source_of), compared(mine, theirs)
    assert (together.sources, apart.sources) == (4, 40)
    assert together.se == pytest.approx(np.std(values) / 2, rel=0.06)
    assert apart.se == pytest.approx(np.std(values) / np.sqrt(40), rel=0.06)


def test_seeds_are_drawn_too():
    """Three seeds of a, 1 m apart, on equal scenes: all that varies is the mean of three seeds drawn."""
    mine = [[score(f"s{n}", 5.0 + seed) for n in range(30)] for seed in range(3)]
    theirs = [[score(f"s{n}", 5.0) for n in range(30)] for _ in range(3)]
    found = compared(mine, theirs)
    assert found.difference == pytest.approx(1.0)
    assert found.se == pytest.approx(np.std([0, 1, 2]) / np.sqrt(3), rel=0.06)


def test_only_tracks_that_every_file_forecasts_count():
    mine = [[score("a", 1.0), score("b", 9.0)]]
    theirs = [[score("a", 2.0), score("c", 9.0)]]
    found = compared(mine, theirs)
    assert (found.tracks, found.difference) == (1, -1.0)
    assert found.low is None  # one scene has no interval
    nothing = compared(mine, [[score("z", 1.0)]])
    assert (nothing.tracks, nothing.difference, nothing.detectable) == (0, None, None)


def test_bands_and_metrics_are_taken_apart():
    (run,) = runs = tables([[score("a", 1.0, agents=40), score("b", 3.0, agents=80), score("b", 99.0, agents=80, k=1)]])
    assert mean_of([run.query("agents > 50")], {}, "min_fde_m", PARAMS).value == 3.0
    assert mean_of(runs, {}, "missed", PARAMS).value == 0.5
    assert mean_of(runs, {}, "brier_min_fde", PARAMS).value == 2.5


def test_files_are_compared_with_the_first(data_root, tmp_path):
    """A forecast that is right ends nearer than constant velocity in every scene."""
    right = {}
    for folder in find_scenarios(data_root):
        scenario = read_scenario(folder)
        track = scenario.track(scenario.focal_track_id)
        right[scenario.scenario_id] = (np.array([1.0]), {track.track_id: track.position[None, track.timesteps > 49]})
    first = write_baseline(data_root, tmp_path / "cv.parquet", kind="constant-velocity")
    second = write_forecasts(right, tmp_path / "right.parquet")
    models = parse_models([str(first), f"oracle={second}"])
    assert models == {"cv": [first], "oracle": [second]}
    found, left_out = compare_predictions(data_root, models, tmp_path / "report", bounds=(22,))
    assert left_out == []
    whole = next(one for one in found if one.band == "all scenes" and one.metric == "min_fde_m")
    assert (whole.model, whole.minus, whole.tracks) == ("oracle", "cv", 3)
    assert whole.high < 0
    assert {one.tracks for one in found if one.band == "more than 22"} == {1}
    assert {path.name for path in (tmp_path / "report").iterdir()} == {"comparison.csv", "comparison.html"}
    with pytest.raises(ConfigError, match="expected two or more"):
        compare_predictions(data_root, parse_models([str(first)]), tmp_path / "report")
    with pytest.raises(ConfigError, match="no such file"):
        parse_models(["a=nowhere.parquet"])
    with pytest.raises(ConfigError, match="given twice"):
        parse_models([f"a={first}", f"a={first}"])
