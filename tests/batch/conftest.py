"""Data sets to run batches on, and the faulty work of `faults.py`."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bridge.scenario import find_scenarios

HERE = Path(__file__).parent
ROOT = HERE.parents[1]


@pytest.fixture(autouse=True)
def faults(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let this process and its children import faults.py by name."""
    monkeypatch.syspath_prepend(str(HERE))


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
        folders = []
        for number in range(count):
            folder = tmp_path / "source" / "val" / f"scene-{number:03d}"
            _copy_with_new_id(synthetic[number % len(synthetic)], folder, f"{number:08d}-0000-4000-8000-000000000000")
            fault = (faults or {}).get(number)
            if fault == "corrupt":
                parquet = next(folder.glob("*.parquet"))
                parquet.write_bytes(parquet.read_bytes()[:1000])
            elif fault:
                (folder / "FAULT").write_text(fault)
            folders.append(folder)
        return folders

    return make


def _copy_with_new_id(source: Path, folder: Path, new_id: str) -> None:
    folder.mkdir(parents=True)
    table = pq.read_table(next(source.glob("scenario_*.parquet")))
    index = table.schema.get_field_index("scenario_id")
    column = pa.array([new_id] * table.num_rows, table.schema.field(index).type)
    pq.write_table(table.set_column(index, "scenario_id", column), folder / f"scenario_{new_id}.parquet")
    shutil.copyfile(next(source.glob("log_map_archive_*.json")), folder / f"log_map_archive_{new_id}.json")
