"""The evaluation on real scenes: against the paper's figures, and against what a person sees."""

import numpy as np
import pytest
from views import lane_view

from bridge.recordings.scenario import read_scenario
from hid2.evaluation.kinematics import kinematics, motion
from hid2.measures.arrays import stack
from hid2.measures.manoeuvres import detect


def test_recorded_means_are_near_the_papers(real_scenes):
    """Four recorded scenes, all tracks pooled: LO 1.71, LA 0.489, JE 8.02 were found on five such; the paper has 1.648,
    0.476, 8.106. This holds the definition in place (the recorded velocity would give LO 0.5 to 0.7).
    """
    lo, la, je = [], [], []
    for folder in real_scenes:
        if (folder / "agent_sizes.csv").is_file():
            continue  # labelled by people: smooth
        arrays = stack(read_scenario(folder).tracks, step_s=0.1)
        found = kinematics(arrays, motion(arrays))
        lo += found.lo[found.counted].tolist()
        la += found.la[found.counted].tolist()
        je += found.je[found.counted].tolist()
    assert 1.4 < np.mean(lo) < 2.0
    assert 0.4 < np.mean(la) < 0.6
    assert 6.5 < np.mean(je) < 9.5


#: What a person sees: manoeuvres and their sides. Each track was drawn over the map with lane markings and centrelines
#: and a dot for every second; those near a marking also turned so that they run to the right and stretched across.
MANOEUVRES = {
    "3b3570b4": {
        "10035": ("lane_change", "left"),  # in the middle of its lane to 6 s, over the dashed line before 9 s
        "10025": ("left_turn",),  # waits in the intersection heading south, then from 6 s a quarter circle to the east
        "10055": ("left_turn",),  # from the northbound stem of a T to the west, round the corner from 1 to 6 s
        "AV": ("left_turn",),  # waits in the intersection to 9 s, then bends north-west; the scene ends in the turn
    },
    "0a0af725": {"8984": ("lane_change", "right")},  # in the middle for 2 s, on the dashed line at 3.5 s, ends right
    "0a0ef009": {"97246": ("left_turn",)},  # a fragment of 2 s that bends north inside the intersection
}
#: What drives on: beside pockets and forks that open (10005, 10007, 10033, 10013, 10018), out of the mapped lanes
#: (10012, 10052), along a bend (10053), in a queue (10044), to a stop, weaving by a metre (72191), in lanes that are
#: renamed (10028). Tracks whose lane a person could not tell were left out.
STRAIGHT_ON = {
    "3b3570b4": "10005 10007 10010 10012 10019 10023 10033 10041 10043 10052 10053 10044",
    "7fab2350": "10006 10010 10013 10018 10019 10020 10028 10031 AV",
    "0a0af725": "9020 9021 9024 9118 9249",
    "00a0ec58": "71530 71778 72080 72132 72146 72191 72205",
    "0a0ef009": "95535 95709 96457",
    "0a1e6f0a": "138951 139400",
}


@pytest.fixture(scope="module")
def seen_by_scene(real_scenes):
    found = {}
    for folder in real_scenes:
        scenario = read_scenario(folder)
        arrays = stack(scenario.tracks, num_steps=scenario.num_steps, step_s=0.1)
        found[folder.name[:8]] = detect(lane_view(arrays, scenario.graph))
    return found


@pytest.mark.parametrize("scene", STRAIGHT_ON)
def test_detector_sees_what_a_person_sees(seen_by_scene, scene):
    wanted = dict.fromkeys(STRAIGHT_ON[scene].split(), ()) | MANOEUVRES.get(scene, {})
    seen = dict.fromkeys(wanted, ())
    for one in seen_by_scene[scene]:
        low, high = {"10035": (8.0, 9.0), "8984": (3.2, 3.8)}.get(one.track_id, (0.0, 11.0))  # when it crosses
        assert low < one.crossing_s < high or one.track_id not in seen
        if one.track_id in seen:
            sides = [{1: "left", -1: "right"}[one.side]] if one.kind.value == "lane_change" else []
            seen[one.track_id] += (one.kind.value, *sides)
    assert seen == wanted
