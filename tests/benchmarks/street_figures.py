"""How inserted vehicles drive on real streets beside recorded ones, whole track by whole track. A script, no test:

python tests/benchmarks/street_figures.py --variants 20 --seed 0 [--set ...] [ROOT ...]

halts        of those that enter an intersection, those that stand inside it (below .3 m/s for .5 s)
against      entries above 3 m/s within 1 s of which a recorded vehicle passes where a lane crosses the one entered
tailgated    of the recorded vehicles that follow an inserted one for 1 s above 3 m/s, those below .7 s of headway for
             1 s; exempt: those that kept as little in the recording
crawls       3 s below 40 % of the lane's usual speed, nothing within 3 s ahead; unbound: with no limit that hid2 set
temper       Wasserstein-1 distances to each of two human-labelled scenes, beside that between the two
critics      of whole tracks on the labelled scenes, and of the place on the same 10 m of lane as recorded tracks
"""

import argparse
import itertools
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_filter
from scipy.stats import wasserstein_distance
from shapely import LineString
from shared_data import ROOTS, scenes_below, scores_of_trees
from sklearn.metrics import roc_auc_score

from bridge.config import load_config
from bridge.generation.generate import generate, prepare
from hid2.agents import FloatArray, Track
from hid2.judge.findings import FOLLOWER_HEADWAY_S
from hid2.judge.states import recorded_headways, sustained_headway
from hid2.measures.arrays import STANDS_FOR_S, STANDS_MPS, BoolArray
from hid2.measures.driven_lanes import runs_of
from hid2.measures.encounters import CROSSING_RAD
from hid2.measures.following import LaneLeaders, leaders
from hid2.measures.lane_matching import FlatLanes, flatten_lanes
from hid2.occupancy.agent_states import AgentStates, agent_states
from hid2.resampling import ratio
from hid2.vehicle import DrivenVehicle
from netconvert.geometry import wrap_angle

STEP_S, STRETCH_M = 0.1, 10.0
STANDS_STEPS = round(STANDS_FOR_S / STEP_S)
CRAWL_SHARE, CRAWL_STEPS, AHEAD_S, TAILGATES_S, ENTERS_MPS = 0.4, 30, 3.0, 0.7, 3.0
#: Whole tracks: of so many steps and more, and so long, m.
LEAST_STEPS, LEAST_M = 60, 10.0
SINGLE = ("acceleration m/s2", "jerk m/s3")
EACH = ("wander of place m", "wander of speed m/s", "hard brakes", "standing starts")


class Log(Counter[str]):
    """Counts limits by cause, and keeps the steps of a vehicle that they bound."""

    def __init__(self, vehicle: DrivenVehicle) -> None:
        super().__init__()
        self.vehicle, self.steps = vehicle, []

    def __setitem__(self, cause: str, count: int) -> None:
        self.steps.append(self.vehicle.start.step + len(self.vehicle.s))
        super().__setitem__(cause, count)


def logged() -> None:
    """Have every driven vehicle keep the steps in which it was limited."""
    begin = DrivenVehicle.__init__

    def begin_logged(self: DrivenVehicle, *args: object, **more: object) -> None:
        begin(self, *args, **more)
        self.limited = Log(self)

    DrivenVehicle.__init__ = begin_logged  # type: ignore[method-assign]


class Whole(NamedTuple):
    """A vehicle's track as smooth motion, (T,) each: speed, acceleration, jerk, offset from the lane's middle."""

    v: FloatArray
    a: FloatArray
    j: FloatArray
    d: FloatArray


def whole(states: AgentStates, agent: int) -> Whole | None:
    """Of one track without gaps; None for short ones. Cubics over 2.1 s: noise does not decide."""
    rows = states.row_span(agent)
    steps, position = states.arrays.step[rows], states.arrays.position[rows]
    if steps.size < LEAST_STEPS or (np.diff(steps) != 1).any():
        return None
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(savgol_filter(position, 11, 2, axis=0), axis=0).T))])
    if s[-1] < LEAST_M:
        return None
    v, a, j = (savgol_filter(s, 21, 3, deriv=k, delta=STEP_S) for k in (1, 2, 3))
    d = np.where(states.matches.lane[rows] >= 0, states.matches.d[rows], np.nan)
    inner = slice(10, -10)
    return Whole(v[inner], a[inner], j[inner], d[inner])


def joined(tracks: list[FloatArray]) -> FloatArray:
    """The known values of several tracks."""
    values = np.concatenate(tracks)
    return values[np.isfinite(values)]


def distances(values: dict[tuple[int, bool], FloatArray], one: int, other: int) -> tuple[float, float, float]:
    """Wasserstein-1: of the inserted vehicles of two scenes to the recorded ones of either, and between these."""
    counts = np.array([values[k, True].size for k in (one, other)])
    ours, weight = np.concatenate([values[k, True] for k in (one, other)]), np.repeat(1 / counts, counts)
    first, second = values[one, False], values[other, False]
    to = (wasserstein_distance(ours, x, weight) for x in (first, second))
    return (*to, wasserstein_distance(first, second))


def lasting(true: BoolArray, steps: int) -> int:
    """First place from which so many in a row hold, -1 where there is none."""
    total = np.concatenate([[0], np.cumsum(true)])
    found = np.flatnonzero(total[steps:] - total[:-steps] == steps) if total.size > steps else np.zeros(0, int)
    return int(found[0]) if found.size else -1


def temper_of(track: Whole) -> FloatArray:
    """(4,) EACH: SD of the offset around a line in windows of 4 s, SD of the speed; whether it brakes hard, starts."""
    wander = [
        float(np.std(d - np.polyval(np.polyfit(time, d, 1), time)))
        for k in range(0, track.d.size - 40, 10)
        for d, time in [(track.d[k : k + 41], np.arange(41))]
        if np.isfinite(d).all() and np.abs(np.diff(d)).max() < 0.5 and track.v[k : k + 41].mean() > 1.0
    ]
    stood = lasting(track.v < STANDS_MPS, STANDS_STEPS)
    starts = stood >= 0 and (track.v[stood:] > 2.0).any()
    return np.array([np.mean(wander) if wander else np.nan, track.v.std(), lasting(track.a < -2.0, 3) >= 0, starts])


def features_of(track: Whole) -> FloatArray:
    """What a critic sees of a whole track: no durations and no extremes, which grow with them."""
    place, speed, brakes, starts = temper_of(track)
    moves = track.v > 0.5
    a, j = track.a[moves], track.j[moves]
    return np.array([
        track.v.mean(), speed, np.percentile(track.v, 95), *np.percentile(a, [5, 50, 95]), a.std(),
        np.sqrt(np.mean(j**2)), np.mean(np.abs(a) < 0.1), (track.v < STANDS_MPS).mean(), brakes, starts,
        place, np.nanstd(track.d) if np.isfinite(track.d).any() else np.nan,
    ])  # fmt: skip


FEATURES = (
    "speed", "its SD", "its 95 %", "acceleration 5 %", "50 %", "95 %", "its SD", "jerk rms", "coasts", "stands",
    "brakes hard", "starts", "wander of place", "SD of offset",
)  # fmt: skip


def told_apart(x: FloatArray, inserted: FloatArray, weight: FloatArray, fold: FloatArray, unit: FloatArray) -> str:
    """AUC of trees, each fold judged by those trained on the others; 95 % by drawing recorded units again."""
    score = scores_of_trees(x, inserted, weight, fold, max_iter=60, min_samples_leaf=5)
    value = roc_auc_score(inserted, score, sample_weight=weight)
    units, place = np.unique(unit, return_inverse=True)
    drawn = []
    for seed in range(300):
        times = np.random.default_rng(seed).multinomial(units.size, np.full(units.size, 1 / units.size))[place]
        if (times * inserted).sum() > 0 and (times * ~inserted).sum() > 0:
            drawn.append(roc_auc_score(inserted, score, sample_weight=weight * times))
    low, high = np.percentile(drawn, [2.5, 97.5])
    return f"{value:.3f} [{low:.2f}, {high:.2f}]"


def evened(inserted: FloatArray, group: FloatArray) -> FloatArray:
    """Weights by which both kinds weigh the same in each group, it what the smaller kind counts; 0 without either."""
    _, place = np.unique(group, axis=0, return_inverse=True)
    ours, theirs = np.bincount(place, inserted), np.bincount(place, ~inserted)
    least = np.minimum(ours, theirs)
    return np.where(inserted, (least / np.maximum(ours, 1))[place], (least / np.maximum(theirs, 1))[place])


class Figures:
    """Sums over scenes; counts by scene and kind."""

    def __init__(self) -> None:
        self.counts: dict[str, dict[tuple[int, bool], list[int]]] = defaultdict(lambda: defaultdict(lambda: [0, 0]))
        self.tracks: list[tuple[int, bool, str, Whole]] = []
        self.places: list[tuple[int, bool, int, int, int, float]] = []
        self.labelled: list[int] = []

    def count(self, what: str, scene: int, inserted: bool, found: int, of: int = 1) -> None:
        both = self.counts[what][scene, inserted]
        both[0], both[1] = both[0] + found, both[1] + of

    def add(self, scene: int, states: AgentStates, made: list[tuple[Track, list[int]]], usual, variant: int) -> None:
        """Take in inserted tracks, with the steps in which they were limited; recorded ones where none were made."""
        arrays = states.arrays
        led = leaders(states)
        inserted, bound = bool(made), {track.track_id: steps for track, steps in made}
        members = arrays.vehicle & arrays.moving & ~arrays.fragment & (arrays.generated == inserted)
        crossing = crossings_of(states.lanes)
        for agent in np.flatnonzero(members).tolist():
            track = whole(states, agent)
            if track is not None:
                self.tracks.append((scene, inserted, f"{variant} {arrays.track_ids[agent]}", track))
            self._places(scene, states, agent, variant)
            self._intersections(scene, states, agent, crossing)
            slow = crawling(states, agent, led, usual)
            self.count("crawls", scene, inserted, lasting(slow, CRAWL_STEPS) >= 0)
            if inserted:
                free = ~np.isin(arrays.step[states.row_span(agent)], bound[arrays.track_ids[agent]])
                self.count("crawls, unbound", scene, True, lasting(slow & free, CRAWL_STEPS) >= 0)
        if inserted:
            self._tailgated(scene, states, led)

    def _places(self, scene: int, states: AgentStates, agent: int, variant: int) -> None:
        rows, matches = states.row_span(agent), states.matches
        lane, d, inserted = matches.lane[rows], matches.d[rows], bool(states.arrays.generated[agent])
        stretch = (matches.s[rows] // STRETCH_M).astype(int)
        for one in set(zip(lane.tolist(), stretch.tolist(), strict=True)):
            here = (lane == one[0]) & (stretch == one[1]) & (np.abs(d) < 1.5)
            if one[0] >= 0 and here.any():
                self.places.append((scene, inserted, 1000 * variant + agent, *one, float(np.median(d[here]))))

    def _intersections(
        self, scene: int, states: AgentStates, agent: int, crossing: dict[int, list[tuple[int, float]]]
    ) -> None:
        arrays, inserted = states.arrays, bool(states.arrays.generated[agent])
        speed = np.hypot(*np.gradient(arrays.position[states.row_span(agent)], STEP_S, axis=0).T)
        speed = savgol_filter(speed, 5, 1) if speed.size >= 5 else speed
        first_row, entered, halts = states.row_span(agent).start, False, False
        inside = np.zeros(speed.size, dtype=bool)
        for before, run in itertools.pairwise([None, *runs_of(states, agent)]):
            if run.lane < 0 or not graph_lane(states.lanes, run.lane).is_intersection:
                continue
            inside[run.first - first_row : run.last + 1 - first_row] = True
            if before is None or (before.lane >= 0 and graph_lane(states.lanes, before.lane).is_intersection):
                continue
            entered = True
            if speed[run.first - first_row] > ENTERS_MPS:
                against = crossing_then(states, crossing[run.lane], int(arrays.step[run.first]), agent)
                self.count("against", scene, inserted, against)
        halts = lasting(inside & (speed < STANDS_MPS), STANDS_STEPS) >= 0
        if inside.any():
            self.count("halts", scene, inserted, halts)
        if entered:
            self.count("halts, of those that enter while seen", scene, inserted, halts)

    def _tailgated(self, scene: int, states: AgentStates, led: LaneLeaders) -> None:
        arrays = states.arrays
        speed = np.hypot(*arrays.velocity.T)
        kept = recorded_headways(states)
        for agent in np.flatnonzero(arrays.vehicle & arrays.moving & ~arrays.fragment & ~arrays.generated).tolist():
            rows = states.row_span(agent)
            follows = (led.agent[rows] >= 0) & arrays.generated[np.maximum(led.agent[rows], 0)]
            if lasting(follows & (speed[rows] > ENTERS_MPS), 10) < 0:
                continue
            gap_m = np.where(follows, led.gap_m[rows], np.inf)
            near = sustained_headway(gap_m, arrays.length[np.maximum(led.agent[rows], 0)], speed[rows], STEP_S)[0]
            exempt = kept.get(agent, np.inf) <= near
            self.count("tailgated, exempt", scene, True, near < TAILGATES_S and exempt)
            self.count("tailgated", scene, True, near < TAILGATES_S and not exempt)
            self.count("below the limit of .8 s", scene, True, near < FOLLOWER_HEADWAY_S and not exempt)

    def shares(self) -> Iterator[str]:
        for what, found in self.counts.items():
            for inserted in (False, True):
                rows = np.array([two for (_, kind), two in found.items() if kind == inserted], dtype=float)
                if rows.size:
                    told = ratio(*rows.T)
                    ends = "" if told.low is None else f"[{told.low:.3f}, {told.high:.3f}]"
                    yield (f"{what:40s} {'inserted' if inserted else 'recorded':9s} {told.value or 0:.4f} {ends} "
                           f"{int(rows[:, 0].sum())} of {int(rows[:, 1].sum())}")  # fmt: skip

    def temper(self) -> Iterator[str]:
        """Distances to both labelled scenes, and between them; inserted ones of both, which weigh the same."""
        one, other = self.labelled
        series: dict[tuple[int, bool], list[list[FloatArray]]] = defaultdict(list)
        for scene, inserted, _, track in self.tracks:
            if scene in self.labelled:
                moves = track.v > 0.5
                each = [np.array([value]) for value in temper_of(track)]
                series[scene, inserted].append([track.a[moves], track.j[moves], *each])
        rng = np.random.default_rng(0)
        for row, name in enumerate((*SINGLE, *EACH)):
            found = {key: [track[row] for track in tracks] for key, tracks in series.items()}
            values = {key: joined(tracks) for key, tracks in found.items()}
            told = distances(values, one, other)
            drawn = np.array([
                distances(
                    {key: joined([tracks[k] for k in rng.integers(len(tracks), size=len(tracks))])
                     for key, tracks in found.items()}, one, other,
                )
                for _ in range(200)
            ])  # fmt: skip
            low, high = np.percentile(drawn, [2.5, 97.5], axis=0)
            names = ("to A", "to B", "between")
            ends = ", ".join(
                f"{n} {d:.3f} [{a:.2f}, {b:.2f}]" for n, d, a, b in zip(names, told, low, high, strict=True)
            )
            more = np.mean(drawn[:, :2].max(axis=1) <= drawn[:, 2])
            ours = np.concatenate([values[one, True], values[other, True]])
            means = "; ".join(
                f"{what} mean {x.mean():.3f} SD {x.std():.3f}"
                for what, x in (("A", values[one, False]), ("B", values[other, False]), ("inserted", ours))
            )
            met = "met" if max(told[:2]) <= told[2] else "MISSED"
            yield f"temper {name:20s} {ends}: {met}, met in {more:.2f} of draws; {means}"

    def critics(self) -> Iterator[str]:
        rows = [one for one in self.tracks if one[0] in self.labelled]
        x, inserted = np.array([features_of(one[3]) for one in rows]), np.array([one[1] for one in rows])
        scene = np.array([one[0] for one in rows])
        unit = np.array([f"{one[0]} {one[2].split()[0] if one[1] else one[2]}" for one in rows])
        parts = np.array([sum(map(ord, name)) % 5 for name in unit])
        weight = evened(inserted, scene[:, None])
        band = np.searchsorted([2.0, 5.0, 8.0, 11.0], x[:, 0])
        even = evened(inserted, np.column_stack([scene, band]))
        yield f"whole tracks: {inserted.sum()} inserted, {(~inserted).sum()} recorded"
        for name, weights in (("", weight), (" of the same mean speeds", even)):
            yield f"whole tracks{name}, five parts {told_apart(x, inserted, weights, parts, unit)}"
            yield f"whole tracks{name}, the other scene's critic {told_apart(x, inserted, weights, scene, unit)}"
        alone = [roc_auc_score(inserted, np.nan_to_num(x[:, k]), sample_weight=even) for k in range(x.shape[1])]
        yield "alone: " + ", ".join(f"{name} {auc:.2f}" for name, auc in zip(FEATURES, alone, strict=True))
        recorded, controls = ~inserted, []
        for seed in range(20):
            half = np.random.default_rng(seed).random(recorded.sum()) < 0.5
            own = evened(half, np.column_stack([scene, band])[recorded])
            controls.append(float(told_apart(x[recorded], half, own, parts[recorded], unit[recorded]).split()[0]))
        low, high = np.percentile(controls, [2.5, 97.5])
        yield f"control: recorded halves, five parts {np.mean(controls):.3f} [{low:.2f}, {high:.2f}]"

    def place(self) -> Iterator[str]:
        """A critic that sees the median offset alone, where two recorded tracks or more are on the same 10 m."""
        by: dict[tuple[int, int, int], list[tuple[bool, int, float]]] = defaultdict(list)
        for scene, inserted, agent, lane, stretch, d in self.places:
            by[scene, lane, stretch].append((inserted, agent, d))
        rows = []
        for number, ((scene, _, _), found) in enumerate(by.items()):
            recorded = np.array([d for inserted, _, d in found if not inserted])
            if recorded.size >= 2:
                rows += [
                    (scene, inserted, agent, number, d, d - np.median(others))
                    for inserted, agent, d in found
                    for others in [recorded if inserted else np.delete(recorded, np.argmax(recorded == d))]
                ]
        table = np.array(rows, dtype=float).reshape(-1, 6)
        for name, scenes in (("labelled", self.labelled), ("all", np.unique(table[:, 0]))):
            own = table[np.isin(table[:, 0], scenes)]
            inserted = own[:, 1] > 0
            weight = evened(inserted, own[:, 3:4])
            own, inserted, weight = own[weight > 0], inserted[weight > 0], weight[weight > 0]
            unit = parts = own[:, 0]
            if name == "labelled":  # so few scenes: recorded tracks, and variants
                unit, parts = own[:, 0] * 1e6 + np.where(inserted, own[:, 2] // 1000, -1 - own[:, 2]), own[:, 2] % 5
            if np.unique(parts).size < 2:
                yield f"place, {name}: no critic, which learns from other scenes with both kinds on the same 10 m"
                continue
            for what, x in (("offset", own[:, 4:5]), ("offset less that of others there", own[:, 5:6])):
                yield (f"place, {name}, {what}: {told_apart(x, inserted, weight, parts, unit)}; |.| alone "
                       f"{roc_auc_score(inserted, np.abs(x[:, 0]), sample_weight=weight):.3f}; "
                       f"SD {np.sqrt(np.average(x[inserted, 0]**2, weights=weight[inserted])):.3f} "
                       f"recorded {np.sqrt(np.average(x[~inserted, 0]**2, weights=weight[~inserted])):.3f}, "
                       f"{inserted.sum()} {(~inserted).sum()}")  # fmt: skip


def graph_lane(lanes: FlatLanes, lane: int):
    """The lane of a number."""
    return lanes.graph.lanes[int(lanes.lane_ids[lane])]


def crossings_of(lanes: FlatLanes) -> dict[int, list[tuple[int, float]]]:
    """By lane inside an intersection: lanes that cross it at more than 40 degrees, and where on them, m."""
    inside = [k for k in range(len(lanes.lane_ids)) if graph_lane(lanes, k).is_intersection]
    lines, found = {k: LineString(lanes.lane_points(k)) for k in inside}, {k: [] for k in inside}
    for one, other in itertools.combinations(inside, 2):
        if not lines[one].crosses(lines[other]):
            continue
        at = lines[one].intersection(lines[other]).representative_point()
        s = {k: lines[k].project(at) for k in (one, other)}
        first, second = (lanes.heading(np.array([k]), np.array([s[k]]))[0] for k in (one, other))
        if abs(wrap_angle(first - second)) > CROSSING_RAD:
            found[one].append((other, s[other]))
            found[other].append((one, s[one]))
    return found


def crossing_then(states: AgentStates, places: list[tuple[int, float]], step: int, agent: int) -> bool:
    """Whether another recorded vehicle passes one of the places, from 1 s before to 1 s after a step."""
    arrays, matches = states.arrays, states.matches
    for other in np.flatnonzero(arrays.vehicle & arrays.moving & ~arrays.generated & ~arrays.fragment).tolist():
        rows = arrays.row_of[other, max(0, step - 10) : step + 11]
        rows = rows[rows >= 0]
        for lane, place in places if other != agent else []:
            s = matches.s[rows[matches.lane[rows] == lane]]
            if s.size and s[0] <= place <= s[-1]:
                return True
    return False


def crawling(states: AgentStates, agent: int, led: LaneLeaders, usual) -> FloatArray:
    """(R,) rows below 40 % of the lane's usual speed, with nothing within 3 s ahead."""
    arrays, rows = states.arrays, states.row_span(agent)
    position, heading, lane = arrays.position[rows], arrays.heading[rows], states.matches.lane[rows]
    speed = np.hypot(*arrays.velocity[rows].T)
    usual_mps = np.array([usual(int(states.lanes.lane_ids[k])) if k >= 0 else 0.0 for k in lane.tolist()])
    slow = speed < CRAWL_SHARE * usual_mps
    free = (led.agent[rows] < 0) | (led.gap_m[rows] > np.maximum(AHEAD_S * speed, 10.0))
    for at in np.flatnonzero(slow & free):
        here = arrays.row_of[:, arrays.step[rows.start + at]]
        here = here[(here >= 0) & (arrays.agent[np.maximum(here, 0)] != agent)]
        offset, (cos, sin) = arrays.position[here] - position[at], (np.cos(heading[at]), np.sin(heading[at]))
        ahead, aside = offset @ [cos, sin], np.abs(offset @ [-sin, cos])
        free[at] = not ((ahead > 0) & (ahead < 5.0 + max(AHEAD_S * speed[at], 10.0)) & (aside < 3.0)).any()
    return slow & free


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--variants", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--set", dest="settings", action="append", default=[])
    parser.add_argument("roots", nargs="*", type=Path, default=ROOTS)
    asked = parser.parse_args()
    logged()
    figures = Figures()
    config = load_config(None, asked.settings, {"request.seed": asked.seed})
    for number, recording in enumerate(scenes_below(asked.roots)):
        prepared, lanes = prepare(recording, config), flatten_lanes(recording.graph)
        kept = {"num_steps": recording.num_steps, "step_s": recording.step_s}
        if recording.provenance == "human":
            figures.labelled.append(number)
        usual = prepared.surroundings(config).scene.usual_speed
        figures.add(number, agent_states(recording.tracks, lanes, **kept), [], usual, -1)
        for variant in range(asked.variants):
            scene = generate(prepared, config, variant=variant)
            if scene.generated:
                made = [(t, v.driven.limited.steps) for t, v in zip(scene.generated, scene.vehicles, strict=True)]
                states = agent_states([*recording.tracks, *scene.generated], lanes, **kept)
                figures.add(number, states, made, usual, variant)
    whole = (figures.temper(), figures.critics()) if len(figures.labelled) == 2 else ()
    for line in itertools.chain(figures.shares(), *whole, figures.place()):
        print(line, flush=True)
    if not whole:
        print(f"no temper and no critics of whole tracks: {len(figures.labelled)} human-labelled scenes, expected two")


if __name__ == "__main__":
    main()
