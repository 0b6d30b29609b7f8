"""Where the scenes are: the synthetic ones in data/, the real ones beside the checkout; copies of them to
spoil, and hand-made generated tracks, so that export and validation are tested without a simulation.
"""

import os
import shutil
import signal
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from pkgutil import resolve_name

import pytest
from browser import Page, chromium

ROOT = Path(__file__).parents[1]
#: A shell that puts a command in the background has it ignore Ctrl-C, and so all that it starts: tests send Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)

REAL_IDS = (
    "0a0af725-fbc3-41de-b969-3be718f694e2",
    "3b3570b4-7b0b-3268-a571-b0889dbf40b6",
    "7fab2350-7eaf-3b7e-a39d-6937a4c1bede",
    "00a0ec58-1fb9-4a2b-bfd7-f4e5da7a9eff",
    "0a0ef009-9d44-4399-99e6-50004d345f34",
    "0a1e6f0a-1817-4a98-b02e-db8c9327d151",
)
DATA_IDS = {
    "arterial": "c58d7c2e-a9c9-5311-9808-c6a914afd19f",
    "intersection": "bf8c5e9d-76de-5c6f-a44b-69cc2c9a318a",
    "curve": "2112b63e-58e4-5604-a86c-b243689827da",
}


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """With CI set nothing may be left out for want of data or of a screen: a skip fails."""
    report = yield
    if report.skipped and os.environ.get("CI"):
        report.outcome = "failed"
        report.longrepr = f"CI does not allow a skip: {report.longrepr}"
    return report


def find_folder(root: Path, scenario_id: str) -> Path:
    found = sorted(root.glob(f"*/{scenario_id}"))
    assert len(found) == 1, f"want one folder {scenario_id} under {root}, have {found}"
    return found[0]


@pytest.fixture
def tmp_path(tmp_path: Path) -> Path:
    """One folder deeper than pytest's, in which the folder of a test that writes a scene is one beside others'."""
    folder = tmp_path / "work"
    folder.mkdir()
    return folder


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scenes are made in this process, which takes a tenth of the time, for tests of what is made of them."""
    monkeypatch.setattr("bridge.batch.engine.IsolatedProcess", resolve_name("served:Here"))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """A page of a browser. Without Chromium a test that needs it is skipped, which fails where CI is set."""
    with chromium(tmp_path_factory.mktemp("browser")) as page:
        yield page


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder with real Argoverse data. Without it a test that needs it is skipped, which fails where CI is set."""
    path = Path(os.environ.get("HID2_SHARED_DATA", ROOT.parent / "shared" / "data"))
    if not (path / "av2").is_dir():
        pytest.skip(f"{path}/av2: real scenes are missing; set HID2_SHARED_DATA")
    return path


@pytest.fixture(scope="session")
def real_scenes(shared_data: Path) -> list[Path]:
    """The folders of the six real scenes."""
    return [find_folder(shared_data / "av2", scenario_id) for scenario_id in REAL_IDS]


@pytest.fixture(scope="session")
def fourteen_scenes(shared_data: Path) -> list[Path]:
    """The folders of all real scenes."""
    found = [path.parent for part in ("av2", "wide") for path in shared_data.glob(f"{part}/*/*/scenario_*.parquet")]
    assert len(found) == 14
    return sorted(found)


@pytest.fixture(scope="session", params=REAL_IDS, ids=[scenario_id[:8] for scenario_id in REAL_IDS])
def real_scene(request: pytest.FixtureRequest, shared_data: Path) -> Path:
    """One folder of a real scene after the other."""
    return find_folder(shared_data / "av2", request.param)


@pytest.fixture(scope="session")
def data_root() -> Path:
    """The root of the synthetic data set."""
    return ROOT / "data" / "av2"


@pytest.fixture(scope="session")
def data_scenes(data_root: Path) -> dict[str, Path]:
    """The folders of the synthetic scenes by name."""
    return {name: find_folder(data_root, scenario_id) for name, scenario_id in DATA_IDS.items()}


@pytest.fixture(scope="session", params=DATA_IDS)
def data_scene(request: pytest.FixtureRequest, data_scenes: dict[str, Path]) -> Path:
    """One folder of a synthetic scene after the other."""
    return data_scenes[request.param]


@pytest.fixture
def copy_scene(tmp_path: Path, data_scenes: dict[str, Path]) -> Callable[..., Path]:
    """copy_scene("arterial", folder=None): a copy of a scenario folder that a test may spoil."""

    def copy(name: str = "arterial", *, folder: Path | None = None) -> Path:
        source = folder or data_scenes[name]
        target = tmp_path / "copy" / source.parent.name / source.name
        shutil.copytree(source, target)
        return target

    return copy
