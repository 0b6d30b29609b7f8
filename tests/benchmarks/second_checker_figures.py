"""What the second checker finds: in scenes of hid2, and on recorded tracks taken for inserted ones. A script, no test:

python tests/benchmarks/second_checker_figures.py SCENES... [--sources ROOT...]

SCENES: roots of generated scenes. Every finding in them is printed, by quantity. The rates are of the moving vehicles
of category 1 to 3 of the recorded scenes below the sources: the share that has each finding when they are judged as if
they had been inserted. --sources serves for agent_sizes.csv as well.
"""

import argparse
import json
import sys
from collections import Counter, defaultdict
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

from second_checker import CHECKS, Finding, check_folder
from second_scene import SecondScene, read_scene


def folders(root: Path) -> list[Path]:
    return sorted({path.parent for path in root.glob("**/scenario_*.parquet")})


def of_recorded(scene: SecondScene) -> tuple[int, dict[str, set[str]]]:
    """Moving vehicles of category 1 to 3, and which of them have each finding, one after the other as if inserted."""
    found: dict[str, set[str]] = defaultdict(set)
    movers = [
        one for one in scene.tracks
        if one.object_type in ("vehicle", "bus") and one.category > 0 and one.moves and len(one.steps) >= 5
    ]  # fmt: skip
    for track in movers:
        alone = replace(scene, inserted_ids=[track.track_id])
        for check in CHECKS:
            for one in check(alone, track):
                found[one.quantity].add(track.track_id)
    return len(movers), found


def line(one: Finding) -> str:
    where = f"{one.scene} {one.vehicle} step {one.step}"
    return f"{one.quantity}: {where}: {one.value:.3f}, limit {one.limit:g} {one.other}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", type=Path)
    parser.add_argument("--sources", nargs="*", type=Path, default=[])
    arguments = parser.parse_args()
    sources = {folder.name: folder for root in arguments.sources for folder in folders(root)}
    count, vehicles, findings = 0, 0, []
    for folder in [one for root in arguments.scenes for one in folders(root)]:
        (sidecar,) = folder.glob("hid2_*.json")
        made = json.loads(sidecar.read_text())
        findings += check_folder(folder, sources.get(made["source_scenario_id"]))
        count, vehicles = count + 1, vehicles + len(made["agents"])
    if count:
        print(f"{count} scenes with {vehicles} inserted vehicles: {dict(Counter(one.quantity for one in findings))}")
        for one in sorted(findings, key=lambda one: (one.quantity, one.scene, one.vehicle)):
            print(" ", line(one))
    movers, with_finding = 0, Counter()
    for folder in sources.values():
        scene = read_scene(folder)
        some, found = of_recorded(scene)
        movers += some
        with_finding.update({quantity: len(ids) for quantity, ids in found.items()})
        shares = {quantity: round(len(ids) / max(some, 1), 2) for quantity, ids in sorted(found.items())}
        print(f"recorded {scene.scenario_id[:8]}: {some} moving vehicles; {shares}")
    if movers:
        print(f"recorded, all {movers}:", {name: round(n / movers, 3) for name, n in with_finding.most_common()})


if __name__ == "__main__":
    main()
