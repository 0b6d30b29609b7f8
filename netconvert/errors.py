"""The tree of errors: everything that a user can cause has a class here, and every message names file, id and value."""


class Hid2Error(Exception):
    """Any failure that is explained to the user in one line instead of a traceback."""


class MapError(Hid2Error):
    """The map cannot be used: missing, not JSON, or a lane segment breaks the format."""


class NetError(Hid2Error):
    """The SUMO net cannot be built or written."""


class ScenarioError(Hid2Error):
    """The recorded scenario cannot be used: missing, not parquet, or a row breaks the format."""


class ConfigError(Hid2Error):
    """A parameter is unknown, of the wrong type or out of its range."""


class NoSceneError(ScenarioError, MapError, ConfigError):
    """A path that was named holds no scene, or none that is wanted."""


class SimulationError(Hid2Error):
    """SUMO refused a call, or a second simulation was started in one process."""


class ExportError(Hid2Error):
    """The result cannot be written."""


class DiskFullError(ExportError):
    """Nothing more can be written, whatever it is: the disk is full, over its quota or read-only."""


class BatchError(Hid2Error):
    """A batch cannot go on: its scheduler is lost, its folder is in use, or its bundle cannot be read."""
