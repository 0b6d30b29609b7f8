"""One agent over time: speed, acceleration, jerk, lateral offset and cells, with the moments of its manoeuvres."""

from collections.abc import Mapping
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bridge.pictures import figures
from bridge.recordings.judging import recording_states
from bridge.recordings.recording import Recording
from hid2.agents import FloatArray, Track
from hid2.evaluation.kinematics import motion
from hid2.measures.driven_lanes import LaneView, first_lane_offset
from hid2.measures.manoeuvres import Maneuver, ManeuverKind, detect
from hid2.params import Limits
from hid2.policy.behaviours import behaviour_seen
from netconvert.cells import build_cell_grid
from netconvert.geometry import arc_length

#: Distance of times on the plan, as a share of the path's extent.
_LABELS_APART = 0.08


#: Dash patterns of the four moments of a manoeuvre.
_STYLES: Mapping[str, Literal["dotted", "dashed", "solid", "dashdot"]] = {
    "trigger": "dotted", "start": "dashed", "crossing": "solid", "end": "dashdot",
}  # fmt: skip


def agent_figure(scenario: Recording, agent_id: str) -> Figure:
    """One track over time: where, how fast, how smoothly, in which lane and cell. Errors: ConfigError.

    Vertical lines are the trigger, start, crossing and end of its manoeuvres: the sidecar's, of recorded ones as seen.
    """
    track = scenario.track(agent_id)
    view = recording_states(scenario, [track])
    moments, note = _moments(scenario, agent_id, detect(view))
    time = np.asarray(track.timesteps * scenario.step_s, dtype=np.float64)
    figures.style()
    figure = figures.ShownFigure(figsize=(9.5, 11.5), layout="constrained")
    axes = figure.subplots(6, 1, height_ratios=[2.2, 1, 1, 1, 1, 1])
    _plan(axes[0], scenario, track, moments, time)
    limits, moved = Limits(), motion(view.arrays)
    axes[1].plot(time, moved.speed_mps, color=figures.BLUE)
    axes[1].set(ylabel="speed, m/s", ylim=(0, max(1.0, float(moved.speed_mps.max()) * 1.15)))
    accel = {"longitudinal": moved.accel_mps2, "lateral": moved.lateral_accel_mps2}
    _derivative(axes[2], time, accel, limits=(limits.accel_min_mps2, limits.accel_max_mps2), one_sided=2)
    axes[2].set_ylabel("acceleration,\nm/s²")
    jerk = {"longitudinal": moved.longitudinal_jerk_mps3, "magnitude (JE)": moved.jerk_mps3}
    most = limits.longitudinal_jerk_mps3
    _derivative(axes[3], time, jerk, limits=(-most, most), one_sided=3)
    axes[3].set_ylabel("jerk, m/s³")
    _offset(axes[4], time, view)
    _cells(axes[5], time, scenario, view)
    for ax in axes[1:]:
        ax.set_xlim(time[0] - 0.1, time[-1] + 0.1)
        ax.grid(visible=True, color=figures.LIGHT_GREY, linewidth=0.5)
        for what, time_s in moments:
            ax.axvline(time_s, color=figures.DARK_GREY, linestyle=_STYLES[what], linewidth=1.0)
    axes[5].set_xlabel(
        "time from timestep 0, s (acceleration and jerk: without the ends, where differences are one-sided)"
    )
    handles = [
        Line2D([], [], color=figures.DARK_GREY, linestyle=dashes, label=what)
        for what, dashes in _STYLES.items()
        if what in dict(moments)
    ]
    if handles:
        axes[1].legend(handles=handles, ncols=4, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    kind = f"{track.object_type}, {track.size.length_m:.1f} x {track.size.width_m:.1f} m"
    figure.suptitle(f"{scenario.scenario_id[:8]}, track {agent_id} ({kind}){note}", fontsize=11)
    return figure


def _moments(scenario: Recording, agent_id: str, seen: list[Maneuver]) -> tuple[list[tuple[str, float]], str]:
    """Moments to mark, each with its time, s, and what the title says of the manoeuvres."""
    said = scenario.sidecar
    record = next((agent for agent in said.agents if agent.track_id == agent_id), None) if said else None
    moments = [
        (what, time_s)
        for maneuver in (seen if record is None else record.maneuvers)
        for what in _STYLES
        if (time_s := getattr(maneuver, f"{what}_s", None)) is not None  # what is seen has no trigger
    ]
    if said is None or record is None:
        kinds = ", ".join(maneuver.kind.value.replace("_", " ") for maneuver in seen)
        return moments, f"\nseen: {kinds}" if kinds else "\nno manoeuvre seen"
    named = [
        f"{behaviour_seen(ManeuverKind(m.kind)).label} {m.status.replace('_', ' ')}{f' ({m.reason})' * bool(m.reason)}"
        for m in record.maneuvers
    ]
    named += [
        f"{one.kind.replace('_', ' ')} with {one.target_track_id} at {one.at_s:g} s"
        for one in said.events
        if one.track_id == agent_id
    ]
    return moments, f"\npolicy {record.policy.value.replace('_', ' ')}" + (": " + ", ".join(named) if named else "")


def _plan(ax: Axes, scenario: Recording, track: Track, moments: list[tuple[str, float]], time: FloatArray) -> None:
    figures.draw_map(ax, scenario.graph, cells=True)
    position, color = track.position, figures.FACES[figures.kinds_in(scenario)[track.track_id]]
    ax.plot(position[:, 0], position[:, 1], color=color, linewidth=1.6, zorder=5)
    seconds = np.flatnonzero(np.isclose(time % 1.0, 0.0, atol=1e-6) | np.isclose(time % 1.0, 1.0, atol=1e-6))
    ax.plot(*position[seconds].T, ".", color=figures.BLACK, markersize=4, zorder=6)
    apart_m = _LABELS_APART * float(np.ptp(position, axis=0).max() + 20.0)
    _, labelled = np.unique(np.floor(arc_length(position)[seconds] / apart_m), return_index=True)
    for row in seconds[labelled].tolist():  # one in each such stretch of the path
        ax.annotate(
            f"{time[row]:.0f} s", position[row], xytext=(3, 4), textcoords="offset points", fontsize=7, zorder=7
        )
    for row in [int(np.argmin(np.abs(time - time_s))) for what, time_s in moments if what == "crossing"]:
        ax.plot(*position[row], "D", color=figures.BLUE, markeredgecolor="black", markersize=7, zorder=8)
    figures.frame(ax, position.min(axis=0) - 10.0, position.max(axis=0) + 10.0, aspect=2.6)
    ax.set_title("position every second; diamond: crossing between lanes", fontsize=9)


def _derivative(
    ax: Axes, time: FloatArray, series: Mapping[str, FloatArray], *, limits: tuple[float, float], one_sided: int
) -> None:
    """Two series, dotted lines at the longitudinal limits, and room for whatever exceeds them.

    one_sided: first and last steps that are not shown, as differences jump there where the motion does not.
    """
    shown = [np.array(limits)]
    looks = ((figures.BLUE, "-"), (figures.VERMILION, "--"))
    for (name, values), (color, dashes) in zip(series.items(), looks, strict=True):
        inner = values.copy()
        inner[:one_sided] = inner[-one_sided:] = np.nan
        ax.plot(time, inner, color=color, label=name, linestyle=dashes)
        shown.append(inner[np.isfinite(inner)])
    for value, label in zip(limits, ("limit (longitudinal)", None), strict=True):
        ax.axhline(value, color=figures.GREY, linewidth=0.9, linestyle=":", label=label)
    every = np.concatenate(shown)
    low, high = float(every.min()), float(every.max())
    ax.set_ylim(low - 0.1 * (high - low), high + 0.3 * (high - low))
    ax.legend(loc="upper right", ncols=3, fontsize=8)


def _offset(ax: Axes, time: FloatArray, view: LaneView) -> None:
    offset = first_lane_offset(view)
    ax.set_ylabel("lateral offset, m\n(left is positive)")
    if np.isnan(offset).all():
        ax.text(0.5, 0.5, "never on a lane", transform=ax.transAxes, ha="center")
        return
    ax.plot(time, offset, color=figures.GREEN)
    ax.axhline(0.0, color=figures.GREY, linewidth=0.8)
    first = view.matches.lane[view.matches.lane >= 0][0]
    for sign, label in ((-1, "edge of the first lane"), (1, None)):
        ax.axhline(sign * view.lanes.half_width[first], color=figures.GREY, linewidth=0.8, linestyle=":", label=label)
    ax.legend(loc="upper right", fontsize=8)
    low, high = ax.get_ylim()
    low, high = min(low, -2.2), max(high, 2.2)
    ax.set_ylim(low, high + 0.25 * (high - low))


def _cells(ax: Axes, time: FloatArray, scenario: Recording, view: LaneView) -> None:
    """Cell index within its lane, in another colour where the lane changes, dashed once six are used."""
    grid = build_cell_grid(scenario.graph)
    colors = [figures.BLUE, figures.VERMILION, figures.GREEN, figures.PURPLE, figures.SKY, figures.ORANGE]
    number = len(colors)
    ax.set_prop_cycle(color=2 * colors, linestyle=["-"] * number + ["--"] * number)
    for rows in np.split(np.arange(len(time)), np.flatnonzero(np.diff(view.matches.lane)) + 1):
        lane = int(view.matches.lane[rows[0]])
        if lane < 0:
            continue
        lane_id = int(view.lanes.lane_ids[lane])
        index = [grid.cell_at(lane_id, float(s)).index for s in view.matches.s[rows]]
        # up to the next lane: one that is crossed in a single step shows too
        after = time[rows[-1] + 1] if rows[-1] + 1 < len(time) else time[rows[-1]]
        ax.step([*time[rows], after], [*index, index[-1]], where="post", label=str(lane_id))
    ax.set_ylabel("cell of the lane\n(legend: lane)")
    ax.set_ylim(bottom=-0.5)
    if ax.lines:  # the lanes in the order driven, row by row: matplotlib fills columns
        handles = [line for column in range(number) for line in ax.get_lines()[column::number]]
        ax.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=number, fontsize=7)
