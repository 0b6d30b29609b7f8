"""Makes the pictures of the README, and the gallery of events, EVENTS.md: python data/make_pictures.py.

All are of the synthetic scenes of data/av2, and reduced to a palette: small files. Each kind of event is asked for of
any moving recorded vehicle; of the first seed that has it in some scene, the event nearest to its target is shown.
"""

import io
import sys
import tempfile
from pathlib import Path
from typing import get_args

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from bridge import TrafficScene, evaluate_folder, find_scenarios, generate, load_config, read_scene
from bridge.batch.scene_work import told_of
from bridge.pages.charts import distribution_figure
from bridge.pictures import figures
from bridge.pictures.render import palette_of
from bridge.recordings.sidecar import EventRecord
from hid2.params import Config, Event, Request

DATA = Path(__file__).parent
PAGE, EVENTS, PICTURES = DATA / "EVENTS.md", DATA / "events", DATA / "pictures"
#: Longest side of a picture, pixels.
WIDTH = 1200
KINDS: tuple[str, ...] = get_args(Event.model_fields["kind"].annotation)
SEEDS = 4
#: Range of the time of an event, by kind, s: an overtake takes longer than all others.
AT_S = dict.fromkeys(KINDS, (1.5, 6.0)) | {"overtake": (6.0, 10.0)}
#: Ground shown to each side of the inserted vehicle, m.
GROUND_M = 30.0
#: Time before and after the moment of an event at which it is shown too, s.
AROUND_S = 2.0
_HEAD = """# Events

A picture of each kind of event that `hid2 generate --event` makes, in the synthetic scenes of this folder: {around:g} s
before the moment of the event, at it, and {around:g} s after it. Coloured and ringed is the inserted vehicle;
the target, which the text names, is recorded and does not react. Below a picture is the
command that writes its scene; [what each kind is](../bridge/generation/README.md#events-with-recorded-vehicles).

This page and its pictures are made by `python data/make_pictures.py`.
"""


def best_of(kind: str) -> tuple[Path, TrafficScene, EventRecord, int]:
    """Source, generated scene, record and seed of an event: of the first seed that has any, the nearest."""
    asked = Event.model_validate({"kind": kind, "target": "any", "at_s": AT_S[kind]})
    for seed in range(SEEDS):
        config = Config(request=Request(agents=0, seed=seed), event=(asked,))
        found = []
        for folder in find_scenarios(DATA / "av2"):
            scene = generate(read_scene(folder), config)
            (event,) = scene.sidecar.events
            if event.status == "done":
                found.append((folder, scene, event, seed))
        if found:
            return min(found, key=lambda one: one[2].gap_m or 0.0)
    raise SystemExit(f"{kind}: none of the scenes has one with seeds 0 to {SEEDS - 1}")


def picture(scene: TrafficScene, event: EventRecord) -> Figure:
    """Three moments of an event."""
    figure, step_s = Figure(figsize=(15.0, 5.2), layout="constrained"), scene.recording.step_s
    last_s = (scene.recording.num_steps - 1) * step_s
    for axes, apart_s in zip(figure.subplots(1, 3), (-AROUND_S, 0.0, AROUND_S), strict=True):
        at_s = float(np.clip((event.at_s or 0.0) + apart_s, 0.0, last_s))
        step = round(at_s / step_s)
        scene.draw(axes, step=step, agent=event.track_id)
        own = scene.tracks.query(f"track_id == {event.track_id!r} and timestep == {step}")
        for x, y in own[["position_x", "position_y"]].to_numpy()[:1]:
            axes.set(xlim=(x - GROUND_M, x + GROUND_M), ylim=(y - GROUND_M, y + GROUND_M))
        axes.set_title(f"{at_s:.1f} s")
    return figure


def make_gallery() -> None:
    """Make the page of events and its pictures."""
    figures.style()
    EVENTS.mkdir(exist_ok=True)
    lines = [_HEAD.format(around=AROUND_S)]
    for kind in KINDS:
        source, scene, event, seed = best_of(kind)
        drawn = io.BytesIO()
        picture(scene, event).savefig(drawn, dpi=100)
        write_small(drawn, EVENTS / f"{kind}.png")
        low, high = AT_S[kind]
        made_of = f"hid2 generate {source.relative_to(DATA.parent)} -o out --agents 0 --seed {seed}"
        lines += [
            f"## {kind}\n",
            f"{told_of(event)}\n",
            f"![{kind}](events/{kind}.png)\n",
            f"    {made_of} --event {kind} --target any --at {low:g}:{high:g}\n",
        ]
        print(kind, source.name, told_of(event), file=sys.stderr)
    PAGE.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")


def make_pictures() -> None:
    """Write the pictures of the README."""
    PICTURES.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch)
        settings = ["request.agents=12", "request.straight=0.4", "request.lane_change=0.4", "request.overtake=0.2"]
        folders = find_scenarios(DATA / "av2")
        scenes = [generate(read_scene(folder), load_config(overrides=settings)) for folder in folders]
        for scene in scenes:
            scene.write(out / "scenes")
        # the scene in which most is done, and in it a vehicle that changes lanes
        done = [scene.maneuvers.query("status == 'done' and kind in ['lane_change', 'overtake']") for scene in scenes]
        best = max(range(len(scenes)), key=lambda k: len(done[k]))
        scenes[best].render(out / "scene.png")
        figures.save(scenes[best].plot(done[best]["track_id"].iloc[0]), out / "plot.png")
        evaluation = evaluate_folder(out / "scenes", report_dir=out / "report", source=[DATA / "av2"])
        figures.save(distribution_figure(evaluation.totals.realism), out / "report.png")
        for name in ("scene", "plot", "report"):
            write_small(out / f"{name}.png", PICTURES / f"{name}.png")


def write_small(drawn: Path | io.BytesIO, to: Path | io.BytesIO, *, colors: int = 96, width: int = WIDTH) -> None:
    """A picture as a PNG of at most so many pixels a side with a palette."""
    picture = Image.open(drawn).convert("RGB")
    picture.thumbnail((width, width), Image.Resampling.LANCZOS)
    picture.quantize(palette=palette_of(picture, colors), dither=Image.Dither.NONE).save(to, "png", optimize=True)


if __name__ == "__main__":
    make_pictures()
    make_gallery()
