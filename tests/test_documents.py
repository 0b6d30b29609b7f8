"""What the documents name is there: rooms, files, functions, reasons."""

import re
import runpy
import shlex
import shutil
from pathlib import Path
from typing import get_args, get_type_hints

import pytest

from bridge.batch.scan import SceneFacts
from bridge.studies.study import read_study
from hid2.agents import DEFAULT_SIZES
from hid2.params import Event
from hid2.reasons import Reason

ROOT = Path(__file__).parents[1]
PACKAGES = ("netconvert", "hid2", "bridge")
#: `file.py`: `name`, `name`
NAMED = re.compile(r"`([\w./]+\.py)`: ((?:`\w+`(?:, )?)+)")
#: Every page but those that are made of the code or tell of the past.
PAGES = sorted(
    path.relative_to(ROOT).as_posix()
    for path in (*ROOT.glob("*.md"), *(page for top in (*PACKAGES, "data") for page in (ROOT / top).rglob("*.md")))
)
DOCUMENTS = [page for page in PAGES if page not in {"CHANGELOG.md", "bridge/COMMANDS.md"}]
WRITTEN = {"study.md", "study.toml", "map/", "map_files/"}
#: A line of a page that is a command, or goes on from the line before.
COMMAND = re.compile(r"^    (?:[.]venv/bin/)?(hid2 (?:.*\\\n)*.*)$", re.MULTILINE)


def place(document: Path, name: str) -> Path | None:
    """A file or folder that a document names: from its own folder, from the root, or, by its name alone, anywhere."""
    found = [document.parent / name, ROOT / name]
    if "/" not in name.rstrip("/"):
        found += [path for room in (*PACKAGES, "tests", "data") for path in (ROOT / room).rglob(name.rstrip("/"))]
    return next((path for path in found if path.exists()), None)


@pytest.mark.parametrize("name", DOCUMENTS)
def test_what_a_document_names_is_there(name: str) -> None:
    document = ROOT / name
    text = document.read_text(encoding="utf-8")
    files = re.findall(r"`((?:\w[\w.]*/)*\w[\w.]*\.(?:py|toml|md)|(?:\w[\w.]*/)+)`", text)
    # what hid2 writes is not there
    files = [file for file in files if not file.startswith(("DIR/", "OUT/")) and file not in WRITTEN]
    missing = [file for file in files if place(document, file) is None]
    for file, names in NAMED.findall(text):
        source = place(document, file)
        code = "" if source is None else source.read_text(encoding="utf-8")
        missing += [
            f"{file}: {one}"
            for one in re.findall(r"\w+", names)
            if not re.search(rf"^\s*(?:(?:def|class) {one}\b|{one}\b[:\w\[\], ]* =|{one}: )", code, re.MULTILINE)
        ]
    assert missing == []


@pytest.mark.parametrize("package", PACKAGES)
def test_every_room_is_in_the_readme_of_its_package(package: str) -> None:
    text = (ROOT / package / "README.md").read_text(encoding="utf-8")
    rooms = {path.parent.name + "/" for path in (ROOT / package).glob("*/__init__.py")}
    files = {path.name for path in (ROOT / package).glob("*.py")} - {"__init__.py"}
    assert {name for name in rooms | files if f"`{name}`" not in text} == set()


def test_table_of_reasons_is_made_of_the_reasons() -> None:
    page = (ROOT / "hid2" / "REASONS.md").read_text(encoding="utf-8")
    made = runpy.run_path(str(ROOT / ".ci" / "reference.py"))["with_reasons"](page)
    assert page == made, "write it anew: .venv/bin/python .ci/reference.py"
    assert f"| `{Reason.PET.value}` | {Reason.PET.text} |" in page


def rows_below(page: str, head: str) -> list[str]:
    """Rows of the table of a page that has this head."""
    return (ROOT / page).read_text(encoding="utf-8").split(head + "\n")[1].split("\n\n")[0].splitlines()[1:]


def test_table_of_sizes_is_that_of_the_code() -> None:
    rows = [f"| `{name}` | {size.length_m:g} | {size.width_m:g} |" for name, size in DEFAULT_SIZES.items()]
    assert rows_below("bridge/recordings/README.md", "| object type | length, m | width, m |") == rows


def test_columns_of_scan_are_told_on_its_page() -> None:
    said = get_type_hints(SceneFacts, include_extras=True)
    rows = [f"| `{name}` | {said[name].__metadata__[0]} |" for name in SceneFacts._fields]
    assert rows_below("bridge/generation/README.md", "| column | what it is |") == rows


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub makes them."""
    heads = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("name", PAGES)
def test_links_of_a_page_lead_somewhere(name: str) -> None:
    page = ROOT / name
    wrong = []
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if "://" in link:
            continue
        path, _, anchor = link.partition("#")
        target = page if not path else page.parent / path
        if not target.exists() or (anchor and anchor not in anchors(target)):
            wrong.append(link)
    assert wrong == []


def test_every_page_can_be_found_from_the_readme() -> None:
    """Following links from README.md, as a reader does."""
    found, waiting = set(), {"README.md"}
    while waiting:
        name = waiting.pop()
        found.add(name)
        page = ROOT / name
        for link in re.findall(r"\]\(([^)#\s]+\.md)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
            if "://" not in link:
                target = (page.parent / link).resolve().relative_to(ROOT).as_posix()
                waiting |= {target} - found
    assert set(PAGES) - found == set()


@pytest.mark.parametrize("name", PAGES)
def test_every_command_line_of_a_page_is_understood(name: str) -> None:
    """Commands, options and choices are there: each line is parsed, and not run."""
    import typer
    from typer.main import get_command

    from bridge.cli.commands import application

    group = get_command(application())
    text = (ROOT / name).read_text(encoding="utf-8").replace("`hid2 ...", "")
    for line in COMMAND.findall(text):
        words = shlex.split(line.replace("\\\n", " "), comments=True)[1:]
        words = [word.removesuffix("...") for word in words if word != "..."]
        command = group.commands[words[0]]  # type: ignore[attr-defined]
        arguments = [re.sub(r"^(EXPERIMENT)$", "density", word) for word in words[1:]]
        context = command.make_context(words[0], arguments, parent=typer.Context(group))
        assert context.args == [], line


def test_gallery_shows_every_kind_of_event_with_its_picture_and_its_command() -> None:
    """A heading, a picture that is there and a command that asks for it, for each kind that can be asked for."""
    page = (ROOT / "data" / "EVENTS.md").read_text(encoding="utf-8")
    _, *parts = re.split(r"^## ", page, flags=re.MULTILINE)
    kinds = get_args(Event.model_fields["kind"].annotation)
    assert [part.split("\n")[0] for part in parts] == list(kinds)
    for kind, part in zip(kinds, parts, strict=True):
        (picture,) = re.findall(r"!\[.*\]\((.*)\)", part)
        (command,) = COMMAND.findall(part)
        assert picture == f"events/{kind}.png"
        assert (ROOT / "data" / picture).stat().st_size < 120_000
        assert f"--event {kind} " in command
        assert (ROOT / command.split()[2]).is_dir(), "the source of a picture is in the repository"
    assert {path.stem for path in (ROOT / "data" / "events").glob("*.png")} == set(kinds)


def test_pictures_of_pages_are_small_and_shown() -> None:
    pictures = list((ROOT / "data" / "pictures").iterdir())
    assert pictures
    assert max(path.stat().st_size for path in pictures) < 150_000
    shown = "".join((ROOT / page).read_text(encoding="utf-8") for page in PAGES)
    assert [path.name for path in pictures if path.name not in shown] == []


def test_every_reason_is_given_somewhere() -> None:
    """As a member or by its value."""
    sources = [path for room in ("hid2", "bridge") for path in (ROOT / room).rglob("*.py")]
    code = "".join(path.read_text(encoding="utf-8") for path in sources if path.name != "reasons.py")
    missing = [reason.name for reason in Reason if not re.search(rf'Reason\.{reason.name}\b|"{reason.value}"', code)]
    assert missing == []


def test_the_study_on_the_page_of_studies_is_one(tmp_path: Path) -> None:
    page = (ROOT / "bridge" / "studies" / "README.md").read_text()
    (tmp_path / "study.toml").write_text(page.split("## The file of a study\n\n```toml\n")[1].split("```")[0])
    shutil.copy(ROOT / "data" / "studies" / "two_sided.py", tmp_path)
    study = read_study(tmp_path / "study.toml", scenes=[ROOT / "data" / "av2"])
    assert len(study.points) == 4


def test_every_symbol_of_the_paper_tables_is_in_the_table() -> None:
    """What the paper names and a reader looks for."""
    text = (ROOT / "hid2" / "README.md").read_text(encoding="utf-8")
    wanted = ("N_l", "type_l", "sigma", "t_trigger", "Algorithm 1", "d_obs", "d_safe^front", "d_overtake", "f_left",
              "f_right", "n_i", "case 1", "case 2", "case 3", "R_min", "a_y,max", "LO, LA, JE", "SCR", "ORR",
              "ablations")  # fmt: skip
    assert [symbol for symbol in wanted if symbol not in text] == []
