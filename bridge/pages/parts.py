"""What pages are made of: HTML without outside references, its tables, figures and numbers."""

import functools
import html
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import jinja2
from markupsafe import Markup
from matplotlib.figure import Figure

from bridge.pictures import figures


class Section(NamedTuple):
    """One entry of a page's contents: its anchor, its heading and what is below, as HTML."""

    key: str
    title: str
    body: str


@functools.cache
def _templates() -> jinja2.Environment:
    loader = jinja2.FileSystemLoader(Path(__file__).parent / "templates")
    escaped = jinja2.select_autoescape(("html.j2",))  # all but Markdown
    return jinja2.Environment(loader=loader, autoescape=escaped, undefined=jinja2.StrictUndefined)  # noqa: S701


def text(file: str, **values: object) -> str:
    """A page of text, such as Markdown, that a template makes of values."""
    return _templates().get_template(file).render(**values)


def macro(file: str, name: str, *arguments: object) -> Markup:
    """What a macro of a template makes of its arguments."""
    return Markup(getattr(_templates().get_template(file).module, name)(*arguments))  # noqa: S704  # of our templates


def page(title: str, parts: Iterable[str], sections: Sequence[Section] = ()) -> str:
    """A whole HTML page without outside references; parts are HTML, above the sections."""
    template = _templates().get_template("page.html.j2")
    marked = [section._replace(body=Markup(section.body)) for section in sections]  # noqa: S704
    return template.render(title=title, parts=[Markup(part) for part in parts], sections=marked) + "\n"  # noqa: S704


def table(head: Sequence[str], rows: Iterable[Sequence[str]], *, numbers: int | None = None) -> Markup:
    """An HTML table: the first column is text, the `numbers` next ones (None: all) are numbers. Cells are HTML."""
    cells = [[Markup(cell) for cell in row] for row in rows]  # noqa: S704
    last = len(head) if numbers is None else numbers
    return macro("parts.html.j2", "table", [Markup(cell) for cell in head], cells, last)  # noqa: S704


def picture(figure: Figure, caption: str, see: str = "") -> Markup:
    """A figure with a caption, inside the page. see: a sentence that says what there is to see in it."""
    marked = Markup(caption), Markup(see)  # noqa: S704
    return macro("parts.html.j2", "figure", Markup(figures.data_uri(figure)), *marked)  # noqa: S704


def number(value: float | None, digits: int = 3) -> str:
    """A figure for a table; a dash where there is none. What is more than 0 does not look like 0."""
    if value is None:
        return "–"
    least = 10.0**-digits
    return f"&lt; {least:.{digits}f}" if 0 < value < least / 2 else f"{value:.{digits}f}"


def with_interval(entry: Mapping[str, float | None], digits: int = 3) -> str:
    """A value with its 95 % interval in small print."""
    text = number(entry["value"], digits)
    if entry["low"] is None or entry["high"] is None:
        return text
    return f"{text}<br><small>{number(entry['low'], digits)} to {number(entry['high'], digits)}</small>"


#: Words in the names of metrics, and the definitions that they lead to; longer ones first.
_LINKED = {
    "footprint ORR": "footprint", "time gap": "gap", "TTC": "ttc", "PET": "pet", "SCR": "scr", "ORR": "orr",
    "IoU": "iou", "LO": "motion", "LA": "motion", "JE": "motion", "time to collision": "ttc",
    "post-encroachment time": "pet", "lane-change duration": "duration", "acceleration": "smooth", "jerk": "smooth",
    "yaw rate": "smooth", "offset": "smooth", "speed": "smooth", "touch": "contact", "contact": "contact",
    "lane change": "manoeuvre", "left turn": "manoeuvre", "right turn": "manoeuvre", "overtake": "overtake",
    "obstacle avoidance": "overtake", "pass": "overtake", "AUC": "auc", "Jensen-Shannon": "js",
    "Wasserstein": "wasserstein", "finding": "judge",
}  # fmt: skip


def linked(label: str) -> str:
    """The name of a metric as HTML, its first known word linked to the definition."""
    text = html.escape(label)
    word = next((word for word in _LINKED if word in text), None)
    return text if word is None else text.replace(word, f'<a href="#word-{_LINKED[word]}">{word}</a>', 1)
