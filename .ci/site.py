"""Builds the site from the pages and notebooks of the tree, offline: `.venv/bin/python .ci/site.py OUT` (extra `site`).

A page is where it is in the tree, so that links between pages hold; what they link to beside pages can be downloaded.
Any warning is an error. `.ci/site/` has its front page and settings.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[1]


def build(out: Path) -> None:
    """Write the site into a folder. Errors: CalledProcessError where a page warns."""
    sys.path.insert(0, str(ROOT))
    from bridge.config import ParameterRow, describe_config

    with TemporaryDirectory() as place:
        source = Path(place)
        tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout
        for name in tracked.splitlines():
            if not name.startswith((".ci", "tests/")):
                (source / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(ROOT / name, source / name)
        rows = [" | ".join(str(part).replace("|", "\\|") for part in row) for row in describe_config()]
        head = " | ".join(ParameterRow._fields)
        parameters = "\n".join(["# Parameters\n", head, " | ".join("-" for _ in ParameterRow._fields), *rows, ""])
        (source / "parameters.md").write_text(parameters)
        shutil.copytree(ROOT / ".ci" / "site", source, dirs_exist_ok=True)
        (source / "extra").mkdir()
        view = ["-m", "bridge.cli", "view", "data/av2", "-q", "-o", str(source / "extra/gallery.html")]
        sphinx = ["-m", "sphinx", "-W", "-n", "--keep-going", "-q", "-b", "html", place, str(out)]
        for command in (view, sphinx):
            subprocess.run(
                [sys.executable, *command], cwd=ROOT, check=True, env={**os.environ, "PYTHONPATH": str(ROOT)}
            )


if __name__ == "__main__":
    build(Path(sys.argv[1]).resolve())
