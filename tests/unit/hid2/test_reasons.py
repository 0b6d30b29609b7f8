import ast
from pathlib import Path

import hid2
from hid2.judge.findings import MOTION_LIMITS, Quantity
from hid2.reasons import Reason


def test_every_reason_has_a_name_and_a_sentence_of_its_own() -> None:
    for reason in Reason:
        assert reason.text[0].isupper(), reason
        assert reason.text.endswith("."), reason
        assert reason.value == str(reason) == reason.value.lower()
    assert len({reason.text for reason in Reason}) == len({reason.value for reason in Reason}) == len(list(Reason))


def test_no_reason_is_a_string_literal() -> None:
    """Whoever searches for a reason finds its member. Measures and metrics have names of their own, such as "pet"."""
    root, values = Path(hid2.__file__).parents[1], {reason.value for reason in Reason} - {"pet"}
    rooms = "hid2/policy", "hid2/conflicts", "hid2/insertion", "hid2/motion", "bridge/sumo", "bridge/generation"
    found = [
        f"{path}:{node.lineno}: {node.value}"
        for room in rooms
        for path in (root / room).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Constant) and node.value in values
    ]
    assert not found


def test_every_limit_of_motion_has_a_reason() -> None:
    assert [limit.reason for limit in MOTION_LIMITS] == [Reason(f"limit_{limit.value}") for limit in MOTION_LIMITS]


def test_quantities_without_a_reason_drop_no_vehicle() -> None:
    """Boxes that meet are told apart by their agents; claims and noise are judged when all is exported."""
    names = {one.value for one in Quantity if one.reason is None}
    assert names == {one for one in names if one.startswith("claim")} | {"overlap", "noise"}
