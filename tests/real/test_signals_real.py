"""Whether the signals that are inferred from recorded traffic are those that recorded drivers obey."""

from pathlib import Path

from signal_entries import entries as passed

from bridge.recordings.judging import states_of
from bridge.recordings.scenario import STEP_S, read_scenario
from hid2.conflicts.signals import InferredSignals
from hid2.measures.lane_matching import flatten_lanes
from hid2.params import Signals

#: Of the recorded entries, at red: one of 69 in these six scenes.
MOST_ON_RED = 0.03


def test_recorded_vehicles_hardly_ever_enter_on_red(real_scenes: list[Path]) -> None:
    entries = on_red = red_lanes = 0
    for folder in real_scenes:
        scenario = read_scenario(folder)
        lanes = flatten_lanes(scenario.graph)
        states = states_of(scenario.tracks, lanes, set(), num_steps=scenario.num_steps, step_s=STEP_S)
        signals = InferredSignals(scenario.graph, states, Signals())
        for lane_id in scenario.graph.lanes:
            red, enters = signals.red(lane_id), passed(signals, lane_id)
            assert (red is None) == (enters is None)
            if red is not None and enters is not None:
                entries += int(enters.sum())
                on_red += int((enters & red).sum())
                red_lanes += bool(red.any())
    print(f"{on_red} of {entries} recorded entries on red; {red_lanes} entrances red at some time")
    assert entries >= 50
    assert red_lanes >= 50
    assert on_red <= MOST_ON_RED * entries
