"""What vehicles of every seed and variant find in a scene: worked out once."""

from dataclasses import dataclass, field

from hid2.conflicts.stop_lines import StopLines
from hid2.insertion.entries import Entries
from hid2.insertion.meetings import Meetings
from hid2.insertion.routes import Routes
from hid2.policy.behaviours import load_own
from hid2.policy.roads import Roads
from hid2.scene import Scene


@dataclass(eq=False, slots=True)
class Surroundings:
    """Roads, routes, stop lines, and which agents a vehicle would meet from where; nothing here depends on a seed."""

    scene: Scene
    roads: Roads = field(init=False)
    routes: Routes = field(init=False)
    stop_lines: StopLines = field(init=False)
    meetings: Meetings = field(init=False)
    entries: Entries = field(init=False)

    def __post_init__(self) -> None:
        """Each fills its own tables at the first use. Errors: ConfigError for behaviours of a user's own."""
        load_own(self.scene.config.request.own_behaviours)
        self.roads, self.routes, self.stop_lines = Roads(self.scene), Routes(self.scene), StopLines(self.scene)
        self.meetings = Meetings(self.scene, self.routes, self.stop_lines.signals)
        self.entries = Entries(self.scene, self.routes, self.meetings)
