"""Every tunable of the method: default, unit, range and source, in one typed, frozen tree.

`Config` is what a request resolves to; it goes into the sidecar as it is. The paper's symbol or the source of a
number is written beside it.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PlainSerializer, field_validator, model_validator

from hid2.policies import Policy


def _param(default: Any, unit: str, source: str, **bounds: Any) -> Any:  # noqa: ANN401
    return Field(default=default, json_schema_extra={"unit": unit, "source": source}, **bounds)


def _option(default: Any, unit: str, says: str, metavar: str, **more: Any) -> Any:  # noqa: ANN401
    """A parameter that is an option of `hid2 generate` as well; shown: in place of the default, "" for none."""
    extra: dict[str, Any] = {"unit": unit, "source": says, "metavar": metavar, "shown": str(default)}
    extra |= {"shown": more.pop("shown")} if "shown" in more else {}
    return Field(default=default, json_schema_extra=extra, **more)


_FUNCTION = Field(pattern=r"^[A-Za-z_][\w.]*:[A-Za-z_]\w*$", examples=["module:function"])
_OWN = r"[A-Za-z_][\w.]*:[A-Za-z_]\w*=(0?\.[0-9]+|[01](\.0*)?)"  # module:behaviour=share
_ARGUMENT = r"[A-Za-z_]\w*=-?[0-9]+(\.[0-9]*)?(e[+-]?[0-9]{1,2})?"
#: What rules of the tool read of `lane_change.rule_with`, on roads without recorded agents.
_READ_OF_RULE_WITH = {"paper": {"incentive"}, "MOBIL": set[str](), "LC2013": {"keep_right"}}
_ARGUMENTS = Field(pattern=rf"^({_ARGUMENT}(, *{_ARGUMENT})*)?$", examples=["name=number, ..."])


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Request(_Section):
    """What the user asks for in a scene."""

    agents: Annotated[int, Field(ge=0, le=500)] | Literal["max"] = _option(
        10, "vehicles", "Vehicles to insert into each scene (paper, Diversity: 10); max: one to 25 m of lane", "N|max"
    )
    straight: float = _param(0.73, "share", "policy mix; shares are divided by their sum", ge=0, le=1)
    left_turn: float = _param(0.035, "share", "policy mix; turns as often as recorded: 0.07", ge=0, le=1)
    right_turn: float = _param(0.035, "share", "policy mix", ge=0, le=1)
    lane_change: float = _param(0.15, "share", "policy mix", ge=0, le=1)
    overtake: float = _param(0.05, "share", "policy mix", ge=0, le=1)
    own: str = _param(
        "", "-", "behaviours of your own with their shares: module:name=share, ... (bridge/generation/README.md)",
        pattern=rf"^({_OWN}(, *{_OWN})*)?$", max_length=1000, examples=["module:name=share, ... (shares from 0 to 1)"],
    )  # fmt: skip
    trigger_min_s: float = _param(0.5, "s", "t_trigger, uniform from here", ge=0, le=60)
    trigger_max_s: Annotated[float, Field(ge=0, le=60)] | None = _param(
        None, "s", "t_trigger, uniform to here (equal: fixed); none: 4 s, of a scene 36 % at most, of overtakes 14 %"
    )
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
        if len(self.behaviours) < len(Policy) + len(self.own_behaviours):
            raise ValueError(f"own = {self.own!r}: two of one name, expected a name for each")
        if sum(self.behaviours.values()) <= 0:
            raise ValueError("the behaviour shares sum to 0, expected at least one above 0")
        if self.bus_share + self.truck_share > 1:
            raise ValueError("bus_share + truck_share is above 1")
        if self.sites == "any" and self.is_near_agents:
            raise ValueError(f"near {self.near!r} with sites 'any', which draws all alike, expected sites 'promising'")
        return self

    @property
    def first_trigger_s(self) -> float:
        """Earliest trigger time that may be drawn, s."""
        return min(self.trigger_list_s, default=self.trigger_min_s)

    @property
    def behaviours(self) -> Mapping[Policy, float]:
        """Shares by policy, as asked for; those of a user's own come last."""
        shares = {policy: float(getattr(self, policy.value)) for policy in Policy}
        return shares | {Policy(name.partition(":")[2]): share for name, share in self.own_behaviours.items()}

    @property
    def own_behaviours(self) -> Mapping[str, float]:
        """Shares of behaviours of a user's own, by "module:name"."""
        parts = (part.strip().partition("=") for part in self.own.split(",") if part)
        return {name: float(share) for name, _, share in parts}

    @property
    def is_near_agents(self) -> bool:
        """Whether vehicles are to be near to agents that are named, not to traffic or anywhere."""
        return self.near not in ("traffic", "anywhere")


class SourceChecks(_Section):
    """What is asked of a recording before anything is driven in it."""

    plausible: bool = _param(
        True, "-", "refuse recordings with tracks that fit neither their map nor their own velocities and headings"
    )


class Grid(_Section):
    """Lane gridification."""

    cell_m: float = _param(4.0, "m", "delta s, paper eq. N_l = ceil(L_l / 4.0)", ge=1, le=20)


class Spawn(_Section):
    """Insertion into free cells."""

    prior_speed_mps: float = _param(9.0, "m/s", "speed of traffic where the scene has none; AV2's median", ge=1, le=40)
    min_speed_mps: float = _param(5.5, "m/s", "slowest desired speed drawn; none recorded is below 5", ge=0, le=40)
    max_speed_mps: float = _param(20.0, "m/s", "fastest desired speed drawn; above 20, lanes' limit too", ge=1, le=50)
    rounds: int = _param(12, "rounds", "simulations run to reach the requested count", ge=1, le=50)
    reseed_rounds: int = _param(2, "rounds", "times a failed manoeuvre is given to another vehicle", ge=0, le=20)

    @model_validator(mode="after")
    def _check(self) -> "Spawn":
        for name in ("prior_speed_mps", "min_speed_mps"):
            if getattr(self, name) > self.max_speed_mps:
                raise ValueError(f"{name} {getattr(self, name):g} is above max_speed_mps {self.max_speed_mps:g}")
        return self


class Drivers(_Section):
    """How people drive: what each inserted vehicle's driver is drawn from."""

    desired_mean: float = _param(
        1.08, "share", "mean desired speed over the cruising speed of the lane's traffic: leaders keep it lower",
        ge=0.5, le=1.5,
    )  # fmt: skip
    desired_sd: float = _param(0.12, "share", "its SD between drivers", ge=0, le=0.5)
    wander_sd_mps: float = _param(
        1.2, "m/s", "SD of desired speeds' wandering (Ornstein-Uhlenbeck), of start speeds; 0.9 to 1.9", ge=0, le=3
    )
    wander_time_s: float = _param(3.0, "s", "correlation time of that wandering", gt=0, le=30)
    tau_mean_s: float = _param(1.15, "s", "time gap; usual 0.9 to 1.5", ge=0.6, le=4)
    tau_sd_s: float = _param(0.25, "s", "its SD between drivers", ge=0, le=2)
    accel_mean_mps2: float = _param(
        1.85, "m/s2", "acceleration from standstill; 95 % of recorded ones are below 1.45", ge=0.6, le=2.4
    )
    accel_sd_mps2: float = _param(0.35, "m/s2", "its SD between drivers", ge=0, le=1)
    decel_mean_mps2: float = _param(3.4, "m/s2", "comfortable deceleration; EIDM brakes by less", ge=0.8, le=4.05)
    decel_sd_mps2: float = _param(0.35, "m/s2", "its SD between drivers", ge=0, le=1)
    min_gap_mean_m: float = _param(3.4, "m", "gap to a standing leader; half of 69: 2.3 to 5.1", ge=1, le=10)
    min_gap_sd_m: float = _param(1.3, "m", "its SD between drivers", ge=0, le=3)
    turn_lateral_min_mps2: float = _param(
        1.5, "m/s2", "lateral acceleration in turns, uniform from here", gt=0, le=4.89
    )
    turn_lateral_max_mps2: float = _param(3.5, "m/s2", "to here; measured over 1.1 s: 1.4 to 3.0", gt=0, le=4.89)
    offset_mean_m: float = _param(0.1, "m", "mean place in the lane, left positive; measured", ge=-1, le=1)
    offset_sd_m: float = _param(0.39, "m", "SD between vehicles of the place in the lane; measured", ge=0, le=1)
    offset_lane_share: float = _param(
        0.85, "share", "of its variance that is the lane's: where recorded vehicles drive, they tell it; measured: on "
        "one lane 0.24 m, wandering included", ge=0, le=1,
    )  # fmt: skip
    lateral_wander_sd_m: float = _param(
        0.27, "m", "median driver's SD of wandering about it; measured: 0.16 to 0.40", ge=0, le=0.5
    )
    lateral_wander_spread: float = _param(0.85, "-", "SD between drivers of its logarithm; measured", ge=0, le=1.5)
    lateral_wander_time_s: float = _param(2.7, "s", "its correlation time; measured: 1.8 to 3.3", gt=0, le=30)
    lane_change_mean_s: float = _param(
        5.0, "s", "duration of a lane change (|d'| above .1 m/s), within lane_change.*_duration_s", ge=1.5, le=15
    )
    lane_change_sd_s: float = _param(0.9, "s", "its SD between drivers", ge=0, le=4)
    reaction_s: float = _param(0.5, "s", "EIDM treaction", ge=0.1, le=3)
    error: float = _param(0.1, "-", "EIDM sigmaerror; acts on roads without replayed agents alone", ge=0, le=1)

    @model_validator(mode="after")
    def _check(self) -> "Drivers":
        low, high = self.turn_lateral_min_mps2, self.turn_lateral_max_mps2
        if low > high:
            raise ValueError(f"turn_lateral_min_mps2 {low:g} is above turn_lateral_max_mps2 {high:g}")
        return self


class LaneChange(_Section):
    """Paper, Lane Change; Algorithm 1 lines 3 to 5."""

    time_gap_front_s: float = _param(0.6, "s", "gap to the new leader over the own speed", ge=0, le=5)
    time_gap_rear_s: float = _param(0.8, "s", "gap to the new follower over its speed", ge=0, le=5)
    min_gap_m: float = _param(2.5, "m", "smallest bumper gap to both", ge=0, le=50)
    braking_mps2: float = _param(2.0, "m/s2", "deceleration that the follower in a pair may need", gt=0, le=9)
    min_remaining_m: float = _param(25.0, "m", "length of l' left, through its successors", ge=0, le=500)
    give_up_s: float = _param(6.0, "s", "from the trigger on, the request ends after this", ge=0, le=60)
    min_duration_s: float = _param(
        3.7, "s", "shortest lane change, as lane_change_mean_s: at most 1.3 m/s", ge=1.5, le=10
    )
    max_duration_s: float = _param(6.0, "s", "longest lane change that a driver wants", ge=1.5, le=15)
    heading_deg: float = _param(9.5, "deg", "to the lane at most, so that slow vehicles take longer", ge=1, le=45)
    min_speed_mps: float = _param(2.0, "m/s", "slower vehicles cannot shift a lane in time", ge=0, le=20)
    rule: Literal["paper", "MOBIL", "LC2013"] | Annotated[str, _FUNCTION] = _param(
        "paper", "-", "what decides whether a gap is taken; module:function names one of your own"
    )
    rule_with: Annotated[str, _ARGUMENTS] = _param(
        "", "-", "arguments of a rule of your own, as 'b=1.0, lead=0.5'; a study varies them as rule.b"
    )
    safety: Literal["sumo", "guard", "rule"] = _param(
        "sumo",
        "-",
        "what may refuse a gap that the rule takes: sumo: the guard and SUMO's gap check; guard: the guard alone; "
        "rule: neither, and what is unsafe is an outcome, in studies alone",
    )
    mobil_politeness: float = _param(0.3, "-", "MOBIL p (Kesting et al. 2007: 0 to 1)", ge=0, le=2)
    mobil_threshold_mps2: float = _param(0.1, "m/s2", "MOBIL, advantage that is worth a change", ge=0, le=5)
    mobil_bias_mps2: float = _param(0.3, "m/s2", "MOBIL, bias towards the lane that is asked for", ge=0, le=10)
    mobil_safe_mps2: float = _param(4.0, "m/s2", "MOBIL b_safe, hardest braking left to the new follower", gt=0, le=9)
    lc_speed_gain: float = _param(1.0, "-", "LC2013 lcSpeedGain; SUMO's default", ge=0, le=1000)

    @model_validator(mode="after")
    def _check(self) -> "LaneChange":
        if self.max_duration_s < self.min_duration_s:
            raise ValueError(f"max_duration_s {self.max_duration_s} is below min_duration_s {self.min_duration_s}")
        names = [part.partition("=")[0].strip() for part in self.rule_with.split(",") if part]
        if len(names) > len({*names}):
            raise ValueError(f"rule_with = {self.rule_with!r}: a name is there twice, expected each once")
        read = _READ_OF_RULE_WITH.get(self.rule, {*names})
        if not {*names} <= read:
            raise ValueError(
                f"rule_with = {self.rule_with!r}: rule {self.rule} reads {', '.join(read) or 'nothing'} of it"
            )
        return self


class Overtake(_Section):
    """Paper, Overtaking; Algorithm 1 lines 6 to 11."""

    d_obs_m: float = _param(40.0, "m", "d_obs, the observation horizon", ge=4, le=200)
    d_overtake_m: float = _param(40.0, "m", "d_overtake, length of the free corridor m * delta s", ge=8, le=300)
    speed_advantage_mps: float = _param(1.5, "m/s", "the leader is slower than the desired speed by this", ge=0, le=20)
    safe_front_m: float = _param(6.0, "m", "delta d_safe^front", ge=0, le=100)
    safe_rear_m: float = _param(8.0, "m", "delta d_safe^rear", ge=0, le=100)
    return_gap_m: float = _param(5.0, "m", "bumper gap ahead of the passed vehicle before the return", ge=1, le=50)


class Turn(_Section):
    """Paper, Straight, Left Turn and Right Turn."""

    left_trough: float = _param(0.77, "ratio", "min of f_left(alpha); measured: 0.73 to 0.83", gt=0, le=1)
    right_trough: float = _param(0.79, "ratio", "the same of f_right, above left_trough; 0.70 to 0.83", gt=0, le=1)
    trough_at: float = _param(0.5, "share", "alpha of the trough, early to mid-turn; measured", ge=0.1, le=0.9)

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
    brake_max_mps2: float = _param(3.5, "m/s2", "hardest braking for a conflict", ge=1.1, le=4.05)
    margin_lateral_m: float = _param(0.1, "m", "added to each side of a box", ge=0, le=2)
    ttc_min_s: float = _param(1.5, "s", "critical TTC (SSAM)", ge=0, le=5)
    follower_ttc_min_s: float = _param(
        1.5, "s", "TTC kept to recorded vehicles behind, which do not brake", ge=0, le=10
    )
    pet_min_s: float = _param(1.0, "s", "critical PET, kept to all agents on crossing paths", ge=0, le=5)
    end_ttc_min_s: float = _param(1.0, "s", "smallest TTC at the last step, at constant velocities", ge=0, le=5)


class Signals(_Section):
    """Red and green inferred from recorded traffic; the signals themselves are not in the data."""

    before_s: float = _param(2.0, "s", "red so long before recorded traffic crosses, and amber before", ge=0, le=10)
    after_s: float = _param(3.0, "s", "red so long after recorded traffic has crossed", ge=0, le=20)


class Driving(_Section):
    """What is added to SUMO's car following, which is blind to crossing agents. Chosen on the scenes of tests/real."""

    replay: Literal["fixed", "reactive"] = _param(
        "fixed", "-", "reactive: recorded vehicles yield in time on their recorded path; for studies and planner tests"
    )
    check_replay: bool = _option(
        False, "-", "Replay every recorded agent and measure its pose in SUMO, not only those near inserted ones", "",
        shown="",
    )  # fmt: skip


class CarFollowing(_Section):
    """SUMO's car following of the inserted vehicles."""

    model: Literal["EIDM", "IDM", "Krauss"] = _param("EIDM", "-", "SUMO's carFollowModel")


class Flow(_Section):
    """Traffic that enters at the edges of the map while the scene runs: in studies (`hid2 study`)."""

    veh_per_h_lane: float = _param(0.0, "veh/h", "flow on each lane that begins at the map's edge", ge=0, le=3000)
    min_headway_s: float = _param(1.2, "s", "headways are exponential beyond this (Cowan's M2)", ge=0, le=10)
    warm_up_s: float = _param(30.0, "s", "requests before this are not counted", ge=0, le=3600)

    @property
    def counted_from_s(self) -> float:
        """From when on traffic counts, s: where none enters, from the first step."""
        return self.warm_up_s if self.veh_per_h_lane > 0.0 else 0.0


class Limits(_Section):
    """Limits of motion of every exported step (nuPlan's comfort bounds; R_min and a_y,max of the paper)."""

    accel_max_mps2: float = _param(2.40, "m/s2", "nuPlan", ge=0.6, le=6)
    accel_min_mps2: float = _param(-4.05, "m/s2", "nuPlan", ge=-10, le=-0.8)
    lateral_accel_mps2: float = _param(4.89, "m/s2", "nuPlan; a_y,max", gt=0, le=8)
    yaw_rate_radps: float = _param(0.95, "rad/s", "nuPlan", gt=0, le=2)
    yaw_accel_radps2: float = _param(1.93, "rad/s2", "nuPlan", gt=0, le=5)
    longitudinal_jerk_mps3: float = _param(4.13, "m/s3", "nuPlan", gt=0, le=20)
    jerk_mps3: float = _param(8.37, "m/s3", "nuPlan", gt=0, le=30)
    min_radius_m: float = _param(5.0, "m", "R_min", gt=1, le=20)
    drivable_tolerance_m: float = _param(0.3, "m", "nuPlan", ge=0, le=2)


class Smoothing(_Section):
    """Frenet smoothing: s(t), d(t) piecewise cubics."""

    filter_s: float = _param(0.15, "s", "SD of the Gaussian that takes SUMO's steps out of the speed", gt=0, le=2)


Band = tuple[float, float]
#: Cap of an event's TTC and PET, s: larger ones are not told apart. No tunable, a definition.
EVENT_CAP_S = 10.0


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
        None, "m", "Bumper to bumper at that moment, in metres", "A:B", shown="4:30, cut_in 4:15, cross 0:100"
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
        return self.gap_m or {"cross": (0.0, 100.0), "cut_in": (4.0, 15.0)}.get(self.kind, (4.0, 30.0))

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
        names = "at_s", "gap_m", "speed_difference_mps", "ttc_s", "pet_s", "drac_mps2"
        asked = {name: band for name in names if (band := getattr(self, name)) is not None}
        for name, band in asked.items():
            if band[1] < band[0]:
                raise ValueError(f"{name} {band[0]:g}:{band[1]:g}, expected the smaller value first")
            if name != "at_s" and band[0] == band[1]:  # a moment has moment_s to both sides
                raise ValueError(f"{name} {band[0]:g}, expected a band of two values: nothing driven meets one exactly")
            if name != "speed_difference_mps" and band[0] < 0:
                raise ValueError(f"{name} {band[0]:g}:{band[1]:g}, expected values of 0 or more")
            if name in ("ttc_s", "pet_s") and band[0] >= EVENT_CAP_S:
                raise ValueError(f"{name} {band[0]:g}, expected less than {EVENT_CAP_S:g} s: more is not told")
        if self.brakes_mps2 and self.kind != "lead":
            raise ValueError(f"brakes_mps2 {self.brakes_mps2:g} with kind {self.kind}, expected kind lead")
        if self.pet_s is not None and self.kind != "cross":
            raise ValueError(f"pet_s with kind {self.kind}, expected kind cross: only crossing paths have a PET")
        if self.drac_mps2 is not None and self.kind == "follow":
            raise ValueError("drac_mps2 with kind follow, expected another kind: what is ahead need not brake")
        return self


class EventSearch(_Section):
    """The search for a vehicle that brings an event about."""

    candidates: int = _param(1500, "vehicles", "rolled out for one event before it is given up", ge=1, le=100_000)
    tries: int = _param(10, "vehicles", "driven for one event before it is given up", ge=1, le=200)


class Export(_Section):
    """What is written."""

    noise: Literal["none", "tracker"] = _param(
        "none", "-", "of inserted tracks; tracker: as recorded vehicles of the scene, with clean states in the sidecar"
    )

    def adds_noise(self, provenance: str) -> bool:
        """Whether inserted tracks get any in a recording of a provenance: those that people labelled have none."""
        return self.noise == provenance == "tracker"


class Config(_Section):
    """A whole request: what to generate and every parameter of the method."""

    request: Request = Request()
    source: SourceChecks = SourceChecks()
    grid: Grid = Grid()
    spawn: Spawn = Spawn()
    drivers: Drivers = Drivers()
    driving: Driving = Driving()
    car_following: CarFollowing = CarFollowing()
    lane_change: LaneChange = LaneChange()
    overtake: Overtake = Overtake()
    turn: Turn = Turn()
    conflict: Conflict = Conflict()
    signals: Signals = Signals()
    flow: Flow = Flow()
    limits: Limits = Limits()
    smoothing: Smoothing = Smoothing()
    event_search: EventSearch = EventSearch()
    export: Export = Export()

    event: tuple[Event, ...] = Field(
        default=(),
        json_schema_extra={"unit": "-", "source": "events, a section [[event]] each; see hid2 generate --event"},
    )
    without: Annotated[frozenset[Literal["topology", "collision", "smoothing"]], PlainSerializer(sorted)] = Field(
        default=frozenset(), json_schema_extra={"unit": "-", "source": "paper, Table ablation: components switched off"}
    )


#: Sections of parameters by use, as `hid2 config` lists them; single keys of a section that has several uses.
GROUPS: Mapping[str, tuple[str, ...]] = {
    "request": ("request", "event", "export", "without"),
    "paper": ("grid", "lane_change", "overtake", "turn", "conflict.horizon_s", "conflict.brake_max_mps2", "smoothing"),
    "drivers": ("drivers", "car_following"),
    "limits": ("limits",),
    "criticality": ("conflict",),
    "expert": ("source", "spawn", "driving", "signals", "flow", "event_search"),
}


class Forecasting(_Section):
    """The forecasting experiment (`bridge/forecasting`). No part of `Config`: no scene depends on it."""

    place_cell_m: float = _param(50.0, "m", "scenes with lanes through one square of this size overlap", gt=1, le=500)
    block_m: float = _param(1000.0, "m", "scenes with maps centred in one square of this size are split as one", gt=1)
    density_bounds: tuple[int, ...] = _param((30, 50, 70, 90), "tracks", "strata of density; the paper's and one below")
    resamples: int = _param(4000, "-", "draws of the bootstrap over scenes and seeds", ge=100, le=100_000)
    variants: int = _param(8, "scenes", "scenes of each recorded one in `hid2 paper prediction`", ge=1, le=1000)
    val_share: float = _param(0.3, "share", "scenes kept for validation in `hid2 paper prediction`", gt=0, lt=1)
    updates: int = _param(300, "-", "updates of a training, the same for every composition", ge=1)
