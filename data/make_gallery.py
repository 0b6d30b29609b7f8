"""Write the gallery of events, EVENTS.md, from the synthetic scenes: python data/make_gallery.py.

Each kind of event is asked for in the scenes of data/av2, with any moving recorded vehicle as target; the first scene
in which it comes about is shown.
"""

import sys
import tempfile
from pathlib import Path
from typing import get_args

from bridge.generation.generate import generate, prepare, write
from bridge.pictures import figures
from bridge.pictures.render import scene_figure
from bridge.recordings.folders import find_scenarios
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sidecar import EventRecord
from hid2.params import Config, Event, Request

DATA = Path(__file__).parent
PAGE, PICTURES = DATA / "EVENTS.md", DATA / "events"
SEEDS = 1
#: What is to be seen in each picture.
SEEN = {
    "cut_in": "changes from the lane beside to before the target",
    "overtake": "passes the target by the lane beside and comes back before it",
    "lead": "drives ahead of the target",
    "follow": "drives behind the target",
    "merge": "comes onto the target's lane from another one",
    "cross": "passes the target's path",
}


def first_of(kind: str, folders: list[Path], out: Path) -> tuple[Path, Path, EventRecord, int] | None:
    """Source, generated folder, record and seed of the first event of a kind that comes about; None where none does."""
    for seed in range(SEEDS):
        for folder in folders:
            config = Config(
                request=Request(agents=0, seed=seed),
                event=(Event.model_validate({"kind": kind, "target": "any", "at_s": (1.5, 6.0)}),),
            )
            scene = generate(prepare(read_scenario(folder), config), config)
            (event,) = scene.sidecar.events
            if event.status == "done":
                return folder, write(scene, out), event, seed
    return None


def main() -> None:
    """Make the page and its pictures."""
    figures.style()
    PICTURES.mkdir(exist_ok=True)
    lines = [
        "# Events", "", "A picture of each kind of event, in the synthetic scenes of this folder. `python",
        "data/make_gallery.py` writes this page; the same event comes of the command below its picture. The ring marks",
        "the inserted vehicle at the last observed step; the target is recorded and does not react.", "",
    ]  # fmt: skip
    with tempfile.TemporaryDirectory() as scratch:
        for kind in get_args(Event.model_fields["kind"].annotation):
            found = first_of(kind, find_scenarios(DATA / "av2"), Path(scratch))
            lines += [f"## {kind}", ""]
            if found is None:
                lines += [f"The vehicle {SEEN[kind]}. None of these scenes has room for it.", ""]
                continue
            source, folder, event, seed = found
            figure = scene_figure(folder, agent=event.track_id)
            figure.savefig(PICTURES / f"{kind}.png", dpi=70, metadata={"Software": None})
            asked = f"--agents 0 --seed {seed} --event {kind} --target any --at 1.5:6"
            measured = f"{event.gap_m:.1f} m from the target at {event.at_s:.1f} s"
            lines += [
                f"![{kind}](events/{kind}.png)", "",
                f"The vehicle {SEEN[kind]}, track {event.target_track_id}: {measured}, {event.tries} tried.", "",
                f"    hid2 generate data/av2/{source.parent.name}/{source.name} -o out {asked}", "",
            ]  # fmt: skip
            print(kind, source.name, measured, file=sys.stderr)
    PAGE.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
