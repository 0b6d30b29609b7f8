"""What an evaluation keeps of all its scenes: sums and counts, the same size after ten scenes and after a million."""

import hashlib
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from bridge.evaluation.scene_metrics import PAIR_COLUMNS, PAIR_GROUPS, PAIR_KINDS, SceneMeasures
from bridge.recordings.folders import Address
from hid2.agents import FloatArray, Policy
from hid2.evaluation.critics import critique
from hid2.evaluation.metrics import GROUPS, METRICS, Metric, MetricTable, columns
from hid2.evaluation.realism import FEATURES, GENERATED, RECORDED, TAIL_SHARES, TAILS, RealismCounts, quantiles
from hid2.evaluation.windows import WINDOW, Windows
from hid2.judge.findings import Quantity
from hid2.measures.manoeuvres import ManeuverKind
from hid2.resampling import Estimate, ratio

#: Most source scenes of which sums are kept; of more, sums are kept of as many groups of sources.
MOST_SOURCES = 1000
#: Most events listed in the report; events.csv has all.
MOST_EVENTS = 40
#: Parts of a second to which delays are counted.
_DELAY_PARTS = 1000
#: Bounds of the agent-count bands of the paper.
BANDS = (40, 50, 70, 90)
#: Density in two ways: all tracks of a scene, and those present at the last observed step.
DENSITIES = ("tracks", "tracks_at_49")
#: Most generated, and most recorded, windows that the critics look at.
MOST_OF_A_KIND = 4000

#: Scenes as they were, the vehicles added alone, and scenes as they are: the group of a scene row that each counts.
_MOMENTS = {"before": "original", "generated": "generated", "after": "combined"}
#: What may become of a manoeuvre that was asked for.
_STATUSES = ("done", "aborted", "not_feasible", "not_triggered")
#: Columns of scenes that are summed, beside those of `SourceSums`.
_COUNTED = ("generated", "placed", *PAIR_COLUMNS)

Row = Mapping[str, Any]


class SourceSums:
    """Sums of columns over the scenes of each recorded log: what a bootstrap over recordings draws from.

    A log is a source scene, or all windows of a drive. Memory does not grow with scenes, and not with logs beyond
    `most`: then the logs are pooled in `most` groups by a hash of their names, and groups are drawn. Totals stay exact,
    intervals are as good as from `most` logs, and the order of the scenes does not matter.
    """

    def __init__(
        self, rows: Iterable[Row] = (), *, names: Sequence[str] | None = None, most: int = MOST_SOURCES
    ) -> None:
        """Sums over scene rows, of the columns of these names; of every metric and group unless told."""
        self._columns = list(names or (f"{group}_{column}" for group in GROUPS for column in columns()))
        self._most, self._grouped = most, False
        self._sums: dict[str, FloatArray] = {}
        for row in rows:
            self.add(row)

    def add(self, row: Row) -> None:
        """Take a scene row in. Errors: KeyError where it lacks a column."""
        self._add(str(row["log"]), np.array([float(row[name]) for name in self._columns]))

    def of_columns(self, *columns: str) -> tuple[FloatArray, ...]:
        """Sums (S,) of each column, in the order of the logs' names. Errors: ValueError for an unknown column."""
        table = np.array([self._sums[name] for name in sorted(self._sums)]).reshape(-1, len(self._columns))
        return tuple(table[:, self._columns.index(name)] for name in columns)

    def _add(self, source: str, values: FloatArray) -> None:
        name = f"{_hash(source) % self._most:09d}" if self._grouped else source
        self._sums[name] = self._sums.get(name, 0.0) + values
        if len(self._sums) > self._most:
            known, self._sums, self._grouped = self._sums, {}, True
            for each in sorted(known):
                self._add(each, known[each])


def _hash(text: str) -> int:
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=8).digest())


def estimate(sums: SourceSums, metric: Metric, group: str) -> Estimate:
    """Pool a metric over scenes. The bootstrap draws logs: variants of one scene, or windows, are not independent."""
    return ratio(*sums.of_columns(f"{group}_{metric.numerator.name}", f"{group}_{metric.denominator.name}"))


def table(sums: SourceSums, section: MetricTable) -> dict[str, Any]:
    """Every metric of a section with its interval for every group, ready for JSON: table[metric.key][group]."""
    own = [metric for metric in METRICS if metric.section == section]
    said = {one.key: {"label": one.label, "unit": one.unit, "sentence": one.sentence} for one in own}
    return {one.key: said[one.key] | {group: estimate(sums, one, group)._asdict() for group in GROUPS} for one in own}


class Diversity:
    """Scenes before and after vehicles were added, and the vehicles added alone."""

    def __init__(self, rows: Iterable[Row] = (), sources: Iterable[Row] = ()) -> None:
        """Count scene rows and those of their source scenes."""
        #: By moment and what is counted: scenes by number of agents, moving vehicles and manoeuvres by kind.
        self._counts: Counter[tuple[str, str, int | str]] = Counter()
        for row in rows:
            self.add(row, "generated", "after")
        for row in sources:
            self.add(row, "before")

    def add(self, row: Row, *moments: str) -> None:
        """Count a scene: as it was, once for each source; what was added to it, and as it is."""
        for when in moments:
            group = _MOMENTS[when]
            told: dict[tuple[str, int | str], int] = {("scenes", ""): 1}
            for name in DENSITIES:
                added = row[name.replace("tracks", "generated")]
                told[name, {"original": row[name] - added, "generated": added, "combined": row[name]}[group]] = 1
            for policy in Policy:
                vehicles = row[f"{group}_policy_{policy}"]
                told |= {("vehicles", policy): vehicles, ("scenes_with", policy): int(vehicles > 0)}
            told |= {("maneuvers", kind): row[f"{group}_seen_{kind}"] for kind in ManeuverKind}
            self._counts.update({(when, *key): count for key, count in told.items()})

    def content(self) -> dict[str, Any]:
        """Ready for JSON: scenes before and after, density[name] by number of agents, and behaviours."""
        scenes = {when: self._counts[when, "scenes", ""] for when in _MOMENTS}
        names = {"vehicles": Policy, "scenes_with": Policy, "maneuvers": ManeuverKind}
        return {
            "scenes": {when: scenes[when] for when in ("before", "after")},
            "density": {name: self._density(name, scenes) for name in DENSITIES},
            "behaviours": {
                when: {what: {one.value: self._counts[when, what, one] for one in of} for what, of in names.items()}
                | {"scenes": count}
                for when, count in scenes.items()
            },
        }

    def _density(self, name: str, scenes: Mapping[str, int]) -> dict[str, Any]:
        """Scenes by number of agents, fewest first (JSON's keys are texts), means, and shares above BANDS."""
        by_number: dict[str, dict[str, int]] = {}
        means: dict[str, float | None] = {}
        above: dict[str, dict[str, float | None]] = {str(bound): {} for bound in BANDS}
        for when in ("before", "after"):
            of = sorted((int(n), c) for (at, what, n), c in self._counts.items() if (at, what) == (when, name))
            every = scenes[when]
            by_number[when] = {str(number): count for number, count in of}
            means[f"mean_{when}"] = sum(n * count for n, count in of) / every if every else None
            for bound in BANDS:
                above[str(bound)][when] = sum(c for n, c in of if n > bound) / every if every else None
        return by_number | means | {"share_above": above}


class Samples:
    """The windows with the smallest hashes, up to `most` generated and `most` recorded ones.

    A window's hash is drawn from the name of its scene, so that which ones are kept does not depend on the order of
    the scenes, and the memory not on their number.
    """

    def __init__(self, *, most: int = MOST_OF_A_KIND) -> None:
        self._most = most
        self._kept = np.zeros(0, dtype=WINDOW)

    def add(self, offered: Windows, *, scene: str) -> None:
        """Offer windows of a scene, which may be one of many that were made from their recorded one."""
        every = np.concatenate([offered, self._kept])
        every["drawn"][: len(offered)] = np.random.default_rng(_hash(scene)).random(len(offered))
        every = every[np.argsort(every["drawn"], kind="stable")]
        self._kept = np.concatenate([every[every["generated"] == kind][: self._most] for kind in (True, False)])

    def windows(self, control: "Samples | None" = None) -> Windows:
        """The windows kept, by recorded scene, so that the order in which scenes came does not matter.

        control: its generated windows are taken instead: what a control is judged on.
        """
        every = self._kept
        if control is not None:
            every = np.concatenate([part[part["generated"] == kind] for part, kind in ((every, 0), (control._kept, 1))])
        return every[np.lexsort([every["drawn"], np.unique(every["scene"], return_inverse=True)[1]])]


class ManeuverCounts:
    """Manoeuvres asked for: how many of a kind came to the same, and how long after their trigger they started."""

    def __init__(self) -> None:
        #: By kind: statuses, reasons, and delays in thousandths of a second.
        self._told: dict[str, tuple[Counter[str], Counter[str], Counter[int]]] = {}

    def add(self, rows: Iterable[Row]) -> None:
        """Count manoeuvre rows of generated vehicles."""
        for row in rows:
            if row["group"] != "generated" or not row["recorded"]:
                continue
            statuses, reasons, delays = self._told.setdefault(row["kind"], (Counter(), Counter(), Counter()))
            statuses[row["status"]] += 1
            statuses["done_and_seen"] += row["status"] == "done" and row["seen"] is not None
            reasons.update([f"{row['status']}: {row['reason']}"] if row["reason"] else [])
            if row["trigger_s"] is not None and row["start_s"] is not None:
                delays[round((row["start_s"] - row["trigger_s"]) * _DELAY_PARTS)] += 1

    def content(self) -> dict[str, Any]:
        """Ready for JSON, by kind: statuses, reasons from the commonest on, median delay, s; None where none began."""
        return {
            kind: {name: statuses[name] for name in (*_STATUSES, "done_and_seen")}
            | {
                "reasons": dict(reasons.most_common()),
                "median_trigger_to_start_s": float(np.median([*delays.elements()])) / _DELAY_PARTS if delays else None,
            }
            for kind, (statuses, reasons, delays) in sorted(self._told.items())
        }


class Totals:
    """Sums over all scenes of a pass.

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
        self.samples, self.control = Samples(), Samples()
        self.events: list[Row] = []
        self._sources: dict[str, str] = {}  # and the log of each
        self._counts: Counter[str] = Counter()
        self._told: defaultdict[str, Counter[Any]] = defaultdict(Counter)  # by what is counted, such as reasons
        self._selection: defaultdict[str, Counter[str]] = defaultdict(Counter)

    def add(self, measures: SceneMeasures) -> None:
        """Take a scene in."""
        row = measures.scene
        source = str(row["source"])
        self.sums.add(row)
        self.diversity.add(row, "generated", "after")
        self.maneuvers.add(measures.tables["maneuvers"])
        events = measures.tables["events"]
        self._told["events"].update((event["kind"], event["status"]) for event in events)
        self.events += events[: max(0, MOST_EVENTS - len(self.events))]
        # the recorded vehicles of a source scene are in every scene that was made from it: they count once
        as_recorded = source not in self._sources and source not in self._measured_sources
        self._sources[source] = str(row["log"])
        if as_recorded:
            self.diversity.add(row, "before")
        self._add_driving(measures, generated=True, recorded=as_recorded)
        self._add_counts(row)

    def add_source(self, measures: SceneMeasures) -> None:
        """Take a source scene in: what there was before, and how recorded vehicles drive among themselves."""
        self.diversity.add(measures.scene, "before")
        self._add_driving(measures, generated=False, recorded=True)

    def add_control(self, measures: SceneMeasures) -> None:
        """Take a scene of the control's drivers in: of it only what the critics look at counts."""
        self.control.add(measures.windows[measures.windows["generated"]], scene=measures.scene["scenario_id"])

    def _add_driving(self, measures: SceneMeasures, *, generated: bool, recorded: bool) -> None:
        self.realism.add(measures.realism, generated=generated, recorded=recorded)
        own = measures.windows
        self.samples.add(own[np.where(own["generated"], generated, recorded)], scene=measures.scene["scenario_id"])

    def content(self) -> dict[str, Any]:
        """The parts of metrics.json that the scenes tell."""
        counts, told = self._counts, self._told
        return {
            "scenes": {
                "scenes": counts["scenes"],
                "sources": len({*self._sources.values()}),
                "generated_scenes": counts["generated_scenes"],
                "generated_vehicles": counts["generated"],
            },
            "kinematics": {"paper": table(self.sums, "paper"), "clean": table(self.sums, "clean")},
            "safety": table(self.sums, "safety")
            | {"pairs": {kind: {g: counts[f"{kind}_{g}"] for g in PAIR_GROUPS} for kind in PAIR_KINDS}},
            "judge": {
                quantity.value: {"findings": told["findings"][quantity.value], "limit": quantity.sentence}
                for quantity in Quantity
                if told["findings"][quantity.value]
            },
            "encounters": table(self.sums, "encounters"),
            "events": {
                kind: {status: told["events"][kind, status] for status in ("done", "not_feasible")}
                for kind in sorted({kind for kind, _ in told["events"]})
            },
            "diversity": self.diversity.content(),
            "realism": {
                "distances": [distance._asdict() for distance in self.realism.distances()],
                "tails": _tails(self.realism),
                "critics": critique(self.samples.windows(), self.samples.windows(self.control)),
            },
            "requests": {
                "requested": counts["requested"],
                "placed": counts["placed"],
                "placed_of_requested": counts["placed_of_requested"],
                "rejected": dict(told["rejected"].most_common()),
                "wanted": {name: total / counts["wanted"] for name, total in told["wanted"].items()},
                "selection": {name: dict(part) for name, part in self._selection.items()},
                "maneuvers": self.maneuvers.content(),
            },
        }

    def _add_counts(self, row: Row) -> None:
        self._counts.update({name: row[name] for name in _COUNTED})
        self._counts.update(scenes=1, generated_scenes=row["generated"] > 0, wanted=bool(row["wanted"]))
        if row["requested"] is not None:
            self._counts.update(requested=row["requested"], placed_of_requested=row["placed"])
        for name in ("rejected", "wanted", "findings"):
            self._told[name].update(row[name] or {})
        for name, part in (row["selection"] or {}).items():
            self._selection[name].update(part)


class Evaluation(NamedTuple):
    """What is known of a folder after the pass; `metrics` is the content of metrics.json.

    failures: scenes that could not be read, with the reason.
    """

    totals: Totals
    failures: list[tuple[Address, str]]
    metrics: dict[str, Any]


def _tails(realism: RealismCounts) -> list[dict[str, Any]]:
    """Quantiles of generated and recorded vehicles side by side."""
    rows = {"generated": GENERATED, "recorded": RECORDED}
    return [
        {"feature": one.name, "unit": one.unit, "shares": list(TAIL_SHARES)}
        | {kind: quantiles(one, realism.of(one)[row], TAIL_SHARES) for kind, row in rows.items()}
        for one in FEATURES
        if one.name in TAILS
    ]
