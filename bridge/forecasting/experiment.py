"""`hid2 paper prediction`: the paper's Tables 2 and 3, from recorded scenes to the page, with the small forecaster.

Scenes are generated from every recorded one, with and without interaction; `compose` makes the control data sets; the
forecaster is trained on each with every seed, the same number of updates each; its forecasts of the validation scenes
are scored and compared in pairs. Forecasts from elsewhere on a composed root take the place of the first three steps.
"""

import itertools
import logging
import shutil
import sys
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, NamedTuple

import pandas as pd

from bridge.batch.batch import Options, Run, SceneJob, run_batch
from bridge.batch.batch import Progress as BatchProgress
from bridge.batch.engine import Task, execute_here
from bridge.batch.isolation import Settings
from bridge.batch.manifest import DONE, ManifestRow
from bridge.files import data_folder, make_folder, write_json, write_rows
from bridge.forecasting import predictions as scoring
from bridge.forecasting.compose import COMPOSITION, VALIDATION, compose
from bridge.forecasting.composition import CONTROLS, HID2_ONLY, Composition, Controls, Draw, Split
from bridge.forecasting.places import generated_sidecar
from bridge.pages import parts as pages
from bridge.recordings.sources import find_scenarios, find_sources
from hid2.params import Config, Forecasting, Request
from hid2.resampling import Estimate
from netconvert.errors import BatchError, ConfigError, ScenarioError

_LOG = logging.getLogger(__name__)
#: Which track of a generated scene is forecast: the recorded focal one, an inserted one, or both in turn by variant.
Reading = Literal["recorded", "generated", "both"]
#: Training sets of the tables.
SETS = (*CONTROLS, HID2_ONLY)
#: Validation sets of the tables.
RECORDED, HID2 = "recorded", "hid2"
#: What the paper's tables have: minADE, minFDE and MR of six futures.
_COLUMNS: tuple[scoring.MetricKey, ...] = ("min_ade_m", "min_fde_m", "missed")
#: Table 2: trained on, then on Argoverse 2 and on HiD2.
PAPER_TABLE2: Mapping[str, Sequence[float]] = {
    "paper: QCNet, Argoverse 2": (0.845, 1.573, 0.228, 0.925, 1.701, 0.254),
    "paper: QCNet, HiD2": (0.849, 1.584, 0.223, 0.835, 1.537, 0.211),
    "paper: DeMo, Argoverse 2": (0.745, 1.511, 0.208, 0.823, 1.645, 0.234),
    "paper: DeMo, HiD2": (0.765, 1.548, 0.221, 0.779, 1.530, 0.212),
}
#: Table 3: more than 50, 70 and 90 agents.
PAPER_TABLE3: Mapping[str, Sequence[float]] = {
    "paper: QCNet, Argoverse 2": (0.728, 1.237, 0.160, 0.734, 1.257, 0.166, 0.745, 1.243, 0.169),
    "paper: QCNet, Argoverse 2 and HiD2": (0.723, 1.214, 0.152, 0.730, 1.206, 0.160, 0.731, 1.217, 0.161),
    "paper: DeMo, Argoverse 2": (0.674, 1.320, 0.167, 0.688, 1.327, 0.173, 0.696, 1.357, 0.176),
    "paper: DeMo, Argoverse 2 and HiD2": (0.663, 1.291, 0.164, 0.678, 1.293, 0.167, 0.641, 1.219, 0.153),
}
#: The paper's smallest gain of minFDE, m: QCNet, more than 50 agents.
PAPER_GAIN_M = 0.023
#: The small forecaster, which needs the extra `forecast`.
_SCRIPT = data_folder() / "examples" / "small_forecaster.py"

Progress = Callable[[str, int, int], None]
_Scores = dict[str, dict[str, list[pd.DataFrame]]]  # by validation set and training set, a table for each seed


class TrainingPlan(NamedTuple):
    """What is run: seeds of the training, vehicles added, scenes made of each recorded one, and the parameters."""

    seeds: int = 3
    agents: int = 10
    reading: Reading = "both"
    params: Forecasting = Forecasting()


def run_prediction(
    scenes: Sequence[Path], out: Path, plan: TrainingPlan, composed: Path | None = None,
    predictions: Path | None = None, *, jobs: int = 1, on_step: Progress | None = None,
) -> Path:  # fmt: skip
    """Run the experiment and write prediction.html, .json and _scores.csv into `out`; returns the page.

    scenes: recorded scenes of Argoverse 2. Called again, it goes on from what `out` holds. composed: a root that
    `compose` made with the controls and validation sets `recorded` and `hid2`, instead of one made here. predictions: a
    folder of files SET/SEED/VALIDATION.parquet, instead of those of the small forecaster. Errors: ConfigError where
    torch is missing and needed, or files are, or for recordings of another format; ScenarioError, ExportError;
    BatchError where no scene can be generated.
    """
    tell = on_step or (lambda what, done, total: None)
    if predictions is not None and composed is None:
        raise ConfigError("--predictions DIR needs --composed ROOT, the data sets that they were made with; give both")
    if predictions is None:
        check_forecaster()
    make_folder(out)
    own = composed is None
    if composed is None:
        composed = _composed(scenes, out, plan, jobs=jobs, tell=tell)
    lacking = [name for name in (RECORDED, HID2) if not (composed / VALIDATION / name / "val").is_dir()]
    if lacking:
        raise ConfigError(f"{composed}: no {VALIDATION}/{lacking[0]}/val, expected a root that `hid2 compose` made")
    brought = predictions is not None
    if predictions is None:
        predictions = out / "models"
        _train(composed, predictions, plan, jobs=jobs, tell=tell)
    seeds = None if brought else range(plan.seeds)  # those of an earlier call with more stay aside
    runs = _scores(composed, predictions, seeds, jobs=jobs, tell=tell)
    reading, updates = plan.reading if own else None, None if brought else plan.params.updates
    return _write(runs, composed, out, plan.params, reading=reading, updates=updates)


# From recorded scenes to data sets


def _composed(scenes: Sequence[Path], out: Path, plan: TrainingPlan, *, jobs: int, tell: Progress) -> Path:
    folders = find_sources(scenes)
    other = next((folder for folder in folders if not isinstance(folder, Path)), None)
    if other is not None:
        raise ConfigError(f"{other}: {other.format}, expected Argoverse 2 scenes alone, which prediction is about")
    places = {}
    made: dict[str, int] = {}

    def count(_: ManifestRow, progress: BatchProgress) -> None:
        made[name] = progress.done
        tell(f"generating {name}", progress.done + progress.skipped + progress.quarantined, progress.total)

    # what another request made, or of other folders, lies elsewhere: a source is all that its folder holds
    asked = *map(str, scenes), plan.agents, plan.reading, plan.params.variants
    generated = out / "generated" / f"{zlib.crc32(repr(asked).encode()):08x}"
    for name, without in (("hid2", frozenset[str]()), ("no-interaction", frozenset({"collision"}))):
        places[name] = generated / name
        work = [SceneJob(folder, _runs(plan, without)) for folder in folders]
        tell(f"generating {name}", 0, sum(len(job.runs) for job in work))
        rows = run_batch(work, places[name], Options(jobs=jobs, resume=True, timeout_s=600), on_row=count)
        if not any(row.status == DONE for row in rows):
            raise BatchError(f"{places[name]}: no scene could be generated; {rows[0].reason}")
    composition = Composition(
        split=Split(val=plan.params.val_share),
        sources={"recorded": tuple(map(str, scenes))} | {name: (str(place),) for name, place in places.items()},
        controls=Controls(recorded="recorded", generated="hid2", without_interaction="no-interaction"),
        validation={RECORDED: Draw(take={"recorded": "all"}), HID2: Draw(take={"hid2": "all"})},
    )
    root, text = out / "composed", composition.model_dump_json(indent=1) + "\n"
    there = (root / COMPOSITION).is_file()
    if not there or any(made.values()) or (root / COMPOSITION).read_text(encoding="utf-8") != text:
        if there:  # of another composition, or of scenes that have been made anew since
            shutil.rmtree(root)
        for line in compose(composition, root, jobs=jobs, on_scene=tell).unread:
            _LOG.warning("left out: %s", line)
    return root


def _runs(plan: TrainingPlan, without: frozenset[str]) -> tuple[Run, ...]:
    """The variants of a scene; with both readings every other one has an inserted focal track."""
    runs = []
    for variant in range(plan.params.variants):
        focal = plan.reading if plan.reading != "both" else ("recorded", "generated")[variant % 2]
        request = Request.model_validate({"agents": plan.agents, "focal": focal})
        runs.append(Run(Config.model_validate({"request": request, "without": without}), variant))
    return tuple(runs)


# From data sets to forecasts


def _train(composed: Path, models: Path, plan: TrainingPlan, *, jobs: int, tell: Progress) -> None:
    """Train on every set with every seed and forecast every validation set, each set in a process of its own."""
    validation = {name: composed / VALIDATION / name / "val" for name in (RECORDED, HID2)}
    work, seeds = "bridge.forecasting.experiment:train_and_forecast", tuple(range(plan.seeds))
    tasks = [
        Task(name, work, (composed / name / "train", validation, models / name, plan.params.updates), seeds)
        for name in SETS
    ]
    tell("training", 0, len(SETS) * plan.seeds)
    settings = Settings(timeout_s=86_400, memory_mb=32_000)  # torch reserves more than it uses
    for done, outcomes in enumerate(execute_here(tasks, jobs=min(jobs, len(SETS)), settings=settings), 1):
        for outcome in outcomes:
            if outcome.failure is not None:
                raise BatchError(f"training on {outcome.task.key}, seed {outcome.item}: {outcome.failure.message}")
        tell("training", done * plan.seeds, len(SETS) * plan.seeds)


def check_forecaster() -> None:
    """Errors: ConfigError where torch is not there, with what to do; it is not imported."""
    if find_spec("torch") is None:
        raise ConfigError(
            "the small forecaster needs the extra `forecast` (torch): run `sh setup.sh forecast` in the checkout, "
            "or install torch into this environment"
        )


def small_forecaster() -> tuple[ModuleType, ModuleType]:
    """Its modules: what it sees of scenes, and its network, which imports torch. Errors: ConfigError."""
    check_forecaster()
    if str(_SCRIPT.parent) not in sys.path:
        sys.path.append(str(_SCRIPT.parent))
    return import_module("scene_features"), import_module(_SCRIPT.stem)


def train_and_forecast(shared: tuple[Path, Mapping[str, Path], Path, int], seeds: Sequence[int]) -> Iterator[int]:
    """The work of a process: one training for each seed, and its forecasts. Yields the seeds."""
    scenes, network = small_forecaster()
    training, validation, models, updates = shared
    targets, left_out = scenes.features_of(find_scenarios(training))
    held_out = {}
    for name, place in validation.items():
        held_out[name], unread = scenes.features_of(find_scenarios(place))
        left_out += unread
    if left_out:
        raise ScenarioError(f"{len(left_out)} scenes cannot be read, the first: {left_out[0]}")
    for seed in seeds:
        folder = models / str(seed)
        try:
            model = network.train(targets, folder / "checkpoint.pt", updates=updates, seed=seed, resume=True)
        except ConfigError:  # of other scenes or updates
            model = network.train(targets, folder / "checkpoint.pt", updates=updates, seed=seed)
        for name, found in held_out.items():
            scoring.write_forecasts(network.forecast(model, found), folder / f"{name}.parquet")
        yield seed


# From forecasts to tables


def _scores(composed: Path, predictions: Path, seeds: Sequence[int] | None, *, jobs: int, tell: Progress) -> _Scores:
    """Scores by validation set and training set, a table for each seed. Errors: ConfigError for a missing file."""
    pairs = itertools.product(SETS, (RECORDED, HID2))
    files = [(on, name, path) for name, on in pairs for path in _files(predictions / name, f"{on}.parquet", seeds)]
    runs: _Scores = {RECORDED: {}, HID2: {}}
    for done, (on, name, path) in enumerate(files, 1):
        place = composed / VALIDATION / on / "val"
        scores, left_out = scoring.score_predictions(place, predictions=path, jobs=jobs)
        if left_out:
            raise ScenarioError(f"{path}: {len(left_out)} not scored, the first: {left_out[0]}")
        runs[on].setdefault(name, []).append(scores)
        tell("scoring", done, len(files))
    return runs


def _files(folder: Path, name: str, seeds: Sequence[int] | None) -> list[Path]:
    """The forecasts of a training set on a validation set, one file a seed. Errors: ConfigError for a missing one."""
    runs = sorted(folder.glob("*")) if seeds is None else [folder / str(seed) for seed in seeds]
    found = [seed / name for seed in runs if seed.is_dir()]
    missing = next((path for path in found or [folder / "0" / name] if not path.is_file()), None)
    if missing is not None:
        raise ConfigError(f"{missing}: no such file; expected DIR/SET/SEED/VALIDATION.parquet of every set and seed")
    return found


def _table(
    paper: Mapping[str, Sequence[float]], ours: Mapping[str, Sequence[scoring.Runs]], names: Sequence[str],
    source_of: Mapping[str, str], params: Forecasting,
) -> list[dict[str, Any]]:  # fmt: skip
    """The paper's rows and ours, by label: every metric of each of a row's runs, by name, ready for JSON."""
    rows = [(label, [Estimate(value) for value in values]) for label, values in paper.items()]
    rows += [
        (f"ours: {label}", [scoring.mean_of(one, source_of, metric, params) for one in runs for metric in _COLUMNS])
        for label, runs in ours.items()
    ]
    return [{"row": label} | dict(zip(names, (one._asdict() for one in cells), strict=True)) for label, cells in rows]


def _differences(
    runs: Mapping[str, Mapping[str, scoring.Runs]], source_of: Mapping[str, str], params: Forecasting
) -> list[scoring.Difference]:
    """The controls minus recorded scenes alone, and HiD2 minus its rivals, on recorded scenes; Table 2 on both."""
    in_all = {"all scenes": "agents > 0"} | {f"more than {bound}": f"agents > {bound}" for bound in scoring.BOUNDS}
    pairs = [(name, RECORDED) for name in CONTROLS if name != RECORDED]
    pairs += [("hid2", "recorded-dense"), ("hid2", "no-interaction")]
    found = scoring.differences_of(pairs, runs[RECORDED], in_all, source_of, params)
    for on in (RECORDED, HID2):
        whole = {f"{on} validation scenes": in_all["all scenes"]}
        found += scoring.differences_of([(HID2_ONLY, RECORDED)], runs[on], whole, source_of, params)
    return found


_READINGS: Mapping[Reading, str] = {
    "recorded": "the recorded focal track, among more vehicles",
    "generated": "an inserted vehicle, one that does its manoeuvre where any does, among many neighbours",
    "both": "the recorded focal track in one half of the generated scenes, an inserted one in the other",
}


def _write(
    runs: _Scores, composed: Path, out: Path, params: Forecasting, *, reading: Reading | None, updates: int | None
) -> Path:
    """reading: of data sets made here, None for others; updates: of trainings here, None for forecasts brought."""
    validation = composed / VALIDATION
    source_of = scoring.sources_of(validation / HID2) | scoring.sources_of(validation / RECORDED)
    ours2 = {"recorded": RECORDED, "HiD2": HID2_ONLY}
    table2 = {label: [runs[on][name] for on in (RECORDED, HID2)] for label, name in ours2.items()}
    table3 = {
        label: [[run.query(f"agents > {bound}") for run in runs[RECORDED][name]] for bound in scoring.BOUNDS]
        for name, label in CONTROLS.items()
    }
    names2 = [f"{on}_{key}" for on in (RECORDED, HID2) for key in _COLUMNS]
    names3 = [f"{key}_{bound}" for bound in scoring.BOUNDS for key in _COLUMNS]
    differences = _differences(runs, source_of, params)
    sidecars = map(generated_sidecar, find_scenarios(validation / HID2 / "val"))
    focal = Counter(one.placed.focal for one in sidecars if one is not None and one.placed.focal)
    content: dict[str, Any] = {
        "experiment": "prediction",
        "seeds": {name: len(found) for name, found in runs[RECORDED].items()},
        "reading": reading,
        "focal": focal,
        "table2": _table(PAPER_TABLE2, table2, names2, source_of, params),
        "table3": _table(PAPER_TABLE3, table3, names3, source_of, params),
        "differences": [one._asdict() for one in differences],
    }
    every = (
        (on, name, number, *score)
        for on, models in runs.items()
        for name, found in models.items()
        for number, scores in enumerate(found)
        for score in scores.itertuples(index=False)
    )
    write_rows(out / "prediction_scores.csv", ("validation", "trained_on", "run", *scoring.SCORE_COLUMNS), every)
    write_json(out / "prediction.json", content)
    page = out / "prediction.html"
    content |= {
        "updates": updates,
        "reading": None if reading is None else _READINGS[reading],
        "gain_m": PAPER_GAIN_M,
        "main": next(one for one in differences if one[:4] == ("hid2", RECORDED, "all scenes", "min_fde_m")),
        "metrics": [scoring.METRICS[key] for key in _COLUMNS],
        "head": scoring.HEAD,
        "rows": scoring.rows_of(differences),
    }
    pages.write_page(page, "prediction.html.j2", **content)
    return page
