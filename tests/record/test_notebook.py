"""How a run shows itself in a notebook."""

from labrig.record.notebook import make_html_table


def test_a_list_is_shown_and_what_is_empty_is_left_out() -> None:
    """A manifest of another program may hold any value: a list is shown as text, None and an empty text are not."""
    table = make_html_table("Run", [("title", ["a", "b"]), ("operator", None), ("reason", "")])
    assert "[&#x27;a&#x27;, &#x27;b&#x27;]" in table
    assert "operator" not in table
    assert "reason" not in table
