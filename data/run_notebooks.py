"""Runs the notebooks in data/examples and writes their outputs: python data/run_notebooks.py [NOTEBOOK...].

Without Jupyter: the code of a notebook runs cell after cell in a process of its own, as it does there; what is printed,
the value of a last expression and figures become the outputs. The tests run them with `run` and compare the kinds of
outputs.
"""

import ast
import base64
import contextlib
import io
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

EXAMPLES = Path(__file__).parent / "examples"
#: Colours that a figure is reduced to.
_COLORS = 64


def run(notebook: Path, folder: Path) -> dict[str, Any]:
    """A notebook with the outputs that its cells have when they run in a folder; fails where a cell does."""
    command = [sys.executable, str(Path(__file__).resolve()), "--cells", str(notebook.resolve())]
    environment = os.environ | {"MPLBACKEND": "Agg"}
    result = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if result.returncode:
        raise RuntimeError(f"{notebook}: {result.stderr}")
    document: dict[str, Any] = json.loads(result.stdout)
    return document


def text_of(document: dict[str, Any]) -> str:
    """A notebook as it is kept: one format, no ids of runs."""
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"


def _with_outputs(document: dict[str, Any]) -> dict[str, Any]:
    names: dict[str, Any] = {"__name__": "__main__"}
    code = [cell for cell in document["cells"] if cell["cell_type"] == "code"]
    for number, cell in enumerate(code, 1):
        cell["execution_count"], cell["outputs"] = number, _outputs("".join(cell["source"]), names, number)
    return document


def _outputs(source: str, names: dict[str, Any], number: int) -> list[dict[str, Any]]:
    tree = ast.parse(source)
    shown = tree.body and isinstance(tree.body[-1], ast.Expr) and not source.rstrip().endswith(";")  # as in Jupyter
    last = tree.body.pop() if shown else None
    printed, value = io.StringIO(), None
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, f"cell {number}", "exec"), names)  # noqa: S102  # our notebooks
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), f"cell {number}", "eval"), names)  # noqa: S307
    outputs: list[dict[str, Any]] = []
    if lines := printed.getvalue().splitlines(keepends=True):
        outputs.append({"name": "stdout", "output_type": "stream", "text": lines})
    if value is not None:
        data: dict[str, Any] = {"text/plain": repr(value).splitlines(keepends=True)}
        if hasattr(value, "savefig"):
            data["image/png"] = _picture(value)
        if html := getattr(value, "_repr_html_", lambda: None)():
            data["text/html"] = html.splitlines(keepends=True)
        outputs.append({"data": data, "execution_count": number, "metadata": {}, "output_type": "execute_result"})
    return outputs + _figures()


def _figures() -> list[dict[str, Any]]:
    """Open figures as pictures, as Jupyter shows them; they are closed."""
    import matplotlib.pyplot as plt

    outputs: list[dict[str, Any]] = []
    for figure in map(plt.figure, plt.get_fignums()):
        data = {"image/png": _picture(figure), "text/plain": [repr(figure)]}
        outputs.append({"data": data, "metadata": {}, "output_type": "display_data"})
    plt.close("all")
    return outputs


def _picture(figure: Any) -> str:  # noqa: ANN401  # matplotlib is not imported here
    from make_pictures import write_small  # beside this file

    drawn, small = io.BytesIO(), io.BytesIO()
    figure.savefig(drawn, dpi=80, bbox_inches="tight")
    write_small(drawn, small, colors=_COLORS)
    return base64.b64encode(small.getvalue()).decode()


def main() -> None:
    """Run the notebooks named, or all."""
    if sys.argv[1:2] == ["--cells"]:
        with contextlib.redirect_stdout(sys.stderr):
            document = _with_outputs(json.loads(Path(sys.argv[2]).read_text(encoding="utf-8")))
        print(json.dumps(document))
        return
    for notebook in [Path(name) for name in sys.argv[1:]] or sorted(EXAMPLES.glob("*.ipynb")):
        with tempfile.TemporaryDirectory() as scratch:
            notebook.write_text(text_of(run(notebook, lay_out(Path(scratch)))), encoding="utf-8")
        print(notebook)


def lay_out(root: Path) -> Path:
    """A folder to run notebooks in, which sees the data as data/examples does, and keeps what they write."""
    folder = root / "data" / "examples"
    folder.mkdir(parents=True)
    for name in ("av2", "configs", "studies"):
        (root / "data" / name).symlink_to(EXAMPLES.parent / name)
    return folder


if __name__ == "__main__":
    main()
