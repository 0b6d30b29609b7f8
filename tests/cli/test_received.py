"""Files that were received are data: whatever they name, no command imports anything for them."""

import hashlib
import json
import re
import resource
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_type_hints

import pytest
from bundles import members, zipped
from served import Served
from typer.main import get_command

from bridge.batch.batch import plan, run_batch
from bridge.batch.manifest import ManifestRow, read_manifest
from bridge.cli.commands import application
from bridge.config import config_from_dict, config_sha256
from bridge.recordings.folders import SIDECAR_PATTERN
from hid2.params import Config, LaneChange
from netconvert.errors import ConfigError

Run = Callable[..., subprocess.CompletedProcess[str]]
#: What is written where it is imported: in the working folder, as are the received files.
PAYLOAD = "from pathlib import Path\nPath(__file__).with_name('ran').touch()\n\ndef accept(view):\n    return True\n"
RULE = "owned:accept"
REFUSED = f"lane_change.rule: asks for the function '{RULE}', which is none of hid2's: if you trust it, add --function"
#: Every command that reads a path, with the exit code and what it says: {received} is a generated scene whose sidecar
#: names the payload as its rule, in the root {root}; all other names are files and folders of the working folder.
#: code None: as the machine has a screen, or torch.
READERS: tuple[tuple[str, int | None, str], ...] = (
    ("generate --from {sidecar} --source {recorded} -o again", 2, REFUSED),
    ("generate --repro bundle.zip -o again", 1, REFUSED),
    ("generate {recorded} -o again --drivers drivers.toml", 2, "section or key lane_change, expected [drivers] alone"),
    ("generate {recorded} -o continued --resume --agents 1", 0, ""),
    ("generate {received} -o again --config sound.toml", 2, "holds generated scenes only"),
    ("study sound_study.toml -o . --scenes {received}", 2, "holds generated scenes only"),
    ("compose composition.toml -o composed", 2, "unknown key 'config'"),
    ("compose . {recorded} -o composed", 2, "leave one out"),
    ("compose --check .", 0, ""),
    ("config --config drivers.toml", 0, ""),
    ("evaluate . -o report --source {recorded} --control .", 0, ""),
    ("evaluate . -o report --predictions forecasts.parquet", 2, "forecasts.parquet"),
    ("validate . --source {recorded} --csv findings.csv", 1, ""),
    ("calibrate . -o measured.toml", 2, "holds generated scenes only"),
    ("resimulate . -o again", 2, "holds generated scenes only"),
    ("scan . -o facts.csv", 0, ""),
    ("net {received} -o net", 0, ""),
    ("view {received} -o page.html", 0, ""),
    ("export {received} --to openscenario -o exported", 0, ""),
    ("render {received} -o scene.png", 0, ""),
    ("plot {received} -o agent.png --agent AV", 0, ""),
    ("gui {received} --screenshot shot.png", None, ""),
    ("paper table1 -o again --scenes {received}", 2, "holds generated scenes only"),
    ("paper prediction -o again --composed . --predictions .", None, ""),
    ("forecast . -o . --scenes . --resume", None, ""),
    ("public public.toml -o again", 2, "unknown key 'rule_with'"),
    ("example -o again", 0, ""),
    ("make corridor -o again --road drivers.toml", 2, "drivers.toml: no key 'length_m'"),
)


@pytest.fixture(scope="module")
def made(hid2: Run, data_scenes: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of received files that name the payload wherever a configuration can stand, beside the payload."""
    root = tmp_path_factory.mktemp("received")
    assert hid2("generate", data_scenes["curve"], "-o", root, "--agents", 1, "-q").returncode == 0
    (sidecar,) = root.glob(f"*/*/{SIDECAR_PATTERN}")
    document = json.loads(sidecar.read_text())
    document["config"]["lane_change"]["rule"] = RULE
    document["config_sha256"] = config_sha256(config_from_dict(document["config"]))
    sidecar.write_text(json.dumps(document))
    shutil.copytree(root, root / "continued")
    (root / "bundle.zip").write_bytes(bundle(config=document["config"]))
    (root / "drivers.toml").write_text(f'[lane_change]\nrule = "{RULE}"\n')
    (root / "sound.toml").write_text("[request]\nstraight = 1.0\n")
    (root / "sound_study.toml").write_text(STUDY)
    (root / "public.toml").write_text(
        f'title = "a"\nrule_with = "{RULE}"\n[[road]]\nfile = "."\ncounts = "."\n[[rule]]\nname = "a"\n'
    )
    (root / "composition.toml").write_text(f'[sources]\na = "."\n[sets.b]\n[config.lane_change]\nrule = "{RULE}"\n')
    (root / "forecasts.parquet").write_bytes(b"PAR1")
    for name in ("owned", "sitecustomize", "usercustomize", "numpy", "torch"):
        (root / f"{name}.py").write_text(PAYLOAD)
    return root


STUDY = """scenes = ["x"]
[vary]
"lane_change.give_up_s" = [5.0]
[config.request]
agents = 0
"""


def bundle(files: dict[str, bytes] | None = None, **changes: Any) -> bytes:
    """A bundle whose request, or whole files, are changed."""
    return zipped(members(**changes) | (files or {}))


def filled(line: str, root: Path, data_scenes: dict[str, Path]) -> list[str]:
    (sidecar,) = root.glob(f"*/*/{SIDECAR_PATTERN}")
    names = {"sidecar": sidecar, "received": sidecar.parent, "recorded": data_scenes["curve"]}
    return line.format(**{name: str(path) for name, path in names.items()}).split(" ")


def test_every_path_that_a_command_reads_is_among_the_readers() -> None:
    """A command or an option that is added joins: all parameters that are paths are given in some line."""
    commands = get_command(application()).commands  # type: ignore[attr-defined]
    paths = {
        (command.name or command.callback.__name__, name)
        for command in application().registered_commands
        for name, hint in get_type_hints(command.callback).items()
        if "Path" in str(hint) and name != "map_path"  # of Argoverse 1 sequences, which are no folders that hid2 wrote
    }
    given = set()
    for line, _, _ in READERS:
        name, *arguments = line.split(" ")
        context = commands[name].make_context(name, arguments)
        given |= {(name, key) for key, value in context.params.items() if value not in (None, [], ())}
    assert paths - given == set()


def test_received_file_imports_nothing(made: Path, data_scenes: dict[str, Path], tmp_path: Path) -> None:
    """Neither in the process of the command nor in those of its scenes."""
    hid2, wrong = Served(isolated=True), []
    for number, (line, code, said) in enumerate(READERS):
        copy = shutil.copytree(made, tmp_path / str(number))
        result = hid2(*filled(line, copy, data_scenes), cwd=copy)
        if (copy / "ran").exists() or said not in result.stderr or code not in (None, result.returncode):
            wrong.append((line, (copy / "ran").exists(), result.returncode, result.stderr))
    hid2.close()
    assert wrong == []


@pytest.fixture(scope="module")
def importing() -> Iterator[Run]:
    """The command in a process that no other tests share, as modules that it has imported stay."""
    served = Served()
    yield served
    served.close()


def kept_rule(out: Path, text: str) -> ManifestRow:
    """The only row of a manifest, which has the digest of the file of a rule."""
    ((row,), unread) = read_manifest(out / "manifest.csv")
    assert (row.rule_sha256, unread) == (hashlib.sha256(text.encode()).hexdigest(), 0)
    return row


@pytest.mark.parametrize("named", ["--config", "--function"])
def test_rule_that_the_command_line_names_is_run_and_its_file_is_said_and_kept(
    importing: Run, made: Path, data_scenes: dict[str, Path], tmp_path: Path, named: str
) -> None:
    """Found in the working folder; the manifest has the digest of its file."""
    rule = RULE if named == "--function" else "owned_by_config:accept"
    file = tmp_path / f"{rule.partition(':')[0]}.py"
    file.write_text(PAYLOAD)
    (tmp_path / "own.toml").write_text(f'[lane_change]\nrule = "{rule}"\n')
    line = {
        "--config": "generate {recorded} -o out --agents 0 --config own.toml",
        "--function": f"generate --from {{sidecar}} --source {{recorded}} -o out --function {rule}",
    }[named]
    result = importing(*filled(line, made, data_scenes), cwd=tmp_path)
    assert (tmp_path / "ran").exists()
    assert f"lane_change.rule = {rule} is imported from {file} and run" in result.stderr
    kept_rule(tmp_path / "out", PAYLOAD)


def test_rule_of_a_study_is_tried_before_its_first_run(
    importing: Run, data_scenes: dict[str, Path], tmp_path: Path
) -> None:
    """It is imported, as the study on the command line names it, and answers what no rule may: nothing is written."""
    (tmp_path / "tried.py").write_text("def accept(view):\n    return 1\n")
    (tmp_path / "own.toml").write_text(f'{STUDY}[config.lane_change]\nrule = "tried:accept"\n')
    result = importing("study", "own.toml", "-o", "out", "--scenes", data_scenes["curve"], cwd=tmp_path)
    assert (result.returncode, "tried.py:1: it answered 1, expected True or False" in result.stderr) == (2, True)
    assert not (tmp_path / "out").exists()


def test_rule_that_raises_in_a_scene_only_is_the_error_of_that_scene(
    new_hid2: Run, data_scenes: dict[str, Path], tmp_path: Path
) -> None:
    """It is sound when it is tried, at 2 s, and raises at any other time."""
    text, file = "def accept(view):\n    return view.time_s == 2.0 or bool(1 / 0)\n", tmp_path / "owned.py"
    file.write_text(text)
    command = ["-o", "out", "--agents", 6, "--behaviours", "lane_change=1", "--set", f"lane_change.rule={RULE}"]
    result = new_hid2("generate", data_scenes["arterial"], *command, cwd=tmp_path)
    assert f"lane_change.rule = {RULE} is imported from {file} and run" in result.stderr
    row = kept_rule(tmp_path / "out", text)
    assert (result.returncode, row.failure) == (1, "error")
    assert f"{file}:2: ZeroDivisionError: division by zero" in row.reason


def test_batch_imports_no_rule_that_its_options_do_not_name(data_scenes: dict[str, Path], tmp_path: Path) -> None:
    """The last door, for callers in Python: whatever a configuration was read from."""
    jobs = plan([data_scenes["curve"]], Config(lane_change=LaneChange(rule=RULE)))
    with pytest.raises(ConfigError, match=REFUSED):
        run_batch(jobs, tmp_path / "out")
    assert not (tmp_path / "out").exists()


ZEROS = bytes(120_000_000)


def lying_bundle() -> bytes:
    """120 MB whose size is said to be 1,000 bytes, in its own header and in the directory."""
    raw = bytearray(bundle({"details.txt": ZEROS}))
    size = struct.pack("<I", len(ZEROS))
    assert raw.count(size) == 2
    return bytes(raw).replace(size, struct.pack("<I", 1000))


def bundle_of_entries() -> bytes:
    """A directory of 300,000 files and nothing else, 15 MB: each would be an object of its own."""
    one = struct.pack("<4s4B4HL2L5H2L", b"PK\1\2", 20, 3, 20, 0, 0, 0, 0, 33, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0) + b"x"
    many = one * 300_000
    return many + struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, 65535, 65535, len(many), 0, 0)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: bundle({"scene/x": ZEROS}), "file 'scene/x' unpacks to more than 32 MB"),
        (lying_bundle, "Bad CRC-32 for file 'details.txt'"),
        (bundle_of_entries, "more than 128 files in it, expected at most 64"),
    ],
)
def test_bundle_that_unpacks_to_much_is_refused_within_bounds(
    tmp_path: Path, make: Callable[[], bytes], said: str
) -> None:
    (tmp_path / "b.zip").write_bytes(make())
    assert said in said_within_bounds(["generate", "--repro", "b.zip"], tmp_path, memory_mb=700)


def test_sidecar_of_many_wrong_entries_is_refused_within_bounds(data_scenes: dict[str, Path], tmp_path: Path) -> None:
    """2 MB, of which hundreds of thousands of errors could be told: the first is."""
    (tmp_path / "hid2_x.json").write_text('{"agents":[' + "{}," * 660_000 + "{}]}")
    command = ["generate", "--from", "hid2_x.json", "--source", str(data_scenes["curve"]), "-o", "out"]
    assert "hid2_x.json: source_scenario_id: Field required" in said_within_bounds(command, tmp_path, memory_mb=1000)


def said_within_bounds(command: list[str], folder: Path, *, memory_mb: int) -> str:
    """The one line in which a command refuses a file; the system ends it beyond the memory or 20 s of processor."""

    def bound() -> None:
        resource.setrlimit(resource.RLIMIT_DATA, (memory_mb * 1_000_000, memory_mb * 1_000_000))
        resource.setrlimit(resource.RLIMIT_CPU, (20, 20))

    result = subprocess.run(
        [str(Path(sys.executable).parent / "hid2"), *command],
        capture_output=True, text=True, cwd=folder, timeout=300, preexec_fn=bound,
    )  # fmt: skip
    (line,) = [line for line in result.stderr.splitlines() if "so far" not in line]
    assert (result.returncode, line[:11]) == (1, "hid2: error"), line[:500]
    assert len(line) < 2100
    return line


#: The readers that read TOML, with a file that a test writes.
TOML_READERS = [re.sub(r"(?<!-o )\b\w+\.toml", "x.toml", line) for line, _, _ in READERS if ".toml" in line]
WILD = (
    ("a = " + "[" * 5000 + "]" * 5000, "nested too deeply"),
    ("a = " + "{a=" * 5000 + "1" + "}" * 5000, "nested too deeply"),
    (".".join("a" * 5000) + " = 1", "a key of more than 20 parts"),
    ("a = 0x" + "f" * 100_000, "an integer of more than 64 bit"),
    (f'a = "{"x" * 100_000}"', "expected"),
    (f"{'x' * 100_000} = 1", "expected"),
    ("#" + "x" * 2_000_000, "holds more than 1 MB"),
)


def test_toml_is_read_in_one_place() -> None:
    root = Path(__file__).parents[2]
    product = [path for package in ("bridge", "hid2", "netconvert") for path in (root / package).rglob("*.py")]
    assert [path.name for path in product if "tomllib.load" in path.read_text()] == ["toml.py"]


def test_wild_toml_is_one_line_that_says_what_is_expected(
    hid2: Run, made: Path, data_scenes: dict[str, Path], tmp_path: Path
) -> None:
    """All of it in one command, the last three in every one that reads TOML."""
    lines = [line for line in TOML_READERS if "x.toml" in line]
    assert len(lines) > 5
    for number, line in enumerate(lines):
        for text, words in WILD[4 if number else 0 :]:
            (tmp_path / "x.toml").write_text(text)
            result = hid2(*filled(line, made, data_scenes), cwd=tmp_path)
            (said,) = [line for line in result.stderr.splitlines() if "so far" not in line]
            assert (result.returncode, said[:20], words in said) == (2, "hid2: error: x.toml:", True), (line, text[:99])
            assert len(said) < 2100
            assert [path.name for path in tmp_path.iterdir()] == ["x.toml"]
