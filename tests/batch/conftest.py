"""Data sets to run batches on, and the faulty work of `faults.py`."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from served import Here
from written import copy_with_new_id

from bridge.batch.batch import Options, plan, run_batch
from bridge.recordings.sources import find_scenarios
from hid2.params import Config

HERE = Path(__file__).parent
ROOT = HERE.parents[1]


@pytest.fixture(scope="session", autouse=True)
def faults() -> Iterator[None]:
    """Let this process and its children import faults.py by name."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.syspath_prepend(str(HERE))
        yield


@pytest.fixture(scope="session")
def synthetic() -> list[Path]:
    """The scenario folders of data/av2."""
    return find_scenarios(ROOT / "data" / "av2")


@pytest.fixture
def make_data_set(tmp_path: Path, synthetic: list[Path]) -> Callable[..., list[Path]]:
    """Build a data set below tmp_path/source/val: copies of the synthetic scenes, each with an id of its own.

    faults: by number of the scene, see faults.py; "corrupt" cuts its parquet file.
    """

    def make(count: int, faults: dict[int, str] | None = None) -> list[Path]:
        folders = _copies(synthetic, tmp_path / "source" / "val", count)
        for number, fault in (faults or {}).items():
            if fault == "corrupt":
                parquet = next(folders[number].glob("*.parquet"))
                parquet.write_bytes(parquet.read_bytes()[:1000])
            else:
                (folders[number] / "FAULT").write_text(fault)
        return folders

    return make


@pytest.fixture(scope="session")
def finished_batch(synthetic: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a data set of three scenes in source/val and the finished batch of them in out."""
    place = tmp_path_factory.mktemp("finished")
    folders = _copies(synthetic, place / "source" / "val", 3)
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr("bridge.batch.engine.IsolatedProcess", Here)
        run_batch(plan(folders, Config()), place / "out", Options(function="faults:copies"))
    return place


def _copies(scenes: list[Path], root: Path, count: int) -> list[Path]:
    folders = [root / f"scene-{number:03d}" for number in range(count)]
    for number, folder in enumerate(folders):
        copy_with_new_id(scenes[number % len(scenes)], folder, f"{number:08d}-0000-4000-8000-000000000000")
    return folders
