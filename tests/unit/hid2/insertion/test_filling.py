"""Rounds of filling a scene; in SUMO's place a function says how the starts were driven."""

import itertools
import logging
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from hand_drawn import draw_road
from inserted import changing, driven, scene_on, sites_of

from hid2.agents import Policy
from hid2.insertion.filling import Filling, _found_none
from hid2.insertion.finalise import ExportedVehicle
from hid2.insertion.sites import TurnedDown
from hid2.insertion.starts import Site, Starts
from hid2.insertion.surroundings import Surroundings
from hid2.occupancy.traffic import Traffic
from hid2.params import Config, Request, Spawn
from hid2.reasons import Reason
from hid2.scene import Scene
from hid2.vehicle import DrivenVehicle, Start, VehicleRequest

NOTHING = {"straight": 0.0, "left_turn": 0.0, "right_turn": 0.0, "lane_change": 0.0, "overtake": 0.0}
#: Half of all change lanes, from 1 s on.
HALF: dict[str, Any] = {"straight": 0.5, "lane_change": 0.5, "trigger_min_s": 1.0, "trigger_max_s": 1.0}
Spoil = Callable[[DrivenVehicle, int], DrivenVehicle]
BRAKES = 5  # steps: half a second, for which a vehicle has to brake to be seen to


@dataclass
class Road:
    """Drives everybody at 8 m/s; spoil(vehicle, round) may change what came of it. Keeps the starts of each round."""

    spoil: Spoil
    rounds: list[list[Start]] = field(default_factory=list)
    kept_before: list[int] = field(default_factory=list)

    def __call__(self, starts: Sequence[Start], kept: Traffic, number: int) -> list[DrivenVehicle]:
        assert number >= len(self.rounds)  # a round without a start is not driven
        self.rounds.append(list(starts))
        self.kept_before.append(len(kept.ids))
        return [self.spoil(driven(start, np.full(110 - start.step, 8.0)), number) for start in starts]


def _refusing(
    *vehicle_ids: str,
    where: Callable[[VehicleRequest, int], bool] = lambda *_: False,
    reason: Reason = Reason.SUMO_REFUSES_INSERTION,
) -> Spoil:
    """SUMO does not insert these vehicles, nor those of some requests in a round."""

    def spoil(vehicle: DrivenVehicle, number: int) -> DrivenVehicle:
        if vehicle.vehicle_id in vehicle_ids or where(vehicle.start.request, number):
            vehicle.not_inserted = reason
        return vehicle

    return spoil


def scene_for(*, agents: int | str = 4, rounds: int = 6, reseeds: int = 2, **request: object) -> Scene:
    """Two empty lanes of 500 m; everybody goes straight unless told."""
    mix = {**NOTHING, "straight": 1.0, **request}
    config = Config(request=Request(agents=agents, **mix), spawn=Spawn(rounds=rounds, reseed_rounds=reseeds))
    return scene_on(draw_road(length_m=500.0), config=config)


def _fill(scene: Scene, spoil: Spoil | None = None, *, seed: int = 0) -> tuple[Filling, Road]:
    filling, drive = Filling(Surroundings(scene), [seed, 0, 1]), Road(spoil or _refusing())
    filling.fill(drive)
    return filling, drive


def test_count_is_reached_in_one_round_and_no_vehicle_is_driven_beyond_it() -> None:
    """With nobody asked for in one empty simulation, which replays the recorded agents that the sidecar tells of."""
    filling, drive = _fill(scene_for())
    assert len(filling.kept) == 4
    assert filling.rounds == len(drive.rounds) == 1
    assert len(drive.rounds[0]) == 4
    assert filling.rejected == []
    assert filling.unmet == []
    filling, drive = _fill(scene_for(agents=0))
    assert filling.kept == []
    assert [len(starts) for starts in drive.rounds] == [0]


def test_failed_vehicle_is_replaced_elsewhere_and_counted_with_its_reason() -> None:
    filling, drive = _fill(scene_for(), _refusing("v0_0", "v1_0"), seed=1)
    assert len(filling.kept) == 4
    assert [(one.vehicle.vehicle_id, one.reason, one.round_number) for one in filling.rejected] == [
        ("v0_0", Reason.SUMO_REFUSES_INSERTION, 0), ("v1_0", Reason.SUMO_REFUSES_INSERTION, 0),
    ]  # fmt: skip
    assert [start.vehicle_id for start in drive.rounds[1]] == ["v0_1", "v1_1"]
    assert drive.kept_before == [0, 2]
    assert drive.rounds[1][0].start_m != drive.rounds[0][0].start_m


def test_who_cannot_enter_is_replaced_and_its_lane_stays_open() -> None:
    """Everybody who would enter finds somebody at the edge in round 0: the next round tries the same two lanes."""

    def spoil(vehicle: DrivenVehicle, number: int) -> DrivenVehicle:
        if number == 0 and vehicle.start.step > 0:
            vehicle.not_inserted, vehicle.s[:], vehicle.v[:] = Reason.NO_ROOM_AT_EDGE, [], []
        return vehicle

    filling, drive = _fill(scene_for(agents=2, entering=1.0, near="anywhere"), spoil)
    first, second = drive.rounds
    assert [start.step > 0 for start in (*first, *second)] == [True] * 4
    assert [(one.reason, one.vehicle.last_step) for one in filling.rejected] == [
        (Reason.NO_ROOM_AT_EDGE, start.step) for start in first
    ]
    assert [one.driven.start for one in filling.kept] == second
    assert [one.span.stop for one in filling.kept] == [110, 110]


def test_places_that_failed_are_tried_again_where_no_other_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where all of the first round fail, or the first start on each lane; all of a lane is near to these."""
    make, refused = Starts.make, set[tuple[int, ...]]()

    def refuse_first(starts: Starts, request: VehicleRequest, site: Site, **wants: Any) -> Start | Reason:
        seen = site.offer.route in refused
        refused.add(site.offer.route)
        return make(starts, request, site, **wants) if seen else Reason.CONFLICT_PREDICTED

    monkeypatch.setattr("hid2.insertion.sites._AVOIDED_M", 600.0)
    filling, drive = _fill(scene_for(), _refusing("v0_0", "v1_0", "v2_0", "v3_0"))
    assert (len(filling.kept), filling.rounds, {one.route[0] for one in drive.rounds[0]}) == (4, 2, {1, 2})
    monkeypatch.setattr("hid2.insertion.starts.Starts.make", refuse_first)
    filling, drive = _fill(scene_for())
    assert (len(refused), len(filling.kept), filling.rounds) == (2, 4, 1)


def test_safe_vehicle_whose_manoeuvre_did_not_come_about_takes_an_open_request_to_go_straight() -> None:
    """Two lane changes, v2 and v3, do not come about; v0, which was to go straight, is refused. One of the two takes
    its place and has no record of a manoeuvre; the other one goes. Both lane changes stay open for round 1.
    """
    filling, drive = _fill(scene_for(**HALF), _refusing("v0_0"))
    assert {start.vehicle_id for start in drive.rounds[0]} == {"v0_0", "v1_0", "v2_0", "v3_0"}
    assert drive.kept_before[:2] == [0, 2]
    stayed = [one.driven for one in filling.kept if one.driven.vehicle_id in ("v2_0", "v3_0")]
    assert [(one.policy, one.start.request.number) for one in stayed] == [(Policy.STRAIGHT, 0)]
    assert not {one.vehicle_id for one in stayed} & filling.outcomes.keys()
    gone = {one.vehicle.vehicle_id: one.reason for one in filling.rejected if one.round_number == 0}
    assert set(gone.values()) == {Reason.SUMO_REFUSES_INSERTION, Reason.DID_NOT_DO_IT}
    assert len(gone) == 2
    assert {start.vehicle_id for start in drive.rounds[1]} == {"v2_1", "v3_1"}


def test_vehicle_that_is_on_its_way_across_does_not_go_straight() -> None:
    """As above, and both lane changes are under way when the map ends: neither takes the place of v0."""
    scene = scene_for(**HALF)

    def spoil(vehicle: DrivenVehicle, number: int) -> DrivenVehicle:
        if vehicle.vehicle_id == "v0_0":
            vehicle.not_inserted = Reason.SUMO_REFUSES_INSERTION
        if number == 0 and vehicle.policy is Policy.LANE_CHANGE:
            to, mps = 3 - vehicle.start.route[0], 7.0  # at other speeds they meet
            vehicle = changing(scene, vehicle.start, np.full(110, mps), to=to, at_step=20, wanted_s=5.0)
            vehicle.s, vehicle.v, vehicle.jumped_m = vehicle.s[:60], vehicle.v[:60], vehicle.jumped_m[:60]
        return vehicle

    filling, _ = _fill(scene, spoil)
    gone = {one.vehicle.vehicle_id: one.reason for one in filling.rejected if one.round_number == 0}
    assert gone["v0_0"] is Reason.SUMO_REFUSES_INSERTION
    assert gone.get("v2_0") is gone.get("v3_0") is Reason.DID_NOT_DO_IT


def test_vehicle_that_another_one_needs_stays_before_one_that_none_needs() -> None:
    """As above, and v1 had braked for v3."""

    def spoil(vehicle: DrivenVehicle, number: int) -> DrivenVehicle:
        if vehicle.vehicle_id == "v0_0":
            vehicle.not_inserted = Reason.SUMO_REFUSES_INSERTION
        if vehicle.vehicle_id == "v1_0":
            vehicle.waited_for[needed] = BRAKES
        return vehicle

    for needed in ("v2_0", "v3_0"):
        filling, _ = _fill(scene_for(**HALF), spoil)
        kept = {one.driven.vehicle_id for one in filling.kept}
        assert {"v1_0", needed} < kept
        assert not {"v2_0", "v3_0"} - {needed} & kept


def test_two_rounds_that_add_no_vehicle_are_the_last() -> None:
    """Round 0 keeps v0 to v2; v3 fails in this one and in all that follow, which are two instead of eleven.

    Of one round that is all there is one.
    """
    filling, drive = _fill(scene_for(rounds=12), _refusing(where=lambda one, _: one.number == 3))
    assert [len(starts) for starts in drive.rounds] == [4, 1, 1]
    assert len(filling.kept) == 3
    filling, drive = _fill(scene_for(rounds=1), _refusing(where=lambda *_: True))
    assert filling.kept == []
    assert len(drive.rounds) == filling.rounds == 1


def test_max_is_sought_until_rounds_add_none() -> None:
    """Forty are asked for: round 0 keeps thirty, and each of the five after it two."""
    spoil = _refusing(where=lambda one, number: one.number >= 30 + 2 * number)
    assert len(_fill(scene_for(agents="max", rounds=12, reseeds=0), spoil)[0].kept) == 40


def test_reason_of_a_manoeuvre_without_a_site_is_what_turns_most_down_rather_than_that_places_are_taken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two places in three are taken, and from the others lane changes are too slow: all of them name that."""
    make, count = Starts.make, itertools.count()

    def too_slow(starts: Starts, request: VehicleRequest, site: Site, **wants: Any) -> Start | Reason:
        if request.policy is not Policy.LANE_CHANGE:
            return make(starts, request, site, **wants)
        return Reason.TOO_SLOW if next(count) % 3 == 0 else Reason.NO_SITE

    monkeypatch.setattr(Starts, "make", too_slow)
    filling, _ = _fill(scene_for(**HALF))
    lane_changes = [one.reason for one in filling.unmet if one.request.policy is Policy.LANE_CHANGE]
    assert lane_changes
    assert set(lane_changes) == {Reason.TOO_SLOW}
    sites = sites_of(scene_for())
    refused = Counter({Reason.NO_SITE: 9, Reason.TTC_AT_END: 1, Reason.TOO_SLOW: 2})
    assert _found_none(Policy.LANE_CHANGE, sites, refused) is Reason.TOO_SLOW
    assert _found_none(Policy.LANE_CHANGE, sites, Counter()) is Reason.NO_CELL_IN_REACH


def test_cells_that_were_turned_down_are_left_alone_in_rounds_to_come(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cells of lane 1 admit no start. Each round adds three vehicles of twelve, and in none is a cell looked at once
    more that was turned down in those before, there or near to it, unless all are looked at anew.
    """
    make, looked, anew, before = Starts.make, Counter[tuple[int, int, int]](), [0], TurnedDown.look_anew

    def only_lane_2(starts: Starts, request: VehicleRequest, site: Site, **wants: Any) -> Start | Reason:
        assert site.s is not None
        path = starts.scene.paths.along(site.offer.route)
        cell = starts.scene.cell_at(path, path.to_line(site.s))
        if cell.lane_id == 2:
            return make(starts, request, site, **wants)
        looked[anew[0], cell.lane_id, cell.index] += 1
        return Reason.CONFLICT_PREDICTED

    def look_anew(turned_down: TurnedDown) -> None:
        anew[0] += 1
        before(turned_down)

    monkeypatch.setattr("hid2.insertion.starts.Starts.make", only_lane_2)
    monkeypatch.setattr(TurnedDown, "look_anew", look_anew)
    filling, drive = _fill(scene_for(agents=12), _refusing(where=lambda one, number: one.number >= 3 * (number + 1)))
    assert len(drive.rounds) >= 4
    assert 25 < len(looked) < 100  # those around are spared
    assert max(looked.values()) == 1
    assert len(filling.kept) == 12


def test_unmet_manoeuvres_are_told_with_their_last_reason_and_the_count_is_reached() -> None:
    """Vehicles that are to change lanes are not safe. After three rounds straight ones take the places; each request is
    told of.
    """
    refuse = _refusing(where=lambda one, _: one.policy is Policy.LANE_CHANGE, reason=Reason.MEETS_RECORDED)
    filling, _ = _fill(scene_for(**HALF), refuse)
    assert len(filling.kept) == 4
    assert [(one.request.policy, one.reason) for one in filling.unmet] == [
        (Policy.LANE_CHANGE, Reason.MEETS_RECORDED), (Policy.LANE_CHANGE, Reason.MEETS_RECORDED),
    ]  # fmt: skip
    assert {one.driven.policy for one in filling.kept} == {Policy.STRAIGHT}


@pytest.mark.parametrize("reseeds", [0, 2])
def test_vehicle_that_tries_a_manoeuvre_last_stays_with_its_reason(reseeds: int) -> None:
    """No lane change comes about: each is tried anew in spawn.reseed_rounds, and vehicles of the last one stay."""

    def refuse(vehicle: DrivenVehicle, _number: int) -> DrivenVehicle:
        vehicle.reason = Reason.SUMO_REFUSES
        return vehicle

    filling, drive = _fill(scene_for(reseeds=reseeds, **HALF), refuse)
    assert len(drive.rounds) == 1 + reseeds
    assert len(filling.rejected) == 2 * reseeds
    assert len(filling.kept) == 4
    assert filling.unmet == []
    told = [(one.status, one.reason) for one in filling.outcomes.values()]
    assert told == [("not_feasible", Reason.SUMO_REFUSES)] * 2


def test_what_the_map_or_the_scene_does_not_offer_is_told_at_once() -> None:
    """No turn on a straight road; a trigger at 11 s is behind the last step at 10.9 s."""
    turns, _ = _fill(scene_for(straight=0.5, left_turn=0.5))
    assert [one.reason for one in turns.unmet] == [Reason.MAP_OFFERS_NO_LEFT_TURN] * 2
    late, drive = _fill(scene_for(straight=0.5, lane_change=0.5, trigger_min_s=11.0, trigger_max_s=11.0))
    assert [one.reason for one in late.unmet] == [Reason.TRIGGER_AFTER_SCENE] * 2
    assert {start.request.policy for start in drive.rounds[0]} == {Policy.STRAIGHT}
    assert len(turns.kept) == len(late.kept) == 4


def test_what_braked_for_a_vehicle_that_is_gone_goes_too() -> None:
    """V0 fails; v2 had braked for it, v1 for v2: all three requests are met anew. v3 stays."""

    def spoil(vehicle: DrivenVehicle, number: int) -> DrivenVehicle:
        if number == 0:
            if vehicle.vehicle_id == "v0_0":
                vehicle.not_inserted = Reason.SUMO_REFUSES_INSERTION
            vehicle.waited_for[{"v2_0": "v0_0", "v1_0": "v2_0"}.get(vehicle.vehicle_id, "")] = BRAKES
        return vehicle

    filling, drive = _fill(scene_for(), spoil, seed=1)
    assert {one.vehicle.vehicle_id: one.reason for one in filling.rejected} == {
        "v0_0": Reason.SUMO_REFUSES_INSERTION, "v1_0": Reason.WAITED_FOR_GONE, "v2_0": Reason.WAITED_FOR_GONE,
    }  # fmt: skip
    assert {start.vehicle_id for start in drive.rounds[1]} == {"v0_1", "v1_1", "v2_1"}
    assert drive.kept_before == [0, 1]
    assert len(filling.kept) == 4


@pytest.mark.parametrize("seed", range(3))
def test_count_is_never_exceeded_nor_a_request_met_twice(seed: int) -> None:
    """Half lane changes, which succeed only in the second round, beside spare ones that are there in the first.

    A third of all fails, and some had waited for others.
    """
    rng = np.random.default_rng(seed)
    scene = scene_for(agents=6, **HALF)

    def spoil(vehicle: DrivenVehicle, number: int) -> DrivenVehicle:
        if rng.random() < 0.3:
            vehicle.not_inserted = Reason.SUMO_REFUSES_INSERTION
        elif vehicle.policy is Policy.LANE_CHANGE and number > 0:
            (own,) = {segment.lane_id for segment in vehicle.path.segments}
            vehicle = changing(scene, vehicle.start, vehicle.v, to={1: 2, 2: 1}[own], at_step=10, wanted_s=4.0)
        if rng.random() < 0.3:
            needed = f"v{int(rng.integers(6))}_{number}"
            vehicle.waited_for = Counter({needed: BRAKES} if needed != vehicle.vehicle_id else {})
        return vehicle

    filling, _ = _fill(scene, spoil, seed=seed)
    assert len(filling.kept) <= 6
    numbers = [one.driven.start.request.number for one in filling.kept]
    assert len(numbers) == len(set(numbers))
    manoeuvres = [one for one in filling.kept if one.driven.policy is Policy.LANE_CHANGE]
    assert len(manoeuvres) + len(filling.unmet) == 3


def test_debug_log_tells_what_became_of_every_vehicle_that_was_tried(caplog: pytest.LogCaptureFixture) -> None:
    """V0 is refused and replaced in round 1; the lane change of the other request never comes about."""

    def spoil(vehicle: DrivenVehicle, number: int) -> DrivenVehicle:
        if number == 0 and vehicle.policy is Policy.STRAIGHT:
            vehicle.not_inserted = Reason.SUMO_REFUSES_INSERTION
        vehicle.reason = Reason.SUMO_REFUSES
        return vehicle

    with caplog.at_level(logging.DEBUG, logger="hid2.insertion.filling"):
        filling, drive = _fill(scene_for(agents=2, straight=0.5, lane_change=0.5), spoil)
    told = [record.getMessage() for record in caplog.records]
    tried = [start.vehicle_id for starts in drive.rounds for start in starts]
    assert [sum(f"vehicle {vehicle_id}," in line for line in told) for vehicle_id in tried] == [1] * len(tried)
    for one in filling.rejected:
        detail = f" ({one.detail})" if one.detail else ""
        assert (
            f"round {one.round_number}: vehicle {one.vehicle.vehicle_id}, {one.vehicle.policy}, "
            f"lane {one.cell.lane_id} cell {one.cell.index}, last step {one.vehicle.last_step}: {one.reason}{detail}"
        ) in told
    assert {one.reason for one in filling.rejected} == {Reason.SUMO_REFUSES_INSERTION, Reason.DID_NOT_DO_IT}
    assert sum(": kept" in line for line in told) == len(filling.kept) == 2


def test_vehicle_that_conflicts_with_others_together_is_replaced_and_kept_ones_stay(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Row 0 is said to conflict while it is new, in the first round; in the second those from row 3 on are asked."""

    def said(_scene: Scene, exported: Sequence[ExportedVehicle], *, first_row: int) -> list[tuple[int, Reason]]:
        return [(0, Reason.PET)] if first_row == 0 else []

    monkeypatch.setattr("hid2.insertion.filling.conflicting", said)
    filling, drive = _fill(scene_for())
    assert [(one.reason, one.round_number) for one in filling.rejected] == [(Reason.PET, 0)]
    assert drive.kept_before == [0, 3]
    assert len(filling.kept) == 4
