"""Pictures of scenes: what is drawn is checked by colour in the pixels and by the words in the figure."""

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import imageio.v3 as iio
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from hand_drawn import draw_lane
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from PIL import Image

from bridge.pictures import figures, plot, render
from bridge.pictures.plot import agent_figure
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sidecar import EventRecord
from netconvert.errors import ConfigError, ExportError
from netconvert.lane_graph import LaneGraph


def pixels(path, color):
    """Number of pixels of a colour, give or take the smoothing of edges."""
    picture = iio.imread(path)[..., :3].astype(int)
    rgb = np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)])
    return int((np.abs(picture - rgb).max(axis=-1) < 8).sum())


def words(figure):
    return " | ".join(text.get_text() for text in figure.findobj(mpl.text.Text))


def longest_side(box):
    return float(np.hypot(*np.diff(box, axis=0).T).max())


def test_picture_of_a_generated_scene_shows_before_and_after_with_ids_and_a_legend(made_scene):
    scenario = read_scenario(made_scene)
    figure = render.scene_figure(scenario)
    titles = [ax.get_title().splitlines()[0] for ax in figure.axes]
    count = sum(track.track_id.startswith("gen_") for track in scenario.tracks)
    before = f"{len(scenario.tracks) - count} recorded agents"
    assert titles == [f"before: {before}", f"after: {before} + {count} generated vehicles"]
    for said in ("east, m", "north, m", "generated: lane change (LC)", "whole path, generated"):
        assert said in words(figure)
    shown = [text.get_text() for text in figure.axes[1].texts]
    there = [t.track_id for t in scenario.tracks if 49 in t.timesteps]
    assert sorted(shown) == sorted(name for name in there if name.startswith("gen_") or name == scenario.focal_track_id)
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "generated vehicle" not in legend  # the policy of each is known
    policies = {agent.policy for agent in scenario.sidecar.agents}
    assert sum(text.startswith("generated: ") for text in legend) == len(policies)
    plt.close(figure)


def test_generated_vehicles_are_drawn_in_the_colour_of_their_policy_and_one_close_up_with_a_ring(made_scene, tmp_path):
    """One car covers more pixels close up than the cars of its colour do on average in the whole scene."""
    scenario = read_scenario(made_scene)
    agents = scenario.sidecar.agents
    whole = render.render_scene(scenario, tmp_path / "a.png")
    for policy in {agent.policy for agent in agents}:
        assert pixels(whole, figures.POLICY_COLORS[policy]) > 30, policy
    assert pixels(whole, figures.HIGHLIGHT) == 0
    figure = render.scene_figure(scenario, agent=agents[0].track_id)
    assert f"track {agents[0].track_id}" in words(figure)
    assert sum(len(ax.patches) for ax in figure.axes) == 1
    figures.save(figure, tmp_path / "b.png")
    color = figures.POLICY_COLORS[agents[0].policy]
    alike = sum(other.policy is agents[0].policy for other in agents)
    assert pixels(tmp_path / "b.png", color) > pixels(whole, color) / alike
    assert pixels(tmp_path / "b.png", figures.HIGHLIGHT) > 100


def test_recorded_scene_is_one_panel_without_generated_colours_and_has_cells_on_request(data_scenes, tmp_path):
    scenario = read_scenario(data_scenes["curve"])
    figure = render.scene_figure(scenario)
    assert len(figure.axes) == 1
    assert "generated" not in words(figure)
    figures.save(figure, tmp_path / "a.png")
    assert pixels(tmp_path / "a.png", figures.VERMILION) == 0
    cells = render.render_scene(scenario, tmp_path / "b.png", cells=True)
    assert pixels(cells, "#A8C4D6") > pixels(tmp_path / "a.png", "#A8C4D6") + 200


def test_a_cell_in_which_the_boundaries_of_its_lane_cross_is_drawn():
    lane = draw_lane(5, [(0, 0), (20, 0)])
    left, right = (np.array([[0.0, side * 2.0], [16.0, side * 2.0], [20.0, -side * 8.0]]) for side in (1, -1))
    axes = Figure().add_subplot()
    figures.draw_map(axes, LaneGraph({5: replace(lane, left_boundary=left, right_boundary=right)}), cells=True)
    assert len(axes.collections[-1].get_paths()) == 6


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".svg", ".pdf"])
def test_same_scene_gives_the_same_picture(data_scenes, tmp_path, suffix):
    scenario = read_scenario(data_scenes["curve"])
    paths = [render.render_scene(scenario, tmp_path / f"{name}{suffix}") for name in ("a", "b")]
    assert paths[0].read_bytes() == paths[1].read_bytes()


@pytest.mark.parametrize("suffix", render.ANIMATIONS)
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # imageio leaves ffmpeg's pipes open
def test_animation_has_a_frame_for_every_step_and_moves_and_tells_its_progress(data_scenes, tmp_path, suffix):
    """Of a scene of ten steps."""
    scenario, told = replace(read_scenario(data_scenes["curve"]), num_steps=10), []
    path = tmp_path / f"scene{suffix}"
    render.render_scene(scenario, path, on_frame=lambda done, total: told.append((done, total)))
    frames = iio.imread(path)
    assert len(frames) == 10
    assert (frames[0] != frames[9]).any()
    assert told == [(number, 10) for number in range(1, 11)]
    if suffix == ".gif":
        with Image.open(path) as picture:
            assert picture.info["duration"] == 100


def test_labelled_sizes_of_the_source_are_drawn_before_and_after(made_scene, tmp_path):
    """A truck of 9.5 x 3.0 m is one in both halves: the sidecar keeps the sizes that lay beside the source."""
    scene = shutil.copytree(made_scene, tmp_path / made_scene.name)
    (path,) = scene.glob("hid2_*.json")
    content = json.loads(path.read_text())
    content["recording"]["sizes"]["AV"] = [9.5, 3.0]
    path.write_text(json.dumps(content))
    figure = render.scene_figure(read_scenario(scene))
    assert len(figure.axes) == 2
    for ax in figure.axes:
        boxes = [path.vertices for made in ax.findobj(PolyCollection) if made.zorder == 5 for path in made.get_paths()]
        assert [round(length, 2) for length in (longest_side(box) for box in boxes) if 9 < length < 10] == [9.5]
    plt.close(figure)


def test_step_beyond_the_scene_and_a_file_in_the_way_are_explained(data_scenes, tmp_path):
    scene = data_scenes["arterial"]
    with pytest.raises(ConfigError, match=r"timestep 110, expected 0 to 109"):
        render.render_scene(read_scenario(scene), tmp_path / "scene.png", step=110)
    (tmp_path / "file").write_text("")
    for suffix in (*figures.PICTURES, *render.ANIMATIONS):
        with pytest.raises(ExportError, match=rf"scene{suffix}: cannot be written \(File exists\)"):
            render.render_scene(read_scenario(scene), tmp_path / "file" / f"scene{suffix}")


def test_film_that_fails_half_way_leaves_nothing(data_scenes, tmp_path, monkeypatch):
    def fail(self, steps, on_frame):
        yield np.zeros((64, 64, 3), dtype=np.uint8)
        raise OSError("no more memory")

    monkeypatch.setattr("bridge.pictures.render._Drawing.frames", fail)
    with pytest.raises(ExportError, match="no more memory"):
        render.render_scene(read_scenario(data_scenes["arterial"]), tmp_path / "scene.mp4")
    assert list(tmp_path.iterdir()) == []


def boxes_of(figure, texts):
    figure.draw_without_rendering()
    return [text.get_window_extent() for text in texts if text.get_text()]


@pytest.mark.parametrize("count", [12, 40])
def test_labels_of_vehicles_that_stand_close_do_not_overlap_and_are_not_cut(count: int) -> None:
    """A queue at 3 m to .5 m before the edge, at 5 px/m: labels of 35 px would cover each other."""
    axes = Figure(figsize=(8, 4), dpi=100).add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, 160), ylim=(0, 80))
    points = np.column_stack([159.5 - 3.0 * np.arange(count)[::-1], np.full(count, 40.0)])
    names = [f"gen_{k}" for k in range(count)]
    offsets = figures.label_offsets(axes, points, names, size=6.5)
    texts = [
        axes.annotate(name, at, xytext=offset, textcoords="offset points", fontsize=6.5)
        for name, at, offset in zip(names, points, offsets, strict=True)
    ]
    boxes = boxes_of(axes.figure, texts)
    assert [k for k, one in enumerate(boxes) if any(one.overlaps(other) for other in boxes[:k])] == []
    assert all(axes.bbox.x0 <= box.x0 and box.x1 <= axes.bbox.x1 for box in boxes)
    assert offsets[0] == (4.0, 4.0)


@pytest.mark.parametrize("longest", [None, render.GIF_WIDTH])
def test_cars_of_a_film_are_never_below_fourteen_pixels(made_scene, data_scenes, longest) -> None:
    """Whatever the ground: of 300 m a film of 1100 px would show cars of 8 px."""
    for folder in (made_scene, data_scenes["curve"]):
        drawing = render._Drawing(read_scenario(folder), agent=None, cells=False, whole_paths=False)
        drawing.scale(longest=longest)
        axes = drawing.panels[0][1]
        assert 4.5 * axes.get_window_extent().width / np.ptp(axes.get_xlim()) > render.CAR_PIXELS - 0.1
        assert max(np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim())) < 2 * render.MOST_GROUND_M
        frame = next(drawing.frames([60], None))
        assert max(frame.shape) >= (longest or 0) - 2


def test_plot_has_every_quantity_with_its_unit_and_marks_the_moments_of_the_sidecar(made_scene, tmp_path):
    scene = read_scenario(made_scene)
    agent = next(a for a in scene.sidecar.agents if any(m.crossing_s for m in a.maneuvers))
    done = {"kind": "cut_in", "target": "av", "status": "done", "target_track_id": "AV", "at_s": 2.1, "tries": 1}
    event = EventRecord(**done, track_id=agent.track_id)
    figure = agent_figure(replace(scene, sidecar=scene.sidecar.model_copy(update={"events": (event,)})), agent.track_id)
    text = words(figure)
    assert figure.axes[0].lines[0].get_color() == figures.POLICY_COLORS[agent.policy]  # of its path
    units = ("speed, m/s", "acceleration,\nm/s²", "jerk, m/s³", "lateral offset, m", "cell of the lane")
    assert all(label in text for label in (*units, "trigger", "crossing", "cut in with AV at 2.1 s"))
    lines = {round(float(line.get_xdata()[0]), 6) for line in figure.axes[1].lines if len(set(line.get_xdata())) == 1}
    maneuver = next(m for m in agent.maneuvers if m.crossing_s)
    assert {round(t, 6) for t in (maneuver.trigger_s, maneuver.start_s, maneuver.crossing_s) if t is not None} <= lines
    figures.save(agent_figure(read_scenario(made_scene), "AV"), tmp_path / "deep" / "av.png")  # a recorded one
    assert iio.imread(tmp_path / "deep" / "av.png").shape[0] > 500


def test_legend_of_cells_has_lanes_in_the_order_driven_none_as_another(data_scenes):
    """Eight lanes in columns of six: 0 and 6, 1 and 7, 2 ..., read row by row 0 to 7; the seventh is dashed."""
    scenario, ax = read_scenario(data_scenes["intersection"]), Figure().subplots()
    lanes = np.array(list(scenario.graph.lanes))
    driven = SimpleNamespace(lane=np.repeat(np.arange(8), 2), s=np.zeros(16))
    plot._cells(
        ax, np.arange(16) / 10, scenario, SimpleNamespace(lanes=SimpleNamespace(lane_ids=lanes), matches=driven)
    )
    told = [text.get_text() for text in ax.get_legend().get_texts()]
    assert told == [str(lanes[k]) for k in (0, 6, 1, 7, 2, 3, 4, 5)]
    assert len({(line.get_color(), line.get_linestyle()) for line in ax.get_lines()}) == 8


def test_film_without_ffmpeg_is_an_error_that_says_where_to_look(data_scenes, tmp_path, monkeypatch):
    monkeypatch.setattr("imageio_ffmpeg._utils._get_ffmpeg_exe", lambda: None)  # its own removed, none installed
    monkeypatch.delenv("IMAGEIO_FFMPEG_EXE", raising=False)
    with pytest.raises(
        ExportError, match=r"found no program ffmpeg, which writes \.mp4: see INSTALL\.md, or ask for \.gif"
    ):
        render.render_scene(read_scenario(data_scenes["arterial"]), tmp_path / "scene.mp4")
    assert list(tmp_path.iterdir()) == []
