"""A lane-change rule of one's own: a time gap to each side, condition by condition."""

from hid2.policy.rules import GapView


def accept(view: GapView, lead: float = 0.5, b: float = 1.0) -> dict[str, bool]:
    """Take a gap of `lead` seconds to the new leader and `b` seconds to the new follower."""
    front, rear = view.front, view.rear
    return {"lead": front.distance_m >= lead * view.speed_mps, "lag": rear.distance_m >= b * rear.speed_mps}
