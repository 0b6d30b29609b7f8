"""Bundles: what is written is read back; what others made is data, and stays in its folder."""

import json
import os
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from bundles import OWN, members, zipped

from bridge.batch.isolation import Failure
from bridge.batch.quarantine import MAX_MEMBERS, Bundle, read_bundle, write_bundle
from hid2.params import Config
from netconvert.errors import BatchError

FAILURE = Failure("exception", "ValueError: \x1b[2J no", "Traceback\n  line\n")


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    folder = tmp_path / "source" / "val" / "scene"
    folder.mkdir(parents=True)
    (folder / "scenario_x.parquet").write_bytes(b"rows")
    return folder


def bundle_of(scene: Path, **changes: Any) -> Bundle:
    values = {"folder": scene, "config": Config(), "variant": 1, "timeout_s": 5.0, "function": OWN}
    return Bundle(**(values | {"failure": FAILURE, "version": "1"} | changes))


def test_bundle_comes_back_a_reason_without_end_shortened_with_its_details(scene: Path, tmp_path: Path) -> None:
    write_bundle(bundle_of(scene), tmp_path / "b.zip")
    read = read_bundle(tmp_path / "b.zip", tmp_path / "into")
    assert read.folder == tmp_path / "into" / "val" / "scene"
    assert [path.name for path in read.folder.iterdir()] == ["scenario_x.parquet"]
    assert (read.config, read.variant, read.timeout_s, read.function) == (Config(), 1, 5.0, OWN)
    assert read.failure == Failure("exception", "ValueError: \\x1b[2J no", "Traceback\n  line\n")
    assert read.failure.message.isprintable(), "nothing that a terminal obeys"
    write_bundle(bundle_of(scene, failure=Failure("error", "x" * 150_000, "x" * 150_000)), tmp_path / "b.zip")
    failure = read_bundle(tmp_path / "b.zip", tmp_path / "again").failure
    assert len(failure.message) < 10_000 < 100_000 < len(failure.details)


def test_pipes_giants_and_hidden_files_of_a_scene_are_left_out_and_named(scene: Path, tmp_path: Path) -> None:
    os.mkfifo(scene / "pipe")
    (scene / ".hidden").touch()
    for name in "abc":  # of these two are as much as a bundle takes
        (scene / name).write_bytes(bytes(25_000_000))
    (scene / "giant").touch()
    os.truncate(scene / "giant", 10**11)
    write_bundle(bundle_of(scene), tmp_path / "b.zip")
    with zipfile.ZipFile(tmp_path / "b.zip") as archive:
        assert json.loads(archive.read("request.json"))["left_out"] == [".hidden", "c", "giant", "pipe"]
    held = read_bundle(tmp_path / "b.zip", tmp_path / "into").folder.iterdir()
    assert sorted(path.name for path in held) == ["a", "b", "scenario_x.parquet"]


def craft(path: Path, files: dict[str, bytes], *, compression: int = zipfile.ZIP_DEFLATED) -> Path:
    path.write_bytes(zipped(files, compression=compression))
    return path


REQUESTS: dict[str, tuple[dict[str, Any], str]] = {
    "split upwards": ({"split": "../../outside"}, "split"),
    "scenario upwards": ({"scenario": "../../outside"}, "name '../../outside'"),
    "scenario with a zero": ({"scenario": "a\0b"}, "name"),
    "another function": ({"function": "os:system"}, r"'os:system', which is none of hid2's: .* --function os:system"),
    "a time-out of NaN": ({"timeout_s": float("nan")}, "timeout_s"),
    "a time-out of nothing": ({"timeout_s": -1}, "timeout_s"),
    "a variant below 0": ({"variant": -1}, "variant"),
    "an unknown parameter": ({"config": {"no": 1}}, "unknown key 'no'"),
    "a parameter of NaN": ({"config": {"limits": {"min_radius_m": float("nan")}}}, "limits|JSON"),
    "another format": ({"format": 2}, "format"),
    "a field more": ({"run": "me"}, "run"),
}


@pytest.mark.parametrize("name", REQUESTS)
def test_request_of_a_crafted_bundle_is_refused_in_one_line(tmp_path: Path, name: str) -> None:
    changes, said = REQUESTS[name]
    refused(craft(tmp_path / "b.zip", members(**changes)), said)


def refused(path: Path, said: str) -> None:
    """Refused in one line, with nothing but an empty folder left."""
    into = path.parent / "into"
    with pytest.raises(BatchError, match=rf"b\.zip: not a bundle of hid2 that can be run \(.*({said})") as caught:
        read_bundle(path, into)
    assert "\n" not in str(caught.value)
    assert [entry.name for entry in path.parent.iterdir() if entry.name != "into"] == ["b.zip"]
    assert [entry for entry in into.rglob("*") if not entry.is_dir()] == []


def _encrypted(path: Path) -> None:
    """The flags of the last member, in its own header and in the directory."""
    craft(path, members())
    raw = bytearray(path.read_bytes())
    for signature, offset in ((b"PK\3\4", 6), (b"PK\1\2", 8)):
        at = raw.rindex(signature) + offset
        raw[at : at + 2] = struct.pack("<H", 1)
    path.write_bytes(raw)


def _twice(path: Path) -> None:
    craft(path, members())
    with pytest.warns(UserWarning, match="Duplicate name"), zipfile.ZipFile(path, "a") as archive:
        archive.writestr("request.json", b"{}")


ARCHIVES: dict[str, tuple[Callable[[Path], object], str]] = {
    "a bomb": (
        lambda p: craft(p, members() | {"scene/zeros": bytes(130_000_000)}),
        "unpacks to 130 MB, expected at most 128 MB",
    ),
    "a large request": (lambda p: craft(p, members() | {"request.json": bytes(2_000_000)}), "more than 1 MB"),
    "large details": (lambda p: craft(p, members() | {"details.txt": bytes(5_000_000)}), "more than 4 MB"),
    "a list without end": (lambda p: craft(p, members(left_out=["x"] * 60_000)), "at most 64 items"),
    "many files": (lambda p: craft(p, members() | {f"scene/{k}": b"" for k in range(MAX_MEMBERS)}), "68 files in it"),
    "another compression": (lambda p: craft(p, members(), compression=zipfile.ZIP_LZMA), "compression 14"),
    "encrypted": (_encrypted, "is encrypted"),
    "a file twice": (_twice, "is in it twice"),
    "a file upwards": (lambda p: craft(p, members() | {"scene/../../x": b"x"}), r"name '\.\./\.\./x'"),
    "an absolute file": (lambda p: craft(p, members() | {"scene//etc/x": b"x"}), "name '/etc/x'"),
    "a hidden file": (lambda p: craft(p, members() | {"scene/.x": b"x"}), r"name '\.x'"),
    "a file beside": (lambda p: craft(p, members() | {"setup.py": b"x"}), "file 'setup.py'"),
    "no failure": (lambda p: craft(p, {"request.json": members()["request.json"]}), "no 'failure.json'"),
    "deep JSON": (lambda p: craft(p, members() | {"request.json": b"[" * 100_000}), "the file: Invalid JSON"),
    "details that are no text": (lambda p: craft(p, members() | {"details.txt": b"\xff"}), "invalid start byte"),
    "cut": (lambda p: p.write_bytes(craft(p, members()).read_bytes()[:-30]), "not a zip file"),
    "a pipe": (os.mkfifo, "not a regular file"),
}


@pytest.mark.parametrize("name", ARCHIVES)
def test_crafted_archive_is_refused_in_one_line(tmp_path: Path, name: str) -> None:
    make, said = ARCHIVES[name]
    make(tmp_path / "b.zip")
    refused(tmp_path / "b.zip", said)


@pytest.mark.parametrize(
    ("changes", "name"),
    [({"function": "mine:work"}, "mine:work"), ({"config": {"lane_change": {"rule": "mine:accept"}}}, "mine:accept")],
)
def test_own_function_is_agreed_to_by_name(tmp_path: Path, changes: dict[str, Any], name: str) -> None:
    """Nothing of a bundle, nor of its configuration, is imported without a word of who runs it."""
    path = craft(tmp_path / "b.zip", members(**changes))
    refused(path, f"--function {name}")
    agreed = read_bundle(path, tmp_path / "again", functions={name})
    assert name in (agreed.function, agreed.config.lane_change.rule)
    with pytest.raises(BatchError):
        read_bundle(path, tmp_path / "third", functions={"mine:other"})
