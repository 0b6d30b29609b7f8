"""The OpenDRIVE file as SUMO's netconvert reads it: lanes, connections, centrelines."""

import itertools
import subprocess
from collections import defaultdict
from pathlib import Path

import pytest
import shapely
from drawn_roads import links_of, off_m, segments
from lxml import etree
from saved_nets import netconvert

from bridge.exports.export import export_scene
from bridge.recordings.sources import read_recording
from netconvert.lane_graph import LaneGraph


def _line(element: etree._Element) -> shapely.LineString:
    return shapely.LineString([[float(part) for part in xy.split(",")[:2]] for xy in element.get("shape").split()])


def read_by_netconvert(file: Path, graph: LaneGraph, folder: Path) -> tuple[set[tuple[int, int]], dict[int, float]]:
    """Links that netconvert loses, and how far each lane is from its centreline, m.

    As netconvert writes plain files, before it cuts lanes where its junctions begin; it keeps one width for each edge.
    """
    command = [netconvert(), "--opendrive", str(file), "--plain-output-prefix", str(folder / "read")]
    command += ["--plain-output.lanes", "--precision", "4", "--output.original-names", "--opendrive.import-all-lanes"]
    command += ["--opendrive.internal-shapes", "--offset.disable-normalization", "--opendrive.min-width", "0"]
    command += ["--opendrive.curve-resolution", "0.25", "--geometry.min-dist", "0"]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    nodes, edges, links = (etree.parse(folder / f"read.{kind}.xml").getroot() for kind in ("nod", "edg", "con"))
    place = {node.get("id"): [float(node.get("x")), float(node.get("y"))] for node in nodes.iter("node")}
    of = {
        f"{road.get('id')}_{lane.get('id')}": segments(lane)
        for road in etree.parse(file).getroot().iter("road")
        for lane in road.iter("lane")
    }
    lines, lane_of = defaultdict(list), {}
    for edge in edges.iter("edge"):
        ends = [place[edge.get("from")], place[edge.get("to")]]
        border, aside = _line(edge) if edge.get("shape") else shapely.LineString(ends), 0.0
        for lane in reversed(edge.findall("lane")):
            (lane_id,) = of[lane.find("param[@key='origId']").get("value")]
            width = float(lane.get("width"))
            lines[lane_id].append(border.offset_curve(-(aside + width / 2), join_style="mitre"))
            aside += width
            lane_of[edge.get("id"), lane.get("index")] = lane_id
    found, joins = set(), []
    for link in links.iter("connection"):
        if link.get("to") is None:
            continue
        ends = [lane_of[link.get("from"), link.get("fromLane")], lane_of[link.get("to"), link.get("toLane")]]
        road = link.find("param[@key='origId']")
        chain = [ends[0], *(of[road.get("value")] if road is not None else []), ends[1]]
        found |= set(itertools.pairwise(chain))
        if road is None:
            joins.append(ends)
        for lane_id in chain if road is not None else ():
            lines[lane_id].append(_line(link))
    whole = {lane_id: list(parts) for lane_id, parts in lines.items()}
    for one, other in joins:
        lines[one] += whole[other]
        lines[other] += whole[one]
    lost = links_of(graph) - found
    read = LaneGraph({lane_id: graph.lanes[lane_id] for lane_id in lines if lines[lane_id]})
    return lost, off_m(read, lines)


def test_netconvert_reads_a_synthetic_map_whole(data_scenes: dict[str, Path], tmp_path: Path) -> None:
    check(data_scenes["intersection"], tmp_path)


@pytest.mark.parametrize("start", ["0a0af725", "00a0ec58"])
def test_netconvert_reads_a_real_map_whole(start: str, real_scenes: list[Path], tmp_path: Path) -> None:
    """In the first one bicycle lanes and lanes beside them lead to one lane."""
    (scene,) = (folder for folder in real_scenes if folder.name.startswith(start))
    check(scene, tmp_path)


@pytest.mark.slow
def test_netconvert_reads_fourteen_real_maps_whole(shared_data: Path, tmp_path: Path) -> None:
    scenes = [path.parent for part in ("av2", "wide") for path in shared_data.glob(f"{part}/*/*/scenario_*.parquet")]
    assert len(scenes) == 14
    print({scene.name[:8]: check(scene, tmp_path) for scene in scenes})


def check(scene: Path, folder: Path) -> tuple[int, int, float]:
    """All links, and all lanes within 0.1 m of their centrelines; how many of each, and how far lanes are off, m."""
    (file,) = export_scene(scene, "opendrive", folder)
    graph = read_recording(scene).graph
    lost, off = read_by_netconvert(file, graph, folder)
    assert not lost
    assert off.keys() == graph.lanes.keys()
    assert max(off.values()) <= 0.1
    return len(links_of(graph)), len(off), round(max(off.values()), 3)
