"""Which events come about on real scenes: kind by target by moment, with what it costs. A script, no test:

    export PYTHONPATH=tests/support
    python tests/benchmarks/event_figures.py --kinds cut_in cross --targets av focal --ttc 1.5:3 [--roots ROOT ...]

Targets: av, focal, any, track ids, or `moving` for every other recorded vehicle. Those are asked for that are seen for
3 s around the moment, on a lane of the map, above 1 m/s.

possible it came about, or any of 2,000 rollouts with another seed brings it about
came     it came about, and is seen again in the exported positions by the second checker of the tests
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
from second_checker import check_folder
from shared_data import ROOTS
from unsteered import simulate_unsteered

from bridge.generation.generate import PreparedScene, generate, prepare
from bridge.generation.scene import TrafficScene
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sources import find_scenarios
from bridge.sumo.poses import sumo_poses
from hid2.insertion.event_targets import candidate_rows, target_of
from hid2.insertion.events import SceneEvents
from hid2.insertion.meetings import moving_vehicles, named_rows
from hid2.params import Config, Event, Request
from hid2.scene import Scene

Bands = dict[str, tuple[float, ...]]
KINDS = get_args(Event.model_fields["kind"].annotation)
MOMENTS_S, OVERTAKE_S = (3.0, 6.0), 9.0
#: Nothing but an overtake is asked for later than this before the end, s, nor of a target that is slower, m/s, or is
#: not there so long before and after, s.
BEFORE_END_S, MOVES_MPS, SEEN_S = 4.0, 1.0, 1.5
ROLLED_OUT, ANOTHER_SEED = 2000, 12345


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


def not_seen(made: TrafficScene, source: Path) -> str:
    """What the second checker does not see of the claims of a scene; empty where it sees all."""
    with tempfile.TemporaryDirectory() as out:
        found = check_folder(made.write(Path(out)), source)
    return "; ".join(f"{one.other}, {one.value:.1f} s off" for one in found if one.quantity == "claim")


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
            missing = not_seen(made, folder)
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
    parser.add_argument("--roots", type=Path, nargs="+", default=ROOTS, help="data-set roots")
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
