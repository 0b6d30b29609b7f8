"""Every tunable of the method: default, unit, range and source, in one typed, frozen tree.

`Config` is what a request resolves to; it goes into the sidecar as it is. The paper's symbol or the source of a
number is written beside it.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from hid2.agents import Policy


def _param(default: Any, unit: str, source: str, **bounds: Any) -> Any:  # noqa: ANN401
    return Field(default=default, json_schema_extra={"unit": unit, "source": source}, **bounds)


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Request(_Section):
    """What the user asks for in a scene."""

    agents: Annotated[int, Field(ge=0, le=500)] | Literal["max"] = _param(
        10, "vehicles", "paper, Diversity: 10 added to each scene; max fills every admissible cell"
    )
    straight: float = _param(0.6, "share", "policy mix; shares are divided by their sum", ge=0, le=1)
    left_turn: float = _param(0.1, "share", "policy mix", ge=0, le=1)
    right_turn: float = _param(0.1, "share", "policy mix", ge=0, le=1)
    lane_change: float = _param(0.15, "share", "policy mix", ge=0, le=1)
    overtake: float = _param(0.05, "share", "policy mix", ge=0, le=1)
    trigger_min_s: float = _param(0.5, "s", "t_trigger, uniform from here", ge=0, le=60)
    trigger_max_s: float = _param(4.0, "s", "t_trigger, uniform to here (equal to trigger_min_s: fixed)", ge=0, le=60)
    focal: Literal["recorded", "generated"] = _param("recorded", "-", "which track carries category 3")
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
    min_speed_mps: float = _param(3.0, "m/s", "slowest spawn speed drawn", ge=0, le=40)
    max_speed_mps: float = _param(20.0, "m/s", "fastest desired speed drawn", gt=0, le=50)
    speed_noise: float = _param(0.1, "share", "standard deviation of the desired speed", ge=0, le=0.5)
    clear_ahead_s: float = _param(
        1.5, "s", "time gap to a slower vehicle ahead at spawn (usual 0.9 to 1.5)", gt=0, le=10
    )
    clear_gap_m: float = _param(3.0, "m", "smallest bumper gap at spawn", ge=0.5, le=50)
    rounds: int = _param(6, "rounds", "simulations run to reach the requested count", ge=1, le=50)
    reseed_rounds: int = _param(
        2, "rounds", "a manoeuvre that did not come about is given to another vehicle elsewhere so often", ge=0, le=20
    )
    spare_share: float = _param(
        0.1, "share", "vehicles planned beyond the count, in case some cannot be made safe", ge=0, le=1
    )


class Packing(_Section):
    """Closer gaps for a road that did not take the count asked for; TTC to leaders and boxes are held as always."""

    attempts: int = _param(
        4,
        "attempts",
        "times a road is packed, the fullest is kept; eight times as often where only a few are missing; 0: never",
        ge=0,
        le=100,
    )
    clear_gap_m: float = _param(2.0, "m", "spawn.clear_gap_m where the road is packed", ge=0.5, le=50)
    clear_ahead_s: float = _param(1.0, "s", "spawn.clear_ahead_s there", gt=0, le=10)
    follow_time_s: float = _param(0.7, "s", "conflict.follow_time_s there", ge=0, le=5)
    margin_lateral_m: float = _param(0.15, "m", "conflict.margin_lateral_m there", ge=0, le=2)
    margin_front_m: float = _param(0.7, "m", "conflict.margin_front_m there", ge=0, le=10)
    follower_ttc_min_s: float = _param(0.0, "s", "conflict.follower_ttc_min_s there", ge=0, le=10)


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
    lateral_accel_mps2: float = _param(1.0, "m/s2", "peak lateral acceleration sought in a change", gt=0, le=4)
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
    """The three cases of conflict resolution. The horizon H delta is the rest of the scene: all futures are known."""

    margin_lateral_m: float = _param(0.25, "m", "added to each side of a box", ge=0, le=2)
    margin_front_m: float = _param(1.0, "m", "kept to a box that crosses or stands ahead", ge=0, le=10)
    follow_time_s: float = _param(1.0, "s", "smallest time gap to a leader in the last check", ge=0, le=5)
    ttc_min_s: float = _param(1.5, "s", "critical TTC (SSAM)", ge=0, le=5)
    follower_ttc_min_s: float = _param(
        1.5, "s", "TTC kept to recorded vehicles behind, which do not brake for anybody inserted", ge=0, le=10
    )
    pet_min_s: float = _param(1.0, "s", "critical PET, kept to everybody whose path is crossed", ge=0, le=5)


class CarFollowing(_Section):
    """SUMO's car following of the inserted vehicles (sigma is 0: the paper keeps v(t + dt) near v(t))."""

    accel_mps2: float = _param(1.8, "m/s2", "SUMO accel", gt=0, le=2.4)
    decel_mps2: float = _param(2.5, "m/s2", "SUMO decel", gt=0, le=4.05)
    tau_s: float = _param(
        1.0, "s", "SUMO tau; within the usual time gaps 0.9 to 1.5, the plan keeps the critical TTC", ge=0.5, le=4
    )
    min_gap_m: float = _param(1.5, "m", "SUMO minGap", ge=0.5, le=10)


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
    jerk_weight: float = _param(
        1.0, "m2 / (m/s3)2", "weight of jerk against distance to the driven s(t)", gt=0, le=1000
    )


class Config(_Section):
    """A whole request: what to generate and every parameter of the method."""

    request: Request = Request()
    grid: Grid = Grid()
    spawn: Spawn = Spawn()
    packing: Packing = Packing()
    car_following: CarFollowing = CarFollowing()
    lane_change: LaneChange = LaneChange()
    overtake: Overtake = Overtake()
    turn: Turn = Turn()
    conflict: Conflict = Conflict()
    limits: Limits = Limits()
    smoothing: Smoothing = Smoothing()

    def packed(self) -> "Config":
        """The same request with the gaps of `packing`."""
        close = self.packing
        spawn = self.spawn.model_copy(update={"clear_gap_m": close.clear_gap_m, "clear_ahead_s": close.clear_ahead_s})
        conflict = self.conflict.model_copy(
            update={
                "follow_time_s": close.follow_time_s,
                "margin_lateral_m": close.margin_lateral_m,
                "margin_front_m": close.margin_front_m,
                "follower_ttc_min_s": close.follower_ttc_min_s,
            }
        )
        return self.model_copy(update={"spawn": spawn, "conflict": conflict})

    without: frozenset[Literal["topology", "collision", "smoothing"]] = Field(
        default=frozenset(),
        json_schema_extra={"unit": "-", "source": "paper, Table ablation: components switched off"},
    )
