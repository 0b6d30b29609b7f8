"""The evaluation of folders: figures, tables and the report."""

import csv
import json
import re
import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recordings import LOG_ID, make_log
from written import edit_json, edit_rows, made_up_sidecar

import bridge.evaluation.totals as totals_module
from bridge.evaluation.evaluate import evaluate_folder, write_report
from bridge.evaluation.scene_metrics import measure, measure_folder
from bridge.evaluation.totals import Evaluation, SourceSums, Totals, estimate
from bridge.generation.generate import prepare
from bridge.recordings.folders import Choices
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sidecar import EventRecord
from bridge.recordings.sources import find_recordings, find_scenarios
from hid2.agents import VEHICLE_TYPES
from hid2.evaluation import metrics
from hid2.evaluation.metrics import METRICS, ROWS, Column, Metric
from hid2.evaluation.realism import RECORDED
from hid2.params import Config
from netconvert.errors import MapError, ScenarioError


@pytest.fixture(scope="module")
def report(made_root, data_root, tmp_path_factory):
    """The evaluation of the made scenes, of which every one is told, and its folder."""
    folder, told = tmp_path_factory.mktemp("report"), []
    evaluation = evaluate_folder(
        made_root, report_dir=folder, source=[data_root], on_scene=lambda done, total: told.append((done, total))
    )
    assert told == [(number, 4) for number in (1, 2, 3, 4)], "two scenes and their sources"
    return evaluation, folder


def read_csv(path):
    with path.open() as stream:
        return list(csv.DictReader(stream))


def test_report_has_every_file_with_a_row_for_every_scene_track_and_maneuver(report, made_root):
    evaluation, folder = report
    tables = ("conflicts", "events", "lane_changes", "maneuvers", "realism", "scenes", "tracks")
    expected = {"metrics.json", "report.html", *(f"{name}.csv" for name in tables)}
    assert {path.name for path in folder.iterdir()} == expected
    assert json.loads((folder / "metrics.json").read_text()) == evaluation.metrics
    scenarios = [read_scenario(path) for path in find_scenarios(made_root)]
    assert len(read_csv(folder / "scenes.csv")) == len(scenarios)
    tracks = read_csv(folder / "tracks.csv")
    assert len(tracks) == sum(len(scenario.tracks) for scenario in scenarios)
    assert {row["group"] for row in tracks} == {"original", "generated"}
    recorded = [row for row in read_csv(folder / "maneuvers.csv") if row["recorded"] == "True"]
    requested = evaluation.metrics["requests"]["maneuvers"]
    statuses = ("done", "aborted", "not_feasible", "not_triggered")
    assert len(recorded) == sum(entry[status] for entry in requested.values() for status in statuses)
    done = [row for row in recorded if row["status"] == "done"]
    assert done
    assert all(row["seen"] for row in done), "what was done is seen in the positions"


def test_vehicles_of_events_count_among_those_asked_for(data_root):
    scene = read_scenario(find_scenarios(data_root)[0])
    missed = EventRecord(kind="cross", target="av", status="not_feasible", reason="event_no_place", tries=0)
    sidecar = made_up_sidecar(scene, Config(), events=(missed,) * 3)
    assert measure(scene, scene.tracks, sidecar).scene["requested"] == 3


def test_maneuvers_tell_how_far_from_the_focal_track_and_the_recording_vehicle_they_are(report, made_root):
    """By the tracks, at the step of the crossing, else of the start; nothing of those that were not done."""
    scenes = {path.name: read_scenario(path) for path in find_scenarios(made_root)}
    rows = read_csv(report[1] / "maneuvers.csv")
    counted = Counter()
    for row in rows:
        scene = scenes[row["scenario_id"]]
        is_done = row["status"] == "done" or row["recorded"] == "False"
        for column, name in (("focal_m", scene.focal_track_id), ("av_m", "AV")):
            counted[column, is_done, row[column] != ""] += 1
            if row[column]:
                step = round(float(row["crossing_s"] or row["start_s"] or row["seen_crossing_s"]) * 10)
                own, other = (
                    next(t.position[t.timesteps == step][0] for t in scene.tracks if t.track_id == track_id)
                    for track_id in (row["track_id"], name)
                )
                assert float(row[column]) == pytest.approx(np.hypot(*(own - other)), rel=1e-5)
    assert min(counted["focal_m", True, True], counted["av_m", True, True], counted["focal_m", False, False]) > 0
    assert not any(counted[column, False, True] for column in ("focal_m", "av_m"))


def test_groups_are_kept_apart_also_at_the_end_of_the_scene(report):
    """Combined is the mean of the other two, weighted by tracks, and generated vehicles are clean.

    At the end vehicles and scenes are counted by group; the table of tracks tells the same vehicles.
    """
    evaluation, folder = report
    rows, ends = read_csv(folder / "scenes.csv"), read_csv(folder / "tracks.csv")
    kinematics = evaluation.metrics["kinematics"]["paper"]["lo"]
    tracks = {
        group: sum(int(row[f"{group}_paper_tracks"]) for row in rows) for group in ("original", "generated", "combined")
    }
    assert tracks["combined"] == tracks["original"] + tracks["generated"]
    both = sum(kinematics[group]["value"] * tracks[group] for group in ("original", "generated"))
    assert kinematics["combined"]["value"] == pytest.approx(both / tracks["combined"])
    assert evaluation.metrics["safety"]["scr"]["generated"]["value"] == 0.0
    assert evaluation.metrics["safety"]["footprint_orr"]["generated"]["value"] == 0.0
    for group in ("original", "generated"):
        counted = [int(row[f"{group}_end_ttc_critical"]) for row in rows]
        low = [row for row in ends if row["group"] == group and row["end_ttc_s"] and float(row["end_ttc_s"]) < 1.0]
        assert sum(counted) == len(low)
        shown = evaluation.metrics["safety"]["end_ttc_critical"][group]["value"]
        assert shown == pytest.approx(sum(counted) / sum(int(row[f"{group}_meeting"]) for row in rows))
        shares = evaluation.metrics["safety"]["end_scenes_critical"][group]["value"]
        assert shares == pytest.approx(sum(number > 0 for number in counted) / len(rows))
    assert all(int(row["generated_meeting"]) == int(row["generated"]) for row in rows)
    assert "after the last step" in (folder / "report.html").read_text()


def test_before_is_the_sources_of_what_is_measured_and_after_holds_what_was_added(report, data_root):
    """Three scenes lie below the source's root, two were made denser: the third is not before, whatever its density."""
    evaluation, folder = report
    diversity = evaluation.metrics["diversity"]
    density = diversity["density"]["tracks"]
    rows = read_csv(folder / "scenes.csv")
    sources = {row["source"] for row in rows}
    assert len(sources) == 2 < len(find_scenarios(data_root))
    numbers = Counter(len(read_scenario(path).tracks) for path in find_scenarios(data_root) if path.name in sources)
    assert density["before"] == {str(number): numbers[number] for number in sorted(numbers)}
    assert density["mean_before"] < density["mean_after"]
    assert diversity["scenes"] == {"before": 2, "after": 2}
    assert "2 source scenes" in (folder / "report.html").read_text()
    assert sum(int(number) * scenes for number, scenes in density["after"].items()) == sum(
        int(row["tracks"]) for row in rows
    )
    assert all(int(row["generated"]) > 0 for row in rows)


def test_report_stands_alone_and_leads_to_a_definition_of_every_number(report):
    """The name of the row or the head of its column does; left out: shares of scenes by density, and the net."""
    text = (report[1] / "report.html").read_text()
    assert not re.search(r'(src|href)="(?!data:|#)', text)
    words = "SCR ORR TTC PET Words Jensen-Shannon floor generated original combined m/s²"
    for word in words.split():
        assert word in text
    assert "Of 2 scenes made from 2 recorded ones" in text
    assert text.count("data:image/png;base64,") == 2
    anchors = re.findall(r'id="([^"]+)"', text)
    assert len(anchors) == len(set(anchors))
    assert set(re.findall(r'href="#([^"]+)"', text)) <= set(anchors)
    sections = re.findall(r'<section id="([^"]+)"><h2>', text)
    assert sections == re.findall(r'href="#([^"]+)"', text.split("</nav>")[0])
    assert sections[:3] == ["glance", "encounters", "realism"]
    for key in (*sections[:3], "safety", "motion", "requests"):
        section = text.split(f'<section id="{key}">')[1].split("</section>")[0]
        for table in re.findall(r"<table>.*?</table>", section, re.S):
            head, *rows = re.findall(r"<tr.*?</tr>", table, re.S)
            lacking = [row for row in rows if "href" not in row and "href" not in head]
            assert not lacking, (key, lacking[0])


def test_selection_is_told_as_the_sidecars_tell_it(report, made_root):
    """Sums over the two scenes, and the share that was kept in the report; a sidecar of an older version has none."""
    evaluation, folder = report
    told, wanted = (evaluation.metrics["requests"][name] for name in ("selection", "wanted"))
    first, second = sidecars = [json.loads(path.read_text()) for path in made_root.rglob("hid2_*.json")]
    assert wanted == {one: (share + second["wanted"][one]) / 2 for one, share in first["wanted"].items()}
    for group in ("kept", "dropped", "recorded"):
        for name in ("vehicles", "braking", "standing", "steps", "limited"):
            assert told[group][name] == sum(sidecar["selection"][group][name] for sidecar in sidecars)
    kept, dropped = told["kept"]["vehicles"], told["dropped"]["vehicles"]
    assert kept == sum(len(sidecar["agents"]) for sidecar in sidecars)
    assert dropped == sum(len(sidecar["replaced"]) for sidecar in sidecars)
    text = (folder / "report.html").read_text()
    assert f"stands at some time {wanted['stands']:.2f}.</p>" in text
    assert f"of {kept + dropped} vehicles that were driven {kept} were kept" in text


@pytest.fixture
def no_critics(monkeypatch):
    """Realism is not judged, which takes half of the time of an evaluation."""
    monkeypatch.setattr("hid2.evaluation.critics.find_spec", lambda _: None)


@pytest.mark.usefixtures("no_critics")
def test_result_does_not_depend_on_jobs(report, made_root, data_root, tmp_path):
    evaluation, folder = report
    other = evaluate_folder(made_root, report_dir=tmp_path, source=[data_root], jobs=2)
    for name in ("conflicts", "lane_changes", "maneuvers", "scenes", "tracks"):
        assert (tmp_path / f"{name}.csv").read_bytes() == (folder / f"{name}.csv").read_bytes(), name
    ours, theirs = (json.loads((place / "metrics.json").read_text()) for place in (tmp_path, folder))
    assert ours["realism"].pop("critics") != theirs["realism"].pop("critics")
    assert ours == theirs
    looked_at = [repr(one.totals.samples.windows().tolist()) for one in (evaluation, other)]  # by the critics
    assert looked_at[0] == looked_at[1]


@pytest.mark.usefixtures("no_critics")
def test_recorded_scenes_alone_are_evaluated_and_their_maps_read_as_those_of_a_source_are(copy_scene, tmp_path):
    """What generate refuses is left out here too, with the same words, and the other scenes are measured.

    A recorded track with an id as inserted ones have is none of these; nothing is inserted beside it.
    """
    spoilt, named = copy_scene("curve"), copy_scene("arterial")
    edit_rows(
        named, lambda rows: rows.replace({"track_id": {rows.track_id[rows.object_category == 1].iloc[0]: "gen_0"}})
    )
    with pytest.raises(ScenarioError, match=f"{named.name}: track 'gen_0': .*; rename the track"):
        prepare(read_scenario(named), Config())
    edit_json(next(spoilt.glob("log_map_archive_*.json")), lambda document: document["drivable_areas"].clear())
    with pytest.raises(MapError, match="no drivable area, expected at least one") as refused:
        read_scenario(spoilt)
    evaluation = evaluate_folder(spoilt.parent, report_dir=tmp_path / "report")
    assert evaluation.failures == [(spoilt, str(refused.value))]
    assert (evaluation.metrics["scenes"]["scenes"], evaluation.metrics["scenes"]["generated_vehicles"]) == (1, 0)
    assert evaluation.metrics["kinematics"]["paper"]["lo"]["generated"]["value"] is None
    events = (tmp_path / "report" / "events.csv").read_text()
    assert events.startswith("scenario_id,folder,kind,target,status,reason,")
    assert "At a glance" not in (tmp_path / "report" / "report.html").read_text()


def test_recorded_driving_is_that_among_recorded_vehicles(made_scene: Path, data_scenes: dict[str, Path]) -> None:
    """Without its source a generated scene tells of recorded vehicles what the source does."""
    alone, apart, with_source = (
        measure_folder(data_scenes["arterial"]), measure_folder(made_scene),
        measure_folder(made_scene, {data_scenes["arterial"].name}),
    )  # fmt: skip
    np.testing.assert_array_equal(apart.realism.counts[RECORDED:], alone.realism.counts[RECORDED:])
    np.testing.assert_array_equal(apart.realism.counts[:RECORDED], with_source.realism.counts[:RECORDED])
    assert (with_source.realism.counts[RECORDED:] != alone.realism.counts[RECORDED:]).any()
    recorded = apart.windows[~apart.windows["generated"]]
    assert (len(recorded), len(apart.windows)) == (len(alone.windows), len(with_source.windows))
    np.testing.assert_array_equal(recorded["gap_m"], alone.windows["gap_m"])


@pytest.mark.usefixtures("no_critics")
def test_what_is_there_of_recorded_and_generated_scenes_is_measured(
    made_scene, data_scenes, copy_scene, tmp_path, caplog
):
    """A scene made of one whose source is not there, a recorded one, and one that cannot be read."""
    broken = copy_scene("curve")
    root = copy_scene(folder=made_scene).parents[1]
    shutil.copytree(data_scenes["intersection"], root / "val" / "recorded")
    next(broken.glob("scenario_*.parquet")).write_bytes(b"no parquet")
    evaluation = evaluate_folder(root, report_dir=tmp_path / "report", source=[data_scenes["intersection"]])
    assert [path for path, _ in evaluation.failures] == [broken]
    assert "not a parquet file" in (tmp_path / "report" / "report.html").read_text()
    rows = read_csv(tmp_path / "report" / "scenes.csv")
    scenes = evaluation.metrics["scenes"]
    assert (len(rows), scenes["scenes"], scenes["generated_scenes"]) == (2, 2, 1)
    assert [row["seed"] != "" for row in rows].count(True) == 1
    assert evaluation.metrics["diversity"]["scenes"] == {"before": 2, "after": 2}
    assert "source scenes are not there" in caplog.text


def test_scenes_of_which_none_can_be_read_are_explained(copy_scene, tmp_path):
    scene = copy_scene("curve")
    next(scene.glob("scenario_*.parquet")).write_bytes(b"no parquet")
    with pytest.raises(ScenarioError, match=r"none of 1 scenes can be read, expected one at least; \S+: not a parquet"):
        evaluate_folder(scene, report_dir=tmp_path / "report")
    assert not (tmp_path / "report").exists()


def test_pooled_ratio_is_of_sums_and_the_interval_holds_it():
    """Sources with 1, 3 and 2 of 10: 6 of 30, not the mean over anything else; three sources give 0.1 to 0.3."""
    columns = ("log", "original_paper_lo", "original_paper_tracks")
    each = (("a", 1.0, 10), ("b", 2.0, 5), ("b", 1.0, 5), ("c", 2.0, 10))
    rows = [dict(zip(columns, row, strict=True)) for row in each]
    found = estimate(SourceSums(rows, names=columns[1:]), METRICS[0], "original")
    assert found == pytest.approx((0.2, 0.1, 0.3))


def test_windows_of_one_log_are_one_recording(data_scenes, tmp_path):
    """Two that share 90 of 110 sweeps: drawn together, and in one fold of the critics."""
    log, totals = make_log(data_scenes["intersection"], tmp_path), Totals()
    for window in find_recordings([log], Choices(stride=20)):
        totals.add(measure_folder(window))
    assert {*totals.samples.windows()["scene"]} == {LOG_ID}
    assert totals.sums.of_columns("original_rows")[0].size == 1
    assert [totals.content()["scenes"][name] for name in ("scenes", "sources")] == [2, 1]


def test_a_scene_in_which_nothing_moves_is_measured(made_scene):
    """No vehicle to compare: no windows."""
    scenario = read_scenario(made_scene)
    parked = [
        replace(track, position=np.repeat(track.position[:1], len(track.timesteps), axis=0))
        for track in scenario.tracks[:3]
    ]
    measures = measure(scenario, parked, None)
    assert measures.windows.shape == (0,)
    assert measures.scene["combined_moving"] == 0


@pytest.mark.usefixtures("no_critics")
def test_a_metric_that_is_added_is_measured_pooled_and_shown(made_scene, tmp_path, monkeypatch):
    """Share of vehicle rows in the left half-plane: an entry of METRICS, and nothing else; files' words are escaped."""
    extra = Metric(
        "left_half", "share of rows with x < 0", "share", "safety", "Rows of vehicles west of the origin.",
        Column("left_half", lambda group: int((group.arrays.position[group.rows][:, 0] < 0).sum())), ROWS,
    )  # fmt: skip
    for where in (metrics, totals_module):
        monkeypatch.setattr(where, "METRICS", (*METRICS, extra))
    totals = Totals()
    totals.add(measure_folder(made_scene))
    tracks = [track for track in read_scenario(made_scene).tracks if track.object_type in VEHICLE_TYPES]
    x = np.concatenate([track.position[:, 0] for track in tracks])
    content = totals.content()
    assert content["safety"]["left_half"]["combined"]["value"] == pytest.approx((x < 0).mean())
    content["scenes"]["failed"] = [{"folder": "a<b>", "reason": "<script>"}]
    write_report(Evaluation(totals, [], content), tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text()
    assert "share of rows with x &lt; 0" in text
    assert extra.sentence in text
    assert "<li>a&lt;b&gt;: &lt;script&gt;</li>" in text
