"""A scene that is held: the same whether it was generated, or read from where it was written; it shows itself."""

import dataclasses
import filecmp
import re
from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from browser import Page

from bridge.config import load_config
from bridge.evaluation.scene_metrics import evaluate_scene
from bridge.generation.generate import generate, prepare
from bridge.generation.scene import TrafficScene, read_scene
from bridge.recordings.sidecar import EventRecord
from hid2.policy.rules import GapView
from netconvert.errors import ConfigError, ExportError, ScenarioError

CHANGES = ["request.agents=6", "request.straight=0.3", "request.lane_change=0.7", "request.trigger_max_s=3"]


@pytest.fixture(scope="module")
def made(data_scenes: dict[str, Path]) -> TrafficScene:
    return generate(read_scene(data_scenes["arterial"]), load_config(None, [*CHANGES, "request.focal=generated"]))


@pytest.fixture(scope="module")
def written(made: TrafficScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made.write(tmp_path_factory.mktemp("out"), record=("gaps",))


def test_generated_scene_is_what_is_read_from_where_it_was_written(made: TrafficScene, written: Path) -> None:
    read = read_scene(str(written))
    assert type(read) is type(made)
    assert repr(read) == repr(made)
    for one in dataclasses.fields(made.recording):
        if one.name not in {"table", "tracks", "graph", "folder", "map_path"}:
            assert getattr(read.recording, one.name) == getattr(made.recording, one.name), one.name
    pd.testing.assert_frame_equal(read.tracks, made.tracks)
    pd.testing.assert_frame_equal(read.maneuvers, made.maneuvers)
    pd.testing.assert_frame_equal(read.judge(), made.judge())


def test_scene_that_was_read_is_written_as_the_same_bytes(written: Path, tmp_path: Path) -> None:
    again = read_scene(written).write(tmp_path)
    names = [path.name for path in written.iterdir() if not path.name.startswith("gaps_")]
    assert len(names) == 3
    assert filecmp.cmpfiles(written, again, names, shallow=False) == (names, [], [])


def test_gaps_are_written_of_a_scene_just_generated_alone_which_is_no_source(
    made: TrafficScene, written: Path, tmp_path: Path
) -> None:
    for scene, record in ((made, "gaps"), (made, ["looks"]), (read_scene(written), ["gaps"])):
        with pytest.raises(ConfigError, match="record = "):
            scene.write(tmp_path, record=record)
    assert not any(tmp_path.iterdir())
    with pytest.raises(ScenarioError, match="vehicles are inserted already"):
        prepare(made, load_config())


def test_prepared_scene_is_prepared_anew_for_another_grid(data_scenes: dict[str, Path]) -> None:
    scene, other = read_scene(data_scenes["curve"]), load_config(None, ["grid.cell_m=8", "request.agents=1"])
    made = generate(prepare(scene, load_config()), other)
    pd.testing.assert_frame_equal(made.tracks, generate(scene, other).tracks)


def test_recorded_scene_has_no_manoeuvres_and_is_not_written(data_scenes: dict[str, Path], tmp_path: Path) -> None:
    scene = read_scene(data_scenes["curve"])
    assert (scene.sidecar, scene.generated) == (None, ())
    assert len(scene.maneuvers) == len(scene.events) == len(scene.judge()) == 0
    with pytest.raises(ExportError, match="was recorded, nothing is inserted"):
        scene.write(tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_tables_are_in_city_coordinates_with_a_row_for_each_request_and_reprs_one_short_line(
    made: TrafficScene,
) -> None:
    own = made.generated[0]
    rows = made.tracks[made.tracks["track_id"] == own.track_id]
    assert np.array_equal(rows[["position_x", "position_y"]], own.position)
    assert len(made.maneuvers) == len(made.sidecar.asked) > 0
    lane_change = made.maneuvers.iloc[0]
    assert made.sidecar.agents[int(lane_change["track_id"][4:])].policy == lane_change["policy"]
    for one in (made, made.recording, made.sidecar, own):
        assert re.fullmatch(rf"{type(one).__name__}\([^\n]{{,150}}\)", repr(one)), repr(one)


def test_events_are_a_table_with_the_keys_of_the_sidecar(made: TrafficScene) -> None:
    done = EventRecord(kind="cut_in", target="focal", status="done", track_id="gen_0", gap_m=7.5, at_s=5.3, tries=1)
    missed = EventRecord(kind="cross", target="av", status="not_feasible", reason="event_no_place", tries=0)
    sidecar = made.sidecar.model_copy(update={"events": (done, missed)})
    table = TrafficScene(dataclasses.replace(made.recording, sidecar=sidecar)).events
    assert table["track_id"].isna().tolist() == [False, True]
    assert table.loc[0, ["gap_m", "at_s"]].tolist() == [7.5, 5.3]
    assert table.loc[1, "reason"] == "event_no_place"


def test_the_inserted_focal_track_does_its_manoeuvre_and_has_the_most_neighbours(made: TrafficScene) -> None:
    """Within 50 m, among the vehicles that live through the scene and have a manoeuvre that is done."""
    done = {agent.track_id for agent in made.sidecar.agents if any(m.status == "done" for m in agent.maneuvers)}
    there = [t.position[t.timesteps == 49][0] for t in (*made.source.tracks, *made.generated) if 49 in t.timesteps]
    counts = {
        track.track_id: int((np.hypot(*(np.array(there) - track.position[49]).T) <= 50.0).sum())
        for track in made.generated
        if len(track.timesteps) == 110 and track.track_id in done
    }
    assert counts[made.recording.focal_track_id] == max(counts.values())
    assert len(counts) > 1
    assert made.sidecar.placed.focal == "lane_change"
    assert [track.track_id for track in made.generated if track.category == 3] == [made.recording.focal_track_id]


def test_judge_tells_what_is_wrong_with_a_vehicle(made: TrafficScene) -> None:
    """A vehicle that is shifted by 40 m is off the road."""
    off = dataclasses.replace(made.generated[0], position=made.generated[0].position + 40.0)
    tracks = tuple(off if track.track_id == off.track_id else track for track in made.recording.tracks)
    found = TrafficScene(dataclasses.replace(made.recording, tracks=tracks)).judge()
    assert {"off_road"} <= set(found.loc[found["track_id"] == off.track_id, "quantity"])
    assert len(made.judge()) == 0


def test_pictures_are_figures_that_nobody_has_to_close(made: TrafficScene) -> None:
    figure, axes = plt.subplots()
    plots = [made.draw(), made.plot(made.generated[0].track_id), made.draw(axes, step=3)]
    assert plots[2] is figure
    assert plt.get_fignums() == [figure.number]
    assert [len(one.axes) for one in plots] == [2, 6, 1]
    assert plots[1]._repr_png_().startswith(b"\x89PNG")  # what a notebook shows
    plt.close(figure)


def test_notebook_shows_the_scene_as_the_viewer_does(page: Page, made: TrafficScene, tmp_path: Path) -> None:
    """The frame has the page that `view` writes; it runs, and knows what each look at a gap came to."""
    html = made._repr_html_()
    assert len(html) < 150_000
    (tmp_path / "cell.html").write_text(f"<!doctype html><title>cell</title>{html}")
    page.errors.clear(), page.requests.clear()
    page.size(1100, 700)
    page.open(tmp_path / "cell.html")
    page.js("globalThis.inner = document.querySelector('iframe').contentWindow.eval.bind(null), 0")
    page.until("document.querySelector('iframe').contentWindow.eval('now.scene && now.frames > 0')")
    inner = "document.querySelector('iframe').contentWindow.eval"
    assert page.js(f"{inner}('now.scene.id')") == made.recording.scenario_id
    looks = page.js(f"{inner}('Object.values(now.scene.looks).map((rows) => rows.length)')")
    assert sum(looks) == sum(len(one.driven.gaps) for one in made.vehicles) > 0
    assert page.errors == []
    assert [url for url in page.requests if not url.startswith(("file:", "data:", "about:"))] == []


def test_view_without_a_name_opens_a_browser(made: TrafficScene, tmp_path: Path, monkeypatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    path = made.view()
    assert opened == [path.as_uri()]
    assert path.read_text() == made.view(tmp_path / "named.html").read_text()
    assert len(opened) == 1


@pytest.mark.parametrize("function", [generate, prepare])
def test_a_path_instead_of_a_scene_is_told_in_one_line(function: Callable[..., object]) -> None:
    with pytest.raises(ConfigError, match=r"source 'data/av2': expected a scene, as read_scene\(path\) gives it"):
        function("data/av2", load_config())


# --- rules and metrics of a user's own --------------------------------------------------------------------------------


def takes_all(view: GapView) -> bool:
    return view.remaining_m > 0.0


def two_arguments(view: GapView, other: float) -> bool:
    return other > view.speed_mps


def raises(view: GapView) -> bool:
    return view.nothing


def says_maybe(view: GapView) -> str:
    return f"maybe {view.side}"


def test_rule_of_ones_own_is_a_function(data_scenes: dict[str, Path]) -> None:
    config = load_config(None, CHANGES, {"lane_change.rule": takes_all})
    assert config.lane_change.rule == f"{__name__}:takes_all"
    scene = generate(read_scene(data_scenes["arterial"]), config)
    assert not {*scene.maneuvers["reason"]} & {"front_gap", "rear_gap"}
    named = load_config(None, [], {"lane_change.rule": two_arguments, "lane_change.rule_with": "other=3"})
    assert named.lane_change.rule.endswith(":two_arguments")


@pytest.mark.parametrize(
    ("rule", "said"),
    [
        (two_arguments, r"TypeError: two_arguments\(\) missing 1 required positional argument: 'other'; expected a"),
        (raises, r"AttributeError: 'GapView' object has no attribute 'nothing'; expected a function of a GapView"),
        (says_maybe, r"it answered 'maybe left', expected True or False"),
        (lambda view: True, r"<lambda> is not found by its name in .*; expected a function at the top of a module"),
    ],
)
def test_rule_of_ones_own_is_tried_at_once(rule: object, said: str) -> None:
    with pytest.raises(ConfigError, match=rf"^lane_change\.rule.*{re.escape(__file__)}:\d+: {said}") as error:
        load_config(None, [], {"lane_change.rule": rule})
    assert "\n" not in str(error.value)


def test_metrics_of_a_scene_and_ones_own(made: TrafficScene) -> None:
    found = evaluate_scene(made, vehicles)
    counts = [
        sum(t.object_type in {"vehicle", "bus"} for t in tracks) for tracks in (made.source.tracks, made.generated)
    ]
    assert found.loc["vehicles", ["original", "generated", "combined"]].tolist() == [*counts, sum(counts)]
    assert found.loc["met_stands", "generated"] == 0.0
    with pytest.raises(ConfigError, match="metric 'vehicles': there is one of this name already"):
        evaluate_scene(made, vehicles, vehicles)


def vehicles(group) -> float:
    return group.vehicles.sum()


def nothing() -> float:
    return 0.0


@pytest.mark.parametrize(("metric", "said"), [(nothing, "TypeError"), (lambda group: "much", "ValueError")])
def test_metric_of_ones_own_is_told_in_one_line(made: TrafficScene, metric: object, said: str) -> None:
    with pytest.raises(ConfigError, match=rf"^metric .*{re.escape(__file__)}:\d+: {said}: .*; expected a") as error:
        evaluate_scene(made, metric)
    assert "\n" not in str(error.value)
