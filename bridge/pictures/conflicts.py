"""Agents that touch or come close in a scene, as values, and as marks in a picture of your own."""

from collections.abc import Iterator, Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from bridge.pictures import figures
from bridge.recordings.scenario import Scenario
from hid2.agents import FloatArray
from hid2.evaluation.safety import overlaps
from hid2.measures.arrays import SceneArrays, is_generated_id, stack
from hid2.measures.following import leaders
from hid2.measures.lane_matching import flatten_lanes, match_lanes
from hid2.measures.post_encroachment import encroachments
from hid2.params import Conflict as Critical

_CRITICAL = Critical()


class ConflictKind(StrEnum):
    """How two agents conflict: boxes that overlap, paths that cross, a leader that is closed in on."""

    CONTACT = "contact"
    CROSSING = "crossing"
    CLOSING_IN = "closing_in"


class Conflict(NamedTuple):
    """Two agents of a scene that touch or come close.

    first, second: track ids; of CLOSING_IN the follower and its leader. time_s: when it begins, or is worst. position
    (2,), m, city frame: between the two. value: the largest IoU of a CONTACT, the PET of a CROSSING, s, the smallest
    TTC of CLOSING_IN, s.
    """

    kind: ConflictKind
    first: str
    second: str
    time_s: float
    position: FloatArray
    value: float

    @property
    def text(self) -> str:
        """The conflict in a few words."""
        measure = {
            ConflictKind.CONTACT: f"IoU {self.value:.2f}",
            ConflictKind.CROSSING: f"PET {self.value:.1f} s",
            ConflictKind.CLOSING_IN: f"TTC {self.value:.1f} s",
        }[self.kind]
        return f"{self.first}, {self.second}: {measure} at {self.time_s:.1f} s"


def find_conflicts(
    scenario: Scenario,
    *,
    agent: str | None = None,
    pet_s: float = _CRITICAL.pet_min_s,
    ttc_s: float = _CRITICAL.ttc_min_s,
) -> list[Conflict]:
    """Contacts, crossings with a PET below pet_s, and leaders closed in on with a TTC below ttc_s, in order of time.

    All with all, recorded or generated, one entry a pair and kind; boxes of any type may touch, crossings
    and TTC are of moving vehicles. agent: only conflicts of this track.
    Errors: ConfigError for a track that the scene does not have.
    """
    if agent is not None:
        figures.find_track(scenario, agent)
    arrays = stack(scenario.tracks, num_steps=scenario.num_steps, step_s=scenario.step_s)
    found = [*_contacts(arrays), *_crossings(arrays, pet_s), *_closing_in(arrays, scenario, ttc_s)]
    wanted = [conflict for conflict in found if agent is None or agent in (conflict.first, conflict.second)]
    return sorted(wanted, key=lambda one: (one.time_s, one.kind, one.first, one.second))


def draw_conflicts(axes: Axes, conflicts: Sequence[Conflict]) -> None:
    """Mark conflicts where they are, each with its text, in axes that `draw_scene` has drawn into."""
    points = np.array([conflict.position for conflict in conflicts]).reshape(-1, 2)
    offsets = figures.label_offsets(axes, points, [conflict.text for conflict in conflicts], size=7.5)
    for conflict, offset in zip(conflicts, offsets, strict=True):
        x, y = conflict.position.tolist()
        axes.plot(
            [x], [y], marker=_MARKS[conflict.kind], markersize=12, color=figures.HIGHLIGHT, markeredgecolor="black",
            linestyle="none", zorder=11,
        )  # fmt: skip
        axes.annotate(
            conflict.text, (x, y), xytext=offset, textcoords="offset points", fontsize=7.5, zorder=12, clip_on=True,
            annotation_clip=True, path_effects=[withStroke(linewidth=2.0, foreground="white")],
        )  # fmt: skip


_MARKS = {ConflictKind.CONTACT: "X", ConflictKind.CROSSING: "P", ConflictKind.CLOSING_IN: "v"}


def _contacts(arrays: SceneArrays) -> Iterator[Conflict]:
    for pair in overlaps(arrays):
        rows = arrays.row_of[[pair.first, pair.second], pair.first_step]
        yield _conflict(arrays, ConflictKind.CONTACT, int(rows[0]), int(rows[1]), pair.iou)


def _crossings(arrays: SceneArrays, pet_s: float) -> Iterator[Conflict]:
    """Each at the place where the two come nearest, so many steps after one another."""
    for crossing in encroachments(arrays, cap_s=pet_s):
        if crossing.pet_s >= pet_s:
            continue
        one, other = (np.arange(arrays.first[a], arrays.first[a + 1]) for a in (crossing.first, crossing.second))
        apart = np.abs(arrays.step[one][:, None] - arrays.step[other]) == round(crossing.pet_s / arrays.step_s)
        distance = np.linalg.norm(arrays.position[one][:, None] - arrays.position[other], axis=-1)
        i, j = np.unravel_index(np.argmin(np.where(apart, distance, np.inf)), distance.shape)
        yield _conflict(arrays, ConflictKind.CROSSING, int(one[i]), int(other[j]), crossing.pet_s)


def _closing_in(arrays: SceneArrays, scenario: Scenario, ttc_s: float) -> Iterator[Conflict]:
    lanes = flatten_lanes(scenario.graph)
    matches = match_lanes(arrays, lanes)
    ahead = leaders(arrays, lanes, matches)
    rows = np.flatnonzero((ahead.ttc_s < ttc_s) & arrays.moving[arrays.agent])
    rows = rows[np.argsort(ahead.ttc_s[rows], kind="stable")]
    _, worst = np.unique(np.column_stack([arrays.agent[rows], ahead.agent[rows]]), axis=0, return_index=True)
    for row in rows[worst].tolist():
        leader_row = int(arrays.row_of[ahead.agent[row], arrays.step[row]])
        yield _conflict(arrays, ConflictKind.CLOSING_IN, row, leader_row, float(ahead.ttc_s[row]))


def _conflict(arrays: SceneArrays, kind: ConflictKind, row: int, other: int, value: float) -> Conflict:
    """Of two rows; at the earlier of their steps, between their positions."""
    first, second = (arrays.track_ids[arrays.agent[r]] for r in (row, other))
    if kind is not ConflictKind.CLOSING_IN and is_generated_id(second) and not is_generated_id(first):
        first, second = second, first
    time_s = float(min(arrays.step[row], arrays.step[other]) * arrays.step_s)
    return Conflict(kind, first, second, time_s, (arrays.position[row] + arrays.position[other]) / 2.0, value)
