"""gaps_<id>.csv.gz: every look at a gap, with all answers."""

import csv
import gzip
from pathlib import Path

import pytest
from hand_drawn import draw_lane
from inserted import scene_on, start_on

from bridge.generation.gaps import GAP_COLUMNS, gap_rows, gaps_bytes
from bridge.generation.generate import generate
from bridge.recordings.scenario import read_scenario
from hid2.agents import Policy
from hid2.params import Config, Request, Spawn
from hid2.policy.lane_change import OPEN, Gap, LaneOption
from hid2.reasons import Reason
from hid2.vehicle import DrivenVehicle, GapLook
from netconvert.cells import Cell
from netconvert.lane_graph import LaneGraph


def _vehicle(*looks: GapLook) -> DrivenVehicle:
    scene = scene_on(LaneGraph({1: draw_lane(1, [(0.0, 0.0), (100.0, 0.0)])}))
    start = start_on(scene, (1,), 10.0, 5.0, policy=Policy.LANE_CHANGE, trigger_s=1.5)
    return DrivenVehicle(start=start, path=start.path, gaps=list(looks))


def test_row_by_hand() -> None:
    """12 m behind a leader at 8 m/s with 10 m/s: 1.2 s, TTC 12 / 2 s. Follower at 15 m/s, 9 m: .6 s, TTC 9 / 5 s."""
    seen = LaneOption("left", Cell(7, 3), True, Gap(12.0, 8.0, "a"), Gap(9.0, 15.0, "b"), 80.0, 12.0)
    look = GapLook(step=20, seen=seen, own_mps=10.0, refusals=(), guard=None, sumo=False)
    (row,) = gap_rows([(2, _vehicle(look))], {"v0_0": "gen_4"}, step_s=0.1)
    assert list(row) == list(GAP_COLUMNS)
    assert (row["vehicle"], row["round"], row["track_id"], row["policy"]) == ("v0_0", 2, "gen_4", "lane_change")
    assert (row["trigger_s"], row["time_s"], row["lane_id"], row["cell"]) == (1.5, 2.0, 7, 3)
    assert (row["lead_id"], row["lead_time_gap_s"], row["lead_ttc_s"]) == ("a", 1.2, 6.0)
    assert (row["lag_id"], row["lag_time_gap_s"], row["lag_ttc_s"]) == ("b", 0.6, 1.8)
    assert (row["rule"], row["guard"], row["sumo"]) == ("yes", "yes", "no")
    again = gap_rows([(1, _vehicle(look)), (2, _vehicle(look))], {"v0_0": "gen_4"}, step_s=0.1)
    assert [row["track_id"] for row in again] == [None, "gen_4"], "driven again: the last is exported"


@pytest.mark.parametrize(
    ("refusals", "guard", "answers"),
    [
        ((Reason.REAR_GAP,), None, ("rear_gap", None, None)),
        ((), Reason.CONFLICT_PREDICTED, ("yes", "conflict_predicted", None)),
    ],
)
def test_what_is_not_asked_has_no_answer(
    refusals: tuple[Reason, ...], guard: Reason | None, answers: tuple[str | None, ...]
) -> None:
    stands = Gap(9.0, 1e-14, "b")  # as recorded: never quite 0
    look = GapLook(20, LaneOption("right", Cell(7, 3), True, OPEN, stands, 80.0, 80.0), 10.0, refusals, guard)
    (row,) = gap_rows([(0, _vehicle(look))], {}, step_s=0.1)
    assert (row["rule"], row["guard"], row["sumo"]) == answers
    assert row["lead_gap_m"] is row["lead_id"] is row["lag_ttc_s"] is row["lag_time_gap_s"] is row["track_id"] is None


def test_file_is_beside_the_scene_and_agrees_with_the_sidecar(data_scenes: dict[str, Path], tmp_path: Path) -> None:
    config = Config(
        request=Request(agents=6, straight=0.0, left_turn=0.0, right_turn=0.0, lane_change=1.0, overtake=0.0),
        spawn=Spawn(rounds=1),
    )
    scene = generate(read_scenario(data_scenes["arterial"]), config)
    folder = scene.write(tmp_path, record=("gaps",))
    (path,) = folder.glob("gaps_*.csv.gz")
    with gzip.open(path, "rt", newline="") as file:
        rows = list(csv.DictReader(file))
    for agent in scene.sidecar.agents:
        mine = [row for row in rows if row["track_id"] == agent.track_id]
        assert len(mine) == agent.gaps.looked_at
        assert sum(row["sumo"] == "no" for row in mine) == agent.gaps.refused_by_sumo
    assert any(row["sumo"] == "yes" for row in rows)
    assert gaps_bytes(scene.driven, {}, step_s=0.1) == gaps_bytes(scene.driven, {}, step_s=0.1)
    assert not list(scene.write(tmp_path).glob("gaps_*"))
