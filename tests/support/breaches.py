"""Findings on the format alone: made-up vehicles drive circles wherever the map may be, which the judge finds."""

from pathlib import Path
from typing import Any

from bridge.batch.validation import validate_folder
from bridge.recordings.validate import FileBreach
from hid2.judge.findings import Quantity


def breaches(out: Path, **arguments: Any) -> list[FileBreach]:
    """What `validate_folder` finds of a data set, without what the judge says of inserted vehicles."""
    return [finding for finding in validate_folder(out, **arguments) if finding.rule not in list(Quantity)]
