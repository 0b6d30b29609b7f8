"""One inserted vehicle on its way: what is asked of it, where it starts, its driver, and how it has been driven."""

from collections import Counter
from dataclasses import dataclass, field

from hid2.agents import DEFAULT_SIZES, BoxSize, FloatArray, Policy
from hid2.drivers.driver import Driver, LaneOffset
from hid2.motion.route import DrivenPath, Route
from hid2.policy.lane_change import LaneOption
from hid2.policy.overtake import Stage
from hid2.reasons import Reason
from netconvert.lane_graph import Side


@dataclass(frozen=True, slots=True)
class VehicleRequest:
    """A vehicle that is asked for: what it is to do, from which moment on, s, and what it is."""

    number: int
    policy: Policy
    trigger_s: float
    object_type: str = "vehicle"
    size: BoxSize = DEFAULT_SIZES["vehicle"]


@dataclass(frozen=True, eq=False, slots=True)
class Start:
    """A request with a site and a driver: everything that decides how a vehicle begins.

    start_m m, of the box centre on the path; start_mps m/s; box: what is kept clear; desired (T,) m/s, by the scene's
    steps; sides: where it looks for a lane, in this order; step: at which it is first there, later than 0 where it
    enters at the map's edge; leader: the recorded vehicle that it would follow, as `Meetings` numbers them; -1 none;
    situations: what it meets by its rollout, as `insertion/situations.py` has it.
    """

    vehicle_id: str
    request: VehicleRequest
    box: BoxSize
    route: Route
    path: DrivenPath
    start_m: float
    start_mps: float
    driver: Driver
    desired: FloatArray
    offset: LaneOffset
    sides: tuple[Side, ...]
    step: int = 0
    leader: int = -1
    situations: frozenset[str] = frozenset()

    @property
    def size(self) -> BoxSize:
        """The box that is exported."""
        return self.request.size

    @property
    def beyond_m(self) -> float:
        """By how much what is kept clear is longer, ahead, than what is exported."""
        return 0.5 * (self.box.length_m - self.size.length_m)


@dataclass(frozen=True, slots=True)
class Shift:
    """A change of lanes that SUMO carried out. target: path of the lane changed to."""

    side: Side
    source_lane: int
    target_lane: int
    requested_step: int
    target: DrivenPath


@dataclass(frozen=True, slots=True)
class GapLook:
    """One look at a gap: what was seen at a step, and the answers.

    own_mps: of the vehicle; refusals: conditions of the lane-change rule that said no, none for yes; guard: why
    there is no safe path into the gap, None for yes or where the rule said no; sumo: its answer, None where it was not
    asked.
    """

    step: int
    seen: LaneOption
    own_mps: float
    refusals: tuple[Reason, ...]
    guard: Reason | None = None
    sumo: bool | None = None

    @property
    def rule(self) -> Reason | None:
        """The rule's answer: the first condition that said no, None for yes."""
        return next(iter(self.refusals), None)


@dataclass(eq=False, slots=True)
class DrivenVehicle:
    """A vehicle that SUMO drives: s (T,) m, v (T,) m/s on its path since its start, and what became of its request.

    jumped_m (T,): how far SUMO has it behind s, which does not jump where SUMO changes lanes; reason: of the last
    refusal of its manoeuvre; not_inserted: why SUMO does not have it, None where it has; left_at: step at which it left
    the map; overtaken_id: what it passes, or has passed;
    limited: steps in which hid2 held it below SUMO's own choice of speed, by cause; policies: steps by the policy that
    Algorithm 1 returned; rerouted_at: step at which it took another way at the next split; waited_for: steps in which
    it braked for a vehicle of the same run that it followed or yielded to.
    """

    start: Start
    path: DrivenPath
    s: list[float] = field(default_factory=list)
    v: list[float] = field(default_factory=list)
    jumped_m: list[float] = field(default_factory=list)
    stage: Stage = Stage.WAITING
    reason: Reason | None = None
    not_inserted: Reason | None = None
    left_at: int | None = None
    rerouted_at: int | None = None
    shifts: list[Shift] = field(default_factory=list)
    gaps: list[GapLook] = field(default_factory=list)
    overtaken_id: str | None = None
    limited: Counter[str] = field(default_factory=Counter)
    policies: Counter[Policy] = field(default_factory=Counter)
    waited_for: Counter[str] = field(default_factory=Counter)

    @property
    def vehicle_id(self) -> str:
        """Its id in the simulation."""
        return self.start.vehicle_id

    @property
    def policy(self) -> Policy:
        """What is asked of it."""
        return self.start.request.policy

    @property
    def last_step(self) -> int:
        """Last step at which SUMO had it."""
        return self.start.step + max(0, len(self.s) - 1)

    @property
    def running(self) -> bool:
        """Whether SUMO has it, or will have it."""
        return self.not_inserted is None and self.left_at is None
