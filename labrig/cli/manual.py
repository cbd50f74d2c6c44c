"""`labrig manual`: the pages of the manual, in a browser or in the terminal, without a network."""

import os
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from labrig import __version__
from labrig.cli.output import AsJson, print_json, print_line, print_markdown, say
from labrig.errors import InputError
from labrig.protocol.formatting import choice_hint
from labrig.report.manual import INDEX, KINDS, ManualPage, read_written_pages


def manual(
    topic: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="TOPIC", help="Name of a page, or words of its title; all pages are listed without it."
        ),
    ] = None,
    in_terminal: Annotated[
        bool, typer.Option("--print", help="Print the page, also where a browser could show it.")
    ] = False,
    html: Annotated[
        Path | None,
        typer.Option(
            "--html", metavar="FOLDER", help="Write all pages as HTML files there.", show_default=False
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace files in the folder of --html.")] = False,
    as_json: AsJson = False,
) -> None:
    """Open a page in the browser if there is a display, else print it; nothing is fetched from a network."""
    pages = list_pages()
    if html is not None:
        _write_all(pages, html, force=force, as_json=as_json)
    elif not topic:
        _list_pages(pages, as_json)
    else:
        page = find_page(pages, " ".join(topic))
        if as_json:
            print_json(_describe_page(page) | {"text": page.read()})
        elif in_terminal or not _open_page(page, pages):
            print_markdown(page.read())


def list_pages() -> list[ManualPage]:
    """Return all pages of the manual, written and generated: the first page first, then by kind and name."""
    from labrig.cli.reference_pages import REFERENCE

    kinds = ("", *KINDS)
    return sorted((*read_written_pages(), *REFERENCE), key=lambda page: (kinds.index(page.kind), page.topic))


def find_page(pages: Sequence[ManualPage], asked: str) -> ManualPage:
    """Return the page of this name, else the one with all these words in its title.

    Raises
    ------
    InputError
        When there is none or more than one; names those that may be meant.
    """
    wanted = asked.casefold().removesuffix(".md")
    named = [page for page in pages if wanted in {page.topic, page.place}]
    words = wanted.split()
    found = named or [
        page for page in pages if all(word in f"{page.title} {page.topic}".casefold() for word in words)
    ]
    if len(found) == 1:
        return found[0]
    if found:
        raise InputError(
            f"{len(found)} pages of the manual fit {asked!r}",
            f"name one: {', '.join(page.place for page in found)}",
        )
    topics = dict.fromkeys(page.topic for page in pages)
    raise InputError(f"the manual has no page {asked!r}", choice_hint(asked, topics))


def _describe_page(page: ManualPage) -> dict[str, object]:
    return {"topic": page.topic, "kind": page.kind or None, "title": page.title}


def _list_pages(pages: Sequence[ManualPage], as_json: bool) -> None:
    if as_json:
        print_json([_describe_page(page) for page in pages])
        return
    width = max(len(page.topic) for page in pages) + 2
    for kind, name in KINDS.items():
        listed = [page for page in pages if page.kind == kind]
        if listed:
            print_line(name)
        for page in listed:
            print_line(f"  {page.topic:{width}}{page.title}", width + 2)
    print_line("labrig manual TOPIC opens a page; --print prints it here")


def _write_all(pages: Sequence[ManualPage], out: Path, *, force: bool, as_json: bool) -> None:
    from labrig.record.urls import output_folder
    from labrig.report.manual_html import write_html

    with output_folder(str(out), force=force) as folder:
        write_html(pages, folder, __version__)
    first = out / f"{INDEX}.html"
    if as_json:
        print_json({"out": str(out), "pages": [f"{page.place}.html" for page in pages]})
    else:
        print_line(str(first))


def _open_page(page: ManualPage, pages: Sequence[ManualPage]) -> bool:
    """Give a page to the browser, and return whether one was started; whether it shows the page is not known."""
    from labrig.report.viewer import has_display

    if not has_display(os.environ):
        return False
    from labrig.report.manual_html import write_html

    folder = _find_cache_folder()
    write_html(pages, folder, __version__)
    file = folder / f"{page.place}.html"
    say(f"the page is {file}; --print prints it here")
    return webbrowser.open(file.as_uri())


def _find_cache_folder() -> Path:
    """Return the folder for pages that can be made again (XDG Base Directory Specification 0.8)."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    cache = Path(base) if Path(base).is_absolute() else Path.home() / ".cache"
    return cache / "labrig" / "manual"
