"""SUMO's car-following law without its noise: EIDM, the Extended Intelligent Driver Model (Salles et al. 2020).

    v_next = what SUMO 1.28 makes of a speed, a desired speed, a leader and a limit that is set for the step

IIDM (Treiber, Kesting) with coolness, action points (the driver looks anew each `reaction`, and at once before hard
braking), a desired speed that is taken up within seconds, and a slow start. The constants are SUMO's defaults, the
random errors of perception are left out. SUMO takes ballistic steps as soon as a type of vehicle has an action step of
its own, as the replayed ones have, and EIDM then bounds no jerk and has no driving error.
"""

import numpy as np

from hid2.kernels.compiled import inner
from netconvert.geometry import FloatArray

#: Columns of a driver's state: steps since its last look; own speed, leader's speed and gap seen at that look;
#: acceleration wanted at that look, least one wanted since, own and the leader's, m/s2; desired speed taken up so far
#: and the one left, m/s; time of driving off, s. Within a step: least acceleration wanted, own and the leader's.
(
    _SINCE, _SEEN_V, _SEEN_LEAD_V, _SEEN_GAP, _WANTED, _WOULD, _DID, _LEAD_DID, _TAKEN_UP, _TAKEN_FROM, _OFF_S, _WANTS,
    _DOES, _LEAD_DOES,
) = range(14)  # fmt: skip
DRIVER_STATE = 14  # number of these columns
_EPS = 0.001  # tolerance of numbers, whatever their unit
_NOTHING = 100.0  # m/s2, above every acceleration: none is wanted yet
_COOLNESS = 0.99
_SUDDEN_MPS2 = 1.0  # drop of the acceleration wanted, since the last look, above which a driver looks anew
PREVIEW_S = 4.0  # time over which a desired speed is taken up
_FREE_GAP_M = 500.0  # gap to a leader at the desired speed, which a free road is taken for
_EMERGENCY_MPS2 = 9.0
_HALTING_MPS, _SLOW_MPS = 0.1, 3.0
_GAP_MORE_M, _GAP_LESS_M = 0.05, 0.25  # added to the gap at standstill that is desired, taken off the one that is seen
_OFF_S_LONG, _OFF_FLAT, _OFF_BEGINS, _OFF_AGAIN_S, _OFF_BELOW_MPS = 1.2, 2.0, 0.7, 4.0, 0.5


@inner
def new_driver(state: FloatArray, desired_mps: float) -> None:
    """Set the state of a driver that has just come."""
    state[:] = 0.0
    state[_TAKEN_UP] = state[_TAKEN_FROM] = max(desired_mps, _EPS)
    state[_WOULD] = state[_WANTS] = state[_DOES] = state[_LEAD_DOES] = _NOTHING
    state[_OFF_S] = -10.0


@inner
def _iidm(v: float, desired: float, star: float, gap: float, accel: float, decel: float) -> float:
    """Acceleration by the Improved IDM, m/s2; star m: the gap that is desired."""
    near: float = accel * (1.0 - (star / gap) ** 2)
    if v > desired:
        slower: float = -decel * (1.0 - (desired / v) ** (4.0 * accel / decel))
        return slower + near if star >= gap else slower
    if star >= gap:
        return near
    free: float = accel * (1.0 - (v / desired) ** 4)
    less: float = (star / gap) ** (2.0 * accel / max(free, 1e-12))
    return free * (1.0 - less)


@inner
def _cool(a: float, v: float, lead_v: float, lead_a: float, gap: float, decel: float) -> float:
    """An acceleration blended with that of the constant-acceleration heuristic (CAH), m/s2."""
    if lead_v * (v - lead_v) <= -2.0 * gap * lead_a:
        cah = v * v * lead_a / (lead_v * lead_v - 2.0 * gap * lead_a)
    elif v >= lead_v:
        cah = lead_a - (v - lead_v) ** 2 / (2.0 * gap)
    else:
        cah = lead_a
    if a >= cah:
        return a
    cool: float = cah + decel * np.tanh((a - cah) / decel)
    return (1.0 - _COOLNESS) * a + _COOLNESS * cool


@inner
def _response(
    state: FloatArray, v: float, most: float, gap: float, lead_v: float, lead_a: float,
    is_limit: bool,  # noqa: FBT001  # kernels have no keywords
    driver: tuple[float, float, float, float], reaction: float, step_s: float, time_s: float,
) -> float:  # fmt: skip
    """Speed after the step for one leader, m/s; the least acceleration wanted for any of them is kept, as in SUMO.

    gap m: beyond the one at standstill; lead_a m/s2, inf where no agent leads; most m/s: highest speed after the step;
    is_limit: it stands for a lower desired speed.
    """
    tau, accel, decel, min_gap = driver
    gap = max(_EPS, gap + max(_EPS, min_gap - _GAP_LESS_M))
    since = state[_SINCE] * step_s
    seen_v, seen_lead_v, seen_gap = v, lead_v, gap
    if since > 0.0:  # extrapolated from the last look
        seen_v = max(state[_SEEN_V] + state[_DID] * since, 0.0)
        seen_lead_v = max(state[_SEEN_LEAD_V] + state[_LEAD_DID] * since, 0.0)
        if not is_limit:
            seen_gap = state[_SEEN_GAP] - 0.5 * (state[_SEEN_V] + seen_v - state[_SEEN_LEAD_V] - seen_lead_v) * since
    root, standing = 2.0 * np.sqrt(accel * decel), min_gap + _GAP_MORE_M
    star = max(0.0, seen_v * tau + seen_v * (seen_v - seen_lead_v) / root) + standing
    if seen_gap < min_gap + (step_s * 10.0 + 1.0) * _GAP_MORE_M and seen_v < _SLOW_MPS:  # no creeping
        star = max(star, seen_gap * np.sqrt(1.0 + 2.0 * _GAP_MORE_M / accel))
    a = _iidm(seen_v, state[_TAKEN_UP], star, seen_gap, accel, decel)
    wants = (max(0.0, seen_v + a * step_s) - seen_v) / step_s
    star_now = max(0.0, v * tau + v * (v - lead_v) / root) + standing
    would = _iidm(v, state[_TAKEN_UP], star_now, gap, accel, decel)
    state[_WOULD] = min(state[_WOULD], (max(0.0, v + would * step_s) - v) / step_s)
    decides, follows = state[_WANTS] > wants - _EPS, _EPS
    if decides:
        if lead_a < np.inf and seen_lead_v >= _HALTING_MPS:
            follows = min(lead_a, accel) * min(1.0, 1.5 * star / seen_gap)
        if state[_OFF_S] + _OFF_S_LONG + _EPS < time_s and v > _HALTING_MPS:
            a = _cool(a, seen_v, max(seen_lead_v, _HALTING_MPS), follows, seen_gap, decel)
    v_next = max(0.0, v + a * step_s)
    does = (min(v_next, most) - v) / step_s
    if not decides:
        return max(0.0, v + state[_DOES] * step_s) if state[_DOES] > does else v_next
    if since == 0.0:
        state[_SEEN_V], state[_SEEN_LEAD_V] = v, lead_v
        state[_SEEN_GAP] = gap + reaction * v if is_limit else gap
    state[_WANTS], state[_DOES], state[_LEAD_DOES] = wants, min(state[_DOES], does), follows
    return v_next


@inner
def _gap_for_limit(
    state: FloatArray, v: float, limit: float, driver: tuple[float, float, float, float], reaction: float, step_s: float
) -> float:
    """Gap to a standing leader, m, at which a driver brakes as for a lower desired speed from the next cell on."""
    tau, accel, decel, _ = driver
    seen = v + (state[_SEEN_V] - v + state[_DID] * state[_SINCE] * step_s if state[_SINCE] > 0.0 else 0.0)
    ratio = 1.0 + (v - limit) / (accel * max(0.5 * reaction, step_s))
    if seen > state[_TAKEN_UP]:
        ratio -= decel * (1.0 - (state[_TAKEN_UP] / seen) ** (4.0 * accel / decel)) / accel
    star = max(0.0, seen * tau + seen * seen / (2.0 * np.sqrt(accel * decel)))
    gap: float = star / np.sqrt(max(ratio, 1.0))
    return gap


@inner
def _take_up(state: FloatArray, desired: float, step_s: float) -> None:
    """The desired speed that a driver is at comes nearer to the one it has, m/s."""
    taken, left = state[_TAKEN_UP], state[_TAKEN_FROM]
    if abs(left - desired) < _EPS and abs(left - taken) < _EPS:
        return
    fell = taken < left + _EPS and taken < desired + _EPS and left > desired - _EPS
    rose = taken > left - _EPS and taken > desired - _EPS and left < desired + _EPS
    if fell or rose:  # it went beyond and turns round
        state[_TAKEN_FROM] = taken
    else:
        eased = taken - (left - desired) * step_s / PREVIEW_S
        taken = max(desired, eased) if taken >= desired - _EPS else min(desired, eased)
    state[_TAKEN_UP] = taken
    if abs(taken - desired) < _EPS:
        state[_TAKEN_UP] = state[_TAKEN_FROM] = desired


@inner
def _driven_off(state: FloatArray, v: float, a: float, v_next: float, accel: float, time_s: float) -> float:
    """Speed after a step of a driver that would gain speed, m/s: less of it while it drives off."""
    again = state[_OFF_S] + _OFF_AGAIN_S - _EPS < time_s and state[_SINCE] == 0.0
    if v < _OFF_BELOW_MPS and again and a < min(0.25 * accel, 0.2):
        state[_OFF_S] = time_s
    if state[_OFF_S] + _OFF_S_LONG + _EPS <= time_s:
        return v_next
    passed = 2.0 * (time_s - state[_OFF_S]) / _OFF_S_LONG
    share: float = 0.5 * (np.tanh((passed - _OFF_BEGINS) * _OFF_FLAT) + 1.0)
    return v + (v_next - v) * share


@inner
def eidm_speed(
    state: FloatArray, v: float, a: float, desired: tuple[float, float], leader: tuple[float, float, float],
    limit: float, driver: tuple[float, float, float, float], reaction: float, step_s: float, time_s: float,
) -> float:  # fmt: skip
    """Speed after a step, m/s, of a driver with speed v m/s, acceleration a m/s2 and the state that it keeps.

    desired m/s: the highest speed now, and the one that is taken up for what is ahead; leader: bumper gap m, inf for
    none, its speed m/s and acceleration m/s2; limit m/s: what setSpeed allows, inf for none; driver: tau s,
    acceleration, deceleration m/s2 and gap at standstill m, as SUMO has them; reaction s; time_s: since some moment.
    """
    _, accel, decel, min_gap = driver
    gap, lead_v, lead_a = leader
    most = min(v + accel * step_s, desired[0])
    if desired[0] < v:
        ahead = _gap_for_limit(state, v, desired[0], driver, reaction, step_s)
        free = _response(state, v, most, ahead, 0.0, lead_a, True, driver, reaction, step_s, time_s)
    else:
        free = _response(state, v, most, _FREE_GAP_M, desired[0], lead_a, False, driver, reaction, step_s, time_s)
    safe = min(most, limit, max(free, v - decel * step_s))
    if gap < np.inf:
        follow = _response(state, v, most, gap - min_gap, lead_v, lead_a, False, driver, reaction, step_s, time_s)
        safe = min(safe, follow)
    v_next = max(min(max(v - decel * step_s, 0.0), max(safe, v - _EMERGENCY_MPS2 * step_s)), safe)
    if v_next > v:
        v_next = _driven_off(state, v, a, v_next, accel, time_s)
    _take_up(state, desired[1], step_s)
    if state[_SINCE] == 0.0:
        state[_WANTED] = state[_WOULD] = state[_WANTS]
        state[_DID], state[_LEAD_DID] = state[_DOES], state[_LEAD_DOES]
    state[_SINCE] = 0.0 if state[_SINCE] >= reaction / step_s - 1.0 - _EPS else state[_SINCE] + 1.0
    suddenly = state[_WOULD] - state[_WANTED] < -_SUDDEN_MPS2 or state[_WOULD] < -_EMERGENCY_MPS2
    if suddenly or (v < _SLOW_MPS and v_next < v):
        state[_SINCE] = 0.0
    state[_WANTS] = state[_DOES] = state[_LEAD_DOES] = _NOTHING
    return safe if limit < np.inf else v_next  # a limit that is set overrides how SUMO drives off
