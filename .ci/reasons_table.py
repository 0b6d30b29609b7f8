"""Writes the README's table of reasons from hid2/reasons.py: python .ci/reasons_table.py. A test compares the two."""

from pathlib import Path

from hid2.reasons import Reason

README = Path(__file__).parents[1] / "README.md"
BEGIN, END = "<!-- reasons: .ci/reasons_table.py writes this table -->\n", "<!-- end of reasons -->\n"


def with_table(readme: str) -> str:
    """A README with the table between its two markers made anew."""
    before, rest = readme.split(BEGIN)
    after = rest.split(END)[1]
    rows = "".join(f"| `{reason.value}` | {reason.text} |\n" for reason in Reason)
    return f"{before}{BEGIN}| reason | what it says |\n|---|---|\n{rows}{END}{after}"


if __name__ == "__main__":
    README.write_text(with_table(README.read_text(encoding="utf-8")), encoding="utf-8")
