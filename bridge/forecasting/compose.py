"""`hid2 compose`: data-set roots of recorded and generated scenes, which readers of Argoverse 2 take unchanged.

Folders are real, files are hard links, or copies where the file system has none: readers that look with rglob do not
see linked folders. Same composition, same sources, same seed: the same root.
"""

import contextlib
import csv
import itertools
import os
import shutil
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from bridge.batch.engine import OnDone
from bridge.config import copy_id
from bridge.files import explained, untabled, write_rows, write_text
from bridge.forecasting.composition import Composition, Count, Draw
from bridge.forecasting.places import Leak, SourceScene, facts_of_scenes, leaks_between, split_by_place, stratum
from bridge.interruption import hidden_folder, remove_abandoned
from bridge.recordings.export import parquet_bytes
from bridge.recordings.folders import RAW, SPLITS, split_of
from bridge.recordings.scenario import MAX_STEPS
from bridge.recordings.sources import find_scenarios
from hid2.params import Forecasting
from netconvert.errors import ConfigError, NoSceneError, ScenarioError

ORIGINS, COMPOSITION = "origins.csv", "composition.json"
VALIDATION = "validation"


class Origin(NamedTuple):
    """One scene of a composed root, a row of origins.csv.

    scenario_id: its own, another one where it is a copy; kind: recorded, generated or copy; drawn: id of the scene it
    is; source_id: that of the recorded scene it comes from.
    """

    split: str
    scenario_id: str
    kind: str
    source: str
    drawn: str
    source_id: str
    city: str
    tracks: int
    observed: int
    folder: str


class Composed(NamedTuple):
    """What was made: scenes by data set and split, and lines on what was left out; unread: those on broken scenes."""

    root: Path
    counts: dict[str, dict[str, int]]
    left_out: tuple[str, ...]
    unread: tuple[str, ...]


def compose(
    composition: Composition, root: Path, *, jobs: int = 1, on_scene: Callable[[str, int, int], None] | None = None
) -> Composed:
    """Make a data-set root. on_scene(what is done, done, total).

    Errors: ConfigError where the root is there already, where a source has too few scenes, or where one scenario is in
    two sources; ExportError.
    """
    tell = on_scene or (lambda what, done, total: None)
    if root.exists() and (not root.is_dir() or any(root.iterdir())):
        raise ConfigError(f"{root}: is there already; choose another root, or remove it")
    pool = _Pool(composition, jobs=jobs, tell=lambda done, total: tell("reading scenes", done, total))
    every = composition.all_sets(pool.added())
    sets = {name: pool.draw("train", draw, f"sets.{name}") for name, draw in every.items()}
    validation = {name: pool.draw("val", draw, f"validation.{name}") for name, draw in composition.validation.items()}
    test, shared = pool.draw("test", composition.test, "test"), next(iter(validation.values()), [])
    nested = composition.nested
    roots = {(name if nested else ""): {"train": scenes, "val": shared, "test": test} for name, scenes in sets.items()}
    for name, scenes in validation.items() if nested or len(validation) > 1 else ():
        roots[f"{VALIDATION}/{name}"] = {"train": [], "val": scenes, "test": []}
    for split, drawn, table in (("val", any(validation.values()), "validation"), ("test", any(test), "test")):
        there = sum(len(scenes) for (name, _), scenes in pool.scenes.items() if name == split)
        if there and not drawn:
            way = f"set split.{split} = 0 or add" if composition.split.by == "place" else "add"
            pool.left_out.insert(0, f"{there} scenes held out for {split}, which no {table} takes; {way} [{table}]")
        elif split == "val" and composition.validation and composition.split.by == "place" and not there:
            pool.left_out.insert(
                0, "no scene held out for val: all are of one place or recording; add scenes of others"
            )
    total = sum(len(scenes) for splits in roots.values() for scenes in splits.values())
    if not total:
        raise ConfigError(f"{root}: no scene in any data set, expected one at least: take more (a share can be none)")
    done = 0
    with explained(root):
        root.parent.mkdir(parents=True, exist_ok=True)
        remove_abandoned(root.parent)
    with explained(root), hidden_folder(root.parent) as hidden:
        made = hidden / "root"
        write_text(made / COMPOSITION, composition.model_dump_json(indent=1) + "\n")
        for name, splits in roots.items():
            for split, scenes in splits.items():
                place = made / name / split / (RAW if composition.layout == "qcnet" else "")
                place.mkdir(parents=True, exist_ok=True)
                for scene in scenes:
                    _put(scene, place)
                    done += 1
                    tell("writing", done, total)
            write_rows(made / name / ORIGINS, Origin._fields, itertools.chain(*splits.values()))
        if root.exists():
            root.rmdir()  # empty
        made.rename(root)
    counts = {name: {split: len(scenes) for split, scenes in splits.items()} for name, splits in roots.items()}
    return Composed(root, counts, tuple(pool.left_out), tuple(pool.unread))


class _Pool:
    """The scenes of all sources by split, and how they are drawn."""

    def __init__(self, composition: Composition, *, jobs: int, tell: Callable[[int, int], None]) -> None:
        self._params, self._composition = Forecasting(), composition
        places = [(Path(place), name) for name, folders in composition.sources.items() for place in folders]
        source_of: dict[Path, str] = {}
        for folder, name in ((folder, name) for place, name in places for folder in find_scenarios(place)):
            if (other := source_of.setdefault(folder, name)) != name:  # one that comes twice in a source is one scene
                raise ConfigError(f"{folder}: in the sources {other!r} and {name!r}; leave it out of one")
        facts, self.unread = facts_of_scenes([*source_of], jobs=jobs, on_scene=tell)
        self.left_out, usable = [*self.unread], []
        seen: dict[tuple[str, str], SourceScene] = {}
        for fact in facts:
            name = source_of[fact.folder]
            if (same := seen.setdefault((name, fact.scenario_id), fact)) is not fact:
                raise ConfigError(f"{same.folder} and {fact.folder} are both {fact.scenario_id!r}; leave one out")
            if fact.steps < MAX_STEPS and not (composition.split.by == "folder" and split_of(fact.folder) == "test"):
                self.left_out.append(f"{fact.folder}: {fact.steps} of {MAX_STEPS} steps, no future to learn or score")
            elif fact.kind == "generated" and not fact.inserted:
                self.left_out.append(f"{fact.folder}: no vehicle was inserted, it is {fact.source_id} once more")
            else:
                usable.append(fact)
        if not usable:
            where, first = ", ".join(str(place) for place, _ in places), ", ".join(self.left_out[:1])
            raise NoSceneError(f"{where}: no scene that can be used; {first} ({len(self.left_out)} left out)")
        for name, count in composition.only.items():
            there = [fact for fact in usable if source_of[fact.folder] == name]
            taken = self._stratified(there, self._number(count, there, name, "scenes"), f"only {name}")
            dropped = {fact.folder for fact in there} - {fact.folder for fact in taken}
            usable = [fact for fact in usable if fact.folder not in dropped]
        self.scenes: dict[tuple[str, str], list[SourceScene]] = defaultdict(list)
        for split, rows in self._split(usable).items():
            for row in rows:
                self.scenes[split, source_of[usable[row].folder]].append(usable[row])

    def _split(self, facts: Sequence[SourceScene]) -> dict[str, list[int]]:
        composition = self._composition
        by_place = composition.split.by == "place"
        if by_place:
            shares, bounds = composition.split.shares, self._params.density_bounds
            splits = split_by_place(facts, shares, seed=composition.seed, bounds=bounds)
        else:
            splits = {split: [] for split in SPLITS}
            for row, fact in enumerate(facts):
                split = split_of(fact.folder)
                if split is None:
                    raise ConfigError(
                        f"{fact.folder}: in no folder train, val or test, which split.by = 'folder' goes by; "
                        "split by place instead"
                    )
                splits[split].append(row)
        known = facts if by_place else [fact._replace(cells=b"") for fact in facts]  # official sides share ground
        leaks = leaks_between(known, splits["train"], splits["val"] + splits["test"])
        leaks += leaks_between(known, splits["val"], splits["test"])
        # groups of places share nothing but ground, at the edges of their blocks
        self.left_out += [f"{leak.text()}, which is held out" for leak in leaks]
        dropped = {leak.folder for leak in leaks}
        return {split: [row for row in rows if facts[row].folder not in dropped] for split, rows in splits.items()}

    def added(self) -> int:
        """How many scenes are added to each control. Errors: ConfigError where the sources have none."""
        controls = self._composition.controls
        if controls is None or controls.added != "all":
            return 1 if controls is None else int(controls.added)
        there = {name: len(self.scenes["train", name]) for name in (controls.generated, controls.without_interaction)}
        if not min(there.values()):
            raise ConfigError(f"controls: source {min(there, key=lambda name: there[name])!r} has no scene in train")
        return min(there.values())

    def draw(self, split: str, draw: Draw, where: str) -> list[Origin]:
        """The scenes of one split of one data set. Errors: ConfigError where there are too few."""
        scenes: list[Origin] = []
        copies: Counter[str] = Counter()
        agents: Callable[[SourceScene], int] = attrgetter("tracks" if draw.min_agents_in == "all" else "observed")
        for source in draw.sources:
            there = [fact for fact in self.scenes[split, source] if agents(fact) >= draw.min_agents]
            wanted = self._number(draw.take.get(source, 0), there, source, f"{where}: {split}")
            taken = self._stratified(there, wanted, f"{split} {source}")
            chosen = {fact.scenario_id for fact in taken}
            left = _densest((fact for fact in there if fact.scenario_id not in chosen), agents)
            dense = left[: draw.densest.get(source, 0)]
            lacking = draw.densest.get(source, 0) - len(dense)
            scenes += [_origin(split, source, fact) for fact in (*taken, *dense)]
            for number, among in (
                (draw.again.get(source, 0), self._shuffled(taken, f"{split} {source} again")),
                (lacking, _densest(taken, agents)[: max(1, min(lacking, (len(taken) + 1) // 2))]),
            ):
                if number and not among:
                    raise ConfigError(f"{where}: nothing of {source!r} to draw again in {split}; take some")
                for fact in itertools.islice(itertools.cycle(among), number):
                    copies[fact.scenario_id] += 1
                    scenes.append(_origin(split, source, fact, copy=copies[fact.scenario_id]))
        twice = [name for name, number in Counter(scene.scenario_id for scene in scenes).items() if number > 1]
        if twice:
            both = " and ".join(scene.folder for scene in scenes if scene.scenario_id == twice[0])
            raise ConfigError(f"{where}: scene {twice[0]} is in two of the sources, {both}; leave it out of one")
        return scenes

    def _number(self, count: Count, there: Sequence[SourceScene], source: str, where: str) -> int:
        """How many scenes of those of a source are asked for. Errors: ConfigError where there are too few."""
        wanted = len(there) if count == "all" else round(count * len(there)) if isinstance(count, float) else count
        if wanted > len(there):
            raise ConfigError(
                f"{where}: {wanted} of {source!r} ({', '.join(self._composition.sources[source])}) asked for, "
                f"{len(there)} are there ({len(self.left_out)} of all sources were left out); ask for fewer, or for all"
            )
        return wanted

    def _shuffled(self, facts: Sequence[SourceScene], what: str) -> list[SourceScene]:
        """In an order drawn for each purpose apart, so that a further data set changes no other."""
        ranked = sorted(facts, key=lambda fact: fact.scenario_id)
        random = np.random.default_rng([self._composition.seed, *what.encode()])
        return [ranked[index] for index in random.permutation(len(ranked))]

    def _stratified(self, facts: Sequence[SourceScene], number: int, what: str) -> list[SourceScene]:
        """So many, of each city and density in proportion (largest remainders), in the order of `facts`."""
        if number == len(facts):
            return list(facts)
        strata: dict[tuple[str, int], list[SourceScene]] = defaultdict(list)
        for fact in self._shuffled(facts, what):
            strata[stratum(fact, self._params.density_bounds)].append(fact)
        names = sorted(strata)
        exact = np.array([number * len(strata[name]) / len(facts) for name in names])
        counts = np.floor(exact).astype(int)
        counts[np.argsort(-(exact - counts), kind="stable")[: number - counts.sum()]] += 1
        chosen = {fact.scenario_id for name, count in zip(names, counts, strict=True) for fact in strata[name][:count]}
        return [fact for fact in facts if fact.scenario_id in chosen]


def _densest(facts: Iterable[SourceScene], agents: Callable[[SourceScene], int]) -> list[SourceScene]:
    """The densest first."""
    return sorted(facts, key=lambda fact: (-agents(fact), fact.scenario_id))


def _origin(split: str, source: str, fact: SourceScene, *, copy: int = 0) -> Origin:
    """A scene that is drawn. copy: 0, or which further copy of it, with an id of its own."""
    own, of = fact.scenario_id, (fact.source_id, fact.city, fact.tracks, fact.observed, str(fact.folder))
    name, kind = (copy_id(own, copy), "copy") if copy else (own, fact.kind)
    return Origin(split, name, kind, source, own, *of)


def _put(scene: Origin, place: Path) -> None:
    """Write one scene's folder. A copy has another id: its rows are written anew, its other files take the new name."""
    own, new = scene.drawn, scene.scenario_id
    target = place / new
    target.mkdir()
    for entry in sorted(os.scandir(scene.folder), key=lambda entry: entry.name):
        if not entry.is_file() or entry.name.startswith("."):
            continue
        name = entry.name.replace(own, new)
        if name != entry.name == f"scenario_{own}.parquet":
            table = pq.read_table(entry.path)
            index = table.schema.get_field_index("scenario_id")
            ids = pa.repeat(pa.scalar(new).cast(table.schema.field(index).type), table.num_rows)
            (target / name).write_bytes(parquet_bytes(table.set_column(index, table.schema.field(index), ids)))
        else:
            try:
                os.link(Path(entry.path).resolve(), target / name)
            except OSError:  # another file system, or one without links, or too many of them
                shutil.copyfile(entry.path, target / name)


def check_leaks(root: Path, *, jobs: int = 1, on_scene: OnDone = None) -> list[Leak]:
    """Training scenes of a root, or of the roots in it, that tell of a validation or test scene of the same.

    root: a data-set root, or a composed one with several. What the files say counts, and origins.csv where a copy has
    lost its source. Errors: NoSceneError where there is no scene; ScenarioError for one that cannot be read.
    """
    roots = [root] if any((root / split).is_dir() for split in SPLITS) else _roots_in(root)
    held_out = _roots_in(root / VALIDATION)
    folders: dict[Path, list[Path]] = {}
    for place in [*roots, *held_out]:
        with contextlib.suppress(NoSceneError):
            folders[place] = find_scenarios(place)
    everything = list(dict.fromkeys(folder for found in folders.values() for folder in found))
    if not everything:
        raise NoSceneError(f"{root}: no scene in folders train, val or test")
    facts, unread = facts_of_scenes(everything, jobs=jobs, on_scene=on_scene)
    if unread:
        raise ScenarioError(f"{root}: {len(unread)} scenes cannot be read, the first: {unread[0]}")
    source_of = {name: source for place in folders for name, source in origins_of(place).items()}
    facts = [fact._replace(source_id=source_of.get(fact.scenario_id, fact.source_id)) for fact in facts]
    row_of = {fact.folder: row for row, fact in enumerate(facts)}
    found: dict[Path, Leak] = {}
    for place in roots:
        train, val, test = ([row_of[f] for f in folders.get(place, ()) if split_of(f) == split] for split in SPLITS)
        outside = list(dict.fromkeys(val + [row_of[f] for other in held_out for f in folders.get(other, ())]))
        for leak in (*leaks_between(facts, train, outside + test), *leaks_between(facts, val, test)):
            found.setdefault(leak.folder, leak)
    return list(found.values())


def _roots_in(root: Path) -> list[Path]:
    children = sorted(root.iterdir()) if root.is_dir() else []
    return [child for child in children if any((child / split).is_dir() for split in SPLITS)]


def origins_of(root: Path) -> dict[str, str]:
    """Recorded scene by scenario id, of a data-set root's origins.csv; empty without one. Errors: ScenarioError."""
    path = root / ORIGINS
    if not path.is_file():
        return {}
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream))
        return {untabled(row["scenario_id"]): untabled(row["source_id"]) for row in rows}
    except (OSError, ValueError, KeyError, TypeError, csv.Error) as error:  # damaged, or another program's
        raise ScenarioError(f"{path}: {error!r:.99}, expected columns scenario_id, source_id; compose anew") from error
