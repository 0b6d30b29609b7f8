"""Every tunable of the method: default, unit, range and source, in one typed, frozen tree.

`Config` is what a request resolves to; it goes into the sidecar as it is. The paper's symbol or the source of a
number is written beside it.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from hid2.policies import Policy


def _param(default: Any, unit: str, source: str, **bounds: Any) -> Any:  # noqa: ANN401
    return Field(default=default, json_schema_extra={"unit": unit, "source": source}, **bounds)


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Request(_Section):
    """What the user asks for in a scene."""

    agents: Annotated[int, Field(ge=0, le=500)] | Literal["max"] = _param(
        10, "vehicles", "paper, Diversity: 10 added to each scene; max: as many as the road takes at usual gaps"
    )
    straight: float = _param(0.6, "share", "policy mix; shares are divided by their sum", ge=0, le=1)
    left_turn: float = _param(0.1, "share", "policy mix", ge=0, le=1)
    right_turn: float = _param(0.1, "share", "policy mix", ge=0, le=1)
    lane_change: float = _param(0.15, "share", "policy mix", ge=0, le=1)
    overtake: float = _param(0.05, "share", "policy mix", ge=0, le=1)
    trigger_min_s: float = _param(0.5, "s", "t_trigger, uniform from here", ge=0, le=60)
    trigger_max_s: float = _param(4.0, "s", "t_trigger, uniform to here (equal to trigger_min_s: fixed)", ge=0, le=60)
    trigger_list_s: tuple[Annotated[float, Field(ge=0, le=60)], ...] = _param(
        (), "s", "t_trigger, one of these; used instead of the range where there are any"
    )
    sites: Literal["promising", "any"] = _param(
        "promising", "-", "start sites: those first where map and traffic allow what is asked for; any: uniformly drawn"
    )
    focal: Literal["recorded", "generated"] = _param("recorded", "-", "which track carries category 3")
    focal_radius_m: float = _param(
        50.0, "m", "a generated focal track is the one with the most neighbours within this that does its manoeuvre",
        gt=0, le=200,
    )  # fmt: skip
    generated_category: Literal[1, 2] = _param(1, "-", "category of generated tracks: 1 context, 2 scored")
    seed: int = _param(0, "-", "seed of every random choice", ge=0, le=2**31 - 1)
    variants: int = _param(1, "scenes", "scenes written for each source scene", ge=1, le=10_000)
    spawn_leaders: bool = _param(True, "-", "an overtake without a slower leader may spawn one")
    bus_share: float = _param(0.0, "share", "share of buses among generated vehicles", ge=0, le=1)
    truck_share: float = _param(0.0, "share", "share of box trucks among generated vehicles", ge=0, le=1)

    @model_validator(mode="after")
    def _check(self) -> "Request":
        if self.trigger_max_s < self.trigger_min_s:
            raise ValueError(f"trigger_max_s {self.trigger_max_s} is below trigger_min_s {self.trigger_min_s}")
        if sum(self.behaviours.values()) <= 0:
            raise ValueError("the behaviour shares sum to 0, expected at least one above 0")
        if self.bus_share + self.truck_share > 1:
            raise ValueError("bus_share + truck_share is above 1")
        return self

    @property
    def behaviours(self) -> Mapping[Policy, float]:
        """Shares by policy, as asked for."""
        return {policy: float(getattr(self, policy.value)) for policy in Policy}


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
    max_speed_mps: float = _param(20.0, "m/s", "fastest desired speed drawn", gt=0, le=50)
    speed_sd: float = _param(
        0.08, "share", "standard deviation of the start speed around the desired one", ge=0, le=0.5
    )
    clear_gap_m: float = _param(2.0, "m", "smallest bumper gap at the start", ge=0.5, le=50)
    settle_s: float = _param(
        3.0, "s", "a start holds if nobody is met so long by a vehicle that drives on and brakes as a driver would",
        ge=0, le=10,
    )  # fmt: skip
    near_m: float = _param(
        30.0,
        "m",
        "sites this near to moving recorded traffic are drawn as much more often as near_weight",
        gt=0,
        le=200,
    )
    near_weight: float = _param(4.0, "ratio", "weight of sites near moving recorded traffic", ge=1, le=100)
    rounds: int = _param(6, "rounds", "simulations run to reach the requested count", ge=1, le=50)
    reseed_rounds: int = _param(
        3, "rounds", "a manoeuvre that did not come about is given to another vehicle elsewhere so often", ge=0, le=20
    )
    spare_share: float = _param(
        0.2, "share", "vehicles driven beyond the count, in case some cannot be made safe", ge=0, le=2
    )


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
    accel_mean_mps2: float = _param(1.6, "m/s2", "acceleration from standstill", gt=0, le=2.4)
    accel_sd_mps2: float = _param(0.25, "m/s2", "its SD between drivers", ge=0, le=1)
    decel_mean_mps2: float = _param(2.2, "m/s2", "comfortable deceleration", gt=0, le=4.05)
    decel_sd_mps2: float = _param(0.35, "m/s2", "its SD between drivers", ge=0, le=1)
    min_gap_mean_m: float = _param(2.2, "m", "gap kept to a standing leader (SUMO minGap)", ge=0.5, le=10)
    min_gap_sd_m: float = _param(0.4, "m", "its SD between drivers", ge=0, le=3)
    turn_lateral_min_mps2: float = _param(
        1.5, "m/s2", "lateral acceleration taken in turns, uniform from here", gt=0, le=4.89
    )
    turn_lateral_max_mps2: float = _param(3.0, "m/s2", "to here (comfort ends at 3)", gt=0, le=4.89)
    offset_sd_m: float = _param(0.25, "m", "SD between drivers of the mean place in the lane", ge=0, le=1)
    lateral_wander_sd_m: float = _param(0.15, "m", "SD of the wandering about that place", ge=0, le=0.5)
    lateral_wander_time_s: float = _param(3.0, "s", "its correlation time at the desired speed", gt=0, le=30)
    lane_change_mean_s: float = _param(
        5.5, "s", "duration of a lane change (highD: 5.5 cars, 6.1 heavy)", ge=1.5, le=15
    )
    lane_change_sd_s: float = _param(0.9, "s", "its SD between drivers", ge=0, le=4)
    reaction_s: float = _param(0.5, "s", "EIDM treaction", ge=0.1, le=3)
    error: float = _param(0.1, "-", "EIDM sigmaerror, driving error", ge=0, le=1)


class LaneChange(_Section):
    """Paper, Lane Change; Algorithm 1 lines 3 to 5."""

    time_gap_front_s: float = _param(0.6, "s", "gap to the new leader over the own speed", ge=0, le=5)
    time_gap_rear_s: float = _param(0.8, "s", "gap to the new follower over its speed", ge=0, le=5)
    min_gap_m: float = _param(2.5, "m", "smallest bumper gap to both", ge=0, le=50)
    braking_mps2: float = _param(2.0, "m/s2", "deceleration that the follower in a pair may need", gt=0, le=9)
    min_remaining_m: float = _param(25.0, "m", "length of l' left, through its successors", ge=0, le=500)
    give_up_s: float = _param(6.0, "s", "from the trigger on, the request ends after this", ge=0, le=60)
    min_duration_s: float = _param(2.5, "s", "shortest lateral motion (11 s scenes)", ge=1.5, le=10)
    max_duration_s: float = _param(6.0, "s", "longest lateral motion", ge=1.5, le=15)
    min_speed_mps: float = _param(2.0, "m/s", "slower vehicles cannot shift a lane in time", ge=0, le=20)

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

    horizon_s: float = _param(4.0, "s", "H delta: how far ahead conflicts are looked for", gt=0, le=10)
    act_mps2: float = _param(
        1.1, "m/s2", "deceleration that a conflict must ask for before the timing is changed", ge=0, le=4
    )
    brake_max_mps2: float = _param(3.5, "m/s2", "hardest braking for a conflict", gt=0, le=4.05)
    margin_lateral_m: float = _param(0.1, "m", "added to each side of a box", ge=0, le=2)
    margin_front_m: float = _param(1.0, "m", "kept to a box that crosses or stands ahead", ge=0, le=10)
    stop_margin_m: float = _param(1.0, "m", "kept to a stop line", ge=0, le=10)
    ttc_min_s: float = _param(1.5, "s", "critical TTC (SSAM)", ge=0, le=5)
    follower_ttc_min_s: float = _param(
        1.5, "s", "TTC kept to recorded vehicles behind, which do not brake for anybody inserted", ge=0, le=10
    )
    pet_min_s: float = _param(1.0, "s", "critical PET, kept to everybody whose path is crossed", ge=0, le=5)
    end_horizon_s: float = _param(3.0, "s", "beyond its last step a vehicle is looked at so long", ge=0, le=10)
    end_ttc_min_s: float = _param(1.0, "s", "smallest TTC at the last step, everybody at constant velocity", ge=0, le=5)


class Signals(_Section):
    """Red and green inferred from recorded traffic; the signals themselves are not in the data."""

    before_s: float = _param(2.0, "s", "red so long before recorded traffic crosses", ge=0, le=10)
    after_s: float = _param(3.0, "s", "red so long after recorded traffic has crossed", ge=0, le=20)
    queue_m: float = _param(20.0, "m", "a queue that stands within this of the entrance makes it red", ge=0, le=100)
    beyond_m: float = _param(3.0, "m", "centres so far beyond the entrance still stand in the queue", ge=0, le=10)
    standing_mps: float = _param(0.5, "m/s", "slower recorded vehicles stand", gt=0, le=3)
    flow_mps: float = _param(1.0, "m/s", "faster recorded vehicles are cross traffic", ge=0, le=10)
    parked_m: float = _param(5.0, "m", "whoever moves less over the scene may be parked", gt=0, le=50)
    crossing_deg: float = _param(40.0, "deg", "smaller angles between two ways are merges, not crossings", gt=0, lt=90)
    entry_before_s: float = _param(1.0, "s", "green so long before a recorded vehicle enters", ge=0, le=10)
    entry_after_s: float = _param(2.0, "s", "green so long after one has entered", ge=0, le=10)
    crossing_s: float = _param(
        1.0, "s", "no entry makes it green this close to cross traffic (critical PET)", ge=0, le=5
    )


class Crossings(_Section):
    """Pedestrians on or at the map's pedestrian crossings."""

    near_m: float = _param(1.0, "m", "whoever is this near and moves towards the crossing counts", ge=0, le=5)
    towards_mps: float = _param(0.3, "m/s", "slower approach to the crossing is standing beside it", ge=0, le=3)
    ahead_s: float = _param(1.5, "s", "whoever is on the crossing within this time counts", ge=0, le=10)
    strip_m: float = _param(
        1.0, "m", "to each side of the swept width, where nobody may be while it is passed", ge=0, le=5
    )
    strip_s: float = _param(3.0, "s", "only who is on that strip within this time holds a vehicle up", ge=0, le=20)
    along_deg: float = _param(40.0, "deg", "who moves along the path within this angle does not cross it", gt=0, lt=90)


class CarFollowing(_Section):
    """SUMO's car following of the inserted vehicles."""

    model: Literal["EIDM", "IDM", "Krauss"] = _param("EIDM", "-", "SUMO's carFollowModel")
    jerk_mps3: float = _param(3.0, "m/s3", "EIDM jerkmax", gt=0, le=10)


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


class Config(_Section):
    """A whole request: what to generate and every parameter of the method."""

    request: Request = Request()
    grid: Grid = Grid()
    spawn: Spawn = Spawn()
    drivers: Drivers = Drivers()
    car_following: CarFollowing = CarFollowing()
    lane_change: LaneChange = LaneChange()
    overtake: Overtake = Overtake()
    turn: Turn = Turn()
    conflict: Conflict = Conflict()
    signals: Signals = Signals()
    crossings: Crossings = Crossings()
    limits: Limits = Limits()
    smoothing: Smoothing = Smoothing()

    without: frozenset[Literal["topology", "collision", "smoothing"]] = Field(
        default=frozenset(),
        json_schema_extra={"unit": "-", "source": "paper, Table ablation: components switched off"},
    )


class Forecasting(_Section):
    """The forecasting experiment (`bridge/forecasting`). No part of `Config`: no scene depends on it."""

    place_cell_m: float = _param(
        50.0, "m", "scenes whose lanes pass the same square of this size overlap", gt=1, le=500
    )
    block_m: float = _param(
        1000.0, "m", "scenes whose maps' centres are in one square of this size are split as one", gt=1
    )
    density_bounds: tuple[int, ...] = _param(
        (30, 50, 70, 90), "tracks", "strata of density; paper's bands and one below"
    )
    resamples: int = _param(4000, "-", "draws of the bootstrap over scenes and seeds", ge=100, le=100_000)
    variants: int = _param(
        8, "scenes", "scenes generated of each recorded one in `hid2 paper prediction`", ge=1, le=1000
    )
    val_share: float = _param(0.3, "share", "scenes kept for validation in `hid2 paper prediction`", gt=0, lt=1)

    agents: int = _param(48, "-", "neighbours that the forecaster sees, the nearest", ge=1, le=256)
    history_every: int = _param(5, "steps", "from one point of a history to the one before", ge=1, le=49)
    lanes: int = _param(48, "-", "lane segments that it sees, the nearest", ge=1, le=512)
    lane_points: int = _param(6, "-", "points of a lane segment", ge=2, le=50)
    radius_m: float = _param(100.0, "m", "neighbours and lanes farther away are not seen", gt=1, le=500)
    hidden: int = _param(64, "-", "width of the network; VectorNet has 64", ge=8, le=512)
    layers: int = _param(2, "-", "layers of attention between polylines", ge=1, le=8)
    heads: int = _param(4, "-", "heads of attention", ge=1, le=16)
    modes: int = _param(6, "-", "futures of a forecast; av2's challenge has 6", ge=1, le=6)
    batch: int = _param(32, "targets", "targets of an update", ge=1, le=1024)
    updates: int = _param(300, "-", "updates of a training, the same for every composition", ge=1)
    learning_rate: float = _param(1e-3, "-", "AdamW, falling to 0 as a cosine", gt=0, le=1)
    weight_decay: float = _param(1e-4, "-", "AdamW", ge=0, le=1)
    checkpoint_every: int = _param(100, "updates", "updates from one checkpoint to the next", ge=1)
