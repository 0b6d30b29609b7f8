"""Tables as lines of text that crop no value: columns wrap between words, or rows are stacked."""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

#: Between two columns, or two fields of a stacked row.
_GAP = "  "
_INDENT = "    "
#: Prose is wrapped to no less than this.
_PROSE = 16


@dataclass(frozen=True, slots=True)
class _Column:
    """Lines of one column. least: the longest piece that is not broken; most: the longest text."""

    head: str
    texts: tuple[str, ...]
    numeric: bool
    least: int
    most: int


def table_lines(columns: Sequence[str], rows: Sequence[Sequence[object]], *, width: int | None) -> list[str]:
    """Lines of a table with a head, at most `width` wide where no single word is wider; None: as wide as it needs.

    Numbers are aligned right. Text is wrapped between words, heads also at underscores. What does not fit so is
    stacked: for each row its first value, and below it every other one with its name.
    """
    texts = [[cell_text(cell) for cell in row] for row in rows]
    described = [
        _column(head, [row[k] for row in texts], numeric=bool(rows) and all(_is_number(row[k]) for row in rows))
        for k, head in enumerate(columns)
    ]
    room = None if width is None else width - len(_GAP) * (len(columns) - 1)
    widths = _widths(described, room)
    return _stacked(columns, texts, width or 0) if widths is None else _side_by_side(described, widths)


def cell_text(cell: object) -> str:
    """A value as text, whole: floats to twelve digits, which is more than any is rounded to; a dash for none."""
    return f"{cell:.12g}" if isinstance(cell, float) else str(cell) or "-"


def _is_number(cell: object) -> bool:
    return isinstance(cell, int | float) and not isinstance(cell, bool)


def _column(head: str, texts: Sequence[str], *, numeric: bool) -> _Column:
    words = [word for text in texts for word in ([text] if numeric else text.split())]
    longest = max(map(len, texts), default=0)
    least = max(map(len, [*_head_words(head), *words]), default=0)
    return _Column(head, tuple(texts), numeric, max(least, min(longest, _PROSE)), max(longest, len(head)))


def _head_words(head: str) -> list[str]:
    """Pieces that a head may be broken into: at spaces, and behind underscores."""
    return head.replace("_", "_ ").split()


def _widths(columns: Sequence[_Column], room: int | None) -> list[int] | None:
    """Width of each column: what it wants, or less for those that can be wrapped; None where that is not enough."""
    wanted = [column.most for column in columns]
    if room is None or sum(wanted) <= room:
        return wanted
    widths = [column.least for column in columns]
    if sum(widths) > room:
        return None
    for _ in range(room - sum(widths)):  # a character at a time to the narrowest that lacks some: short ones stay whole
        lacking = [k for k, width in enumerate(widths) if width < wanted[k]]
        widths[min(lacking, key=lambda k: widths[k])] += 1
    return widths


def _side_by_side(columns: Sequence[_Column], widths: Sequence[int]) -> list[str]:
    heads = [_head_lines(column.head, width) for column, width in zip(columns, widths, strict=True)]
    deep = max(map(len, heads), default=0)
    blocks = [[[""] * (deep - len(head)) + head for head in heads]]
    blocks += [
        [_wrapped(text, width) for text, width in zip(row, widths, strict=True)]
        for row in zip(*(column.texts for column in columns), strict=True)
    ]
    lines = [line for block in blocks for line in _block(block, columns, widths)]
    lines.insert(deep, "-" * (sum(widths) + len(_GAP) * (len(widths) - 1)))
    return lines


def _block(cells: Sequence[Sequence[str]], columns: Sequence[_Column], widths: Sequence[int]) -> list[str]:
    """The lines of one row whose cells have several."""
    lines = []
    for number in range(max(map(len, cells), default=0)):
        parts = [cell[number] if number < len(cell) else "" for cell in cells]
        aligned = [
            part.rjust(width) if column.numeric else part.ljust(width)
            for part, column, width in zip(parts, columns, widths, strict=True)
        ]
        lines.append(_GAP.join(aligned).rstrip())
    return lines


def _head_lines(head: str, width: int) -> list[str]:
    lines = [""]
    for word in _head_words(head):
        joint = "" if not lines[-1] or lines[-1].endswith("_") else " "
        if lines[-1] and len(lines[-1] + joint + word) > width:
            lines.append(word)
        else:
            lines[-1] += joint + word
    return lines


def _wrapped(text: str, width: int) -> list[str]:
    if len(text) <= width:
        return [text]
    return textwrap.wrap(text, width, break_long_words=False, break_on_hyphens=False) or [""]


def _stacked(columns: Sequence[str], rows: Sequence[Sequence[str]], width: int) -> list[str]:
    """Each row as its first value and, below it, fields "name: value", as many to a line as fit."""
    lines: list[str] = []
    for row in rows:
        lines += _wrapped(row[0], width)
        line = ""
        for name, text in zip(columns[1:], row[1:], strict=True):
            field = f"{name}: {text}"
            if line and len(_INDENT + line + _GAP + field) <= width:
                line += _GAP + field
                continue
            lines += [_INDENT + line] if line else []
            *full, line = _wrapped(field, max(width - 2 * len(_INDENT), 1)) if len(_INDENT + field) > width else [field]
            lines += [_INDENT + part if k == 0 else 2 * _INDENT + part for k, part in enumerate(full)]
            if full:  # the end of a long field stays alone
                lines.append(2 * _INDENT + line)
                line = ""
        lines += [_INDENT + line] if line else []
    return lines
