"""Renews requirements.txt: of everything that is needed, the newest version that the ranges in pyproject.toml allow.

By hand, in a checkout that was set up with `sh setup.sh tests`: `.venv/bin/python .ci/renew_pins.py`, then the tests.
"""

import re
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[1]
#: Versions and hashes of all extras and groups, of wheels for the Pythons and systems of pyproject.toml; no addresses.
EXPORT = ["--all-extras", "--all-groups", "--no-emit-project", "--no-header", "--no-annotate"]
#: What torch brings for CUDA: it names the versions itself, and the torch that setup.sh installs brings none of them.
LEFT_OUT = ("cuda-", "nvidia-", "triton")


def requirements(project: str) -> str:
    """requirements.txt for a pyproject.toml, as texts. Errors: CalledProcessError without network, or if none fits."""
    with TemporaryDirectory() as folder:
        (Path(folder) / "pyproject.toml").write_text(project)
        command = [ROOT / ".uv/bin/uv", "export", "-q", *EXPORT]
        exported = subprocess.run(command, cwd=folder, check=True, stdout=subprocess.PIPE, text=True).stdout
    entries = re.split(r"\n(?=\S)", exported)
    # No hashes of torch: the wheels of PyTorch's own list have others.
    entries = [entry.split(" \\\n")[0] if entry.startswith("torch==") else entry for entry in entries]
    return "\n".join(entry for entry in entries if not entry.startswith(LEFT_OUT)).strip() + "\n"


if __name__ == "__main__":
    (ROOT / "requirements.txt").write_text(requirements((ROOT / "pyproject.toml").read_text()))
