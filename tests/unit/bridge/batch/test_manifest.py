"""manifest.csv survives what can happen to a file that is written all night, and what others may put in its place."""

import csv
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from bridge.batch.manifest import DONE, MAX_TEXT, QUARANTINED, Manifest, ManifestRow, files_sha256, read_manifest
from bridge.files import MAX_FILE_MB
from bridge.recordings.sources import source_files
from netconvert.errors import BatchError


def row(scenario: str, variant: int = 0, **values: object) -> ManifestRow:
    return ManifestRow(scenario, "val", variant, 0, QUARANTINED, config_sha256="c" * 64, version="1")._replace(**values)


def rows_of(path: Path) -> list[ManifestRow]:
    rows, unread = read_manifest(path)
    assert unread == 0
    return rows


def test_rows_come_back_with_their_types_and_text_that_a_spreadsheet_would_run_is_none_in_the_file(
    tmp_path: Path,
) -> None:
    manifest = Manifest(tmp_path)
    written = row("=cmd", 1, seed=3, city="@SUM(1)", reason="-2+3", seconds=1.25, placed=10, requested="max")
    written = written._replace(rejected='a "b", c (2); d (1)')
    manifest.add(written)
    assert rows_of(manifest.path) == [written]
    manifest.save()
    assert rows_of(manifest.path) == [written]
    with manifest.path.open(newline="", encoding="utf-8") as file:
        (read,) = csv.DictReader(file)
    assert (read["scenario"], read["city"], read["reason"]) == ("'=cmd", "'@SUM(1)", "'-2+3")
    assert list(read) == [*ManifestRow._fields, "check"]


def test_saved_file_is_sorted_whatever_the_order_of_the_work(tmp_path: Path) -> None:
    manifest = Manifest(tmp_path)
    for scenario, variant, placed in (("b", 0, 1), ("a", 10, 1), ("a", 2, 1), ("b", 0, 2)):
        manifest.add(row(scenario, variant, placed=placed))
    assert len(Manifest(tmp_path).rows) == 3, "a later row takes the place of the earlier one"
    manifest.save()
    saved = [(entry.scenario, entry.variant, entry.placed) for entry in rows_of(manifest.path)]
    assert saved == [("a", 2, 1), ("a", 10, 1), ("b", 0, 2)]


#: What happens to a manifest of five scenes, and which of them are lost.
DAMAGES: dict[str, tuple[Callable[[bytes], bytes], set[int]]] = {
    "a byte of a name": (lambda raw: raw.replace(b"scene-1", b"scenf-1"), {1}),
    "bytes that are no text": (lambda raw: raw.replace(b"scene-1", b"scene\xff1"), {1}),
    "a quote that does not end": (lambda raw: raw.replace(b"scene-1", b'"scene-1'), {1}),
    "two lines in one": (lambda raw: raw.replace(b"\nscene-2", b"scene-2"), {1, 2}),
    "zeros": (lambda raw: raw.replace(b"scene-1", b"\0" * 7), {1}),
    "a long text": (lambda raw: raw.replace(b"scene-1", b"x" * 300_000), {1}),
    "no header": (lambda raw: raw[raw.index(b"\n") + 1 :], set()),
    "a header twice": (lambda raw: raw[: raw.index(b"\n") + 1] + raw, set()),
    "cut": (lambda raw: raw[:-2], {4}),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_costs_the_lines_it_touches_and_makes_none_up(
    tmp_path: Path, name: str, caplog: pytest.LogCaptureFixture
) -> None:
    """No row is read that was not written, and what was read is written whole again."""
    manifest = Manifest(tmp_path)
    written = [row(f"scene-{number}", reason="a reason, with a comma") for number in range(5)]
    for one in written:
        manifest.add(one)
    change, lost = DAMAGES[name]
    manifest.path.write_bytes(change(manifest.path.read_bytes()))
    read = Manifest(tmp_path).rows
    assert read == [one for number, one in enumerate(written) if number not in lost]
    assert not lost or "cannot be read: their scenes are made again" in caplog.text
    assert rows_of(manifest.path) == read


@pytest.mark.parametrize("values", [
    {"status": DONE, "folder": "../elsewhere"}, {"status": DONE, "folder": "/etc"},
    {"bundle": "quarantine/../../x.zip"}, {"status": "finished"}, {"split": "../val"}, {"variant": -1},
    {"config_sha256": "short"}, {"status": DONE}, {"folder": "val/x"},
], ids=str)  # fmt: skip
def test_row_that_cannot_have_been_written_here_is_left_out(tmp_path: Path, values: dict[str, object]) -> None:
    """A manifest may come from anywhere: what it says is joined to no path outside OUT."""
    Manifest(tmp_path).add(row("a", **values))
    assert read_manifest(tmp_path / "manifest.csv") == ([], 1)


def test_long_and_wild_texts_do_not_keep_a_manifest_from_being_read(tmp_path: Path) -> None:
    Manifest(tmp_path).add(row("a\udcff", reason="x" * 150_000, city="line\nline\x1b[2J"))
    (read,) = rows_of(tmp_path / "manifest.csv")
    assert len(read.reason) == MAX_TEXT
    assert " ...(shortened)... " in read.reason
    assert (read.scenario, read.city) == ("a\\udcff", "line line\\x1b[2J")


def test_row_of_a_scene_that_is_not_there_any_more_is_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    manifest = Manifest(tmp_path)
    for name in ("a", "b"):
        (tmp_path / "val" / name).mkdir(parents=True)
        manifest.add(row(name, status=DONE, folder=f"val/{name}"))
    (tmp_path / "val" / "b").rmdir()
    assert [one.scenario for one in Manifest(tmp_path).rows] == ["a"]
    assert "1 rows left out: their folders are not there" in caplog.text


def test_something_else_of_that_name_is_said(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "manifest.csv")
    with pytest.raises(BatchError, match=r"manifest\.csv: not a regular file, expected a manifest"):
        Manifest(tmp_path)


def test_link_in_the_place_of_the_manifest_is_not_written_through(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "mine").write_text("mine\n")
    (tmp_path / "out" / "manifest.csv").symlink_to(tmp_path / "mine")
    Manifest(tmp_path / "out").add(row("a"))
    assert (tmp_path / "mine").read_text() == "mine\n"
    assert rows_of(tmp_path / "out" / "manifest.csv") == [row("a")]


def test_digest_depends_on_names_and_contents_only(tmp_path: Path) -> None:
    for name, content in (("a", "1"), ("b", "2")):
        (tmp_path / name).write_text(content)
    a, b = tmp_path / "a", tmp_path / "b"
    assert (before := files_sha256([a, b])) == files_sha256([b, a])
    b.write_text("3")
    assert files_sha256([a, b]) != before
    assert files_sha256([]) == ""


def test_digest_reads_no_pipes_and_no_giants(tmp_path: Path) -> None:
    """It is taken in the main process, which no time-out ends."""
    os.mkfifo(tmp_path / "scenario_a.parquet")
    (tmp_path / "log_map_archive_a.json").mkdir()
    assert source_files(tmp_path) == []
    giant = tmp_path / "agent_sizes.csv"
    giant.touch()
    os.truncate(giant, MAX_FILE_MB * 1_000_000 + 1)
    first = files_sha256(source_files(tmp_path))
    os.truncate(giant, 10**12)
    assert files_sha256(source_files(tmp_path)) != first
