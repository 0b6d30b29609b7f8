"""Agents of a scene: recorded and generated tracks, policies, and the sizes of boxes by object type."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hid2.policies import Policy as Policy
from netconvert.geometry import FloatArray as FloatArray
from netconvert.geometry import IntArray as IntArray


class BoxSize(NamedTuple):
    """An oriented box: along its heading, and across."""

    length_m: float
    width_m: float


#: Track id of the recording vehicle (Argoverse 2).
AV_ID = "AV"
#: Box of a track without one, by object type: medians of labelled boxes, rounded; cars a little larger to be safe.
DEFAULT_SIZES: Mapping[str, BoxSize] = {
    "vehicle": BoxSize(4.5, 1.9),
    "bus": BoxSize(11.0, 2.8),
    "motorcyclist": BoxSize(2.2, 0.9),
    "cyclist": BoxSize(1.8, 0.6),
    "riderless_bicycle": BoxSize(1.6, 0.5),
    "pedestrian": BoxSize(0.6, 0.6),
    "static": BoxSize(0.8, 0.8),
    "background": BoxSize(0.8, 0.8),
    "construction": BoxSize(0.8, 0.8),
    "unknown": BoxSize(0.8, 0.8),
}
#: Distance of the rear axle behind the middle of a vehicle's box over the box's length: 1.4 m of the recording car's.
REAR_AXLE_SHARE = 0.3

#: Categories (Argoverse 2) of tracks that forecasts are scored on, and of the focal track, which matters most of these.
SCORED_CATEGORY, FOCAL_CATEGORY = 2, 3
#: Object types that drive on lanes, and all that follow on roads and obey signals.
VEHICLE_TYPES = frozenset({"vehicle", "bus"})
ROAD_TYPES = VEHICLE_TYPES | {"motorcyclist", "cyclist"}


@dataclass(frozen=True, eq=False, slots=True, repr=False)
class Track:
    """One agent over time, recorded or generated.

    timesteps (T,) strictly increasing, not always without gaps; position (T, 2) m, box centre, city frame;
    heading (T,) rad in (-pi, pi]; velocity (T, 2) m/s; category 0 fragment, 1 context, 2 scored, 3 focal.
    """

    track_id: str
    object_type: str
    category: int
    timesteps: IntArray
    position: FloatArray
    heading: FloatArray
    velocity: FloatArray
    size: BoxSize

    def __repr__(self) -> str:
        """Id, type, and when it is there."""
        there = f"timesteps {self.timesteps[0]} to {self.timesteps[-1]}" if len(self.timesteps) else "never there"
        return f"Track({self.track_id}, {self.object_type}, {there})"

    @property
    def speed(self) -> FloatArray:
        """(T,) m/s."""
        return np.asarray(np.hypot(self.velocity[:, 0], self.velocity[:, 1]), dtype=np.float64)

    @property
    def path_m(self) -> float:
        """Length of the path driven, m."""
        return float(np.hypot(*np.diff(self.position, axis=0).T).sum())
