"""One vehicle as a vector of features of its driving."""

import numpy as np

from hid2.kernels.compiled import inner, kernel
from netconvert.geometry import FloatArray


@inner
def _quantile(values: FloatArray, share: float) -> float:
    """As numpy.quantile."""
    ordered = np.sort(values)
    place = share * (len(ordered) - 1)
    below = int(place)
    above = min(below + 1, len(ordered) - 1)
    return float(ordered[below] + (place - below) * (ordered[above] - ordered[below]))


@kernel("(f8[::1], f8[::1], f8[::1], f8[::1], f8[::1], f8[::1], f8[::1], f8[::1],)")
def track_features_vector(
    speed: FloatArray, offset: FloatArray, direction: FloatArray, gap: FloatArray, accel: FloatArray,
    lateral: FloatArray, yaw_rate: FloatArray, jerk: FloatArray,
) -> FloatArray:  # fmt: skip
    """Values (16,) of DRIVING_FEATURES, then MOTION_FEATURES, of one track; gap: its finite time gaps, s."""
    out = np.zeros(16)
    out[0], out[1], out[2], out[3] = speed.mean(), speed.std(), speed.min(), speed.max()
    if len(offset):
        out[4], out[5] = offset.mean(), offset.std()
    turned = 0.0
    for k in range(len(direction) - 1):
        turned += (direction[k + 1] - direction[k] + np.pi) % (2 * np.pi) - np.pi
    out[6] = abs(turned)
    out[7] = min(_quantile(gap, 0.5), 10.0) if len(gap) else 10.0
    out[8] = len(gap) / len(speed)
    out[9], out[10] = accel.mean(), _quantile(accel, 0.95)
    out[11], out[12] = lateral.mean(), _quantile(lateral, 0.95)
    out[13] = yaw_rate.mean()
    out[14], out[15] = jerk.mean(), _quantile(jerk, 0.95)
    return out
