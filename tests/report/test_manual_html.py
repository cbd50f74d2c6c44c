"""The manual as HTML files."""

import re
from pathlib import Path

import pytest

from labrig.errors import DiskError
from labrig.report.manual import ManualPage, read_written_pages
from labrig.report.manual_html import write_html


def _page(place: str, text: str) -> ManualPage:
    return ManualPage(place, f"Title of {place} <b>", lambda: text)


PAGES = (
    _page("index", "# First\n\n[a guide](howto/camera.md#lens)"),
    _page(
        "howto/camera",
        "# Camera\n\n## Lens\n\n[package](../example/README.md) [web](https://example.org/x.md)",
    ),
)


def test_pages_lead_to_each_other(tmp_path: Path) -> None:
    """Links between pages, those of the contents too, name files that are there; others are left as they are."""
    write_html(PAGES, tmp_path, "1.2")
    for page in PAGES:
        file = tmp_path / f"{page.place}.html"
        links = re.findall(r'href="([^"#]+)', file.read_text(encoding="utf-8"))
        assert len(links) >= 2
        assert [link for link in links if ":" not in link and not (file.parent / link).is_file()] == []
    assert 'href="howto/camera.html#lens"' in (tmp_path / "index.html").read_text(encoding="utf-8")
    assert 'href="https://example.org/x.md"' in (tmp_path / "howto/camera.html").read_text(encoding="utf-8")


def test_a_page_needs_no_network_and_keeps_text_as_text(tmp_path: Path) -> None:
    """Style and pictures stand in it, its policy allows nothing else, and a title is escaped."""
    write_html([*read_written_pages(), *PAGES], tmp_path, "1.2")
    for file in tmp_path.rglob("*.html"):
        text = file.read_text(encoding="utf-8")
        assert "default-src 'none'" in text
        assert re.findall(r'<(?:script|link|iframe)|src="(?!data:)', text) == []
        assert "&lt;b&gt;" in text
        assert "<b>Title" not in text.replace(
            f"<b>Title of {file.relative_to(tmp_path).with_suffix('')} &lt;b&gt;", ""
        )


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    """The error is that of the disk."""
    (tmp_path / "howto").write_text("", encoding="utf-8")
    with pytest.raises(DiskError, match="howto"):
        write_html(PAGES, tmp_path, "1.2")
