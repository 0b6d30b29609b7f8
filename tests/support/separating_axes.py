"""The separating axis test over arrays of corners: a reference beside the compiled one of hid2/kernels/boxes."""

import numpy as np

from netconvert.geometry import BoolArray, FloatArray


def boxes_overlap(corners_a: FloatArray, corners_b: FloatArray) -> BoolArray:
    """Whether boxes share ground, by the separating axis theorem; boxes that only touch do not.

    corners_a, corners_b: (..., 4, 2) m as box_corners gives them, broadcast against each other. Returns (...) bool.
    """
    shape = np.broadcast_shapes(corners_a.shape[:-2], corners_b.shape[:-2])
    apart = np.zeros(shape, dtype=np.bool_)
    for corners in (corners_a, corners_b):
        for first, second in ((0, 1), (1, 2)):
            axis = corners[..., first, :] - corners[..., second, :]
            a = np.einsum("...ij,...j->...i", corners_a, axis)
            b = np.einsum("...ij,...j->...i", corners_b, axis)
            apart |= (a.max(axis=-1) <= b.min(axis=-1)) | (b.max(axis=-1) <= a.min(axis=-1))
    return ~apart
