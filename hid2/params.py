"""Every tunable of the method: default, unit, range and source, in one typed, frozen tree.

`Config` is what a request resolves to; it goes into the sidecar as it is. The paper's symbol or the source of a
number is written beside it.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from hid2.policies import Policy


def _param(default: Any, unit: str, source: str, **bounds: Any) -> Any:  # noqa: ANN401
    return Field(default=default, json_schema_extra={"unit": unit, "source": source}, **bounds)


def _option(default: Any, unit: str, says: str, metavar: str, **more: Any) -> Any:  # noqa: ANN401
    """A parameter that is an option of `hid2 generate` as well; shown: in place of the default, "" for none."""
    extra: dict[str, Any] = {"unit": unit, "source": says, "metavar": metavar, "shown": str(default)}
    extra |= {"shown": more.pop("shown")} if "shown" in more else {}
    return Field(default=default, json_schema_extra=extra, **more)


_FUNCTION = r"^[A-Za-z_][\w.]*:[A-Za-z_]\w*$"  # module:function
_ARGUMENT = r"[A-Za-z_]\w*=-?[0-9][0-9.e+-]*"
_ARGUMENTS = rf"^({_ARGUMENT}(, *{_ARGUMENT})*)?$"


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Request(_Section):
    """What the user asks for in a scene."""

    agents: Annotated[int, Field(ge=0, le=500)] | Literal["max"] = _option(
        10, "vehicles", "Vehicles to insert into each scene (paper, Diversity: 10); max: as many as it holds", "N|max"
    )
    straight: float = _param(0.73, "share", "policy mix; shares are divided by their sum", ge=0, le=1)
    left_turn: float = _param(0.035, "share", "policy mix; turns as often as recorded: 0.07", ge=0, le=1)
    right_turn: float = _param(0.035, "share", "policy mix", ge=0, le=1)
    lane_change: float = _param(0.15, "share", "policy mix", ge=0, le=1)
    overtake: float = _param(0.05, "share", "policy mix", ge=0, le=1)
    trigger_min_s: float = _param(0.5, "s", "t_trigger, uniform from here", ge=0, le=60)
    trigger_max_s: Annotated[float, Field(ge=0, le=60)] | None = _param(
        None, "s", "t_trigger, uniform to here (equal to trigger_min_s: fixed); where none: what is usual"
    )
    trigger_usual_s: float = _param(4.0, "s", "t_trigger where no trigger_max_s is asked for: to here", ge=0, le=60)
    trigger_usual_share: float = _param(
        0.36, "share", "of the scene's duration, and no later: what comes about takes seconds", ge=0, le=1
    )
    trigger_overtake_share: float = _param(0.14, "share", "the same for overtakes, which take 8 s and more", ge=0, le=1)
    trigger_list_s: tuple[Annotated[float, Field(ge=0, le=60)], ...] = _param(
        (), "s", "t_trigger, one of these; used instead of the range where there are any"
    )
    sites: Literal["promising", "any"] = _param(
        "promising", "-", "start sites: those first where map and traffic allow what is asked for; any: uniformly drawn"
    )
    near: str = _option(
        "traffic", "-",
        "Where vehicles are inserted first: near moving traffic, the recording vehicle, the focal track, scored "
        "tracks, or a track; what finds no site there is inserted elsewhere",
        "av|focal|scored|traffic|anywhere|TRACK_ID", min_length=1, max_length=100,
    )  # fmt: skip
    within_m: float = _option(
        30.0, "m",
        "How near that is, in metres between centres: to traffic at some step, to others at the last observed one",
        "M", gt=0, le=500,
    )  # fmt: skip
    focal: Literal["recorded", "generated"] = _option("recorded", "-", "Which track is the focal one (category 3)", "")
    focal_radius_m: float = _param(
        50.0, "m", "a generated focal track is the one with the most neighbours within this that does its manoeuvre",
        gt=0, le=200,
    )  # fmt: skip
    generated_category: Literal[1, 2] = _param(1, "-", "category of generated tracks: 1 context, 2 scored")
    entering: float = _option(
        0.0, "share", "Of the vehicles that go straight: these enter at the map's edge during the observed steps, "
        "where there is room; none where generated_category is 2", "SHARE", ge=0, le=1,
    )  # fmt: skip
    seed: int = _option(0, "-", "Seed of every random choice", "N", ge=0, le=2**31 - 1)
    variants: int = _option(1, "scenes", "Scenes to write for each source scene", "K", ge=1, le=10_000)
    spawn_leaders: bool = _option(True, "-", "Add a slow lead vehicle when an overtake has none", "")
    bus_share: float = _param(0.0, "share", "share of buses among generated vehicles", ge=0, le=1)
    truck_share: float = _param(0.0, "share", "share of box trucks among generated vehicles", ge=0, le=1)

    @model_validator(mode="after")
    def _check(self) -> "Request":
        if self.trigger_max_s is not None and self.trigger_max_s < self.trigger_min_s:
            raise ValueError(f"trigger_max_s {self.trigger_max_s} is below trigger_min_s {self.trigger_min_s}")
        if sum(self.behaviours.values()) <= 0:
            raise ValueError("the behaviour shares sum to 0, expected at least one above 0")
        if self.bus_share + self.truck_share > 1:
            raise ValueError("bus_share + truck_share is above 1")
        return self

    @property
    def first_trigger_s(self) -> float:
        """Earliest trigger time that may be drawn, s."""
        return min(self.trigger_list_s, default=self.trigger_min_s)

    @property
    def behaviours(self) -> Mapping[Policy, float]:
        """Shares by policy, as asked for."""
        return {policy: float(getattr(self, policy.value)) for policy in Policy}

    @property
    def is_near_agents(self) -> bool:
        """Whether vehicles are to be near to agents that are named, not to traffic or anywhere."""
        return self.near not in ("traffic", "anywhere")


class Source(_Section):
    """What is asked of a recording before anything is driven in it."""

    plausible: bool = _param(
        True, "-", "refuse recordings with tracks that fit neither their map nor their own velocities and headings"
    )


class Grid(_Section):
    """Lane gridification."""

    cell_m: float = _param(4.0, "m", "delta s, paper eq. N_l = ceil(L_l / 4.0)", ge=1, le=20)
    max_skew_m: float = _param(6.0, "m", "a row of cells more skewed than this is split", ge=0.5, le=20)


class Spawn(_Section):
    """Insertion into free cells."""

    prior_speed_mps: float = _param(
        9.0, "m/s", "median moving speed on urban AV2 lanes; where the scene has none", gt=0, le=40
    )
    min_speed_mps: float = _param(4.0, "m/s", "slowest desired speed drawn", ge=0, le=40)
    max_speed_mps: float = _param(
        20.0, "m/s", "fastest desired speed drawn; where it is above 20, the speed limit of the lanes", gt=0, le=50
    )
    usual_from_m: float = _param(
        5.0, "m", "vehicles that drive less over the scene do not count for the usual speed", ge=0, le=100
    )
    usual_from_s: float = _param(1.0, "s", "nor do vehicles that move for less than this", ge=0, le=10)
    speed_sd: float = _param(
        0.08, "share", "standard deviation of the start speed around the desired one", ge=0, le=0.5
    )
    clear_gap_m: float = _param(2.0, "m", "smallest bumper gap at the start", ge=0.5, le=50)
    settle_s: float = _param(
        3.0, "s", "a start holds if a vehicle that drives on and brakes as a driver would meets no agent for this long",
        ge=0, le=10,
    )  # fmt: skip
    near_weight: float = _param(8.0, "ratio", "weight of sites near to agents that request.near asks for", ge=1, le=100)
    leader_weight: float = _param(
        6.0, "ratio", "weight of sites from which a recorded vehicle would be followed", ge=1, le=100
    )
    braking_weight: float = _param(3.0, "ratio", "weight of those of them with a braking leader", ge=1, le=100)
    crossing_weight: float = _param(
        3.0, "ratio", "weight of sites from which recorded traffic would be crossed", ge=1, le=100
    )
    run_into_weight: float = _param(
        0.2, "ratio", "weight of sites where a recorded follower would run into the vehicle: most fail", ge=0, le=1
    )
    crossing_apart_s: tuple[Annotated[float, Field(ge=0, le=10)], Annotated[float, Field(ge=0, le=10)]] = _param(
        (1.8, 3.8), "s", "between centres where a path is crossed; boxes take about .8 s less, which leaves a PET from "
        "conflict's critical 1 s to 3 s",
    )  # fmt: skip
    rounds: int = _param(12, "rounds", "simulations run to reach the requested count", ge=1, le=50)
    reseed_rounds: int = _param(
        2, "rounds", "a manoeuvre that did not come about is given to another vehicle elsewhere so often", ge=0, le=20
    )
    most_agents: int = _param(400, "vehicles", "most that `agents = max` asks for", ge=1, le=500)
    spacing_m: float = _param(25.0, "m", "lane that a vehicle takes on a full road; `agents = max`", ge=5, le=200)
    full_share: float = _param(0.1, "share", "a round of `max` that adds a smaller share is the last", ge=0, le=1)
    failed_manoeuvres: int = _param(
        4, "requests", "without a site, after which a round looks for no more for that manoeuvre", ge=1, le=500
    )
    failed_straight: int = _param(1, "requests", "the same for those that go straight", ge=1, le=500)
    driven_again: int = _param(
        1, "times", "a vehicle that had waited for one that is gone is driven again", ge=0, le=10
    )

    @model_validator(mode="after")
    def _check(self) -> "Spawn":
        if self.prior_speed_mps > self.max_speed_mps:
            raise ValueError(f"prior_speed_mps {self.prior_speed_mps:g} is above max_speed_mps {self.max_speed_mps:g}")
        return self


class Sites(_Section):
    """Where vehicles may begin, and how fast. Chosen on the scenes of tests/real unless another source is named."""

    cell_tries: int = _param(
        2, "vehicles", "that were turned down on a cell or near to it, after which it is left alone", ge=1, le=1000
    )
    tries: int = _param(80, "sites", "looked at in full for a request in a round", ge=1, le=10_000)
    drivers: int = _param(3, "drivers", "drawn for a site before it is turned down", ge=1, le=50)
    routes: int = _param(16, "routes", "known from a lane", ge=1, le=1000)
    run_up_m: float = _param(40.0, "m", "length of a route before the lane of a start: followers are seen there", ge=0,
        le=200,
    )  # fmt: skip
    routes_estimated: int = _param(
        4, "routes", "with the same turns: what is met from a lane's cells is estimated as their mean", ge=1, le=100
    )
    pace_share: float = _param(
        0.9, "share", "of the usual speed, at which it is estimated where a vehicle would be: it brakes now and then",
        gt=0, le=2,
    )  # fmt: skip
    near_share: float = _param(
        0.7,
        "share",
        "of request.within_m: an agent estimated within it counts as near; estimates are rough",
        gt=0,
        le=1,
    )
    leaves_share: float = _param(
        0.8, "share", "of the way at usual speed: no vehicle begins with less of it left on the map", ge=0, le=2
    )
    avoided_m: float = _param(
        8.0,
        "m",
        "no vehicle begins around a start that could not be kept, nor where vehicles were turned down",
        ge=0,
        le=100,
    )
    from_edge_m: float = _param(
        0.5, "m", "least distance of a rear bumper from the beginning of the way at the start", ge=0, le=50
    )
    standing_mps: float = _param(0.3, "m/s", "a vehicle that would begin more slowly begins standing", ge=0, le=3)
    queue_m: float = _param(8.0, "m", "a vehicle begins standing only this near behind one that stands", ge=0, le=50)
    slowest_share: float = _param(
        0.25, "share", "of the desired speed; no vehicle begins more slowly, except standing in a queue", ge=0, le=1
    )
    begin_braking_mps2: float = _param(0.8, "m/s2", "a vehicle may begin by braking so hard for its leader", ge=0, le=4)
    looks_s: float = _param(1.0, "s", "between two looks at gaps in a rollout", gt=0, le=10)
    hindered_s: float = _param(
        4.0, "s", "TTC to a vehicle that begins ahead, below which one chosen before is rolled out anew", ge=0, le=20
    )
    before_turn_m: float = _param(5.0, "m", "a vehicle that is to turn begins so far before the turn", ge=0, le=100)
    turn_approach_share: float = _param(0.75, "share", "mean speed up to a turn, over the usual one", gt=0, le=1)
    turn_pace_mps: float = _param(5.0, "m/s", "mean speed on a turn lane, to tell when it is left", gt=0, le=20)
    turn_spare_s: float = _param(2.0, "s", "left of the scene after a turn", ge=0, le=10)
    entry_stays_s: float = _param(
        3.0, "s", "a vehicle that enters at the map's edge stays at least so long", ge=0.5, le=10
    )
    entry_edge_m: float = _param(
        15.0, "m", "a lane that begins so near to the hull of all lanes begins at the map's edge; farther inside it is "
        "a turn pocket or a driveway", ge=0, le=200,
    )  # fmt: skip
    entry_gap_s: float = _param(
        1.0, "s", "no vehicle enters at the map's edge less than this ahead of another inserted one", ge=0, le=5
    )
    slow_leader_min: float = _param(
        0.5, "share", "desired speed of an added leader over the usual one of its lane, uniform from here", gt=0, le=1
    )
    slow_leader_max: float = _param(0.7, "share", "to here", gt=0, le=1)
    slow_leader_mps: float = _param(3.0, "m/s", "slowest desired speed of an added leader", gt=0, le=20)
    overtake_ways: int = _param(
        120, "routes", "on which a place is looked for, for an overtake in a round", ge=1, le=10_000
    )
    overtake_draws: int = _param(120, "places", "with an added leader that are drawn on each", ge=1, le=10_000)
    overtake_tries: int = _param(6, "places", "rolled out for an overtake in a round, at most", ge=1, le=1000)
    overtake_gap_s: tuple[Annotated[float, Field(ge=0, le=20)], Annotated[float, Field(ge=0, le=20)]] = _param(
        (1.0, 4.0), "s", "of the speed difference, from the leader at the start, beyond the gap at standstill"
    )

    @model_validator(mode="after")
    def _check(self) -> "Sites":
        if self.slow_leader_max < self.slow_leader_min:
            raise ValueError(f"slow_leader_max {self.slow_leader_max} is below slow_leader_min {self.slow_leader_min}")
        return self


class Drivers(_Section):
    """How people drive: what each inserted vehicle's driver is drawn from."""

    desired_sd: float = _param(0.12, "share", "SD of the desired speed around that of the lane's traffic", ge=0, le=0.5)
    wander_sd_mps: float = _param(
        0.7,
        "m/s",
        "SD of the slow wandering of the desired speed (Ornstein-Uhlenbeck): a = 0.25 to 0.4 m/s2",
        ge=0,
        le=3,
    )
    wander_time_s: float = _param(3.0, "s", "correlation time of that wandering", gt=0, le=30)
    tau_mean_s: float = _param(1.15, "s", "time gap; usual 0.9 to 1.5", ge=0.5, le=4)
    tau_sd_s: float = _param(0.25, "s", "its SD between drivers", ge=0, le=2)
    accel_mean_mps2: float = _param(
        1.85,
        "m/s2",
        "acceleration from standstill; 95 % of recorded accelerations are below 1.45, of inserted vehicles' below 1.20",
        gt=0,
        le=2.4,
    )
    accel_sd_mps2: float = _param(0.35, "m/s2", "its SD between drivers", ge=0, le=1)
    decel_mean_mps2: float = _param(2.2, "m/s2", "comfortable deceleration", gt=0, le=4.05)
    decel_sd_mps2: float = _param(0.35, "m/s2", "its SD between drivers", ge=0, le=1)
    min_gap_mean_m: float = _param(2.2, "m", "gap kept to a standing leader (SUMO minGap)", ge=0.5, le=10)
    min_gap_sd_m: float = _param(0.4, "m", "its SD between drivers", ge=0, le=3)
    turn_lateral_min_mps2: float = _param(
        1.5, "m/s2", "lateral acceleration taken in turns, uniform from here", gt=0, le=4.89
    )
    turn_lateral_max_mps2: float = _param(3.0, "m/s2", "to here (comfort ends at 3)", gt=0, le=4.89)
    offset_mean_m: float = _param(
        0.1,
        "m",
        "mean place in the lane, left positive: away from the kerb and parked cars; measured: 0.10",
        ge=-1,
        le=1,
    )
    offset_sd_m: float = _param(
        0.39, "m", "SD between vehicles of the mean place in the lane; measured, robust: 0.39", ge=0, le=1
    )
    offset_lane_share: float = _param(
        0.85, "share", "of its variance that is the lane's: where recorded vehicles drive, they tell it; measured: on "
        "one lane 0.24 m, wandering included", ge=0, le=1,
    )  # fmt: skip
    offset_max_m: float = _param(0.9, "m", "no driver is farther from the lane's middle", ge=0, le=1.5)
    lateral_wander_sd_m: float = _param(
        0.33,
        "m",
        "SD of the wandering about that place, of the median driver; measured (hid2 calibrate): 0.24 to 0.46",
        ge=0,
        le=0.5,
    )
    lateral_wander_spread: float = _param(
        0.8, "-", "SD between drivers of its logarithm: some hold the lane, some weave; measured", ge=0, le=1.5
    )
    lateral_wander_time_s: float = _param(
        2.2, "s", "its correlation time at the desired speed; measured (hid2 calibrate): 1.5 to 3.4", gt=0, le=30
    )
    lane_change_mean_s: float = _param(
        5.0,
        "s",
        "duration of a lane change, between the moments at which |d'| passes .1 m/s; as recorded",
        ge=1.5,
        le=15,
    )
    lane_change_sd_s: float = _param(0.9, "s", "its SD between drivers", ge=0, le=4)
    reaction_s: float = _param(0.5, "s", "EIDM treaction", ge=0.1, le=3)
    error: float = _param(0.1, "-", "EIDM sigmaerror, driving error", ge=0, le=1)
    truncated_at: float = _param(2.0, "SD", "draws are cut off so far from the mean", gt=0, le=6)
    eased_s: float = _param(0.8, "s", "the wandering of the speed is eased over this: feet do not jump", gt=0, le=10)
    offset_spacing_m: float = _param(
        6.0, "m", "between two places in the lane at the least: a car is not a bicycle", gt=1, le=100
    )


class LaneChange(_Section):
    """Paper, Lane Change; Algorithm 1 lines 3 to 5."""

    time_gap_front_s: float = _param(0.6, "s", "gap to the new leader over the own speed", ge=0, le=5)
    time_gap_rear_s: float = _param(0.8, "s", "gap to the new follower over its speed", ge=0, le=5)
    min_gap_m: float = _param(2.5, "m", "smallest bumper gap to both", ge=0, le=50)
    braking_mps2: float = _param(2.0, "m/s2", "deceleration that the follower in a pair may need", gt=0, le=9)
    min_remaining_m: float = _param(25.0, "m", "length of l' left, through its successors", ge=0, le=500)
    give_up_s: float = _param(6.0, "s", "from the trigger on, the request ends after this", ge=0, le=60)
    min_duration_s: float = _param(
        3.7,
        "s",
        "shortest lane change, as lane_change_mean_s: no driver crosses a lane faster than 1.3 m/s",
        ge=1.5,
        le=10,
    )
    max_duration_s: float = _param(
        6.0, "s", "longest lane change that a driver wants; driven ones end up to half a second later", ge=1.5, le=15
    )
    ramp_share: float = _param(
        0.27, "share", "of its time, in which the lateral speed rises, and falls: recorded ones peak at .87 m/s", gt=0,
        le=0.5,
    )  # fmt: skip
    heading_deg: float = _param(
        9.5, "deg", "to the lane at most, so that slow vehicles take longer; smoothing adds half a degree", gt=0, le=45
    )
    min_speed_mps: float = _param(2.0, "m/s", "slower vehicles cannot shift a lane in time", ge=0, le=20)
    rule: Literal["paper", "MOBIL", "LC2013"] | Annotated[str, Field(pattern=_FUNCTION)] = _param(
        "paper", "-", "what decides whether a gap is taken; module:function names one of your own"
    )
    rule_with: Annotated[str, Field(pattern=_ARGUMENTS)] = _param(
        "", "-", "arguments of a rule of your own, as 'b=1.0, lead=0.5'; a study varies them as rule.b"
    )
    safety: Literal["sumo", "guard", "rule"] = _param(
        "sumo", "-",
        "what may refuse a gap that the rule takes: sumo: the guard and SUMO's gap check; guard: the guard alone; "
        "rule: neither, and what is unsafe is an outcome, in studies alone",
    )  # fmt: skip
    mobil_politeness: float = _param(0.3, "-", "MOBIL p (Kesting et al. 2007: 0 to 1)", ge=0, le=2)
    mobil_threshold_mps2: float = _param(0.1, "m/s2", "MOBIL, advantage that is worth a change", ge=0, le=5)
    mobil_bias_mps2: float = _param(0.3, "m/s2", "MOBIL, bias towards the lane that is asked for", ge=0, le=10)
    mobil_safe_mps2: float = _param(4.0, "m/s2", "MOBIL b_safe, hardest braking left to the new follower", gt=0, le=9)
    lc_strategic: float = _param(1.0, "-", "LC2013 lcStrategic; SUMO's default", ge=0, le=100)
    lc_cooperative: float = _param(1.0, "-", "LC2013 lcCooperative; SUMO's default", ge=0, le=1)
    lc_speed_gain: float = _param(1.0, "-", "LC2013 lcSpeedGain; SUMO's default", ge=0, le=1000)
    look_back_m: float = _param(
        50.0, "m", "length of lanes before l', where vehicles from behind are seen", ge=0, le=300
    )
    max_shift_m: float = _param(5.5, "m", "middles of lanes farther apart are not side by side", gt=0, le=20)
    time_share: float = _param(0.95, "share", "of the time left that the lateral motion may take", gt=0, le=1)
    spare_s: float = _param(0.5, "s", "of that time, left after the lateral motion", ge=0, le=5)
    length_share: float = _param(0.8, "share", "of the length of l' left that the lateral motion may take", gt=0, le=1)

    @model_validator(mode="after")
    def _check(self) -> "LaneChange":
        if self.max_duration_s < self.min_duration_s:
            raise ValueError(f"max_duration_s {self.max_duration_s} is below min_duration_s {self.min_duration_s}")
        return self


class Overtake(_Section):
    """Paper, Overtaking; Algorithm 1 lines 6 to 11."""

    d_obs_m: float = _param(40.0, "m", "d_obs, the observation horizon", ge=4, le=200)
    d_overtake_m: float = _param(40.0, "m", "d_overtake, length of the free corridor m * delta s", ge=8, le=300)
    speed_advantage_mps: float = _param(1.5, "m/s", "the leader is slower than the desired speed by this", ge=0, le=20)
    safe_front_m: float = _param(6.0, "m", "delta d_safe^front", ge=0, le=100)
    safe_rear_m: float = _param(8.0, "m", "delta d_safe^rear", ge=0, le=100)
    return_gap_m: float = _param(5.0, "m", "bumper gap ahead of the passed vehicle before the return", ge=1, le=50)
    parked_mps: float = _param(0.5, "m/s", "a slower leader is an obstacle, not an overtaken vehicle", ge=0, le=5)
    shift_ratio: float = _param(
        0.68, "ratio", "duration of its lane changes over usual ones, the shortest too", gt=0, le=2
    )


class Turn(_Section):
    """Paper, Straight, Left Turn and Right Turn."""

    left_trough: float = _param(0.65, "ratio", "min of f_left(alpha)", gt=0, le=1)
    right_trough: float = _param(0.75, "ratio", "min of f_right(alpha), above left_trough", gt=0, le=1)
    trough_at: float = _param(0.4, "share", "alpha of the trough, early to mid-turn", ge=0.1, le=0.9)
    lateral_accel_mps2: float = _param(
        1.8, "m/s2", "speed cap sqrt(a_y / kappa) on the lane; what drivers take, comfort ends at 3", gt=0, le=4.89
    )
    approach_decel_mps2: float = _param(1.5, "m/s2", "slowing before the entrance", gt=0, le=4)

    @model_validator(mode="after")
    def _check(self) -> "Turn":
        if self.right_trough <= self.left_trough:
            raise ValueError(
                f"right_trough {self.right_trough} must be above left_trough {self.left_trough} (f_right > f_left)"
            )
        return self


class Conflict(_Section):
    """The three cases of conflict resolution, and what is exported at all."""

    horizon_s: float = _param(5.0, "s", "H delta: how far ahead conflicts are looked for", gt=0, le=10)
    act_mps2: float = _param(
        1.1, "m/s2", "deceleration that a conflict must ask for before the timing is changed", ge=0, le=4
    )
    brake_max_mps2: float = _param(3.5, "m/s2", "hardest braking for a conflict", gt=0, le=4.05)
    brakes_mps2: tuple[Annotated[float, Field(ge=0, le=9)], ...] = _param(
        (0.0, 0.5, 0.8, 1.1, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0),
        "m/s2",
        "decelerations tried, from 0 on and least first, up to brake_max_mps2",
        min_length=1,
    )
    predicted_jerk_mps3: float = _param(4.0, "m/s3", "predicted braking builds up at this rate", gt=0, le=20)
    braking_lasts_s: float = _param(
        1.0, "s", "a generated vehicle that brakes is predicted to brake on so long", ge=0, le=10
    )
    hardest_ratio: float = _param(
        1.4, "ratio", "hardest braking for an agent that appears ahead, over the driver's deceleration", ge=1, le=5
    )
    stride: int = _param(2, "steps", "between two looks at the predicted motion", ge=1, le=10)
    margin_lateral_m: float = _param(0.1, "m", "added to each side of a box", ge=0, le=2)
    margin_front_m: float = _param(1.0, "m", "kept to a box that crosses or stands ahead", ge=0, le=10)
    stop_margin_m: float = _param(1.0, "m", "kept to a stop line", ge=0, le=10)
    ttc_min_s: float = _param(1.5, "s", "critical TTC (SSAM)", ge=0, le=5)
    follower_ttc_min_s: float = _param(
        1.5, "s", "TTC kept to recorded vehicles behind, which do not brake for inserted ones", ge=0, le=10
    )
    pet_min_s: float = _param(1.0, "s", "critical PET, kept to all agents on crossing paths", ge=0, le=5)
    end_horizon_s: float = _param(3.0, "s", "beyond its last step a vehicle is looked at so long", ge=0, le=10)
    end_ttc_min_s: float = _param(
        1.0, "s", "smallest TTC at the last step, all agents at constant velocity", ge=0, le=5
    )

    @model_validator(mode="after")
    def _check(self) -> "Conflict":
        if self.brakes_mps2[0] != 0 or list(self.brakes_mps2) != sorted(self.brakes_mps2):
            raise ValueError(f"brakes_mps2 {list(self.brakes_mps2)} does not rise from 0")
        return self


class Signals(_Section):
    """Red and green inferred from recorded traffic; the signals themselves are not in the data."""

    before_s: float = _param(2.0, "s", "red so long before recorded traffic crosses", ge=0, le=10)
    after_s: float = _param(3.0, "s", "red so long after recorded traffic has crossed", ge=0, le=20)
    queue_m: float = _param(20.0, "m", "a queue that stands within this of the entrance makes it red", ge=0, le=100)
    beyond_m: float = _param(3.0, "m", "centres so far beyond the entrance still stand in the queue", ge=0, le=10)
    standing_mps: float = _param(0.5, "m/s", "slower recorded vehicles stand", gt=0, le=3)
    flow_mps: float = _param(1.0, "m/s", "faster recorded vehicles are cross traffic", ge=0, le=10)
    parked_m: float = _param(5.0, "m", "an agent that moves less over the scene may be parked", gt=0, le=50)
    crossing_deg: float = _param(40.0, "deg", "smaller angles between two ways are merges, not crossings", gt=0, lt=90)
    entry_before_s: float = _param(1.0, "s", "green so long before a recorded vehicle enters", ge=0, le=10)
    entry_after_s: float = _param(2.0, "s", "green so long after one has entered", ge=0, le=10)
    beside_m: float = _param(0.5, "m", "a centre so far beside a lane's edge is still on the lane", ge=0, le=3)
    alike_m: float = _param(
        0.3,
        "m",
        "a vehicle that enters follows the lane nearest on average, and any farther by at most this",
        ge=0,
        le=3,
    )
    crossing_s: float = _param(
        1.0, "s", "no entry makes it green this close to cross traffic (critical PET)", ge=0, le=5
    )


class Crossings(_Section):
    """Pedestrians on or at the map's pedestrian crossings."""

    near_m: float = _param(1.0, "m", "an agent this near that moves towards the crossing counts", ge=0, le=5)
    towards_mps: float = _param(0.3, "m/s", "slower approach to the crossing is standing beside it", ge=0, le=3)
    directed_mps: float = _param(0.5, "m/s", "slower agents have no direction of motion", ge=0, le=3)
    ahead_s: float = _param(1.5, "s", "an agent that is on the crossing within this time counts", ge=0, le=10)
    strip_m: float = _param(
        1.0, "m", "to each side of the swept width, where no agent may be while a vehicle passes", ge=0, le=5
    )
    strip_s: float = _param(3.0, "s", "only agents on that strip within this time hold a vehicle up", ge=0, le=20)
    along_deg: float = _param(
        40.0, "deg", "an agent that moves along the path within this angle does not cross it", gt=0, lt=90
    )


class Driving(_Section):
    """What is added to SUMO's car following, which is blind to crossing agents. Chosen on the scenes of tests/real."""

    replay: Literal["fixed", "reactive"] = _param(
        "fixed", "-", "reactive: recorded vehicles yield in time on their recorded path; for studies and planner tests"
    )
    check_replay: bool = _option(
        False, "-", "Replay every recorded agent and measure its pose in SUMO, not only those near inserted ones", "",
        shown="",
    )  # fmt: skip
    yields_mps2: float = _param(
        4.5, "m/s2", "reactive: a follower that would have to brake harder is not expected to yield; SUMO's decel",
        ge=0, le=9,
    )  # fmt: skip
    yields_ahead_m: float = _param(80.0, "m", "reactive: leaders farther away are not followed", gt=0, le=300)
    standing_mps: float = _param(0.5, "m/s", "slower agents stand: SUMO is shown them in any direction", ge=0, le=3)
    leads_from_m: float = _param(0.3, "m", "an agent ahead leads from this gap on; nearer it is beside", ge=0, le=5)
    shown_m: float = _param(120.0, "m", "SUMO is shown agents up to here ahead of a vehicle", ge=20, le=500)
    soon_s: float = _param(
        2.5, "s", "no braking yet for a conflict later than this, unless it asks for hard braking", ge=0, le=10
    )
    urgent_ratio: float = _param(3.0, "ratio", "hard braking over conflict.act_mps2", ge=1, le=10)
    reroute_over_mps: float = _param(
        0.05,
        "m/s",
        "over the speed of the road on another way, with which it is still taken (conflict case 3)",
        ge=0,
        le=10,
    )
    keep_yielding_mps2: float = _param(
        0.3, "m/s2", "a vehicle that yields goes on while a conflict asks for this", ge=0, le=4
    )
    brake_jerk_mps3: float = _param(3.5, "m/s3", "braking for what SUMO does not see builds up so", gt=0, le=20)
    last_brake_mps2: float = _param(0.6, "m/s2", "hardest braking just before standing still", gt=0, le=4)
    last_brake_per_s: float = _param(1.8, "1/s", "and so much harder by the speed", ge=0, le=20)
    stop_ahead_m: float = _param(60.0, "m", "closed stop lines farther ahead matter to no driver yet", ge=5, le=500)
    stop_share: float = _param(0.6, "share", "of its deceleration, with which a driver rolls up to a line", gt=0, le=1)
    stop_takes_s: float = _param(0.5, "s", "in which it takes up the speed for that", gt=0, le=5)
    stop_hardest_ratio: float = _param(
        1.3, "ratio", "over its deceleration: a vehicle that had to brake harder crosses, as at amber", ge=1, le=5
    )
    across_s: float = _param(8.0, "s", "agents from behind on the way across are looked for so far ahead", gt=0, le=15)
    let_pass_mps2: float = _param(
        0.7, "m/s2", "a vehicle that waits for a gap slows down so for those beside", ge=0, le=4
    )
    let_pass_share: float = _param(0.8, "share", "of the desired speed, to which that goes", ge=0, le=1)
    slows_mps2: float = _param(
        0.7, "m/s2", "a vehicle that slows down more behind a near one has waited for it", ge=0, le=4
    )
    behind_ratio: float = _param(2.0, "ratio", "near: the gap over that of time gap and jam gap", ge=0, le=10)


class CarFollowing(_Section):
    """SUMO's car following of the inserted vehicles."""

    model: Literal["EIDM", "IDM", "Krauss"] = _param("EIDM", "-", "SUMO's carFollowModel")
    jerk_mps3: float = _param(3.0, "m/s3", "EIDM jerkmax", gt=0, le=10)


class Flow(_Section):
    """Traffic that enters at the edges of the map while the scene runs: in studies (`hid2 study`)."""

    veh_per_h_lane: float = _param(0.0, "veh/h", "flow on each lane that begins at the map's edge", ge=0, le=3000)
    min_headway_s: float = _param(
        1.2, "s", "headways are exponential beyond this (shifted exponential, Cowan's M2)", ge=0, le=10
    )
    warm_up_s: float = _param(30.0, "s", "requests before this are not counted", ge=0, le=3600)

    @property
    def counted_from_s(self) -> float:
        """From when on traffic counts, s: where none enters, from the first step."""
        return self.warm_up_s if self.veh_per_h_lane > 0.0 else 0.0


class Limits(_Section):
    """Limits of motion of every exported step (nuPlan's comfort bounds; R_min and a_y,max of the paper)."""

    accel_max_mps2: float = _param(2.40, "m/s2", "nuPlan", gt=0, le=6)
    accel_min_mps2: float = _param(-4.05, "m/s2", "nuPlan", ge=-10, lt=0)
    lateral_accel_mps2: float = _param(4.89, "m/s2", "nuPlan; a_y,max", gt=0, le=8)
    yaw_rate_radps: float = _param(0.95, "rad/s", "nuPlan", gt=0, le=2)
    yaw_accel_radps2: float = _param(1.93, "rad/s2", "nuPlan", gt=0, le=5)
    longitudinal_jerk_mps3: float = _param(4.13, "m/s3", "nuPlan", gt=0, le=20)
    jerk_mps3: float = _param(8.37, "m/s3", "nuPlan", gt=0, le=30)
    min_radius_m: float = _param(5.0, "m", "R_min", gt=1, le=20)
    drivable_tolerance_m: float = _param(0.3, "m", "nuPlan", ge=0, le=2)


class Smoothing(_Section):
    """Frenet smoothing: s(t), d(t) piecewise cubics."""

    path_step_m: float = _param(1.0, "m", "spacing of the reference line's points", gt=0.1, le=4)
    max_offset_m: float = _param(
        0.9, "m", "the smoothed reference line stays this close to the centrelines", ge=0, le=2
    )
    filter_s: float = _param(
        0.3, "s", "standard deviation of the Gaussian that takes SUMO's steps out of the speed", gt=0, le=2
    )


Band = tuple[float, float]


class Event(_Section):
    """One kind of event that is asked for in a scene: `[[event]]` in TOML, `--event` on the command line.

    Bands are (least, largest), None: `at_band_s`, `gap_band_m`, `difference_band_mps`. gap_m of kind cross: from the
    target's bumper to the conflict point; ttc_s, pet_s, drac_mps2: criticality, None: what the critical values of
    `conflict` allow.
    """

    kind: Literal["cut_in", "overtake", "lead", "follow", "merge", "cross"]
    target: str = _option(
        "av", "-", "The agent that it happens to", "av|focal|any|TRACK_ID", min_length=1, max_length=100
    )
    at_s: Band | None = _option(
        None, "s", "When, in seconds, half a second more or less: the moment of crossing into the target's lane (of an "
        "overtake, on the way back), of coming onto the common lane, or of passing the conflict point", "S|S:S",
        shown="2:7, overtake 4:10",
    )  # fmt: skip
    gap_m: Band | None = _option(
        None, "m", "Bumper to bumper at that moment, in metres", "A:B", shown="4:30, cross 0:100"
    )
    speed_difference_mps: Band | None = _option(
        None, "m/s", "Own speed minus the target's at that moment, in m/s", "A:B", shown="-6:6, cross any"
    )
    brakes_mps2: float = _option(
        0.0, "m/s2", "A leader brakes so hard from that moment on, in m/s2", "MPS2", shown="", ge=0, le=4.05
    )
    ttc_s: Band | None = None
    pet_s: Band | None = None
    drac_mps2: Band | None = None
    count: int = _option(1, "events", "Events of each kind in a scene", "N", ge=1, le=20)

    @property
    def at_band_s(self) -> Band:
        """Time asked for; where none is, what is usual for the kind: out, past and back take 5 s and more."""
        return self.at_s or ((4.0, 10.0) if self.kind == "overtake" else (2.0, 7.0))

    @property
    def gap_band_m(self) -> Band:
        """Gap asked for; where none is, what is usual for the kind."""
        return self.gap_m or ((0.0, 100.0) if self.kind == "cross" else (4.0, 30.0))

    @property
    def difference_band_mps(self) -> Band:
        """Speed difference asked for; where none is, what is usual for the kind: ways that cross are apart in speed."""
        return self.speed_difference_mps or ((-40.0, 40.0) if self.kind == "cross" else (-6.0, 6.0))

    @field_validator("at_s", "gap_m", "speed_difference_mps", "ttc_s", "pet_s", "drac_mps2", mode="before")
    @classmethod
    def _band(cls, value: Any) -> Any:  # noqa: ANN401
        """A band may be given as a list, which is what JSON and TOML have, a moment as one number."""
        if isinstance(value, int | float) and not isinstance(value, bool):
            return float(value), float(value)
        return tuple(value) if isinstance(value, list) else value

    @model_validator(mode="after")
    def _check(self) -> "Event":
        for name in ("at_s", "gap_m", "speed_difference_mps", "ttc_s", "pet_s", "drac_mps2"):
            band = getattr(self, name)
            if band is not None and band[1] < band[0]:
                raise ValueError(f"{name} {band[0]:g}:{band[1]:g}, expected the smaller value first")
            if band is not None and name != "at_s" and band[0] == band[1]:  # a moment has moment_s to both sides
                raise ValueError(f"{name} {band[0]:g}, expected a band of two values: nothing driven meets one exactly")
            if band is not None and name != "speed_difference_mps" and band[0] < 0:
                raise ValueError(f"{name} {band[0]:g}:{band[1]:g}, expected values of 0 or more")
        if self.brakes_mps2 and self.kind != "lead":
            raise ValueError(f"brakes_mps2 {self.brakes_mps2:g} with kind {self.kind}, expected kind lead")
        if self.pet_s is not None and self.kind != "cross":
            raise ValueError(f"pet_s with kind {self.kind}, expected kind cross: only crossing paths have a PET")
        return self


class EventSearch(_Section):
    """The search for a vehicle that brings an event about."""

    candidates: int = _param(1500, "vehicles", "rolled out for one event before it is given up", ge=1, le=100_000)
    tries: int = _param(10, "vehicles", "driven for one event before it is given up", ge=1, le=200)
    moment_s: float = _param(0.5, "s", "an event counts so much before or after the time asked for", ge=0, le=5)
    cut_in_gap_s: float = _param(0.3, "s", "lane_change.time_gap_front_s of a cut-in", ge=0, le=5)
    brakes_s: float = _param(2.5, "s", "braking that is asked for lasts so long", ge=0, le=10)
    brakes_share: float = _param(
        0.8,
        "share",
        "of the braking asked for is seen at the least: jerk is bounded, and positions smoothed",
        ge=0,
        le=1,
    )


class Export(_Section):
    """The last word on what is exported at all."""

    filter_ratios: tuple[Annotated[float, Field(gt=0, le=10)], ...] = _param(
        (1.0, 1.6, 2.5), "ratio", "widths of the filter tried in turn, over smoothing.filter_s", min_length=1
    )
    offset_shares: tuple[Annotated[float, Field(ge=0, le=1)], ...] = _param(
        (1.0, 0.5, 0.0), "share", "of the driver's place in the lane, tried in turn", min_length=1
    )
    moves_m: float = _param(2.0, "m", "an agent that moves less stands throughout", ge=0, le=50)
    box_margin_m: float = _param(0.05, "m", "between boxes, so that readers' rounding makes none meet", ge=0, le=1)
    limit_share: float = _param(0.98, "share", "of the curvature 1 / R_min that a path may have", gt=0, le=1)
    drivable_share: float = _param(0.9, "share", "of limits.drivable_tolerance_m that is used", ge=0, le=1)
    end_spare_s: float = _param(0.1, "s", "above conflict.end_ttc_min_s, for the rounding of files", ge=0, le=2)
    noise: Literal["none", "tracker"] = _param(
        "none",
        "-",
        "of inserted tracks; tracker: as the scene's recorded vehicles have it, with clean states in the sidecar",
    )


class Config(_Section):
    """A whole request: what to generate and every parameter of the method."""

    request: Request = Request()
    source: Source = Source()
    grid: Grid = Grid()
    spawn: Spawn = Spawn()
    sites: Sites = Sites()
    drivers: Drivers = Drivers()
    driving: Driving = Driving()
    car_following: CarFollowing = CarFollowing()
    lane_change: LaneChange = LaneChange()
    overtake: Overtake = Overtake()
    turn: Turn = Turn()
    conflict: Conflict = Conflict()
    signals: Signals = Signals()
    crossings: Crossings = Crossings()
    flow: Flow = Flow()
    limits: Limits = Limits()
    smoothing: Smoothing = Smoothing()
    event_search: EventSearch = EventSearch()
    export: Export = Export()

    event: tuple[Event, ...] = Field(
        default=(),
        json_schema_extra={"unit": "-", "source": "events, a section [[event]] each; see hid2 generate --event"},
    )
    without: frozenset[Literal["topology", "collision", "smoothing"]] = Field(
        default=frozenset(),
        json_schema_extra={"unit": "-", "source": "paper, Table ablation: components switched off"},
    )


class Forecasting(_Section):
    """The forecasting experiment (`bridge/forecasting`). No part of `Config`: no scene depends on it."""

    place_cell_m: float = _param(
        50.0, "m", "scenes with lanes through the same square of this size overlap", gt=1, le=500
    )
    block_m: float = _param(1000.0, "m", "scenes with maps centred in one square of this size are split as one", gt=1)
    density_bounds: tuple[int, ...] = _param(
        (30, 50, 70, 90), "tracks", "strata of density; paper's bands and one below"
    )
    resamples: int = _param(4000, "-", "draws of the bootstrap over scenes and seeds", ge=100, le=100_000)
    variants: int = _param(
        8, "scenes", "scenes generated of each recorded one in `hid2 paper prediction`", ge=1, le=1000
    )
    val_share: float = _param(0.3, "share", "scenes kept for validation in `hid2 paper prediction`", gt=0, lt=1)
    updates: int = _param(300, "-", "updates of a training, the same for every composition", ge=1)
