"""The notebooks run on the synthetic scenes, and are kept with outputs of the same kinds."""

import json
import runpy
from pathlib import Path

import nbformat
import pytest
from nbclient.exceptions import CellExecutionError

DATA = Path(__file__).parents[3] / "data"
NOTEBOOKS = sorted(path.name for path in (DATA / "examples").glob("*.ipynb"))
TOOLS = runpy.run_path(str(DATA / "run_notebooks.py"))


def kinds(document):
    """For each cell of code what it puts out, without the values: those change with the driving."""
    return [
        [(output["output_type"], sorted(output.get("data", {}))) for output in cell["outputs"]]
        for cell in document["cells"]
        if cell["cell_type"] == "code"
    ]


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name.startswith("first") else [pytest.mark.slow]) for name in NOTEBOOKS]
)
def test_notebook_runs_and_is_kept_with_its_outputs(name, tmp_path):
    notebook = DATA / "examples" / name
    kept = json.loads(notebook.read_text(encoding="utf-8"))
    made = TOOLS["run"](notebook, TOOLS["lay_out"](tmp_path))
    assert kinds(kept) == kinds(made), "write them anew: .venv/bin/python data/run_notebooks.py"
    assert notebook.stat().st_size < 300_000  # a scene that shows itself has 100,000


def test_there_are_three_and_a_failing_cell_is_told(tmp_path):
    assert NOTEBOOKS == ["evaluation.ipynb", "first_scene.ipynb", "study.ipynb"]
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("1 / 0", id="one")])
    nbformat.write(notebook, tmp_path / "bad.ipynb")
    with pytest.raises(CellExecutionError, match="ZeroDivisionError"):
        TOOLS["run"](tmp_path / "bad.ipynb", tmp_path)
