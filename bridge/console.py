"""What a person sees of a run: progress and messages on stderr, tables on stdout. It imports nothing slow."""

import json
import os
import shutil
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Self

from bridge.files import one_line
from bridge.interruption import tidied

#: Seconds between two looks at what is done.
_LOOK_S = 0.2
#: Seconds to the first line off a terminal, and to each later one, so that the log of a night is a thousand lines.
FIRST_S, EVERY_S = 2.0, 30.0
#: Most characters of a message, behind the command's name.
_MOST_CHARACTERS = 1990
#: Seconds before which nothing is said of the time left.
_KNOWN_AFTER_S = 1.0
#: Control characters to the beginning of a terminal's line, and to clear it.
_CLEAR = "\r\x1b[K"
#: Text between two columns, or two fields of a stacked row.
_GAP = "  "
_INDENT = "    "
#: Least width that prose is wrapped to, characters.
_PROSE = 16


def say(message: str) -> None:
    """A message for the person, on stderr: in the place of the progress, which comes again below."""
    _write(f"hid2: {message}\n")


def _write(text: str) -> None:
    sys.stderr.write(_CLEAR + text if _is_live() else text)
    sys.stderr.flush()


def _is_live() -> bool:
    """Whether stderr is a terminal on which a line can be written anew."""
    return sys.stderr.isatty() and os.environ.get("TERM") != "dumb"


def warn(message: str) -> None:
    """What went wrong, or may have, while the command goes on: a line."""
    say(one_line(f"warning: {message}", most=_MOST_CHARACTERS))


def fail(message: str) -> None:
    """What ended the command: a line, whatever came with it from a file or the command line."""
    say(one_line(f"error: {message}", most=_MOST_CHARACTERS))


def counted(number: int, noun: str) -> str:
    """A number with its noun: "no scene", "1 scene", "3 scenes"."""
    return f"{number or 'no'} {noun}{'' if number < 2 else 's'}"


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table with a title on stdout, every value whole; a pipe or a file takes lines of any length."""
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    print(title, *table_lines(columns, rows, width=width), sep="\n")


def table_lines(columns: Sequence[str], rows: Sequence[Sequence[object]], *, width: int | None) -> list[str]:
    """Lines of a table with a head, at most `width` wide where no single word is wider; None: as wide as it needs.

    Text of the last column is wrapped between words. What does not fit so is stacked: below the first value of a row
    every other one with its name.
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


def print_json(columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table on stdout as a JSON list of one object a row."""
    print(json.dumps([dict(zip(columns, row, strict=True)) for row in rows], indent=1, default=str))


class Activity(ExitStack):
    """What is being done, from the start: one line on a terminal, a line now and then elsewhere, none when quiet.

    verbose: how much a command says beyond the usual, 0 to 2; clock: seconds, from any moment on.
    """

    def __init__(self, *, quiet: bool, verbose: int = 0, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self.quiet, self.verbose, self._clock, self._what = quiet, verbose, clock, "starting"
        self._named = clock()
        self._next_line = self._named + FIRST_S
        self._counted = ""
        self._over = threading.Event()
        self._ticker = threading.Thread(target=self._tick, daemon=True)

    def __enter__(self) -> Self:
        self.enter_context(tidied(self.end))
        if not self.quiet:
            self._ticker.start()
        return self

    def end(self) -> None:
        """Say nothing more; safe to call twice."""
        self._over.set()
        if self._ticker.is_alive():
            self._ticker.join()

    def doing(self, what: str) -> None:
        """Name the work that begins now, which nothing is counted of yet."""
        self._what, self._counted, self._named = what, "", self._clock()

    def show(self, done: int, total: int, details: str = "") -> None:
        """Take note of what is done so far."""
        elapsed_s = self._clock() - self._named
        is_known = 0 < done < total and elapsed_s > _KNOWN_AFTER_S
        left = f", {duration((total - done) * elapsed_s / done)} left" if is_known else ""
        self._counted = f": {done} of {total}{details}{left}"

    def step(self, what: str, done: int, total: int) -> None:
        """`show`, after `doing` where it is another piece of work than before."""
        if what != self._what:
            self.doing(what)
        self.show(done, total)

    def note(self, *messages: str) -> None:
        """Messages that can be missed: none when quiet."""
        for message in () if self.quiet else messages:
            say(message)

    def result(self, *lines: object) -> None:
        """Lines of the result on stdout, none when quiet; nothing is in progress any more."""
        self.end()
        for line in () if self.quiet else lines:
            print(line)

    def table(
        self, title: str, columns: Sequence[str], rows: Sequence[Sequence[object]], *, as_json: bool = False
    ) -> None:
        """A table as the result: as JSON where that is asked for, else none when quiet."""
        self.end()
        if as_json:
            print_json(columns, rows)
        elif not self.quiet:
            print_table(title, columns, rows)

    def _tick(self) -> None:
        while not self._over.wait(_LOOK_S):
            self.look()
        if _is_live():
            _write("")

    def look(self) -> None:
        """Say how far it is: on a terminal always, elsewhere where a line is due."""
        now = self._clock()
        if _is_live():
            _write(f"{self._what}{self._so_far(now)}"[: shutil.get_terminal_size().columns - 1])
        elif now >= self._next_line:
            self._next_line = now + EVERY_S
            say(f"{self._what}{self._so_far(now)}")

    def _so_far(self, now: float) -> str:
        return self._counted or f", {duration(now - self._named)} so far"


def duration(seconds: float) -> str:
    """Hours, minutes and seconds, as much as is needed."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"
