"""The OpenDRIVE file of a scene as SUMO's netconvert reads it: lanes, connections, centrelines."""

from pathlib import Path

import pytest
from drawn_roads import check_roads

from bridge.exports.export import export_scene
from bridge.recordings.sources import read_recording


def check(scene: Path, folder: Path) -> None:
    (file,) = export_scene(scene, "opendrive", folder)
    check_roads(file, read_recording(scene).graph, folder)


def test_netconvert_reads_a_real_map_whole(real_scenes: list[Path], tmp_path: Path) -> None:
    """Bicycle lanes and lanes beside them lead to one lane."""
    check(real_scenes[0], tmp_path)


@pytest.mark.slow
def test_netconvert_reads_fourteen_real_maps_whole(fourteen_scenes: list[Path], tmp_path: Path) -> None:
    for scene in fourteen_scenes:
        check(scene, tmp_path / scene.name)
