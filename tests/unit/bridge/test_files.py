"""Files are there whole or not at all."""

from pathlib import Path

import pytest

from bridge.files import beside, make_folder, write_text
from netconvert.errors import ExportError


def test_file_appears_when_all_is_written(tmp_path: Path) -> None:
    path = tmp_path / "folder" / "table.csv"
    with beside(path) as hidden:
        assert (hidden.parent, hidden.suffix) == (path.parent, path.suffix)
        hidden.write_text("new")
        assert not path.exists()
    assert [(entry.name, entry.read_text()) for entry in path.parent.iterdir()] == [("table.csv", "new")]


def test_file_stays_as_it_was_when_writing_fails(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    write_text(path, "old")
    for error in (OSError("disk full"), KeyboardInterrupt()):

        def fail(reason: BaseException = error) -> None:
            with beside(path) as hidden:
                hidden.write_text("half of it")
                raise reason

        with pytest.raises(type(error)):
            fail()
        assert [(entry.name, entry.read_text()) for entry in tmp_path.iterdir()] == [("table.csv", "old")]


def test_folder_that_cannot_be_made_is_explained(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ExportError, match=r"file/folder: cannot be written \(Not a directory\)"):
        make_folder(tmp_path / "file" / "folder")
