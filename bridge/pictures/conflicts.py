"""Conflicts of a scene (`hid2.measures.conflicts`) as marks in a picture of your own."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from bridge.pictures import figures
from hid2.measures.conflicts import TrafficConflict

_MARKS = {"crossing": "P", "lane_change": "X", "rear_end": "v"}


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
