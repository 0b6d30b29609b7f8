"""The paper's experiments that need no training: scenes of every setting, generated and measured.

table1: realism and safety with 10 vehicles added, by data set. ablation: without topology, collision checks, smoothing.
density: 0 to 40 vehicles added. diversity: scenes by number of agents and behaviour, before and after, of the whole
data set and of the paper's templates.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from scipy.signal import savgol_filter

from bridge.batch.engine import OnDone, work_on_each
from bridge.batch.isolation import Failure, attempts
from bridge.evaluation.scene_metrics import Row, measure
from bridge.recordings.folders import Address, Source
from bridge.recordings.sources import read_recording
from hid2.agents import Track
from hid2.params import Config, Request

Experiment = Literal["table1", "ablation", "density", "diversity"]

#: Numbers of vehicles added in the paper's density figure.
ADDED = (0, 5, 10, 20, 40)
#: The paper does not say how its Argoverse 1 tracks were smoothed. With this filter (samples, degree) tracks seen at
#: every step come to its JE, and near its LO and LA. For comparison alone: nothing that is generated depends on it.
_SMOOTHED_FORMAT, _FILTER_SAMPLES, _FILTER_DEGREE = "argoverse1", 13, 3
_TIMEOUT_S = 600.0  # of a scene that is generated and measured once
#: The mix of the diversity experiment: the paper's underrepresented behaviours.
_RARE_MIX = {"straight": 0.2, "left_turn": 0.2, "right_turn": 0.2, "lane_change": 0.25, "overtake": 0.15}


class Setting(NamedTuple):
    """One row of an experiment: its name and the configuration that it runs (None: nothing is generated).

    smoothed: recorded positions of Argoverse 1 are also measured smoothed, of tracks seen at every step.
    """

    name: str
    config: Config | None
    smoothed: bool = False


class SettingRows(NamedTuple):
    """Scene rows of a setting, one per source scene and seed, those smoothed, and the scenes that failed, with why."""

    setting: Setting
    rows: list[Row]
    smoothed: list[Row]
    failures: list[str]


def settings_of(name: Experiment, agents: int) -> list[Setting]:
    """The rows of an experiment; agents: vehicles added where it has no numbers of its own."""
    base = Config(request=Request(agents=agents))
    if name == "ablation":
        parts: tuple[Literal["topology", "collision", "smoothing"], ...] = ("topology", "collision", "smoothing")
        return [Setting("full", base)] + [
            Setting(p, base.model_copy(update={"without": frozenset({p})})) for p in parts
        ]
    if name == "density":
        return [Setting(str(n), Config(request=Request(agents=n)) if n else None) for n in ADDED]
    if name == "diversity":
        rare = Config(request=Request.model_validate({"agents": agents, **_RARE_MIX}))
        return [Setting("recorded", None), Setting("dense", base), Setting("rare", rare)]
    return [Setting("hid2", base, smoothed=True)]


def run_settings(
    folders: Sequence[Address], settings: Sequence[Setting], *, seeds: int, jobs: int, on_scene: OnDone
) -> list[SettingRows]:
    """Generate and measure every setting on every scene with every seed, each scene in a process of its own."""
    outcomes, shared = [SettingRows(setting, [], [], []) for setting in settings], (tuple(settings), seeds)
    timeout_s = _TIMEOUT_S * seeds * len(settings)
    for folder, made in work_on_each(
        generate_and_measure, folders, shared=shared, jobs=jobs, chunk=1, timeout_s=timeout_s, on_item=on_scene
    ):
        name = folder.name[:8]
        if isinstance(made, Failure):
            for outcome in outcomes:
                outcome.failures.append(f"{name}: {made.message}")
            continue
        for setting, seed, found in made:
            if isinstance(found, Failure):
                outcomes[setting].failures.append(f"{name}, seed {seed}: {found.message}")
            else:
                outcomes[setting].rows.append(found[0])
                outcomes[setting].smoothed.extend(found[1:])
    return outcomes


def generate_and_measure(
    shared: tuple[tuple[Setting, ...], int], folder: Address
) -> list[tuple[int, int, list[Row] | Failure]]:
    """The work on a scene: number of the setting, seed, and the scene's row of each; a second one where smoothed."""
    from bridge.generation.generate import generate, prepare  # libsumo: only where scenes are made

    settings, seeds = shared
    scenario = read_recording(folder)
    is_rough = isinstance(folder, Source) and folder.format == _SMOOTHED_FORMAT
    items = [(k, seed) for k, setting in enumerate(settings) for seed in range(seeds if setting.config else 1)]
    prepared = prepare(scenario, next((s.config for s in settings if s.config), Config()))

    def rows(item: tuple[int, int]) -> list[Row]:
        setting, seed = settings[item[0]], item[1]
        recorded, inserted, sidecar = {setting.name: scenario.tracks}, tuple[Track, ...](), None
        if setting.smoothed and is_rough:
            recorded["smoothed"] = smoothed(scenario.tracks, scenario.num_steps, step_s=scenario.step_s)
        if setting.config is not None:
            request = setting.config.request.model_copy(update={"seed": seed})
            scene = generate(prepared, setting.config.model_copy(update={"request": request}))
            inserted, sidecar = scene.generated, scene.sidecar
        about = {"city": scenario.city, "seed_run": seed}
        return [
            {"setting": name} | about | measure(scenario, (*tracks, *inserted), sidecar).scene
            for name, tracks in recorded.items()
        ]

    return [(*item, found) for item, found in zip(items, attempts(rows, items), strict=True)]


def smoothed(tracks: Sequence[Track], num_steps: int, *, step_s: float) -> tuple[Track, ...]:
    """Tracks seen at every step by a Savitzky-Golay filter over their positions."""
    found = []
    for track in tracks:
        if len(track.timesteps) == num_steps:
            position = savgol_filter(track.position, _FILTER_SAMPLES, _FILTER_DEGREE, axis=0)
            velocity = np.gradient(position, step_s, axis=0)
            found.append(replace(track, position=position, velocity=velocity))
    return tuple(found)
