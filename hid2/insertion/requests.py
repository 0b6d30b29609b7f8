"""What is asked for in a scene: how many vehicles do what, and when."""

import math

import numpy as np

from hid2.agents import Policy
from hid2.params import Config, Request
from hid2.vehicle import VehicleRequest


def draw_requests(config: Config, rng: np.random.Generator, *, count: int, duration_s: float) -> list[VehicleRequest]:
    """`count` requests for a scene of some duration, s.

    The mix by drawn rounding, so that a share of 5 % of 10 is one vehicle in every other scene.
    """
    request = config.request
    policies = draw_mix(dict(request.behaviours), rng, count=count)
    return [
        VehicleRequest(number=number, policy=policy, trigger_s=draw_trigger(request, rng, duration_s, policy=policy))
        for number, policy in enumerate(policies)
    ]


def draw_mix(shares: dict[Policy, float], rng: np.random.Generator, *, count: int) -> list[Policy]:
    """Policies in proportion: whole parts as they are, and the rest drawn by systematic sampling (sums to count)."""
    total = sum(shares.values())
    offset, upto, before = float(rng.random()), 0.0, 0
    found: list[Policy] = []
    for policy in Policy:
        upto += count * shares[policy] / total
        until = min(max(math.floor(upto + offset), before), count)
        found += [policy] * (until - before)
        before = until
    last = max((policy for policy in Policy if shares[policy] > 0), key=list(Policy).index)
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
        share = request.trigger_overtake_share if overtakes else request.trigger_usual_share
        high = min(request.trigger_usual_s, share * duration_s)
    return low if high <= low else float(rng.uniform(low, high))
