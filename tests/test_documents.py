"""What the documents name is there: rooms, files, functions, reasons."""

import re
import runpy
from pathlib import Path

import pytest

from hid2.reasons import Reason

ROOT = Path(__file__).parents[1]
PACKAGES = ("netconvert", "hid2", "bridge")
#: `file.py`: `name`, `name`
NAMED = re.compile(r"`([\w./]+\.py)`: ((?:`\w+`(?:, )?)+)")
DOCUMENTS = ("README.md", "CONTRIBUTING.md", *(f"{package}/README.md" for package in PACKAGES))


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


def test_every_symbol_of_the_paper_tables_is_in_the_table() -> None:
    """What the paper names and a reader looks for."""
    text = (ROOT / "hid2" / "README.md").read_text(encoding="utf-8")
    wanted = ("N_l", "type_l", "sigma", "t_trigger", "Algorithm 1", "d_obs", "d_safe^front", "d_overtake", "f_left",
              "f_right", "n_i", "case 1", "case 2", "case 3", "R_min", "a_y,max", "LO, LA, JE", "SCR", "ORR",
              "ablations")  # fmt: skip
    assert [symbol for symbol in wanted if symbol not in text] == []


def test_table_of_reasons_is_made_of_the_reasons() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    with_table = runpy.run_path(str(ROOT / ".ci" / "reasons_table.py"))["with_table"]
    assert readme == with_table(readme), "write it anew: .venv/bin/python .ci/reasons_table.py"
    assert f"| `{Reason.PET.value}` | {Reason.PET.text} |" in readme


def test_every_reason_is_given_somewhere() -> None:
    """As a member or by its value; those of limits of motion are put together by `limit_reason`."""
    sources = [path for room in ("hid2", "bridge") for path in (ROOT / room).rglob("*.py")]
    code = "".join(path.read_text(encoding="utf-8") for path in sources if path.name != "reasons.py")
    missing = [
        reason.name
        for reason in Reason
        if not reason.name.startswith("LIMIT_") and not re.search(rf'Reason\.{reason.name}\b|"{reason.value}"', code)
    ]
    assert missing == []
