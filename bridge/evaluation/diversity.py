"""How many agents scenes hold and what their vehicles do, before and after: counts by value, whatever the scenes."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from typing import Any

from hid2.agents import Policy
from hid2.measures.manoeuvres import ManeuverKind

#: Bounds of the agent-count bands of the paper.
BANDS = (40, 50, 70, 90)
#: Density in two ways: all tracks of a scene, and those present at the last observed step (evaluation.md).
DENSITIES = ("tracks", "tracks_at_49")

Row = Mapping[str, Any]


class Diversity:
    """Scenes before and after vehicles were added, and the vehicles added alone."""

    def __init__(self) -> None:
        self._scenes: Counter[str] = Counter()
        #: Number of scenes by number of agents, for each moment and each of DENSITIES.
        self._density: defaultdict[tuple[str, str], Counter[int]] = defaultdict(Counter)
        #: Moving vehicles by policy, scenes that have any, and manoeuvres by kind, for each moment.
        self._counts: Counter[tuple[str, str, str]] = Counter()

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
        self._count("generated", "generated", row)
        self._count("after", "combined", row)

    def add_source(self, row: Row) -> None:
        """Count what was recorded: a source scene, or a scene that stands for its own. Each source counts once."""
        self._count("before", "original", row)

    def _count(self, when: str, group: str, row: Row) -> None:
        self._scenes[when] += 1
        for name in DENSITIES:
            added = row[name.replace("tracks", "generated")]
            numbers = {"original": row[name] - added, "generated": added, "combined": row[name]}
            self._density[when, name][numbers[group]] += 1
        for policy in Policy:
            number = row[f"{group}_policy_{policy}"]
            self._counts[when, "vehicles", policy.value] += number
            self._counts[when, "scenes_with", policy.value] += number > 0
        for kind in ManeuverKind:
            self._counts[when, "maneuvers", kind.value] += row[f"{group}_seen_{kind}"]

    def content(self) -> dict[str, Any]:
        """Ready for JSON: scenes before and after, density[name] by number of agents, and behaviours."""
        names = {"vehicles": Policy, "scenes_with": Policy, "maneuvers": ManeuverKind}
        return {
            "scenes": {when: self._scenes[when] for when in ("before", "after")},
            "density": {name: self._density_content(name) for name in DENSITIES},
            "behaviours": {
                when: {
                    what: {one.value: self._counts[when, what, one.value] for one in of} for what, of in names.items()
                }
                | {"scenes": self._scenes[when]}
                for when in ("before", "generated", "after")
            },
        }

    def _density_content(self, name: str) -> dict[str, Any]:
        """Scenes by number of agents, fewest first (JSON's keys are texts), means, and shares above BANDS."""
        density = {when: sorted(self._density[when, name].items()) for when in ("before", "after")}

        def per_scene(when: str, total: int) -> float | None:
            return total / self._scenes[when] if self._scenes[when] else None

        means = {f"mean_{when}": per_scene(when, sum(n * count for n, count in of)) for when, of in density.items()}
        above = {
            str(bound): {when: per_scene(when, sum(c for n, c in of if n > bound)) for when, of in density.items()}
            for bound in BANDS
        }
        by_number = {when: {str(number): count for number, count in of} for when, of in density.items()}
        return by_number | means | {"share_above": above}
