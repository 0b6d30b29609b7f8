"""Renews the pins in pyproject.toml: of everything that is needed, the newest version that the ranges there allow.

By hand, in a checkout that was set up with `sh setup.sh tests`: `.venv/bin/python .ci/renew_pins.py`, then the tests.
"""

import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[1]
BEGIN, END = "constraint-dependencies = [\n", "\n]\n"
#: What torch brings for CUDA: it names the versions itself, and the torch that setup.sh installs brings none of them.
LEFT_OUT = ("cuda-", "nvidia-", "triton")


def renewed(project: str) -> str:
    """The text of a pyproject.toml with new pins. Errors: CalledProcessError without network, or where nothing fits."""
    before, rest = project.split(BEGIN)
    _, after = rest.split(END, 1)
    compiling = ["pip", "compile", "-q", "--universal", "--python-version", "3.11", "--no-header", "--no-annotate"]
    with TemporaryDirectory() as folder:
        (Path(folder) / "pyproject.toml").write_text(before + BEGIN + "]\n" + after)
        command = [ROOT / ".uv/bin/uv", *compiling, "--all-extras", "--group", "dev", "pyproject.toml"]
        pins = subprocess.run(command, cwd=folder, check=True, stdout=subprocess.PIPE, text=True).stdout
    listed = [f'    "{pin}",' for pin in pins.splitlines() if not pin.startswith(LEFT_OUT)]
    return before + BEGIN + "\n".join(listed) + END + after


if __name__ == "__main__":
    file = ROOT / "pyproject.toml"
    file.write_text(renewed(file.read_text()))
