"""What vehicles of every seed and variant find in a scene: worked out once."""

from functools import cached_property

from hid2.conflicts.stop_lines import StopLines
from hid2.insertion.entries import Entries
from hid2.insertion.meetings import Meetings
from hid2.insertion.routes import Routes
from hid2.insertion.situations import Situation, recorded_shares
from hid2.policy.behaviours import load_own
from hid2.policy.roads import Roads
from hid2.scene import Scene


class Surroundings:
    """Roads, routes, stop lines, and which agents a vehicle would meet from where; nothing here depends on a seed.

    Each fills its own tables at the first use. Errors: ConfigError for behaviours of a user's own.
    """

    def __init__(self, scene: Scene) -> None:
        load_own(scene.config.request.own_behaviours)
        self.scene = scene
        self.roads, self.routes, self.stop_lines = Roads(scene), Routes(scene), StopLines(scene)
        self.meetings = Meetings(scene, self.routes, self.stop_lines.signals)
        self.entries = Entries(scene, self.routes, self.meetings)

    @cached_property
    def shares(self) -> dict[Situation, float]:
        """Shares of vehicles that are to meet something; none where no traffic is asked for, or none is foreseen."""
        request, is_foreseen = self.scene.config.request, "collision" not in self.scene.config.without
        is_asked = request.sites == "promising" and request.near != "anywhere"
        return recorded_shares(self.scene) if is_asked and is_foreseen else {}
