"""A bundle: one zip file that holds all it takes to run a failed scene again, and what was seen when it failed.

A bundle comes from anywhere: the scene, configuration and function of hid2 that it names are checked before anything is
unpacked; what it holds is bounded, and unpacked by plain names into one folder.
"""

import io
import json
import platform
import zipfile
import zlib
from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from bridge.batch.isolation import Failure
from bridge.config import check_function, config_from_dict, config_to_dict, functions_of
from bridge.files import MAX_FILE_MB, beside, one_line, printable, read_regular
from bridge.recordings.folders import Address, Choices, Source, split_of
from bridge.recordings.sources import find_one, source_files
from hid2.params import Config
from netconvert.errors import BatchError, ConfigError, NoSceneError

#: Functions that a bundle may ask for: any other has to be named with `--function`.
OWN_WORK = frozenset(
    {
        "bridge.batch.scene_work:generate_runs",
        "bridge.studies.paired:measure_runs",
        "bridge.studies.paired:measure_runs_for_ssam",
        "bridge.studies.road_traffic:measure_roads",
    }
)
#: Longest time a scene may be given, s.
MAX_TIMEOUT_S = 86_400.0
#: A bundle: size of the file and of what it unpacks to, MB; files in it. A real one has 1 MB and five files.
MAX_BUNDLE_MB, MAX_UNPACKED_MB, MAX_MEMBERS = 64, 128, 64

_REQUEST, _FAILURE, _DETAILS, _SCENE = "request.json", "failure.json", "details.txt", "scene/"
#: What comes of a file that is no bundle.
_REFUSED = (OSError, ValueError, KeyError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error, ConfigError)
#: How the entry of a file in the directory of an archive begins.
_ENTRY = b"PK\1\2"
#: Files of a scene in a bundle, MB together, so that it can be read again; a scene's own come first.
_MOST_OF_SCENE_MB = 60
_MOST_DETAILS, _MOST_REASON = 200_000, 2_000
#: What is unpacked of each member at most, MB; of others MAX_FILE_MB. Real: 0.02, 0.002, 0.2.
_MOST_MB = {_REQUEST: 1, _FAILURE: 1, _DETAILS: 4}


class _Request(BaseModel):
    """What is to be run again."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    format: Literal[1]
    version: Annotated[str, Field(max_length=200)]
    python: Annotated[str, Field(max_length=200)]
    platform: Annotated[str, Field(max_length=1_000)]
    scenario: Annotated[str, Field(max_length=255)]
    split: Literal["train", "val", "test"] | None
    variant: Annotated[int, Field(ge=0, le=1_000_000)]
    start: Annotated[int, Field(ge=0, le=1_000_000)] = 0
    map: Annotated[str, Field(max_length=255)] | None = None
    timeout_s: Annotated[float, Field(ge=1, le=MAX_TIMEOUT_S)]
    function: Annotated[str, Field(pattern=r"^[A-Za-z_][\w.]*:[A-Za-z_]\w*$", max_length=200)]
    config: dict[str, Any]
    left_out: Annotated[list[Annotated[str, Field(max_length=255)]], Field(max_length=MAX_MEMBERS)] = []


@dataclass(frozen=True, slots=True)
class Bundle:
    """A failed run. folder: of the recording; function: what ran it."""

    folder: Address
    config: Config
    variant: int
    timeout_s: float
    function: str
    failure: Failure
    version: str


def write_bundle(bundle: Bundle, path: Path) -> None:
    """Write a bundle, the same bytes for the same failure. Errors: ExportError."""
    files, left_out = _packed(bundle.folder)
    source = bundle.folder if isinstance(bundle.folder, Source) else None
    request = _Request(
        format=1,
        version=bundle.version,
        python=platform.python_version(),
        platform=platform.platform(),
        scenario=one_line(bundle.folder.name, most=200),
        split=split_of(bundle.folder),  # type: ignore[arg-type]  # one of these
        variant=bundle.variant,
        start=source.start if source is not None else 0,
        map=source.map_path.name if source and source.map_path and source.map_path.is_file() else None,
        timeout_s=bundle.timeout_s,
        function=bundle.function,
        config=config_to_dict(bundle.config),
        left_out=left_out[:MAX_MEMBERS],
    )
    seen = {"kind": bundle.failure.kind, "message": printable(bundle.failure.message[:_MOST_REASON])}
    members = {
        _REQUEST: request.model_dump_json(indent=1).encode(),
        _FAILURE: json.dumps(seen, indent=1, ensure_ascii=False).encode(),
        _DETAILS: printable(bundle.failure.details[-_MOST_DETAILS:]).encode(),
        **{_SCENE + name: content for name, content in files.items()},
    }
    with beside(path) as hidden, zipfile.ZipFile(hidden, "w") as archive:
        for name, content in members.items():
            archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)


def _packed(folder: Address) -> tuple[dict[str, bytes], list[str]]:
    """Files of a scene by name; names of those that are no regular ones, or beyond what is read, alone or together."""
    if isinstance(folder, Source):  # what is read of it
        there = source_files(folder)
    else:  # all in the folder, which may be damaged, or not be there
        own = "scenario_", "log_map_archive_", "hid2_"
        there = sorted(folder.glob("*"), key=lambda path: (not path.name.startswith(own), path))
    files, left_out, room = dict[str, bytes](), list[str](), _MOST_OF_SCENE_MB * 1_000_000
    for number, entry in enumerate(there):
        name, content = one_line(entry.name, most=200), None
        if number < MAX_MEMBERS - 3 and not name.startswith("."):
            with suppress(OSError):
                content = read_regular(entry, most_mb=MAX_FILE_MB)
        if content is None or len(content) > room:
            left_out.append(name)
        else:
            files[name] = content
            room -= len(content)
    return files, left_out


def read_bundle(path: Path, into: Path, *, functions: Collection[str] = ()) -> Bundle:
    """Read a bundle and unpack its scene below `into`; nothing is imported, or written elsewhere.

    functions: those beyond hid2's own that the caller agrees to. Errors: BatchError.
    """
    try:
        content = read_regular(path, most_mb=MAX_BUNDLE_MB)
        if content.count(_ENTRY) > 2 * MAX_MEMBERS:  # before `zipfile` makes an object of each; data hold few by chance
            raise ValueError(f"more than {2 * MAX_MEMBERS} files in it, expected at most {MAX_MEMBERS}")
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = _members(archive)
            request = _Request.model_validate_json(_unpack(archive, members[_REQUEST]))
            seen = TypeAdapter(Failure).validate_json(_unpack(archive, members[_FAILURE]), strict=True)
            check_function(request.function, {*OWN_WORK, *functions}, where="function")
            config = config_from_dict(request.config, source="config")
            for name, key in functions_of(config).items():
                check_function(name, functions, where=f"config: {key}")
            details = printable(_unpack(archive, members[_DETAILS]).decode())
            folder = into / (request.split or "scenes") / _plain(request.scenario)
            folder.mkdir(parents=True)
            for name, member in members.items():
                if name.startswith(_SCENE):
                    (folder / _plain(name.removeprefix(_SCENE))).write_bytes(_unpack(archive, member))
            address = _unpacked(folder, request)
    except _REFUSED as error:
        said = one_line(_said(error), most=500)
        raise BatchError(f"{path}: not a bundle of hid2 that can be run ({said})") from error
    failure = Failure(seen.kind, one_line(seen.message, most=_MOST_REASON), details)
    version = one_line(request.version, most=200)
    return Bundle(address, config, request.variant, request.timeout_s, request.function, failure, version)


def _unpacked(folder: Path, request: _Request) -> Address:
    """The recording in an unpacked scene; the folder itself where none is recognised: reading it says why."""
    try:
        map_path = None if request.map is None else folder / _plain(request.map)
        sequence = next(folder.glob("*.csv"), folder) if map_path is not None else folder  # not the map beside it
        return find_one(sequence, Choices(map_path, request.start))
    except (NoSceneError, ConfigError):
        return folder


def _members(archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    """The files of an archive by name, of known kinds and bounded size. Errors: ValueError."""
    found = archive.infolist()
    if len(found) > MAX_MEMBERS:
        raise ValueError(f"{len(found)} files in it, expected at most {MAX_MEMBERS}")
    unpacked = sum(member.file_size for member in found)
    if unpacked > MAX_UNPACKED_MB * 1_000_000:
        raise ValueError(f"it unpacks to {unpacked / 1e6:.0f} MB, expected at most {MAX_UNPACKED_MB} MB")
    members: dict[str, zipfile.ZipInfo] = {}
    for member in found:
        name = member.filename
        if name in members:
            raise ValueError(f"file {name!r} is in it twice")
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ValueError(f"file {name!r}: compression {member.compress_type}, expected none or deflate")
        if name.startswith(_SCENE):
            _plain(name.removeprefix(_SCENE))
        elif name not in (_REQUEST, _FAILURE, _DETAILS):
            raise ValueError(f"file {name!r}, expected {_REQUEST}, {_FAILURE}, {_DETAILS} and {_SCENE}<file>")
        members[name] = member
    return members


def _unpack(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """What a member holds, never unpacked beyond its limit, whatever its size is said to be. Errors: ValueError."""
    most_mb = _MOST_MB.get(member.filename, MAX_FILE_MB)
    with archive.open(member) as stream:
        content = stream.read(most_mb * 1_000_000 + 1)
    if len(content) > most_mb * 1_000_000:
        raise ValueError(f"file {member.filename!r} unpacks to more than {most_mb} MB")
    return content


def _plain(name: str) -> str:
    """A name that stays in its folder and can be printed. Errors: ValueError."""
    if not name or name != Path(name).name or name.startswith(".") or not name.isprintable() or len(name) > 255:
        raise ValueError(f"name {name[:100]!r}, expected that of a file, without folders and leading dot")
    return name


def _said(error: Exception) -> str:
    """What speaks against a bundle."""
    if isinstance(error, ValidationError):
        first = error.errors(include_url=False)[0]
        field = ".".join(str(part) for part in first["loc"]) or "the file"
        return f"{field}: {first['msg']}, have {first['input']!r}"
    return f"no {error} in it" if isinstance(error, KeyError) else getattr(error, "strerror", None) or str(error)
