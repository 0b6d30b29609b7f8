"""A scene from above: recorded and generated vehicles, the focal one, trails and manoeuvres; picture, GIF or MP4."""

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import imageio.v2
import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import Collection, LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch
from matplotlib.patheffects import withStroke
from PIL import Image

from bridge.config import word_for_recorded
from bridge.files import beside, explained
from bridge.pictures import figures
from bridge.recordings.folders import Address
from bridge.recordings.scenario import AV_ID, FOCAL_CATEGORY, Scenario
from bridge.recordings.sidecar import ManeuverRecord, sidecar_in
from bridge.recordings.sources import read_recording
from hid2.agents import VEHICLE_TYPES, FloatArray, Policy, Track
from hid2.measures.arrays import is_generated_id
from hid2.measures.manoeuvres import ManeuverKind
from hid2.policy.behaviours import BEHAVIOURS, behaviour_seen
from netconvert.errors import ConfigError
from netconvert.geometry import box_corners

PICTURES = tuple(figures.PICTURES)
ANIMATIONS = (".gif", ".mp4")
#: Length of the trail behind each vehicle.
TRAIL_S = 2.0
#: Longest side of a GIF, pixels.
GIF_WIDTH = 1100
_GIF_COLORS = 128
#: Ground shown around what moves.
MARGIN_M = 15.0
#: Ground shown around one agent's path.
AGENT_MARGIN_M = 25.0
_OTHER = "#B9A7C4"
_RECORDED = "#B4B4B4"


class _Look(NamedTuple):
    face: str
    edge: str
    line_width: float
    order: int


@dataclass(frozen=True, eq=False, slots=True)
class _Panel:
    """What one half of the picture shows."""

    title: str
    scenario: Scenario
    tracks: tuple[Track, ...]
    looks: Mapping[str, _Look]
    maneuvers: tuple[tuple[str, ManeuverRecord], ...]


def render_scene(
    folder: Address,
    out_file: Path,
    *,
    source: Address | None = None,
    agent: str | None = None,
    cells: bool = False,
    step: int | None = None,
    on_frame: Callable[[int, int], None] | None = None,
) -> Path:
    """Draw a scene folder from above into a picture (.png, .jpg, .pdf, .svg) or a film (.gif, .mp4).

    A generated scene is shown before | after; before is the scene at `source` where given, whose sizes its recorded
    tracks then have on both sides, else its own recorded tracks. `agent` is highlighted and its surroundings shown.
    `step`: the timestep of a picture (default: the last observed one); a film shows all. on_frame(done, total) is
    called as the frames of a film are drawn.
    Errors: ScenarioError, MapError; ConfigError for an unknown ending, step or track; ExportError where the file cannot
    be written.
    """
    suffix = out_file.suffix.lower()
    figures.check_ending(out_file, PICTURES + ANIMATIONS)
    if step is not None and suffix in ANIMATIONS:
        raise ConfigError(f"{out_file}: a film shows every timestep; for one give a picture, {', '.join(PICTURES)}")
    scenario = read_recording(folder)
    shown = figures.check_step(scenario, step)
    panels = _panels(scenario, source)
    window = _window(scenario, agent)
    with explained(out_file):
        drawing = _Drawing(panels, window, agent=agent, cells=cells, whole_paths=suffix in PICTURES)
        if suffix in PICTURES:
            drawing.show(shown)
            figures.save(drawing.figure, out_file)
        else:
            with beside(out_file) as hidden:
                hidden.touch()  # what speaks against it is said before the film is drawn
                frames = drawing.frames(range(scenario.num_steps))
                _write_animation(_counted(frames, scenario.num_steps, on_frame), hidden, step_s=scenario.step_s)
            plt.close(drawing.figure)
    return out_file


def _counted(
    frames: Iterator[npt.NDArray[np.uint8]], total: int, on_frame: Callable[[int, int], None] | None
) -> Iterator[npt.NDArray[np.uint8]]:
    for number, frame in enumerate(frames, 1):
        if on_frame is not None:
            on_frame(number, total)
        yield frame


def scene_figure(folder: Address, *, source: Address | None = None, agent: str | None = None) -> Figure:
    """A scene folder, or the surroundings of one track in it, at its last observed step, before | after, as a figure.

    Errors: ScenarioError, MapError.
    """
    scenario = read_recording(folder)
    window = _window(scenario, agent)
    drawing = _Drawing(_panels(scenario, source), window, agent=agent, cells=False, whole_paths=True)
    drawing.show(figures.check_step(scenario, None))
    return drawing.figure


def draw_scene(
    axes: Axes, scenario: Scenario, *, step: int | None = None, agent: str | None = None, cells: bool = False
) -> None:
    """Draw a scene, recorded or generated, into axes of your own: map, vehicles in the colours of their policies, ids.

    step: a timestep (default: the last observed one). agent: a track to highlight, whose surroundings are shown. Axes
    are in metres from a round place nearby, at the same scale both ways; more ground is shown where the axes are wider
    or higher than the scene. Errors: ConfigError for an unknown step or track.
    """
    shown = figures.check_step(scenario, step)
    panel = _panels(scenario, None)[-1]
    low, high = _window(scenario, agent)
    figures.draw_map(axes, scenario.graph, cells=cells)
    _put(panel, axes, shown, agent=agent, whole_paths=True)
    room = axes.get_window_extent()
    figures.frame(axes, low, high, origin=np.floor(low / 100) * 100, aspect=room.width / room.height)


def _panels(scenario: Scenario, source: Address | None) -> list[_Panel]:
    sidecar = sidecar_in(scenario.folder, scenario.scenario_id)
    generated = {track.track_id for track in scenario.tracks if is_generated_id(track.track_id)}
    policies = {record.track_id: record.policy for record in sidecar.agents} if sidecar else {}
    maneuvers = tuple(
        (record.track_id, maneuver) for record in (sidecar.agents if sidecar else ()) for maneuver in record.maneuvers
    )
    looks = {track.track_id: _look(track, policies.get(track.track_id)) for track in scenario.tracks}
    recorded = tuple(track for track in scenario.tracks if track.track_id not in generated)
    name = scenario.scenario_id[:8]
    if not generated and source is None:
        return [_Panel(f"{name}: {len(recorded)} recorded agents", scenario, scenario.tracks, looks, ())]
    before = scenario if source is None else read_recording(source)
    origin = (
        "the recorded tracks of this scene, sizes by object type"
        if source is None
        else f"source scene {before.scenario_id[:8]}, with the sizes labelled there"
    )
    before_tracks = recorded if source is None else before.tracks
    known = {track.track_id: track.size for track in before_tracks}  # labelled sizes lie beside the source only
    before_looks = {track.track_id: _look(track, None) for track in before_tracks}
    word = word_for_recorded(scenario.scenario_id)
    after = _Panel(
        f"after: {len(recorded)} {word} agents + {len(generated)} generated vehicles\n(scene {name})",
        scenario,
        tuple(
            t if t.track_id in generated else replace(t, size=known.get(t.track_id, t.size)) for t in scenario.tracks
        ),
        looks,
        maneuvers,
    )
    if source is None and word != "recorded":  # what was recorded is not in it
        return [after]
    return [
        _Panel(f"before: {len(before_tracks)} recorded agents\n({origin})", before, before_tracks, before_looks, ()),
        after,
    ]


def _look(track: Track, policy: Policy | None) -> _Look:
    focal = track.category == FOCAL_CATEGORY
    edge, width = (figures.BLACK, 1.6) if focal else ("#333333", 0.4)
    if is_generated_id(track.track_id):
        face = figures.POLICY_COLORS[policy] if policy is not None else figures.GENERATED
        return _Look(face, edge, width, 6)
    if track.track_id == AV_ID:
        return _Look(figures.SKY, edge, width, 5)
    if track.object_type in VEHICLE_TYPES:
        return _Look(_RECORDED if not focal else figures.DARK_GREY, edge, width, 4)
    return _Look(_OTHER, edge, width, 3)


def _window(scenario: Scenario, agent: str | None) -> tuple[FloatArray, FloatArray]:
    """Ground to show, low and high corner, m: around one agent's path, else around what moves and the focal one."""
    if agent is not None:
        tracks, margin = [figures.find_track(scenario, agent)], AGENT_MARGIN_M
    else:
        tracks = [track for track in scenario.tracks if np.ptp(track.position, axis=0).max() > 5.0]
        tracks += [scenario.track(scenario.focal_track_id)]
        margin = MARGIN_M
    points = np.concatenate([track.position for track in tracks])
    return points.min(axis=0) - margin, points.max(axis=0) + margin


def _put(panel: _Panel, ax: Axes, step: int, *, agent: str | None, whole_paths: bool) -> list[Artist]:
    """Draw every vehicle where it is at a timestep; returns what was drawn, to be taken away again."""
    trail = round(TRAIL_S / panel.scenario.step_s)
    present = [(track, int(np.searchsorted(track.timesteps, step))) for track in panel.tracks]
    present = [(t, i) for t, i in present if i < len(t.timesteps) and t.timesteps[i] == step]
    present.sort(key=lambda item: panel.looks[item[0].track_id].order)
    looks = [panel.looks[track.track_id] for track, _ in present]
    boxes = [
        box_corners(t.position[i], t.heading[i], length_m=t.size.length_m, width_m=t.size.width_m) for t, i in present
    ]
    noses = [np.stack([t.position[i], box[:2].mean(axis=0)]) for (t, i), box in zip(present, boxes, strict=True)]
    trails = [t.position[max(0, i - trail) : i + 1] for t, i in present]
    artists: list[Collection] = []
    if whole_paths:
        paths = [t for t in panel.tracks if is_generated_id(t.track_id)]
        colors = [panel.looks[t.track_id].face for t in paths]
        artists.append(LineCollection([t.position for t in paths], colors=colors, linewidths=0.8, alpha=0.8, zorder=3))
    artists.append(LineCollection(trails, colors=[look.face for look in looks], linewidths=2.2, alpha=0.5, zorder=4))
    artists.append(
        PolyCollection(
            boxes,
            facecolors=[look.face for look in looks],
            edgecolors=[look.edge for look in looks],
            linewidths=[look.line_width for look in looks],
            zorder=5,
        )
    )
    artists.append(LineCollection(noses, colors="#222222", linewidths=0.6, zorder=6))
    for artist in artists:
        ax.add_collection(artist, autolim=False)
    labels = [part for track, row in present for part in _label(ax, track, row, agent)]
    return [*artists, *labels, *_marks(panel, ax, None if whole_paths else step * panel.scenario.step_s)]


def _label(ax: Axes, track: Track, row: int, agent: str | None) -> list[Artist]:
    """The id beside a generated or focal vehicle, or beside any where one is highlighted; a ring round that one."""
    artists: list[Artist] = []
    chosen = track.track_id == agent
    if chosen:
        ring = Circle(
            (track.position[row, 0], track.position[row, 1]), 0.75 * track.size.length_m + 1.0,
            fill=False, edgecolor=figures.HIGHLIGHT, linewidth=1.8, zorder=9,
        )  # fmt: skip
        artists.append(ax.add_patch(ring))
    if not (agent or is_generated_id(track.track_id) or track.category == FOCAL_CATEGORY):
        return artists
    text = ax.annotate(
        track.track_id, tuple(track.position[row]), xytext=(4, 4), textcoords="offset points", fontsize=6.5,
        fontweight="bold" if chosen else "normal", annotation_clip=True, clip_on=True, zorder=10,
        path_effects=[withStroke(linewidth=1.6, foreground="white")],
    )  # fmt: skip
    return [*artists, text]


def _marks(panel: _Panel, ax: Axes, until_s: float | None) -> list[Artist]:
    """Marks where manoeuvres were done or aborted, up to a time; None: all."""
    artists: list[Artist] = []
    tracks = {track.track_id: track for track in panel.tracks}
    for track_id, maneuver in panel.maneuvers:
        place = maneuver.crossing_s if maneuver.crossing_s is not None else maneuver.start_s
        if place is None or maneuver.status not in {"done", "aborted"} or track_id not in tracks:
            continue
        if until_s is not None and place > until_s:
            continue
        track = tracks[track_id]
        x, y = track.position[int(np.argmin(np.abs(track.timesteps * panel.scenario.step_s - place)))]
        done = maneuver.status == "done"
        behaviour = behaviour_seen(ManeuverKind(maneuver.kind))
        color = figures.POLICY_COLORS[behaviour.policy] if done else "black"
        size = 110 if maneuver.kind == "overtake" else 45
        artist = ax.scatter(
            [x], [y], marker=behaviour.mark if done else "x", s=size, c=color,
            edgecolors="black" if done else None, linewidths=0.8, zorder=8,
        )  # fmt: skip
        artists.append(artist)
    return artists


class _Drawing:
    """A figure whose map is drawn once and whose vehicles are drawn for each step, generated and focal ones with ids.

    agent: id of a track to highlight; then all have their ids. whole_paths: the generated vehicles' whole paths are
    drawn thinly, and all manoeuvres marked whatever the step.
    """

    def __init__(
        self,
        panels: Sequence[_Panel],
        window: tuple[FloatArray, FloatArray],
        *,
        agent: str | None,
        cells: bool,
        whole_paths: bool,
    ) -> None:
        self.whole_paths, self.agent = whole_paths, agent
        figures.style()
        low, high = window
        span = high - low
        aspect = float(np.clip(span[0] / span[1], 0.6, 2.2))
        width = 7.0 if len(panels) > 1 else 9.0
        height = float(np.clip(width / aspect, 4.0, 9.0))
        self.figure, axes = plt.subplots(
            1, len(panels), figsize=(width * len(panels), height + 1.3), squeeze=False, layout="constrained"
        )
        self.canvas: Any = FigureCanvasAgg(self.figure)
        self.panels = list(zip(panels, axes[0], strict=True))
        for panel, ax in self.panels:
            figures.draw_map(ax, panel.scenario.graph, cells=cells)
            figures.frame(ax, low, high, origin=np.floor(low / 100) * 100, aspect=aspect)
            ax.set_title(panel.title)
        self.legend()
        self.clock = self.figure.suptitle("0.0 s", x=0.01, ha="left", fontsize=11, fontweight="bold")
        self.moving: list[tuple[Axes, Artist]] = []

    def legend(self) -> None:
        """What the colours and marks mean, for those that appear."""
        panel = self.panels[-1][0]
        faces = {look.face for look in panel.looks.values()}
        word = word_for_recorded(panel.scenario.scenario_id)
        names = [(f"{word} vehicle", _RECORDED), (f"{word} focal vehicle", figures.DARK_GREY)]
        names += [("recording vehicle (AV)", figures.SKY), ("other recorded agent", _OTHER)]
        names += [
            (f"generated: {BEHAVIOURS[policy].label} ({BEHAVIOURS[policy].short})", color)
            for policy, color in figures.POLICY_COLORS.items()
        ]
        handles: list[Patch | Line2D] = [
            Patch(facecolor=color, edgecolor="#333333", linewidth=0.4, label=name)
            for name, color in names
            if color in faces
        ]
        handles.append(Patch(facecolor="none", edgecolor="black", linewidth=1.6, label="focal track: black edge"))
        if self.agent is not None:
            handles.append(
                Line2D([], [], marker="o", color="none", markersize=11, markeredgecolor=figures.HIGHLIGHT,
                       markeredgewidth=1.8, label=f"track {self.agent}")
            )  # fmt: skip
        for kind in dict.fromkeys(maneuver.kind for _, maneuver in panel.maneuvers if maneuver.status == "done"):
            behaviour = behaviour_seen(ManeuverKind(kind))
            color = figures.POLICY_COLORS[behaviour.policy]
            handles.append(
                Line2D([], [], marker=behaviour.mark, color="none", markerfacecolor=color, markeredgecolor="black",
                       label=f"{behaviour.label} here")
            )  # fmt: skip
        if any(maneuver.status == "aborted" for _, maneuver in panel.maneuvers):
            handles.append(Line2D([], [], marker="x", color="none", markeredgecolor="black", label="aborted here"))
        handles.append(
            Line2D([], [], color=figures.DARK_GREY, linewidth=1.6, alpha=0.5, label=f"path of the last {TRAIL_S:.0f} s")
        )
        if self.whole_paths and any(is_generated_id(track.track_id) for track in panel.tracks):
            handles.append(
                Line2D([], [], color=figures.DARK_GREY, linewidth=0.8, alpha=0.8, label="whole path, generated")
            )
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

    def frames(self, steps: Sequence[int]) -> Iterator[npt.NDArray[np.uint8]]:
        """(H, W, 3) pictures, H and W even; the map is drawn once and kept."""
        self.show(steps[0])
        for _, artist in self.moving:
            artist.set_visible(False)
        self.clock.set_visible(False)
        self.canvas.draw()
        self.figure.set_layout_engine("none")
        background = self.canvas.copy_from_bbox(self.figure.bbox)
        self.clock.set_visible(True)
        renderer = self.canvas.get_renderer()
        for step in steps:
            self.show(step)
            self.canvas.restore_region(background)
            for ax, artist in sorted(self.moving, key=lambda item: item[1].get_zorder()):
                ax.draw_artist(artist)
            self.clock.draw(renderer)
            picture = np.asarray(self.canvas.buffer_rgba())[..., :3]
            yield picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2].copy()


def _write_animation(frames: Iterator[npt.NDArray[np.uint8]], path: Path, *, step_s: float) -> None:
    """A frame for each step, in real time."""
    if path.suffix.lower() == ".gif":
        _write_gif(frames, path, step_s=step_s)
        return
    writer: Any = imageio.v2.get_writer(path, fps=1.0 / step_s, codec="libx264", quality=7, macro_block_size=2)
    with contextlib.closing(writer):  # as a context, it would leave ffmpeg running after an error
        for picture in frames:
            writer.append_data(picture)


def _write_gif(frames: Iterator[npt.NDArray[np.uint8]], path: Path, *, step_s: float) -> None:
    """All frames share one palette, at a reduced size: a tenth of the bytes of one palette a frame.

    It is that of the first frame, with the colours that tell vehicles apart, which cover too little ground to be kept.
    """
    pictures: list[Image.Image] = []
    kept = [*figures.POLICY_COLORS.values(), figures.SKY, figures.DARK_GREY, _RECORDED, _OTHER]
    own = [int(color[k : k + 2], 16) for color in kept for k in (1, 3, 5)]
    shared: Image.Image | None = None
    for picture in frames:
        image = Image.fromarray(picture)
        image.thumbnail((GIF_WIDTH, GIF_WIDTH), Image.Resampling.LANCZOS)
        if shared is None:
            first = image.quantize(_GIF_COLORS - len(kept)).getpalette() or []
            shared = Image.new("P", (1, 1))
            shared.putpalette(first + own)
        pictures.append(image.quantize(palette=shared, dither=Image.Dither.NONE))
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=round(1000 * step_s), loop=0, disposal=1)
