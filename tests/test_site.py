"""The site is built of the pages of the tree, without a network and without a warning."""

import runpy
import shutil
import subprocess
from pathlib import Path

import pytest

import bridge

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
def test_the_site_has_every_page_and_notebook_every_public_name_and_the_gallery(tmp_path: Path) -> None:
    """Sphinx takes each warning for an error, so that a link of a page to nothing fails here."""
    if not shutil.which("git") or subprocess.run(["git", "rev-parse"], cwd=ROOT, capture_output=True).returncode:
        pytest.skip("no git checkout: which files belong to the project cannot be told")
    runpy.run_path(str(ROOT / ".ci" / "site.py"))["build"](tmp_path / "site")
    pages = [
        path.relative_to(ROOT)
        for top in ("netconvert", "hid2", "bridge", "data")
        for path in (*(ROOT / top).rglob("*.md"), *(ROOT / top).rglob("*.ipynb"))
    ]
    assert len(pages) > 10
    missing = [page for page in pages if not (tmp_path / "site" / page.with_suffix(".html")).is_file()]
    assert missing == []
    names = (tmp_path / "site" / "api.html").read_text()
    assert [name for name in bridge.__all__ if f'id="bridge.{name}"' not in names] == []
    assert 'id="bridge.TrafficScene.judge"' in names
    assert "lane_change.time_gap_rear_s" in (tmp_path / "site" / "parameters.html").read_text()
    gallery = (tmp_path / "site" / "gallery.html").read_text()
    assert all(folder.name in gallery for folder in (ROOT / "data" / "av2").glob("*/*"))
    assert 'href="gallery.html"' in (tmp_path / "site" / "index.html").read_text()
