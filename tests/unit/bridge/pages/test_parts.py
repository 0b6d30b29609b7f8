"""What pages are made of: numbers, tables, and what templates escape."""

from markupsafe import Markup

from bridge.pages.parts import linked, macros, number, reason, with_interval


def test_a_share_that_is_not_zero_does_not_look_like_it_and_an_interval_stands_below_its_value() -> None:
    shown = [number(value, 4) for value in (None, 0.0, 0.00004, 0.0002, 1.5)]
    assert shown == ["–", "0.0000", "&lt; 0.0001", "0.0002", "1.5000"]
    assert with_interval({"value": 0.25, "low": 0.1, "high": 0.4}, 1) == "0.2<br><small>0.1 to 0.4</small>"
    assert with_interval({"value": 0.25, "low": None, "high": None}, 2) == "0.25"


def test_first_column_of_a_table_is_text_and_every_cell_has_the_name_of_its_column() -> None:
    text = macros("parts.html.j2").table(("", Markup("<b>share</b>"), "why"), [("a", "1", "x")], 1)
    assert '<td data-label="">a</td><td class=n data-label="share">1</td><td data-label="why">x</td>' in text


def test_what_is_not_ours_is_escaped_in_pages_and_the_one_of_scores_tells_no_number_of_seconds() -> None:
    """Of Argoverse 1 3 s are forecast, of Argoverse 2 6 s."""
    text = macros("scored.html.j2", head=[], rows=[], left_out=["a <b>"]).intro()
    assert "<li>a &lt;b&gt;</li>" in text
    assert " s after" not in text
    assert linked("share <x>") == "share &lt;x&gt;"


def test_both_parts_of_a_reason_lead_to_their_sentences() -> None:
    shown = reason("event_not_foreseen:no_site")
    assert shown == '<a href="#reason-event_not_foreseen">event not foreseen</a>: <a href="#reason-no_site">no site</a>'
