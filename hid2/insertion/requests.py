"""What is asked for in a scene: how many vehicles do what, and when, and how large they are."""

import math

import numpy as np

from hid2.agents import Policy
from hid2.insertion.sizes import draw_size
from hid2.params import Config, Request
from hid2.vehicle import VehicleRequest

#: Where no trigger_max_s is asked for, triggers are drawn up to so many seconds, and to this share of the scene; of
#: overtakes, which take 8 s and more, to the other. No tunables: `request.trigger_max_s` is.
_LATEST_S, _LATEST_SHARE, _LATEST_OVERTAKE_SHARE = 4.0, 0.36, 0.14


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
        overtakes = policy is Policy.OVERTAKE
        share = _LATEST_OVERTAKE_SHARE if overtakes else _LATEST_SHARE
        high = min(_LATEST_S, share * duration_s)
    return low if high <= low else float(rng.uniform(low, high))
