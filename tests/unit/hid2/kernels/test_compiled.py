"""Compiled functions: kept for the next process, compiled again when a file of the room changes, by nothing else."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hid2.kernels.compile import make_ready
from hid2.kernels.compiled import KERNELS

ROOT = Path(__file__).parents[4]

CALLED = '''"""Called."""

from hid2.kernels.compiled import inner


@inner
def called(x: float) -> float:
    return x + {value}
'''
CALLER = '''"""Calls it."""

from hid2.kernels.called import called
from hid2.kernels.compiled import kernel


@kernel("(f8,)")
def caller(x: float) -> float:
    return called(x)
'''
RUN = "from hid2.kernels.caller import caller; print(caller(1.0), sum(caller.stats.cache_hits.values()))"


@pytest.fixture
def room(tmp_path: Path) -> Path:
    """A copy of the room with two kernels of our own, one of which calls the other one."""
    folder = tmp_path / "hid2" / "kernels"
    folder.mkdir(parents=True)
    (tmp_path / "hid2" / "__init__.py").write_text("")
    for name in ("__init__.py", "compiled.py", "compile.py"):
        shutil.copy(ROOT / "hid2" / "kernels" / name, folder)
    (folder / "called.py").write_text(CALLED.format(value=1))
    (folder / "caller.py").write_text(CALLER)
    return folder


def run(room: Path, *arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = {"PATH": os.environ["PATH"], "HOME": str(room.parents[1]), "PYTHONDONTWRITEBYTECODE": "1"} | variables
    command = [sys.executable, *(arguments or ("-c", RUN))]
    done = subprocess.run(command, cwd=room.parents[1], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done


def test_kernel_is_kept_for_the_next_process_until_a_file_of_the_room_changes(room: Path) -> None:
    """The caller's own file is the same: numba itself would go on with the old one. What is outside is no matter.

    Set-up compiles all of it once, and says so.
    """
    compile_all = ("-m", "hid2.kernels.compile")
    assert run(room, *compile_all).stderr == "hid2: compiling inner loops, which takes a minute\n"
    assert run(room, *compile_all).stderr == ""
    (room.parent / "__init__.py").write_text('"""Changed."""\n')
    (room.parent / "params.py").write_text('"""New."""\n')
    assert run(room).stdout.split() == ["2.0", "1"]
    (room / "called.py").write_text(CALLED.format(value=2))
    assert run(room).stdout.split() == ["3.0", "0"]
    assert run(room).stdout.split() == ["3.0", "1"]


def test_code_is_kept_elsewhere_where_sources_cannot_be_written_and_runs_where_nothing_can(room: Path) -> None:
    """Where NUMBA_CACHE_DIR says; also for root, since a file is where the folder would be."""
    (room / "__pycache__").write_text("")
    chosen = room.parents[1] / "chosen"
    assert run(room, NUMBA_CACHE_DIR=str(chosen)).stdout.split() == ["2.0", "0"]
    assert run(room, NUMBA_CACHE_DIR=str(chosen)).stdout.split() == ["2.0", "1"]
    assert list(chosen.rglob("*.nbi"))
    nothing = room.parents[1] / "nothing"
    nothing.write_text("")
    places = {"HOME": str(nothing), "XDG_CACHE_HOME": str(nothing)}
    assert run(room, **places).stdout.split() == ["2.0", "0"]
    run(room, "-m", "hid2.kernels.compile", **places)


#: Generates and measures a scene; prints what each kernel was called with that was not compiled, and if it was called.
USES = """
import json, sys
from pathlib import Path
from bridge.evaluation.scene_metrics import measure_folder
from bridge.generation.generate import generate
from bridge.recordings.scenario import read_scenario
from hid2.kernels.compile import make_ready
from hid2.kernels.compiled import KERNELS
from hid2.params import Config, Limits, Request
make_ready()
folder = Path(sys.argv[1])
generate(read_scenario(folder), Config(request=Request(agents=5)))
measure_folder(folder)
missed = {one.__name__: [str(types) for types in one.stats.cache_misses] for one, _ in KERNELS}
json.dump([missed, [bool(one.stats.cache_hits) for one, _ in KERNELS]], sys.stdout)
"""


def test_kernels_are_compiled_for_the_types_that_they_are_called_with(data_scenes: dict[str, Path]) -> None:
    """A scene generated and measured compiles nothing of the room beyond what set-up has compiled.

    In a process of its own: other tests call kernels with arrays of their own making.
    """
    make_ready()
    command = [sys.executable, "-c", USES, str(data_scenes["intersection"])]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300)
    missed, called = json.loads(done.stdout)
    assert {name: types for name, types in missed.items() if types} == {}
    assert sum(called) > len(called) / 2


def test_compiled_code_is_in_the_room_alone() -> None:
    """A kernel elsewhere would be in no digest, and none is compiled by set-up without its types."""
    outside = {
        path.relative_to(ROOT).as_posix()
        for package in ("netconvert", "hid2", "bridge")
        for path in (ROOT / package).rglob("*.py")
        if path.parent.name != "kernels" and "njit(" in path.read_text()
    }
    assert outside == set()
    assert [dispatcher.__name__ for dispatcher, signatures in KERNELS if not signatures] == []
