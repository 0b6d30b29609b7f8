"""Commands that are interrupted at moments that events name."""

import csv
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest
from interrupted import Command, damaged, faults, leftovers

from bridge.interruption import remove_abandoned

Script = Callable[[str], subprocess.Popen[str]]
#: Stops every Python process of a command where it imports a module, and says so by a file.
HOOK = """
import os, sys, time
class Stop:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name == os.environ["STOP_AT"]:
            open(os.environ["STOPPED"], "w").close()
            time.sleep(600)
sys.meta_path.insert(0, Stop)
"""


@pytest.mark.parametrize(
    ("number", "module", "arguments"),
    [
        (signal.SIGINT, "bridge.cli.commands", ["--version"]),
        (signal.SIGTERM, "typer", ["config"]),
        (signal.SIGINT, "numpy", ["net", "SCENE", "-o", "out"]),
        (signal.SIGINT, "bridge.batch.scene_work", ["generate", "SCENE", "-o", "out", "-j", "2"]),  # of the scene
        (signal.SIGTERM, "bridge.batch.scene_work", ["generate", "SCENE", "-o", "out"]),
    ],
)
def test_command_is_interrupted_in_an_import(
    data_scenes: dict[str, Path], tmp_path: Path, number: signal.Signals, module: str, arguments: list[str]
) -> None:
    (tmp_path / "hook").mkdir()
    (tmp_path / "hook" / "sitecustomize.py").write_text(HOOK)
    stopped, scene = tmp_path / "stopped", str(data_scenes["curve"])
    environment = {"PYTHONPATH": str(tmp_path / "hook"), "STOP_AT": module, "STOPPED": str(stopped)}
    command = Command([scene if word == "SCENE" else word for word in arguments], tmp_path, environment)
    command.wait_for(stopped.exists)
    command.send(number, to_group=number == signal.SIGINT)
    assert faults(command.left(), number, tmp_path / "out") == []


def is_driving(command: Command) -> bool:
    return any(command.scratch.glob(".hid2-*/hid2-scene-*/hid2-sumo-*"))


def is_filming(command: Command) -> bool:
    return any(child.name().startswith("ffmpeg") for child in psutil.Process(command.process.pid).children())


@pytest.mark.parametrize(
    ("arguments", "event"),
    [
        (["generate", "-o", "out", "-j", "2", "--variants", "50", "-q"], is_driving),
        (["render", "-o", "out/film.mp4", "-q"], is_filming),
    ],
)
def test_command_is_interrupted_at_work_as_by_a_terminal(
    data_scenes: dict[str, Path], tmp_path: Path, arguments: list[str], event: Callable[[Command], bool]
) -> None:
    """Child processes that get the signal too say nothing of it."""
    command = Command([*arguments, data_scenes["curve"]], tmp_path)
    command.wait_for(lambda: event(command))
    command.send(signal.SIGINT, to_group=True)
    left = command.left()
    assert faults(left, signal.SIGINT, tmp_path / "out") == []
    assert left.stderr == "hid2: interrupted; nothing half-written is left\n"


def test_batch_says_what_is_done_and_goes_on(data_scenes: dict[str, Path], tmp_path: Path) -> None:
    """Interrupted when the variants of one scene are done, and in the manifest, and those of the other are not."""
    scenes = data_scenes["curve"], data_scenes["intersection"]
    arguments = ["generate", *scenes, "-o", "out", "--agents", "1", "--variants", "6"]
    command = Command([*arguments, "-v"], tmp_path)
    command.wait_for(lambda: " placed, " in command.said())
    command.send(signal.SIGTERM, to_group=False)
    left = command.left()
    assert faults(left, signal.SIGTERM, tmp_path / "out") == []
    assert left.stderr.endswith("finished scenes are in out/manifest.csv; continue with --resume\n")
    made = len((tmp_path / "out" / "manifest.csv").read_text().splitlines()) - 1
    assert 1 <= made < 12
    assert Command([*arguments, "--resume"], tmp_path).left().code == 0
    with (tmp_path / "out" / "manifest.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["status"] for row in rows] == ["done"] * 12
    assert {path.name for path in (tmp_path / "out").glob("*/*")} == {Path(row["folder"]).name for row in rows}


def test_what_a_killed_command_leaves_is_removed_by_the_next_one(data_scenes: dict[str, Path], tmp_path: Path) -> None:
    film = Command(["render", data_scenes["curve"], "-o", "out/film.mp4"], tmp_path)
    film.wait_for(lambda: is_filming(film))
    film.send(signal.SIGKILL, to_group=True)
    left = film.left()
    assert (left.code, left.processes, len(left.temporary)) == (-signal.SIGKILL, [], 1)
    assert any("hidden: " in fault for fault in damaged(tmp_path / "out"))
    for path in (tmp_path / "out").iterdir():
        os.utime(path, (1.0, 1.0))  # what is empty is left for a moment, as its process may be about to write it
    left = Command(["make", "corridor", "-o", "out"], tmp_path).left()
    assert (left.code, leftovers(left), damaged(tmp_path / "out")) == (0, [], [])


#: A process as that of a command, which waits until it is ended.
SCRIPT = """
import signal, sys, threading, time
from pathlib import Path
from bridge.interruption import end_when_interrupted, hidden_file, hidden_folder, tidied
signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
end_when_interrupted()
{}
"""


@pytest.fixture
def script(tmp_path: Path) -> Iterator[Script]:
    """script(text): a process that has written its first line."""
    started: list[subprocess.Popen[str]] = []
    (tmp_path / "tmp").mkdir()

    def start(text: str) -> subprocess.Popen[str]:
        environment = os.environ | {"TMPDIR": str(tmp_path / "tmp")}
        command = [sys.executable, "-c", SCRIPT.format(text)]
        pipe = subprocess.PIPE
        process = subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, cwd=tmp_path, env=environment)
        started.append(process)
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


def test_second_signal_ends_at_once(tmp_path: Path, script: Script) -> None:
    process = script(
        "with tidied(lambda: (print('tidying', flush=True), time.sleep(600))):\n print('ready', flush=True)\n"
        " time.sleep(600)"
    )
    process.send_signal(signal.SIGINT)
    assert process.stdout is not None
    assert process.stdout.readline() == "tidying\n"
    process.send_signal(signal.SIGINT)
    assert process.communicate() == ("", "")
    assert process.returncode == 130
    assert len(list((tmp_path / "tmp").iterdir())) == 1, "nothing more was tidied"


def test_lock_that_the_interrupted_code_holds_stops_nothing(tmp_path: Path, script: Script) -> None:
    process = script(
        "import bridge.interruption\nbridge.interruption._STUCK_S = 0.2\n"
        "lock = threading.Lock()\nwith hidden_folder(Path('.')), tidied(lock.acquire), lock:\n"
        " print('ready', flush=True)\n time.sleep(600)"
    )
    process.send_signal(signal.SIGTERM)
    assert process.communicate() == ("", "hid2: interrupted; nothing half-written is left\n")
    assert process.returncode == 143
    assert [*(tmp_path / "tmp").iterdir(), *tmp_path.glob(".*")] == []


def test_signal_that_does_not_wake_the_main_thread_is_not_lost(script: Script) -> None:
    """Another thread gets it, as if it had come just before the main one began to wait."""
    process = script(
        "threading.Thread(target=time.sleep, args=(600,), daemon=True).start()\n"
        "signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])\nprint('ready', flush=True)\ntime.sleep(600)"
    )
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    assert process.returncode == 130


def test_children_end_with_the_command_whatever_started_them(script: Script) -> None:
    process = script(
        "import subprocess\n"
        "child = subprocess.Popen([sys.executable, '-c', \"print('ready', flush=True); input()\"],"
        " stdin=subprocess.PIPE, start_new_session=True)\ntime.sleep(600)"
    )
    (child,) = psutil.Process(process.pid).children()
    process.send_signal(signal.SIGTERM)
    process.wait()
    assert not child.is_running()


def test_what_is_being_written_is_removed_only_when_its_process_is_gone(tmp_path: Path, script: Script) -> None:
    (tmp_path / "below").mkdir()
    process = script(
        "with hidden_folder(Path('.')) as folder, hidden_file(Path('below'), '.csv') as file:\n"
        " (folder / 'new').mkdir()\n file.write_text('half')\n print('ready', flush=True)\n time.sleep(600)"
    )
    (tmp_path / ".hid2-mine").touch()
    found = sorted(tmp_path.rglob(".hid2-*"))
    remove_abandoned(tmp_path, "below")
    assert sorted(tmp_path.rglob(".hid2-*")) == found
    process.kill()
    process.wait()
    remove_abandoned(tmp_path, "below")
    assert sorted(tmp_path.glob(".*")) == [tmp_path / ".hid2-mine"]
    assert list((tmp_path / "below").iterdir()) == []


def test_what_another_command_is_about_to_lock_stays(tmp_path: Path) -> None:
    """Between making and locking it: many commands start at once on a node, and each looks for what is abandoned."""
    folder, file = tmp_path / f".hid2-{0:016x}", tmp_path / f".hid2-{1:016x}.csv"
    folder.mkdir()
    file.touch()
    remove_abandoned(tmp_path)
    assert sorted(tmp_path.iterdir()) == [folder, file]
    for path in (folder, file):  # made a while ago
        os.utime(path, (0.0, 0.0))
    remove_abandoned(tmp_path)
    assert list(tmp_path.iterdir()) == []
