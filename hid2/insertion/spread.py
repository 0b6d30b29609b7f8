"""Spread of start sites over seeds and variants: each continues one sequence over the sites of its scene.

Drawn one by one, the sites of two variants would often be the same ones. Here (seed, variant) is an index into a
sequence of low discrepancy (an additive recurrence): the sites of its scene, weighted, are a line of length 1, and
vehicle k of K that are to do the same manoeuvre looks first at the place (k + u) / K of that line, where u is what the
index says. Where no vehicle can begin there, others are drawn by weight.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hid2.agents import FloatArray, IntArray

#: Steps of the recurrences: from variant to variant, seed to seed, kind to kind. No tunables: any numbers that are far
#: from every fraction do (the golden ratio, roots of 2 and 3, the plastic number).
_VARIANT, _SEED, _KIND = 0.6180339887498949, 0.4142135623730951, 0.7320508075688773
#: Shift of the first place with each round, and each lap beyond the count. No tunable: far from every fraction too.
_LAP = 0.3247179572447460


@dataclass(frozen=True, slots=True)
class Spread:
    """Where in the line of sites a scene begins: offset in [0, 1), by seed and variant; base, by scene."""

    base: float
    offset: float

    @classmethod
    def of(cls, seed: Sequence[int]) -> "Spread":
        """Of (seed, variant, scene): `Filling.seed`."""
        number, variant, *scene = [*seed, 0, 0][: max(3, len(seed))]
        base = float(np.random.default_rng([*scene, 0x5EED]).random())
        return cls(base, (number * _SEED + variant * _VARIANT) % 1.0)

    def order(
        self, weight: FloatArray, rng: np.random.Generator, *, number: int, of: int, kind: int, round_number: int
    ) -> IntArray:
        """Order in which sites of some weight (N,) are looked at by vehicle `number` of `of` of a kind.

        Those without any weight are left out.
        """
        order = by_weight(weight, rng)
        if not order.size:
            return order
        lap, place = divmod(number, max(1, of))
        share = (place + (self.offset + kind * _KIND) % 1.0) / max(1, of)
        line = np.cumsum(weight)
        at = (self.base + share + (lap + round_number) * _LAP) % 1.0
        first = min(int(np.searchsorted(line, at * line[-1], side="right")), int(order.max()))
        return np.concatenate([[first], order[order != first]])


def by_weight(weight: FloatArray, rng: np.random.Generator) -> IntArray:
    """Sites of some weight (N,) in weighted random order."""
    key = rng.exponential(size=weight.size)
    with_weight = np.flatnonzero(weight > 0.0)
    return with_weight[np.argsort(key[with_weight] / weight[with_weight], kind="stable")]
