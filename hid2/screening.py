"""What soon speaks against places for a vehicle: the map, who is there as the scene begins, and that no plan exists.

Of the places tried few are possible, so that many are looked at in one go, before anything is foreseen in detail.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from hid2.agents import FloatArray, Policy
from hid2.conflicts import Prospect
from hid2.foresight import Foresight, Wish
from hid2.occupancy import UNDER_SHARE, are_taken
from hid2.places import Places
from hid2.route import DrivenPath, Route
from hid2.starts import Start, starts
from hid2.turns import TURN_OF_POLICY

#: By which gaps along a bend may differ from those straight ahead, m.
BEND_M = 0.3
#: Speeds at spawn that are tried, as shares of the one drawn: without patience, for a turn, with patience.
_SHARES, _TURN_SHARES, _PATIENT_SHARES = (1.0,), (1.0, 0.6), (1.0, 0.5, 0.0)
_BACK_STEPS, _BACK_M = 4, 1.0


@dataclass(slots=True)
class Candidate:
    """A place for a wish, with its desired speed and the one wished for at the start, m/s.

    turn_end: arc length behind the turn that it is for, m.
    """

    wish: Wish
    route: Route
    s0: float
    cruise_mps: float
    wanted_mps: float
    turn_end: float = 0.0

    def move_back(self, by_m: float) -> bool:
        """Begin a little further back, unless the lane does not."""
        self.s0 -= by_m
        return self.s0 >= self.wish.size.length_m / 2


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
        against = [self.places.unsuited(c.wish, c.route, c.s0, c.cruise_mps, patience) for c in candidates]
        if "collision" in self.places.world.config.without:
            return [reason or Start(c.wanted_mps, None) for c, reason in zip(candidates, against, strict=True)]
        found: dict[int, Start | str] = {row: reason for row, reason in enumerate(against) if reason is not None}
        policy = candidates[0].wish.policy
        rows = [row for row in range(len(candidates)) if row not in found]
        # seen before a path is laid and looked along
        found.update(self._taken({row: candidates[row] for row in rows}, ahead, sigma))
        if self.places.packed and policy is Policy.STRAIGHT:
            for _ in range(_BACK_STEPS):  # a packed road has each one close behind the next
                back = {row: candidates[row] for row in rows if row in found and candidates[row].move_back(_BACK_M)}
                for row in back:
                    del found[row]
                found.update(self._taken(back, ahead, sigma))
        by_path: dict[DrivenPath, list[int]] = {}
        for row in rows:
            if row not in found:
                candidate = candidates[row]
                path = self.places.world.path(candidate.route)
                if policy in TURN_OF_POLICY:
                    end = ahead.turn_end(candidate.wish, path, candidate.s0, candidate.cruise_mps)
                    if isinstance(end, str):
                        found[row] = end
                        continue
                    candidate.turn_end = end
                by_path.setdefault(path, []).append(row)
        for path, at in by_path.items():
            found.update(zip(at, self._on_path(path, [candidates[row] for row in at], ahead, patience), strict=True))
        return [found[row] for row in range(len(candidates))]

    def _on_path(
        self, path: DrivenPath, candidates: Sequence[Candidate], ahead: Foresight, patience: int
    ) -> list[Start | str]:
        """For candidates on one path how each might start, or the reason against it.

        What was seen along the path before the last vehicles were added, by one of no larger size, suffices to turn
        most of them down.
        """
        size = candidates[0].wish.size
        drawn = np.array([(c.s0, c.cruise_mps, c.wanted_mps) for c in candidates])
        seen = self._seen.setdefault(path, [])
        before = next((look for look in reversed(seen) if look.size.fits(size)), None)
        found: list[Start | str] = ["unseen"] * len(candidates)
        rows = np.arange(len(candidates))
        if before is not None:
            found = self._seen_from(before, drawn, candidates[0].wish.policy, patience)
            rows = np.array([row for row, start in enumerate(found) if isinstance(start, Start)], dtype=np.int64)
        look = ahead.along(path, size) if rows.size else None
        if look is not None and look is not before:
            seen.append(look)
            again = self._seen_from(look, drawn[rows], candidates[0].wish.policy, patience)
            for row, start in zip(rows.tolist(), again, strict=True):
                found[row] = start
        return found

    def _seen_from(self, look: Prospect, drawn: FloatArray, policy: Policy, patience: int) -> list[Start | str]:
        return starts(
            look, self.places.world.speeds(look.path), *drawn.T, shares=shares_at_spawn(policy, patience),
            gentle_from=look.occupancy.low.shape[0] if patience > 0 else look.recorded_rows,
            config=self.places.world.config, plans=policy is not Policy.OVERTAKE,
        )  # fmt: skip

    def _taken(
        self, candidates: Mapping[int, Candidate], ahead: Foresight, sigma: npt.NDArray[np.uint8]
    ) -> dict[int, str]:
        """Which places others are on at step 0, or within the clear gap along the lane."""
        if not candidates:
            return {}
        size = next(iter(candidates.values())).wish.size
        x, y, heading = np.array([self.places.pose(c.route, c.s0) for c in candidates.values()]).T
        taken = are_taken(
            self.places.world.boxes, sigma, x, y, heading, length_m=size.length_m, width_m=UNDER_SHARE * size.width_m
        )
        gap_m = self.places.world.config.spawn.clear_gap_m - BEND_M
        close = ahead.meet_at_start(np.stack([x, y], axis=1), heading, size, gap_m)
        return {
            row: "cells_occupied" if here else "box_too_close"
            for row, here, near in zip(candidates, taken.tolist(), close.tolist(), strict=True)
            if here or near
        }
