"""Every metric of the evaluation: its key, name, unit and sentence, and the function that measures it.

A metric is a ratio of two sums over one of the three groups of a scene; scenes are pooled by adding
numerators and denominators. To add one, add it to METRICS: tables, report and metrics.json follow.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from hid2.agents import FloatArray, Policy
from hid2.evaluation.kinematics import Kinematics
from hid2.evaluation.safety import Safety, colliding
from hid2.measures.arrays import STANDS_FOR_S, STANDS_MPS, BoolArray, SceneArrays
from hid2.measures.encounters import BRAKES_MPS2, FOLLOWS_FOR_S, FOLLOWS_S, NEAR_M, WITHIN_S, Partner
from hid2.measures.manoeuvres import Maneuver
from hid2.params import Conflict, Limits
from hid2.policy.behaviours import BEHAVIOURS, behaviour_seen

#: The three groups that are never mixed.
GROUPS = ("original", "generated", "combined")
#: Time gap to the leader below which it counts as short, s.
SHORT_GAP_S = 0.9
#: Bounds of critical TTC and PET: the defaults, whatever a scene was made with.
CRITICAL = Conflict()
#: Tables that metrics are shown in.
MetricTable = Literal["paper", "clean", "safety", "encounters"]


@dataclass(frozen=True, eq=False, slots=True)
class Group:
    """One group of the agents of a scene, with what was measured of the whole scene.

    members (A,); partners (A,): what a member may collide with; end_ttc_s (A,): from the last step to the first contact
    of those `meeting`, inf without; met: by name what each agent meets (A,).
    """

    arrays: SceneArrays
    kinematic: Kinematics
    safe: Safety
    members: BoolArray
    partners: BoolArray
    end_ttc_s: FloatArray
    met: Mapping[str, BoolArray]

    @property
    def vehicles(self) -> BoolArray:
        """(A,) members that are vehicles."""
        return np.asarray(self.members & self.arrays.vehicle)

    @property
    def tracks(self) -> BoolArray:
        """(A,) members of at least five steps, of every type: the paper's row."""
        return np.asarray(self.members & self.kinematic.counted)

    @property
    def clean_tracks(self) -> BoolArray:
        """(A,) those of `tracks` that are moving vehicles and no fragments."""
        return np.asarray(self.tracks & self.arrays.clean)

    @property
    def meeting(self) -> BoolArray:
        """(A,) members that may meet others, and with a last step that counts: see `driven`."""
        return np.asarray(self.members & driven(self.arrays))

    @property
    def rows(self) -> BoolArray:
        """(N,) rows of vehicles."""
        return np.asarray(self.vehicles[self.arrays.agent])

    @property
    def moving_rows(self) -> BoolArray:
        """(N,) rows of vehicles that move at some time."""
        return np.asarray((self.vehicles & self.arrays.moving)[self.arrays.agent])

    @property
    def colliding(self) -> int:
        """Vehicles among the partners that collide with another one."""
        hit = colliding(self.arrays, self.safe.overlaps)[:, self.partners].any(axis=1)
        return int((hit & self.partners & self.vehicles).sum())

    @property
    def critical_ends(self) -> int:
        """Vehicles that come to touch another agent too soon after their last step."""
        return int((self.end_ttc_s < CRITICAL.end_ttc_min_s).sum())


class Column(NamedTuple):
    """A sum over a group of a scene: a column of scenes.csv, behind the group's name."""

    name: str
    of: Callable[[Group], float]


class Metric(NamedTuple):
    """A ratio of two columns. label: its name; sentence: what it is, for the report."""

    key: str
    label: str
    unit: str
    section: MetricTable
    sentence: str
    numerator: Column
    denominator: Column


def driven(arrays: SceneArrays) -> BoolArray:
    """(A,) vehicles that are driven: all inserted ones, recorded ones that move and are no fragments."""
    return np.asarray(arrays.vehicle & (arrays.generated | arrays.clean))


TRACKS = Column("paper_tracks", lambda g: int(g.tracks.sum()))
CLEAN_TRACKS = Column("clean_tracks", lambda g: int(g.clean_tracks.sum()))
SCENES_WITH_VEHICLES = Column("scr_scenes", lambda g: int(g.vehicles.any()))
ROWS = Column("rows", lambda g: int(g.rows.sum()))
MOVING_ROWS = Column("moving_rows", lambda g: int(g.moving_rows.sum()))
FOLLOWING_ROWS = Column("following_rows", lambda g: int(np.isfinite(g.safe.leaders.time_gap_s[g.moving_rows]).sum()))
MEETING = Column("meeting", lambda g: int(g.meeting.sum()))
SCENES_WITH_ENDS = Column("end_scenes", lambda g: int(g.meeting.any()))


def _magnitude(key: Literal["lo", "la", "je"], label: str, unit: str, what: str) -> tuple[Metric, Metric]:
    """One of the paper's magnitudes: over every track, and over the clean ones."""
    name = label.partition(":")[0]
    return (
        Metric(
            key, label, unit, "paper",
            f"Magnitude of the {what}, from positions: mean over each track, then over tracks.",
            Column(f"paper_{key}", lambda g: float(getattr(g.kinematic, key)[g.tracks].sum())), TRACKS,
        ),
        Metric(
            f"clean_{key}", f"{name}, moving vehicles without fragments", unit, "clean",
            f"{name} of moving vehicles that are no tracker fragments.",
            Column(f"clean_{key}", lambda g: float(getattr(g.kinematic, key)[g.clean_tracks].sum())), CLEAN_TRACKS,
        ),
    )  # fmt: skip


def _steps(key: str, label: str, sentence: str, of: Callable[[Group], BoolArray], *, column: str = "") -> Metric:
    """Share of the steps of moving vehicles; column: where it has another name than the metric."""
    return Metric(
        key, label, "share", "safety", sentence,
        Column(column or key, lambda g: int((of(g) & g.moving_rows).sum())), MOVING_ROWS,
    )  # fmt: skip


def _met(name: str, label: str, sentence: str) -> Metric:
    """Share of vehicles with an encounter, by its name in `measures.encounters`."""
    column = Column(f"met_{name}", lambda g: int((g.met[name] & g.meeting).sum()))
    return Metric(f"met_{name}", label, "share", "encounters", sentence, column, MEETING)


def _followed(kind: Partner) -> tuple[Metric, Metric]:
    """What is measured of a kind of leader."""
    follows = f"Behind a vehicle ({kind}) at a time gap below {FOLLOWS_S:g} s for {FOLLOWS_FOR_S:g} s on end."
    brakes = f"Deceleration beyond {-BRAKES_MPS2:g} m/s² behind a near leader ({kind})."
    return (
        _met(f"follows_{kind}", f"follows a leader, {kind}", follows),
        _met(f"brakes_{kind}", f"brakes for a leader, {kind}", brakes),
    )


_TTC = f"TTC below {CRITICAL.ttc_min_s:g} s"
_END_TTC = f"TTC below {CRITICAL.end_ttc_min_s:g} s"
_TOLERANCE = f"{Limits().drivable_tolerance_m:g} m"

_MAGNITUDES = (
    _magnitude("lo", "LO: |longitudinal acceleration|", "m/s²", "acceleration along the heading"),
    _magnitude("la", "LA: |lateral acceleration|", "m/s²", "acceleration across the heading"),
    _magnitude("je", "JE: jerk", "m/s³", "derivative of the acceleration"),
)

METRICS: tuple[Metric, ...] = (
    *(paper for paper, _ in _MAGNITUDES),
    *(of_clean for _, of_clean in _MAGNITUDES),
    Metric(
        "scr", "SCR: share of vehicles that collide", "share", "safety",
        "Scenario collision rate: vehicles that overlap another one (boxes, IoU above 0.02) at any step, of the "
        "vehicles of a scene; mean over scenes.",
        Column("scr", lambda g: g.colliding / int(g.vehicles.sum()) if g.vehicles.any() else 0.0), SCENES_WITH_VEHICLES,
    ),
    Metric(
        "orr", "ORR: share of positions off the road", "share", "safety",
        "Off-road rate: positions of vehicles outside the drivable area of the map.",
        Column("off_road", lambda g: int(g.safe.off_road[g.rows].sum())), ROWS,
    ),
    Metric(
        "footprint_orr", f"footprint ORR: share of boxes over {_TOLERANCE} off", "share", "safety",
        f"Boxes of vehicles that reach more than {_TOLERANCE} out of the drivable area.",
        Column("off_footprint", lambda g: int(g.safe.off_footprint[g.rows].sum())), ROWS,
    ),
    _steps(
        "wrong_way", "share of driving against the lane",
        "Steps of moving vehicles at too large an angle to every lane below them, by the judge's limits.",
        lambda g: g.safe.against_lane, column="against_lane",
    ),
    _steps(
        "ttc_critical", f"share of driving, {_TTC} to anything",
        "Steps at which a moving vehicle would touch another agent so soon if both kept their velocity.",
        lambda g: g.safe.ttc_s < CRITICAL.ttc_min_s,
    ),
    _steps(
        "leader_ttc_critical", f"share of driving, {_TTC} to the leader",
        "Steps of moving vehicles that would reach the next vehicle on their lane path so soon.",
        lambda g: g.safe.leaders.ttc_s < CRITICAL.ttc_min_s,
    ),
    Metric(
        "short_gap", f"share of following, time gap below {SHORT_GAP_S:g} s", "share", "safety",
        "Steps behind a leader at a shorter time gap than drivers usually keep.",
        Column("short_gap", lambda g: int((g.safe.leaders.time_gap_s[g.moving_rows] < SHORT_GAP_S).sum())),
        FOLLOWING_ROWS,
    ),
    Metric(
        "end_ttc_critical", f"share of vehicles, {_END_TTC} after the last step", "share", "safety",
        "Vehicles that touch another agent so soon after their last step if all keep the velocity; recorded vehicles "
        "that move, every inserted one.",
        Column("end_ttc_critical", lambda g: g.critical_ends), MEETING,
    ),
    Metric(
        "end_scenes_critical", "share of scenes with such a vehicle", "share", "safety",
        f"Scenes in which some vehicle has a {_END_TTC} after its last step.",
        Column("end_scenes_critical", lambda g: int(g.critical_ends > 0)), SCENES_WITH_ENDS,
    ),
    _met(
        "far", f"never within {NEAR_M:g} m of moving recorded traffic",
        f"Centre never within {NEAR_M:g} m of that of another vehicle that was recorded and moves.",
    ),
    *_followed(Partner.RECORDED),
    *_followed(Partner.INSERTED),
    *(
        _met(
            f"crosses_{kind}", f"crossing with PET below {WITHIN_S:g} s, {kind}",
            f"Swept path crosses that of a road user that moves ({kind}) at a PET below {WITHIN_S:g} s.",
        )
        for kind in Partner
    ),
    _met("stands", "stands at some time", f"Slower than {STANDS_MPS:g} m/s for {STANDS_FOR_S:g} s."),
)  # fmt: skip


def columns() -> dict[str, Column]:
    """Every column that some metric is made of, by name."""
    return {column.name: column for metric in METRICS for column in (metric.numerator, metric.denominator)}


def policies(arrays: SceneArrays, maneuvers: Sequence[Maneuver]) -> dict[str, Policy]:
    """One policy of the paper per moving vehicle, by track id: the rarest of what it did, else straight."""
    order, moving = list(BEHAVIOURS), np.flatnonzero(arrays.moving_vehicles)
    out = {arrays.track_ids[agent]: Policy.STRAIGHT for agent in moving}
    for maneuver in maneuvers:
        out[maneuver.track_id] = max(out[maneuver.track_id], behaviour_seen(maneuver.kind).policy, key=order.index)
    return out
