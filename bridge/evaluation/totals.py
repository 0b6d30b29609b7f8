"""What an evaluation keeps of all its scenes: sums and counts, the same size after ten scenes and after a million."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from bridge.evaluation.aggregate import SourceSums, table
from bridge.evaluation.critique import critique
from bridge.evaluation.diversity import Diversity
from bridge.evaluation.samples import Samples
from bridge.evaluation.scene_metrics import PAIR_GROUPS, PAIR_KINDS, SceneMeasures
from bridge.recordings.folders import Address
from hid2.evaluation.metrics import Section, metrics_in
from hid2.evaluation.realism import FEATURES, TAIL_SHARES, TAILS, RealismCounts, quantiles
from hid2.judge.findings import Quantity
from hid2.measures.arrays import BoolArray

#: Nets of at most this many different maps are measured.
MOST_NETS = 20
#: Events are listed in the report up to this many; events.csv has all.
MOST_EVENTS = 40
#: Delays are counted to this part of a second.
_DELAY_PARTS = 1000

Row = Mapping[str, Any]


@dataclass(eq=False, slots=True)
class ManeuverCounts:
    """Manoeuvres asked for by kind and status, whether they were seen, reasons, and delays from trigger to start.

    delays[kind]: how often each delay came up, by its number of thousandths of a second.
    """

    status: Counter[tuple[str, str]] = field(default_factory=Counter)
    seen: Counter[tuple[str, str]] = field(default_factory=Counter)
    reasons: Counter[tuple[str, str, str]] = field(default_factory=Counter)
    unasked: Counter[str] = field(default_factory=Counter)
    delays: dict[str, Counter[int]] = field(default_factory=dict)

    def add(self, rows: Iterable[Row]) -> None:
        """Count manoeuvre rows of generated vehicles."""
        for row in rows:
            if row["group"] != "generated":
                continue
            kind, status = row["kind"], row["status"]
            if not row["recorded"]:
                if row["part_of"] is None and row["seen_complete"]:
                    self.unasked[kind] += 1
                continue
            self.status[kind, status] += 1
            self.seen[kind, status] += row["seen"] is not None
            if row["reason"]:
                self.reasons[kind, status, row["reason"]] += 1
            if row["trigger_s"] is not None and row["start_s"] is not None:
                delay_s = row["start_s"] - row["trigger_s"]
                self.delays.setdefault(kind, Counter())[round(delay_s * _DELAY_PARTS)] += 1

    def median_delay_s(self, kind: str) -> float | None:
        """Median time from trigger to start, None where no manoeuvre of the kind started."""
        counts = self.delays.get(kind)
        if not counts:
            return None
        return float(np.median(np.repeat(list(counts), list(counts.values())))) / _DELAY_PARTS


class Example(NamedTuple):
    """The scene that shows most: one with generated vehicles, then the one with most manoeuvres."""

    has_generated: bool
    maneuvers: int
    scenario_id: str
    folder: str


class Totals:
    """Sums over all scenes of a pass. `example`: the scene to show, None before the first.

    Memory grows by the names of the source scenes alone.

    sources: ids of the source scenes that are measured themselves; for others the recorded tracks of the first scene
    made from them stand.
    """

    def __init__(self, sources: Iterable[str] = ()) -> None:
        self._measured_sources = frozenset(sources)
        self.sums = SourceSums()
        self.diversity = Diversity()
        self.realism = RealismCounts()
        self.maneuvers = ManeuverCounts()
        self.samples = Samples()
        self.control: Samples | None = None
        self.events: list[Row] = []
        self.event_counts: Counter[tuple[str, str]] = Counter()
        self.example: Example | None = None
        self._sources: set[str] = set()
        self._nets: dict[str, str] = {}
        self._counts: Counter[str] = Counter()
        self._rejected: Counter[str] = Counter()
        self._selection: dict[str, Counter[str]] = {}
        self._findings: Counter[str] = Counter()
        self._replay_position_error_m = 0.0

    def add(self, measures: SceneMeasures) -> None:
        """Take a scene in."""
        row = measures.scene
        source = str(row["source"])
        self.sums.add(row)
        self.diversity.add(row)
        self.maneuvers.add(measures.maneuvers)
        self.event_counts.update((str(row["kind"]), str(row["status"])) for row in measures.events)
        self.events += measures.events[: max(0, MOST_EVENTS - len(self.events))]
        # the recorded vehicles of a source scene are in every scene that was made from it: they count once
        as_recorded = source not in self._sources and source not in self._measured_sources
        self._sources.add(source)
        if as_recorded:
            self.diversity.add_source(row)
        self._add_driving(measures, generated=True, recorded=as_recorded)
        self._add_counts(row)
        shown = row["generated_seen_overtake"] + row["generated_seen_lane_change"]
        example = Example(row["generated"] > 0, shown, row["scenario_id"], row["folder"])
        self.example = max(example, self.example or example)
        self._nets.setdefault(source, row["folder"])
        if len(self._nets) > MOST_NETS:
            del self._nets[max(self._nets)]

    def add_source(self, measures: SceneMeasures) -> None:
        """Take a source scene in: what there was before, and how recorded vehicles drive among themselves."""
        self.diversity.add_source(measures.scene)
        self._add_driving(measures, generated=False, recorded=True)

    def add_control(self, measures: SceneMeasures) -> None:
        """Take a scene of the control's drivers in: of it only what the critics look at counts."""
        self.control = self.control or Samples()
        self._add_windows(measures, self.control, measures.sample_generated)

    def _add_driving(self, measures: SceneMeasures, *, generated: bool, recorded: bool) -> None:
        self.realism.add(measures.realism, generated=generated, recorded=recorded)
        self._add_windows(measures, self.samples, np.where(measures.sample_generated, generated, recorded))

    @staticmethod
    def _add_windows(measures: SceneMeasures, samples: Samples, kept: BoolArray) -> None:
        row = measures.scene
        samples.add(
            measures.samples[kept], measures.sample_generated[kept], scene=row["scenario_id"], source=str(row["source"])
        )

    def net_folders(self) -> dict[str, str]:
        """Scene folder of each of the first source scenes by name."""
        return {source: self._nets[source] for source in sorted(self._nets)}

    def content(self) -> dict[str, Any]:
        """The parts of metrics.json that the scenes tell."""
        counts = self._counts
        return {
            "scenes": {
                "scenes": counts["scenes"],
                "sources": len(self._sources),
                "generated_scenes": counts["generated_scenes"],
                "generated_vehicles": counts["generated"],
            },
            "kinematics": {
                "paper": table(self.sums, metrics_in(Section.PAPER)),
                "clean": table(self.sums, metrics_in(Section.CLEAN)),
                "limits": table(self.sums, metrics_in(Section.LIMITS)),
            },
            "safety": table(self.sums, metrics_in(Section.SAFETY))
            | {"pairs": {kind: {g: counts[f"{kind}_{g}"] for g in PAIR_GROUPS} for kind in PAIR_KINDS}},
            "judge": {
                quantity.value: {
                    "findings": self._findings[quantity.value],
                    "limit": quantity.sentence,
                }
                for quantity in Quantity
                if self._findings[quantity.value]
            },
            "encounters": table(self.sums, metrics_in(Section.ENCOUNTERS)),
            "events": {
                kind: {status: self.event_counts[kind, status] for status in ("done", "not_feasible")}
                for kind in sorted({kind for kind, _ in self.event_counts})
            },
            "diversity": self.diversity.content(),
            "realism": {
                "distances": [distance._asdict() for distance in self.realism.distances()],
                "tails": _tails(self.realism),
                "critics": critique(
                    self.samples.packed(), self.samples.joined(self.control) if self.control is not None else None
                ),
            },
            "requests": {
                "requested": counts["requested"],
                "placed": counts["placed"],
                "placed_of_requested": counts["placed_of_requested"],
                "rejected": dict(self._rejected.most_common()),
                "selection": {name: dict(counts) for name, counts in self._selection.items()},
                "maneuvers": _maneuvers(self.maneuvers),
                "seen_without_record": dict(sorted(self.maneuvers.unasked.items())),
            },
            "replay": {
                "states": counts["replay_states"],
                "max_position_error_m": self._replay_position_error_m,
            },
        }

    def _add_counts(self, row: Row) -> None:
        counts = self._counts
        counts["scenes"] += 1
        counts["generated_scenes"] += row["generated"] > 0
        for name in ("generated", "placed", "replay_states"):
            counts[name] += row[name]
        if row["requested"] is not None:
            counts["requested"] += row["requested"]
            counts["placed_of_requested"] += row["placed"]
        for kind in PAIR_KINDS:
            for group in PAIR_GROUPS:
                counts[f"{kind}_{group}"] += row[f"{kind}_{group}"]
        self._rejected.update(row["rejected"] or {})
        for name, told in (row["selection"] or {}).items():
            self._selection.setdefault(name, Counter()).update(told)
        self._findings.update(row["findings"])
        self._replay_position_error_m = max(self._replay_position_error_m, row["replay_position_error_m"] or 0.0)


@dataclass(eq=False, slots=True)
class Evaluation:
    """What is known of a folder after the pass; `metrics` is the content of metrics.json.

    failures: scenes that could not be read, with the reason.
    """

    totals: Totals = field(default_factory=Totals)
    failures: list[tuple[Address, str]] = field(default_factory=list)
    metrics: dict[str, Any] = field(default_factory=dict)


def _tails(realism: RealismCounts) -> list[dict[str, Any]]:
    """Quantiles of generated and recorded vehicles side by side."""
    return [
        {
            "feature": feature.name,
            "unit": feature.unit,
            "shares": list(TAIL_SHARES),
            "generated": quantiles(feature, realism.generated[feature.name]),
            "recorded": quantiles(feature, realism.recorded[feature.name]),
        }
        for feature in FEATURES
        if feature.name in TAILS
    ]


def _maneuvers(counts: ManeuverCounts) -> dict[str, Any]:
    statuses = ("done", "aborted", "not_feasible", "not_triggered")
    return {
        kind: {
            **{status: counts.status[kind, status] for status in statuses},
            "done_and_seen": counts.seen[kind, "done"],
            "reasons": {
                f"{status}: {reason}": count
                for (name, status, reason), count in counts.reasons.most_common()
                if name == kind
            },
            "median_trigger_to_start_s": counts.median_delay_s(kind),
        }
        for kind in sorted({kind for kind, _ in counts.status})
    }
