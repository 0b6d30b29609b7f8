"""What is said of a batch: a message for every scene that failed, and a table at the end."""

from collections.abc import Sequence
from pathlib import Path

from bridge.batch.batch import OnRow, Progress
from bridge.batch.manifest import DONE, MANIFEST_NAME, ManifestRow
from bridge.console import Activity, print_table, say
from bridge.interruption import if_interrupted
from hid2.params import Request

#: A batch with more runs than this is summed up instead of listed; those that failed were told one by one.
LISTED_RUNS = 24
#: Reasons shown in a row of the table; manifest.csv has them all.
_REASONS = 3


def notes_of(activity: Activity, out: Path, *, go_on: str) -> OnRow:
    """Tells an activity what becomes of a batch's runs; when it is verbose, of those that succeed too."""

    def note(row: ManifestRow, progress: Progress) -> None:
        if_interrupted(f"finished scenes are in {out / MANIFEST_NAME}; {go_on}")
        if row.status != DONE:
            say(
                f"warning: {row.scenario} variant {row.variant}: {row.failure}: {row.reason}\n"
                f"  to see it again: hid2 generate --repro {out / row.bundle}"
            )
        elif activity.verbose:
            placed = f"{row.placed} of {row.asked} placed, {row.seconds:.1f} s"
            say(f"{row.scenario} variant {row.variant}: {placed}")
        details = f" ({progress.skipped} complete before, {progress.quarantined} quarantined)"
        activity.show(progress.finished - progress.skipped, progress.total - progress.skipped, details)

    return note


def print_batch(rows: Sequence[ManifestRow], request: Request) -> None:
    """Print what happened, run by run when there are few, and the sums."""
    if len(rows) <= LISTED_RUNS:
        with_events = any(row.events_requested for row in rows)
        head = ("scene", "variant", "placed", "left", "right", "changes", "overtakes", "manoeuvres")
        listed = (*head, *(("events",) if with_events else ()), "s", "remarks")
        print_table("Generated scenes", listed, [_line(row, with_events=with_events) for row in rows])
    done = [row for row in rows if row.status == DONE]
    most = any(row.asked == "max" for row in done)
    asked = "" if most else f" of {sum(int(row.asked) for row in done)}"
    events = sum(row.events_requested for row in done)
    target = f"{request.near} at the last observed step" if request.is_near_agents else "traffic"
    print(
        f"{len(done)} of {len(rows)} scenes done; vehicles placed: {sum(row.placed for row in done)}{asked}, "
        f"{sum(row.near for row in done)} of them within {request.within_m:g} m of {target}; "
        f"manoeuvres done: {sum(row.maneuvers_done for row in done)} of {sum(row.maneuvers_requested for row in done)}"
    )
    if events:
        print(f"events done: {sum(row.events_done for row in done)} of {events}")


def _line(row: ManifestRow, *, with_events: bool) -> tuple[object, ...]:
    if row.status != DONE:
        blank = ("-",) * (7 if with_events else 6)
        return (row.scenario, row.variant, *blank, row.seconds, f"{row.failure}: {row.reason}")
    said = {"events": row.events, "not done": row.not_done}
    if row.asked == "max" or row.placed < int(row.asked):
        said["candidates rejected"] = row.rejected
    remarks = "; ".join(f"{what}: {_first(reasons)}" for what, reasons in said.items() if reasons)
    return (
        row.scenario,
        row.variant,
        f"{row.placed} of {row.asked}",
        row.left_turn,
        row.right_turn,
        row.lane_change,
        row.overtake,
        f"{row.maneuvers_done} of {row.maneuvers_requested}",
        *((f"{row.events_done} of {row.events_requested}",) if with_events else ()),
        round(row.seconds, 2),
        remarks or "-",
    )


def _first(reasons: str) -> str:
    """The most frequent reasons, and how many kinds more there are."""
    each = reasons.split("; ")
    more = f", {len(each) - _REASONS} more in manifest.csv" if len(each) > _REASONS else ""
    return ", ".join(each[:_REASONS]) + more
