from collections.abc import Iterator
from dataclasses import replace

import pytest
from hand_drawn import draw_two_lanes

from bridge.sumo.simulation import Simulation
from hid2.agents import BoxSize
from hid2.drivers.driver import usual_driver
from netconvert.cells import build_cell_grid
from netconvert.errors import SimulationError
from netconvert.net_xml import net_bytes

#: Of lanes 1 (index 0) and 2, the left one (1): 4 m each.
EDGES = [f"1#{k}" for k in range(25)]
CAR = BoxSize(4.5, 1.9)
DRIVER = replace(usual_driver(12.0), accel_mps2=1.8, decel_mps2=2.5, tau_s=1.6, min_gap_m=2.5)


@pytest.fixture(scope="module")
def net() -> bytes:
    return net_bytes(build_cell_grid(draw_two_lanes(100.0)))


@pytest.fixture
def sumo(net: bytes) -> Iterator[Simulation]:
    with Simulation(net, seed=0, step_s=0.1, model="Krauss") as simulation:
        yield simulation


def _insert(sumo: Simulation, name: str, front_m: float, speed: float, *, lane_id: str | None = None) -> str | None:
    """A car with its front bumper at front_m of lane 1."""
    first = int(front_m // 4.0)
    return sumo.insert(
        name, edges=EDGES[first:], lane_id=lane_id or f"1#{first}_0", front_m=front_m - 4.0 * first, speed_mps=speed,
        driver=DRIVER, size=CAR, max_speed_mps=12.0,
    )  # fmt: skip


def _place(sumo: Simulation, x: float, y: float, angle_deg: float) -> None:
    """The replayed vehicle r0 at a pose, on whatever lane is there."""
    sumo.place_all([("r0", x, y, angle_deg, ("", -1))])


def test_second_simulation_in_one_process_is_refused(sumo: Simulation, net: bytes) -> None:
    with pytest.raises(SimulationError, match="already running"), Simulation(net, seed=0, step_s=0.1):
        pass
    sumo.step()  # the first one is unharmed


def test_simulation_is_closed_behind_an_error_and_a_net_that_sumo_refuses(net: bytes) -> None:
    broken = b"<net version='1.20'><edge/></net>"
    with pytest.raises(SimulationError, match="SUMO does not load the net"), Simulation(broken, seed=0, step_s=0.1):
        pass
    with pytest.raises(RuntimeError, match="mine"), Simulation(net, seed=0, step_s=0.1):
        raise RuntimeError("mine")
    with Simulation(net, seed=0, step_s=0.1) as again:
        again.step()


def test_rewound_simulation_is_as_good_as_a_fresh_one(net: bytes) -> None:
    """A car follows a replayed one that brakes: the same in a simulation of its own and behind something else."""

    def drive(sumo: Simulation) -> list[float]:
        sumo.add_replayed("r0", length_m=4.5, width_m=1.9)
        speeds = []
        for step in range(40):
            _place(sumo, 50.0 + 0.8 * step - 0.01 * step**2, 0.0, 90.0)
            sumo.step()
            if step == 0:
                assert _insert(sumo, "v1", 20.0, 11.0) is None
            speeds.append(sumo.speed("v1"))
        return speeds

    with Simulation(net, seed=0, step_s=0.1, model="Krauss") as fresh:
        wanted = drive(fresh)
    with Simulation(net, seed=0, step_s=0.1, model="Krauss") as sumo:
        sumo.rewind()
        assert _insert(sumo, "v1", 60.0, 3.0) is None
        for _ in range(30):
            sumo.step()
        sumo.rewind()
        assert sumo.vehicle_ids() == frozenset()
        assert drive(sumo) == wanted
    assert min(wanted) < 9.0


def test_vehicle_is_inserted_close_behind_another_if_it_was_planned_so(sumo: Simulation) -> None:
    """SUMO's own insertion check would wait: it takes the one ahead, as fast, for one that may stop at any time.

    A lane that the net does not have is an objection, not an error, and SUMO has nothing of the vehicle.
    """
    assert _insert(sumo, "v0", 2.0, 8.0, lane_id="1#0_7") is not None
    sumo.step()
    assert sumo.vehicle_ids() == frozenset()
    assert _insert(sumo, "v1", 40.0, 8.0) is None
    assert _insert(sumo, "v2", 31.0, 8.0) is None
    sumo.step()
    assert {"v1", "v2"} <= sumo.vehicle_ids()


def test_vehicle_that_is_taken_from_the_queue_may_queue_again(sumo: Simulation) -> None:
    """The lane's first metres are taken until the vehicle ahead has gone; the one behind it waits, twice."""
    sumo.step()
    assert _insert(sumo, "v1", 6.0, 0.0) is None
    sumo.drive("v1", desired_mps=12.0, limit_mps=0.0)
    for _ in range(2):
        sumo.queue("v2", edges=EDGES, lane_index=0, driver=DRIVER, size=CAR)
        sumo.step()
        assert sumo.vehicle_ids() == {"v1"}
        sumo.remove("v2")
        sumo.step()
    sumo.queue("v2", edges=EDGES, lane_index=0, driver=DRIVER, size=CAR)
    sumo.drive("v1", desired_mps=12.0, limit_mps=None)
    for _ in range(80):
        sumo.step()
    assert sumo.lane("v2")[0].endswith("_0")


def test_limit_holds_below_the_desired_speed_and_ends_with_it(sumo: Simulation) -> None:
    """7.9 m/s for one step at 8; without a limit 10 m/s are reached at 1.8 m/s2: 8.08 after a step, 10 after 1.2 s.

    Its lane is changed at once, it keeps its route, and leaves at its end.
    """
    _insert(sumo, "v1", 22.25, 8.0)
    sumo.drive("v1", desired_mps=10.0, limit_mps=7.9)
    sumo.step()
    assert sumo.speed("v1") == pytest.approx(7.9)
    sumo.drive("v1", desired_mps=10.0, limit_mps=None)
    sumo.change_lane("v1", 1, edges=EDGES[5:])
    sumo.step()
    assert sumo.speed("v1") == pytest.approx(8.08)
    assert sumo.lane("v1")[0].endswith("_1")
    for _ in range(12):
        sumo.step()
    assert sumo.speed("v1") == pytest.approx(10.0)
    assert sumo.lane("v1")[0].endswith("_1")
    for _ in range(70):
        sumo.step()
    assert "v1" not in sumo.vehicle_ids()


def test_unsafe_lane_change_is_refused(sumo: Simulation) -> None:
    """A vehicle that stands right beside: nothing happens, nobody is touched."""
    sumo.add_replayed("r0", length_m=4.5, width_m=1.9)
    _place(sumo, 24.0, 3.5, 90.0)
    sumo.step()
    _insert(sumo, "v1", 22.25, 0.0)
    _place(sumo, 24.0, 3.5, 90.0)
    sumo.drive("v1", desired_mps=12.0, limit_mps=0.0)
    sumo.change_lane("v1", 1, edges=EDGES[5:])
    sumo.step()
    assert sumo.lane("v1")[0].endswith("_0")
    sumo.remove("r0")  # what was refused is over: SUMO does not make it up at the next step
    sumo.drive("v1", desired_mps=12.0, limit_mps=0.0)
    sumo.step()
    assert sumo.lane("v1")[0].endswith("_0")


def test_gap_behind_a_replayed_vehicle_is_what_its_expected_deceleration_asks_for(net: bytes) -> None:
    """Krauss: gap_min + v tau + v^2 / 2b - v^2 / 2b_leader. At 5 m/s, tau 1, gap_min 1.5 and b 2.5: 6.5 m behind one
    that would brake alike, and 25 / 5 - 25 / 9 = 2.2 m more behind one that SUMO expects to brake with 4.5 m/s2.
    """
    with Simulation(net, seed=0, step_s=0.1, model="Krauss") as sumo:
        sumo.add_replayed("r0", length_m=4.5, width_m=1.9)
        for step in range(120):
            front = 30.0 + 0.5 * step
            _place(sumo, front, 0.0, 90.0)
            sumo.step()
            if step == 0:
                assert sumo.insert(
                    "v1", edges=EDGES[3:], lane_id="1#3_0", front_m=0.0, speed_mps=5.0,
                    driver=replace(DRIVER, tau_s=1.0, min_gap_m=1.5), size=CAR, max_speed_mps=12.0,
                ) is None  # fmt: skip
        pose = sumo.poses(["v1"])[0]
        assert pose is not None
        assert front - 4.5 - pose[0] == pytest.approx(8.7, abs=0.5)
