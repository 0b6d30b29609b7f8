"""`hid2 view`: script time a frame with 60 vehicles, bytes of 40 scenes, and how long a scene takes to open.

Not part of the default run: `pytest -m benchmark -s`. A scene is the synthetic intersection with its tracks three times
over, a few steps apart in place, so that at least 60 vehicles are there at every step that is measured.
"""

import statistics
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from browser import Page

from bridge.files import write_text
from bridge.pages import viewer
from bridge.recordings.scenario import read_scenario

#: Script time of a frame, ms, median; of 40 scenes MB; until a scene is drawn, s.
MOST_MS, MOST_MB, MOST_S = 8.0, 25.0, 1.0
SCENES, VEHICLES = 40, 60


def document(folder: Path) -> dict[str, Any]:
    """What a page holds of a scene with three times the tracks."""
    scenario = read_scenario(folder)
    moved = [
        replace(track, track_id=f"{track.track_id}_{k}", category=1, position=track.position + 4.0 * k)
        for k in (1, 2)
        for track in scenario.tracks
    ]
    return viewer.scene_document(replace(scenario, tracks=(*scenario.tracks, *moved)))


@pytest.mark.benchmark
def test_frames_bytes_and_opening(data_scenes: dict[str, Path], page: Page, tmp_path: Path) -> None:
    one = document(data_scenes["arterial"])
    every = [{**one, "id": f"scene-{number}"} for number in range(SCENES)]
    facts, packed = [viewer.facts_of(each) for each in every], [viewer.pack(each) for each in every]
    file = tmp_path / "scenes.html"
    write_text(file, viewer.text("viewer.html.j2", shared=viewer._shared(), facts=facts, packed=packed))
    size_mb = file.stat().st_size / 1e6
    page.size(1600, 900)
    page.open(file)
    opened = [page.js(OPENING.format(number=number)) / 1000 for number in range(0, SCENES, 8)]
    page.js("(goTo(0), $('cells').click(), choose(now.scene.focal ?? now.scene.tracks[0].id))")
    for how in ("free", "follow"):
        if how == "follow":
            page.js("$('follow').click()")
        there = page.js("now.scene.tracks.filter((track) => track.leader && track.row[20] >= 0).length")
        times = page.js(FRAMES)
        print(
            f"{how}: {there} vehicles, {len(times)} frames, script {statistics.median(times):.2f} ms (median), "
            f"{max(times):.1f} ms at most"
        )
        assert there >= VEHICLES
        assert len(times) > 30
        assert statistics.median(times) <= MOST_MS
    print(f"{SCENES} scenes {size_mb:.1f} MB; opened in {statistics.median(opened):.2f} s, {max(opened):.2f} s at most")
    assert size_mb <= MOST_MB
    assert max(opened) < MOST_S


#: Milliseconds until a scene that was not open is drawn.
OPENING = """(async () => {{ const began = performance.now(); await show({number});
    await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
    return performance.now() - began; }})()"""
#: Script times of the frames of 4 s of playing, ms.
FRAMES = """(async () => { const times = []; goTo(0), play(true);
    const end = performance.now() + 4000;
    for (let seen = now.frames; now.playing && performance.now() < end; seen = now.frames) {
        while (now.frames === seen && performance.now() < end) await new Promise((done) => requestAnimationFrame(done));
        times.push(now.ms);
    }
    play(false);
    return times; })()"""
