"""How many agents scenes hold and what their vehicles do, before and after: counts by value, whatever the scenes."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from hid2.agents import Policy
from hid2.measures.manoeuvres import ManeuverKind

#: Bounds of the agent-count bands of the paper.
BANDS = (40, 50, 70, 90)
#: Density in two ways: all tracks of a scene, and those present at the last observed step (evaluation.md).
DENSITIES = ("tracks", "tracks_at_49")

Row = Mapping[str, Any]


@dataclass(eq=False, slots=True)
class Part:
    """Scenes seen with one group of their agents.

    density: number of scenes by number of agents, for each of DENSITIES; vehicles: moving vehicles by policy;
    scenes_with: scenes that have any; maneuvers: by kind.
    """

    scenes: int = 0
    density: dict[str, Counter[int]] = field(default_factory=lambda: {name: Counter() for name in DENSITIES})
    vehicles: Counter[str] = field(default_factory=Counter)
    scenes_with: Counter[str] = field(default_factory=Counter)
    maneuvers: Counter[str] = field(default_factory=Counter)

    def add(self, row: Row, group: str) -> None:
        """Count one group of the agents of a scene row: original, generated or combined."""
        self.scenes += 1
        for name in DENSITIES:
            generated = row[name.replace("tracks", "generated")]
            number = {"original": row[name] - generated, "generated": generated, "combined": row[name]}[group]
            self.density[name][number] += 1
        for policy in Policy:
            self.vehicles[policy.value] += row[f"{group}_policy_{policy.value}"]
            self.scenes_with[policy.value] += row[f"{group}_policy_{policy.value}"] > 0
        for kind in ManeuverKind:
            self.maneuvers[kind.value] += row[f"{group}_seen_{kind.value}"]


class Diversity:
    """Scenes before and after vehicles were added."""

    def __init__(self) -> None:
        self._before, self._generated, self._after = Part(), Part(), Part()

    @classmethod
    def of(cls, rows: Iterable[Row], sources: Iterable[Row]) -> "Diversity":
        """Count scene rows and those of their source scenes."""
        diversity = cls()
        for row in rows:
            diversity.add(row)
        for row in sources:
            diversity.add_source(row)
        return diversity

    def add(self, row: Row) -> None:
        """Count a scene as it is now."""
        self._generated.add(row, "generated")
        self._after.add(row, "combined")

    def add_source(self, row: Row) -> None:
        """Count what was recorded: a source scene, or a scene that stands for its own. Each source counts once."""
        self._before.add(row, "original")

    def content(self) -> dict[str, Any]:
        """Ready for JSON: scenes before and after, density[name] by number of agents, and behaviours."""
        before, after = self._before, self._after
        return {
            "scenes": {"before": before.scenes, "after": after.scenes},
            "density": {
                name: {
                    "before": _by_number(before.density[name]),
                    "after": _by_number(after.density[name]),
                    "mean_before": _mean(before.density[name]),
                    "mean_after": _mean(after.density[name]),
                    "share_above": {
                        str(bound): {
                            "before": _share(before.density[name], bound),
                            "after": _share(after.density[name], bound),
                        }
                        for bound in BANDS
                    },
                }
                for name in DENSITIES
            },
            "behaviours": {
                "before": _behaviours(before),
                "generated": _behaviours(self._generated),
                "after": _behaviours(after),
            },
        }


def _behaviours(part: Part) -> dict[str, Any]:
    return {
        "vehicles": {policy.value: part.vehicles[policy.value] for policy in Policy},
        "scenes_with": {policy.value: part.scenes_with[policy.value] for policy in Policy},
        "maneuvers": {kind.value: part.maneuvers[kind.value] for kind in ManeuverKind},
        "scenes": part.scenes,
    }


def _by_number(counts: Counter[int]) -> dict[str, int]:
    """Scenes by number of agents, fewest first; JSON's keys are texts."""
    return {str(number): counts[number] for number in sorted(counts)}


def _mean(counts: Counter[int]) -> float | None:
    scenes = counts.total()
    return sum(number * count for number, count in counts.items()) / scenes if scenes else None


def _share(counts: Counter[int], bound: int) -> float | None:
    scenes = counts.total()
    return sum(count for number, count in counts.items() if number > bound) / scenes if scenes else None
