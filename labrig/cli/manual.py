"""`labrig manual`: opens the manual, which a wheel holds as a site, or names the source of a page."""

import os
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated

from typer import Argument

from labrig.cli.output import print_json, print_line, print_table
from labrig.errors import InputError

SOURCE = Path(__file__).parents[1] / "manual"
SITE = SOURCE / "site"
"""The pages as HTML; a checkout has none."""


def manual(
    topic: Annotated[
        list[str] | None, Argument(metavar="[TOPIC]", help="Name of a page, or words of its title or text.")
    ] = None,
) -> None:
    """Open the page in a browser if there is a display, and print where it is; without TOPIC, list the pages."""
    pages = find_pages()
    if not topic:
        titles = {name: read_title(page) for name, page in pages.items()}
        print_json(titles)
        print_table(("topic", "title"), list(titles.items()))
        return
    name = _choose(pages, " ".join(topic).lower().rpartition("/")[2].removesuffix(".md"))
    built = SITE / pages[name].relative_to(SOURCE).with_suffix(".html")
    page = built if built.exists() else pages[name]
    print_json({"page": str(page)})
    print_line(f"page: {page}; read it in {'a browser' if page == built else 'an editor'}")
    from labrig.report.viewer import has_display

    if page == built and has_display(os.environ):
        import webbrowser

        webbrowser.open(page.as_uri())


def find_pages() -> dict[str, Path]:
    """Return the Markdown of each page by its name."""
    pages = [
        page for page in SOURCE.rglob("*.md") if not {"example", "site"} & set(page.relative_to(SOURCE).parts)
    ]
    return {page.stem: page for page in sorted(pages)}


def read_title(page: Path) -> str:
    """Return the heading of a page."""
    return page.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")


def _choose(pages: dict[str, Path], asked: str) -> str:
    """Return the page of this name, else the one with all these words in its title, or else its text.

    Raises
    ------
    InputError
        For none, or for several, the one that has the words most often first.
    """
    titles = {name: f"{name} {read_title(page)}".lower() for name, page in pages.items()}
    texts = {name: page.read_text(encoding="utf-8").lower() for name, page in pages.items()}
    held = (
        [name for name in pages if all(word in text[name] for word in asked.split())]
        for text in (titles, texts)
    )
    found = sorted(next(filter(None, held), []), key=lambda name: -sum(map(texts[name].count, asked.split())))
    if asked in pages or len(found) == 1:
        return asked if asked in pages else found[0]
    near = found or get_close_matches(asked, pages, 3) or list(pages)
    many = f"{len(found) or 'no'} pages of the manual fit {asked!r}"
    raise InputError(many, f"name one: {', '.join(near)}")
