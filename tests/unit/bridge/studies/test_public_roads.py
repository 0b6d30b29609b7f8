"""A page of public roads: figures by hand, what is tuned on, what is refused, and the same bytes after a kill."""

from pathlib import Path
from typing import Any

import pytest

from bridge.batch.batch import Options
from bridge.studies.public_roads import RoadResult, read_public, run_public
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
[[inflow]]
until_s = 60.0
veh_per_h = [900.0, 900.0]
on_ramp = 400.0
"""
COUNTS = """name = "Somewhere"
flow_veh_per_h = 2000.0
speed_mps = 10.0
vehicles = [40.0, 40.0]
changes_per_vehicle = [0.1, 0.3]
ramp_vehicles = 20.0
ramp_changes_per_vehicle = 1.5
all_changes_per_vehicle = 0.5
changes_per_veh_km = 1.0
start_to_end = [[38, 2, 0], [10, 30, 0], [5, 15, 0]]
"""
PAGE = """seeds = 2
[[road]]
file = "road.toml"
counts = "counts.toml"
tune = true
[[rule]]
name = "LC2013"
set = { "lane_change.rule" = "LC2013" }
vary = { "lane_change.lc_speed_gain" = [3.0] }
[[cause]]
says = "one speed"
set = { "drivers.desired_sd" = 0.0 }
[config.lane_change]
min_speed_mps = 0.0
safety = "rule"
"""


def page_in(tmp_path: Path, *, page: str = PAGE, counts: str = COUNTS, road: str = ROAD) -> Path:
    for name, text in (("page.toml", page), ("counts.toml", counts), ("road.toml", road)):
        (tmp_path / name).write_text(text)
    return tmp_path / "page.toml"


def run_of(vehicles: list[int], changes: list[int], **more: Any) -> dict[str, Any]:
    return {"vehicles": vehicles, "changes": changes, "veh_km": 10.0, "flow_veh_per_h": 2040.0, "speed_mps": 9.5} | more


def result(tmp_path: Path, *runs: dict[str, Any]) -> RoadResult:
    return RoadResult(read_public(page_in(tmp_path)).sites[0], "a rule", "untuned", {}, runs)


def test_figures_by_hand(tmp_path: Path) -> None:
    """Two seeds: 100 and 100 vehicles, 60 and 40 changes.

    By lane (10 + 10) / 80 = .25, (30 + 10) / 80 = .5, ramp (20 + 20) / 40 = 1.0; published .1, .3, 1.5 with 40, 40, 20
    vehicles: (40 x .15 + 40 x .2 + 20 x .5) / 100 = .24. All 100 / 200 = .5 as published; 100 changes in 20 km: 5.
    """
    one = result(tmp_path, run_of([40, 40, 20], [10, 30, 20]), run_of([40, 40, 20], [10, 10, 20]))
    assert [estimate.value for estimate in one.each] == [0.25, 0.5, 1.0]
    assert (one.every.value, one.per_veh_km.value) == (0.5, 5.0)
    assert (one.every.low, one.every.high) == (0.4, 0.6)  # draws of one seed alone
    assert one.error == pytest.approx(0.24)
    assert one.misses == pytest.approx(0.0)
    assert one.rank == pytest.approx(1.0)
    assert one.off == pytest.approx((0.02, -0.05))
    assert one.reproduces


@pytest.mark.parametrize("more", [{"flow_veh_per_h": 2061.0}, {"speed_mps": 8.9}])
def test_road_without_its_flow_or_its_speed_does_not_reproduce(tmp_path: Path, more: dict[str, float]) -> None:
    assert not result(tmp_path, run_of([40, 40, 20], [1, 1, 1], **more)).reproduces


def test_pages_of_the_project_are_read_and_tune_on_one_road_alone() -> None:
    page = read_public(ROOT / "data" / "public" / "ngsim.toml")
    assert [(site.counts.name[:4], site.tune) for site in page.sites] == [("US-1", True), ("I-80", False)]
    for site in page.sites:
        assert sum(site.counts.vehicles) + site.counts.ramp_vehicles in (2017, 2052)  # as the reports add up
        assert sum(map(sum, site.counts.start_to_end)) in (2017, 2052)


@pytest.mark.parametrize(
    ("page", "counts", "said"),
    [
        (PAGE.replace("tune = true", ""), COUNTS, "rule.vary, and no road with tune = true"),
        (PAGE.replace("lc_speed_gain", "lc_sped_gain"), COUNTS, "lc_sped_gain"),
        (PAGE.replace("seeds = 2", "seeds = 0"), COUNTS, "seeds = 0, expected at least 1"),
        (PAGE.replace('counts = "counts.toml"', 'counts = "none.toml"'), COUNTS, "none.toml: no such file"),
        (PAGE, COUNTS.replace("[40.0, 40.0]", "[40.0, 40.0, 40.0]"), "vehicles: 3 values, expected one for each of 2"),
        (PAGE, COUNTS.replace("speed_mps = 10.0", "speed_mps = 0.0"), "speed_mps = 0.0, expected greater than 0"),
    ],
)
def test_page_that_cannot_be_is_refused_in_one_line(tmp_path: Path, page: str, counts: str, said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        read_public(page_in(tmp_path, page=page, counts=counts))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_page_goes_on_after_a_kill_with_the_same_bytes_and_refuses_runs_that_are_none(tmp_path: Path) -> None:
    page = read_public(page_in(tmp_path))
    whole = run_public(page, tmp_path / "whole", Options())

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
    assert "**Somewhere** (tuned on)" in told
    assert "| one speed |" in told
    for run in (tmp_path / "whole" / "runs").iterdir():
        (run / "run.json.gz").unlink()
    assert run_public(page, tmp_path / "whole", Options()).files[0].read_text() == told  # made again
    import gzip

    (tmp_path / "run.json.gz").write_bytes(gzip.compress(b"[]", mtime=0))
    with pytest.raises(BatchError, match="not what a run of a page of public roads writes"):
        read_run(tmp_path, ("vehicles",), "page of public roads")
