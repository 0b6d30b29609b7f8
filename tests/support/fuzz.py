"""Damages scenes by the thousand, generates from them in isolated processes, and lets validate and the checker judge.

    python tests/support/fuzz.py --count 2000 --jobs 2

Exit code 1, with the seeds, where a scene crashed, hung, raised what nobody explains, or was done with a finding that
its source does not have. Each scene is made from its seed alone; recorded rows are compared with those of the damaged
source, bit for bit.
"""

import argparse
import json
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
from mutations import mutate_scene

from bridge.batch.batch import Options, plan, run_batch
from bridge.batch.manifest import DONE
from bridge.batch.validation import validate_folder
from bridge.config import load_config
from bridge.recordings.scenario import find_scenarios

ROOT = Path(__file__).parents[2]
#: Below OUT: what the checker found in a scene, a file for each that has something.
FOUND = "found"


def damaged(folders: Sequence[Path], seed: int, root: Path) -> tuple[Path, str]:
    """A copy of one of the scenes with an id of its own, damaged by its seed; and how."""
    source, new_id = folders[seed % len(folders)], f"{seed:08d}-0000-4000-8000-000000000000"
    folder = root / f"seed-{seed:06d}"
    folder.mkdir(parents=True)
    table = pq.read_table(next(source.glob("scenario_*.parquet")))
    index = table.schema.get_field_index("scenario_id")
    column = pa.array([new_id] * table.num_rows, table.schema.field(index).type)
    pq.write_table(table.set_column(index, "scenario_id", column), folder / f"scenario_{new_id}.parquet")
    shutil.copyfile(next(source.glob("log_map_archive_*.json")), folder / f"log_map_archive_{new_id}.json")
    return folder, mutate_scene(folder, seed)


def main() -> int:
    """Damage, generate, check; print what became of the scenes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--root", type=Path, default=ROOT / "data" / "av2", help="scenes to damage")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--agents", type=int, default=3)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--timeout", type=float, default=60.0)
    parser.add_argument("--keep", type=Path, default=None, help="folder to work in, which is kept")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="hid2-fuzz-") as scratch:
        place = arguments.keep or Path(scratch)
        scenes, out = find_scenarios(arguments.root), place / "out"
        made = [
            damaged(scenes, seed, place / "source")
            for seed in range(arguments.first, arguments.first + arguments.count)
        ]
        how = {folder.name: said for folder, said in made}
        config = load_config(flags={"request.agents": arguments.agents})
        options = Options(jobs=arguments.jobs, timeout_s=arguments.timeout, function="fuzz_work:checked")
        rows = run_batch(plan([folder for folder, _ in made], config), out, options)
        bad = []
        for row in rows:
            if row.failure not in ("", "error", "memory"):
                bad.append(f"{row.scenario} ({how[row.scenario]}): {row.failure}: {row.reason}")
            if row.status == DONE:
                findings = validate_folder(out / row.folder, source=place / "source" / row.scenario)
                said = [f"{finding.rule}: {finding.message}" for finding in findings if not finding.is_note]
                bad += [f"{row.scenario} ({how[row.scenario]}): {one}" for one in said]
        for file in sorted((out / FOUND).glob("*.json")):
            bad += [f"{file.stem} ({how[file.stem]}): {said}" for said in json.loads(file.read_text())]
    kinds = Counter(row.failure or row.status for row in rows)
    print(f"{len(rows)} scenes: {dict(kinds)}; slowest {max(row.seconds for row in rows):.1f} s; {len(bad)} to look at")
    print("\n".join(bad))
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
