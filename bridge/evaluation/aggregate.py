"""Scenes pooled: ratios of sums for each group, with bootstrap intervals over scenes."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from hid2.agents import FloatArray
from hid2.evaluation.metrics import GROUPS, Metric, columns
from hid2.resampling import Estimate, ratio

#: Sums are kept of at most this many source scenes; of more, they are kept of this many groups of sources.
MOST_SOURCES = 1000

Row = Mapping[str, Any]


class SourceSums:
    """Sums of columns over the scenes of each source scene: what a bootstrap over source scenes draws from.

    Memory does not grow with scenes, and not with source scenes beyond `most`: then the sources are pooled in `most`
    groups by a hash of their names, and groups are drawn. Totals stay exact, intervals are as good as from `most`
    scenes, and the order of the scenes does not matter.
    """

    def __init__(self, names: Sequence[str] | None = None, *, most: int = MOST_SOURCES) -> None:
        """Sum the columns of these names; of every metric and group unless told."""
        if names is None:
            names = [f"{group}_{column}" for group in GROUPS for column in columns()]
        self._columns = {name: k for k, name in enumerate(names)}
        self._most = most
        self._grouped = False
        self._sums: dict[str, FloatArray] = {}

    @classmethod
    def of(cls, rows: Iterable[Row]) -> "SourceSums":
        """Sums over scene rows."""
        sums = cls()
        for row in rows:
            sums.add(row)
        return sums

    def __len__(self) -> int:
        return len(self._sums)

    def add(self, row: Row) -> None:
        """Take a scene row in. Errors: KeyError where it lacks a column."""
        self._add(str(row["source"]), np.array([float(row[name]) for name in self._columns]))

    def of_columns(self, *columns: str) -> tuple[FloatArray, ...]:
        """Sums (S,) of each column, in the order of the sources' names. Errors: KeyError for an unknown column."""
        table = np.array([self._sums[name] for name in sorted(self._sums)]).reshape(-1, len(self._columns))
        return tuple(table[:, self._columns[name]] for name in columns)

    def _add(self, source: str, values: FloatArray) -> None:
        name = self._group_of(source) if self._grouped else source
        if name in self._sums:
            self._sums[name] = self._sums[name] + values
            return
        self._sums[name] = values
        if len(self._sums) > self._most:
            known, self._sums, self._grouped = self._sums, {}, True
            for each in sorted(known):
                self._add(each, known[each])

    def _group_of(self, source: str) -> str:
        digest = hashlib.blake2b(source.encode(), digest_size=8).digest()
        return f"{int.from_bytes(digest) % self._most:09d}"


def estimate(sums: SourceSums, metric: Metric, group: str) -> Estimate:
    """Pool a metric over scenes. The bootstrap draws source scenes: the variants of one scene are not independent."""
    return ratio(*sums.of_columns(f"{group}_{metric.numerator.name}", f"{group}_{metric.denominator.name}"))


def table(sums: SourceSums, metrics: Sequence[Metric]) -> dict[str, Any]:
    """Every metric with its interval for every group, ready for JSON: table[metric.key][group]."""
    return {
        metric.key: {
            "label": metric.label,
            "unit": metric.unit,
            "sentence": metric.sentence,
            **{group: estimate(sums, metric, group)._asdict() for group in GROUPS},
        }
        for metric in metrics
    }
