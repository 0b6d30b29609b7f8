"""Files are there whole or not at all; those of others may be anything."""

import csv
import errno
import io
import os
from pathlib import Path

import pytest

from bridge import files
from netconvert.errors import DiskFullError, ExportError


def test_file_appears_when_all_is_written(tmp_path: Path) -> None:
    path = tmp_path / "folder" / "table.csv"
    with files.beside(path) as hidden:
        assert (hidden.parent, hidden.suffix) == (path.parent, path.suffix)
        hidden.write_text("new")
        assert not path.exists()
    assert [(entry.name, entry.read_text()) for entry in path.parent.iterdir()] == [("table.csv", "new")]
    with pytest.raises(ExportError, match=r"table.csv/folder: cannot be written \(Not a directory\)"):
        files.make_folder(path / "folder")


def test_file_stays_as_it_was_when_writing_fails(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    files.write_text(path, "old")
    for error, raised in ((OSError("disk full"), ExportError), (KeyboardInterrupt(), KeyboardInterrupt)):

        def fail(reason: BaseException = error) -> None:
            with files.beside(path) as hidden:
                hidden.write_text("half of it")
                raise reason

        with pytest.raises(raised):
            fail()
        assert [(entry.name, entry.read_text()) for entry in tmp_path.iterdir()] == [("table.csv", "old")]


def test_only_regular_files_of_bounded_size_are_read(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"x" * 1_000_000)
    assert len(files.read_regular(tmp_path / "file", most_mb=1)) == 1_000_000
    (tmp_path / "file").write_bytes(b"x" * 1_000_001)
    with pytest.raises(OSError, match="holds more than 1 MB"):
        files.read_regular(tmp_path / "file", most_mb=1)
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", tmp_path, Path(os.devnull)):
        with pytest.raises(OSError, match=r"not a regular file|Is a directory"):
            files.read_regular(path, most_mb=1)


@pytest.mark.parametrize("text", ["two  spaces", "a\n\tb", "\x1b[2J", "\udcff\u202e", "x" * 50, ""])
def test_text_on_one_line_is_bounded_printable_and_stays_as_it_is(text: str) -> None:
    """A long value in a message leaves what is expected to be read."""
    shown = files.one_line(text, most=20)
    assert len(shown) <= 20
    assert shown.isprintable()
    assert files.one_line(shown, most=20) == shown
    assert shown.encode("utf-8") is not None, "it is text for every file"
    shown = files.one_line(f"key = {'x' * 100_000}, expected a number", most=100)
    assert len(shown) == 100
    assert (shown[:10], shown[-19:]) == ("key = xxxx", ", expected a number")


def test_full_disk_is_told_from_other_failures() -> None:
    def raised(number: int) -> Exception:
        try:
            with files.explained(Path("out")):
                raise OSError(number, os.strerror(number))
        except ExportError as error:
            return error
        raise AssertionError

    assert isinstance(raised(errno.ENOSPC), DiskFullError)
    assert files.disk_error(raised(errno.EDQUOT)) is not None
    assert not isinstance(raised(errno.ENOTDIR), DiskFullError)
    assert files.disk_error(raised(errno.ENOTDIR)) is None


RUN = ("=cmd", "+cmd|' /C calc'!A0", "-2+3", "@SUM(A1)", "\t=1", "'=cmd", "-gen_0", "--")
NOT_RUN = (-1, -2.5, "-2.5", "+1e-07", "-inf", "-", "", "gen_0", "'quoted'", "a=b", None)


@pytest.mark.parametrize("value", [*RUN, *NOT_RUN])
def test_text_that_a_spreadsheet_would_run_goes_behind_an_apostrophe_and_comes_back(value: object) -> None:
    """Numbers and other texts stay as they are."""
    text = "" if value is None else str(value)
    ((_, cell),) = csv.reader(io.StringIO(files.table_text([["first", value]])))
    assert cell == (f"'{text}" if value in RUN else text)
    assert files.untabled(cell) == text


@pytest.mark.parametrize(
    ("name", "cell"), [(b"a/\xff\x1b[1m", r"a/\udcff\x1b[1m"), (b"=cmd", "'=cmd"), (b"a b", "a b")]
)
def test_path_is_text_that_any_table_takes(name: bytes, cell: str, tmp_path: Path) -> None:
    files.write_rows(tmp_path / "table.csv", ("path",), [[Path(os.fsdecode(name))]])
    assert (tmp_path / "table.csv").read_text().splitlines() == ["path", cell]
