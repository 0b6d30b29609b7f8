"""What is asked for in a scene: how many vehicles do what, and when, and how large they are."""

import math

import numpy as np

from hid2.agents import BoxSize, Policy
from hid2.params import Config, Request
from hid2.vehicle import VehicleRequest

#: Latest trigger where no `request.trigger_max_s` is asked for, s. No tunable: `request.trigger_max_s` is.
_LATEST_S = 4.0
#: Latest trigger over the scene's duration, without `request.trigger_max_s`. No tunable: `request.trigger_max_s` is.
_LATEST_SHARE = 0.36
#: Latest trigger of overtakes, which take 8 s and more, over the scene's duration. No tunable: `trigger_max_s` is.
_LATEST_OVERTAKE_SHARE = 0.14
_Table = tuple[tuple[float, float, float], ...]
#: (share, length m, width m) of cars, box trucks and buses: quantiles of labelled Argoverse 2 boxes (human labels of
#: sensor logs). No tunables: measured; shares of buses and trucks are.
_CAR = ((0.0, 3.8, 1.72), (0.1, 4.0, 1.76), (0.5, 4.2, 1.87), (0.9, 5.2, 2.05), (1.0, 5.6, 2.12))
_TRUCK = ((0.0, 7.0, 2.3), (0.5, 9.6, 2.6), (1.0, 10.5, 2.7))
_BUS = ((0.0, 10.5, 2.7), (0.5, 11.6, 2.9), (1.0, 12.3, 2.95))


def draw_requests(config: Config, rng: np.random.Generator, *, count: int, duration_s: float) -> list[VehicleRequest]:
    """`count` requests for a scene of some duration, s.

    The mix by drawn rounding, so that a share of 5 % of 10 is one vehicle in every other scene.
    """
    request = config.request
    policies = draw_mix(dict(request.behaviours), rng, count=count)
    return [
        VehicleRequest(number, policy, draw_trigger(request, rng, duration_s, policy=policy), *draw_size(request, rng))
        for number, policy in enumerate(policies)
    ]


def draw_mix(shares: dict[Policy, float], rng: np.random.Generator, *, count: int) -> list[Policy]:
    """Policies in proportion: whole parts as they are, and the rest drawn by systematic sampling (sums to count)."""
    total = sum(shares.values())
    offset, upto, before = float(rng.random()), 0.0, 0
    found: list[Policy] = []
    for policy, share in shares.items():
        upto += count * share / total
        until = min(max(math.floor(upto + offset), before), count)
        found += [policy] * (until - before)
        before = until
    last = [policy for policy, share in shares.items() if share > 0][-1]
    return found + [last] * (count - len(found))


def draw_trigger(
    request: Request, rng: np.random.Generator, duration_s: float, *, policy: Policy = Policy.STRAIGHT
) -> float:
    """t_trigger, s: exactly as asked for, one of a list, or uniform in a range; never cut to suit a place.

    Where nothing is asked for the range ends at what is usual for a policy in scenes of this duration, s.
    """
    if request.trigger_list_s:
        return float(request.trigger_list_s[int(rng.integers(len(request.trigger_list_s)))])
    low, high = request.trigger_min_s, request.trigger_max_s
    if high is None:
        share = _LATEST_OVERTAKE_SHARE if policy is Policy.OVERTAKE else _LATEST_SHARE
        high = min(_LATEST_S, share * duration_s)
    return low if high <= low else float(rng.uniform(low, high))


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
