"""A scene from above: recorded and generated vehicles, the focal one, trails and manoeuvres; picture, GIF or MP4."""

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import imageio.v2
import imageio_ffmpeg
import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import Collection, LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch
from matplotlib.patheffects import withStroke
from PIL import Image

from bridge.config import word_for_recorded
from bridge.files import beside
from bridge.pictures import figures
from bridge.recordings.recording import Recording
from bridge.recordings.sidecar import ManeuverRecord
from hid2.agents import DEFAULT_SIZES, FOCAL_CATEGORY, FloatArray, Track
from hid2.measures.arrays import is_generated_id
from hid2.measures.conflicts import TrafficConflict
from hid2.measures.manoeuvres import ManeuverKind
from hid2.policy.behaviours import behaviour_seen
from netconvert.errors import ConfigError, ExportError
from netconvert.geometry import box_corners

ANIMATIONS = (".gif", ".mp4")
#: Length of the trail behind each vehicle, s.
TRAIL_S = 2.0
#: Longest side of a GIF, pixels, where cars are large enough then.
GIF_WIDTH = 1100
_GIF_COLORS = 128
#: Least length of a car in a film, pixels, and most ground a side, m: a frame stays below 30 MB.
CAR_PIXELS = 14
MOST_GROUND_M = 400.0
_LABEL_SIZE = 6.5
#: Ground shown around one agent's path, m.
AGENT_MARGIN_M = 25.0

#: Marks of conflicts by their kind.
_MARKS = {"crossing": "P", "lane_change": "X", "rear_end": "v"}
#: Which agents are drawn above which; inserted ones above all.
_ORDER = {"other": 3, "recorded": 4, "focal": 4, "av": 5}


@dataclass(frozen=True, eq=False, slots=True)
class _Panel:
    """What one half of the picture shows; maneuvers: with the ids of their tracks."""

    title: str
    scenario: Recording
    tracks: tuple[Track, ...]
    kinds: Mapping[str, str]
    maneuvers: tuple[tuple[str, ManeuverRecord], ...]


def render_scene(
    scenario: Recording,
    out_file: Path,
    *,
    agent: str | None = None,
    cells: bool = False,
    step: int | None = None,
    on_frame: Callable[[int, int], None] | None = None,
) -> Path:
    """Draw a scene from above into a picture (.png, .jpg, .pdf, .svg) or a film (.gif, .mp4), before | after.

    `agent` is highlighted, with surroundings. `step`: of a picture (default: the last observed one); a film shows all.
    on_frame(done, total) is called as the frames of a film are drawn.
    Errors: ConfigError for an unknown ending, step or track; ExportError where the file cannot be written.
    """
    suffix = out_file.suffix.lower()
    figures.check_ending(out_file, (*figures.PICTURES, *ANIMATIONS))
    if suffix not in ANIMATIONS:
        figures.save(scene_figure(scenario, agent=agent, cells=cells, step=step), out_file)
        return out_file
    if step is not None:
        pictures = ", ".join(figures.PICTURES)
        raise ConfigError(f"{out_file}: a film shows every timestep; for one give a picture, {pictures}")
    drawing = _Drawing(scenario, agent=agent, cells=cells, whole_paths=False)
    with beside(out_file) as hidden:
        drawing.scale(longest=GIF_WIDTH if suffix == ".gif" else None)
        _write_animation(drawing.frames(range(scenario.num_steps), on_frame), hidden, step_s=scenario.step_s)
    return out_file


def scene_figure(
    scenario: Recording, *, agent: str | None = None, cells: bool = False, step: int | None = None
) -> Figure:
    """A picture as `render_scene` draws it, as a figure. Errors: ConfigError for an unknown step or track."""
    shown = figures.check_step(scenario, step)
    drawing = _Drawing(scenario, agent=agent, cells=cells, whole_paths=True)
    drawing.show(shown)
    return drawing.figure


def draw_scene(
    axes: Axes, scenario: Recording, *, step: int | None = None, agent: str | None = None, cells: bool = False
) -> None:
    """Draw a scene, recorded or generated, into axes of your own: map, vehicles in the colours of their policies, ids.

    step: a timestep (default: the last observed one). agent: a track to highlight with its surroundings. Axes are in
    city coordinates, m, at the same scale both ways. Errors: ConfigError for an unknown step or track.
    """
    shown, panel = figures.check_step(scenario, step), _panels(scenario)[-1]
    low, high = _window(scenario, agent)
    figures.draw_map(axes, scenario.graph, cells=cells)
    room = axes.get_window_extent()
    figures.frame(axes, low, high, aspect=room.width / room.height)
    _put(panel, axes, shown, agent=agent, whole_paths=True)


def draw_conflicts(axes: Axes, conflicts: Sequence[TrafficConflict]) -> None:
    """Mark conflicts where they are, each with its text, in axes that `draw_scene` has drawn into."""
    points = np.array([(conflict.x_m, conflict.y_m) for conflict in conflicts]).reshape(-1, 2)
    offsets = figures.label_offsets(axes, points, [conflict.text for conflict in conflicts], size=7.5)
    for conflict, offset in zip(conflicts, offsets, strict=True):
        axes.plot(
            [conflict.x_m], [conflict.y_m], marker=_MARKS[conflict.kind], markersize=12, color=figures.HIGHLIGHT,
            markeredgecolor="black", linestyle="none", zorder=11,
        )  # fmt: skip
        axes.annotate(
            conflict.text, (conflict.x_m, conflict.y_m), xytext=offset, textcoords="offset points", fontsize=7.5,
            zorder=12, clip_on=True, annotation_clip=True,
            path_effects=[withStroke(linewidth=2.0, foreground="white")],
        )  # fmt: skip


def _panels(scenario: Recording) -> list[_Panel]:
    """What is shown: one half for a recorded scene, before | after for a generated one."""
    agents = scenario.sidecar.agents if scenario.sidecar else ()
    maneuvers = tuple((record.track_id, maneuver) for record in agents for maneuver in record.maneuvers)
    recorded = tuple(track for track in scenario.tracks if not is_generated_id(track.track_id))
    generated = len(scenario.tracks) - len(recorded)
    name, word = scenario.scenario_id[:8], word_for_recorded(scenario.scenario_id)
    kinds = figures.kinds_in(scenario)
    if not generated:
        return [_Panel(f"{name}: {len(recorded)} {word} agents", scenario, recorded, kinds, ())]
    title = f"after: {len(recorded)} {word} agents + {generated} generated vehicles\n(scene {name})"
    after = _Panel(title, scenario, scenario.tracks, kinds, maneuvers)
    if word != "recorded":  # what was recorded is not in it
        return [after]
    title = f"before: {len(recorded)} recorded agents\n(the recorded tracks of this scene)"
    return [_Panel(title, scenario, recorded, kinds, ()), after]


def _window(scenario: Recording, agent: str | None) -> tuple[FloatArray, FloatArray]:
    """Ground to show, low and high corner, m: around one agent's path, else around what moves and the focal one."""
    if agent is None:
        return figures.moving_ground(scenario)
    path = scenario.track(agent).position
    return path.min(axis=0) - AGENT_MARGIN_M, path.max(axis=0) + AGENT_MARGIN_M


def _put(panel: _Panel, ax: Axes, step: int, *, agent: str | None, whole_paths: bool) -> list[Artist]:
    """Draw every vehicle where it is at a timestep; returns what was drawn, to be taken away again."""
    trail = round(TRAIL_S / panel.scenario.step_s)
    present = [(track, int(np.searchsorted(track.timesteps, step))) for track in panel.tracks]
    present = [(t, i) for t, i in present if i < len(t.timesteps) and t.timesteps[i] == step]
    present.sort(key=lambda item: _ORDER.get(panel.kinds[item[0].track_id], 6))
    focal = [track.category == FOCAL_CATEGORY for track, _ in present]
    boxes = [
        box_corners(t.position[i], t.heading[i], length_m=t.size.length_m, width_m=t.size.width_m) for t, i in present
    ]
    noses = [np.stack([t.position[i], box[:2].mean(axis=0)]) for (t, i), box in zip(present, boxes, strict=True)]
    trails = [t.position[max(0, i - trail) : i + 1] for t, i in present]
    faces = [figures.FACES[panel.kinds[track.track_id]] for track, _ in present]
    artists: list[Collection] = [
        LineCollection(trails, colors=faces, linewidths=2.2, alpha=0.5, zorder=4),
        PolyCollection(
            boxes,
            facecolors=faces,
            edgecolors=[figures.BLACK if is_focal else "#333333" for is_focal in focal],
            linewidths=[1.6 if is_focal else 0.4 for is_focal in focal],
            zorder=5,
        ),
        LineCollection(noses, colors="#222222", linewidths=0.6, zorder=6),
    ]
    if whole_paths:
        paths = [t for t in panel.tracks if is_generated_id(t.track_id)]
        colors = [figures.FACES[panel.kinds[t.track_id]] for t in paths]
        whole = LineCollection([t.position for t in paths], colors=colors, linewidths=0.8, alpha=0.8, zorder=3)
        artists.insert(0, whole)
    for artist in artists:
        ax.add_collection(artist, autolim=False)
    labels, until_s = _labels(ax, present, agent), None if whole_paths else step * panel.scenario.step_s
    return [*artists, *labels, *_marks(panel, ax, until_s)]


def _labels(ax: Axes, present: Sequence[tuple[Track, int]], agent: str | None) -> list[Artist]:
    """The id beside each generated and focal vehicle, and each in sight of one that is highlighted; a ring round it."""
    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    named = [
        (track, track.position[row])
        for track, row in present
        if (agent or is_generated_id(track.track_id) or track.category == FOCAL_CATEGORY)
        and left <= track.position[row, 0] <= right
        and low <= track.position[row, 1] <= high
    ]
    named.sort(key=lambda one: one[0].track_id != agent)  # which is labelled first, next to it
    ids, points = [track.track_id for track, _ in named], np.array([at for _, at in named]).reshape(-1, 2)
    artists: list[Artist] = []
    for (track, (x, y)), offset in zip(named, figures.label_offsets(ax, points, ids, size=_LABEL_SIZE), strict=True):
        chosen = track.track_id == agent
        if chosen:
            ring = {"edgecolor": figures.HIGHLIGHT, "linewidth": 1.8, "zorder": 9, "fill": False}
            artists.append(ax.add_patch(Circle((x, y), 0.75 * track.size.length_m + 1.0, **ring)))
        line = {"arrowstyle": "-", "lw": 0.4, "shrinkA": 0, "shrinkB": 0} if abs(offset[1]) > 4 * _LABEL_SIZE else None
        artists.append(ax.annotate(
            track.track_id, (x, y), xytext=offset, textcoords="offset points", fontsize=_LABEL_SIZE, arrowprops=line,
            fontweight="bold" if chosen else "normal", annotation_clip=True, clip_on=True, zorder=10,
            path_effects=[withStroke(linewidth=1.6, foreground="white")],
        ))  # fmt: skip
    return artists


def _marks(panel: _Panel, ax: Axes, until_s: float | None) -> list[Artist]:
    """Marks where manoeuvres were done or aborted, up to a time; None: all."""
    artists: list[Artist] = []
    tracks = {track.track_id: track for track in panel.tracks}
    for track_id, maneuver in panel.maneuvers:
        at_s = maneuver.crossing_s if maneuver.crossing_s is not None else maneuver.start_s
        if at_s is None or maneuver.status not in {"done", "aborted"} or track_id not in tracks:
            continue
        if until_s is not None and at_s > until_s:
            continue
        track = tracks[track_id]
        row = int(np.argmin(np.abs(track.timesteps * panel.scenario.step_s - at_s)))
        behaviour = behaviour_seen(ManeuverKind(maneuver.kind))
        look: dict[str, Any] = {"marker": "x", "c": "black"}
        if maneuver.status == "done":
            look = {"marker": behaviour.mark, "c": figures.POLICY_COLORS[behaviour.policy], "edgecolors": "black"}
        size = 110 if maneuver.kind == "overtake" else 45
        x, y = track.position[row]
        artists.append(ax.scatter([x], [y], s=size, linewidths=0.8, zorder=8, **look))
    return artists


class _Drawing:
    """A figure with its map drawn once and its vehicles for each step, generated and focal ones with ids.

    agent: a track to highlight; then all have their ids. whole_paths: and all manoeuvres, whatever the step.
    """

    def __init__(self, scenario: Recording, *, agent: str | None, cells: bool, whole_paths: bool) -> None:
        self.whole_paths, self.agent = whole_paths, agent
        panels = _panels(scenario)
        low, high = _window(scenario, agent)
        if not whole_paths:  # a film
            middle = np.clip(scenario.track(agent or scenario.focal_track_id).position.mean(axis=0), low, high)
            low = np.clip(middle - MOST_GROUND_M / 2, low, np.maximum(low, high - MOST_GROUND_M))
            high = np.minimum(high, low + MOST_GROUND_M)
        figures.style()
        span = high - low
        aspect = float(np.clip(span[0] / span[1], 0.6, 2.2))
        width = 7.0 if len(panels) > 1 else 9.0
        height = float(np.clip(width / aspect, 4.0, 9.0))
        self.figure = figures.ShownFigure(figsize=(width * len(panels), height + 1.3), layout="constrained")
        axes = self.figure.subplots(1, len(panels), squeeze=False)
        self.canvas: Any = FigureCanvasAgg(self.figure)
        self.panels = list(zip(panels, axes[0], strict=True))
        for panel, ax in self.panels:
            figures.draw_map(ax, panel.scenario.graph, cells=cells)
            figures.frame(ax, low, high, aspect=aspect)
            ax.set_title(panel.title)
        self.legend()
        self.clock = self.figure.suptitle("0.0 s", x=0.01, ha="left", fontsize=11, fontweight="bold")
        self.figure.draw_without_rendering()  # lays it out: where labels come depends on it
        self.moving: list[tuple[Axes, Artist]] = []

    def legend(self) -> None:
        """What the colours and marks mean, for those that appear."""
        panel = self.panels[-1][0]
        word = word_for_recorded(panel.scenario.scenario_id)
        handles: list[Patch | Line2D] = [
            Patch(facecolor=figures.FACES[kind], edgecolor="#333333", linewidth=0.4, label=says)
            for kind, says in figures.kinds_in_words(word).items()
            if kind in panel.kinds.values()
        ]
        handles.append(Patch(facecolor="none", edgecolor="black", linewidth=1.6, label="focal track: black edge"))

        def add(label: str, **look: Any) -> None:  # noqa: ANN401  # as Line2D has it
            handles.append(Line2D([], [], label=label, **look))

        if self.agent is not None:
            ring = {"markersize": 11, "markeredgecolor": figures.HIGHLIGHT, "markeredgewidth": 1.8}
            add(f"track {self.agent}", marker="o", color="none", **ring)
        for kind in dict.fromkeys(maneuver.kind for _, maneuver in panel.maneuvers if maneuver.status == "done"):
            seen = behaviour_seen(ManeuverKind(kind))
            look = {"markerfacecolor": figures.POLICY_COLORS[seen.policy], "markeredgecolor": "black"}
            add(f"{seen.label} here", marker=seen.mark, color="none", **look)
        if any(maneuver.status == "aborted" for _, maneuver in panel.maneuvers):
            add("aborted here", marker="x", color="none", markeredgecolor="black")
        add(f"path of the last {TRAIL_S:.0f} s", color=figures.DARK_GREY, linewidth=1.6, alpha=0.5)
        if self.whole_paths and any(is_generated_id(track.track_id) for track in panel.tracks):
            add("whole path, generated", color=figures.DARK_GREY, linewidth=0.8, alpha=0.8)
        self.figure.legend(handles=handles, loc="outside lower center", ncols=min(5, len(handles)), fontsize=8.5)

    def show(self, step: int) -> None:
        """Put every vehicle where it is at a timestep."""
        for _, artist in self.moving:
            artist.remove()
        self.moving = [
            (ax, artist)
            for panel, ax in self.panels
            for artist in _put(panel, ax, step, agent=self.agent, whole_paths=self.whole_paths)
        ]
        scenario = self.panels[0][0].scenario
        when = "observed" if step <= scenario.last_observed else "future"
        self.clock.set_text(f"{step * scenario.step_s:.1f} s  ({when})")

    def scale(self, *, longest: int | None) -> None:
        """Size of the frames: the longest side of so many pixels, or as drawn, but cars of CAR_PIXELS at least."""
        ax, dpi = self.panels[0][1], self.figure.dpi
        car = DEFAULT_SIZES["vehicle"].length_m * ax.get_window_extent().width / np.ptp(ax.get_xlim())
        usual = dpi if longest is None else longest / self.figure.get_size_inches().max()
        self.figure.set_dpi(max(usual, dpi * CAR_PIXELS / car))

    def frames(
        self, steps: Sequence[int], on_frame: Callable[[int, int], None] | None
    ) -> Iterator[npt.NDArray[np.uint8]]:
        """(H, W, 3) pictures, H and W even; the map is drawn once and kept."""
        self.clock.set_visible(False)
        self.canvas.draw()
        self.figure.set_layout_engine("none")
        background = self.canvas.copy_from_bbox(self.figure.bbox)
        self.clock.set_visible(True)
        renderer = self.canvas.get_renderer()
        for number, step in enumerate(steps, 1):
            self.show(step)
            self.canvas.restore_region(background)
            for ax, artist in sorted(self.moving, key=lambda item: item[1].get_zorder()):
                ax.draw_artist(artist)
            self.clock.draw(renderer)
            picture = np.asarray(self.canvas.buffer_rgba())[..., :3]
            if on_frame is not None:
                on_frame(number, len(steps))
            yield picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2].copy()


def _write_animation(frames: Iterator[npt.NDArray[np.uint8]], path: Path, *, step_s: float) -> None:
    """A frame for each step, in real time."""
    if path.suffix.lower() == ".gif":
        _write_gif(frames, path, step_s=step_s)
        return
    try:
        imageio_ffmpeg.get_ffmpeg_exe()
    except RuntimeError:  # its own was removed
        raise ExportError(
            f"found no program ffmpeg, which writes {path.suffix}: see INSTALL.md, or ask for .gif"
        ) from None
    writer: Any = imageio.v2.get_writer(path, fps=1.0 / step_s, codec="libx264", quality=7, macro_block_size=2)
    with contextlib.closing(writer):  # as a context, it would leave ffmpeg running after an error
        for picture in frames:
            writer.append_data(picture)


def _write_gif(frames: Iterator[npt.NDArray[np.uint8]], path: Path, *, step_s: float) -> None:
    """All frames share the palette of the first: a tenth of the bytes of one palette a frame."""
    pictures: list[Image.Image] = []
    palette: Image.Image | None = None
    for picture in frames:
        image = Image.fromarray(picture)
        palette = palette or palette_of(image, _GIF_COLORS)
        pictures.append(image.quantize(palette=palette, dither=Image.Dither.NONE))
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=round(1000 * step_s), loop=0, disposal=1)


def palette_of(picture: Image.Image, colors: int) -> Image.Image:
    """A palette of so many colours, for `quantize`: a picture's own, and those of vehicles, which are small."""
    faces = [*dict.fromkeys(figures.FACES.values())]
    own = np.array([to_rgb(color) for color in (*faces, figures.HIGHLIGHT, *faces)])
    own[-len(faces) :] = (own[-len(faces) :] + to_rgb(figures.MAP_COLORS["ground"])) / 2  # trails on the ground
    kept, palette = np.rint(255 * own).astype(int), Image.new("P", (1, 1))
    palette.putpalette((picture.quantize(colors - len(kept)).getpalette() or []) + kept.ravel().tolist())
    return palette
