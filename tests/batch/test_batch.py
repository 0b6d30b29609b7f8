"""Batches: manifest, quarantine, resume, interruption, faults; the work is that of faults.py, which is quick."""

import csv
import errno
import gc
import os
import shutil
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from distributed import LocalCluster
from recordings import make_argoverse1
from served import Here
from written import contents

from bridge.batch.batch import RUNS_OF_A_TASK, Options, Progress, plan, reproduce, run_batch
from bridge.batch.manifest import DONE, QUARANTINED, Manifest, ManifestRow
from bridge.config import load_config
from bridge.generation.program import code_version
from bridge.recordings.sources import find_recordings, find_scenarios, find_sources
from hid2.params import Config
from netconvert.errors import BatchError, ConfigError, DiskFullError, ExportError

COPIES = "faults:copies"
MakeDataSet = Callable[..., list[Path]]


@pytest.fixture(autouse=True)
def here(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Scenes are made in this process, which takes a tenth of the time, unless a test asks for isolated ones."""
    if "isolated" not in request.fixturenames:
        monkeypatch.setattr("bridge.batch.engine.IsolatedProcess", Here)


@pytest.fixture
def isolated() -> None:
    """Scenes are made in processes of their own."""


def statuses(rows: Sequence[ManifestRow]) -> dict[str, str]:
    return {row.scenario: row.failure or row.status for row in rows}


def assert_nothing_half_written(out: Path) -> None:
    assert [path for path in out.rglob(".*") if path.name != ".hid2.lock"] == []


def test_results_are_not_written_beside_the_sources(make_data_set: MakeDataSet, tmp_path: Path) -> None:
    folders = make_data_set(2)
    before = sorted((tmp_path / "source").rglob("*"))
    for where in (".", "val"):
        with pytest.raises(ConfigError, match=r"source/val holds the input; choose another output folder"):
            run_batch(plan(folders, Config()), tmp_path / "source" / where, Options(function=COPIES))
    assert sorted((tmp_path / "source").rglob("*")) == before


def test_results_may_be_written_below_the_data_set_and_are_no_sources_then(
    make_data_set: MakeDataSet, tmp_path: Path
) -> None:
    """Scenes in no split are written to OUT itself, where they are found from the folder above."""
    make_data_set(2)
    root = (tmp_path / "source" / "val").rename(tmp_path / "scenes")
    for variants in (1, 2):
        config = load_config(flags={"request.variants": variants})
        sources = find_sources([root])
        rows = run_batch(plan(sources, config), root / "out", Options(function=COPIES, resume=True))
        assert [row.scenario for row in rows] == [f"scene-{n:03d}" for n in range(2) for _ in range(variants)]
        assert len(find_scenarios(root)) == 2 + 2 * variants


@pytest.mark.parametrize("name", ["scene-000", "copy"])
def test_two_scenes_that_would_be_written_to_one_place_are_refused(
    make_data_set: MakeDataSet, tmp_path: Path, name: str
) -> None:
    """A copy of a scene, of the same folder's name or not: one would take the place of the other."""
    folders = make_data_set(2)
    other = tmp_path / "other" / "val" / name
    shutil.copytree(folders[0], other)
    with pytest.raises(ConfigError, match=r"scene-000 and .*/other/val/.* are both scene '.*'; leave one out"):
        run_batch(plan([*folders, other], Config()), tmp_path / "out", Options(function=COPIES))
    assert not (tmp_path / "out").exists()


def test_second_source_with_the_scenario_id_of_another_is_not_written_over_it(
    make_data_set: MakeDataSet, tmp_path: Path
) -> None:
    """The names of its files do not tell: it is found when it is read."""
    folders = make_data_set(2)
    shutil.rmtree(folders[1])
    shutil.copytree(folders[0], folders[1])
    for path in folders[1].iterdir():
        path.rename(path.with_name(path.name.replace("00000000-0000", "11111111-1111")))
    good, bad = run_batch(plan(folders, Config()), tmp_path / "out", Options(function=COPIES))
    assert (good.status, bad.failure) == (DONE, "error")
    assert "scenario_id '00000000-0000-4000-8000-000000000000', expected the id in the file's name" in bad.reason
    assert list(contents(tmp_path / "out")) == [good.folder]


def test_scene_of_another_batch_is_not_replaced_by_one_of_its_id(make_data_set: MakeDataSet, tmp_path: Path) -> None:
    folders = make_data_set(2)
    run_batch(plan(folders, Config()), tmp_path / "out", Options(function=COPIES))
    other = tmp_path / "other" / "val" / "copy"
    shutil.copytree(folders[0], other)
    before = contents(tmp_path / "out")
    with pytest.raises(
        ConfigError, match=r"copy: scene '0+-.*' is in .* already, made from another folder, 'scene-000'"
    ):
        run_batch(plan([other], Config()), tmp_path / "out", Options(function=COPIES))
    assert contents(tmp_path / "out") == before
    assert len(Manifest(tmp_path / "out").rows) == 2


@pytest.mark.parametrize("timeout_s", [float("nan"), float("inf"), 0.0, 1e9])
def test_time_that_never_comes_is_refused(timeout_s: float) -> None:
    with pytest.raises(ConfigError, match=r"scene-timeout .*: expected 1 to 86400 s"):
        Options(timeout_s=timeout_s)


class TestFullDisk:
    """Nothing more can be written: one line, nothing half-written, and the batch goes on when there is room."""

    def check(self, folders: list[Path], out: Path, patched: pytest.MonkeyPatch) -> None:
        said = r"cannot be written \(No space left on device\); finished scenes are in "
        with pytest.raises(DiskFullError, match=said):
            run_batch(plan(folders, Config()), out, Options(function=COPIES))
        patched.undo()
        assert_nothing_half_written(out)
        assert [path for path in (out / "quarantine").rglob("*") if not path.is_dir()] == []
        rows = run_batch(plan(folders, Config()), out, Options(function=COPIES, resume=True))
        assert {row.status for row in rows} <= {DONE, QUARANTINED}
        assert len(rows) == len(folders)

    def test_in_a_scene(self, make_data_set: MakeDataSet, tmp_path: Path) -> None:
        self.check(make_data_set(3, {1: "full once"}), tmp_path / "out", pytest.MonkeyPatch())

    @pytest.mark.parametrize("what", ["add", "save"])
    def test_in_the_manifest(
        self, make_data_set: MakeDataSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str
    ) -> None:
        opened, calls = Path.open, []
        name, mode = ("manifest.csv", "a") if what == "add" else (".hid2-*.csv", "w")

        def full(path: Path, *arguments: object, **named: object) -> object:
            if path.match(name) and (arguments or (named.get("mode"),))[0] == mode:
                calls.append(path)
                if len(calls) > 1:
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return opened(path, *arguments, **named)  # type: ignore[call-overload]

        with monkeypatch.context() as patched:
            patched.setattr(Path, "open", full)
            self.check(make_data_set(3), tmp_path / "out", patched)
        assert len(calls) > 1

    def test_in_a_bundle(self, make_data_set: MakeDataSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        def full(*_: object) -> None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        with monkeypatch.context() as patched:
            patched.setattr("zipfile.ZipFile.writestr", full)
            self.check(make_data_set(3, {1: "raise"}), tmp_path / "out", patched)


def test_folder_with_any_bytes_in_its_name_is_a_scene_like_others(make_data_set: MakeDataSet, tmp_path: Path) -> None:
    folders = make_data_set(5, {1: "raise", 3: "raise", 4: "raise"})
    named = [folder.rename(folder.parent / f"s{k}\udcff\n,\x1b[2J") for k, folder in enumerate(folders[:2])]
    long = [
        folder.rename(folder.parent / ("\u8857" * 84 + name)) for folder, name in zip(folders[3:], "ab", strict=True)
    ]
    for resume in (False, True):
        options = Options(function=COPIES, resume=resume)
        rows = run_batch(plan([*named, folders[2], *long], Config()), tmp_path / "out", options)
        assert [row.failure or row.status for row in rows] == [DONE, "exception", DONE, "exception", "exception"]
        assert [row.scenario for row in rows[:3]] == ["s0\\udcff ,\\x1b[2J", "s1\\udcff ,\\x1b[2J", "scene-002"]
        assert len({row.bundle for row in rows[1:] if row.bundle}) == 3
    assert rows[1].bundle
    _, again = reproduce(tmp_path / "out" / rows[1].bundle, tmp_path / "again", functions=[COPIES])
    assert again.failure == "exception"


def test_lock_that_is_a_link_is_not_written_through(make_data_set: MakeDataSet, tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("mine")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / ".hid2.lock").symlink_to(tmp_path / "mine")
    with pytest.raises(ExportError, match="cannot be written"):
        run_batch(plan(make_data_set(1), Config()), tmp_path / "out", Options(function=COPIES))
    assert (tmp_path / "mine").read_text() == "mine"


@pytest.mark.usefixtures("isolated")
def test_bad_scenes_are_quarantined_and_good_ones_complete(make_data_set: MakeDataSet, tmp_path: Path) -> None:
    faults = {1: "sumo", 2: "wait", 3: "corrupt", 4: "raise", 5: "segfault once"}
    folders, out = make_data_set(7, faults), tmp_path / "out"
    rows = run_batch(plan(folders, Config()), out, Options(jobs=2, timeout_s=8, function=COPIES))
    ended = [DONE, "crashed", "timeout", "error", "exception", DONE, DONE]
    assert statuses(rows) == {f"scene-{number:03d}": how for number, how in enumerate(ended)}
    assert [row.attempts for row in rows] == [1, 2, 2, 1, 1, 2, 1]
    assert_nothing_half_written(out)
    assert len(contents(out)) == 3
    for row in rows:
        assert bool(row.bundle) == (row.status == QUARANTINED)
    found = list(out.rglob("*.parquet"))
    assert found == [path for path in found if path.name.startswith("scenario_")], "a bundle shows readers no parquet"


@pytest.mark.usefixtures("isolated")
@pytest.mark.parametrize("fault", ["segfault", "corrupt"])
def test_bundle_reproduces_its_failure(make_data_set: MakeDataSet, tmp_path: Path, fault: str) -> None:
    folders = make_data_set(1, {0: fault})
    (row,) = run_batch(plan(folders, Config()), tmp_path / "out", Options(timeout_s=20, retries=0, function=COPIES))
    shutil.rmtree(tmp_path / "source")  # the bundle holds all that is needed
    bundle, again = reproduce(tmp_path / "out" / row.bundle, tmp_path / "again", functions=[COPIES])
    assert (again.failure, again.reason) == (row.failure, row.reason.replace(str(folders[0]), str(bundle.folder)))
    assert bundle.failure.kind == row.failure
    assert bundle.variant == 0


@pytest.mark.usefixtures("isolated")
def test_every_run_has_a_row_and_a_folder_and_workers_make_no_difference_to_the_bytes(
    make_data_set: MakeDataSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    jobs, out = plan(make_data_set(3), load_config(flags={"request.variants": 2})), tmp_path / "two"
    rows = run_batch(jobs, out, Options(jobs=2, function=COPIES))
    with (out / "manifest.csv").open() as file:
        written = [(row["scenario"], row["variant"], row["status"]) for row in csv.DictReader(file)]
    assert written == [(f"scene-{number:03d}", variant, DONE) for number in range(3) for variant in "01"]
    assert contents(out).keys() == {row.folder for row in rows}
    assert {row.split for row in rows} == {"val"}
    monkeypatch.setattr("bridge.batch.engine.IsolatedProcess", Here)
    run_batch(jobs, tmp_path / "one", Options(function=COPIES))
    assert contents(tmp_path / "one") == contents(out)
    assert len(contents(out)) == 6


def test_runs_on_one_scene_are_in_the_manifest_part_by_part(
    make_data_set: MakeDataSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A power cut costs one part, not all variants of a scene; and a second process has something to do."""
    monkeypatch.setenv("FAULTS_SLEEP_S", "0.05")
    jobs = plan(make_data_set(1), load_config(flags={"request.variants": 2 * RUNS_OF_A_TASK + 1}))
    out, written = tmp_path / "out", []

    def note(row: ManifestRow, progress: Progress) -> None:
        written.append(len(list(out.glob("val/[!.]*/hid2_*.json"))))

    rows = run_batch(jobs, out, Options(function=COPIES), on_row=note)
    assert len(rows) == len(written) == written[-1] == 2 * RUNS_OF_A_TASK + 1
    assert RUNS_OF_A_TASK <= written[0] < 2 * RUNS_OF_A_TASK


class TestResume:
    """--resume trusts contents, nothing else."""

    @pytest.fixture
    def first(self, finished_batch: Path, tmp_path: Path) -> tuple[list[Path], Path]:
        """Three scenes and the finished batch of them, to be spoilt."""
        shutil.copytree(finished_batch, tmp_path, dirs_exist_ok=True)
        return sorted((tmp_path / "source" / "val").iterdir()), tmp_path / "out"

    @staticmethod
    def redone(folders: Sequence[Path], out: Path, config: Config | None = None) -> list[str]:
        """Names of the scenes that a resumed batch makes again."""
        made, skipped = [], 0

        def note(row: ManifestRow, progress: Progress) -> None:
            nonlocal skipped
            if progress.skipped == skipped:
                made.append(row.scenario)
            skipped = progress.skipped

        run_batch(plan(folders, config or Config()), out, Options(resume=True, function=COPIES), on_row=note)
        return made

    def test_complete_scenes_are_skipped_and_half_written_folders_removed(self, first: tuple[list[Path], Path]) -> None:
        half = first[1] / "val" / ".hid2-0123456789abcdef"
        half.mkdir()
        (half / "scenario.parquet").write_bytes(b"half")
        assert self.redone(*first) == []
        assert not half.exists()

    def test_changed_configuration_is_redone_and_more_variants_keep_the_first(
        self, first: tuple[list[Path], Path]
    ) -> None:
        folders, out = first
        assert len(self.redone(folders, out, load_config(flags={"request.seed": 1}))) == 3
        assert self.redone(folders, out) == [], "the scenes of the first configuration are still there"
        assert len(self.redone(folders, out, load_config(flags={"request.variants": 2}))) == 3

    def test_what_has_changed_or_is_damaged_is_redone(self, first: tuple[list[Path], Path]) -> None:
        """A source, the files of two scenes, the program, and a row that is cut within its line."""
        folders, out = first
        map_path = next(folders[1].glob("log_map_archive_*.json"))
        map_path.write_bytes(map_path.read_bytes() + b"\n")
        assert self.redone(folders, out) == ["scene-001"]
        manifest, before = Manifest(out), contents(out)
        next((out / manifest.rows[0].folder).glob("*.parquet")).write_bytes(b"half")
        shutil.rmtree(out / manifest.rows[2].folder)
        assert self.redone(folders, out) == ["scene-000", "scene-002"]
        assert contents(out) == before
        manifest = Manifest(out)
        assert {row.version for row in manifest.rows} == {code_version()}
        number, _, digest = code_version().partition("+")
        manifest.add(manifest.rows[1]._replace(version=f"{number}+{'0' * len(digest)}"))
        assert self.redone(folders, out) == ["scene-001"]
        lines = (out / "manifest.csv").read_text().splitlines(keepends=True)
        (out / "manifest.csv").write_text("".join(lines[:-1]) + lines[-1][:40])
        assert self.redone(folders, out) == ["scene-002"]

    def test_quarantined_scene_is_tried_again(self, make_data_set: MakeDataSet, tmp_path: Path) -> None:
        folders, out = make_data_set(2, {1: "raise"}), tmp_path / "out"
        (_, bad) = run_batch(plan(folders, Config()), out, Options(function=COPIES))
        assert (out / bad.bundle).exists()
        (folders[1] / "FAULT").unlink()
        assert self.redone(folders, out) == ["scene-001"]
        assert not (out / bad.bundle).exists(), "a scene that is done leaves no bundle"


def test_what_is_asked_for_beside_a_scene_is_written_with_all_else_and_notes_are_kept(
    synthetic: list[Path], tmp_path: Path
) -> None:
    """Gaps; where they are asked for later, the scene is made again."""
    jobs, out = plan(synthetic[:1], load_config(flags={"request.agents": 1})), tmp_path / "out"
    (row,) = run_batch(jobs, out)
    (out / row.folder / "NOTES.txt").write_text("mine")
    run_batch(jobs, out, Options(resume=True))
    assert (out / row.folder / "NOTES.txt").read_text() == "mine"
    (row,) = run_batch(jobs, out, Options(resume=True, gaps=True))
    assert len(list((out / row.folder).glob("gaps_*.csv.gz"))) == 1


def test_sequence_of_argoverse_1_that_is_asked_for_later_is_written_by_a_resumed_batch(tmp_path: Path) -> None:
    """A scene that is complete without one is not complete with one; so it is with one that is lost or spoilt since."""
    found = find_recordings([make_argoverse1(tmp_path / "av1") / "val/data/7.csv"])
    jobs, out = plan(found, load_config(flags={"request.agents": 1})), tmp_path / "out"
    run_batch(jobs, out)
    contents_found = set()
    for spoil in (Path.unlink, lambda path: path.write_text("junk"), Path.unlink):
        run_batch(jobs, out, Options(argoverse1=True, resume=True))
        (sequence,) = (out / "argoverse1").rglob("*.csv")
        contents_found.add(sequence.read_bytes())
        spoil(sequence)
    assert len(contents_found) == 1


def test_second_batch_on_the_same_folder_is_refused(make_data_set: MakeDataSet, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("FAULTS_SLEEP_S", "0.5")
    jobs = plan(make_data_set(2), Config())
    thread = threading.Thread(target=run_batch, args=(jobs, tmp_path / "out", Options(function=COPIES)))
    thread.start()
    while not (tmp_path / "out" / "manifest.csv").exists():
        time.sleep(0.02)
    with pytest.raises(BatchError, match="another run"):
        run_batch(jobs, tmp_path / "out", Options(function=COPIES))
    thread.join()


def test_worker_of_another_version_ends_the_batch(make_data_set: MakeDataSet, tmp_path: Path) -> None:
    with pytest.raises(BatchError, match=r"a worker runs hid2-sumo 0\.0\.1"):
        run_batch(plan(make_data_set(1), Config()), tmp_path / "out", Options(function="faults:other_version"))


@pytest.mark.parametrize("address", ["somewhere", "tcp://host:port", "http://host:80"])
def test_address_of_no_scheduler_is_explained(
    make_data_set: MakeDataSet, tmp_path: Path, address: str, recwarn: pytest.WarningsRecorder
) -> None:
    options = Options(scheduler=address, function=COPIES)
    with pytest.raises(ConfigError, match=rf"scheduler '{address}': .*, expected tls://HOST:PORT or tcp://HOST:PORT"):
        run_batch(plan(make_data_set(1), Config()), tmp_path / "out", options)
    gc.collect()  # a client that was half made would be complained about by now
    assert [str(warning.message) for warning in recwarn if "Client" in str(warning.message)] == []


def test_scheduler_that_gets_no_workers_is_given_up(
    make_data_set: MakeDataSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bridge.batch.cluster._WORKERS_S", 1.0)
    with LocalCluster(n_workers=0, processes=False, dashboard_address=None, host="127.0.0.1", protocol="tcp") as nobody:
        address = nobody.scheduler_address
        with pytest.raises(BatchError, match=rf"scheduler {address}: no workers for 1 s, expected some .*dask worker"):
            run_batch(plan(make_data_set(1), Config()), tmp_path / "out", Options(scheduler=address, function=COPIES))
    assert_nothing_half_written(tmp_path / "out")
