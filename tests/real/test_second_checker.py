"""The second checker finds nothing in scenes that hid2 writes, and every fault that is planted into them."""

import json
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest
from planted_faults import GROSS, INSIDE, KINDS, PlantedFault, planted, planted_in
from second_checker import check_folder
from second_map import SecondMap

from bridge.config import config_from_dict
from bridge.generation.generate import generate
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sources import find_scenarios
from bridge.recordings.validate import Against, validate_scene
from hid2.judge.claims import FIGURES
from hid2.judge.findings import Quantity

ROOT = Path(__file__).parents[2]
Scenes = list[tuple[Path, Path]]
TWO_STRAIGHT = {"agents": 2, "straight": 1, "lane_change": 0, "overtake": 0, "left_turn": 0, "right_turn": 0}


def generated(out: Path, roots: Iterable[Path], **request: object) -> Scenes:
    """Scenes written, each with the folder of its recording."""
    config = config_from_dict({"request": request})
    folders = [folder for root in roots for folder in find_scenarios(root)]
    return [(generate(read_scenario(folder), config).write(out), folder) for folder in folders]


def wrong(fault: PlantedFault) -> str | None:
    """What the second checker makes of a planted fault, if it is not what it should be."""
    found = check_folder(fault.folder, fault.source)
    if fault.strength == INSIDE:
        return f"{fault.name}: {found}" if found else None
    told = {one.quantity for one in found if one.vehicle == fault.vehicle}
    return None if fault.quantity in told else f"{fault.name}: no {fault.quantity} in {told}"


@pytest.fixture(scope="module")
def quiet_scenes(tmp_path_factory: pytest.TempPathFactory, data_root: Path) -> Scenes:
    """The synthetic scenes with two vehicles that go straight: there is room for faults."""
    return generated(tmp_path_factory.mktemp("quiet"), [data_root], **TWO_STRAIGHT)


def test_the_second_checker_imports_nothing_of_the_product() -> None:
    """In a process of its own, with the faults that it is tested by."""
    code = "import sys, planted_faults; print({'hid2', 'bridge', 'netconvert'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, cwd=ROOT / "tests" / "support")
    assert done.stdout.decode().strip() == "set()"


#: What a fault inside its limit may break besides, as a vehicle that is moved may come nearer to its leader than one
#: follows: in a bend the judge's path reaches 5 cm to its side; the lines that are crossed are looked at by it alone.
BESIDE = {"past a standing vehicle": Quantity.TTC_LEADER, "lane change": Quantity.SOLID_LINE}


def misjudged(fault: PlantedFault) -> str | None:
    """What `hid2 validate --source` makes of a planted fault, if it is not what it should be.

    Its rule on headings and motion is of the format; faults of the heading alone break that inside their limits too.
    """
    every = validate_scene(Against(sources={fault.source.name: fault.source}), fault.folder)
    found = [one for one in every if one.rule in list(Quantity)]
    if fault.strength == INSIDE:
        beside = {Quantity.FOLLOWER_HEADWAY, BESIDE.get(fault.kind)}
        beside |= set(FIGURES.values()) if fault.kind == "cut-in" else set()  # planted without its figures
        found = [one for one in found if one.rule not in beside - {fault.quantity}]
        return f"{fault.name}: {found}" if found else None
    told = {one.rule for one in found if one.vehicle == fault.vehicle}
    told |= {one.rule for one in every if one.rule == "heading" and f"'{fault.vehicle}'" in one.message}
    return None if fault.quantity in told or (fault.strength == GROSS and told) else f"{fault.name}: {told}"


@pytest.fixture(scope="module")
def faults(quiet_scenes: Scenes, tmp_path_factory: pytest.TempPathFactory) -> list[PlantedFault]:
    return list(planted_in(quiet_scenes, tmp_path_factory.mktemp("planted")))


def test_every_planted_fault_is_found_and_passes_inside_its_limit(faults: list[PlantedFault]) -> None:
    """All kinds find room in three synthetic scenes; the one that is 20 % inside its limit passes in every quantity."""
    assert {(one.kind, one.strength) for one in faults} == {(one.name, s) for one in KINDS for s in one.strengths}
    assert [text for text in map(wrong, faults) if text] == []


def test_judge_and_second_checker_agree_on_every_planted_fault(faults: list[PlantedFault]) -> None:
    assert [text for text in map(misjudged, faults) if text] == []


def test_without_a_sidecar_the_tracks_gen_are_the_inserted_ones(quiet_scenes: Scenes, tmp_path: Path) -> None:
    kinds = tuple(one for one in KINDS if one.name == "500 m aside")
    fault = next(one for scene in quiet_scenes for one in planted(*scene, tmp_path, kinds=kinds))
    next(fault.folder.glob("hid2_*.json")).unlink()
    found = check_folder(fault.folder, fault.source)
    assert {(one.vehicle, one.quantity) for one in found} == {(fault.vehicle, "off_road")}


def test_lanes_are_beside_each_other_where_one_of_them_says_so(data_root: Path, tmp_path: Path) -> None:
    source, path = min(data_root.glob("**/log_map_archive_*.json")), tmp_path / "one_sided.json"
    raw = json.loads(source.read_text())
    one_sided = {key: lane | {"left_neighbor_id": None} for key, lane in raw["lane_segments"].items()}
    path.write_text(json.dumps(raw | {"lane_segments": one_sided}))
    stated, found = (SecondMap(one) for one in (source, path))
    assert any(map(stated.beside, stated.ids))
    assert [*map(found.beside, stated.ids)] == [*map(stated.beside, stated.ids)]


@pytest.mark.slow
def test_real_scenes_as_written_have_no_error(shared_data: Path, tmp_path: Path) -> None:
    scenes = generated(tmp_path / "out", [shared_data / "av2", shared_data / "wide"], agents=10)
    assert len(scenes) == 14
    assert [one for folder, source in scenes for one in check_folder(folder, source)] == []


@pytest.mark.slow
def test_faults_planted_into_real_scenes_are_found(shared_data: Path, tmp_path: Path) -> None:
    """Real scenes have room for some kinds each; over all of them for ten at least."""
    kinds, bad = set[str](), list[str]()
    for scene in generated(tmp_path / "out", [shared_data / "av2"], **TWO_STRAIGHT):
        if check_folder(*scene):  # what is wrong before a fault is planted is for the test above
            continue
        for fault in planted(*scene, tmp_path / "planted", tries=10):
            kinds.add(fault.kind)
            bad += [text for text in (wrong(fault), misjudged(fault)) if text]
    assert bad == []
    assert len(kinds) >= 10
