"""What the second checker finds in scenes of hid2, by quantity. A script, no test:

python tests/benchmarks/second_checker_figures.py SCENES... [--sources ROOT...]

SCENES: roots of generated scenes; sources: those of their recordings, for agent_sizes.csv.
"""

import argparse
import json
import sys
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

from second_checker import check_folder


def folders(root: Path) -> list[Path]:
    return sorted({path.parent for path in root.glob("**/scenario_*.parquet")})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--sources", nargs="*", type=Path, default=[])
    arguments = parser.parse_args()
    sources = {folder.name: folder for root in arguments.sources for folder in folders(root)}
    count, vehicles, findings = 0, 0, []
    for folder in [one for root in arguments.scenes for one in folders(root)]:
        (sidecar,) = folder.glob("hid2_*.json")
        made = json.loads(sidecar.read_text())
        findings += check_folder(folder, sources.get(made["source_scenario_id"]))
        count, vehicles = count + 1, vehicles + len(made["agents"])
    print(f"{count} scenes with {vehicles} inserted vehicles: {dict(Counter(one.quantity for one in findings))}")
    for one in sorted(findings, key=lambda one: (one.quantity, one.scene, one.vehicle)):
        where = f"{one.scene} {one.vehicle} step {one.step}"
        print(f"  {one.quantity}: {where}: {one.value:.3f}, limit {one.limit:g} {one.other}")


if __name__ == "__main__":
    main()
