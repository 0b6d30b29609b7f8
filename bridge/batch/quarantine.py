"""A bundle: one zip file that holds all it takes to run a failed scene again, and what was seen when it failed."""

import dataclasses
import json
import platform
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bridge.batch.isolation import Failure
from bridge.config import config_from_dict, config_to_dict
from bridge.files import beside
from hid2.params import Config
from netconvert.errors import BatchError

_FORMAT = 1
_REQUEST, _FAILURE, _DETAILS, _SCENE = "request.json", "failure.json", "details.txt", "scene/"
_EPOCH = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True, slots=True)
class Bundle:
    """A failed run. folder: the source scene's; function: what ran it; split: of the source, None without one."""

    folder: Path
    split: str | None
    config: Config
    variant: int
    timeout_s: float
    function: str
    failure: Failure
    version: str


def write_bundle(bundle: Bundle, path: Path) -> None:
    """Write a bundle, beside and then renamed. The same failure gives the same bytes."""
    request: dict[str, Any] = {
        "format": _FORMAT,
        "version": bundle.version,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "scenario": bundle.folder.name,
        "split": bundle.split,
        "variant": bundle.variant,
        "timeout_s": bundle.timeout_s,
        "function": bundle.function,
        "config": config_to_dict(bundle.config),
    }
    failure = {key: value for key, value in dataclasses.asdict(bundle.failure).items() if key != "details"}
    with beside(path) as hidden, zipfile.ZipFile(hidden, "w") as archive:
        _add(archive, _REQUEST, json.dumps(request, indent=1).encode())
        _add(archive, _FAILURE, json.dumps(failure, indent=1).encode())
        _add(archive, _DETAILS, bundle.failure.details.encode())
        if bundle.folder.is_dir():
            for file in sorted(entry for entry in bundle.folder.iterdir() if entry.is_file()):
                _add(archive, _SCENE + file.name, file.read_bytes())


def read_bundle(path: Path, into: Path) -> Bundle:
    """Read a bundle and unpack its scene below `into`. Errors: BatchError."""
    try:
        with zipfile.ZipFile(path) as archive:
            request = json.loads(archive.read(_REQUEST))
            failure = json.loads(archive.read(_FAILURE))
            if request["format"] != _FORMAT:
                raise BatchError(f"{path}: bundle format {request['format']!r}, expected {_FORMAT}")
            folder = into / (request["split"] or "scenes") / Path(request["scenario"]).name
            folder.mkdir(parents=True)
            for name in archive.namelist():
                if name.startswith(_SCENE):
                    (folder / Path(name).name).write_bytes(archive.read(name))
            return Bundle(
                folder=folder,
                split=request["split"],
                config=config_from_dict(request["config"], source=f"{path}: config"),
                variant=int(request["variant"]),
                timeout_s=float(request["timeout_s"]),
                function=str(request["function"]),
                failure=Failure(**failure, details=archive.read(_DETAILS).decode()),
                version=str(request["version"]),
            )
    except (OSError, zipfile.BadZipFile, KeyError, TypeError, ValueError) as error:
        raise BatchError(f"{path}: not a bundle of hid2 ({type(error).__name__}: {error})") from error


def _add(archive: zipfile.ZipFile, name: str, content: bytes) -> None:
    info = zipfile.ZipInfo(name, date_time=_EPOCH)
    info.compress_type = zipfile.ZIP_DEFLATED
    archive.writestr(info, content)
