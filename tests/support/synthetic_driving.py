"""Windows of drivers whose parameters are known: what a calibration has to find again."""

from functools import partial

import numpy as np

from hid2.drivers.driver import desired_speeds, draw_driver, lane_offset, place_of_lane
from hid2.evaluation.calibration import SceneDriving
from hid2.evaluation.windows import WINDOW
from hid2.params import Config, Drivers

KNOWN = Drivers(
    desired_sd=0.18, wander_sd_mps=0.5, wander_time_s=2.0, tau_mean_s=1.4, tau_sd_s=0.3, offset_mean_m=0.15,
    offset_sd_m=0.25, lateral_wander_sd_m=0.12, lateral_wander_spread=0.5, lateral_wander_time_s=2.0,
    lane_change_mean_s=4.8, lane_change_sd_s=0.6, min_gap_mean_m=2.2, min_gap_sd_m=0.3,
)  # fmt: skip


def synthetic_driving(known: Drivers, *, drivers: int, seed: int) -> SceneDriving:
    """Drivers of `known` alone on a lane whose traffic drives 9 m/s, and half as many behind a leader."""
    config, rng = Config(drivers=known), np.random.default_rng(seed)
    time = 0.1 * np.arange(41) - 2.0
    parabola = np.linalg.pinv(np.vander(time, 3, increasing=True))
    cubic = np.linalg.pinv(np.vander(time, 4, increasing=True))
    rows = []
    people = [draw_driver(config, rng, lane_speed_mps=9.0) for _ in range(drivers)]
    for number, who in enumerate(people):
        led = number % 3 == 0
        v = desired_speeds(who, config, rng, num_steps=110, step_s=0.1, at_least_mps=0.0)
        v = 0.2 * (v - v.mean()) + v.mean() if led else v  # a platoon at an even pace
        s = np.concatenate([[0.0], np.cumsum(0.05 * (v[1:] + v[:-1]))])
        usual = partial(np.full_like, fill_value=place_of_lane(known, number))  # a lane of its own
        d, _ = lane_offset(who, config, rng, length_m=s[-1] + 20.0, pace_mps=v.mean(), usual=usual).at(5.0 + s)
        for begin in range(10, 60, 5):
            part = slice(begin, begin + 41)
            along, across = cubic @ s[part], parabola @ d[part]
            gap = known.min_gap_mean_m + who.tau_s * along[1] if led else np.inf
            rows.append((number, along[1:], across, gap, led))
    seen = np.zeros(len(rows), dtype=WINDOW)
    seen["agent"], along, across, seen["gap_m"], seen["led"] = (np.array(part) for part in zip(*rows, strict=True))
    seen["scene"], seen["speed_mps"] = "synthetic", along[:, 0]
    seen["accel_mps2"], seen["jerk_mps3"] = 2.0 * along[:, 1], 6.0 * along[:, 2]
    seen["offset_m"], seen["drift_mps"], seen["bend_mps2"] = across.T
    return SceneDriving(
        "synthetic", "city", False, seen, np.array([who.min_gap_m for who in people]),
        np.array([who.lane_change_s for who in people[: drivers // 2]]),
    )  # fmt: skip
