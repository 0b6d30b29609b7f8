"""What tables of looks and requests say: waiting, critical gaps, trends."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bridge.pages.parts import macros
from bridge.studies import statistics
from bridge.studies.gap_acceptance import critical_gap, gaps_of, largest_rejected, troutbeck
from bridge.studies.page import _classes, _seeds_line, _told, _write_table, draw_parameter
from bridge.studies.statistics import difference_sd, dose_response, few_clusters_p, mean_wait, observed_s, seeds_needed


@pytest.fixture(autouse=True)
def _few_draws(few_draws: None) -> None:
    """Nothing here depends on how many draws there are."""


RUN = {"scene": "a", "city": "x", "point": 0, "seed": 0, "replay": "fixed"}


def _drivers(count: int, mean_s: float, sd_s: float, seed: int) -> pd.DataFrame:
    """Gaps looked at by drivers of lognormal critical gaps, one exponential gap after the other until one is taken."""
    rng = np.random.default_rng(seed)
    variance = np.log(1.0 + (sd_s / mean_s) ** 2)
    rows = []
    for driver in range(count):
        critical = float(np.exp(rng.normal(np.log(mean_s) - variance / 2, np.sqrt(variance))))
        taken = False
        while not taken:
            gap = float(rng.exponential(mean_s))
            taken = gap > critical
            rows.append(
                {**RUN, "seed": driver % 10, "vehicle": f"v{driver}", "accepted": taken, "lag_time_gap_s": gap,
                 "lead_time_gap_s": 5.0, "accepted_s": 1.0 if taken else None, "lag_refused_s": None if taken else gap}
            )  # fmt: skip
    return pd.DataFrame(rows)


@pytest.mark.parametrize(("mean_s", "sd_s"), [(1.5, 0.4), (2.5, 0.5), (4.0, 1.0)])
def test_critical_gaps_of_synthetic_drivers_are_found_again(mean_s: float, sd_s: float) -> None:
    """300 drivers of known critical gap: mean and SD lie within their intervals; Raff's is near."""
    drivers = _drivers(300, mean_s, sd_s, seed=1)
    found = critical_gap(drivers, "lag")
    assert found is not None
    assert (found["drivers"], found["inconsistent"]) == (300, 0)
    mean, sd = troutbeck(*largest_rejected(drivers, "lag")[:2])
    assert (found["mean_s"], found["mean_low_s"], found["mean_high_s"], found["sd_s"]) == (*mean, sd.value)
    for estimate, true in ((mean, mean_s), (sd, sd_s)):
        assert estimate.low is not None
        assert estimate.high is not None
        assert estimate.low < true < estimate.high
    assert found["mean_high_s"] - found["mean_low_s"] < 0.25 * mean_s


@pytest.mark.slow
def test_intervals_of_critical_gaps_hold_what_they_say() -> None:
    """95 % intervals of 100 tables of 100 drivers: at least 89 hold the mean (binomial, p < .01 below)."""
    held = 0
    for seed in range(100):
        rejected, accepted, _ = largest_rejected(_drivers(100, 2.0, 0.5, seed=100 + seed), "lag")
        mean, _ = troutbeck(rejected, accepted)
        assert mean.low is not None
        assert mean.high is not None
        held += mean.low < 2.0 < mean.high
    assert held >= 89


def test_few_clusters_cannot_be_surer_than_their_signs_allow() -> None:
    """All six the same way: of 2^6 signs two are as far, p = 2 / 64. One of three the other way, and none moves."""
    assert few_clusters_p(np.array([1.0, 2.0, 1.5, 0.5, 1.2, 3.0])) == pytest.approx(2 / 64)
    assert few_clusters_p(np.array([1.0, -1.0, 1.0])) == 1.0
    assert few_clusters_p(np.zeros(5)) == 1.0
    assert few_clusters_p(np.array([1.0, np.nan])) is None


def test_seeds_needed_are_those_of_the_paired_t_test() -> None:
    """A difference of one SD: 10 pairs; of half of one: 34 (Cohen 1988, table 2.4.1, for paired differences)."""
    assert [seeds_needed(1.0, 1.0), seeds_needed(1.0, 0.5), seeds_needed(0.0, 0.1)] == [10, 34, 2]
    found = difference_sd(_requests(-0.3), "p")
    assert found is not None
    assert found[1] == 12
    assert difference_sd(_requests(-0.3, runs=2), "p") is None
    requests = _requests(-0.3)
    assert difference_sd(requests.assign(p=np.array(["c", "b", "d"])[requests["point"]]), "p") == found
    other = requests.assign(scene="b", counted=False)  # adds no run to a seed
    assert _seeds_line(pd.concat([requests, other]), "p") == _seeds_line(requests, "p")


def test_driver_who_refused_a_larger_gap_is_left_out_and_counted() -> None:
    rows = [
        {**RUN, "vehicle": "v0", "accepted": False, "lag_time_gap_s": 3.0, "lag_refused_s": 3.0},
        {**RUN, "vehicle": "v0", "accepted": True, "lag_time_gap_s": 2.0, "accepted_s": 1.0},
        {**RUN, "vehicle": "v1", "accepted": False, "lag_time_gap_s": 9.0, "lag_refused_s": None},  # not for its lag
        {**RUN, "vehicle": "v1", "accepted": True, "lag_time_gap_s": 2.0, "accepted_s": 1.0},
    ]
    rejected, accepted, inconsistent = largest_rejected(pd.DataFrame(rows), "lag")
    assert (rejected.tolist(), accepted.tolist(), inconsistent) == ([0.0], [2.0], 1)


def test_mean_wait_by_hand() -> None:
    """Up to 2.5 s: 1 * 1 + 1.5 * 2/3 = 2 s; rows weigh like copies of them; nobody waits when all are taken at once."""
    waited, accepted = np.array([1.0, 2.0, 3.0]), np.array([1.0, 0.0, 1.0])
    assert mean_wait(waited, accepted, np.ones(3), within_s=2.5) == pytest.approx(2.0)
    copied = mean_wait(waited[[0, 1, 1]], accepted[[0, 1, 1]], np.ones(3), within_s=6.0)
    assert mean_wait(waited, accepted, np.array([1.0, 2.0, 0.0]), within_s=6.0) == pytest.approx(copied)
    assert mean_wait(np.zeros(4), np.ones(4), np.ones(4), within_s=10.0) == pytest.approx(0.01)


def test_waiting_is_told_up_to_the_shortest_time_observed_at_every_value() -> None:
    """At 0 one waits for 6 s; at 1 the scene has no time left after 2 s; at 2 both accept, and all is known."""
    rows = [(0, 1.0, True), (0, 6.0, False), (1, 1.0, True), (1, 2.0, False), (2, 0.0, True), (2, 1.0, True)]
    found = pd.DataFrame(rows, columns=["p", "waited_s", "accepted"])
    assert [observed_s(found, "p", give_up_s=longest) for longest in (6.0, 1.5)] == [2.0, 1.5]
    requests = _requests(0.0).assign(accepted=False)
    requests.loc[requests["p"] == 1.0, "waited_s"] = 2.0
    dose = dose_response(requests, pd.DataFrame(), "p", give_up_s=6.0, critical_ttc_s=1.5)
    assert dose.loc[dose["outcome"] == "mean_wait_s", ["within_s", "estimate"]].to_numpy().tolist() == [[2.0, 2.0]] * 3
    ((outcome, told),) = [one for one in _told(dose)["outcomes"] if one[0].name == "mean_wait_s"]
    assert "at every value, here 2 s: 2 at every" in macros("study_lines.md.j2").outcome(outcome, told, "p")


def _look(vehicle: str, time_s: float, lag: str, gap_s: float, sumo: str | None, rule: str) -> dict[str, Any]:
    return {
        **RUN, "vehicle": vehicle, "side": "left", "time_s": time_s, "lead_id": None, "lag_id": lag,
        "lag_time_gap_s": gap_s, "lead_time_gap_s": np.nan, "lag_gap_m": 10 * gap_s, "lead_gap_m": np.nan,
        "rule": rule, "refusals": None if rule == "yes" else rule, "guard": "yes" if rule == "yes" else None,
        "sumo": sumo, "trigger_s": 1.0,
    }  # fmt: skip


def test_gap_is_one_row_with_its_largest_size_or_that_at_which_the_rule_took_it() -> None:
    looks = pd.DataFrame(
        [
            _look("v0", 1.0, "a", 0.5, None, "rear_gap"),
            _look("v0", 1.1, "a", 0.9, None, "rear_gap"),
            _look("v0", 1.2, "a", 0.7, None, "rear_gap"),
            _look("v0", 1.3, "b", 3.0, "no", "yes"),
            _look("v0", 1.4, "b", 2.0, "yes", "yes"),
        ]
    )
    first, second = gaps_of(looks, []).to_dict("records")
    assert (first["lag_id"], first["accepted"], first["lag_time_gap_s"]) == ("a", False, 0.9)
    assert (first["refused_by"], first["lag_refused_s"]) == ("rule", 0.9)
    assert (second["lag_id"], second["accepted_s"], second["lag_time_gap_s"]) == ("b", 1.3, 3.0)
    assert (second["accepted"], second["refused_by"], second["taken"]) == (True, "", True)
    assert np.isnan(second["lag_refused_s"])


def _requests(slope: float, *, runs: int = 12, each: int = 20) -> pd.DataFrame:
    """Requests of runs at three values of p; the share accepted goes with slope * p; the same vehicles at each."""
    rng = np.random.default_rng(3)
    rows = []
    for seed in range(runs):
        luck = rng.random(each)
        for point, p in enumerate((0.0, 0.5, 1.0)):
            rows += [
                {**RUN, "point": point, "p": p, "seed": seed, "vehicle": f"v{k}", "counted": True,
                 "accepted": luck[k] < 0.6 + slope * p, "waited_s": 5.0, "looks": 10, "overlaps": False, "start_s": 3.0,
                 "lag_drac_mps2": 1.0, "lag_headway_s": 1.5, "lag_brakes_mps2": 0.5, "lateral_s": 4.0,
                 "lag_time_gap_s": 2.0 + p, "min_ttc_s": np.nan}
                for k in range(each)
            ]  # fmt: skip
    return pd.DataFrame(rows)


def test_trend_is_the_slope_over_all_values_and_p_counts_the_family() -> None:
    """2.0, 2.5, 3.0 s at 0, .5, 1: one s for one more. The share falls by .3; what never changes has no trend.

    The paired difference excludes no effect where there is one, and not elsewhere. Names are each compared with the one
    that the study has first: by the alphabet rule, the second, would have no difference.
    """
    for slope, excluded in ((0.0, False), (-0.3, True)):
        requests = _requests(slope).assign(point=lambda rows: 2 - rows["point"])  # numbers are in their own order
        dose = dose_response(requests, pd.DataFrame(), "p", give_up_s=6.0, critical_ttc_s=1.5)
        last = dose[(dose["outcome"] == "share_accepted") & (dose["value"] == 1.0)].iloc[0]
        assert bool(last["difference_low_runs"] < last["difference_high_runs"] < 0.0) is excluded
        gap = dose[dose["outcome"] == "lag_time_gap_s"]
        assert gap["low_runs"].tolist() == gap["high_runs"].tolist() == pytest.approx([2.0, 2.5, 3.0])
        assert last["rows"] == 240
        assert (last["difference"] == 0.0) is not excluded  # the same luck at every value: nothing differs at all
    first = dose.drop_duplicates("outcome").set_index("outcome")
    assert first.loc["lag_time_gap_s", "trend"] == pytest.approx(1.0)
    assert first.loc["share_accepted", "trend"] == pytest.approx(-0.3, abs=0.1)
    assert first.loc["share_accepted", "p"] < 0.05
    assert first.loc["lateral_s", "p"] == 1.0
    assert first.loc["lag_time_gap_s", "p"] == pytest.approx(2 / 2**12)  # each of twelve runs says the same
    names = _requests(0.0).assign(p=lambda rows: np.array(["sumo", "guard", "rule"])[rows["point"]])
    assert statistics._slopes([0.3, 2.0], np.full((1, 2), 0.15)) == [0.0]  # no rounding
    named = dose_response(names, pd.DataFrame(), "p", give_up_s=6.0, critical_ttc_s=1.5)
    assert ("trend" in named, set(named["clusters"])) == (False, {12})
    ((outcome, told),) = [each for each in _told(named)["outcomes"] if each[0].name == "lag_time_gap_s"]
    line = macros("study_lines.md.j2").outcome(outcome, told, "p")
    assert "2 at sumo, 2.5 at guard, 3 at rule; difference at guard +0.5, 95" in line
    assert "; difference at rule +1, 95" in line
    assert (first["clusters"] == 12).all()
    varies = (first["p"] < 1.0) & (first.index != "share_accepted")  # a study is planned for that one
    assert (first["p_holm"].notna() == varies).all()  # what never changes is none of the family
    assert first.loc[varies, "p_holm"].tolist() == pytest.approx((varies.sum() * first.loc[varies, "p"]).tolist())


def test_table_that_grows_long_is_there_in_one_form(tmp_path: Path) -> None:
    for rows, names in ((50_000, ["looks.csv"]), (50_001, ["looks.csv.gz"]), (1, ["looks.csv"])):
        _write_table(tmp_path, "looks", pd.DataFrame({"time_s": np.arange(rows)}))
        assert [path.name for path in tmp_path.iterdir()] == names


def test_parameter_with_which_nobody_gets_a_gap_is_drawn_too(tmp_path: Path) -> None:
    """Nobody accepts at any value: all still wait at the end, and all the rest is empty."""
    requests = _requests(0.0).assign(accepted=False, lateral_s=np.nan, lag_time_gap_s=np.nan, start_s=np.nan)
    dose = dose_response(requests, pd.DataFrame(), "p", give_up_s=6.0, critical_ttc_s=1.5)
    path = tmp_path / "p.png"
    draw_parameter(path, "p", "p", dose=dose, requests=requests, give_up_s=6.0)
    assert path.stat().st_size > 10_000
    assert dose.loc[dose["outcome"] == "share_accepted", "estimate"].tolist() == [0.0] * 3


def test_shares_of_the_gaps_that_each_refused_by_hand() -> None:
    """Five gaps: cells and guard refuse one each at last, the rule two, one is taken, which SUMO refused at first.

    To one of the rule's SUMO said no before: it counts with both. Of the three that the rule took one came about. The
    guard was asked about three, SUMO about two; a gap is one, however often it was looked at.
    """
    guarded = _look("v2", 1.0, "c", 2.0, None, "yes") | {"guard": "conflict_predicted"}
    late = _look("v5", 9.0, "f", 2.0, None, "yes") | {"guard": "scene_ends"}
    assert gaps_of(pd.DataFrame([late]), [])["refused_by"].tolist() == ["end"]
    looks = [_look("v0", 1.0, "a", 0.5, None, "cells_occupied"), _look("v1", 1.0, "b", 0.5, None, "cells_occupied")]
    looks += [_look("v1", 1.1 + 0.1 * k, "b", 0.9, None, "rear_gap") for k in range(7)]
    looks += [guarded, _look("v3", 1.0, "d", 3.0, "no", "yes"), _look("v4", 1.0, "e", 3.0, "no", "yes")]
    looks += [_look("v3", 1.1, "d", 0.5, None, "rear_gap"), _look("v4", 1.1, "e", 3.0, "yes", "yes")]
    gaps = gaps_of(pd.DataFrame(looks), []).assign(p=0.0)
    assert gaps["refused_by"].tolist() == ["cells", "rule", "guard", "rule", ""]
    dose = dose_response(_requests(0.0), gaps, "p", give_up_s=6.0, critical_ttc_s=1.5)
    taken = dose[dose["outcome"] == "gaps_taken"]
    assert (taken["estimate"].tolist(), taken["rows"].tolist()) == (pytest.approx([1 / 3]), [3])
    found = dose.set_index("outcome").loc[[f"refused_by_{name}" for name in ("sumo", "guard", "rule", "cells", "road")]]
    assert found["estimate"].tolist() == pytest.approx([0.5, 1 / 3, 0.4, 0.2, 0.0])
    assert found["rows"].tolist() == [2, 3, 5, 5, 5]


def test_a_parameter_of_many_values_is_told_in_six_classes_as_large() -> None:
    """Of 0, 1, ..., 23 the first class has 0 to 3, mean 1.5; twelve values stand for themselves, and so do names."""
    told = _classes(pd.Series([float(value) for value in range(24)] * 2))
    assert sorted(set(told.values())) == [1.5, 5.5, 9.5, 13.5, 17.5, 21.5]
    assert (told[3.0], told[4.0]) == (1.5, 5.5)
    assert len(set(_classes(pd.Series(np.linspace(0.0, 0.002, 13))).values())) == 6
    few, names = pd.Series(np.arange(12.0)), pd.Series([f"rule {number}" for number in range(20)])
    assert all(_classes(values) == {value: value for value in values} for values in (few, names))
