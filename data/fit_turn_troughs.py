"""Fit the shaping functions of turns, f_left and f_right, to recorded turns: how deep their troughs are, and where.

    python data/fit_turn_troughs.py PATH [PATH ...] [> TURN.toml]

PATH: scenario folders, split folders or roots of recorded data sets, as many as there are. A turn is counted where a
clean moving vehicle follows a turning lane of the map from near its start to near its end without stopping, turns as
the lane does, and its speed is known. Speeds, over that at the lane's entrance, are averaged by the median at each
share alpha of the lane, on each side, and v / v_0 = f(alpha) is fitted to them by least squares. A side with fewer than
20 turns keeps the documented prior, which is said. The result can be given to `hid2 generate --config`.
"""

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.signal import savgol_filter

from bridge.recordings.judging import recording_states
from bridge.recordings.recording import Recording
from bridge.recordings.sources import find_sources, read_recording
from hid2.agents import FloatArray
from hid2.measures.arrays import SceneArrays
from hid2.measures.driven_lanes import runs_of
from hid2.params import Turn
from hid2.policy.roads import turn_shape
from netconvert.lane_graph import TURN_RAD

#: Shares of a turning lane at which speeds are compared.
ALPHA = np.linspace(0.0, 1.0, 21)
#: Least turns of a side that a fit is made of.
LEAST_TURNS = 20
SIDES = {1: "left", -1: "right"}

_WINDOW, _DEGREE = 11, 2  # samples (1.1 s) and degree of the filter that speeds are derived with
_FROM, _TO = 0.1, 0.9  # shares of the lane between which a turn is seen at least
_STANDS_MPS = 1.0
_ACCEL_MPS2 = 5.0  # above it a change of speed is a tracker's, no driver's
_PLACES = np.round(np.arange(0.1, 0.6001, 0.01), 2)  # shares of the lane tried for the trough: early to mid-turn


def fit(profiles: Mapping[str, FloatArray]) -> dict[str, tuple[float, float, float]]:
    """Trough, its place and the rms difference for the median profile (21,) of each side; one place for all.

    At a place, 1 - f = (1 - trough) g(alpha): the trough follows in closed form. Of the places early to mid-turn the
    one with the least sum of squares over the sides is taken.
    """
    tried = []
    for place in _PLACES.tolist():
        depth, found, total = 1.0 - turn_shape(ALPHA, 0.0, place), {}, 0.0
        for side, profile in profiles.items():
            share = float(np.clip((1.0 - profile) @ depth / (depth @ depth), 0.0, 0.99))
            error = float(np.sum(np.square(1.0 - profile - share * depth)))
            found[side], total = (1.0 - share, place, math.sqrt(error / ALPHA.size)), total + error
        tried.append((total, found))
    return min(tried, key=lambda one: one[0])[1]


def turns_of(scenario: Recording) -> Iterator[tuple[str, FloatArray]]:
    """Turns of a scene's recorded vehicles: the side, and (21,) v / v_0 at ALPHA, v_0 at the entrance of the lane."""
    view = recording_states(scenario)
    arrays, lanes, matches = view.arrays, view.lanes, view.matches
    for agent in np.flatnonzero(arrays.clean).tolist():
        for run in runs_of(view, agent):
            sign = int(lanes.turn[run.lane]) if run.lane >= 0 else 0
            if sign:
                alpha = matches.s[run.first : run.last + 1] / lanes.length_m[run.lane]
                profile = _profile(arrays, agent, run.first, run.last, alpha, sign=sign)
                if profile is not None:
                    yield SIDES[sign], profile


def _profile(
    arrays: SceneArrays, agent: int, first: int, last: int, alpha: FloatArray, *, sign: int
) -> FloatArray | None:
    """Speed ratios v / v_0 at ALPHA of rows first to last on a turning lane; None where it is no turn seen whole."""
    rows = slice(int(arrays.first[agent]), int(arrays.first[agent + 1]))
    count = rows.stop - rows.start
    has_gaps = arrays.step[rows.stop - 1] - arrays.step[rows.start] + 1 != count
    if has_gaps or count < _WINDOW or alpha.min() > _FROM or alpha.max() < _TO:
        return None
    velocity = savgol_filter(arrays.position[rows], _WINDOW, _DEGREE, deriv=1, delta=arrays.step_s, axis=0)
    here = np.hypot(velocity[:, 0], velocity[:, 1])[first - rows.start : last + 1 - rows.start]
    angle = np.unwrap(arrays.heading[first : last + 1])
    jumps = np.abs(np.diff(here)).max() > _ACCEL_MPS2 * arrays.step_s
    if jumps or here.min() < _STANDS_MPS or sign * (angle[-1] - angle[0]) < 0.8 * TURN_RAD:
        return None
    order = np.maximum.accumulate(alpha)
    rising = np.concatenate([[True], order[1:] > order[:-1]])
    v = np.interp(ALPHA, alpha[rising], here[rising])
    return np.asarray(v / v[0])


def report(turns: Sequence[tuple[str, FloatArray]], scenes: int, *, prior: Turn) -> tuple[Turn, list[str]]:
    """The turns' parameters, fitted as far as the data go, and what to say of it."""
    lines = [f"{scenes} scenes"]
    profiles = {side: [profile for own, profile in turns if own == side] for side in SIDES.values()}
    fits = fit({side: np.median(own, axis=0) for side, own in profiles.items() if len(own) >= LEAST_TURNS})
    values: dict[str, float] = {}
    for side, found in profiles.items():
        said = f"fewer than {LEAST_TURNS}: the prior stays, {getattr(prior, f'{side}_trough')} at {prior.trough_at}"
        if side in fits:
            trough, place, rms = fits[side]
            values |= {f"{side}_trough": round(trough, 3), "trough_at": place}
            said = f"trough {trough:.3f} at {place:.2f} (rms {rms:.3f})"
        lines.append(f"{side}: {len(found)} turns; {said}")
    left, right = (values.get(f"{side}_trough", getattr(prior, f"{side}_trough")) for side in ("left", "right"))
    if right <= left:
        lines.append(f"right {right} is not above left {left}, as the paper has it: the prior stays on both sides")
        values = {}
    return prior.model_copy(update=values), lines


def main(paths: Sequence[Path]) -> None:
    """Read, fit, say on stderr what was found, write the section [turn] of a configuration to stdout."""
    folders = find_sources(paths)
    turns = [one for folder in folders for one in turns_of(read_recording(folder))]
    turn, lines = report(turns, len(folders), prior=Turn())
    print(*lines, sep="\n", file=sys.stderr)
    print("[turn]", *(f"{name} = {value}" for name, value in turn), sep="\n")


if __name__ == "__main__":
    if len(sys.argv) == 1:
        sys.exit(__doc__)
    main([Path(name) for name in sys.argv[1:]])
