"""Which events come about on real scenes: kind by target by moment, with what it costs. A script, no test:

    export PYTHONPATH=tests/support
    python tests/benchmarks/event_figures.py --kinds cut_in cross --targets av focal --ttc 1.5:3 [--roots ROOT ...]

Targets: av, focal, any, track ids, or `moving` for every other recorded vehicle. Those are asked for that are seen for
3 s around the moment, on a lane of the map, above 1 m/s.

possible it came about, or any of 2,000 rollouts with another seed brings it about
came     it came about, and is seen again in the exported positions by the rules below, which share nothing with the
         search
floors   processor time of the event alone, over that of SUMO replaying the recorded agents alone
"""

import argparse
import logging
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
from shared_data import SHARED_DATA
from unsteered import simulate_unsteered

from bridge.generation.generate import PreparedScene, generate, prepare
from bridge.generation.scene import TrafficScene
from bridge.recordings.folders import find_scenarios
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sidecar import EventRecord
from bridge.sumo.poses import sumo_poses
from hid2.agents import FloatArray, Track
from hid2.insertion.event_targets import candidate_rows, target_of
from hid2.insertion.events import SceneEvents
from hid2.insertion.meetings import moving_vehicles, named_rows
from hid2.measures.encounters import CROSSING_RAD
from hid2.occupancy.traffic import BoolArray
from hid2.params import Config, Event, Request
from hid2.scene import Scene
from netconvert.geometry import Polyline

Bands = dict[str, tuple[float, ...]]
KINDS = get_args(Event.model_fields["kind"].annotation)
MOMENTS_S, OVERTAKE_S = (3.0, 6.0), 9.0
#: Nothing but an overtake is asked for later than this before the end, s, nor of a target that is slower, m/s, or is
#: not there so long before and after, s.
BEFORE_END_S, MOVES_MPS, SEEN_S = 4.0, 1.0, 1.5
ROLLED_OUT, ANOTHER_SEED = 2000, 12345
#: Off the target's path, m: in its lane at most, in the lane beside at least; how far over at the moment, share.
ON_M, BESIDE_M, HALF_WAY = 1.3, 2.2, (0.2, 0.8)
#: Out, past and half of the way back take so long: 2 x 9 m of boxes and gaps at 6 m/s more, and 1.5 + 0.75 s aside.
OVERLAP_M = 2.0  # boxes overlap across, nearly
MOMENT_S, SPARE_M = 0.7, 1.5


class Said(logging.Handler):
    """What the search says of what it tried."""

    def __init__(self) -> None:
        super().__init__(logging.DEBUG)
        self.last = ""

    def emit(self, record: logging.LogRecord) -> None:
        if isinstance(record.args, tuple) and len(record.args) == 3:
            self.last = str(record.args[2])


def possible(prepared: PreparedScene, config: Config) -> bool:
    """Whether any of so many rollouts, drawn anew, brings the event about: what a miss is held against."""
    many = config.event_search.model_copy(update={"candidates": ROLLED_OUT})
    search = SceneEvents(prepared.surroundings(config.model_copy(update={"event_search": many})), (ANOTHER_SEED,))
    objectives = search.objectives(config.event[0], np.random.default_rng(0))
    return bool(objectives) and next(search.likely(objectives, 0, Counter()), None) is not None


# what is seen in exported positions


def crossing(a: FloatArray, b: FloatArray) -> tuple[int, int] | None:
    """Rows of two ways (N, 2) m at which they first cut each other steeply, oncoming ones too."""
    u, w = np.diff(a, axis=0), np.diff(b, axis=0)
    det = u[:, None, 0] * w[None, :, 1] - u[:, None, 1] * w[None, :, 0]
    off = b[None, :-1] - a[:-1, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (off[..., 0] * w[None, :, 1] - off[..., 1] * w[None, :, 0]) / det
        r = (off[..., 0] * u[:, None, 1] - off[..., 1] * u[:, None, 0]) / det
    lengths = np.hypot(*u.T)[:, None] * np.hypot(*w.T)[None]
    steep = u @ w.T < np.cos(CROSSING_RAD) * lengths
    hits = np.argwhere((t >= 0) & (t <= 1) & (r >= 0) & (r <= 1) & steep)
    return (int(hits[0, 0]), int(hits[0, 1])) if len(hits) else None


@dataclass(frozen=True, eq=False)
class Pair:
    """Own place relative to the way of the target, where both are there: s ahead, m, and d to the left, m, by step.

    beyond: where the way of the target has ended, so that nothing is known of what is aside.
    """

    steps: FloatArray
    ahead: FloatArray
    aside: FloatArray
    beyond: BoolArray

    @staticmethod
    def of(own: Track, target: Track) -> "Pair":
        """The way of the target goes on straight beyond its ends."""
        moved = np.concatenate([[True], np.hypot(*np.diff(target.position, axis=0).T) > 0.05])
        way = target.position[moved]
        ends = [
            way[row] + sign * 100.0 * np.array([np.cos(target.heading[row_h]), np.sin(target.heading[row_h])])
            for row, row_h, sign in ((0, 0, -1.0), (-1, -1, 1.0))
        ]
        line = Polyline(np.concatenate([ends[:1], way, ends[1:]]))
        steps = np.intersect1d(own.timesteps, target.timesteps)
        own_xy = own.position[np.searchsorted(own.timesteps, steps)]
        target_xy = target.position[np.searchsorted(target.timesteps, steps)]
        (s, d), (target_s, _) = line.frenet(own_xy), line.frenet(target_xy)
        ended = line.length_m - 100.0
        return Pair(steps, s - target_s, d, s > ended + 0.5)


def seen(kind: str, own: Track, target: Track, record: EventRecord, gap_m: tuple[float, float], step_s: float) -> str:
    """What is missing of an event in the exported positions; empty where nothing is."""
    assert record.at_s is not None
    at, lengths = round(record.at_s / step_s), 0.5 * (own.size.length_m + target.size.length_m)
    if kind == "cross":
        rows = crossing(own.position, target.position)
        if rows is None:
            return "paths do not cross"
        here = abs(int(own.timesteps[rows[0]]) - at) * step_s <= MOMENT_S
        first = own.timesteps[rows[0]] < target.timesteps[rows[1]]
        return "" if here and first == record.ahead else f"crosses at {own.timesteps[rows[0]] * step_s:.1f} s"
    pair = Pair.of(target, own) if kind == "follow" else Pair.of(own, target)
    row = int(np.searchsorted(pair.steps, at))
    if row >= len(pair.steps) or pair.steps[row] != at:
        return "not both there"
    gap, aside = float(pair.ahead[row]), np.abs(pair.aside)
    before, after = aside[: row + 1], aside[row:]
    if kind == "overtake":
        passed = pair.ahead[0] < 0 < gap and before.max() > BESIDE_M and aside[0] < ON_M
        return "" if passed else f"from {pair.ahead[0]:.1f} to {gap:.1f} m, {before.max():.1f} m aside"
    if kind in ("cut_in", "lead", "follow") and gap < 0.0:
        return f"{gap:.1f} m behind"
    if not gap_m[0] - SPARE_M <= abs(gap) - lengths <= gap_m[1] + SPARE_M:
        return f"gap {abs(gap) - lengths:.1f} m"
    if kind == "cut_in":
        over = (aside[row] - after.min()) / max(before.max() - after.min(), 1e-9)
        done = before.max() > BESIDE_M and after.min() < ON_M and HALF_WAY[0] < over < HALF_WAY[1]
        return "" if done else f"aside {before.max():.1f}, {aside[row]:.1f}, {after.min():.1f} m"
    if kind == "merge":
        done = after.min() < ON_M and before.max() > after.min() + 0.5
        return "" if done else f"aside {before.max():.1f}, then {after.min():.1f} m"
    return "" if aside[row] < OVERLAP_M or pair.beyond[row] else f"{aside[row]:.1f} m aside"


# the table


@dataclass(frozen=True)
class Row:
    """One event that was asked for."""

    scene: str
    kind: str
    target: str
    at_s: float
    possible: bool
    came: bool
    missing: str
    tries: int
    floors: float
    said: str
    measures: str

    def __str__(self) -> str:
        came = "came" if self.came else "-"
        return (
            f"{self.scene} {self.kind:8} {self.target:5} {self.at_s:.0f} s {'possible' if self.possible else '-':8} "
            f"{came:4} {self.tries:3} tries {self.floors:5.1f} floors  {self.measures or self.said}{self.missing}"
        )


def floor_s(prepared: PreparedScene, scene: Scene) -> float:
    """Processor time of the bare floor of a scene, s."""
    front, angle = sumo_poses(scene.traffic.position, scene.traffic.heading, scene.traffic.length_m[:, None])
    with tempfile.TemporaryDirectory() as beside:
        net = Path(beside) / "scene.net.xml"
        net.write_bytes(prepared.net(scene.config))
        taken = []
        for _ in range(3):
            begun = time.process_time()
            simulate_unsteered(net, scene.traffic, front, angle, [])
            taken.append(time.process_time() - begun)
    return min(taken)


def is_eligible(scene: Scene, row: int, at: int) -> bool:
    """Whether a recorded vehicle may be asked for at a step. row: of `scene.traffic`."""
    target, around = target_of(scene, row), scene.steps_in(SEEN_S)
    if target is None or not target.present[max(0, at - around) : at + around + 1].all():
        return False
    return bool(target.speed[at] >= MOVES_MPS) and target.lane_at(at) is not None


def measure(
    folder: Path, kinds: Sequence[str], targets: Sequence[str], bands: Callable[[str], Bands], said: Said
) -> list[Row]:
    """All events of one scene, each asked for alone."""
    prepared = prepare(read_scenario(folder), Config())
    plain = Config(request=Request(agents=0, seed=0))
    scene = prepared.surroundings(plain).scene
    generate(prepared, plain)
    begun = time.process_time()
    generate(prepared, plain.model_copy(update={"request": Request(agents=0, seed=1)}))
    base_s, floor = time.process_time() - begun, floor_s(prepared, scene)
    tracks = {track.track_id: track for track in prepared.scenario.tracks}
    rows, moving = [], moving_vehicles(scene).tolist()
    others = [scene.traffic.ids[r] for r in moving if all(r not in named_rows(scene, n) for n in ("av", "focal"))]
    named = [n for name in targets for n in (others if name == "moving" else [name])]
    for event in (
        Event(kind=kind, target=target, at_s=(at_s, at_s), **bands(kind))
        for kind in kinds
        for target in named
        for at_s in ((OVERTAKE_S,) if kind == "overtake" else MOMENTS_S)
    ):
        latest_s, at = scene.last_s - (0.0 if event.kind == "overtake" else BEFORE_END_S), scene.steps_in(event.at_s[0])
        among = candidate_rows(scene, event.target)
        if event.at_s[0] > latest_s or not any(is_eligible(scene, row, at) for row in among):
            continue
        said.last, begun = "", time.process_time()
        config = plain.model_copy(update={"event": (event,)})
        made: TrafficScene = generate(prepared, config)
        taken = time.process_time() - begun - base_s
        (record,) = made.sidecar.events
        missing, measures, done = "", "", record.status == "done"
        if done:
            own = next(track for track in made.generated if track.track_id == record.track_id)
            missing = seen(event.kind, own, tracks[str(record.target_track_id)], record, event.gap_band_m, scene.step_s)
            missing = f" NOT SEEN AGAIN: {missing}" if missing else ""
            measures = (
                f"at {record.at_s} s, gap {record.gap_m} m, {record.speed_difference_mps} m/s, TTC {record.min_ttc_s}"
            )
        rows.append(
            Row(
                folder.name[:8], event.kind, event.target, event.at_s[0],
                done or possible(prepared, config), done and not missing, missing, record.tries,
                max(0.0, taken) / floor, said.last, measures,
            )
        )  # fmt: skip
        print(rows[-1], flush=True)
    return rows


def summary(rows: Sequence[Row]) -> str:
    """By kind and target: how many of those that are possible came about, and what they cost."""
    lines = []
    named = {row.target: row.target if row.target in ("av", "focal", "any") else "other" for row in rows}
    for kind in dict.fromkeys(row.kind for row in rows):
        for target in (*dict.fromkeys(named.values()), "all"):
            some = [row for row in rows if row.kind == kind and target in (named[row.target], "all")]
            among = sum(row.possible for row in some)
            came, floors = sum(row.came for row in some), [row.floors for row in some] or [0.0]
            lines.append(
                f"{kind:8} {target:5} {len(some):3} asked for, possible {among:3}, came about {came:3} = "
                f"{came / max(1, among):.2f}; not seen again {sum(bool(r.missing) for r in some)}; floors "
                f"median {np.median(floors):.1f}, largest {max(floors):.1f}"
            )
        reasons: Counter[str] = Counter()
        for row in rows:
            if row.kind == kind and row.possible and not row.came:
                for part in row.said.split(", "):
                    name, _, count = part.rpartition(" ")
                    reasons[name or part] += int(count) if count.isdigit() else 1
        lines.append(f"{kind:8} what the others met: {', '.join(f'{n} {c}' for n, c in reasons.most_common(8))}")
    return "\n".join(lines)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS)
    parser.add_argument("--targets", nargs="+", default=["av", "focal"])
    parser.add_argument("--ttc", help="band of TTC asked for, A:B in s")
    parser.add_argument("--pet", help="band of PET asked for of what crosses, in place of that of TTC, A:B in s")
    parser.add_argument("--only", nargs="+", default=[""], help="scenes whose ids begin with one of these")
    roots = [SHARED_DATA / "av2", SHARED_DATA / "wide"]
    parser.add_argument("--roots", type=Path, nargs="+", default=roots, help="data-set roots")
    options = parser.parse_args()

    def bands(kind: str) -> Bands:
        name, band = ("pet_s", options.pet) if kind == "cross" and options.pet else ("ttc_s", options.ttc)
        return {name: tuple(float(one) for one in band.split(":"))} if band else {}

    said, log = Said(), logging.getLogger("hid2.insertion.events")
    log.addHandler(said)
    log.setLevel(logging.DEBUG)
    log.propagate = False
    rows = []
    for folder in (one for root in options.roots for one in find_scenarios(root)):
        if folder.name.startswith(tuple(options.only)):
            rows += measure(folder, options.kinds, options.targets, bands, said)
    print(summary(rows))


if __name__ == "__main__":
    main()
