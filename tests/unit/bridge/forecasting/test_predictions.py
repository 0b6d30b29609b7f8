"""Forecasts scored with av2's metrics and the two baselines, on tracks worked by hand; models compared in pairs."""

import re
import shutil

import numpy as np
import pandas as pd
import pytest
from av2.datasets.motion_forecasting.eval import metrics
from av2.datasets.motion_forecasting.eval.submission import ChallengeSubmission
from baseline_file import write_baseline

from bridge.config import load_config
from bridge.forecasting import predictions
from bridge.forecasting.predictions import baseline, read_forecasts, score_predictions, write_forecasts
from bridge.generation.generate import generate
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sources import find_recordings, find_scenarios, read_recording
from hid2.params import Forecasting
from netconvert.errors import ConfigError, ScenarioError


def focal_future(scenario):
    track = scenario.track(scenario.focal_track_id)
    return track.position[track.timesteps > 49]


def scores_of(folder, forecasts):
    return list(score_predictions(folder, predictions=forecasts)[0].itertuples(index=False))


def submission(scenario, modes, probabilities, path, track_id=None):
    forecast = {scenario.scenario_id: (np.array(probabilities), {track_id or scenario.focal_track_id: np.stack(modes)})}
    ChallengeSubmission(forecast).to_parquet(path)
    return path


def test_errors_are_those_of_the_mode_that_ends_nearest_and_it_misses_beyond_two_metres(data_scenes, tmp_path):
    """Mode 1 (p = .7) is 3 m off throughout; mode 0 (p = .3) is 5 m off, but right at its end.

    k = 1, by probability, not by order: ADE 3, FDE 3, a miss, Brier 3 + .3^2. k = 6, the mode that ends nearest: FDE 0,
    ADE 59/60 * 5, no miss, Brier .7^2.
    """
    scenario = read_scenario(data_scenes["arterial"])
    truth = focal_future(scenario)
    second = truth + np.array([0.0, 5.0])
    second[-1] = truth[-1]
    path = submission(scenario, [second, truth + np.array([3.0, 0.0])], [0.3, 0.7], tmp_path / "f.parquet")
    scores = {s.k: s for s in scores_of(data_scenes["arterial"], path)}
    assert (scores[1].min_ade_m, scores[1].min_fde_m, scores[1].missed) == (pytest.approx(3), pytest.approx(3), True)
    assert (scores[6].min_ade_m, scores[6].min_fde_m) == (pytest.approx(5 * 59 / 60), pytest.approx(0))
    assert not scores[6].missed
    assert (scores[1].brier_min_fde, scores[6].brier_min_fde) == (pytest.approx(3.09), pytest.approx(0.49))
    for off, missed in ((1.99, False), (2.01, True)):
        path = submission(scenario, [truth + np.array([off, 0.0])], [1.0], tmp_path / "f.parquet")
        assert scores_of(data_scenes["arterial"], path)[0].missed is missed


def test_scores_of_a_challenge_submission_are_those_of_av2(data_root, tmp_path):
    """Random forecasts of every scene through a file; each figure again with av2's own functions, to 1e-9."""
    random = np.random.default_rng(5)
    forecasts = {}
    for folder in find_scenarios(data_root):
        scenario = read_scenario(folder)
        probabilities = random.dirichlet(np.ones(6))
        modes = focal_future(scenario) + random.normal(0, 3, (6, 60, 2))
        forecasts[scenario.scenario_id] = (probabilities, {scenario.focal_track_id: modes})
    path = write_forecasts(forecasts, tmp_path / "f.parquet")
    scores = {(s.scenario_id, s.k): s for s in scores_of(data_root, path)}
    for folder in find_scenarios(data_root):
        scenario = read_scenario(folder)
        probabilities, by_track = forecasts[scenario.scenario_id]
        modes, truth = by_track[scenario.focal_track_id], focal_future(scenario)
        fde = metrics.compute_fde(modes, truth)
        best = int(fde.argmin())
        found = scores[scenario.scenario_id, 6]
        assert found.min_fde_m == pytest.approx(fde[best], abs=1e-9)
        assert found.min_ade_m == pytest.approx(metrics.compute_ade(modes, truth)[best], abs=1e-9)
        brier = metrics.compute_brier_fde(modes, truth, probabilities)[best]
        assert found.brier_min_fde == pytest.approx(brier, abs=1e-9)
        assert found.missed == bool(metrics.compute_is_missed_prediction(modes, truth).all())
        observed = sum(49 in track.timesteps for track in scenario.tracks)
        assert (found.agents, found.agents_observed) == (len(scenario.tracks), observed)


def test_a_forecast_that_is_not_finite_or_nowhere_near_is_named_and_refused(data_scenes, tmp_path):
    scenario = read_scenario(data_scenes["arterial"])
    truth, broken = focal_future(scenario), focal_future(scenario).copy()
    for value in (np.nan, 1e9):
        broken[12, 1] = value
        path = submission(scenario, [broken, truth], [0.3, 0.7], tmp_path / "f.parquet")
        where = f"{scenario.scenario_id}, track {scenario.focal_track_id}, mode 1 by probability, step 12: y is {value}"
        with pytest.raises(ScenarioError, match=re.escape(where)):
            score_predictions(data_scenes["arterial"], predictions=path)


def test_tracks_of_a_scenario_with_probabilities_of_their_own_or_without_an_id_are_refused(data_scenes, tmp_path):
    """av2 reads one track's for all: brier-minFDE of the other would be wrong. The order of modes may differ."""
    scenario = read_scenario(data_scenes["arterial"])
    truth = focal_future(scenario)
    by_track = {scenario.focal_track_id: np.stack([truth, truth]), "AV": np.stack([truth, truth])}
    path = write_forecasts({scenario.scenario_id: (np.array([0.4, 0.6]), by_track)}, tmp_path / "f.parquet")
    rows = pd.read_parquet(path)
    rows.assign(probability=(0.4, 0.6, 0.6, 0.4)).to_parquet(path)
    assert list(read_forecasts(path)) == [scenario.scenario_id]
    for wrong, said in (
        ({"probability": (0.4, 0.6, 0.3, 0.7)}, f"{scenario.scenario_id}, track .*: probability 0.3, expected"),
        ({"track_id": None}, "4 rows without scenario_id, track_id or probability"),
        ({"predicted_trajectory_y": [["a"] * 60] * 4}, "could not convert string to float"),
    ):
        rows.assign(**wrong).to_parquet(path)
        with pytest.raises((ConfigError, ScenarioError), match=said):
            read_forecasts(path)


def test_jobs_do_not_change_the_scores(data_root, tmp_path, monkeypatch):
    monkeypatch.setattr(predictions, "_CHUNK", 2)
    path = write_baseline(data_root, tmp_path / "f.parquet", kind="constant-velocity")
    alone, _ = score_predictions(data_root, predictions=path, report_dir=tmp_path / "one")
    both, _ = score_predictions(data_root, predictions=path, report_dir=tmp_path / "two", jobs=2)
    pd.testing.assert_frame_equal(alone, both)
    for name in ("predictions.csv", "predictions.html"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_constant_velocity_goes_on_as_in_the_last_half_second_and_constant_turn_rate_keeps_to_a_circle(data_scenes):
    """On the curve the radius of the forecast is speed over turn rate, all along."""
    scenario = read_scenario(data_scenes["arterial"])
    track = scenario.track(scenario.focal_track_id)
    _, modes = baseline(scenario, "constant-velocity")
    rows = np.searchsorted(track.timesteps, [44, 49])
    velocity = (track.position[rows[1]] - track.position[rows[0]]) / 0.5
    forecast = modes[scenario.focal_track_id]
    assert forecast.shape == (6, 60, 2)
    np.testing.assert_allclose(forecast[0][9], track.position[rows[1]] + velocity, atol=1e-9)
    scenario = read_scenario(data_scenes["curve"])
    _, modes = baseline(scenario, "constant-turn-rate")
    steps = np.diff(modes[scenario.focal_track_id][0], axis=0)
    length, angle = np.hypot(*steps.T), np.unwrap(np.arctan2(*steps.T[::-1]))
    np.testing.assert_allclose(length, length[0], rtol=1e-6)
    track = scenario.track(scenario.focal_track_id)
    turned = np.ptp(np.unwrap(track.heading[np.isin(track.timesteps, [44, 49])])) / 5
    assert turned > 0.001
    np.testing.assert_allclose(np.abs(np.diff(angle)), turned, atol=1e-9)


def test_bands_hold_scenes_with_more_agents(data_root, tmp_path):
    bounds = (5, 1000)
    scores, _ = score_predictions(data_root, predictions="constant-velocity", report_dir=tmp_path, bounds=bounds)
    tracks = {(name, k): rest for name, k, *rest in predictions.band_rows(scores, bounds)}
    assert tracks["all scenes", 1][0] == len(find_scenarios(data_root))
    assert tracks["all scenes", 1][1] == pytest.approx(scores[scores.k == 1].min_ade_m.mean(), rel=1e-12)
    assert tracks["more than 1000", 6] == [0, None, None, None, None]
    assert predictions.shown([("all", 1, 0, 1.23456, None)]) == [("all", 1, 0, "1.235", "–")]
    assert tracks["more than 5 at the observation's end", 6] == tracks["more than 5", 6]
    assert len(pd.read_csv(tmp_path / "predictions.csv")) == len(scores)
    assert "minADE" in (tmp_path / "predictions.html").read_text()


def test_what_cannot_be_scored_is_told_and_so_are_fewer_modes(data_scenes, data_root, tmp_path, caplog):
    scenario = read_scenario(data_scenes["arterial"])
    truth = focal_future(scenario)
    path = submission(scenario, [truth], [1.0], tmp_path / "f.parquet", track_id="nobody")
    with pytest.raises(ScenarioError, match=r"by .*/f.parquet, first of 3 reasons: .*nobody: no such track"):
        score_predictions(data_root, predictions=path)
    path = submission(scenario, [truth], [1.0], tmp_path / "f.parquet")
    _, left_out = score_predictions(data_root, predictions=path)
    assert [reason.partition(": ")[2] for reason in left_out] == ["no forecast"] * 2
    assert "1 of 1 scenarios have fewer than 6 modes" in caplog.text
    shutil.copytree(data_root, tmp_path / "some")
    broken = next((tmp_path / "some").glob("val/*/scenario_*.parquet"))
    broken.write_bytes(b"no")
    scores, left_out = score_predictions(
        tmp_path / "some", predictions="constant-velocity", report_dir=tmp_path / "report"
    )
    assert left_out[0].startswith(f"{broken}: not a parquet file (")
    assert scores["scenario_id"].nunique() == 2
    (tmp_path / "bad.parquet").write_bytes(b"no")
    with pytest.raises(ConfigError, match="not a forecast file") as said:
        read_forecasts(tmp_path / "bad.parquet")
    assert len(str(said.value)) < len(str(tmp_path)) + 150  # pyarrow's own reason goes on for three times as much
    pd.DataFrame({"scenario_id": ["a"], "track_id": "b", "probability": 1.0}).to_parquet(tmp_path / "wrong.parquet")
    with pytest.raises(ConfigError, match=r"not a forecast file .*\(no column 'predicted_trajectory_x'"):
        score_predictions(data_root, predictions=tmp_path / "wrong.parquet", report_dir=tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_a_baseline_forecasts_what_is_not_observed_of_a_scene_made_from_argoverse_1(argoverse1, tmp_path):
    """20 of 50 steps are observed: the 30 others are forecast, in steps of 0.1 s, from step 19 on."""
    (address,) = find_recordings([argoverse1 / "train" / "data" / "1.csv"])
    folder = generate(read_recording(address), load_config(None, ["request.agents=1"])).write(tmp_path / "out")
    scenario = read_scenario(folder)
    _, modes = baseline(scenario, "constant-velocity")
    track = scenario.track(scenario.focal_track_id)
    future = track.position[track.timesteps > 19]
    assert modes[track.track_id].shape == (6, 30, 2)
    scored = {s.k: s for s in scores_of(tmp_path / "out", "constant-velocity")}
    errors = np.hypot(*(modes[track.track_id][0] - future).T)
    assert (scored[1].min_ade_m, scored[1].min_fde_m) == pytest.approx((errors.mean(), errors[-1]))
    assert scored[1].agents_observed == sum(19 in track.timesteps for track in scenario.tracks)


def test_a_scene_that_lies_in_two_folders_is_scored_once_and_named(data_root, tmp_path):
    """As the validation scenes of the data sets of a composed root do."""
    for name in ("one", "two"):
        shutil.copytree(data_root, tmp_path / "root" / name)
    scores, left_out = score_predictions(tmp_path / "root", predictions="constant-velocity")
    pd.testing.assert_frame_equal(scores, score_predictions(data_root, predictions="constant-velocity")[0])
    assert len(left_out) == 3
    assert all(re.search("/two/.*: same scene as .*/one/", line) for line in left_out)
    for file in (tmp_path / "root").rglob("scenario_*"):
        file.unlink()
    with pytest.raises(ScenarioError, match=r"first of 6 reasons: no scenario_<id>\.parquet"):
        score_predictions(tmp_path / "root", predictions="constant-velocity")


PARAMS = Forecasting(resamples=4000)


def score(scene, fde, *, agents=60, k=6):
    return scene, "1", agents, agents, k, fde / 2, fde, fde > 2, fde + 0.5


def tables(runs):
    return [pd.DataFrame(run, columns=predictions.SCORE_COLUMNS) for run in runs]


def compared(mine, theirs, source_of=None, metric="min_fde_m"):
    runs = {"a": tables(mine), "b": tables(theirs)}
    found = predictions.differences_of([("a", "b")], runs, {"all": "agents > 0"}, source_of or {}, PARAMS)
    return next(one for one in found if one.metric == metric)


def test_a_difference_is_over_pairs():
    """Scenes differ by metres, the models by .1 m in each: the interval is that of the pairs, no wider."""
    levels = np.linspace(0.5, 8, 40)
    mine = [[score(f"s{n}", level - 0.1) for n, level in enumerate(levels)]]
    theirs = [[score(f"s{n}", level) for n, level in enumerate(levels)]]
    found = compared(mine, theirs)
    assert (found.difference, found.low, found.high) == pytest.approx((-0.1, -0.1, -0.1))
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
    """Three seeds of a, 1 m apart, on equal scenes: 1 m / sqrt(3), the standard error of the mean of three."""
    mine = [[score(f"s{n}", 5.0 + seed) for n in range(30)] for seed in range(3)]
    theirs = [[score(f"s{n}", 5.0) for n in range(30)] for _ in range(3)]
    found = compared(mine, theirs)
    assert found.difference == pytest.approx(1.0)
    assert found.se == pytest.approx(1 / np.sqrt(3), rel=0.06)


def test_intervals_are_of_three_scenes_at_least_and_within_what_a_metric_can_be():
    """One seed misses in all of three scenes, one in the first: other seeds may miss in all of them, never in more."""
    runs = tables([[score(name, 3.0) for name in "abc"], [score("a", 3.0), score("b", 1.0), score("c", 1.0)]])
    rate = predictions.mean_of(runs, {}, "missed", PARAMS)
    assert (rate.value, rate.high) == (pytest.approx(2 / 3), 1.0)
    assert predictions.mean_of([run.head(2) for run in runs], {}, "missed", PARAMS) == (0.75, None, None)


def test_only_tracks_that_every_file_forecasts_count():
    mine = [[score("a", 1.0), score("b", 9.0)]]
    theirs = [[score("a", 2.0), score("c", 9.0)]]
    found = compared(mine, theirs)
    assert (found.tracks, found.difference) == (1, -1.0)
    assert found.low is None  # one scene has no interval
    nothing = compared(mine, [[score("z", 1.0)]])
    assert (nothing.tracks, nothing.difference, nothing.detectable) == (0, None, None)


def test_files_are_compared_with_the_first(data_root, tmp_path):
    """A forecast that is right ends nearer than constant velocity in every scene."""
    right = {}
    for folder in find_scenarios(data_root):
        scenario = read_scenario(folder)
        track = scenario.track(scenario.focal_track_id)
        right[scenario.scenario_id] = (np.array([1.0]), {track.track_id: track.position[None, track.timesteps > 49]})
    first = write_baseline(data_root, tmp_path / "cv.parquet", kind="constant-velocity")
    second = write_forecasts(right, tmp_path / "right.parquet")
    few = write_forecasts(dict([*right.items()][:2]), tmp_path / "few" / "cv.parquet")
    some = predictions.parse_models([str(first), str(few)])
    _, (told,) = predictions.compare_predictions(data_root, some, tmp_path / "report")
    assert told.startswith(f"{few}, {few}: ")  # of two files of one name each is a model, called by its path
    assert told in (tmp_path / "report" / "comparison.html").read_text()
    models = predictions.parse_models([str(first), f"oracle={second}"])
    assert models == {"cv": [first], "oracle": [second]}
    found, left_out = predictions.compare_predictions(data_root, models, tmp_path / "report", bounds=(22,))
    assert left_out == []
    whole = next(one for one in found if one.band == "all scenes" and one.metric == "min_fde_m")
    assert (whole.model, whole.minus, whole.tracks) == ("oracle", "cv", 3)
    assert whole.high < 0
    assert {one.tracks for one in found if one.band == "more than 22"} == {1}
    assert {path.name for path in (tmp_path / "report").iterdir()} == {"comparison.csv", "comparison.html"}
    with pytest.raises(ConfigError, match="expected two or more"):
        predictions.compare_predictions(data_root, predictions.parse_models([str(first)]), tmp_path / "report")
    with pytest.raises(ConfigError, match="no such file"):
        predictions.parse_models(["a=nowhere.parquet"])
    with pytest.raises(ConfigError, match="given twice"):
        predictions.parse_models([str(first), f"{tmp_path}/few/../cv.parquet"])
