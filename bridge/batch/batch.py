"""Many scenes: what to do, what is done already, where it is done, and what became of each.

Every scene runs in an isolated process (see `engine`). A scene that has no result is quarantined: it leaves a
bundle in OUT/quarantine that reproduces the failure, and the batch goes on.
"""

import contextlib
import hashlib
import logging
import math
import os
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from platform import platform
from tempfile import TemporaryDirectory

from bridge.batch.engine import Task, TaskResult, execute_here
from bridge.batch.isolation import Settings
from bridge.batch.manifest import DONE, MAX_TEXT, QUARANTINED, Manifest, ManifestRow, files_sha256, output_files
from bridge.batch.quarantine import MAX_TIMEOUT_S, Bundle, read_bundle, write_bundle
from bridge.config import (
    check_exportable,
    check_function,
    config_sha256,
    find_in_working_folder,
    functions_of,
    new_scenario_id,
)
from bridge.files import explained, one_line
from bridge.generation.program import code_version, processor
from bridge.interruption import locked, remove_abandoned, tidied
from bridge.recordings.folders import SEQUENCES, SPLITS, Address, sequence_path, source_id, split_of
from bridge.recordings.sources import source_files
from hid2.params import Config
from netconvert.errors import BatchError, ConfigError, DiskFullError, ExportError

#: Folders of OUT: bundles, and what the runs of a study have measured.
QUARANTINE, RUNS = "quarantine", "runs"
#: Bytes of a scene's name in that of its bundle; file systems take 255 in all.
_LONGEST_NAME = 150
#: All in which something half-written may be left.
_WRITTEN_IN = (*SPLITS, RUNS, QUARANTINE, f"{QUARANTINE}/*", f"{SEQUENCES}/*", f"{SEQUENCES}/*/*")
GENERATE = "bridge.batch.scene_work:generate_runs"
#: Most runs on a recording that one process does before they are in the manifest: a power cut costs no more.
RUNS_OF_A_TASK = 24

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Run:
    """One generated scene that is wanted. rule_sha256: of the file of a lane-change rule of the user's own."""

    config: Config
    variant: int = 0
    rule_sha256: str = ""


@dataclass(frozen=True, slots=True)
class SceneJob:
    """A recording and the runs on it, which share its map, net and replay."""

    folder: Address
    runs: tuple[Run, ...]


@dataclass(frozen=True, slots=True)
class SceneFolders:
    """Where a recording is read and its results are written, as `Options` has it; the digest of it, "" where unread."""

    folder: Address
    out: Path
    argoverse1: bool = False
    gaps: bool = False
    source_sha256: str = ""


@dataclass(frozen=True, slots=True)
class Options(Settings):
    """How a batch, and each scene of it, runs. Errors: ConfigError.

    scheduler: address of Dask's; resume: skip what is complete and unchanged; argoverse1: write its sequences as well;
    gaps: write every look at a gap; functions: rules and behaviours of a user's own, module:name, that may be imported;
    contents: what OUT holds of a study or a page, which alone goes on there.
    """

    jobs: int = 1
    scheduler: str | None = None
    resume: bool = False
    function: str = GENERATE
    argoverse1: bool = False
    gaps: bool = False
    functions: Collection[str] = ()
    contents: str = ""

    def __post_init__(self) -> None:
        """Refuse a time that would never come."""
        if not (math.isfinite(self.timeout_s) and 1 <= self.timeout_s <= MAX_TIMEOUT_S):
            raise ConfigError(f"scene-timeout {self.timeout_s:g}: expected 1 to {MAX_TIMEOUT_S:g} s")


@dataclass(slots=True)
class Progress:
    """Counts so far. total: runs in all; skipped: found complete and unchanged."""

    total: int
    done: int = 0
    skipped: int = 0
    quarantined: int = 0


#: What is called after every run.
OnRow = Callable[[ManifestRow, Progress], None]


def plan(folders: Iterable[Address], config: Config) -> list[SceneJob]:
    """One job for every recording, with the variants asked for; variant 0 is the same however many there are."""
    check_exportable(config)
    single = config.model_copy(update={"request": config.request.model_copy(update={"variants": 1})})
    runs = tuple(Run(single, variant) for variant in range(config.request.variants))
    return [SceneJob(folder, runs) for folder in folders]


def run_batch(
    jobs: Sequence[SceneJob], out_dir: Path | str, options: Options | None = None, *, on_row: OnRow | None = None
) -> list[ManifestRow]:
    """Do the jobs, write OUT/manifest.csv, return the rows of these jobs in the manifest's order.

    on_row is called after every run, also for those found complete. When it is interrupted, or the disk is full, the
    manifest holds what is done and nothing is half-written; a later call with `resume` goes on from there.
    Errors: BatchError, ExportError where OUT cannot be written; ConfigError where results get in the way of others.
    """
    options = options or Options()
    on_row = on_row or (lambda row, progress: None)
    out_dir = Path(out_dir).resolve()
    _check_places(jobs, out_dir)
    progress = Progress(total=sum(len(job.runs) for job in jobs))
    rows: list[ManifestRow] = []
    jobs = with_own(jobs, options.functions)
    remove = partial(remove_abandoned, out_dir, *_WRITTEN_IN)
    with _locked(out_dir), tidied(remove):
        remove()
        manifest = Manifest(out_dir)
        _check_owners(jobs, manifest, out_dir)
        if options.contents:
            manifest.name_contents(options.contents)
        tasks = _tasks(jobs, out_dir, options, manifest, lambda row: note(row, skipped=True))

        def note(row: ManifestRow, *, skipped: bool = False) -> None:
            rows.append(row)
            progress.skipped += skipped
            progress.done += row.status == DONE and not skipped
            progress.quarantined += row.status == QUARANTINED
            on_row(row, progress)

        try:
            if options.scheduler is None:
                results = execute_here(tasks, jobs=options.jobs, settings=options)
            else:
                from bridge.batch.cluster import execute_on_dask  # imports distributed, which takes a second

                results = execute_on_dask(tasks, scheduler=options.scheduler, settings=options)
            with contextlib.closing(results):
                for outcome in chain.from_iterable(results):
                    row = _row(outcome, options)
                    manifest.add(row)
                    note(row)
            manifest.save()
        except BaseException as error:
            with contextlib.suppress(ExportError):  # what was appended is there all the same
                manifest.save()
            if isinstance(error, DiskFullError):
                said = f"{error}; finished scenes are in {manifest.path}, make room and continue with --resume"
                raise DiskFullError(said) from error
            raise
    return sorted(rows, key=lambda row: row.key)


def own_files(configs: Sequence[Config], functions: Collection[str]) -> dict[str, tuple[str, str]]:
    """Key and file, by name, of each rule and behaviour of a user's own in configurations; they are imported and tried.

    functions: those that may be imported. They are looked for in the working folder last. Errors: ConfigError.
    """
    named = {name: key for one in configs for name, key in functions_of(one).items()}
    for name, key in sorted(named.items()):
        check_function(name, functions, where=key)
        if name.startswith("__main__:"):
            raise ConfigError(f"{key} = {name!r}: a batch finds nothing in a script; put it into a module of its own")
    if not named:
        return {}
    from hid2.policy.behaviours import load_own  # only where there are any
    from hid2.policy.rules import check_user_rule

    find_in_working_folder()
    changes = {(one.lane_change.rule, one.lane_change.rule_with): one.lane_change for one in configs}
    files = {rule: check_user_rule(change) for (rule, _), change in sorted(changes.items()) if rule in named}
    own = load_own(sorted({name for one in configs for name in one.request.own_behaviours}))
    files |= {name: str(sys.modules[name.partition(":")[0]].__file__) for name in own}
    return {name: (named[name], file) for name, file in files.items()}


def with_own(jobs: Sequence[SceneJob], functions: Collection[str]) -> Sequence[SceneJob]:
    """The jobs with the digests of `own_files`, which are said; functions and errors as there."""
    found = own_files([run.config for job in jobs for run in job.runs], functions)
    digests = {name: hashlib.sha256(Path(file).read_bytes()).hexdigest() for name, (_, file) in found.items()}
    for name, (key, file) in found.items():
        _LOG.warning("%s = %s is imported from %s and run", key, name, file)

    def known(run: Run) -> Run:
        return replace(run, rule_sha256=" ".join(digests[name] for name in functions_of(run.config)))

    return [replace(job, runs=tuple(map(known, job.runs))) for job in jobs]


def _check_owners(jobs: Sequence[SceneJob], manifest: Manifest, out_dir: Path) -> None:
    """What a scene wrote is not replaced by another one of its id, by the names of files. Errors: ConfigError."""
    known = {(row.split, Path(row.folder).name): row for row in manifest.rows if row.folder}
    for job in jobs if known else ():
        scenario_id, split = source_id(job.folder), split_of(job.folder) or ""
        for run in job.runs:
            other = known.get((split, new_scenario_id(scenario_id, run.config, run.config.request.seed, run.variant)))
            if other is not None and other.scenario != _name(job.folder):
                raise ConfigError(
                    f"{job.folder}: scene {scenario_id!r} is in {out_dir / other.folder} already, made from "
                    f"another folder, {other.scenario!r}: expected another OUT, or the folder's name as it was"
                )


def base_row(place: SceneFolders, run: Run, folder: Path | None = None) -> ManifestRow:
    """What is known about a run before it starts; folder: what it has written."""
    return ManifestRow(
        scenario=_name(place.folder),
        split=split_of(place.folder) or "",
        variant=run.variant,
        seed=run.config.request.seed,
        status=DONE,
        requested=str(run.config.request.agents),
        source_sha256=place.source_sha256,
        config_sha256=config_sha256(run.config),
        rule_sha256=run.rule_sha256,
        version=code_version(),
        platform=platform(),
        processor=processor(),
        folder="" if folder is None else folder.relative_to(place.out).as_posix(),
        output_sha256="" if folder is None else files_sha256(_written(place, folder)),
    )


def reproduce(path: Path, out_dir: Path | None, *, functions: Collection[str] = ()) -> tuple[Bundle, ManifestRow]:
    """Run what a bundle holds again, isolated, with its own limits; out_dir: for its scene, None: nothing is kept.

    functions: beyond hid2's own, that the bundle may ask for. Errors: BatchError for a file that is no bundle.
    """
    with TemporaryDirectory(prefix="hid2-repro-") as scratch:
        bundle = read_bundle(path, Path(scratch), functions=functions)
        options = Options(timeout_s=bundle.timeout_s, function=bundle.function, functions=functions)
        job = SceneJob(bundle.folder, (Run(bundle.config, bundle.variant),))
        (row,) = run_batch([job], out_dir or Path(scratch, "out"), options)
    return bundle, row


def _check_places(jobs: Sequence[SceneJob], out_dir: Path) -> None:
    """Raise ConfigError where two scenes would be written to one place, or beside the sources."""
    taken: dict[tuple[str, str], Address] = {}
    for folder in dict.fromkeys(job.folder.absolute() for job in jobs):
        split, real = split_of(folder) or "", folder.resolve()
        if real.parent in (out_dir, out_dir / split):
            raise ConfigError(f"{real.parent} holds the input; choose another output folder than {out_dir}")
        for name in {_name(folder), source_id(folder)}:  # of its row, and of what is written
            other = taken.setdefault((split, name), folder)
            if other != folder:
                raise ConfigError(f"{other} and {folder} are both scene {name!r}; leave one out")


def _tasks(
    jobs: Sequence[SceneJob], out_dir: Path, options: Options, manifest: Manifest, skip: Callable[[ManifestRow], None]
) -> Iterator[Task]:
    """Yield tasks for every job that has something to do; called as workers become free."""
    for job in jobs:
        folder = job.folder.absolute()
        place = SceneFolders(folder, out_dir, options.argoverse1, options.gaps, _digest(folder))
        wanted = []
        for run in job.runs:
            base = base_row(place, run)
            row = manifest.by_key.get(base.key) if options.resume else None
            if row is not None and _is_complete(row, base, place):
                skip(row)
            else:
                wanted.append(run)
        for first in range(0, len(wanted), RUNS_OF_A_TASK):
            yield Task(place.folder.name, options.function, place, tuple(wanted[first : first + RUNS_OF_A_TASK]))


def _name(folder: Address) -> str:
    """What a recording is called in the manifest: its folder's name, with bytes that are no text escaped."""
    return one_line(folder.name, most=MAX_TEXT)


def _digest(folder: Address) -> str:
    """Digest of a source; "" where it cannot be read: the scene is tried, and says why."""
    try:
        return files_sha256(source_files(folder))
    except OSError as error:
        _LOG.warning("%s: cannot be read (%s)", folder, error.strerror)
        return ""


def _is_complete(row: ManifestRow, base: ManifestRow, place: SceneFolders) -> bool:
    """Whether all that was asked for is there, as it was written, and would be written again."""
    folder = place.out / row.folder
    return (
        row.status == DONE
        and base.source_sha256 != ""
        and (row.version, row.source_sha256, row.rule_sha256) == (base.version, base.source_sha256, base.rule_sha256)
        and row.output_sha256 != ""
        and all(path.is_file() for path in _written(place, folder))
        and row.output_sha256 == files_sha256(_written(place, folder))
        and (not place.gaps or any(folder.glob("gaps_*.csv.gz")))
    )


def _written(place: SceneFolders, folder: Path) -> list[Path]:
    """What is written of a scene: the files of its folder and, where asked for, its sequence of Argoverse 1."""
    sequence = [sequence_path(place.out, split_of(place.folder), folder.name)] if place.argoverse1 else []
    return [*output_files(folder), *sequence]


def _row(outcome: TaskResult, options: Options) -> ManifestRow:
    """The manifest's row about an outcome; a failure leaves its bundle."""
    place: SceneFolders = outcome.task.shared
    run: Run = outcome.item
    failure = outcome.failure
    if failure is not None and failure.kind == "disk":  # the next scene would fail no less
        raise DiskFullError(failure.message)
    row = base_row(place, run) if failure else outcome.value
    if row.version != code_version():
        raise BatchError(
            f"a worker runs hid2-sumo {row.version}, expected {code_version()} as here "
            "(installed from other source, or edited while the batch ran)"
        )
    row = row._replace(attempts=outcome.attempts, seconds=round(outcome.seconds, 3))
    digest = hashlib.sha256(f"{row.scenario}\n{row.config_sha256}".encode()).hexdigest()[:8]
    named = row.scenario.encode()[:_LONGEST_NAME].decode(errors="ignore")
    path = place.out / QUARANTINE / (row.split or ".") / f"{named}_{digest}_{row.variant}.zip"
    if failure is None:
        path.unlink(missing_ok=True)
        return row
    write_bundle(
        Bundle(place.folder, run.config, run.variant, options.timeout_s, options.function, failure, row.version), path
    )
    reason, bundle = one_line(failure.message, most=MAX_TEXT), path.relative_to(place.out).as_posix()
    return row._replace(status=QUARANTINED, failure=failure.kind, reason=reason, bundle=bundle)


@contextlib.contextmanager
def _locked(out_dir: Path) -> Iterator[None]:
    """Keep other batches out of a folder. Errors: BatchError, ExportError."""
    with contextlib.ExitStack() as stack:
        with explained(out_dir):
            out_dir.mkdir(parents=True, exist_ok=True)
            flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK  # not what a link there names
            is_mine = stack.enter_context(locked(out_dir / ".hid2.lock", flags))
        if not is_mine:
            raise BatchError(f"{out_dir}: another run is writing there, or its file system has no locks (flock)")
        yield
