"""Work for scene processes of the fuzzer: copy or generate a scene, write it, and let the checker judge it."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

from fuzz import FOUND
from scene_checker import check_scene

from bridge.batch import scene_work
from bridge.batch.batch import Run, SceneFolders
from bridge.batch.isolation import Failure
from bridge.batch.manifest import ManifestRow
from bridge.generation.scene import TrafficScene


def checked(place: SceneFolders, runs: Sequence[Run]) -> Iterator[ManifestRow | Failure]:
    """Generate and write each run; what the checker finds is put into a file beside."""

    def finish(scene: TrafficScene, place: SceneFolders) -> Path:
        found = check_scene(scene)
        if found:
            (place.out / FOUND).mkdir(exist_ok=True)
            (place.out / FOUND / f"{place.folder.name}.json").write_text(json.dumps(found, indent=1))
        return scene.write(place.out)

    scene_work.write_all = finish  # in a process of its own
    yield from scene_work.generate_runs(place, runs)
