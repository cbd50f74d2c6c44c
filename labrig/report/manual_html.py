"""The manual as HTML files that need no network: style and pictures stand in each page."""

import base64
import mimetypes
import posixpath
from collections.abc import Sequence
from pathlib import Path

from markdown_it.token import Token

from labrig.durable import disk_errors, write_and_rename
from labrig.report.manual import (
    KINDS,
    ManualPage,
    find_linked_files,
    find_manual,
    find_target,
    is_elsewhere,
)
from labrig.report.markdown import find_headings, find_links, make_html, parse
from labrig.report.rendering import TEMPLATES, render


def write_html(pages: Sequence[ManualPage], folder: Path, version: str) -> None:
    """Write every page as `folder/KIND/NAME.html`, and the other files that pages link to; older ones are replaced.

    Raises
    ------
    DiskError
        When a file cannot be written.
    """
    linked: set[str] = set()
    for page in pages:
        tokens = parse(page.read())
        linked |= find_linked_files(page.place, find_links(tokens))
        _write(folder / f"{page.place}.html", render_page(page, tokens, pages, version).encode("utf-8"))
    for name in sorted(linked - {f"{page.place}.md" for page in pages}):
        if not _guess_picture(name) and (find_manual() / name).is_file():
            _write(folder / name, (find_manual() / name).read_bytes())


def _write(path: Path, content: bytes) -> None:
    with disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_and_rename(path, content, sync=False)


def render_page(page: ManualPage, tokens: Sequence[Token], pages: Sequence[ManualPage], version: str) -> str:
    """Return a page as HTML, with links to all pages; `tokens` is its text, parsed."""
    shown = {
        "title": page.title,
        "body": make_html(tokens, lambda address: _change_address(page, pages, address)),
        "headings": [heading for heading in find_headings(tokens) if heading.level == 2],
        "contents": [(kind, [other for other in pages if other.kind == kind]) for kind in ("", *KINDS)],
        "names": KINDS,
        "here": page.place,
        "root": posixpath.relpath(".", page.kind or "."),
        "version": version,
    }
    return render(TEMPLATES / "manual.html.jinja", shown)


def _change_address(page: ManualPage, pages: Sequence[ManualPage], address: str) -> str:
    """Return what an address on a page is in HTML: a page's file ends with .html, and a picture is its own content."""
    if is_elsewhere(address) or address.startswith("#"):
        return address
    target = find_target(page.place, address)
    if target.removesuffix(".md") in {other.place for other in pages}:
        path, mark, anchor = address.partition("#")
        return f"{path.removesuffix('.md')}.html{mark}{anchor}"
    kind = _guess_picture(target)
    if not kind or not (find_manual() / target).is_file():
        return address
    content = base64.b64encode((find_manual() / target).read_bytes())
    return f"data:{kind};base64,{content.decode('ascii')}"


def _guess_picture(name: str) -> str:
    """Return the media type of a picture's file by its name; empty for other files."""
    kind = mimetypes.guess_type(name)[0] or ""
    return kind if kind.startswith("image/") else ""
