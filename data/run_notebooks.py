"""Runs the notebooks in data/examples and writes their outputs: python data/run_notebooks.py [NOTEBOOK...].

As in Jupyter, with its kernel. The tests run them with `run` and compare the kinds of outputs.
"""

import base64
import io
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import nbformat
from make_pictures import write_small  # beside this file
from nbclient import NotebookClient

EXAMPLES = Path(__file__).parent / "examples"
#: Colours, and pixels of the longest side, that a figure is reduced to.
_COLORS, _WIDTH = 64, 800


def run(notebook: Path, folder: Path) -> nbformat.NotebookNode:
    """A notebook with the outputs that its cells have when they run in a folder. Errors: CellExecutionError."""
    document = nbformat.read(notebook, as_version=4)
    client = NotebookClient(document, resources={"metadata": {"path": str(folder)}}, record_timing=False)
    client.execute(env={name: value for name, value in os.environ.items() if name != "MPLBACKEND"})  # Jupyter's own
    document.metadata.language_info = {"name": "python"}  # of any version
    for cell in document.cells:
        for output in cell.get("outputs", ()):
            if picture := output.get("data", {}).get("image/png"):
                small = io.BytesIO()
                write_small(io.BytesIO(base64.b64decode(picture)), small, colors=_COLORS, width=_WIDTH)
                output.data["image/png"] = base64.b64encode(small.getvalue()).decode()
    return document


def lay_out(root: Path) -> Path:
    """A folder to run notebooks in, with all that `hid2 example` writes around it."""
    subprocess.run([sys.executable, "-m", "bridge.cli", "example", "-q", "-o", str(root / "data")], check=True)
    return root / "data" / "examples"


def main() -> None:
    """Run the notebooks named, or all."""
    for notebook in [Path(name) for name in sys.argv[1:]] or sorted(EXAMPLES.glob("*.ipynb")):
        with tempfile.TemporaryDirectory() as scratch:
            nbformat.write(run(notebook, lay_out(Path(scratch))), notebook)
        print(notebook)


if __name__ == "__main__":
    main()
