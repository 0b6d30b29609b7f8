"""Every reason that a user can read: why a vehicle was not exported, and why a manoeuvre did not come about."""

from enum import StrEnum, auto


class Reason(StrEnum):
    """A reason; its sentence is its `text`. The table in REASONS.md is made from this list."""

    text: str

    def __new__(cls, value: str, text: str = "") -> "Reason":
        """A member with its sentence."""
        member = str.__new__(cls, value)
        member._value_ = value
        member.text = text
        return member

    # what the map or the request says, before anything is simulated
    MAP_OFFERS_NO_LEFT_TURN = auto(), "The map has no left-turn lane that a route can take and leave in time."
    MAP_OFFERS_NO_RIGHT_TURN = auto(), "The map has no right-turn lane that a route can take and leave in time."
    MAP_OFFERS_NO_LANE_CHANGE = auto(), "The map has no lane beside another to change to."
    MAP_OFFERS_NO_OVERTAKE = auto(), "The map has no lane beside another that lasts for an overtake."
    NO_OVERTAKE_FORESEEN = (
        auto(),
        "No place has both the room for a slower vehicle to be passed and the time for it, out and back.",
    )
    NO_SLOW_LEADER = (
        auto(),
        "No known vehicle is slow enough to be overtaken, and no other request is open that a slow leader could meet.",
    )
    LEADS_AN_OVERTAKE = (
        auto(),
        "The vehicle became the slow leader of another overtake, as no request to go straight was open.",
    )
    MAP_OFFERS_NO_LANE = "map_offers_no_straight", "The map has no lane for general motor traffic."
    TRIGGER_AFTER_SCENE = auto(), "The trigger time lies beyond the end of the scene."
    NO_SITE = (
        auto(),
        "Every admissible start site was taken, or the recorded traffic would have run into a vehicle there.",
    )
    OTHER_SITUATION = (
        auto(),
        "A place was passed over, as a vehicle there would meet nothing of what recorded vehicles meet more often.",
    )
    NO_CELL_IN_REACH = (
        auto(),
        "From no free cell does a vehicle reach such a lane or turn at the time asked for, with room and time left.",
    )
    NEAR_NO_TRACK = auto(), "The track that vehicles are to be near to is not in the scene."
    # what the simulation answered
    NO_ROUTE = auto(), "The start site is not on the vehicle's route."
    SUMO_REFUSES_INSERTION = auto(), "SUMO did not accept the vehicle at its start site."
    NO_ROOM_AT_EDGE = (
        auto(),
        "Another inserted vehicle was too near to the map's edge when the vehicle was to enter there.",
    )
    # events
    EVENT_NO_TARGET = (
        auto(),
        "The target of an event is not there, does not move, is no vehicle on a lane, or its box points backwards.",
    )
    EVENT_NO_PLACE = (
        auto(),
        "The map has no place from which a vehicle meets the target so: no lane beside the target's, for example.",
    )
    EVENT_NOT_FORESEEN = (
        auto(),
        "No motion that was looked at makes the event safely and as asked for; behind the colon what most fail by.",
    )
    EVENT_NOT_AS_ASKED = (
        auto(),
        "No vehicle that was driven made the event safely and as asked for; behind the colon what most failed by.",
    )
    EVENT_NOT_THERE = (
        auto(),
        "The vehicle is not where the target meets it so, at the time and with the gap and speed difference asked for.",
    )
    EVENT_CRITICALITY = (
        auto(),
        "The event comes about, but TTC, PET, DRAC or braking are outside the band asked for; another may be met.",
    )
    # answers to a look at a gap (Algorithm 1, lane change)
    NO_ADJACENT_LANE = auto(), "There is no lane beside that may be changed to."
    TOO_SLOW = auto(), "The vehicle is too slow to shift a lane in time."
    LANE_ENDS = auto(), "The lane beside ends too soon."
    CELLS_OCCUPIED = auto(), "Cells j-1, j, j+1 of the lane beside are not free."
    FRONT_GAP = auto(), "The gap to the new leader is too small."
    REAR_GAP = auto(), "The gap to the new follower is too small."
    MOBIL_UNSAFE = auto(), "MOBIL: the new follower would have to brake harder than b_safe."
    MOBIL_NO_ADVANTAGE = auto(), "MOBIL: the advantage, politeness included, is below the threshold."
    LC2013_NO_MOTIVE = auto(), "SUMO's LC2013 has no motive to change to that lane."
    RULE_REFUSES = auto(), "The user's own lane-change rule does not take the gap."
    # overtake
    NO_LEADER = auto(), "No leader within the observation horizon."
    LEADER_NOT_SLOWER = auto(), "The leader is not slower than the desired speed by enough."
    NO_LANE = auto(), "No free lane to overtake on, or to return to: cells j-1, j, j+1 are not free."
    CORRIDOR_SHORT = auto(), "The free corridor m * 4 m is shorter than d_overtake."
    NOT_AHEAD = auto(), "The overtaken vehicle is not far enough behind for the return."
    LANES_PART = auto(), "The two lanes part before the return."
    # conflicts and what SUMO says to a change
    CONFLICT_PREDICTED = auto(), "Predicted boxes meet on the way across (conflict case 3)."
    LANES_NOT_SIDE_BY_SIDE = auto(), "The two lanes are not side by side all the way across."
    SOLID_LINE = auto(), "The line to the other lane may not be crossed where the vehicle would cross it."
    OFF_ITS_LANE = auto(), "SUMO has the vehicle on no lane of the grid."
    TARGET_NOT_BESIDE_FRONT = auto(), "The target lane is not beside the front bumper."
    SUMO_REFUSES = auto(), "SUMO refused the lane change as unsafe (lane-change mode 512)."
    SCENE_ENDS = auto(), "The scene ends before the manoeuvre could be completed."
    # outcomes of manoeuvres that were begun
    SCENE_ENDED = auto(), "The scene or the map ended first."
    WAITS_AT_LINE = auto(), "A red light, or a crossing that is walked on, is ahead of it until the scene ends."
    SCENE_ENDED_ENTERING = auto(), "The scene ended while the vehicle entered the overtaking lane."
    SCENE_ENDED_RETURNING = auto(), "The scene ended while the vehicle returned."
    PASSED_WITHOUT_RETURN = auto(), "The leader was passed, but the vehicle did not return."
    NOT_PASSED = auto(), "The leader was not passed before the scene ended."
    LEADER_NOT_KEPT = auto(), "The vehicle to be overtaken is not in the exported scene."
    RETURNED_ELSEWHERE = auto(), "The vehicle returned to another lane path than the one it left."
    RETURNED_BEHIND = auto(), "The vehicle returned behind its leader."
    OBSTACLE_AVOIDANCE = auto(), "Done, but the leader stood all the while: obstacle avoidance."
    NOT_AS_ASKED = auto(), "The manoeuvre came about, but not as `is_shown` of a behaviour of your own asks for."
    TURN_NOT_SEEN = auto(), "On the turn lane its heading does not turn by 30 degrees after it began."
    # why a driven vehicle was not exported
    LEAVES_TOO_EARLY = auto(), "The vehicle leaves the map before the last observed timestep."
    OFF_ROAD = auto(), "Its footprint leaves the drivable area."
    MEETS_RECORDED = auto(), "Its box meets that of a recorded agent, or of one that stands there unseen."
    MEETS_GENERATED = auto(), "Its box meets that of another inserted vehicle, or was inside it just before it begins."
    LIMIT_CURVATURE = auto(), "Its path is sharper than 1 / R_min."
    LIMIT_ACCEL = auto(), "It exceeds the longitudinal acceleration allowed."
    LIMIT_DECEL = auto(), "It exceeds the deceleration allowed."
    LIMIT_LATERAL_ACCEL = auto(), "It exceeds the lateral acceleration allowed."
    LIMIT_LONGITUDINAL_JERK = auto(), "It exceeds the longitudinal jerk allowed."
    LIMIT_JERK = auto(), "It exceeds the jerk allowed."
    LIMIT_YAW_RATE = auto(), "It exceeds the yaw rate allowed."
    LIMIT_YAW_ACCEL = auto(), "It exceeds the yaw acceleration allowed."
    AGAINST_LANE = auto(), "It drives at too large an angle to every lane below it."
    TTC_LANE_LEADER = auto(), "TTC to its leader on the path driven falls below the critical value."
    FOLLOWER_HEADWAY = (
        auto(),
        "A follower would drive on its leader's bumper: too short a time headway for a second, unless recorded so.",
    )
    FOLLOWER_BRAKING = auto(), "A recorded vehicle that comes up from behind would have to brake harder than it does."
    TTC_RECORDED_FOLLOWER = auto(), "A recorded vehicle closes in on it from behind below the critical TTC."
    PET = auto(), "It crosses an agent's path below the critical post-encroachment time."
    TTC_AT_END = (
        auto(),
        "Beyond its last step, others at constant velocity, it has a critical TTC or contact that no braking avoids.",
    )
    DID_NOT_DO_IT = auto(), "It did not perform its manoeuvre, and was replaced by another vehicle."
    BREAKS_EVENT = auto(), "It came between the two vehicles of a lead or follow event at its moment."
    TAKES_GAP = auto(), "It would be in a gap that a vehicle kept before takes, nearer than the paper's rule allows."
    WAITED_FOR_GONE = auto(), "It had braked for a vehicle that is not exported."
    STANDS_THROUGHOUT = auto(), "It stands from the first step to the last."
    ENTERS_ON_RED = auto(), "It would enter an intersection on red, or drive over a crossing that is used."
    BEHIND_PARKED = auto(), "It would wait behind a parked vehicle, round which a driver would go."
    STOPS_IN_INTERSECTION = (
        auto(),
        "It would come to a stop inside an intersection, for a queue beyond it or for crossing traffic.",
    )
