"""What vehicles meet: recorded traffic nearby, leaders, braking for them, crossing paths."""

import math
from enum import StrEnum
from itertools import permutations

import numpy as np

from hid2.agents import FloatArray, IntArray
from hid2.measures.arrays import STANDS_FOR_S, STANDS_MPS, BoolArray, SceneArrays
from hid2.measures.following import LaneLeaders, time_gaps
from hid2.measures.surrogates import encroachments
from netconvert.geometry import arc_length

#: Distance between centres, to every moving recorded vehicle, above which a vehicle meets no traffic, m.
NEAR_M = 30.0
#: Time gap below which a leader is followed, s.
FOLLOWS_S = 3.0
#: Least time below FOLLOWS_S for a leader to count as followed, s.
FOLLOWS_FOR_S = 1.0
#: Acceleration below which a vehicle brakes for a leader, m/s2.
BRAKES_MPS2 = -0.7
#: Least duration of braking for a leader, s.
BRAKES_FOR_S = 0.5
#: Gap below which a vehicle brakes for a leader, m.
BRAKES_NEAR_M = 40.0
#: Time gap below which a vehicle brakes for a leader, s.
BRAKES_NEAR_S = 4.0
#: PET below which crossing paths are an encounter, s.
WITHIN_S = 3.0
#: Least angle at which paths cross.
CROSSING_RAD = math.radians(40.0)
#: Least duration of what a vehicle meets, s, by the names of `meets_at`.
LASTS_S = {"follows": FOLLOWS_FOR_S, "brakes": BRAKES_FOR_S, "stands": STANDS_FOR_S}


class Partner(StrEnum):
    """Kinds of road users that a vehicle meets."""

    RECORDED = "recorded"
    INSERTED = "inserted"
    PEDESTRIAN = "pedestrian"
    CYCLIST = "cyclist"


def encounters(arrays: SceneArrays, led: LaneLeaders) -> dict[str, BoolArray]:
    """Which agents (A,) meet what, by name: `far`, `stands`, and `follows_`, `brakes_`, `crosses_` a `Partner`.

    led: `measures.following.leaders` of the same rows. Only vehicles follow, brake, cross or stand.
    """
    masks = partners(arrays)
    speed, slope = np.hypot(arrays.velocity[:, 0], arrays.velocity[:, 1]), _acceleration(arrays)
    has = led.agent >= 0
    leader = np.where(has, led.agent, 0)
    found = {f"crosses_{kind}": crossing for kind, crossing in _crosses(arrays, masks).items()}
    for kind in (Partner.RECORDED, Partner.INSERTED):
        at = meets_at(speed, slope, np.where(has & masks[kind][leader], led.gap_m, np.inf))
        for name in ("follows", "brakes"):
            found[f"{name}_{kind}"] = lasts(at[name], LASTS_S[name], arrays.step_s, arrays.agent, arrays.num_agents)
    stands = lasts(at["stands"], LASTS_S["stands"], arrays.step_s, arrays.agent, arrays.num_agents)
    found["stands"] = stands & arrays.vehicle
    found["far"] = _distance_to_moving(arrays, masks[Partner.RECORDED]) > NEAR_M
    return found


def partners(arrays: SceneArrays) -> dict[Partner, BoolArray]:
    """(A,) agents of each kind that can be met; recorded and inserted: vehicles, without tracker fragments."""
    vehicle = arrays.whole_vehicles
    return {
        Partner.RECORDED: np.asarray(vehicle & ~arrays.generated),
        Partner.INSERTED: np.asarray(vehicle & arrays.generated),
        Partner.PEDESTRIAN: np.isin(arrays.object_types, ["pedestrian"]),
        Partner.CYCLIST: np.isin(arrays.object_types, ["cyclist", "motorcyclist"]),
    }


def meets_at(speed_mps: FloatArray, accel_mps2: FloatArray, gap_m: FloatArray) -> dict[str, BoolArray]:
    """At which steps (N,) a vehicle follows or brakes for its leader, gap_m ahead, inf for none; or stands."""
    time_gap_s = time_gaps(gap_m, speed_mps)
    near = (gap_m < BRAKES_NEAR_M) & (time_gap_s < BRAKES_NEAR_S)
    return {
        "follows": time_gap_s < FOLLOWS_S,
        "brakes": near & (accel_mps2 < BRAKES_MPS2),
        "stands": speed_mps < STANDS_MPS,
    }


def _acceleration(arrays: SceneArrays) -> FloatArray:
    """(N,) m/s2 along the motion of each agent."""
    out = np.zeros(len(arrays.step))
    for agent in np.flatnonzero(arrays.vehicle).tolist():
        rows = slice(int(arrays.first[agent]), int(arrays.first[agent + 1]))
        out[rows] = acceleration(arc_length(arrays.position[rows]), arrays.step[rows], arrays.step_s)
    return out


def acceleration(way_m: FloatArray, steps: IntArray, step_s: float) -> FloatArray:
    """Slope (N,) m/s2 of the speed along a way (N,) m that is driven at steps (N,): over half a second each side.

    0 so near to the ends: there trackers show a third less speed than there is.
    """
    half, at, out = max(1, round(0.5 / step_s)), steps * step_s, np.zeros(len(steps))
    if len(steps) > 2 * half:
        inner, then, before = slice(half, -half), slice(2 * half, None), slice(None, -2 * half)
        faster = (way_m[then] - way_m[inner]) / (at[then] - at[inner])
        slower = (way_m[inner] - way_m[before]) / (at[inner] - at[before])
        out[inner] = 2.0 * (faster - slower) / (at[then] - at[before])
    return out


def lasts(holds: BoolArray, for_s: float, step_s: float, agent: IntArray, num_agents: int) -> BoolArray:
    """(A,) agents for which something holds for so long; agent (N,): that of each row, in order."""
    out, count = np.zeros(num_agents, dtype=bool), max(1, round(for_s / step_s))
    before, first = np.concatenate([[0], np.cumsum(holds)]), agent[: max(0, len(holds) - count + 1)]
    out[first[(before[count:] - before[:-count] == count) & (first == agent[count - 1 :])]] = True
    return out


def _distance_to_moving(arrays: SceneArrays, recorded: BoolArray) -> FloatArray:
    """(A,) m, least distance of a vehicle's centre to that of another vehicle that was recorded and moves."""
    out, others = np.full(arrays.num_agents, np.inf), np.flatnonzero(recorded & arrays.moving)
    for agent in np.flatnonzero(arrays.vehicle).tolist():
        rows = slice(int(arrays.first[agent]), int(arrays.first[agent + 1]))
        among = others[others != agent]
        if not among.size:
            continue
        row = arrays.row_of[among][:, arrays.step[rows]]
        offset = arrays.position[row] - arrays.position[rows]
        out[agent] = float(np.where(row >= 0, np.hypot(offset[..., 0], offset[..., 1]), np.inf).min(initial=np.inf))
    return out


def _crosses(arrays: SceneArrays, masks: dict[Partner, BoolArray]) -> dict[Partner, BoolArray]:
    """(A,) vehicles with a swept path that crosses that of a moving agent of a kind at a PET below WITHIN_S."""
    agents = np.flatnonzero(arrays.moving & np.logical_or.reduce(list(masks.values())))
    out = {kind: np.zeros(arrays.num_agents, dtype=bool) for kind in Partner}
    for *pair, pet_s, _ in encroachments(arrays, cap_s=WITHIN_S, agents=agents, crossing_rad=CROSSING_RAD):
        for one, other in permutations(pair) if pet_s <= WITHIN_S - 1e-9 else ():
            for kind in Partner:
                out[kind][one] |= bool(masks[kind][other] and arrays.vehicle[one])
    return out
