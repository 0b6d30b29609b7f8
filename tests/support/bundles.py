"""Bundles of quarantined scenes, made by hand: what a user may get from anywhere."""

import io
import json
import zipfile
from collections.abc import Mapping
from typing import Any

from bridge.config import config_to_dict
from hid2.params import Config

OWN = "bridge.batch.scene_work:generate_runs"


def members(**changes: Any) -> dict[str, bytes]:
    """Files of a bundle by name; changes: of its request."""
    request = {"format": 1, "version": "1", "python": "3", "platform": "x", "scenario": "scene", "split": "val"}
    request |= {"variant": 0, "timeout_s": 5.0, "function": OWN, "config": config_to_dict(Config()), "left_out": []}
    return {
        "request.json": json.dumps(request | changes).encode(),
        "failure.json": json.dumps({"kind": "error", "message": "m"}).encode(),
        "details.txt": b"",
        "scene/scenario_x.parquet": b"rows",
    }


def zipped(files: Mapping[str, bytes], *, compression: int = zipfile.ZIP_DEFLATED) -> bytes:
    """An archive of files."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", compression) as archive:
        for name, value in files.items():
            archive.writestr(name, value)
    return content.getvalue()
