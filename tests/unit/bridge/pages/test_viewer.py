"""The page of `hid2 view`: what it holds against the files of the scenes, and what a browser shows and does."""

import base64
import gzip
import json
import zlib
from pathlib import Path

import numpy as np
import pytest
from browser import Page
from PIL import Image
from viewed import differences
from written import edit_rows, write_fake

from bridge.config import load_config
from bridge.generation.generate import generate
from bridge.pages.viewer import NONE, coded, facts_of, pack, scene_document, view_scenes
from bridge.pictures import figures
from bridge.recordings.scenario import read_scenario
from bridge.recordings.sources import read_recording
from hid2.measures.lane_matching import flatten_lanes
from hid2.occupancy.agent_states import agent_states
from hid2.occupancy.sigma import cell_boxes, original_occupancy
from hid2.params import Config, Request
from netconvert.cells import build_cell_grid
from netconvert.errors import ScenarioError

WIDTHS = (400, 1600)
#: How many values there are among the pixels of the first thumbnail.
INK = """(() => { const canvas = $("cards").querySelector("canvas"), context = canvas.getContext("2d");
    return new Set(context.getImageData(0, 0, canvas.width, canvas.height).data).size; })()"""


@pytest.fixture(scope="module")
def generated(tmp_path_factory: pytest.TempPathFactory, data_scenes: dict[str, Path]) -> list[Path]:
    """Two generated scenes with a table of looks each: lane changes, and a cut-in."""
    out = tmp_path_factory.mktemp("viewed")
    mix = ["request.agents=8", "request.straight=0.3", "request.lane_change=0.6", "request.trigger_max_s=3"]
    cut_in = load_config(None, ["request.agents=6"], {"event": [{"kind": "cut_in", "target": "focal"}]})
    configs = {"intersection": load_config(None, mix), "arterial": cut_in}
    made = [generate(read_scenario(data_scenes[name]), config) for name, config in configs.items()]
    return [scene.write(out, record=("gaps",)) for scene in made]


@pytest.fixture(scope="module")
def file(generated: list[Path], data_scenes: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page with both, and the recorded scene that the first was made of."""
    return view_scenes([*generated, data_scenes["intersection"]], tmp_path_factory.mktemp("page") / "scenes.html")[0]


@pytest.fixture
def opened(page: Page, file: Path, generated: list[Path]) -> Page:
    """The page at the second generated scene, which has an event, by a link to a time before its first step."""
    page.errors.clear(), page.requests.clear()
    page.size(1600, 900)
    page.open(file, f"#scene={generated[1].name}&t=-3")
    page.until(f"now.scene && now.scene.id === '{generated[1].name}' && now.frames > 0")
    return page


def pixels(picture: Path, color: str) -> int:
    """Number of pixels of a colour."""
    with Image.open(picture) as image:
        rgb = np.asarray(image.convert("RGB"), dtype=int)
    return int((np.abs(rgb - [int(color[k : k + 2], 16) for k in (1, 3, 5)]).max(axis=-1) < 8).sum())


# --- what the page holds ----------------------------------------------------------------------------------------------


def test_numbers_are_differences_of_multiples_of_a_quantum() -> None:
    """1.00, 1.02, 1.05 m in cm: 100, 102, 105; first differences 100, 2, 3, second 100, -98, 1. What is not: NONE."""
    values = [1.0, 1.02, 1.05]
    assert coded(values, quantum=0.01) == [100, 2, 3]
    assert coded(values, quantum=0.01, order=2) == [100, -98, 1]
    assert np.cumsum(coded([0.5, np.nan, np.inf, 2.0], quantum=0.5)).tolist() == [1, NONE, NONE, 4]


def test_same_scenes_give_the_same_bytes_and_refer_to_nothing_outside(file: Path, generated, data_scenes, tmp_path):
    again = view_scenes([*generated, data_scenes["intersection"]], tmp_path / "again.html")[0]
    assert again.read_bytes() == file.read_bytes()
    text = file.read_text()
    assert "src=" not in text
    assert "://" not in text.replace("http://www.w3.org/", "")


def test_recorded_scenes_and_other_formats_are_packed_whole(data_scenes: dict[str, Path]) -> None:
    for folder in data_scenes.values():
        document = scene_document(read_recording(folder))
        facts = facts_of(document)
        assert json.loads(zlib.decompress(base64.b64decode(pack(document)))) == json.loads(json.dumps(document))
        assert (facts["inserted"], facts["asked"], facts["findings"], document["said"]) == (0, None, 0, {})
        assert facts["recorded"] == len(read_recording(folder).tracks)


def test_table_of_looks_that_is_none_is_one_line_that_names_it(generated: list[Path], copy_scene) -> None:
    folder = copy_scene(folder=generated[0])
    table = next(folder.glob("gaps_*.csv.gz"))
    header = gzip.decompress(table.read_bytes()).decode().splitlines()[0]
    exported = read_scenario(folder).sidecar.agents[0].track_id
    words = ",".join(exported if name == "track_id" else "a word" for name in header.split(","))
    for content in (b"no gzip", gzip.compress(b"a,b\n1,2\n"), gzip.compress(f"{header}\n{words}\n".encode())):
        table.write_bytes(content)
        with pytest.raises(ScenarioError, match=r"gaps_.*\.csv\.gz: .*; expected the table of hid2 generate --record"):
            scene_document(read_scenario(folder))
    table.unlink()
    assert scene_document(read_scenario(folder))["looks"] == {}


# --- what a browser makes of it ---------------------------------------------------------------------------------------


def test_viewer_shows_what_parquet_sidecar_and_table_of_looks_say(opened: Page, generated: list[Path]) -> None:
    for number in (0, 1):
        opened.js(f"show({number})")
        assert list(differences(opened, generated[number])) == []
        assert opened.js("Object.keys(now.scene.looks).length") > 0
    assert opened.errors == []


def test_comparison_fails_where_the_viewer_has_something_else(opened: Page, generated: list[Path]) -> None:
    name = opened.js("Object.keys(now.scene.looks)[0]")
    opened.js(f"now.scene.byId.get('{name}').x[20] += 0.2")
    opened.js(f"now.scene.record.get('{name}').limited = {{ turn: 0.5 }}")
    opened.js(f"now.scene.looks['{name}'][0].side = 'above'")
    found = " ".join(differences(opened, generated[1]))
    for part in (f"{name}: x is off by 0.", f"{name}: limits", f"{name}: look"):
        assert part in found


def test_page_starts_paused_at_step_0_and_play_moves(opened: Page) -> None:
    where = "now.scene.tracks.map((track) => pose(track, now.time, now.scene)?.x)"
    assert (opened.js("now.time"), opened.js("now.playing"), opened.js("$('slider').value")) == (0, False, "0")
    before = opened.js(where)
    opened.press(" ")
    opened.until("now.time > 0.5")
    opened.press(" ")
    assert opened.js("now.playing") is False
    assert opened.js("Math.abs(now.time / now.scene.step_s - Number($('slider').value)) < 1e-6")
    assert opened.js(where) != before
    assert opened.errors == []
    assert len(opened.requests) == 1 or {request[:5] for request in opened.requests} <= {"file:", "about", "data:"}


def test_click_chooses_the_vehicle_under_the_pointer(opened: Page, generated: list[Path]) -> None:
    """Where it is at step 30 by the file, in pixels by the page's view; every inserted one and the focal track."""
    scenario = read_scenario(generated[1])
    opened.js("goTo(30)")
    view = opened.js("({ ...view, wide: panes[0].wide, high: panes[0].high, origin: now.scene.origin, "
                     "top: panes[0].front.getBoundingClientRect().top })")  # fmt: skip
    clicked = 0
    for track in scenario.tracks:
        rows = np.flatnonzero(track.timesteps == 30)
        if not rows.size or not (track.track_id.startswith("gen_") or track.track_id == scenario.focal_track_id):
            continue
        east, north = track.position[rows[0]] - view["origin"]
        x = view["wide"] / 2 + (east - view["x"]) * view["scale"]
        y = view["top"] + view["high"] / 2 - (north - view["y"]) * view["scale"]
        opened.click(x, y)
        assert opened.js("$('panel').querySelector('h2').textContent") == track.track_id
        assert f"agent={track.track_id}" in opened.js("location.hash")
        clicked += 1
    assert clicked > 5
    opened.click(5, view["top"] + 60)
    assert opened.js("now.agent") is None
    assert opened.errors == []


def test_link_holds_scene_agent_and_time(page: Page, file: Path, generated: list[Path]) -> None:
    page.open(file, f"#scene={generated[0].name}&t=3.20&agent=gen_1")
    page.until("now.agent === 'gen_1'")
    shown = page.js("[now.scene.id, stepOf(), $('panel').querySelector('h2').textContent]")
    assert shown == [generated[0].name, 32, "gen_1"]
    page.js("(choose('gen_2'), goTo(57))")
    link = page.js("location.hash")
    page.open(file, link)
    page.until("now.agent === 'gen_2'")
    assert page.js("stepOf()") == 57
    page.errors.clear()
    page.open(file, "#scene=elsewhere&agent=nobody&t=x")
    page.until("!$('index').hidden")
    assert page.errors == []


def test_cell_shows_the_paper_s_sigma(opened: Page, generated: list[Path]) -> None:
    """Of every cell at three steps: 1 where a recorded box is, else 2 where an inserted one is, else 0."""
    scenario = read_scenario(generated[1])
    parts = [[t for t in scenario.tracks if t.track_id.startswith("gen_") is inserted] for inserted in (False, True)]
    boxes, lanes = cell_boxes(build_cell_grid(scenario.graph)), flatten_lanes(scenario.graph)
    sizes = {"num_steps": scenario.num_steps, "step_s": scenario.step_s}
    original, inserted = (original_occupancy(boxes, agent_states(part, lanes, **sizes).traffic).sigma for part in parts)
    shown = opened.js(
        "now.scene.cells.map((_, k) => occupancyOf(now.scene, k).map(([track, a, b]) => [track.inserted, a, b]))"
    )
    for step in (0, 40, 90):
        sigma = [
            min((2 if by else 1 for by, first, after in cell if first <= step < after), default=0) for cell in shown
        ]
        assert sigma == np.where(original[step], 1, 2 * inserted[step].astype(int)).tolist()
    assert {1, 2} <= set(np.where(original, 1, 2 * inserted.astype(int))[40].tolist())


def test_events_and_findings_are_marks_on_the_slider(opened: Page, generated: list[Path]) -> None:
    sidecar = json.loads((generated[1] / f"hid2_{generated[1].name}.json").read_text())
    (event,) = sidecar["events"]
    assert event["status"] == "done", "the cut-in that the scene was made for"
    signs = opened.js(
        "[...$('marks').children].map((one) => [one.textContent, one.dataset.agent, Number(one.dataset.step)])"
    )
    assert ["★", event["track_id"], round(event["at_s"] * 10)] in signs
    document = scene_document(read_scenario(generated[1]))
    assert sum(sign == "▲" for sign, *_ in signs) == len(document["findings"])
    opened.js("[...$('marks').children].find((one) => one.textContent === '★').click()")
    assert opened.js("[now.agent, stepOf()]") == [event["track_id"], round(event["at_s"] * 10)]


def test_before_and_after_stand_side_by_side_as_do_two_outputs(opened: Page, data_scenes) -> None:
    """What was zoomed into stays when the second picture comes."""
    opened.press("+")
    near = opened.js("looksAt()")
    opened.press("b")
    opened.until("panes.length === 2")
    assert opened.js("looksAt()") == near
    assert opened.js(
        "panes.map((pane) => pane.scene.tracks.filter((track) => pane.shows(track) && track.inserted).length > 0)"
    ) == [False, True]
    assert "beside=before" in opened.js("location.hash")
    opened.js("show(0)")
    assert opened.js("view.fitted === looksAt()") is True
    opened.js(f"beside('{data_scenes['intersection'].name}')")
    opened.until("panes.length === 2 && panes[1].scene.facts.inserted === 0")
    opened.press("b")
    opened.until("panes.length === 1")
    assert opened.errors == []


def test_sidecars_that_tell_less_are_shown(page: Page, data_scenes, tmp_path: Path) -> None:
    """No limits, looks or reasons, as in older ones; inserted vehicles that drive off the road."""
    scenario = read_scenario(data_scenes["curve"])
    page.errors.clear()
    page.open(view_scenes([write_fake(scenario, tmp_path)], tmp_path / "page.html")[0])
    page.until("now.scene && now.frames > 0")
    for name in ("gen_0", "gen_1", scenario.focal_track_id, "AV"):
        page.js(f"choose('{name}')")
        page.drawn()
        assert page.js("$('panel').querySelector('h2').textContent") == name
    assert page.js("$('many').hidden") is True
    assert page.js("now.scene.findings.length") > 0
    assert page.errors == []


@pytest.mark.parametrize("width", WIDTHS)
def test_page_fits_its_width_and_shows_all_traffic(opened: Page, width: int, tmp_path: Path) -> None:
    """The window changes its size under a scene that is open, and nobody has zoomed or panned."""
    opened.size(width, 800)
    opened.until(f"window.innerWidth === {width} && panes[0].wide === panes[0].node.clientWidth")
    opened.drawn()
    assert opened.js("document.documentElement.scrollWidth") <= width
    picture = opened.picture(tmp_path / "scene.png")
    assert pixels(picture, figures.MAP_COLORS["ground"]) > 2000
    for kind in ("recorded", "av"):
        assert pixels(picture, figures.FACES[kind]) > 20, kind
    outside = """now.scene.tracks.filter((track) => Math.max(...track.x) - Math.min(...track.x) > 5).some((track) => {
        const [x, y] = panes[0].pixel(track.x[0], track.y[0]);
        return x < 0 || y < 0 || x > panes[0].wide || y > panes[0].high; })"""
    assert opened.js(outside) is False


def test_every_key_does_something_and_none_fails(opened: Page) -> None:
    for key in opened.js("Object.keys(KEYS)"):
        opened.press(key)
        if key == "?":
            assert opened.js("$('help').open") is True
            opened.js("$('help').close()")
    opened.press("Escape")
    opened.press("n")
    assert opened.js("now.agent") is not None
    opened.press("f")
    assert opened.js("$('follow').checked") is True
    opened.js("(play(false), choose('gen_0'), goTo(60))")  # the space bar has begun to play
    opened.drawn()
    at = opened.js("pose(now.scene.byId.get('gen_0'), now.time, now.scene)")
    assert opened.js("[view.x, view.y]") == pytest.approx([at["x"], at["y"]])
    assert opened.errors == []


def test_index_filters_by_what_was_asked_and_done(page: Page, file: Path) -> None:
    page.errors.clear()
    page.open(file)
    page.until("$('cards').children.length === 3")
    seen = "[...$('cards').children].map((card) => !card.hidden)"
    assert page.js(seen) == [True, True, True]
    for name, value, fits in (("event", "cut_in done", [False, True, False]), ("behaviour", "lane_change", None)):
        page.js(f"($('of-{name}').value = '{value}', filter())")
        expected = fits or page.js(f"FACTS.map((one) => '{value}' in one.behaviours)")
        assert page.js(seen) == expected
        page.js(f"($('of-{name}').value = '', filter())")
    assert "2 keep right<" in page.js("CARD({...FACTS[0], behaviours: {keep_right: 2}}, 0).text")  # of one's own
    page.until(f"{INK} > 20")  # a thumbnail is drawn when it is seen
    page.js("$('cards').children[1].click()")
    page.until("now.scene && now.scene.number === 1")
    assert page.errors == []


def test_names_of_received_files_are_text_and_nothing_else(page: Page, generated, copy_scene, tmp_path) -> None:
    """A city and a track that are HTML: shown as they are, run never."""
    folder = copy_scene(folder=generated[0])
    hostile = '</script><img src=x onerror="window.run=1">'
    edit_rows(folder, lambda rows: rows.assign(city=hostile, track_id=rows["track_id"].replace({"gen_1": hostile})))
    file = view_scenes([folder, folder], tmp_path / "hostile.html")[0]
    page.errors.clear()
    page.open(file)
    page.until("$('cards').children.length === 2")
    page.js("show(0)")
    page.js(f"choose({json.dumps(hostile)})")
    seen = page.js("[$('panel').querySelector('h2').textContent, window.run ?? null, document.images.length]")
    assert seen == [hostile, None, 0]
    assert hostile in page.js("$('title').textContent")
    assert page.errors == []


def test_index_counts_every_manoeuvre_that_was_asked_for(data_scenes: dict[str, Path]) -> None:
    """Those that no vehicle does, too: the intersection has no room for all of these."""
    request = Request(agents=6, straight=0.0, left_turn=0.0, right_turn=0.0, lane_change=0.5, overtake=0.5)
    scene = generate(read_recording(data_scenes["intersection"]), Config(request=request))
    facts = facts_of(document := scene_document(scene.recording))
    told = {"requested": {"agents": 0}, "events": [{"kind": "lead", "status": "not_feasible", "reason": None}]}
    assert [facts["asked"], facts_of(document | {"said": told})["asked"]] == [6, 1]
    assert len(scene.sidecar.unmet) > 0
    assert facts["maneuvers"] == [[one.kind, one.status] for _, one in scene.sidecar.asked]
