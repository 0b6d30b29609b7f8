"""Pages of the templates beside: what they are filled with, and how figures, metrics and reasons look in them."""

import functools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import jinja2
from markupsafe import Markup, escape

from hid2.reasons import Reason


class Section(NamedTuple):
    """One entry of a page's contents: its anchor, its heading and what is below, as HTML."""

    key: str
    title: str
    body: Markup


@functools.cache
def _templates() -> jinja2.Environment:
    loader = jinja2.FileSystemLoader(Path(__file__).parent / "templates")
    escaped = jinja2.select_autoescape(("html.j2",))  # all but Markdown
    made = jinja2.Environment(
        loader=loader, undefined=jinja2.StrictUndefined, extensions=["jinja2.ext.do"],
        autoescape=escaped,  # noqa: S701
    )  # fmt: skip
    made.filters |= {"number": number, "interval": with_interval, "linked": linked, "reason": reason}
    return made


def text(file: str, **values: object) -> str:
    """A page of text, such as Markdown, that a template makes of values."""
    return _templates().get_template(file).render(**values)


def macro(file: str, name: str, *arguments: object) -> Markup:
    """What a macro of a template makes of its arguments."""
    return Markup(getattr(_templates().get_template(file).module, name)(*arguments))  # noqa: S704  # of our templates


def page(title: str, parts: Iterable[Markup], sections: Sequence[Section] = ()) -> str:
    """A whole HTML page without outside references: parts, then sections."""
    return text("page.html.j2", title=title, parts=parts, sections=sections) + "\n"


def number(value: float | None, digits: int = 3) -> Markup:
    """A figure for a table; a dash where there is none. What is more than 0 does not look like 0."""
    if value is None:
        return Markup("–")
    least = 10.0**-digits
    return escape(f"< {least:.{digits}f}" if 0 < value < least / 2 else f"{value:.{digits}f}")


def with_interval(entry: Mapping[str, float | None], digits: int = 3) -> Markup:
    """A value with its 95 % interval in small print."""
    text = number(entry["value"], digits)
    if entry["low"] is None or entry["high"] is None:
        return text
    low, high = number(entry["low"], digits), number(entry["high"], digits)
    return Markup("{}<br><small>{} to {}</small>").format(text, low, high)


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


def linked(label: str) -> Markup:
    """The name of a metric as HTML, its first known word linked to the definition."""
    text = escape(label)
    word = next((word for word in _LINKED if word in text), None)
    return text if word is None else text.replace(word, _link(f"word-{_LINKED[word]}", word), 1)


def reason(text: str) -> Markup:
    """A reason of a sidecar in words, as HTML that leads to its sentence."""
    words = text.replace("_", " ")
    known = next((one for one in Reason if one.value in text.split(": ")), None)
    return escape(words) if known is None else _link(f"reason-{known}", words)


def _link(anchor: str, words: str) -> Markup:
    return Markup('<a href="#{}">{}</a>').format(anchor, words)
