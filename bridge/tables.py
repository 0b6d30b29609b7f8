"""Tables as lines of text that crop no value: the last column wraps between words, or rows are stacked."""

import textwrap
from collections.abc import Sequence

#: Between two columns, or two fields of a stacked row.
_GAP = "  "
_INDENT = "    "
#: Prose is wrapped to no less than this.
_PROSE = 16


def table_lines(columns: Sequence[str], rows: Sequence[Sequence[object]], *, width: int | None) -> list[str]:
    """Lines of a table with a head, at most `width` wide where no single word is wider; None: as wide as it needs.

    Numbers are aligned right. Text of the last column is wrapped between words. What does not fit so is stacked: for
    each row its first value, and below it every other one with its name.
    """
    # floats to twelve digits, which is more than any is rounded to; a dash for none
    texts = [[f"{cell:.12g}" if isinstance(cell, float) else str(cell) or "-" for cell in row] for row in rows]
    numeric = [
        bool(rows) and all(isinstance(row[k], int | float) and not isinstance(row[k], bool) for row in rows)
        for k in range(len(columns))
    ]
    widths = [max(map(len, column)) for column in zip(columns, *texts, strict=True)]
    before = sum(widths[:-1]) + len(_GAP) * (len(widths) - 1)
    if width is not None and before + widths[-1] > width:
        words = [columns[-1], *(word for row in texts for word in row[-1].split())]
        widths[-1] = width - before
        if widths[-1] < max(_PROSE, *map(len, words)):
            return _stacked(columns, texts, width)
    lines = []
    for row in (columns, *texts):
        *cells, last = (
            text.rjust(room) if right else text.ljust(room)
            for text, room, right in zip(row, widths, numeric, strict=True)
        )
        first, *more = _wrapped(last, widths[-1])
        lines += [_GAP.join([*cells, first]).rstrip(), *(" " * before + part for part in more)]
    lines.insert(1, "-" * (before + widths[-1]))
    return lines


def _wrapped(text: str, width: int) -> list[str]:
    if len(text) <= width:
        return [text]
    return textwrap.wrap(text, width, break_long_words=False, break_on_hyphens=False) or [""]


def _stacked(columns: Sequence[str], rows: Sequence[Sequence[str]], width: int) -> list[str]:
    """Each row as its first value and, below it, fields "name: value", as many to a line as fit."""
    fits, wrap = width - len(_INDENT), textwrap.TextWrapper(width, break_long_words=False, break_on_hyphens=False)
    wrap.initial_indent = wrap.subsequent_indent = _INDENT
    lines: list[str] = []
    for row in rows:
        fields = [f"{name}: {text}" for name, text in zip(columns[1:], row[1:], strict=True)]
        whole = _GAP.join(field.replace(" ", "\0") if len(field) <= fits else field for field in fields)
        lines += [*_wrapped(row[0], width), *(line.replace("\0", " ") for line in wrap.wrap(whole))]
    return lines
