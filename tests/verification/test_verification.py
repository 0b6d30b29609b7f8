"""The statistical verification: by hand, and once before a release, with `pytest -m verification -s`.

Each test compares what comes about in many vehicles with what it should be, and draws a plot whose title says in a
sentence what it shows, into $HID2_VERIFICATION_DIR (by default the test's own folder, which is printed).
"""

import os
from collections import Counter
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from synthetic_driving import KNOWN, synthetic_driving

from bridge.generation.generate import generate, prepare
from bridge.recordings.scenario import read_scenario
from hid2.evaluation.calibration import calibrate
from hid2.params import Config, Drivers, Request

pytestmark = pytest.mark.verification
SEEDS = 25


@pytest.fixture
def folder(tmp_path):
    chosen = Path(os.environ.get("HID2_VERIFICATION_DIR", tmp_path))
    chosen.mkdir(parents=True, exist_ok=True)
    return chosen


def draw(folder, name, sentence, plot, *, x, y):
    figure, ax = plt.subplots(figsize=(6.4, 4.0), layout="constrained")
    plot(ax)
    ax.set_title(sentence, fontsize=9, wrap=True)
    ax.set_xlabel(x)
    ax.set_ylabel(y)
    if ax.get_legend_handles_labels()[0]:
        ax.legend(fontsize=8)
    figure.savefig(folder / f"{name}.png", dpi=110)
    plt.close(figure)
    print(f"{folder / name}.png: {sentence}")


@pytest.fixture(scope="module")
def generated(data_scenes):
    """Scenes of the arterial, SEEDS of them, with 10 vehicles asked for at any site."""
    prepared = prepare(read_scenario(data_scenes["arterial"]), Config())
    config = [Config(request=Request(agents=10, seed=seed, sites="any")) for seed in range(SEEDS)]
    return [generate(prepared, one) for one in config]


def test_start_delay_after_the_trigger(generated, folder):
    """A manoeuvre begins at the trigger or at the first step at which it is feasible, never before."""
    records = [m for scene in generated for agent in scene.sidecar.agents for m in agent.maneuvers]
    delays = np.array([m.requested_s - m.trigger_s for m in records if m.requested_s is not None])
    assert len(delays) >= 10
    assert delays.min() >= -1e-9
    at_once = float((delays <= 0.1 + 1e-9).mean())
    draw(
        folder, "start_delay",
        f"Of {len(delays)} manoeuvres that began, {at_once:.0%} began within a step of their trigger; none before it.",
        lambda ax: ax.step(np.sort(delays), np.arange(1, len(delays) + 1) / len(delays), where="post"),
        x="time from trigger to begin, s", y="share of manoeuvres",
    )  # fmt: skip
    assert delays.max() <= Config().lane_change.give_up_s + 11.0


def test_calibration_finds_synthetic_drivers_again(folder):
    """Eight samples of 120 drivers: known parameters lie in their 95 % intervals, widened by the truncation, mostly."""
    names = ("desired_sd", "tau_mean_s", "offset_mean_m", "offset_sd_m", "lateral_wander_sd_m", "wander_sd_mps",
             "wander_time_s", "lane_change_mean_s")  # fmt: skip
    hits, ratios = Counter[str](), {name: [] for name in names}
    for seed in range(8):
        seen = synthetic_driving(KNOWN, drivers=120, seed=seed)
        found = {one.parameter: one for one in calibrate([seen], prior=Drivers())}
        for name in names:
            known, slack = getattr(KNOWN, name), 0.12 * getattr(KNOWN, name)
            hits[name] += found[name].low - slack <= known <= found[name].high + slack
            ratios[name].append(found[name].value / known)
    draw(
        folder, "calibration", "Parameters found over known ones, eight samples of 120 synthetic drivers: about 1.",
        lambda ax: (ax.boxplot([ratios[name] for name in names]), ax.set_xticklabels(names, rotation=40, fontsize=7)),
        x="", y="found over known",
    )  # fmt: skip
    assert all(count >= 7 for count in hits.values()), hits
