"""The statistical verification: by hand, and once before a release, with `pytest -m verification -s`.

What comes about in many vehicles beside what it should be, and a plot whose title says in a sentence what it shows, in
$HID2_VERIFICATION_DIR (by default the test's own folder, which is printed).
"""

import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

from bridge.generation.generate import generate, prepare
from bridge.recordings.scenario import read_scenario
from hid2.params import Config, Request

pytestmark = pytest.mark.verification
SEEDS = 25


@pytest.fixture(scope="module")
def generated(data_scenes):
    """Scenes of the arterial, SEEDS of them, with 10 vehicles asked for at any site."""
    prepared = prepare(read_scenario(data_scenes["arterial"]), Config())
    config = [Config(request=Request(agents=10, seed=seed, sites="any")) for seed in range(SEEDS)]
    return [generate(prepared, one) for one in config]


def test_start_delay_after_the_trigger(generated, tmp_path):
    """A manoeuvre begins at the trigger or at the first step at which it is feasible, never before."""
    records = [m for scene in generated for agent in scene.sidecar.agents for m in agent.maneuvers]
    delays = np.array([m.requested_s - m.trigger_s for m in records if m.requested_s is not None])
    assert len(delays) >= 10
    assert delays.min() >= -1e-9
    at_once = float((delays <= 0.1 + 1e-9).mean())
    said = f"Of {len(delays)} manoeuvres, {at_once:.0%} began within a step of their trigger; none before it."
    figure, ax = plt.subplots(figsize=(6.4, 4.0), layout="constrained")
    ax.step(np.sort(delays), np.arange(1, len(delays) + 1) / len(delays), where="post")
    ax.set_title(said, fontsize=9, wrap=True)
    ax.set(xlabel="time from trigger to begin, s", ylabel="share of manoeuvres")
    path = Path(os.environ.get("HID2_VERIFICATION_DIR", tmp_path)) / "start_delay.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)
    print(f"{path}: {said}")
    assert delays.max() <= Config().lane_change.give_up_s + 11.0
