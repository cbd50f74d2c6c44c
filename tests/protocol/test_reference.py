"""The reference of a kind of file, generated from its model."""

from typing import Annotated

from pydantic import Field

from labrig.protocol.model import Model
from labrig.protocol.reference import write_reference
from labrig.protocol.schema import model_schema
from labrig.report.markdown import find_headings, find_links, make_html, parse


class TipLens(Model):
    """What looks at the tip."""

    focus_mm: float = Field(gt=0, le=9, description="Focal length [mm], not [0, 1] | <b>x</b>.")


class _File(Model):
    """A file."""

    name: str = Field("a|b", description="Its `name|word`.")
    lens: TipLens | None = Field(None, description="The lens.")
    lenses: list[TipLens] = Field(default_factory=list, description="More of them.")
    levels: Annotated[dict[str, TipLens], Field(description="By name.")]


def _rows(text: str) -> dict[str, list[str]]:
    rows = (line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| `"))
    return {row[0].strip("`"): row[1:] for row in rows}


def test_every_key_has_its_value_unit_default_and_meaning() -> None:
    """A unit is what stands in brackets and is no list of numbers."""
    rows = _rows(write_reference(model_schema(_File, "file"), "Files", "Hello."))
    value, unit, default, meaning = rows["focus_mm"]
    assert (value, unit, default) == ("a number above 0 and at most 9", "mm", "required")
    assert meaning == r"Focal length, not \[0, 1\] \| \<b\>x\</b\>."
    assert rows["lens"][0] == "[Tip lens](#tip-lens) or null"
    assert rows["lens"][2] == "`null`"
    assert rows["lenses"][0] == "a list, each [Tip lens](#tip-lens)"
    assert rows["levels"][0] == "by name, each [Tip lens](#tip-lens)"


def test_a_section_stands_once_with_the_keys_that_lead_to_it() -> None:
    """And the links to it lead there."""
    text = write_reference(model_schema(_File, "file"), "Files", "Hello.")
    assert "At `lens`, `lenses`, `levels`. What looks at the tip." in text
    headings = find_headings(parse(text))
    assert [heading.text for heading in headings] == ["Files", "The file", "Tip lens"]
    assert set(find_links(parse(text))) <= {f"#{heading.anchor}" for heading in headings}


def test_a_description_stays_text() -> None:
    """Markup in a description or a default shows as it was written."""
    html = make_html(parse(write_reference(model_schema(_File, "file"), "Files", "Hello.")), str)
    assert "| &lt;b&gt;x&lt;/b&gt;." in html
    assert "<code>name|word</code>" in html
    assert "a|b" in html
