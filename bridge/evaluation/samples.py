"""Windows of driving for the critics: all of them, or a fair sample of fixed size where there are more."""

import hashlib
import heapq

import numpy as np

from hid2.agents import FloatArray
from hid2.evaluation.critics import WIDTH, Packed
from hid2.measures.arrays import BoolArray

#: Most generated, and most recorded, windows that the critics look at.
MOST_OF_A_KIND = 4000


class Samples:
    """The windows with the smallest hashes, up to `most` generated and `most` recorded ones.

    A window's hash is drawn from the name of its scene, so that which ones are kept does not depend on the order of
    the scenes, and the memory not on their number.
    """

    def __init__(self, *, most: int = MOST_OF_A_KIND) -> None:
        self._most = most
        #: Of each kind, by whether it is generated: hash, source and row of each window.
        self._kept: dict[bool, list[tuple[float, str, FloatArray]]] = {False: [], True: []}

    def add(self, rows: FloatArray, generated: BoolArray, *, scene: str, source: str) -> None:
        """Offer windows of a scene: rows (M, WIDTH), generated (M,). `source`: the scene that it was made from."""
        seed = hashlib.blake2b(scene.encode(), digest_size=8).digest()
        hashes = np.random.default_rng(int.from_bytes(seed)).random(len(rows)).tolist()
        for number, row, kind in zip(hashes, rows, generated.tolist(), strict=True):
            self._kept[kind].append((number, source, row.copy()))  # a part of `rows` would keep all of them
        self._kept = {
            kind: heapq.nsmallest(self._most, kept, key=lambda one: one[0]) for kind, kept in self._kept.items()
        }

    def packed(self) -> Packed:
        """The windows kept; scenes are numbered in the order of their sources' names."""
        every = [(source, number, kind, row) for kind in (True, False) for number, source, row in self._kept[kind]]
        every.sort(key=lambda one: one[:2])  # so that the order in which scenes came does not matter
        scene = np.unique([one[0] for one in every], return_inverse=True)[1]
        rows = np.array([one[3] for one in every]).reshape(-1, WIDTH)
        return Packed(rows, np.array([one[2] for one in every], dtype=bool), scene.astype(np.int64))

    def joined(self, other: "Samples") -> Packed:
        """Recorded windows of this one with the generated ones of another: what a control is judged on."""
        both = Samples(most=self._most)
        both._kept = {False: self._kept[False], True: other._kept[True]}  # of the same class
        return both.packed()
