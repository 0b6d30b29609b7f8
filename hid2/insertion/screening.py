"""What soon speaks against places for a vehicle: the map, who is there as the scene begins, and that no plan exists.

Of the places tried few are possible, so that many are looked at in one go, before anything is foreseen in detail.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from hid2.agents import FloatArray, Policy
from hid2.conflicts.cases import Prospect
from hid2.insertion.foresight import Foresight, Wish
from hid2.insertion.free_places import taken
from hid2.insertion.places import Places
from hid2.insertion.starts import Start, starts
from hid2.motion.route import DrivenPath, Way
from hid2.policy.turns import TURN_OF_POLICY

#: By which gaps along a bend may differ from those straight ahead, m.
BEND_M = 0.3
#: Speeds at spawn that are tried, as shares of the one drawn: without patience, for a turn, with patience.
_SHARES, _TURN_SHARES, _PATIENT_SHARES = (1.0,), (1.0, 0.6), (1.0, 0.5, 0.0)
_BACK_M = (1.0,) * 4  # that a taken place is moved back


@dataclass(slots=True)
class Candidate:
    """A place for a wish, with its desired speed and the one wished for at the start, m/s.

    turn_end: arc length behind the turn that it is for, m, 0 for none.
    """

    wish: Wish
    way: Way
    s0: float
    cruise_mps: float
    wanted_mps: float
    turn_end: float = 0.0


def shares_at_spawn(policy: Policy, patience: int) -> tuple[float, ...]:
    """Of the speed drawn for the spawn, that are tried."""
    return _PATIENT_SHARES if patience > 0 else _TURN_SHARES if policy in TURN_OF_POLICY else _SHARES


@dataclass(slots=True)
class Screening:
    """Looks at candidates before they are planned. What it has seen along a path is kept.

    A start that is not possible does not become so when vehicles are added: what was seen before them still counts.
    """

    places: Places
    _seen: dict[DrivenPath, list[Prospect]] = field(default_factory=dict)

    def forget(self) -> None:
        """Begin anew: somebody is gone, or gaps are others."""
        self._seen = {}

    def starts(
        self, candidates: Sequence[Candidate], ahead: Foresight, sigma: npt.NDArray[np.uint8], patience: int
    ) -> list[Start | str]:
        """For candidates of one vehicle how each might start, or the reason against it.

        ahead: who is there; sigma (C,): occupancy of the cells at step 0, with those placed before.
        """
        if not candidates:
            return []
        against = [self.places.unsuited(c.wish, c.way, c.s0, c.cruise_mps, patience) for c in candidates]
        if "collision" in self.places.world.config.without:
            return [reason or Start(c.wanted_mps, None) for c, reason in zip(candidates, against, strict=True)]
        found: dict[int, Start | str] = {row: reason for row, reason in enumerate(against) if reason is not None}
        policy = candidates[0].wish.policy
        rows = [row for row in range(len(candidates)) if row not in found]
        # seen before a path is laid and looked along
        found.update(self._taken({row: candidates[row] for row in rows}, ahead, sigma))
        by_way: dict[Way, list[int]] = {}
        for row in rows:
            if row not in found:
                by_way.setdefault(candidates[row].way, []).append(row)
        for way, at in by_way.items():
            path = self.places.world.path(way.route)
            if policy in TURN_OF_POLICY:
                found.update(self._without_turn(path, {row: candidates[row] for row in at}, ahead))
                at = [row for row in at if row not in found]
            if at:
                starts_there = self._on_path(path, [candidates[row] for row in at], ahead, patience)
                found.update(zip(at, starts_there, strict=True))
        return [found[row] for row in range(len(candidates))]

    def _without_turn(self, path: DrivenPath, candidates: Mapping[int, Candidate], ahead: Foresight) -> dict[int, str]:
        """Candidates on a path that cannot get through the turn that they are for; the others learn where it ends."""
        found: dict[int, str] = {}
        for row, candidate in candidates.items():
            end = ahead.turn_end(candidate.wish, path, candidate.s0, candidate.cruise_mps)
            if isinstance(end, str):
                found[row] = end
            else:
                candidate.turn_end = end
        return found

    def _on_path(
        self, path: DrivenPath, candidates: Sequence[Candidate], ahead: Foresight, patience: int
    ) -> list[Start | str]:
        """For candidates on one path how each might start, or the reason against it.

        What was seen along the path before the last vehicles were added, by one of no larger size, suffices to turn
        most of them down.
        """
        size = candidates[0].wish.size
        drawn = np.array([(c.s0, c.cruise_mps, c.wanted_mps, c.turn_end) for c in candidates])
        seen = self._seen.setdefault(path, [])
        before = next((look for look in reversed(seen) if look.size.fits(size)), None)
        found: list[Start | str] = ["unseen"] * len(candidates)
        rows = np.arange(len(candidates))
        if before is not None:
            found = self._seen_from(before, drawn, candidates[0].wish.policy, patience, ahead.turned_by)
            rows = np.array([row for row, start in enumerate(found) if isinstance(start, Start)], dtype=np.int64)
        look = ahead.along(path, size) if rows.size else None
        if look is not None and look is not before:
            seen.append(look)
            again = self._seen_from(look, drawn[rows], candidates[0].wish.policy, patience, ahead.turned_by)
            for row, start in zip(rows.tolist(), again, strict=True):
                found[row] = start
        return found

    def _seen_from(
        self, look: Prospect, drawn: FloatArray, policy: Policy, patience: int, turned_by: int
    ) -> list[Start | str]:
        s0, cruise, wanted, turn_end = drawn.T
        return starts(
            look, self.places.world.speeds(look.path), s0, cruise, wanted, shares=shares_at_spawn(policy, patience),
            gentle_from=look.occupancy.low.shape[0] if patience > 0 else look.recorded_rows, turn_end=turn_end,
            turned_by=turned_by, config=self.places.world.config, plans=policy is not Policy.OVERTAKE,
        )  # fmt: skip

    def _taken(
        self, candidates: Mapping[int, Candidate], ahead: Foresight, sigma: npt.NDArray[np.uint8]
    ) -> dict[int, str]:
        """Which places others are on at step 0, or within the clear gap along the lane."""
        if not candidates:
            return {}
        some = list(candidates.values())
        # a packed road has each one close behind the next
        back = self.places.packed and some[0].wish.policy is Policy.STRAIGHT
        world = self.places.world
        reasons, s0 = taken(
            [one.way for one in some], [one.s0 for one in some], some[0].wish.size,
            lanes=world.recorded.lanes, boxes=world.boxes, sigma=sigma, others=ahead.at_start,
            gap_m=world.config.spawn.clear_gap_m - BEND_M, back_m=_BACK_M if back else (),
        )  # fmt: skip
        for one, at in zip(some, s0, strict=True):
            one.s0 = at
        return {row: reason for row, reason in zip(candidates, reasons, strict=True) if reason is not None}
