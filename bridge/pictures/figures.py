"""What every picture shares: colours that colour-blind readers can tell apart, the map underneath, axes with units."""

import base64
import io
import itertools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as MplPath
from matplotlib.ticker import MaxNLocator

from bridge.files import beside
from bridge.recordings.recording import Recording
from hid2.agents import AV_ID, FOCAL_CATEGORY, VEHICLE_TYPES, FloatArray, Policy, Track
from hid2.measures.arrays import is_generated_id
from hid2.policy.behaviours import BEHAVIOURS
from netconvert.cells import build_cell_grid
from netconvert.errors import ConfigError
from netconvert.lane_graph import LaneGraph

#: Okabe and Ito's palette, without its yellow, which is too light on white.
BLACK, ORANGE, SKY, GREEN, BLUE, VERMILION, PURPLE = (
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#0072B2", "#D55E00", "#CC79A7",
)  # fmt: skip
GREY, LIGHT_GREY, DARK_GREY = "#8C8C8C", "#E4E4E4", "#4D4D4D"
RECORDED, GENERATED, COMBINED = GREY, VERMILION, BLUE
#: Ring round a vehicle that is asked for: unlike any policy.
HIGHLIGHT = "#E6007E"

#: Endings of pictures, and what their files must not say, so that the same picture gives the same bytes.
PICTURES: Mapping[str, dict[str, None] | None] = {
    ".png": {"Software": None},
    ".jpg": None,
    ".jpeg": None,
    ".pdf": {"CreationDate": None},
    ".svg": {"Date": None},
}

POLICY_COLORS = {
    Policy.STRAIGHT: VERMILION,
    Policy.LEFT_TURN: GREEN,
    Policy.RIGHT_TURN: PURPLE,
    Policy.LANE_CHANGE: BLUE,
    Policy.OVERTAKE: ORANGE,
}
#: Faces of agents by `kinds_in`; generated: of a behaviour of one's own, or unknown.
FACES: Mapping[str, str] = {
    "recorded": "#B4B4B4", "focal": DARK_GREY, "av": SKY, "other": "#B9A7C4", "generated": "#7A5C2E",
    **{policy.value: color for policy, color in POLICY_COLORS.items()},
}  # fmt: skip
#: Extent of a path above which what moves is shown, and ground shown around it, m.
MOVES_M, MARGIN_M = 5.0, 15.0
#: The map, by what is drawn of it.
MAP_COLORS: Mapping[str, str] = {
    "ground": "#F1F1EF", "kerb": "#C9C9C4", "bike": "#E3EEF4", "edge": "#BDBDB8", "centre": "#CFCFCA",
    "cell": "#A8C4D6", "crossing": "#DDD6C4",
}  # fmt: skip


class ShownFigure(Figure):
    """A figure that a notebook shows where it is the value of a cell, whatever pyplot draws with."""

    def _repr_png_(self) -> bytes:
        return _png(self)


def kinds_in(scenario: Recording) -> dict[str, str]:
    """What each track of a scene is to a picture, a key of FACES, by its id."""
    agents = scenario.sidecar.agents if scenario.sidecar is not None else ()
    policies = {agent.track_id: agent.policy for agent in agents}
    return {track.track_id: _kind_of(track, policies.get(track.track_id)) for track in scenario.tracks}


def _kind_of(track: Track, policy: Policy | None) -> str:
    if is_generated_id(track.track_id):
        return policy.value if policy in POLICY_COLORS else "generated"
    if track.track_id == AV_ID:
        return "av"
    if track.object_type not in VEHICLE_TYPES:
        return "other"
    return "focal" if track.category == FOCAL_CATEGORY else "recorded"


def kinds_in_words(word: str) -> dict[str, str]:
    """What each key of FACES is called in a legend; word: of the tracks that are not inserted."""
    return {
        "recorded": f"{word} vehicle", "focal": f"{word} focal vehicle", "av": "recording vehicle (AV)",
        "other": "other recorded agent", "generated": "generated vehicle",
        **{policy.value: f"generated: {one.label} ({one.short})" for policy, one in BEHAVIOURS.items()},
    }  # fmt: skip


def style() -> None:
    """Settings of every figure."""
    plt.rc("font", size=9)
    plt.rc("axes", titlesize=10, grid=False)
    plt.rc("axes.spines", top=False, right=False)
    plt.rc("legend", frameon=False)
    plt.rc("figure", dpi=100)
    plt.rc("savefig", dpi=130)
    plt.rc("svg", hashsalt="hid2")


def draw_map(axes: Axes, graph: LaneGraph, *, cells: bool = False) -> None:
    """The map from above, in city coordinates: drivable area, lane boundaries, centrelines, cells on request."""
    parts = shapely.get_parts(graph.drivable)
    areas = []
    for part in (part for part in parts if isinstance(part, shapely.Polygon) and not part.is_empty):
        rings = [MplPath(np.asarray(ring.coords), closed=True) for ring in (part.exterior, *part.interiors)]
        areas.append(PathPatch(MplPath.make_compound_path(*rings)))
    axes.add_collection(
        PatchCollection(areas, facecolor=MAP_COLORS["ground"], edgecolor=MAP_COLORS["kerb"], linewidth=0.6, zorder=0)
    )
    sides = [(lane, *lane.sides) for lane in graph.lanes.values()]
    bike = [np.concatenate([left, right[::-1]]) for lane, left, right in sides if lane.lane_type == "BIKE"]
    axes.add_collection(PolyCollection(bike, facecolor=MAP_COLORS["bike"], edgecolor="none", zorder=1))
    crossings = PolyCollection(graph.pedestrian_crossings, facecolor=MAP_COLORS["crossing"], alpha=0.5, zorder=1)
    axes.add_collection(crossings)
    edges = [line for _, *lines in sides for line in lines]
    axes.add_collection(LineCollection(edges, colors=MAP_COLORS["edge"], linewidths=0.5, zorder=2))
    centers = [lane.centerline for lane, *_ in sides if lane.lane_type != "BIKE"]
    axes.add_collection(
        LineCollection(centers, colors=MAP_COLORS["centre"], linewidths=0.5, linestyles=(0, (4, 4)), zorder=2)
    )
    if cells:
        rings = shapely.get_exterior_ring(shapely.get_parts(build_cell_grid(graph).polygons))
        outlines = [shapely.get_coordinates(ring) for ring in rings if not ring.is_empty]
        axes.add_collection(LineCollection(outlines, colors=MAP_COLORS["cell"], linewidths=0.35, zorder=2))


def moving_ground(scenario: Recording) -> tuple[FloatArray, FloatArray]:
    """Low and high corner of the ground around what moves and the focal track, (2,) m."""
    tracks = [track for track in scenario.tracks if np.ptp(track.position, axis=0).max() > MOVES_M]
    points = np.concatenate([track.position for track in (*tracks, scenario.track(scenario.focal_track_id))])
    return points.min(axis=0) - MARGIN_M, points.max(axis=0) + MARGIN_M


def frame(axes: Axes, low: FloatArray, high: FloatArray, *, aspect: float) -> None:
    """Show the ground from `low` to `high`, m, widened to an aspect, width over height, at the same scale both ways."""
    middle, half = (low + high) / 2, (high - low) / 2
    half = np.array([max(half[0], half[1] * aspect), max(half[1], half[0] / aspect)])
    axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
    axes.set_ylim(middle[1] - half[1], middle[1] + half[1])
    axes.set_aspect("equal")
    for axis in (axes.xaxis, axes.yaxis):  # whole metres: the labels are rounded to them
        axis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 5, 10], integer=True))
        axis.set_major_formatter("{x:.0f}")
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")


def label_offsets(axes: Axes, points: FloatArray, texts: Sequence[str], *, size: float) -> list[tuple[float, float]]:
    """Where the lower left corner of each text is from its point (N, 2), in points: in the axes, none over another.

    Axes must have been laid out; size: of the font.
    """
    (left, low), (right, top) = axes.bbox.get_points() * 72.0 / axes.figure.dpi
    inf, found = np.inf, []  # a text that the edge cuts would be another id
    taken = np.array([[-inf, -inf, left, inf], [right, -inf, inf, inf], [-inf, -inf, inf, low], [-inf, top, inf, inf]])
    for (x, y), text in zip(axes.transData.transform(points) * 72.0 / axes.figure.dpi, texts, strict=True):
        wide, high = 0.68 * size * max(map(len, text.split("\n"))), 1.25 * size * (text.count("\n") + 1)
        for far, ahead, above in itertools.product(np.arange(4.0, 200.0, 4.0), (True, False), (True, False)):
            dx, dy = far if ahead else -far - wide, far if above else -far - high
            box = np.array([x + dx, y + dy, x + dx + wide, y + dy + high])
            if not ((box[:2] < taken[:, 2:]) & (taken[:, :2] < box[2:])).all(axis=1).any():
                break
        taken = np.vstack([taken, box])
        found.append((dx, dy))
    return found


def check_ending(path: Path, endings: Iterable[str] = PICTURES) -> None:
    """Errors: ConfigError for a file with a name that does not end in one of `endings`."""
    if path.suffix.lower() not in endings:
        given = f"ending {path.suffix!r} is not supported" if path.suffix else "no ending"
        raise ConfigError(f"{path}: {given}; expected one of {', '.join(endings)}")


def save(figure: Figure, path: Path) -> None:
    """Write a figure in the format that the ending names, and close it: the same figure gives the same bytes.

    Errors: ConfigError for another ending than PICTURES, ExportError where it cannot be written.
    """
    try:
        check_ending(path)
        with beside(path) as hidden:
            figure.savefig(hidden, format=path.suffix[1:].lower(), metadata=PICTURES[path.suffix.lower()])
    finally:
        plt.close(figure)


def check_step(scenario: Recording, step: int | None) -> int:
    """A timestep to show, the last observed one for None. Errors: ConfigError for one that the scene does not have."""
    if step is None:
        return scenario.last_observed
    if not 0 <= step < scenario.num_steps:
        raise ConfigError(f"{scenario.folder}: timestep {step}, expected 0 to {scenario.num_steps - 1}")
    return step


def data_uri(figure: Figure) -> str:
    """A figure as a PNG inside a data: address; the figure is closed."""
    content = _png(figure)
    plt.close(figure)
    return "data:image/png;base64," + base64.b64encode(content).decode()


def _png(figure: Figure) -> bytes:
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png", dpi=110, bbox_inches="tight", metadata={"Software": None})
    return drawn.getvalue()
