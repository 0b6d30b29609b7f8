"""Pages of the templates beside: what they are filled with, and how figures, metrics and reasons look in them."""

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup, escape

from bridge.files import write_text
from hid2.reasons import Reason


@functools.cache
def _templates() -> jinja2.Environment:
    loader = jinja2.FileSystemLoader(Path(__file__).parent / "templates")
    escaped = jinja2.select_autoescape(("html.j2",))  # all but Markdown
    how: Any = {"undefined": jinja2.StrictUndefined, "extensions": ["jinja2.ext.do"]}
    made = jinja2.Environment(loader=loader, autoescape=escaped, **how)  # noqa: S701
    made.filters |= {"number": number, "interval": with_interval, "linked": linked, "reason": reason}
    return made


def text(file: str, **values: object) -> str:
    """A page of text, such as Markdown, that a template makes of values."""
    return _templates().get_template(file).render(**values)


def macros(file: str, **values: object) -> Any:  # noqa: ANN401  # a module of macros and variables
    """The macros of a template, which see values too, and its variables."""
    return _templates().get_template(file).make_module(values)


def write_page(path: Path, file: str, **values: object) -> None:
    """Write a whole HTML page without outside references. Errors: ExportError.

    Of a template with a `title`, an `intro`, and a macro for each of the `sections` that it names; no empty ones.
    """
    of = macros(file, **values)
    bodies = [(key, heading, getattr(of, key)()) for key, heading in getattr(of, "sections", {}).items()]
    sections = [section for section in bodies if section[-1]]
    write_text(path, text("page.html.j2", title=of.title, intro=of.intro(), sections=sections) + "\n")


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
    "time gap": "gap", "TTC": "ttc", "PET": "pet", "IoU": "iou", "time to collision": "ttc",
    "post-encroachment time": "pet", "lane-change duration": "duration", "acceleration": "smooth", "jerk": "smooth",
    "yaw rate": "smooth", "offset": "smooth", "speed": "smooth", "touch": "contact", "contact": "contact",
    "lane change": "manoeuvre", "left turn": "manoeuvre", "right turn": "manoeuvre", "overtake": "overtake",
    "obstacle avoidance": "overtake", "pass": "overtake", "AUC": "auc", "Jensen-Shannon": "js",
    "Wasserstein": "wasserstein", "finding": "judge",
}  # fmt: skip


def linked(label: str) -> Markup:
    """The name of a metric as HTML, its first known word linked to its definition on report.html, and there alone."""
    text = escape(label)
    word = next((word for word in _LINKED if word in text), None)
    return text if word is None else text.replace(word, _link(f"word-{_LINKED[word]}", word), 1)


def reason(text: str) -> Markup:
    """A reason of a sidecar in words, and what stands after its colon, as HTML that leads to their sentences."""
    words = {one: one.replace("_", " ") for one in map(str.strip, text.split(":"))}
    return Markup(": ").join(_link(f"reason-{one}", words[one]) if one in [*Reason] else words[one] for one in words)


def _link(anchor: str, words: str) -> Markup:
    return Markup('<a href="#{}">{}</a>').format(anchor, words)
