"""Mistakes of names, units, paths, formats, order and permissions: one line that helps each.

A line has the thing that is wrong, its value, what was expected, and what to do: the last two are often the same words,
as in "expected one of ...". A mistake that another test would run the command for is a row of this table.
"""

import os
import re
import shutil
from pathlib import Path

import pandas as pd
import pytest
from served import Served

from bridge.config import load_config
from bridge.generation.generate import generate
from bridge.generation.scene import read_scene

#: How a line says what to do.
WAY_OUT = r"expected|choose|give|did you mean|see |use |add |set |say which|continue|make it|free|unpack|convert|leave"

#: Command, then what its line names: the thing, its value, what was expected.
NAMES = [
    ("genrate av2 -o out", "command", "genrate", "generate"),
    ("generate av2 -o out --set request.agnts=3", "key", "request.agnts", "request.agents"),
    ("generate av2 -o out --event cutin --target focal", "--event", "cutin", "cut_in"),
    ("generate av2 -o out -j2 --scheduler tcp://a:1 --near ego", "near", "ego", "av"),
    ("generate av2 -o out --event cut_in --target 99999", "target", "99999", r"\(3 of 3\); .*expected av, focal, any"),
    ("generate av2 -o out --event lead --target ghost --agents 0", "target", "ghost", r"for tracker fragments \(\w"),
    ("generate s/curve -o out --behaviours left_turn=1", "behaviour", "left_turn", r"\(1 of 1\); .*curve: The map "),
    ("generate s/curve -o out --set request.left_turn=0.5", "behaviour", "left_turn", "another behaviour"),
    ("scan av2 --city Miamii", "city", "Miamii", "miami"),
    ("scan av2 --can u_turn", "--can", "u_turn", "left_turn"),
    ("render s/made --agent gen0 -o a.png", "track", "gen0", "gen_0"),
    ("make coridor -o roads", "coridor", "coridor", "corridor"),
    ("generate av2 -o out --focal nobody", "--focal", "nobody", "generated"),
    ("paper table9 -o out", "EXPERIMENT", "table9", "table1"),
    ("example -o has_studies", "studies", "is there already", "a folder without it"),
    ("calibrate av2 -o a.toml --without nobody", "--without", "nobody", "no such scene"),
    ("export s/curve --to vissim -o out", "--to", "vissim", "'opendrive', 'commonroad', 'trj', 'sumo', 'fcd'"),
]
UNITS = [
    ("generate av2 -o out --event cut_in --at 2000:6000", "cut_in", "2000", "10.9 s"),
    ("generate av2 -o out --event cut_in --at 10.9", "cut_in", "at 10.9:10.9 s", "to be across by then"),
    ("generate av2 -o out --trigger-time 12", "trigger time", "12 s", "the scene ends at 10.9 s, expected"),
    ("generate av2 -o out --agents 10.5", "agents", "10.5", "max"),
    ("generate av2 -o out --behaviours lane_change=50%", "lane_change", "50%", "0 to 1"),
    ("make corridor -o roads --length 0.5", "--length", "0.5", "100 to 5000 m"),
    ("generate av2 -o out --min-agents 10000", "none of 3 scenes", "selection", "hid2 scan"),
    ("scan av2 --jobs 0", "--jobs", "0", "at least 1"),
    ("gui av2 --speed 200", "--speed", "200", "at most 100"),
    ("make corridor -o roads --lanes 1", "--lanes", "1", "2 to 8"),
    ("make arterial -o roads --lanes 3", "--lanes", "3", r"arterial\.toml has its own"),
]
PATHS = [
    ("generate av2 -o out --config av2", "av2", "is a folder", "configuration"),
    ("generate nowhere -o out", "nowhere", "no such folder", "scenario folder"),
    ("generate s/curve/scenario.parquet -o out", "scenario.parquet", "no such|is a file", "folder"),
    ("generate empty -o out", "empty", "no scenario", r"scenario_<id>\.parquet"),
    ("generate empty -o out --set lane_change.rule=no:rule", "lane_change.rule", "no:rule", "No module named 'no'"),
    ("generate av2 -o file", "file", "is a file", "folder"),
    ("generate av2 -o av2/train/out", "av2/train/out", "split folder", "outside"),
    ("generate s/curve -o s/curve/out", "curve/out", "inside the scene", "outside"),
    ("generate s/made -o out", "made", "generated scenes only", "recorded"),
    ("evaluate empty -o report", "empty", "no scenario", r"scenario_<id>\.parquet"),
    ("generate av2 -o out --config no.toml", r"no\.toml", "no such file", "TOML"),
    ("view s/curve -o empty", "empty", "is a folder", "file"),
    ("generate --from s/made --source av2 -o again", "made", "no sidecar", r"hid2_<id>\.json"),
    ("generate --repro no.zip", r"no\.zip", "no such file", "bundle"),
    ("generate --from no.json --source av2 -o out", r"no\.json", "no such file", "generated scene"),
    ("evaluate s/curve -o out --predictions x=no.parquet", r"error: no\.parquet", "no such file", "forecast file"),
    ("evaluate s/curve -o out --predictions s/curve", "error: s/curve", "no such file", "forecast file"),
    ("paper prediction --composed none -o out", "none", "no such folder", "scenario"),
    ("render av2 -o a.png", "av2", "several scenes", "one of them, such as av2/"),
]
FORMATS = [
    ("view s/curve -o scenes.pdf", r"scenes\.pdf", r"\.pdf", r"\.html"),
    ("render s/curve -o scene.tiff", r"scene\.tiff", r"\.tiff", r"\.png"),
    ("gui s/curve --screenshot a.txt", r"a\.txt", r"\.txt", r"\.png"),
    ("plot s/no_parquet --agent AV -o a.png", r"scenario_.*\.parquet", "not a parquet", "scenario|expected"),
    ("plot s/no_map --agent AV -o a.png", r"log_map_archive_.*\.json", "not JSON", "map"),
    ("plot s/no_column --agent AV -o a.png", r"scenario_.*\.parquet", "heading", "column"),
    ("plot s/no_sidecar --agent AV -o a.png", r"hid2_.*\.json", "not JSON", "sidecar"),
    ("generate av2 -o out --config bad.toml", r"bad\.toml", "not TOML", "configuration"),
    ("generate av2 -o out --drivers study.toml", r"study\.toml", "drivers", "--config"),
    ("study bad.toml -o out", r"bad\.toml", "not TOML", "study"),
    ("generate waymo -o out", "waymo", "tfrecord", "Argoverse"),
    ("generate scenes.zip -o out", r"scenes\.zip", "is a file|archive", "unpack"),
    ("calibrate av2 -o mine.csv", r"mine\.csv", "TOML", r"NAME\.toml"),
    ("generate s/curve -o out --stride 5", "--stride 5", "does nothing here", "windows of Argoverse 2 sensor logs"),
    ("render s/curve -o a.png --window 3", "--window 3", "does nothing here", "windows of Argoverse 2 sensor logs"),
    ("evaluate s/curve -o out --stride 5", "--stride 5", "does nothing here", "windows of Argoverse 2 sensor logs"),
    ("paper table1 -o out --scenes s/curve --stride 5", "--stride 5", "does nothing here", "windows"),
    ("validate s/curve --map s/curve", "--map s/curve", "does nothing here", "Argoverse 1 sequences"),
    ("generate av2 -o out --format argoverse1", "--format", "argoverse1", "Argoverse 1"),
    ("generate --repro table.csv", r"table\.csv", "no ZIP file", "bundle"),
    ("study no_scenes.toml -o out", r"no_scenes\.toml", "no key 'scenes'", "folders"),
    ("compose sources.toml -o out", r"sources\.toml", "sources.a", "expected"),
]
ORDER = [
    ("generate av2", "-o", "missing", "generate --help"),
    ("av2 generate -o out", "command", "av2", "hid2 --help"),
    ("generate av2 -o", "-o", "requires an argument", "generate --help"),
    ("generate av2 -o out --at 2:6", "--at", "without", "--event"),
    ("generate av2 -o out --event merge --at 6:2", "at", "6", "least|earlier|first"),
    ("generate --from SIDECAR -o again", "--from", "--source", "--source"),
    ("render s/made --step 3 -o a.gif", r"a\.gif", "every timestep", r"\.png"),
    ("generate av2 -o out --source here", "--source", "without", "--from"),
    ("generate x --from=a.json --no-spawn-leaders -j2 --resume", "--jobs, --resume, --spawn", "SCENE", "--from"),
    ("resimulate av2 -o out --seeds 2 --write 9", "--write 9", "of 2 rollouts", "as many at most"),
    ("--agents 9 generate av2 -o out", "option", "--agents", "behind its name"),
    ("evaluate s/made -o out --json", "--json", "without", "--predictions"),
    ("paper table1 -o out --val 0.5", "--val", "does nothing with table1", "leave it out"),
    ("evaluate av2 -o out --predictions f --control av2 --window 3", "--control, --window", "--predictions", "leave"),
    ("evaluate s/made -o out --control av2", "--control av2", "no scene generated from a source", "expected"),
    ("evaluate s/made -o out --predictions f --bands 70,50,50,-3", "--bands", "70,50,50,-3", "larger than the last"),
    ("paper density -o out --agents 3", "--agents", "does nothing with density", "leave it out"),
    ("paper prediction -o out --composed av2 --predictions av2 --seeds 9 --val .5", "--seeds, --val", "does", "leave"),
    ("paper prediction -o out --predictions av2", "--predictions", "needs --composed ROOT", "data sets"),
    ("paper prediction -o out --map m", "--map", "does nothing with prediction", "leave it out"),
    ("resimulate av2 -o out --take-out one --write 1", "--write", "--take-out one", "all"),
    ("compose --check av2 -o out", "-o out", "--check", "leave"),
    ("compose av2:many -o out", "av2:many", "SOURCE", "SOURCE:N"),
    ("generate av2 -o out --event cross --target av --target=focal", "--target", "given 2 times", "it holds one value"),
    ("generate av2 -o out -j2 --scheduler tcp://a:1 --city x", "--city", "no scene is there", "miami"),
    ("generate av2 -o out -j2 --scheduler tcp://a:1", "--jobs 2", "does nothing with --scheduler", "leave it out"),
    ("resimulate s/curve -o out --seeds 1", "scenes: 1", "two at least", "each half is driven"),
    ("net s/curve -o out --signals", "--signals", "cells", "--lanes whole"),
    ("net s/curve -o out --lanes whole --json", "--json", "does nothing with --lanes whole", "leave it out"),
    ("net map.json -o out --window 3 --map m", "--map, --window", "does nothing with .* of a map", "leave it out"),
    ("net missing.json -o out", r"missing\.json", "no such file", "log_map_archive_<id>.json"),
]
PERMISSIONS = [
    ("generate av2 -o locked/out --agents 1", "locked/out", "[Pp]ermission denied", "folder"),
    ("view s/curve -o locked/a.html", r"locked/a\.html", "[Pp]ermission denied", "folder"),
    ("render s/curve -o locked/a.png", r"locked/a\.png", "[Pp]ermission denied", "folder"),
    ("net s/curve -o locked/net", "locked/net", "[Pp]ermission denied", "folder"),
    ("evaluate s/made -o locked/report", "locked/report", "[Pp]ermission denied", "folder"),
    ("make corridor -o locked/roads", "locked/roads", "[Pp]ermission denied", "folder"),
    ("plot s/curve --agent AV -o locked/a.png", r"locked/a\.png", "[Pp]ermission denied", "folder"),
    ("calibrate av2 -o locked/drivers.toml", "locked/drivers", "[Pp]ermission denied", "folder"),
    ("study study.toml -o locked/study", "locked/study", "[Pp]ermission denied", "folder"),
    ("generate s/closed -o out", "closed", "[Pp]ermission denied|not readable", "read"),
    ("plot s/closed_rows --agent AV -o a.png", r"scenario_.*\.parquet", "[Pp]ermission denied", "read|scenario"),
    ("plot s/closed_map --agent AV -o a.png", r"log_map_archive_.*\.json", "[Pp]ermission denied", "read|map"),
    ("plot s/closed_sidecar --agent gen_0 -o a.png", r"hid2_.*\.json", "[Pp]ermission denied", "read|sidecar"),
    ("generate av2 -o out --config closed.toml", r"closed\.toml", "[Pp]ermission denied", "--config"),
]
MISTAKES = [*NAMES, *UNITS, *PATHS, *FORMATS, *ORDER, *PERMISSIONS]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory, data_root: Path, data_scenes: dict[str, Path]) -> Path:
    """A folder with a data set, a scene, a generated one, and what is broken or locked of each."""
    root = tmp_path_factory.mktemp("mistakes") / "work"
    shutil.copytree(data_root, root / "av2")
    curve = data_scenes["curve"]
    made = generate(read_scene(curve), load_config(None, ["request.agents=1"])).write(root / "out_of")
    for name in ("curve", "no_parquet", "no_map", "no_column", "closed", "closed_rows", "closed_map"):
        shutil.copytree(curve, root / "s" / name)
    for name in ("made", "no_sidecar", "closed_sidecar"):
        shutil.copytree(made, root / "s" / name)
    shutil.rmtree(root / "out_of")
    scenes = root / "s"
    (rows,) = (scenes / "no_column").glob("*.parquet")
    pd.read_parquet(rows).drop(columns="heading").to_parquet(rows)
    next((scenes / "no_parquet").glob("*.parquet")).write_text("rows")
    next((scenes / "no_map").glob("*.json")).write_text("{")
    next((scenes / "no_sidecar").glob("hid2_*.json")).write_text("{")
    (root / "waymo").mkdir()
    (root / "waymo" / "training.tfrecord").touch()
    for name in ("file", "scenes.zip"):
        (root / name).touch()
    (root / "table.csv").write_text("x,y\n1,2\n")
    (root / "bad.toml").write_text("[request\n")
    (root / "study.toml").write_text('scenes = ["av2"]\nseeds = 1\n[vary]\ntrigger_s = [1.0, 2.0]\n')
    (root / "no_scenes.toml").write_text("[vary]\ntrigger_s = [1.0]\n")
    (root / "sources.toml").write_text("[sources]\na = 3\n[sets.x]\n")
    (root / "empty").mkdir()
    (root / "has_studies" / "studies").mkdir(parents=True)
    closed = [
        *scenes.glob("closed_rows/*.parquet"),
        *scenes.glob("closed_map/log*"),
        *scenes.glob("closed_sidecar/hid2*"),
    ]
    (root / "closed.toml").touch()
    for path in (*closed, root / "closed.toml", scenes / "closed"):
        path.chmod(0)
    (root / "locked").mkdir(0o555)
    return root


def test_mistakes_are_answered_by_one_line_that_helps(place: Path) -> None:
    """What is there before is there afterwards, and nothing else."""
    before = {path for path in place.rglob("*") if "closed/" not in str(path)}
    (sidecar,) = (path.relative_to(place) for path in place.glob("s/made/hid2_*.json"))
    is_root = os.geteuid() == 0  # to whom everything is permitted
    prefix = ("setpriv", "--bounding-set=-dac_override,-dac_read_search", "--") if is_root else ()
    hid2, poor = Served(prefix=prefix), []
    for command, *wanted in MISTAKES:
        result = hid2(*command.replace("SIDECAR", str(sidecar)).split(), cwd=place)
        lines = [line for line in result.stderr.splitlines() if not re.search(r" so far$|: \d+ of \d+", line)]
        missing = [words for words in (*wanted, WAY_OUT) if not re.search(words, lines[-1] if lines else "")]
        if result.returncode == 0 or len(lines) != 1 or not lines[0].startswith("hid2: error: ") or missing:
            poor.append(f"hid2 {command} (exit {result.returncode}, lacks {missing}):\n  {result.stderr[:600]}")
    hid2.close()
    assert poor == [], "\n".join(poor)
    assert {path for path in place.rglob("*") if "closed/" not in str(path)} == before
