"""Random numbers of one stream, for many small decisions."""

import numpy as np

from hid2.agents import FloatArray

_BLOCK = 256


class Draws:
    """Numbers of a generator, drawn in blocks: one by one they cost more than the decisions they are for."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._units: list[float] = []
        self._normals: list[float] = []

    def unit(self) -> float:
        """Uniform in [0, 1)."""
        if not self._units:
            self._units = self._rng.random(_BLOCK).tolist()
        return self._units.pop()

    def uniform(self, low: float, high: float) -> float:
        """Uniform in [low, high)."""
        return low + (high - low) * self.unit()

    def normal(self) -> float:
        """Standard normal."""
        if not self._normals:
            self._normals = self._rng.standard_normal(_BLOCK).tolist()
        return self._normals.pop()

    def index(self, count: int) -> int:
        """One of 0 .. count - 1, each as likely."""
        return int(count * self.unit())

    def permutation(self, count: int) -> list[int]:
        """0 .. count - 1 in random order."""
        order: list[int] = self._rng.permutation(count).tolist()
        return order

    def between(self, low: FloatArray, high: FloatArray) -> list[float]:
        """For each pair of bounds (M,) a number between them."""
        drawn: list[float] = (low + (high - low) * self._rng.random(low.size)).tolist()
        return drawn
