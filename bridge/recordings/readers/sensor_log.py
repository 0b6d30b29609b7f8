"""Argoverse 2 sensor logs: where their files are; `bridge.recordings.sensor_log` reads them."""

import fnmatch
import uuid
from pathlib import Path

from bridge.recordings.folders import (
    ANNOTATIONS,
    LOG_MAP_NAME,
    POSES,
    Address,
    Choices,
    Reader,
    Source,
    log_maps,
    split_of,
)


def _find(path: Path, _: frozenset[str], choices: Choices) -> list[Address]:
    """The window that was chosen, and with a stride all from there on that fit."""
    starts = [choices.window]
    if choices.stride is not None:
        from bridge.recordings.sensor_log import last_start

        starts = list(range(choices.window, max(last_start(path), choices.window) + 1, choices.stride))
    log_id, split = _log_id(path), split_of(path)
    return [Source(path, SENSOR_LOG.name, window_id(log_id, start), split, start) for start in starts]


def _files(source: Source) -> list[Path]:
    return [*sorted(source.path.glob(ANNOTATIONS))[:1], source.path / POSES, *log_maps(source.path)]


def window_id(log_id: str, start: int) -> str:
    """Scenario id of the window of a log that begins at a sweep: the log's own id for the first."""
    if start == 0:
        return log_id
    try:
        space = uuid.UUID(log_id)
    except ValueError:
        space = uuid.uuid5(uuid.NAMESPACE_DNS, log_id)
    return str(uuid.uuid5(space, str(start)))


def _log_id(log: Path) -> str:
    maps = log_maps(log)
    named = LOG_MAP_NAME.fullmatch(maps[0].stem) if len(maps) == 1 else None
    return named[1] if named is not None else log.absolute().name


#: Windows of sensor logs. An id is the log's for the first window, of log and first sweep for any other.
SENSOR_LOG = Reader(
    name="sensor_log",
    many="Windows of Argoverse 2 sensor logs",
    sniff=lambda _, names: POSES in names or bool(fnmatch.filter(names, ANNOTATIONS)),
    find=_find,
    files=_files,
    lacks="Sensor logs have no focal and scored tracks and no centrelines of lanes: the longest path of a vehicle that "
    "is seen throughout is focal, centrelines run midway between the boundaries",
)
