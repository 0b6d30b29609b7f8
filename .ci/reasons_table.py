"""Writes hid2/REASONS.md's table from hid2/reasons.py: python .ci/reasons_table.py. A test compares the two."""

from pathlib import Path

from hid2.reasons import Reason

PAGE = Path(__file__).parents[1] / "hid2" / "REASONS.md"
HEAD = "| reason | what it says |\n|---|---|\n"


def with_table(page: str) -> str:
    """The page with its table, which ends it, made anew."""
    return page.split(HEAD)[0] + HEAD + "".join(f"| `{reason.value}` | {reason.text} |\n" for reason in Reason)


if __name__ == "__main__":
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
