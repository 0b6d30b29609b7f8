"""`hid2 view` of the six real scenes, with 15 vehicles each: all that it holds and shows, vehicle by vehicle."""

import subprocess
import sys
from pathlib import Path

import pytest
from browser import Page
from viewed import differences

ROOT = Path(__file__).parents[2]


def hid2(*arguments: object) -> None:
    """Exit code 1 alone says that a behaviour came about in no scene; the scenes are written all the same."""
    command = [sys.executable, "-m", "bridge.cli", *map(str, arguments), "-q"]
    result = subprocess.run(command, capture_output=True, cwd=ROOT, text=True)
    assert result.returncode == 0 or "came about in no scene" in result.stderr, result.stderr


@pytest.mark.slow
def test_viewer_shows_what_the_files_of_six_real_scenes_say(shared_data: Path, page: Page, tmp_path: Path) -> None:
    mix = "lane_change=0.4,overtake=0.1,left_turn=0.1,right_turn=0.1,straight=0.3"
    out, file = tmp_path / "out", tmp_path / "scenes.html"
    hid2("generate", shared_data / "av2", "-o", out, "--agents", 15, "--behaviours", mix, "--record", "gaps")
    hid2("view", out, "-o", file)
    page.open(file)
    page.until("$('cards').children.length")
    folders = sorted(path.parent for path in out.rglob("hid2_*.json"))
    assert len(folders) == 6
    for folder in folders:
        page.js(f"show(FACTS.findIndex((one) => one.id === '{folder.name}'))")
        assert list(differences(page, folder)) == []
    assert page.errors == []
