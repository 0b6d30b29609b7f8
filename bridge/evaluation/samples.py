"""Windows of driving for the critics: all of them, or a fair sample of fixed size where there are more."""

import hashlib

import numpy as np

from hid2.agents import FloatArray
from hid2.evaluation.critics import WIDTH, Packed
from hid2.measures.arrays import BoolArray

#: Most generated, and most recorded, windows that the critics look at.
MOST_OF_A_KIND = 4000
#: Windows that are collected before those that are too much are dropped.
_BATCH = 1000


class Samples:
    """The windows with the smallest hashes, up to `most` generated and `most` recorded ones.

    A window's hash is drawn from the name of its scene, so that which ones are kept does not depend on the order of
    the scenes, and the memory not on their number.
    """

    def __init__(self, *, most: int = MOST_OF_A_KIND) -> None:
        self._most = most
        self._rows: FloatArray = np.empty((0, WIDTH))
        self._generated: BoolArray = np.empty(0, dtype=bool)
        self._hashes: FloatArray = np.empty(0)
        self._sources: list[str] = []
        self._waiting: list[tuple[FloatArray, BoolArray, FloatArray]] = []

    def __len__(self) -> int:
        return len(self._sources)

    def add(self, rows: FloatArray, generated: BoolArray, *, scene: str, source: str) -> None:
        """Offer windows of a scene: rows (M, WIDTH), generated (M,). `source`: the scene that it was made from."""
        seed = hashlib.blake2b(scene.encode(), digest_size=8).digest()
        hashes = np.random.default_rng(int.from_bytes(seed)).random(len(rows))
        self._waiting.append((rows, generated, hashes))
        self._sources += [source] * len(rows)
        if len(self._sources) > len(self._rows) + _BATCH:
            self._keep()

    def packed(self) -> Packed:
        """The windows kept; scenes are numbered in the order of their sources' names."""
        self._keep()
        # by source and content, so that the order in which scenes came does not matter
        order = sorted(range(len(self._sources)), key=lambda k: (self._sources[k], self._hashes[k]))
        number = {name: k for k, name in enumerate(sorted(set(self._sources)))}
        scene = np.array([number[self._sources[k]] for k in order], dtype=np.int64)
        return Packed(self._rows[order], self._generated[order], scene)

    def joined(self, other: "Samples") -> Packed:
        """Recorded windows of this one with the generated ones of another: what a control is judged on."""
        both = Samples(most=self._most)
        for samples, kind in ((self, False), (other, True)):
            samples._keep()  # of the same class
            chosen = np.flatnonzero(samples._generated == kind)
            both._waiting.append((samples._rows[chosen], samples._generated[chosen], samples._hashes[chosen]))
            both._sources += [samples._sources[k] for k in chosen]
        return both.packed()

    def _keep(self) -> None:
        """Join what came in, and drop what is too much."""
        if not self._waiting:
            return
        rows = np.concatenate([self._rows, *(each[0] for each in self._waiting)])
        generated = np.concatenate([self._generated, *(each[1] for each in self._waiting)])
        hashes = np.concatenate([self._hashes, *(each[2] for each in self._waiting)])
        kept = np.zeros(len(hashes), dtype=bool)
        for kind in (True, False):
            members = np.flatnonzero(generated == kind)
            kept[members[np.argsort(hashes[members], kind="stable")[: self._most]]] = True
        self._rows, self._generated, self._hashes = rows[kept], generated[kept], hashes[kept]
        self._sources = [self._sources[k] for k in np.flatnonzero(kept)]
        self._waiting = []
