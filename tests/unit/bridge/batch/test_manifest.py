"""manifest.csv survives what can happen to a file that is written all night."""

from pathlib import Path

from bridge.batch.manifest import DONE, Manifest, ManifestRow, files_sha256, read_manifest


def row(scenario: str, variant: int = 0, **values: object) -> ManifestRow:
    return ManifestRow(scenario, "val", variant, 0, DONE, config_sha256="c", version="1")._replace(**values)


def test_rows_come_back_with_their_types(tmp_path: Path) -> None:
    manifest = Manifest(tmp_path)
    written = row("a", 1, seconds=1.25, placed=10, requested="max", rejected='a "b", c (2); d (1)')
    manifest.add(written)
    assert read_manifest(manifest.path) == [written]


def test_later_row_takes_the_place_of_the_earlier(tmp_path: Path) -> None:
    manifest = Manifest(tmp_path)
    manifest.add(row("a", placed=1))
    manifest.add(row("a", placed=2))
    assert [entry.placed for entry in manifest.rows] == [2]
    assert [entry.placed for entry in Manifest(tmp_path).rows] == [2]


def test_saved_file_is_sorted_whatever_the_order_of_the_work(tmp_path: Path) -> None:
    manifest = Manifest(tmp_path)
    for scenario, variant in (("b", 0), ("a", 10), ("a", 2)):
        manifest.add(row(scenario, variant))
    manifest.save()
    assert [(entry.scenario, entry.variant) for entry in read_manifest(manifest.path)] == [
        ("a", 2),
        ("a", 10),
        ("b", 0),
    ]


def test_line_that_was_cut_is_left_out(tmp_path: Path) -> None:
    manifest = Manifest(tmp_path)
    manifest.add(row("a"))
    manifest.add(row("b"))
    text = manifest.path.read_text()
    for cut in range(len(text) - 20, len(text) - 1):
        manifest.path.write_text(text[:cut])
        rows = {entry.scenario: entry for entry in read_manifest(manifest.path)}
        assert rows["a"] == row("a")
        assert rows.get("b") != row("b"), "a row that is not whole is not taken for the whole one"


def test_foreign_file_gives_no_rows(tmp_path: Path) -> None:
    (tmp_path / "manifest.csv").write_text("scenario,other\na,b\n")
    assert Manifest(tmp_path).rows == []


def test_digest_depends_on_names_and_contents_only(tmp_path: Path) -> None:
    for name, content in (("a", "1"), ("b", "2")):
        (tmp_path / name).write_text(content)
    a, b = tmp_path / "a", tmp_path / "b"
    assert files_sha256([a, b]) == files_sha256([b, a])
    before = files_sha256([a, b])
    b.write_text("3")
    assert files_sha256([a, b]) != before
    assert files_sha256([]) == ""
