"""Scenes, recorded or generated, in the formats of others: what `hid2 export` does."""

from collections.abc import Mapping
from pathlib import Path
from pkgutil import resolve_name

from bridge.recordings.folders import Address
from bridge.recordings.sources import read_recording
from bridge.sumo.net import write_all
from netconvert.errors import ConfigError

#: Module and function of each format's writer: a scene in, contents by file name out. Imported when it is asked for.
WRITERS: Mapping[str, str] = {
    "openscenario": "bridge.exports.openscenario:openscenario_files",
    "opendrive": "bridge.exports.openscenario:opendrive_files",
    "commonroad": "bridge.exports.commonroad:commonroad_files",
    "trj": "bridge.recordings.ssam:trj_files",
    "sumo": "bridge.sumo.exchange:sumo_files",
    "fcd": "bridge.sumo.exchange:fcd_files",
}


def export_scene(address: Address | str, to: str, out_dir: Path) -> list[Path]:
    """Write a scene in a format of WRITERS into out_dir, all files or, after an error, none; returns the files.

    Errors: ConfigError for another format; ScenarioError, MapError; NetError where it cannot be said in the format;
    ExportError where not be written.
    """
    if to not in WRITERS:
        raise ConfigError(f"format {to!r}: expected one of {', '.join(WRITERS)}")
    files: dict[str, bytes] = resolve_name(WRITERS[to])(read_recording(address))
    write_all(out_dir, files)
    return [out_dir / name for name in files]
