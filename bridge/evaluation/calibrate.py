"""`hid2 calibrate`: recorded scenes to drivers.toml, with a table of every quantity."""

import json
import logging
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from bridge.batch.engine import OnDone, sorted_out, work_on_each
from bridge.evaluation.evaluate import write_table
from bridge.files import with_name, write_text
from bridge.pages.parts import write_page
from bridge.recordings.folders import Source, source_id
from bridge.recordings.judging import recording_states
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sources import find_sources
from hid2.evaluation.calibration import LEAST, CalibratedQuantity, SceneDriving, calibrate, drivers_of, observe
from hid2.params import Drivers
from netconvert.errors import ConfigError, ScenarioError

_LOG = logging.getLogger(__name__)


def calibrate_folder(
    roots: Sequence[Path], out: Path, *, without: Sequence[str] = (), jobs: int = 1, on_scene: OnDone = None
) -> list[tuple[Path, str]]:
    """Measure how people drive in the recorded scenes below some folders; returns the scenes that failed.

    Writes `out` (TOML, the section [drivers] of a configuration) and, beside it, STEM.csv (quantities) and STEM.html
    (the same as a page). without: ids of scenes to leave out, such as those to be generated from.
    Scenes that hid2 wrote are passed over. Errors: ConfigError where no scene is left or out is no .toml,
    ScenarioError where none can be read; ExportError where something cannot be written.
    """
    if out.suffix != ".toml":
        raise ConfigError(f"{out}: drivers are written in TOML, with a .csv and a .html beside; expected NAME.toml")
    root, there = ", ".join(map(str, roots)), scenes_below(roots)
    if not there:
        raise ConfigError(f"{root}: no Argoverse 2 scene, which calibration reads; expected scenario_<id>.parquet")
    if unknown := sorted(set(without) - there.keys()):
        raise ConfigError(f"--without {unknown[0]}: no such scene in {root}, expected the id of one, as {min(there)}")
    if not (folders := [folder for name, folder in there.items() if name not in without]):
        raise ConfigError(f"{root}: --without leaves no scene to calibrate with, expected at least one")
    scenes, failures = sorted_out(
        work_on_each(observe_scene, folders, 1, jobs=jobs, chunk=20, timeout_s=120, on_item=on_scene)
    )
    if not scenes:
        raise ScenarioError(f"{root}: no scene can be read; the first: {with_name(*failures[0])}")
    prior = Drivers()
    groups = {name: calibrate(part, prior=prior) for name, part in _groups(scenes)}
    rows = [{"group": name} | one._asdict() for name, found in groups.items() for one in found]
    write_table(out.with_name(f"{out.stem}.csv"), rows)
    write_page(out.with_name(f"{out.stem}.html"), "calibration.html.j2", scenes=len(scenes), rows=rows)
    write_text(out, drivers_toml(groups["all"], prior, scenes))
    return failures


def scenes_below(roots: Sequence[Path]) -> dict[str, Path]:
    """The Argoverse 2 scenes below some folders by id, each once; what is left out is logged. Errors: NoSceneError."""
    found, scenes = find_sources(roots), dict[str, Path]()
    for folder in (one for one in found if isinstance(one, Path)):
        if (first := scenes.setdefault(source_id(folder), folder)) is not folder:
            _LOG.warning("%s: the same scene as %s, left out", folder, first)
    if others := sum(isinstance(one, Source) for one in found):
        _LOG.warning("%d of %d recordings left out: sensor logs and Argoverse 1 are not read here", others, len(found))
    return dict(sorted(scenes.items()))


def observe_scene(least: int, folder: Path) -> SceneDriving:
    """What one recorded scene of so many steps at least shows of driving. Errors: ScenarioError, MapError."""
    scene = read_scenario(folder)
    if scene.num_steps < least:
        raise ScenarioError(f"{folder}: {scene.num_steps} steps, expected at least {least}")
    labelled = scene.provenance == "human"
    return observe(recording_states(scene), name=scene.scenario_id, city=scene.city, labelled=labelled)


def _groups(scenes: Sequence[SceneDriving]) -> Iterator[tuple[str, list[SceneDriving]]]:
    yield "all", list(scenes)
    for city in sorted({scene.city for scene in scenes}):
        yield f"city {city}", [scene for scene in scenes if scene.city == city]
    for kind in sorted({scene.labelled for scene in scenes}):
        yield f"recordings {('tracker', 'labelled')[kind]}", [scene for scene in scenes if scene.labelled is kind]
    for name, turning in (("straight", False), ("turning", True)):
        kept = [scene.windows[scene.windows["turning"] == turning] for scene in scenes]
        of_windows = [  # standing gaps and lane changes are of no kind of lane alone
            scene._replace(windows=own, standing_gap_m=np.zeros(0), lane_change_s=np.zeros(0))
            for scene, own in zip(scenes, kept, strict=True)
        ]
        yield f"lane {name}", of_windows


def drivers_toml(found: Sequence[CalibratedQuantity], prior: Drivers, scenes: Sequence[SceneDriving]) -> str:
    """The section [drivers] of a configuration: what was measured, and as comments what keeps its prior."""
    measured, by_name = drivers_of(found), {quantity.parameter: quantity for quantity in found}
    named = ", ".join(scene.name for scene in scenes[:20]) + (" and others" if len(scenes) > 20 else "")
    lines = [f"# Measured by hid2 calibrate in {len(scenes)} scenes: {named}", "", "[drivers]"]
    for name in Drivers.model_fields:
        one = by_name.get(name)
        if one is not None and name in measured:
            lines.append(f"{name} = {json.dumps(one.value)}  # {one.low:.3g} to {one.high:.3g}, {one.drivers} drivers")
        else:
            why = "are too few" if one is None or one.drivers < LEAST else "tell no value above 0"
            seen = f", {one.drivers} drivers {why}" if one is not None and one.drivers else ""
            lines.append(f"# {name} keeps its prior {getattr(prior, name)}{seen}")
    return "\n".join(lines) + "\n"
