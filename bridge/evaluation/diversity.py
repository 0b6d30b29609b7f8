"""How many agents scenes hold and what their vehicles do, before and after: counts by value, whatever the scenes."""

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from hid2.agents import Policy
from hid2.measures.manoeuvres import ManeuverKind

#: Bounds of the agent-count bands of the paper.
BANDS = (40, 50, 70, 90)
#: Density in two ways: all tracks of a scene, and those present at the last observed step (evaluation.md).
DENSITIES = ("tracks", "tracks_at_49")

Row = Mapping[str, Any]


class Part:
    """Scenes seen with one group of their agents: original, generated or combined.

    density: number of scenes by number of agents, for each of DENSITIES; behaviours: moving vehicles by policy,
    scenes that have any, and manoeuvres by kind.
    """

    def __init__(self, group: str) -> None:
        self._group = group
        self.density: dict[str, Counter[int]] = {name: Counter() for name in DENSITIES}
        self._counts: dict[str, Counter[str]] = {
            "vehicles": Counter({policy.value: 0 for policy in Policy}),
            "scenes_with": Counter({policy.value: 0 for policy in Policy}),
            "maneuvers": Counter({kind.value: 0 for kind in ManeuverKind}),
        }
        self.scenes = 0

    def add(self, row: Row) -> None:
        """Count the group's agents of a scene row."""
        self.scenes += 1
        for name in DENSITIES:
            generated = row[name.replace("tracks", "generated")]
            number = {"original": row[name] - generated, "generated": generated, "combined": row[name]}[self._group]
            self.density[name][number] += 1
        for policy in self._counts["vehicles"]:
            number = row[f"{self._group}_policy_{policy}"]
            self._counts["vehicles"][policy] += number
            self._counts["scenes_with"][policy] += number > 0
        for kind in self._counts["maneuvers"]:
            self._counts["maneuvers"][kind] += row[f"{self._group}_seen_{kind}"]

    def behaviours(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {name: dict(counts) for name, counts in self._counts.items()} | {"scenes": self.scenes}

    def mean(self, name: str) -> float | None:
        """Mean number of agents, None without scenes."""
        numbers = self.density[name].items()
        return sum(number * count for number, count in numbers) / self.scenes if self.scenes else None

    def share_above(self, name: str, bound: int) -> float | None:
        """Share of the scenes with more agents, None without scenes."""
        numbers = self.density[name].items()
        return sum(count for number, count in numbers if number > bound) / self.scenes if self.scenes else None


class Diversity:
    """Scenes before and after vehicles were added."""

    def __init__(self) -> None:
        self._before, self._generated, self._after = Part("original"), Part("generated"), Part("combined")

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
        self._generated.add(row)
        self._after.add(row)

    def add_source(self, row: Row) -> None:
        """Count what was recorded: a source scene, or a scene that stands for its own. Each source counts once."""
        self._before.add(row)

    def content(self) -> dict[str, Any]:
        """Ready for JSON: scenes before and after, density[name] by number of agents, and behaviours."""
        parts = {"before": self._before, "after": self._after}
        three = {"before": self._before, "generated": self._generated, "after": self._after}
        return {
            "scenes": {when: part.scenes for when, part in parts.items()},
            "density": {
                name: {when: _by_number(part.density[name]) for when, part in parts.items()}
                | {f"mean_{when}": part.mean(name) for when, part in parts.items()}
                | {
                    "share_above": {
                        str(bound): {when: part.share_above(name, bound) for when, part in parts.items()}
                        for bound in BANDS
                    }
                }
                for name in DENSITIES
            },
            "behaviours": {when: part.behaviours() for when, part in three.items()},
        }


def _by_number(counts: Counter[int]) -> dict[str, int]:
    """Scenes by number of agents, fewest first; JSON's keys are texts."""
    return {str(number): counts[number] for number in sorted(counts)}
