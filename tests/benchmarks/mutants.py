"""Mutants where numbers decide, and the tests that must notice each. A script, no test:

python tests/benchmarks/mutants.py [NAME ... | --drawn ROOM ... [--count 10] [--seed 0]]

The tree is copied, one text of one file is replaced at a time, and the tests named are run there. Exit status 1 where
a mutant survives, where its text is not in its file exactly once any more, or where the tests fail without any mutant.
With --drawn mutants are drawn over the modules of folders such as hid2/policy, a comparison, a sign and a number in
turn, for the tests of tests/unit/ROOM; exit status 1 where less than 95 % are caught.
"""

import argparse
import ast
import itertools
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
UNIT = "tests/unit/hid2"
#: Kernels are interpreted: compiling them anew for a mutant would take longer than the tests.
ENVIRONMENT = {"OMP_NUM_THREADS": "1", "NUMBA_DISABLE_JIT": "1"}
CAUGHT_SHARE = 0.95  # of drawn mutants: some change nothing that anybody could notice
#: A comparison and its neighbour, a sign and the other.
NEIGHBOURS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.USub: ast.UAdd,
}  # fmt: skip


class Mutant(NamedTuple):
    """A text of a file, what is there instead, and the tests that must fail then."""

    file: str
    text: str
    instead: str
    tests: tuple[str, ...]


MUTANTS = {
    "lane change: two cells for three": Mutant(
        "hid2/policy/observation.py", "_cells_free(scene, (before, cell, following), inserted)",
        "_cells_free(scene, (before, cell), inserted)", (f"{UNIT}/policy/test_observation.py",),
    ),
    "lane change: front gap by the other's speed": Mutant(
        "hid2/policy/lane_change.py", "safe_gap_m(speed_mps, front.speed_mps,",
        "safe_gap_m(front.speed_mps, speed_mps,", (f"{UNIT}/policy/test_lane_change.py",),
    ),
    "lane change: rear gap with the time gap of the front": Mutant(
        "hid2/policy/lane_change.py", "time_gap_s=params.time_gap_rear_s", "time_gap_s=params.time_gap_front_s",
        (f"{UNIT}/policy/test_lane_change.py",),
    ),
    "sigma: kept vehicles hold no cell": Mutant(
        "hid2/policy/observation.py",
        "for traffic, column in ((inserted.known, step), (inserted.driven, 0))\n        if traffic.ids\n",
        "for traffic, column in ((inserted.driven, 0),)\n        if traffic.ids\n",
        (f"{UNIT}/policy/test_observation.py",),
    ),
    "conflict case 2: the farther one goes first": Mutant(
        "hid2/kernels/guard.py", "return theirs < mine or", "return theirs > mine or",
        (f"{UNIT}/conflicts/test_guard.py",),
    ),
    "trigger: a step late": Mutant(
        "hid2/policy/decision.py", "time_s >= trigger_s", "time_s > trigger_s",
        (f"{UNIT}/policy/test_decision.py",),
    ),
    "end of the scene: half the time is enough": Mutant(
        "hid2/judge/states.py", "ttc_s < bounds.conflict.end_ttc_min_s + bounds.spare_end_s:",
        "ttc_s < 0.5 * bounds.conflict.end_ttc_min_s:", (f"{UNIT}/judge/test_states.py",),
    ),
    "critical TTC: four fifths are enough": Mutant(
        "hid2/judge/states.py", "critical_s = bounds.conflict.ttc_min_s\n    for other, ttc_s",
        "critical_s = 0.8 * bounds.conflict.ttc_min_s\n    for other, ttc_s", (f"{UNIT}/insertion/test_finalise.py",),
    ),
    "critical PET: four fifths are enough": Mutant(
        "hid2/judge/states.py", "arrays, critical_s = states.arrays, bounds.conflict.pet_min_s",
        "arrays, critical_s = states.arrays, 0.8 * bounds.conflict.pet_min_s", (f"{UNIT}/insertion/test_finalise.py",),
    ),
    "smoothing: the line may stray three times as far": Mutant(
        "hid2/motion/reference_line.py", ".max() > max_offset_m:", ".max() > 3.0 * max_offset_m:",
        (f"{UNIT}/motion/test_reference_line.py",),
    ),
    "mix: rounded, not drawn": Mutant(
        "hid2/insertion/requests.py", "offset, upto, before = float(rng.random()), 0.0, 0",
        "offset, upto, before = 0.5, 0.0, 0", (f"{UNIT}/insertion/test_requests.py",),
    ),
    "order of kept vehicles: the earlier one goes": Mutant(
        "hid2/insertion/finalise.py", "max(row_of[one.track_id], row_of.get(one.other or \"\", -1))",
        "row_of[one.track_id]",
        (f"{UNIT}/insertion/test_finalise.py",),
    ),
    "resume: an edited source is taken as done": Mutant(
        "bridge/batch/batch.py", "== (base.version, base.source_sha256,", "== (base.version, row.source_sha256,",
        ("tests/batch/test_batch.py::TestResume",),
    ),
}  # fmt: skip


def copy(folder: Path) -> None:
    """What git has, or would have, of the tree."""
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listed, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    for name in filter(None, names.split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, folder / name)


def failures(folder: Path, tests: Sequence[str]) -> tuple[int, list[str]]:
    """Exit status of pytest in a folder, and the tests that failed."""
    command = [sys.executable, "-m", "pytest", "-n", "0", "-p", "no:cacheprovider", "-q", "-x", "--tb=no", *tests]
    command += ["-W", "ignore:invalid value encountered:RuntimeWarning"]  # compiled kernels do not warn of inf - inf
    environment = os.environ | ENVIRONMENT | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(command, cwd=folder, env=environment, check=False, capture_output=True, text=True)
    return done.returncode, [
        line.removeprefix("FAILED ").split(" - ")[0].split("::", 1)[-1]
        for line in done.stdout.splitlines()
        if line.startswith("FAILED ")
    ]


def verdict(folder: Path, mutant: Mutant) -> tuple[bool, str]:
    """Whether a mutant was noticed in a copy of the tree, and by whom, or what went wrong."""
    path = folder / mutant.file
    source = path.read_text(encoding="utf-8")
    if source.count(mutant.text) != 1:
        return False, f"{mutant.file} has its text {source.count(mutant.text)} times, expected once"
    path.write_text(source.replace(mutant.text, mutant.instead), encoding="utf-8")
    try:
        status, failed = failures(folder, mutant.tests)
    finally:
        path.write_text(source, encoding="utf-8")
    if status != 1:
        return False, "SURVIVED" if status == 0 else f"pytest ended with status {status}"
    return True, ", ".join(failed)


def left_alone(node: ast.AST, lines: Sequence[str]) -> bool:
    """Texts of errors and logs, and what a comment, beside it or right above, says to be no parameter."""
    if isinstance(node, ast.Assign | ast.AnnAssign):
        above = node.lineno - 1
        while lines[above - 1].lstrip().startswith("#"):
            above -= 1
        said = " ".join(line.strip(" #:") for line in lines[above : node.end_lineno]).lower()
        return "saves time" in said or "not a parameter" in said
    told = isinstance(node, ast.Call) and ast.unparse(node.func).startswith(("_LOG.", "print"))
    return told or isinstance(node, ast.JoinedStr | ast.Raise)


def below(node: ast.AST, lines: Sequence[str]) -> Iterator[ast.AST]:
    """Nodes below one where numbers may decide: no annotations, nothing that is left alone."""
    for field, value in ast.iter_fields(node):
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and field not in {"annotation", "returns"} and not left_alone(child, lines):
                yield child
                yield from below(child, lines)


def changes(node: ast.AST, rng: random.Random) -> Iterator[tuple[str, str, object]]:
    """What may be changed of a node: the kind of mutant, the attribute, and what is there instead."""
    if isinstance(node, ast.Compare):
        for n, op in enumerate(node.ops):
            if type(op) in NEIGHBOURS:
                yield "comparison", "ops", [*node.ops[:n], NEIGHBOURS[type(op)](), *node.ops[n + 1 :]]
    elif isinstance(node, ast.BinOp | ast.AugAssign | ast.UnaryOp) and type(node.op) in NEIGHBOURS:
        yield "sign", "op", NEIGHBOURS[type(node.op)]()
    elif isinstance(node, ast.Constant) and type(node.value) in {int, float}:
        value, side = node.value, rng.choice((-1, 1)) if node.value else 1
        by = max(round(0.3 * value), 1) if isinstance(value, int) else 0.3 * value or 1.0
        yield "number", "value", type(value)(f"{value + side * by:.12g}")


def drawn(room: str, count: int, seed: int) -> dict[str, Mutant]:
    """Mutants of the modules of a folder, the same for a seed. Their text is all of a file; they may loop for ever."""
    rng, kinds = random.Random(f"{seed} {room}"), {"comparison": [], "sign": [], "number": []}
    for path in sorted((ROOT / room).glob("*.py")):
        source = path.read_text(encoding="utf-8")
        tree = ast.parse(source)
        for node in below(tree, source.splitlines()):
            for kind, attribute, instead in changes(node, rng):
                kinds[kind].append((path.relative_to(ROOT).as_posix(), source, tree, node, attribute, instead))
    for found in kinds.values():
        rng.shuffle(found)
    in_turn = (one for row in itertools.zip_longest(*kinds.values()) for one in row if one is not None)
    mutants = {}
    for name, source, tree, node, attribute, instead in itertools.islice(in_turn, count):
        was, before = ast.unparse(node), getattr(node, attribute)
        setattr(node, attribute, instead)
        said = f"{name}:{node.lineno}:{node.col_offset + 1}: {was} -> {ast.unparse(node)}"
        mutants[said] = Mutant(name, source, ast.unparse(tree), (f"tests/unit/{room}", "--timeout=60"))
        setattr(node, attribute, before)
    return mutants


def main() -> int:
    """Run the mutants asked for, all that are written down unless told."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="words of the names of mutants")
    parser.add_argument("--drawn", nargs="+", default=[], metavar="ROOM", help="folders, such as hid2/policy")
    parser.add_argument("--count", type=int, default=10, help="mutants drawn in each")
    parser.add_argument("--seed", type=int, default=0, help="of the draw")
    asked = parser.parse_args()
    if unknown := [room for room in asked.drawn if not (ROOT / "tests/unit" / room).is_dir()]:
        parser.error(f"--drawn {unknown[0]}: no folder tests/unit/{unknown[0]}, expected one such as hid2/policy")
    named = {name: one for name, one in MUTANTS.items() if any(word in name for word in asked.names or [""])}
    rooms = {room: drawn(room, asked.count, asked.seed) for room in asked.drawn} or {"written down": named}
    total = missed = 0
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        copy(folder)
        for room, chosen in rooms.items():
            status, failed = failures(folder, sorted({test for one in chosen.values() for test in one.tests}))
            if status != 0:
                print(f"without any mutant: pytest ended with status {status}: {', '.join(failed)}")
                return 1
            caught = 0
            for name, mutant in chosen.items():
                began = time.monotonic()
                noticed, said = verdict(folder, mutant)
                noticed |= bool(asked.drawn) and said != "SURVIVED"  # a module that cannot be imported is noticed
                caught += noticed
                took_s = time.monotonic() - began
                print(f"{'caught' if noticed else 'MISSED'} {took_s:5.1f} s  {name}: {said}", flush=True)
            total, missed = total + len(chosen), missed + len(chosen) - caught
            print(f"{room}: {caught} of {len(chosen)} mutants caught", flush=True)
    return int(missed > (1.0 - CAUGHT_SHARE if asked.drawn else 0.0) * total or not total)


if __name__ == "__main__":
    sys.exit(main())
