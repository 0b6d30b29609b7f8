"""Roads of a file: lanes cut into rows, routes, the corridor that is made of one, and what is refused."""

from pathlib import Path

import pytest

from bridge.recordings.road import Road, read_road, write_road
from bridge.recordings.sources import read_recording
from netconvert.errors import ConfigError

ROOT = Path(__file__).parents[4]
FLOW = "\n[[period]]\nuntil_s = 240.0\nveh_per_h = [900.0, 900.0]\n"
RAMPS = "\n[beside]\nfrom_m = 100.0\nto_m = 200.0\non_ramp = true\noff_ramp = true\n"


def road_of(tmp_path: Path, head: str, tail: str = FLOW) -> Road:
    path = tmp_path / "my.toml"
    path.write_text(head + tail)
    return read_road(path)


def test_lane_beside_joins_its_ramps_and_lanes_are_kept_before_and_behind_the_section(tmp_path: Path) -> None:
    """Rows of a road with approach and run-out of 50 m, numbers from the left (L2 is lane 2; A the lane beside).

    m     -50      0     100     200     300     350
    lane 1 |  1     | 101  | 201  | 301   | 401   |
    lane 2 |  2     | 102  | 202  | 302   | 402   |
    A               98 -> | 203  | -> 99
    """
    head = "length_m = 300.0\nlanes = 2\napproach_m = 50.0\nrun_out_m = 50.0\n" + RAMPS
    road = road_of(tmp_path, head, FLOW.replace("900.0]", "900.0, 300.0]"))
    lanes = {lane.lane_id: lane for lane in road.stretches()}
    assert list(lanes) == [1, 2, 101, 102, 201, 202, 203, 301, 302, 401, 402, 98, 99]
    assert (lanes[203].left, lanes[202].right, lanes[202].left, lanes[203].right) == (202, 203, 201, None)
    assert (lanes[203].successors, lanes[98].successors, lanes[202].successors) == ((99,), (203,), (302,))
    assert [name for name, lane in lanes.items() if lane.closed] == [1, 2, 401, 402, 98, 99]
    assert road.route(ramp=False, leaves=False) == [1, 101, 201, 301, 401]
    assert road.route(ramp=False, leaves=True) == [1, 101, 201, 99]
    assert road.route(ramp=True, leaves=False) == [98, 201, 301, 401]


def test_lane_that_is_dropped_leads_nowhere(tmp_path: Path) -> None:
    three = "\n[[period]]\nuntil_s = 240.0\nveh_per_h = [900.0, 900.0, 900.0]\n"
    lanes = road_of(tmp_path, "length_m = 300.0\nlanes = 3\ndrop_m = 150.0\n", three).stretches()
    assert [lane.number for lane in lanes if lane.start_m >= 150.0] == [1, 2, 1, 2]
    assert [lane.lane_id for lane in lanes if not lane.successors] == [103, 301, 302]


def test_signal_begins_a_crossing_on_which_lanes_are_kept_and_shows_its_phases(tmp_path: Path) -> None:
    """Green from 5 s on for 10 s, yellow 3 s, red 7 s, and again."""
    signal = "\n[[signal]]\nat_m = 100.0\ngreen_s = 10.0\nred_s = 7.0\noffset_s = 5.0\n"
    road = road_of(tmp_path, "length_m = 300.0\nlanes = 2\n", FLOW + signal)
    crossing = [lane for lane in road.stretches() if lane.crossing]
    assert [(one.lane_id, one.start_m, one.end_m, one.closed) for one in crossing] == [
        (201, 100.0, 120.0, True), (202, 100.0, 120.0, True)
    ]  # fmt: skip
    assert sorted(road.signals) == [201, 202]
    cycle = "r" * 5 + "G" * 10 + "y" * 3 + "r" * 2
    assert ["".join(road.signals[201].shown(1.0, steps)) for steps in (None, 40)] == [cycle, 2 * cycle]


def test_corridor_of_a_road_is_read_like_a_recording_and_named_by_its_content(tmp_path: Path) -> None:
    first = write_road(tmp_path, ROOT / "data" / "public" / "us101_0805.toml")
    graph = read_recording(first).graph
    assert (graph.neighbor(206, "left"), graph.successors(206), graph.successors(98)) == (205, (99,), (206,))
    assert graph.may_change(206, "left")
    assert not graph.may_change(2, "left")  # before the section lanes are kept
    changed = tmp_path / "us101_0805.toml"
    changed.write_text((first / "road.toml").read_text().replace("trucks = 0.022", "trucks = 0.03"))
    assert write_road(tmp_path, changed).name != first.name


@pytest.mark.parametrize(
    ("head", "said"),
    [
        ("lanes = 2\n", "no key 'length_m'; expected length_m, lanes"),
        ("length_m = 300.0\nlanes = 3\n", "period.veh_per_h until 240 s: 2 values, expected one for each of 3 lanes"),
        ("length_m = 300.0\nlanes = 2\nspeed = 3\n", "unknown key 'speed'"),
        ("length_m = 20.0\nlanes = 2\n", "length_m = 20.0, expected at least 100"),
        ("length_m = 150.0\nlanes = 2\n" + RAMPS, "beside and drop_m lie in the section, 0 to 150 m"),
        ("length_m = 300.0\nlanes = 2\nleaving = [0.1, 0.1]\n", "leaving: expected beside.off_ramp = true"),
        ("length_m = 300.0\nlanes = 2\nwarm_up_s = 300.0\n", "warm_up_s 300: expected less than the 240 s"),
        ("length_m = 300.0\nlanes = 2\n[beside]\nfrom_m = 9.0\nto_m = 99.0\non_ramp = true\n", "lanes and the on-ramp"),
        ("length_m = 300.0\nlanes = 2\ndrop_m = 100.0\n", "drop_m: expected three lanes or more"),
        ("length_m = 300.0\nlanes = 2\n[[signal]]\nat_m = 290.0\ngreen_s = 9.0\nred_s = 9.0\n", "signal: at_m has to"),
        ("length_m = 300.0\nlanes = 2\n[[period]]\nuntil_s = 990.0\nveh_per_h = [1.0, 1.0]\n", "until_s has to rise"),
    ],
)
def test_road_that_cannot_be_is_refused_in_one_line(tmp_path: Path, head: str, said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        road_of(tmp_path, head)
    message = str(caught.value)
    assert message.startswith(str(tmp_path / "my.toml"))
    assert said in message
    assert "\n" not in message
