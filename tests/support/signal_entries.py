"""When recorded vehicles pass the entrances that `InferredSignals` watches."""

import numpy as np

from hid2.conflicts.signals import InferredSignals


def entries(signals: InferredSignals, lane_id: int) -> np.ndarray | None:
    """(T,) whether a recorded vehicle's centre passes the lane's entrance at a step; None as in `red`."""
    approach = signals._approach(lane_id)
    return None if approach is None else signals._watch(approach).enters[lane_id]
