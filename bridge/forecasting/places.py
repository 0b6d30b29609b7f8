"""Where scenes lie and what they come from: what keeps training and validation apart.

Two scenes are kept on one side where one was generated from the other, where they were cut from one log (the column
slice_id, where a file has one), and where their maps share a square of ground: neighbouring windows of a drive do.
"""

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bridge.batch.engine import OnDone, sorted_out, work_on_each
from bridge.config import word_for_recorded
from bridge.recordings.scenario import OBSERVED_STEPS, log_of, read_scenario
from bridge.recordings.sidecar import REACTIVE, Sidecar, sidecar_in
from hid2.params import Forecasting
from netconvert.errors import ScenarioError
from netconvert.lane_graph import joined

#: Cells a side of the square in which the cells of a city are numbered.
_SIDE = 1 << 20


class SourceScene(NamedTuple):
    """What a composition needs to know of a scene.

    source_id: the recorded scenario that it was made from, its own where it was recorded; log: drive that it was cut
    from, "" where no file tells; tracks, observed, inserted: tracks in all, at the last observed step, of ours; cells:
    squares of ground that its lanes pass, as numbers within the city, sorted, int64; block: square of its middle.
    """

    folder: Path
    scenario_id: str
    source_id: str
    city: str
    steps: int
    tracks: int
    observed: int
    log: str
    cells: bytes
    block: tuple[int, int]
    inserted: int = 0

    @property
    def kind(self) -> str:
        """Recorded or generated."""
        return "recorded" if self.source_id == self.scenario_id else "generated"


class Leak(NamedTuple):
    """A scene for training that tells of one for validation or test."""

    folder: Path
    other: Path
    why: str

    def text(self) -> str:
        """One line."""
        return f"{self.folder}: {self.why} {self.other}"


def facts_of_scenes(
    folders: Sequence[Path], *, jobs: int = 1, on_scene: OnDone = None
) -> tuple[list[SourceScene], list[str]]:
    """Facts in the order of folders, and a line for each scene that cannot be read."""
    each = work_on_each(
        describe, folders, Forecasting(), jobs=jobs, chunk=256, timeout_s=60, isolated=False, on_item=on_scene
    )
    facts, unread = sorted_out(each)
    return facts, [reason for _, reason in unread]


def describe(params: Forecasting, folder: Path) -> SourceScene:
    """Read one scene, by all rules that its readers have. Errors: ScenarioError, MapError, as of `read_scenario`."""
    sidecar, scene = generated_sidecar(folder), read_scenario(folder)
    points = np.concatenate([line for lane in scene.graph.lanes.values() for line in (lane.centerline, *lane.sides)])
    cell = np.floor(points / params.place_cell_m).astype(np.int64) + _SIDE // 2
    middle = np.floor((points.min(axis=0) + points.max(axis=0)) / 2 / params.block_m).astype(int)
    return SourceScene(
        folder=folder,
        scenario_id=scene.scenario_id,
        source_id=scene.scenario_id if sidecar is None else sidecar.source_scenario_id,
        city=scene.city,
        steps=scene.num_steps,
        tracks=len(scene.tracks),
        observed=sum(OBSERVED_STEPS - 1 in track.timesteps for track in scene.tracks),
        log=log_of(scene.table),
        cells=np.unique(cell[:, 0] * _SIDE + cell[:, 1]).tobytes(),
        block=(int(middle[0]), int(middle[1])),
        inserted=0 if sidecar is None else len(sidecar.agents),
    )


def generated_sidecar(folder: Path) -> Sidecar | None:
    """The sidecar of a generated scene; None for a recorded one. Errors: ScenarioError."""
    if word_for_recorded(folder.name) != "recorded":
        raise ScenarioError(f"{folder}: {REACTIVE}")
    return sidecar_in(folder)


# Groups and splits


def groups_of(facts: Sequence[SourceScene]) -> list[list[int]]:
    """Rows of scenes that stay on one side: of one block of a city, one source, one log. In the order of first rows."""
    number: dict[tuple[object, ...], int] = {}
    links = []
    for row, fact in enumerate(facts):
        keys: list[tuple[object, ...]] = [("block", fact.city, *fact.block), ("source", fact.source_id)]
        keys += [("log", fact.log)] if fact.log else []
        links += [(row, len(facts) + number.setdefault(key, len(number))) for key in keys]
    groups: dict[int, list[int]] = defaultdict(list)
    for row, group in enumerate(joined(len(facts) + len(number), links)[: len(facts)]):
        groups[group].append(row)
    return list(groups.values())


def stratum(fact: SourceScene, bounds: Sequence[int]) -> tuple[str, int]:
    """City and band of density."""
    return fact.city, sum(fact.tracks > bound for bound in bounds)


def split_by_place(
    facts: Sequence[SourceScene], shares: Mapping[str, float], *, seed: int, bounds: Sequence[int]
) -> dict[str, list[int]]:
    """Rows of each split: groups go where they bring every city and density nearest to its share.

    shares: of the scenes, by split. A split with a share above 0 gets at least one group while there are enough.
    """
    groups = groups_of(facts)
    wanted = [split for split, share in shares.items() if share > 0]
    each = [Counter(stratum(facts[row], bounds) for row in rows) for rows in groups]
    strata = sorted({name for one in each for name in one})
    # the last column is the sum: small strata do not decide alone
    counts = np.array([[*(one[name] for name in strata), one.total()] for one in each]).reshape(-1, len(strata) + 1)
    target = np.outer([shares[split] for split in wanted], counts.sum(axis=0))
    have, number_of = np.zeros(target.shape), np.zeros(len(wanted), dtype=int)
    chosen: dict[str, list[int]] = {split: [] for split in shares}
    shuffled = np.random.default_rng(seed).permutation(len(groups))
    order = sorted(shuffled.tolist(), key=lambda number: -len(groups[number]))
    for done, number in enumerate(order):
        worse = (np.square(have + counts[number] - target) - np.square(have - target)).sum(axis=1)
        empty = np.flatnonzero(number_of == 0)
        if len(empty) >= len(order) - done:  # one for each of those that have none
            worse[number_of > 0] = np.inf
        split = int(np.argmin(worse))
        have[split] += counts[number]
        number_of[split] += 1
        chosen[wanted[split]] += groups[number]
    return {split: sorted(rows) for split, rows in chosen.items()}


def leaks_between(facts: Sequence[SourceScene], training: Sequence[int], held_out: Sequence[int]) -> list[Leak]:
    """Scenes for training that are, or come from, or lie where one of those held out does. Each is named once."""
    known = {sign: row for row in reversed(held_out) for sign, _ in _signs(facts[row])}  # by the first of each
    found = []
    for row in training:
        leak = next(((known[sign], why) for sign, why in _signs(facts[row]) if sign in known), None)
        if leak is not None:
            found.append(Leak(facts[row].folder, facts[leak[0]].folder, leak[1]))
    return found


def _signs(fact: SourceScene) -> Iterator[tuple[tuple[object, ...], str]]:
    """By what a scene is known again, and what to say of another one with the same; the plainest first."""
    yield ("scene", fact.scenario_id), "the same scene as"
    yield ("source", fact.source_id), f"made of the same recorded scene {fact.source_id} as"
    if fact.log:
        yield ("log", fact.log), f"cut from the same log {fact.log} as"
    for cell in np.frombuffer(fact.cells, dtype=np.int64).tolist():
        yield ("ground", fact.city, cell), "lies on the ground of"
