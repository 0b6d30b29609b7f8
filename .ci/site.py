"""Builds the site from the pages and notebooks of the tree, offline: `.venv/bin/python .ci/site.py OUT` (extra `site`).

A page is where it is in the tree, so that links between pages hold; what they link to beside pages can be downloaded.
Any warning is an error.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[1]
INDEX = """# hid2-sumo

[Make scenes denser](bridge/generation/README.md), [look at them](bridge/pictures/README.md),
[measure them](bridge/evaluation/README.md), [ask a question of many runs](bridge/studies/README.md);
or hold a scene [in Python](bridge/PYTHON.md).

<a href="gallery.html">The synthetic scenes as `hid2 view` plays them</a>

```{toctree}
:maxdepth: 1
:glob:

README
*
**
```
"""
API = """# Public names

```{eval-rst}
.. automodule:: bridge
   :members:
```
"""
CONF = """
project, html_theme, extensions = "hid2-sumo", "furo", ["myst_nb", "sphinx.ext.autodoc"]
myst_heading_anchors, nb_execution_mode, autodoc_typehints, html_extra_path = 4, "off", "none", ["extra"]
"""


def build(out: Path) -> None:
    """Write the site into a folder. Errors: CalledProcessError where a page warns."""
    with TemporaryDirectory() as place:
        source = Path(place)
        tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout
        for name in tracked.splitlines():
            if not name.startswith((".ci", "tests/")):
                (source / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(ROOT / name, source / name)
        for name, text in (("index.md", INDEX), ("api.md", API), ("conf.py", CONF)):
            (source / name).write_text(text)
        (source / "extra").mkdir()
        view = ["-m", "bridge.cli", "view", "data/av2", "-q", "-o", str(source / "extra/gallery.html")]
        sphinx = ["-m", "sphinx", "-W", "-n", "--keep-going", "-q", "-b", "html", place, str(out)]
        for command in (view, sphinx):
            subprocess.run(
                [sys.executable, *command], cwd=ROOT, check=True, env={**os.environ, "PYTHONPATH": str(ROOT)}
            )


if __name__ == "__main__":
    build(Path(sys.argv[1]).resolve())
