"""A page of public roads: figures by hand, what is tuned on, what is refused, and the same bytes after a kill."""

import gzip
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from bridge.batch.batch import Options
from bridge.pages.parts import text
from bridge.studies.public_roads import WITHIN, RoadResult, _best, read_public, run_public
from bridge.studies.study import read_run
from netconvert.errors import BatchError, ConfigError

ROOT = Path(__file__).parents[4]
ROAD = """length_m = 200.0
lanes = 2
warm_up_s = 10.0
approach_m = 30.0
run_out_m = 30.0
[beside]
from_m = 50.0
to_m = 150.0
on_ramp = true
[[period]]
until_s = 30.0
veh_per_h = [900.0, 900.0, 400.0]
"""
ASKED = ROAD.replace("[900.0, 900.0, 400.0]", "[0.0, 0.0, 0.0]")
COUNTS = """name = "Somewhere"
vehicles = [40.0, 40.0, 20.0]
start_to_end = [[38, 2, 0], [10, 30, 0], [5, 15, 0]]
[published]
flow_veh_per_h = 2000.0
speed_mps = 10.0
changes_per_vehicle = 0.5
changes_per_veh_km = 1.0
from_lane_1 = 0.1
from_lane_2 = 0.3
from_ramp = 1.5
"""
PAGE = """title = "A page"
seeds = 2
[[road]]
file = "road.toml"
counts = "counts.toml"
tune = true
[[rule]]
name = "LC2013"
set = { "lane_change.rule" = "LC2013" }
vary = { "lane_change.lc_speed_gain" = [3.0] }
[cause]
"one speed" = { "drivers.desired_sd" = 0.0 }
[config.lane_change]
min_speed_mps = 0.0
safety = "rule"
"""
GAPS = COUNTS[: COUNTS.index("changes_per_vehicle")] + "critical_lag_gap_mean_s = 1.0\n"


def page_in(tmp_path: Path, *, page: str = PAGE, counts: str = COUNTS, road: str = ROAD) -> Path:
    files = {"page.toml": page, "counts.toml": counts, "road.toml": road, "asked.toml": ASKED}
    for name, content in files.items():
        (tmp_path / name).write_text(content)
    return tmp_path / "page.toml"


def run_of(
    vehicles: list[int], changes: list[int], *, flow: float = 2040.0, speed: float = 9.5, **more: Any
) -> dict[str, Any]:
    """What a run tells of a road of two lanes and a ramp: 10 veh-km."""
    names = ("from_lane_1", "from_lane_2", "from_ramp")
    ratios = {name: one for name, *one in zip(names, changes, vehicles, strict=True)}
    every, count = sum(changes), sum(vehicles)
    ratios |= {"flow_veh_per_h": [flow, 1.0], "speed_mps": [speed, 1.0]}
    ratios |= {"changes_per_vehicle": [every, count], "changes_per_veh_km": [every, 10.0]}
    ratios |= {"inconsistent_lag": [3, 1], "inconsistent_lead": [0, 1]}
    return {"ratios": ratios, "cells": [], "lag": [], "lead": []} | more


def result(tmp_path: Path, *runs: dict[str, Any], **files: str) -> RoadResult:
    return RoadResult(read_public(page_in(tmp_path, **files)).road[0], "a rule", "untuned", {}, [*runs])


def test_figures_by_hand(tmp_path: Path) -> None:
    """Two seeds, too few for an interval: 100 and 100 vehicles, 60 and 40 changes.

    By lane (10 + 10) / 80 = .25, (30 + 10) / 80 = .5, ramp (20 + 20) / 40 = 1.0; published .1, .3, 1.5 with 40, 40, 20
    vehicles: (40 x .15 + 40 x .2 + 20 x .5) / 100 = .24. All 100 / 200 = .5 as published; 100 changes in 20 km: 5.
    A road without its flow or its speed does not reproduce.
    """
    one = result(tmp_path, run_of([40, 40, 20], [10, 30, 20]), run_of([40, 40, 20], [10, 10, 20]))
    told = one.measures
    assert [told[name].value for name in one.site.road.from_lanes] == [0.25, 0.5, 1.0]
    assert (told["changes_per_vehicle"].value, told["changes_per_veh_km"].value) == (0.5, 5.0)
    assert told["changes_per_vehicle"].low is None
    assert one.error == pytest.approx(0.24)
    assert one.off("changes_per_vehicle") == pytest.approx(0.0)
    assert told["rank_correlation"].value == pytest.approx(1.0)
    assert (one.off("flow_veh_per_h"), one.off("speed_mps")) == pytest.approx((0.02, -0.05))
    assert one.reproduces
    for more in ({"flow": 2061.0}, {"speed": 8.9}):
        assert result(tmp_path, run_of([40, 40, 20], [1, 1, 1], **more)).reproduces is False
    bare = COUNTS.replace("flow_veh_per_h = 2000.0\nspeed_mps = 10.0\n", "")
    assert result(tmp_path, run_of([40, 40, 20], [1, 1, 1]), counts=bare).reproduces is None
    better = replace(one, variant="failed on one road", changes={"b": 1}, runs=[run_of([40, 40, 20], [4, 12, 30])])
    assert better.error < 0.01
    assert _best([replace(one, changes={"b": 0})] * 2 + [better]) == {"b": 0}


def test_ladder_and_slopes_by_hand(tmp_path: Path) -> None:
    """Rates .01 x origin + .02 x target + .1 in four cells of 100 veh-km; of one above 20 veh/km no slope is told."""
    cells = [(5, 5, 25, 100), (15, 5, 35, 100), (5, 15, 45, 100), (15, 15, 55, 100), (50, 50, 900, 100)]
    one = result(tmp_path, *[run_of([1, 1, 1], [1, 1, 1], cells=cells)] * 3)
    assert [[rate.value for rate in row] for row in one.ladder([0, 10, 20])] == [[0.25, 0.45], [0.35, 0.55]]
    assert one.ladder([20, 60])[0][0].value == 9.0
    for slope, wanted in zip(one.slopes(20.0), (0.01, 0.02), strict=True):
        assert slope == pytest.approx((wanted, wanted, wanted))


UNTUNED_PAGE = PAGE.replace("tune = true\n", "").replace('set = { "lane_change.rule" = "LC2013" }\nvary', "# vary")


def test_critical_gap_is_found_from_what_was_rejected_and_accepted(tmp_path: Path) -> None:
    """Up to .9 s is refused, once by a vehicle that took a lane without a follower; 1.1 s is the least taken."""
    pairs = [*((0.1 * k, 1.1 + 0.1 * k) for k in range(8)), (0.9, None)]
    lead: list[Any] = [(0.0, 0.4), (0.0, 50.0), (0.5, None)]
    runs = [run_of([1, 1, 1], [1, 1, 1], lag=half, lead=lead) for half in (pairs[:4], pairs[4:])]
    told = result(tmp_path, *runs, counts=GAPS, page=UNTUNED_PAGE).measures
    assert told["critical_lag_gap_mean_s"] == pytest.approx((1.0, 0.9, 1.1))
    assert told["critical_lag_gap_sd_s"].value == 0.0
    assert told["critical_lead_gap_mean_s"].value is None  # too few
    assert told["accepted_lead_gaps_below_0.5_s"].value == 1.0  # 50 s are no gap


def test_durations_are_those_of_changes_seen_from_start_to_end(tmp_path: Path) -> None:
    changes = [{"duration_s": seconds, "complete": seconds < 9.0} for seconds in (4.0, 5.0, 9.0)]
    runs = [{"lane_changes": one} for one in (changes, changes[:1], changes[:1])]
    page = read_public(page_in(tmp_path, page=UNTUNED_PAGE, road=ASKED))  # its counts publish flow and speed, too
    one = RoadResult(page.road[0], "a rule P(a|b)", "as set", {}, runs)
    assert one.measures["duration_mean_s"] == pytest.approx((17.0 / 4.0, 4.0, 4.5))  # draws of one run alone
    assert one.measures["duration_median_s"].value == 4.0
    lists: dict[str, Any] = {"tests": [one], "causes": [(one, one)], "tried": [], "best": {}, "within": WITHIN}
    told = text("public.md.j2", page=page, cell_m=250.0, cell_s=60.0, long_gap_s=10.0, **lists)
    assert r"| Somewhere | a rule P(a\|b) | as set | - | - | - |" in told  # one cell of Markdown
    assert not [words for words in ("I-80", "2.4 %", "Does the road have its flow") if words in told]
    ngsim = read_public(ROOT / "data" / "public" / "ngsim.toml").model_copy(update={"road": page.road})
    assert "- Lane 1 of I-80 " in text("public.md.j2", page=ngsim, cell_m=250.0, cell_s=60.0, long_gap_s=10.0, **lists)


def test_pages_of_the_project_are_read_and_ngsim_tunes_on_one_road_alone_and_its_counts_add_up() -> None:
    page, *others = (read_public(ROOT / "data" / "public" / f"{name}.toml") for name in ("ngsim", "knoop", "gaps"))
    assert [one.rule[2].name for one in (page, *others)] == ["paper"] * 3
    assert [site.told.name[:7] for site in page.road if site.tune] == ["US-101,"]
    assert [sum(site.told.vehicles) for site in page.road] == [2017, 2052, 2169, 1915]  # as the reports add up
    for site in page.road:
        assert sum(map(sum, site.told.start_to_end)) == sum(site.told.vehicles)


@pytest.mark.parametrize(
    ("page", "counts", "said"),
    [
        (PAGE.replace("tune = true", ""), COUNTS, "rule.vary, and no road with tune = true"),
        (PAGE.replace("road.toml", "asked.toml"), COUNTS, "asked.toml, on which no traffic enters by itself; expected"),
        (PAGE.replace("lc_speed_gain", "lc_sped_gain"), COUNTS, "lc_sped_gain"),
        ("densities = [9, 3]\n" + PAGE, COUNTS, "densities = [9.0, 3.0], expected borders that rise, two or more"),
        (PAGE.replace("seeds = 2", "seeds = 0"), COUNTS, "seeds = 0, expected at least 1"),
        (PAGE.replace("[cause]", '[[rule]]\nname = "LC2013"\n[cause]'), COUNTS, "expected another name for each rule"),
        (PAGE.replace('counts = "counts.toml"', 'counts = "none.toml"'), COUNTS, "none.toml: no such file"),
        (PAGE, COUNTS.replace("40.0, 20.0", "20.0"), "vehicles: 2 values on a road to tune on, expected one for each"),
        (PAGE, COUNTS.replace("speed_mps = 10.0", "speed_mps = -1.0"), "speed_mps = -1.0, expected at least 0"),
        (PAGE, COUNTS.replace("2, 0], [10", "2], [10"), "start_to_end: 3 rows, expected a row for each of from"),
        (PAGE, COUNTS.replace(", [5, 15, 0]", ""), "start_to_end: 2 rows, expected a row for each of from"),
        (PAGE, COUNTS.replace("speed_mps", "sped_mps"), "unknown key 'published.sped_mps'; expected flow_veh_per_h"),
    ],
)
def test_page_that_cannot_be_is_refused_in_one_line(tmp_path: Path, page: str, counts: str, said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        read_public(page_in(tmp_path, page=page, counts=counts))
    assert (said in str(caught.value), "\n" in str(caught.value)) == (True, False), str(caught.value)


def test_page_goes_on_after_a_kill_with_the_same_bytes_and_refuses_runs_that_are_none(
    tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """The whole is driven in processes of its own, the rest in this one."""
    same_as_test = '\n[[road]]\nfile = "road.toml"\ncounts = "counts.toml"\n'
    page = read_public(page_in(tmp_path, page=PAGE + same_as_test))
    whole = run_public(page, tmp_path / "whole", Options())
    request.getfixturevalue("here")

    def killed(*_: Any) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_public(page, tmp_path / "again", Options(), on_row=killed)
    continued = run_public(page, tmp_path / "again", Options(), on_row=None)
    assert (whole.runs, whole.failed) == (continued.runs, continued.failed)
    assert whole.failed == 0
    for one, other in zip(whole.files, continued.files, strict=True):
        assert one.read_bytes() == other.read_bytes(), one.name
    told = whole.files[0].read_text()
    causes = "| one speed |", "With one speed changes per vehicle come", "0.0 % trucks", "| 30 | 900, 900 | 400 | - |"
    for said in (*causes, "**Somewhere** (tuned on)", "LC2013, tuned", "LC2013, untuned", "tuned is nearer: "):
        assert said in told
    with pytest.raises(ConfigError, match=r"contents\.txt: 'page of public roads: A page', expected 'page of"):
        run_public(page.model_copy(update={"title": "Another"}), tmp_path / "whole", Options())
    next((tmp_path / "whole" / "runs").glob("*/run.json.gz")).unlink()
    assert run_public(page, tmp_path / "whole", Options()).files[0].read_text() == told  # made again
    (tmp_path / "run.json.gz").write_bytes(gzip.compress(b"[]", mtime=0))
    with pytest.raises(BatchError, match="not what a run of a page of public roads writes"):
        read_run(tmp_path, ("vehicles",), "page of public roads")
