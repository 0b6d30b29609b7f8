"""Recorded scenes that are not what they say they are: each fault planted into the files of a scene, one at a time."""

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

Document = dict[str, Any]


class Spoiled(NamedTuple):
    """The rows and the map of a scene; other: the map of another one."""

    rows: pd.DataFrame
    document: Document
    other: Document


def points(document: Document) -> Iterator[dict[str, float]]:
    """Every point of a map."""
    for area in document["drivable_areas"].values():
        yield from area["area_boundary"]
    for lane in document["lane_segments"].values():
        for name in ("left_lane_boundary", "right_lane_boundary", "centerline"):
            yield from lane.get(name) or []
    for crossing in document.get("pedestrian_crossings", {}).values():
        yield from crossing["edge1"] + crossing["edge2"]


def across(rows: pd.DataFrame) -> tuple[float, float]:
    """Unit vector across the direction in which most vehicles drive."""
    fast = rows[np.hypot(rows["velocity_x"], rows["velocity_y"]) > 2.0]
    course = np.arctan2(fast["velocity_y"], fast["velocity_x"])
    along = float(np.angle(np.exp(2j * course).mean())) / 2
    return -math.sin(along), math.cos(along)


def degrees(scene: Spoiled) -> None:
    """Headings in degrees."""
    scene.rows["heading"] = np.degrees(scene.rows["heading"])


def swapped(scene: Spoiled) -> None:
    """Positions with x and y exchanged."""
    x, y = scene.rows["position_x"].copy(), scene.rows["position_y"].copy()
    scene.rows["position_x"], scene.rows["position_y"] = y, x


def swapped_whole(scene: Spoiled) -> None:
    """Positions, velocities and headings with x and y exchanged: the tracks agree with each other, not with the map."""
    swapped(scene)
    x, y = scene.rows["velocity_x"].copy(), scene.rows["velocity_y"].copy()
    scene.rows["velocity_x"], scene.rows["velocity_y"] = y, x
    scene.rows["heading"] = math.pi / 2 - scene.rows["heading"]


def other_map(scene: Spoiled) -> None:
    """The map of another scene."""
    scene.document.clear()
    scene.document.update(scene.other)


def other_map_here(scene: Spoiled) -> None:
    """The map of another scene, moved to where this one's was."""
    middle = {axis: np.mean([point[axis] for point in points(scene.document)]) for axis in "xy"}
    other_map(scene)
    there = {axis: np.mean([point[axis] for point in points(scene.document)]) for axis in "xy"}
    for point in points(scene.document):
        point.update(x=point["x"] - there["x"] + middle["x"], y=point["y"] - there["y"] + middle["y"])


def shifted(by_m: float) -> Callable[[Spoiled], None]:
    """The map shifted across the lanes."""

    def change(scene: Spoiled) -> None:
        x, y = across(scene.rows)
        for point in points(scene.document):
            point.update(x=point["x"] + by_m * x, y=point["y"] + by_m * y)

    return change


def _halved(scene: Spoiled, about: tuple[float, float]) -> None:
    for axis, middle in zip("xy", about, strict=True):
        scene.rows[f"position_{axis}"] = middle + 0.5 * (scene.rows[f"position_{axis}"] - middle)


def halved(scene: Spoiled) -> None:
    """Positions scaled by .5 about the origin, velocities as they were."""
    _halved(scene, (0.0, 0.0))


def halved_about_the_centre(scene: Spoiled) -> None:
    """The same about the centre of the tracks."""
    _halved(scene, (scene.rows["position_x"].mean(), scene.rows["position_y"].mean()))


def no_velocity_x(scene: Spoiled) -> None:
    """velocity_x of 0."""
    scene.rows["velocity_x"] = 0.0


def end_before_start(scene: Spoiled) -> None:
    """Timestamps exchanged."""
    start, end = scene.rows["start_timestamp"].copy(), scene.rows["end_timestamp"].copy()
    scene.rows["start_timestamp"], scene.rows["end_timestamp"] = end, start


#: Every fault, and what is said of it.
FAULTS: dict[str, tuple[Callable[[Spoiled], None], str]] = {
    "degrees": (degrees, r"headings of \d+ of \d+ moving vehicles .* probably headings in degrees"),
    "swapped": (swapped, r"velocity_[xy] makes .* x and y exchanged"),
    "swapped whole": (swapped_whole, r"moving vehicles within the map, .* x and y exchanged"),
    "other map": (other_map, r"moving vehicles within the map, .* probably the map of another place"),
    "other map here": (other_map_here, r"moving vehicles within the map, .* probably the map of another place"),
    "3 m": (shifted(3.0), r"tracks beside the lanes: \d+% of .* only when shifted, by (2|3)\.\d m"),
    "-3 m": (shifted(-3.0), r"tracks beside the lanes: \d+% of .* only when shifted, by (2|3)\.\d m"),
    "5 m": (shifted(5.0), r"(tracks beside the lanes|on drivable ground for)"),
    "1 km": (shifted(1000.0), r"0 of \d+ moving vehicles within the map"),
    "halved": (halved, r"velocity_[xy] makes 2\.\d\d of the displacement"),
    "halved about the centre": (halved_about_the_centre, r"velocity_[xy] makes (1\.9|2\.)\d+ of the displacement"),
    "no velocity_x": (no_velocity_x, r"velocity_x makes 0\.00 of the displacement along x .* expected 0\.5 to 1\.5"),
    "end before start": (end_before_start, r"end_timestamp \d+, start_timestamp \d+, expected the end later"),
}


def plant(
    source: Path, out: Path, change: Callable[[Spoiled], None], *, other: Path | None = None, new_id: str | None = None
) -> Path:
    """A scene as `source` in the folder `out`, changed; other: the scene whose map stands for another one."""
    (table,), (map_path,) = source.glob("scenario_*.parquet"), source.glob("log_map_archive_*.json")
    other_map_path = next((other or source).glob("log_map_archive_*.json"))
    spoiled = Spoiled(pd.read_parquet(table), json.loads(map_path.read_text()), json.loads(other_map_path.read_text()))
    change(spoiled)
    new_id = new_id or source.name
    folder = out / new_id
    folder.mkdir(parents=True)
    spoiled.rows["scenario_id"] = new_id
    spoiled.rows.to_parquet(folder / f"scenario_{new_id}.parquet")
    (folder / f"log_map_archive_{new_id}.json").write_text(json.dumps(spoiled.document))
    return folder


def moved(matrix: tuple[tuple[float, float], tuple[float, float]]) -> Callable[[Spoiled], None]:
    """The whole scene, map and tracks, by an orthogonal matrix: turned, or mirrored where its determinant is -1."""
    turn = np.array(matrix)
    mirrored = bool(np.linalg.det(turn) < 0)

    def change(scene: Spoiled) -> None:
        for name in ("position", "velocity"):
            columns = [f"{name}_x", f"{name}_y"]
            scene.rows[columns] = scene.rows[columns].to_numpy() @ turn.T
        course = np.column_stack([np.cos(scene.rows["heading"]), np.sin(scene.rows["heading"])]) @ turn.T
        scene.rows["heading"] = np.arctan2(course[:, 1], course[:, 0])
        for point in points(scene.document):
            x, y = turn @ [point["x"], point["y"]]
            point.update(x=float(x), y=float(y))
        for lane in scene.document["lane_segments"].values() if mirrored else ():
            for kind in ("lane_boundary", "lane_mark_type", "neighbor_id"):
                sides = (f"left_{kind}", f"right_{kind}")
                lane[sides[0]], lane[sides[1]] = lane[sides[1]], lane[sides[0]]

    return change
