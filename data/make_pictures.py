"""Makes the pictures of the README from the synthetic scenes: python data/make_pictures.py.

They are of synthetic data only, and reduced to a palette: small files.
"""

import tempfile
from io import BytesIO
from pathlib import Path

from PIL import Image

from bridge import evaluate_folder, find_scenarios, generate, load_config, read_scene
from bridge.pages.charts import distribution_figure
from bridge.pictures import figures
from bridge.pictures.render import palette_of

ROOT = Path(__file__).parent
PICTURES = ROOT / "pictures"
#: Widest picture, pixels.
WIDTH = 1200


def main() -> None:
    """Write every picture."""
    PICTURES.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch)
        settings = ["request.agents=12", "request.straight=0.4", "request.lane_change=0.4", "request.overtake=0.2"]
        folders = find_scenarios(ROOT / "av2")
        scenes = [generate(read_scene(folder), load_config(overrides=settings)) for folder in folders]
        for scene in scenes:
            scene.write(out / "scenes")
        # the scene in which most is done, and in it a vehicle that changes lanes
        done = [scene.maneuvers.query("status == 'done' and kind in ['lane_change', 'overtake']") for scene in scenes]
        best = max(range(len(scenes)), key=lambda k: len(done[k]))
        scenes[best].render(out / "scene.png")
        figures.save(scenes[best].plot(done[best]["track_id"].iloc[0]), out / "plot.png")
        evaluation = evaluate_folder(out / "scenes", report_dir=out / "report", source=[ROOT / "av2"])
        figures.save(distribution_figure(evaluation.totals.realism), out / "report.png")
        for name in ("scene", "plot", "report"):
            write_small(out / f"{name}.png", PICTURES / f"{name}.png")


def write_small(drawn: Path | BytesIO, to: Path | BytesIO, *, colors: int = 96, width: int = WIDTH) -> None:
    """A picture as a PNG of at most so many pixels a side with a palette."""
    picture = Image.open(drawn).convert("RGB")
    picture.thumbnail((width, width), Image.Resampling.LANCZOS)
    palette = palette_of(picture, colors)
    picture.quantize(palette=palette, dither=Image.Dither.NONE).save(to, "png", optimize=True)


if __name__ == "__main__":
    main()
