"""What a person sees of a run: progress on stderr, tables on stdout; rich on a terminal, plain lines otherwise."""

import sys
import time
from collections.abc import Sequence
from types import TracebackType
from typing import Self

from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar
from rich.table import Table
from rich.text import Text

from bridge.batch.batch import Progress
from bridge.batch.manifest import DONE, ManifestRow

#: Seconds between two plain progress lines.
_PLAIN_EVERY_S = 10.0
#: A batch with more runs than this is summed up instead of listed.
_LISTED_RUNS = 24
_PLAIN_WIDTH = 200
#: Reasons shown in a row of the table; manifest.csv has them all.
_REASONS = 3


def say(message: str) -> None:
    """A message for the person, on stderr."""
    print(message, file=sys.stderr, flush=True)


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table on stdout; columns of numbers are aligned right, the last column wraps."""
    terminal = sys.stdout.isatty()
    console = Console(width=None if terminal else _PLAIN_WIDTH, highlight=False, soft_wrap=False)
    table = Table(title=title if terminal else None, title_justify="left", box=box.SIMPLE_HEAD if terminal else None)
    if not terminal:
        table.pad_edge = False
        console.print(title)
    for index, column in enumerate(columns):
        numeric = bool(rows) and all(isinstance(row[index], int | float) for row in rows)
        last = index == len(columns) - 1
        table.add_column(column, justify="right" if numeric else "left", no_wrap=not last, overflow="fold")
    for row in rows:
        table.add_row(*(Text(f"{cell:g}" if isinstance(cell, float) else str(cell)) for cell in row))
    console.print(table)


class Counter:
    """Progress of work that is counted: a bar on a terminal, a line now and then elsewhere, nothing when quiet."""

    def __init__(self, what: str, *, quiet: bool) -> None:
        self._what, self._quiet = what, quiet
        self._bar: Bar | None = None
        self._task: TaskID | None = None
        self._began = self._said = time.monotonic()

    def __enter__(self) -> Self:
        if not self._quiet and sys.stderr.isatty():
            self._bar = Bar(
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.fields[rate]}"),
                TimeRemainingColumn(elapsed_when_finished=True),
                console=Console(stderr=True),
            )
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar:
            self._bar.stop()

    def show(self, done: int, total: int, rate: float | None = None, details: str = "") -> None:
        """Take note of what is done so far; rate: items a second, by the count if not given."""
        now = time.monotonic()
        rate = done / max(now - self._began, 1e-9) if rate is None else rate
        if self._bar:
            if self._task is None:
                self._task = self._bar.add_task(self._what, total=total, rate="")
            self._bar.update(self._task, completed=done, rate=f"{rate:.1f}/s")
        elif not self._quiet and now - self._said > _PLAIN_EVERY_S:
            self._said = now
            left = f", {duration((total - done) / rate)} left" if rate > 0 else ""
            say(f"{self._what}: {done} of {total}{details}, {rate:.1f}/s{left}")

    def message(self, text: str) -> None:
        """A message beside the progress."""
        if self._bar:
            self._bar.console.print(Text(text))
        else:
            say(text)


class BatchDisplay(Counter):
    """Progress of a batch, with a message for every scene that could not be done (and when verbose, every other)."""

    def __init__(self, *, quiet: bool, verbose: bool) -> None:
        super().__init__("generating", quiet=quiet)
        self._verbose = verbose

    def note(self, row: ManifestRow, progress: Progress) -> None:
        """Take note of one more run."""
        if row.status != DONE:
            self.message(f"{row.scenario} variant {row.variant}: {row.reason}")
        elif self._verbose:
            placed = f"{row.placed} of {row.requested} placed, {row.seconds:.1f} s"
            self.message(f"{row.scenario} variant {row.variant}: {placed}")
        details = f" ({progress.skipped} complete before, {progress.quarantined} quarantined)"
        self.show(progress.finished, progress.total, progress.rate, details)


def duration(seconds: float) -> str:
    """Hours, minutes and seconds, as much as is needed."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"


def print_batch(rows: Sequence[ManifestRow]) -> None:
    """Print what happened, run by run when there are few, and the sums."""
    bad = [row for row in rows if row.status != DONE]
    if len(rows) <= _LISTED_RUNS:
        listed = ("scene", "variant", "placed", "left", "right", "changes", "overtakes", "manoeuvres", "s", "remarks")
        print_table("What happened", listed, [_line(row) for row in rows])
    elif bad:
        summed = ("scene", "variant", "failure", "reason")
        print_table(
            f"Quarantined: {len(bad)}, of which the first {min(len(bad), _LISTED_RUNS)}",
            summed,
            [(row.scenario, row.variant, row.failure, row.reason) for row in bad[:_LISTED_RUNS]],
        )
    done = [row for row in rows if row.status == DONE]
    asked = (
        "as many as possible"
        if any(row.requested == "max" for row in done)
        else sum(int(row.requested) for row in done)
    )
    print(
        f"{len(done)} of {len(rows)} scenes done; vehicles placed: {sum(row.placed for row in done)} of {asked}; "
        f"manoeuvres done: {sum(row.maneuvers_done for row in done)} of {sum(row.maneuvers_requested for row in done)}"
    )


def _line(row: ManifestRow) -> tuple[object, ...]:
    if row.status != DONE:
        return (row.scenario, row.variant, "-", "-", "-", "-", "-", "-", row.seconds, f"{row.failure}: {row.reason}")
    remarks = "; ".join(
        f"{what}: {', '.join(reasons.split('; ')[:_REASONS])}"
        for what, reasons, told in (
            ("not done", row.not_done, True),
            ("candidates rejected", row.rejected, row.requested == "max" or row.placed < int(row.requested)),
        )
        if reasons and told
    )
    return (
        row.scenario,
        row.variant,
        f"{row.placed} of {row.requested}",
        row.left_turn,
        row.right_turn,
        row.lane_change,
        row.overtake,
        f"{row.maneuvers_done} of {row.maneuvers_requested}",
        round(row.seconds, 2),
        remarks or "-",
    )
