"""The same mistake ends alike: one line with thing, value, what was expected and the way out, and nothing written."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

Run = Callable[..., Any]


def test_scene_that_cannot_be_read_neither_meets_a_request_nor_hides_that_none_does(
    hid2: Run, data_scenes: dict[str, Path], copy_scene: Callable[..., Path], tmp_path: Path
) -> None:
    broken = copy_scene("arterial")
    next(broken.glob("log_map_archive_*.json")).write_text("{")
    result = hid2("generate", broken, data_scenes["curve"], "-o", tmp_path / "out", "--near", "nobody", "-q")
    assert result.returncode == 2
    assert "near 'nobody': can come about in none of the scenes looked at (1 of 2); " in result.stderr
    alone = hid2("generate", broken, "-o", tmp_path / "out", "--near", "nobody", "-q")
    assert alone.returncode == 1
    assert "not JSON" in alone.stderr


def test_out_with_scenes_of_another_request_takes_the_same_request_or_append(
    hid2: Run, data_scenes: dict[str, Path], tmp_path: Path
) -> None:
    root = tmp_path / "out"
    shared = ["generate", data_scenes["curve"], "-o", root, "-q"]
    first, other = [*shared, "--agents", 1], [*shared, "--agents", 2, "--seed", 4]
    assert hid2(*first).returncode == 0
    before = {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}
    for refused in (hid2(*other), hid2(*other, "--resume")):
        assert (refused.returncode, refused.stdout) == (2, "")
        assert refused.stderr == (
            f"hid2: error: {root}: holds scenes of another request (request.agents was 1, is 2, request.seed was 0, "
            "is 4); expected another OUT, the same request, or --append to add scenes to those there\n"
        )
    assert {path: path.read_bytes() for path in root.rglob("*") if path.is_file()} == before
    for taken in (first, [*first, "--variants", 2, "--resume"], [*other, "--append"], [*other, "--resume"]):
        assert hid2(*taken).returncode == 0
    assert len(list(root.rglob("scenario_*.parquet"))) == 3
    for path in root.rglob("hid2_*.json"):
        path.unlink()
    result = hid2(*shared, "--agents", 3)
    assert result.returncode == 2
    assert "(its configuration has another digest)" in result.stderr
