"""How a run shows itself in a notebook (IPython's `_repr_html_`); text of the record is escaped."""

from collections.abc import Iterable
from html import escape


def make_html_table(caption: str, rows: Iterable[tuple[str, object]]) -> str:
    """Return a table of two columns; a row whose value is None or empty is left out."""
    cells = "".join(
        f'<tr><th style="text-align:left">{escape(name)}</th>'
        f'<td style="text-align:left">{escape(str(value))}</td></tr>'
        for name, value in rows
        if value is not None and value != ""
    )
    return f"<table><caption>{escape(caption)}</caption>{cells}</table>"
