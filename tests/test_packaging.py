"""What is needed, at which versions, and how setup.sh and .ci/run bring it."""

import contextlib
import os
import pty
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Callable, Iterator
from importlib.metadata import Distribution, distribution, distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from bridge.cli.showing import EXAMPLES

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
README = (ROOT / "README.md").read_text()
REQUIREMENTS = (ROOT / "requirements.txt").read_text()
#: Hosts of package registries, in two halves so that this file names none.
REGISTRIES = (
    ("pypi", "org"), ("pythonhosted", "org"), ("npmjs", "org"), ("npmjs", "com"), ("yarnpkg", "com"),
    ("debian", "org"), ("ubuntu", "com"), ("anaconda", "org"), ("crates", "io"), ("golang", "org"), ("ghcr", "io"),
)  # fmt: skip


def project_files() -> list[Path]:
    """Every file that git tracks, and every new one that it does not ignore."""
    listing = ["git", "-c", "safe.directory=*", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    result = subprocess.run(listing, cwd=ROOT, capture_output=True, text=True) if shutil.which("git") else None
    if result is None or result.returncode != 0:
        pytest.skip("no git checkout: which files belong to the project cannot be told")
    return [path for name in sorted(filter(None, result.stdout.split("\0"))) if (path := ROOT / name).is_file()]


def test_no_file_names_a_package_registry_and_none_is_a_lock_file() -> None:
    """Such a file records download addresses; hosts below those listed count too."""
    host = "|".join(rf"{name}\.{top}" for name, top in REGISTRIES)
    pattern = re.compile(rf"\b({host})\b".encode())
    files = project_files()
    assert ROOT / "pyproject.toml" in files
    assert not {path.name for path in files} & {"uv.lock", "poetry.lock", "pdm.lock", "Pipfile.lock", "pylock.toml"}
    assert pattern.search(b"see https://deb." + b".".join(part.encode() for part in REGISTRIES[5]))
    found = [
        f"{path.relative_to(ROOT)}: {hit[0].decode()}" for path in files for hit in pattern.finditer(path.read_bytes())
    ]
    assert found == []


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Contents of the files of wheel and sdist by name, built as uv and pip do, without a network."""
    out = tmp_path_factory.mktemp("dist")
    code = "import sys; from hatchling import build; build.build_wheel(sys.argv[1]); build.build_sdist(sys.argv[1])"
    subprocess.run([sys.executable, "-c", code, out], cwd=ROOT, check=True, timeout=300, stdout=subprocess.DEVNULL)
    with zipfile.ZipFile(next(out.glob("*.whl"))) as wheel:
        found = {name: wheel.read(name) for name in wheel.namelist()}
    with tarfile.open(next(out.glob("*.tar.gz"))) as sdist:
        files = [member for member in sdist.getmembers() if member.isfile()]
        return found | {f"sdist/{one.name.partition('/')[2]}": sdist.extractfile(one).read() for one in files}


def test_wheel_and_sdist_hold_every_file_that_they_need(built: dict[str, bytes]) -> None:
    names = {path.relative_to(ROOT).as_posix() for path in project_files()}
    assert {f"sdist/{name}" for name in names} <= built.keys()
    ours = {name for name in names if name.startswith(("netconvert/", "hid2/", "bridge/")) and not name.endswith(".md")}
    ours |= {f"bridge/{name}" for name in names if name.startswith(tuple(f"data/{one}/" for one in EXAMPLES))}
    assert {name for name in built if not name.startswith("sdist/") and ".dist-info/" not in name} == ours
    assert any(name.endswith("viewer.js") for name in ours)


def test_wheel_brings_the_example(built: dict[str, bytes], tmp_path: Path) -> None:
    for name, content in built.items():
        if name.startswith(("netconvert/", "hid2/", "bridge/")):
            (tmp_path / "wheel" / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / "wheel" / name).write_bytes(content)
    command = [sys.executable, "-P", "-c", "from bridge.cli import main; main()", "example", "-o", "out"]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "wheel")}
    subprocess.run(command, cwd=tmp_path, env=environment, check=True, timeout=120)
    scenes = [path.relative_to(tmp_path / "out") for path in (tmp_path / "out" / "av2").rglob("*.parquet")]
    assert len(scenes) == 3
    assert all((tmp_path / "out" / path).read_bytes() == (ROOT / "data" / path).read_bytes() for path in scenes)


def test_command_without_what_it_needs_says_so_in_a_line() -> None:
    """As of a wheel that was installed without its dependencies."""
    code = "import sys; sys.modules['typer'] = None\nfrom bridge.cli import main\nmain()"
    result = subprocess.run([sys.executable, "-c", code, "--help"], capture_output=True, text=True, timeout=120)
    assert result.returncode == 1
    assert result.stderr.startswith("hid2: error: no module 'typer', which hid2 needs: install it")
    assert result.stderr.count("\n") == 1


def test_description_on_a_package_index_links_to_nothing_that_is_not_there(built: dict[str, bytes]) -> None:
    """An index shows the text of METADATA and no file of the tree: all targets are addresses, and some are left."""
    texts = [content.decode() for name, content in built.items() if name.endswith(("/METADATA", "sdist/PKG-INFO"))]
    assert len(texts) == 2
    for text in texts:
        assert "\n# hid2-sumo\n" in text
        targets = re.findall(r"\]\(([^)]*)\)|(?:href|src)=\"?([^\" >]*)|^\[[^\]]+\]: *(\S+)", text, re.MULTILINE)
        assert targets
        assert [one for one in map("".join, targets) if not one.startswith("https://")] == []
        assert "INSTALL.md says what" in text  # of a link that is none there its words stay


def applies(requirement: Requirement, extras: tuple[str, ...] = ("",)) -> bool:
    """Whether a requirement is one of this Python's and this system's."""
    marker = requirement.marker
    return marker is None or any(marker.evaluate({"extra": extra}) for extra in extras)


def declared() -> list[Requirement]:
    """What pyproject.toml asks for by name: the package, its extras and the tools of the tests."""
    lines = [*PROJECT["project"]["dependencies"], *PROJECT["dependency-groups"]["dev"]]
    extras = PROJECT["project"]["optional-dependencies"]
    return [Requirement(line) for line in (*lines, *extras["gui"], *extras["site"])]


def pins() -> dict[str, str]:
    """Version by canonical name, of the pins that apply here."""
    found = {}
    for line in re.findall(r"^[^ #].*?(?= \\$|$)", REQUIREMENTS, re.MULTILINE):
        requirement = Requirement(line)
        (specifier,) = requirement.specifier
        assert (specifier.operator, requirement.url) == ("==", None), f"{line}: expected a version, name==1.2.3"
        if applies(requirement):
            assert canonicalize_name(requirement.name) not in found, f"{line}: pinned twice"
            found[canonicalize_name(requirement.name)] = specifier.version
    return found


def left_out() -> set[str]:
    """What dependencies declare and dependency-metadata leaves out, but for what the tools of the tests bring."""
    found = set()
    for metadata in PROJECT["tool"]["uv"]["dependency-metadata"]:
        assert pins()[metadata["name"]] == metadata["version"], "dependency-metadata is of another version than the pin"
        said = (Requirement(line) for line in distribution(metadata["name"]).requires or ())
        names = {requirement.name for requirement in said if applies(requirement)}
        assert set(metadata["requires-dist"]) <= names, f"{metadata['name']} no longer needs some of these"
        found |= names - set(metadata["requires-dist"])
    return found - {requirement.name for requirement in declared()}


def test_every_pin_but_torch_has_a_hash_and_none_an_address() -> None:
    """torch's wheels without CUDA are on PyTorch's own list, with hashes of their own."""
    entries = re.split(r"\n(?=\S)", REQUIREMENTS)
    hashed = re.compile(r"[\w.-]+==[\w.+]+ ;[^\\]+( \\\n    --hash=sha256:[0-9a-f]{64})+\n?")
    assert [entry.split("==")[0] for entry in entries if not hashed.fullmatch(entry)] == ["torch"]
    assert "://" not in REQUIREMENTS


def test_pins_are_within_the_declared_ranges() -> None:
    """Also of what builds the package, and of torch, which nothing else brings."""
    pinned = pins()
    (torch,) = (Requirement(line) for line in PROJECT["project"]["optional-dependencies"]["forecast"])
    assert torch.name == "torch"
    assert "torch" not in {requirement.name for requirement in declared()}
    for requirement in (*declared(), torch, *map(Requirement, PROJECT["build-system"]["requires"])):
        version = pinned.get(canonicalize_name(requirement.name))
        assert version is not None, f"{requirement}: no pin; run .ci/renew_pins.py"
        assert requirement.specifier.contains(version), f"{requirement}: pinned at {version}"


def needed() -> Iterator[tuple[str, Distribution]]:
    """Name and distribution of all that is declared, of what that needs, and so on."""
    waiting, seen = declared(), set(left_out())
    while waiting:
        requirement = waiting.pop()
        name = canonicalize_name(requirement.name)
        if name in seen or not applies(requirement):
            continue
        seen.add(name)
        found = distribution(name)
        yield name, found
        extras = ("", *requirement.extras)
        waiting += [part for line in found.requires or () if applies(part := Requirement(line), extras)]


def test_all_that_is_needed_is_pinned_and_installed_at_that_version() -> None:
    pinned = pins()
    wrong = {name: (found.version, pinned.get(name)) for name, found in needed() if found.version != pinned.get(name)}
    assert wrong == {}, "installed and pinned differ: sh setup.sh tests, or renew the pins"


def test_environment_has_neither_torch_nor_cuda() -> None:
    installed = {canonicalize_name(found.metadata["Name"]) for found in distributions()}
    assert left_out() == {"av", "joblib", "kornia", "nox", "opencv-python", "polars", "torch", "tqdm"}
    if " forecast\n" in (ROOT / ".venv" / ".hid2").read_text():
        installed = {name for name in installed if not name.startswith(("torch", "triton", "nvidia-"))}  # asked for
    assert {name for name in installed if name.startswith(("torch", "kornia", "nvidia-", "triton"))} == set()


def test_forecasts_are_scored_without_what_av2_is_installed_without() -> None:
    """av2's metrics and submissions load none of it: the tools of the tests bring cv2 for av2's map alone."""
    gone = {"av", "cv2", "joblib", "kornia", "nox", "polars", "pyproj", "torch", "tqdm"}
    code = f"import sys; sys.modules.update(dict.fromkeys({sorted(gone)}))\nimport bridge.forecasting.predictions"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


# --- setup.sh on a machine that lacks something -----------------------------------------------------------------------

Setup = Callable[..., subprocess.CompletedProcess[str]]


def python(*, missing: str = "") -> str:
    """A python3 of the right version with a pip that installs nothing; it finds one Debian package missing, or none."""
    return f'case "$1" in -m) [ "$3" = --version ] ;; -) echo {missing} ;; *) echo "$0" ;; esac'


@pytest.fixture
def set_up(tmp_path: Path) -> Setup:
    """set_up(*arguments, python3="...", ...): run a copy of setup.sh where only these commands (shell code) exist."""
    for name in ("setup.sh", "pyproject.toml", "requirements.txt"):
        shutil.copy(ROOT / name, tmp_path)

    def run(*arguments: str, **commands: str) -> subprocess.CompletedProcess[str]:
        folder = tmp_path / "bin"
        folder.mkdir()
        for name in ("cksum", "dirname", "grep", "mkdir", "tr", "uname"):
            (folder / name).symlink_to(str(shutil.which(name)))
        for name, code in commands.items():
            file = folder / name.replace("_", "-")
            file.write_text(f"#!/bin/sh\n{code}\n")
            file.chmod(0o755)
        shell = str(shutil.which("sh"))
        environment = {"PATH": str(folder), "HOME": str(tmp_path)}
        command = [shell, "setup.sh", *arguments]
        return subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=180)

    return run


def at_a_terminal(folder: Path, answer: str, *, is_container: bool, **more: str) -> str:
    """What setup.sh says on a terminal on which that answer is typed, with the commands that set_up made there."""
    script = (ROOT / "setup.sh").read_text()
    (folder / "setup.sh").write_text(script.replace("/.dockerenv", str(ROOT if is_container else folder / "none")))
    ours, theirs = pty.openpty()
    os.write(ours, answer.encode())
    environment = {"PATH": str(folder / "bin"), "HOME": str(folder), **more}
    command = [str(shutil.which("sh")), "setup.sh"]
    subprocess.run(
        command, cwd=folder, env=environment, stdin=theirs, stdout=theirs, stderr=theirs, check=False, timeout=180
    )
    os.close(theirs)
    said = b""
    with contextlib.suppress(OSError):  # how a terminal ends on Linux
        while part := os.read(ours, 65_536):
            said += part
    os.close(ours)
    return said.decode()


QUESTION = "apt-get install libgl1? [y/N]"
REFUSED = "please install, then call this again (Debian's names)"
INSTALLED = "pip could not install uv"


@pytest.mark.skipif(sys.platform != "linux", reason="Debian's packages are asked for on Linux only")
def test_root_is_asked_before_packages_are_installed(set_up: Setup, tmp_path: Path) -> None:
    """At a terminal, in no container and no run of CI. The fake pip installs nothing, so that each run ends there."""
    result = set_up(python3=python(missing="libgl1"), id="echo 0", apt_get="exit 0")
    assert "[y/N]" not in result.stderr
    assert INSTALLED in result.stderr
    for answer, ends in (("y\n", INSTALLED), ("n\n", REFUSED), ("\n", REFUSED)):
        said = at_a_terminal(tmp_path, answer, is_container=False)
        assert QUESTION in said
        assert ends in said
    for more in ({"container": "podman"}, {"KUBERNETES_SERVICE_HOST": "10.0.0.1"}, {"CI": "true"}):
        said = at_a_terminal(tmp_path, "", is_container=False, **more)
        assert (QUESTION in said, INSTALLED in said) == (False, True), more
    said = at_a_terminal(tmp_path, "", is_container=True)
    assert (QUESTION in said, INSTALLED in said) == (False, True)


@pytest.mark.parametrize(
    ("arguments", "commands", "said"),
    [
        (["everything"], {"python3": python()}, "unknown argument 'everything'"),
        ([], {}, "found no Python 3.11 or 3.12 with pip"),
        ([], {"python3": "exit 1", "python3.12": "exit 127"}, "found no Python 3.11 or 3.12 with pip"),
        ([], {"python3": python()}, "pip could not install uv"),
        (
            [],
            {"python3": python(missing="libgl1"), "id": "echo 1000"},
            "please install, then call this again (Debian's names): apt-get install --no-install-recommends libgl1",
        ),
        (
            ["tests"],
            {"python3": python(missing="xvfb"), "id": "echo 0", "apt_get": "exit 100"},
            "apt-get could not install xvfb",
        ),
    ],
)
def test_setup_fails_with_a_sentence(set_up: Setup, arguments: list[str], commands: dict[str, str], said: str) -> None:
    if sys.platform != "linux" and ("id" in commands):
        pytest.skip("Debian's packages are asked for on Linux only")
    result = set_up(*arguments, **commands)
    assert result.returncode == 1
    assert result.stdout == ""
    last = result.stderr.splitlines()[-1]
    assert last.startswith("setup.sh: ")
    assert said in last


def test_packages_to_install_by_hand_are_all_that_is_declared() -> None:
    """INSTALL.md has the line for pip; numpy comes with others."""
    (line,) = re.findall(r"^    pip install --no-deps av2 .*?(?<!\\)$", (ROOT / "INSTALL.md").read_text(), re.M | re.S)
    named = {canonicalize_name(word.split("==")[0]) for word in line.replace('"', " ").split()}
    wanted = {canonicalize_name(Requirement(text).name) for text in PROJECT["project"]["dependencies"]}
    assert wanted - named == {"numpy"}


def test_ci_calls_the_test_command_of_the_readme() -> None:
    """.ci/run takes the line from the README; this is the same pattern, so that a change of either shows here."""
    assert len(re.findall(r"^    (sh setup\.sh tests .*pytest)$", README, re.MULTILINE)) == 1
    assert r"s/^    \(sh setup\.sh tests .*pytest\)$/\1/p" in (ROOT / ".ci" / "run").read_text()


def test_quick_start_is_two_commands_of_one_line() -> None:
    section = README.split("## Quick start")[1].split("\n## ")[0]
    commands = [line.strip() for line in section.splitlines() if line.startswith("    ")]
    assert len(commands) == 2
    assert all(command.startswith("sh setup.sh") for command in commands)
