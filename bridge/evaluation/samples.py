"""Vehicles for the classifier test: all of them, or a fair sample of fixed size where there are more."""

import hashlib

import numpy as np

from hid2.agents import FloatArray
from hid2.evaluation.realism import DRIVING_FEATURES, MOTION_FEATURES, classifier_test
from hid2.measures.arrays import BoolArray

#: Most generated, and most recorded, vehicles that the test looks at.
MOST_OF_A_KIND = 5000
#: Vehicles that are collected before those that are too much are dropped.
_BATCH = 1000


class Samples:
    """The vehicles with the smallest hashes, up to `most` generated and `most` recorded ones.

    A vehicle's hash is drawn from the name of its scene, so that which ones are kept does not depend on the order of
    the scenes, and the memory not on their number.
    """

    def __init__(self, *, most: int = MOST_OF_A_KIND) -> None:
        self._most = most
        self._vectors: FloatArray = np.empty((0, len(DRIVING_FEATURES) + len(MOTION_FEATURES)))
        self._generated: BoolArray = np.empty(0, dtype=bool)
        self._hashes: FloatArray = np.empty(0)
        self._sources: list[str] = []
        self._waiting: list[tuple[FloatArray, BoolArray, FloatArray]] = []

    def __len__(self) -> int:
        return len(self._sources)

    @property
    def vectors(self) -> FloatArray:
        """(M, K) what `test` looks at, as of the last time that samples were joined."""
        return self._vectors

    def add(self, vectors: FloatArray, generated: BoolArray, *, scene: str, source: str) -> None:
        """Offer vehicles of a scene: vectors (M, K), generated (M,). `source`: the scene that it was made from."""
        seed = hashlib.blake2b(scene.encode(), digest_size=8).digest()
        hashes = np.random.default_rng(int.from_bytes(seed)).random(len(vectors))
        self._waiting.append((vectors, generated, hashes))
        self._sources += [source] * len(vectors)
        if len(self._sources) > len(self._vectors) + _BATCH:
            self._keep()

    def test(self, columns: int | None = None) -> float | None:
        """AUC of a classifier on the first `columns` features (None: all); None where there is nothing to tell."""
        self._keep()
        return classifier_test(self._vectors[:, :columns], self._generated, self._sources)

    def _keep(self) -> None:
        """Join what came in, and drop what is too much."""
        vectors = np.concatenate([self._vectors, *(each[0] for each in self._waiting)])
        generated = np.concatenate([self._generated, *(each[1] for each in self._waiting)])
        hashes = np.concatenate([self._hashes, *(each[2] for each in self._waiting)])
        kept = np.zeros(len(hashes), dtype=bool)
        for kind in (True, False):
            members = np.flatnonzero(generated == kind)
            kept[members[np.argsort(hashes[members], kind="stable")[: self._most]]] = True
        self._vectors, self._generated, self._hashes = vectors[kept], generated[kept], hashes[kept]
        self._sources = [self._sources[k] for k in np.flatnonzero(kept)]
        self._waiting = []
