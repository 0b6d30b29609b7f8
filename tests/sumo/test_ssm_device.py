"""Conflicts in SSAM's terms beside those that SUMO's SSM device finds on the same run."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from lxml import etree

from hid2.agents import BoxSize, Track
from hid2.measures.arrays import stack
from hid2.measures.conflicts import TrafficConflict, conflicts

CAR = BoxSize(5.0, 1.8)
NODES = '<nodes><node id="w" x="-200" y="0"/><node id="s" x="0" y="-200"/><node id="c" x="0" y="0" type="priority"/>'
NODES += '<node id="e" x="300" y="0"/><node id="n" x="0" y="300"/></nodes>'
EDGES = "<edges>" + "".join(
    f'<edge id="{a}{b}" from="{a}" to="{b}" numLanes="1" speed="30"/>' for a, b in ("wc", "ce", "sc", "cn")
) + "</edges>"  # fmt: skip
ROUTES = """<routes>
<vType id="car" length="5" width="1.8" minGap="0" tau="0.1" decel="9" sigma="0" accel="9"/>
<vehicle id="leader" type="car" depart="0" departPos="100" departSpeed="8"><route edges="wc ce"/></vehicle>
<vehicle id="follower" type="car" depart="0" departPos="50" departSpeed="14"><route edges="wc ce"/></vehicle>
<vehicle id="crosses" type="car" depart="0" departPos="40" departSpeed="10"><route edges="sc cn"/></vehicle>
</routes>"""
# one simulation a process; nobody reacts but the follower, which brakes with 4 m/s2 from a TTC of 1 s on
DRIVE = """
import os, sys
os.environ["LIBSUMO_AS_TRACI"] = "quiet"
import libsumo
libsumo.start(["sumo", "-n", "net.net.xml", "-r", "rou.xml", "--step-length", "0.1", "--no-step-log", "--no-warnings",
    "--fcd-output", "fcd.xml", "--precision", "4", "--collision.action", "none", "--device.ssm.probability", "1",
    "--device.ssm.measures", "TTC DRAC PET", "--device.ssm.thresholds", "5 0.1 5", "--device.ssm.file", "ssm.xml",
    "--device.ssm.range", "150", "--device.ssm.trajectories", "true"])
speeds = {"leader": 8.0, "follower": 14.0, "crosses": 10.0}
for step in range(300):
    libsumo.simulationStep()
    here = set(libsumo.vehicle.getIDList())
    for name in here & set(speeds):
        libsumo.vehicle.setSpeedMode(name, 0)
        libsumo.vehicle.setSpeed(name, speeds[name])
    if {"leader", "follower"} <= here:
        ahead, behind = (libsumo.vehicle.getDistance(name) for name in ("leader", "follower"))
        gap = 50 + ahead - behind - 5
        if speeds["follower"] < 14.0 or gap / 6.0 < 1.0:
            speeds["follower"] = max(8.0, speeds["follower"] - 0.4)
libsumo.close()
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A follower that closes in on a leader and brakes late, and a vehicle that crosses behind them."""
    folder = tmp_path_factory.mktemp("ssm")
    for name, content in (("nod.xml", NODES), ("edg.xml", EDGES), ("rou.xml", ROUTES), ("drive.py", DRIVE)):
        (folder / name).write_text(content)
    make = "from sumolib import checkBinary; print(checkBinary('netconvert'))"
    program = subprocess.run([sys.executable, "-c", make], capture_output=True, text=True, check=True).stdout.strip()
    net = [program, "-n", "nod.xml", "-e", "edg.xml", "-o", "net.net.xml"]
    subprocess.run(net, cwd=folder, check=True, capture_output=True)
    subprocess.run([sys.executable, "drive.py"], cwd=folder, check=True)
    return folder


def _ours(folder: Path) -> dict[frozenset[str], TrafficConflict]:
    """Conflicts of the playback: x, y there are the front bumper's, angles clockwise from north."""
    rows: dict[str, list[tuple[float, ...]]] = {}
    for step in etree.parse(folder / "fcd.xml").getroot():
        for one in step:
            at = float(step.get("time")), *(float(one.get(name)) for name in ("x", "y", "angle", "speed"))
            rows.setdefault(one.get("id"), []).append(at)
    tracks = []
    for name, told in rows.items():
        time, x, y, angle, speed = np.array(told).T
        heading = np.radians(90.0 - angle)
        forward = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        centre = np.stack([x, y], axis=1) - 0.5 * CAR.length_m * forward
        steps = np.rint(time / 0.1).astype(int)
        tracks.append(Track(name, "vehicle", 1, steps, centre, heading, speed[:, None] * forward, CAR))
    return {frozenset((one.first_id, one.second_id)): one for one in conflicts(stack(tracks, step_s=0.1))}


def _theirs(folder: Path, first: str, second: str, measure: str) -> list[float]:
    """What SUMO says of a pair."""
    found = []
    for conflict in etree.parse(folder / "ssm.xml").getroot():
        if {conflict.get("ego"), conflict.get("foe")} == {first, second}:
            found += [
                float(one.get("value")) for one in conflict.iter(measure) if one.get("value") not in (None, "NA", "")
            ]
    return found


def test_following_has_the_ttc_and_drac_and_crossing_the_pet_that_sumo_finds(run: Path) -> None:
    """From a TTC of 1 s on it brakes: the gap closes slower and slower, and DRAC is w^2 / 2 gap.

    SUMO's speed is that of the step before, ours of the steps to both sides: .2 m/s less as it brakes, of 5.6 closing.
    SUMO's PET is exact where the paths cross, ours right to a step for each of the two.
    """
    every = _ours(run)
    ours = every[frozenset(("leader", "follower"))]
    assert (ours.kind, ours.first_id, ours.second_id) == ("rear_end", "leader", "follower")
    assert ours.ttc_s == pytest.approx(min(_theirs(run, "leader", "follower", "minTTC")), abs=0.05)
    assert ours.drac_mps2 == pytest.approx(max(_theirs(run, "leader", "follower", "maxDRAC")), rel=0.08)
    ours = every[frozenset(("follower", "crosses"))]
    assert (ours.kind, ours.first_id) == ("crossing", "follower")
    assert abs(ours.angle_deg - 90.0) < 1.0
    assert ours.pet_s == pytest.approx(min(_theirs(run, "follower", "crosses", "PET")), abs=0.2)
