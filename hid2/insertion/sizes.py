"""Sizes of inserted vehicles: quantiles of labelled Argoverse 2 boxes (human labels of sensor logs)."""

import numpy as np

from hid2.agents import BoxSize
from hid2.params import Request

_Table = tuple[tuple[float, float, float], ...]
#: (share, length m, width m) of cars, box trucks and buses. No tunables: measured; shares of buses and trucks are.
_CAR = ((0.0, 3.8, 1.72), (0.1, 4.0, 1.76), (0.5, 4.2, 1.87), (0.9, 5.2, 2.05), (1.0, 5.6, 2.12))
_TRUCK = ((0.0, 7.0, 2.3), (0.5, 9.6, 2.6), (1.0, 10.5, 2.7))
_BUS = ((0.0, 10.5, 2.7), (0.5, 11.6, 2.9), (1.0, 12.3, 2.95))


def draw_size(request: Request, rng: np.random.Generator) -> tuple[str, BoxSize]:
    """Object type and box of a vehicle; trucks are of type vehicle, as in the data set."""
    kind, share = float(rng.random()), float(rng.random())
    if kind < request.bus_share:
        return "bus", _quantile(_BUS, share)
    return "vehicle", _quantile(_TRUCK if kind < request.bus_share + request.truck_share else _CAR, share)


def _quantile(table: _Table, share: float) -> BoxSize:
    """Linear between the rows of a table; share from 0 to below 1."""
    shares, *columns = np.array(table).T
    return BoxSize(*(round(float(np.interp(share, shares, column)), 3) for column in columns))
