"""The pages of the manual: Markdown in the package, and what a reference is generated from."""

import posixpath
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib import resources
from importlib.resources.abc import Traversable

from labrig.report.markdown import find_headings, parse

INDEX = "index"
KINDS = {
    "tutorials": "Tutorials",
    "howto": "How-to guides",
    "reference": "Reference",
    "explanation": "Explanation",
    "example": "Example package",
}
"""The folder of each kind of page, and what the kind is called: four kinds (https://diataxis.fr), and the example."""


@dataclass(frozen=True)
class ManualPage:
    """A page of the manual.

    Parameters
    ----------
    place : str
        Its folder and name, such as `tutorials/commissioning`; `index` for the first page.
    title : str
        The heading that it begins with; its place if it begins with none.
    read : callable
        Returns its Markdown; a reference is generated then.
    """

    place: str
    title: str
    read: Callable[[], str]

    @property
    def kind(self) -> str:
        """One of `KINDS`; empty for the first page."""
        return posixpath.dirname(self.place)

    @property
    def topic(self) -> str:
        """Its name, by which it is asked for."""
        return posixpath.basename(self.place)


def read_written_pages() -> list[ManualPage]:
    """Return the pages that people wrote, the first page first, then by kind and name."""
    root = find_manual()
    files = [(INDEX, root / f"{INDEX}.md")]
    for kind in KINDS:
        entries = (root / kind).iterdir() if (root / kind).is_dir() else ()
        names = sorted(entry.name for entry in entries if entry.name.endswith(".md"))
        files += [(f"{kind}/{name.removesuffix('.md')}", root / kind / name) for name in names]
    return [_read_page(place, file) for place, file in files if file.is_file()]


def find_manual() -> Traversable:
    """Return the folder of the manual inside the installed package."""
    return resources.files("labrig") / "manual"


def _read_page(place: str, file: Traversable) -> ManualPage:
    text = file.read_text(encoding="utf-8")
    # Only the first block: to parse all pages takes longer than to list them.
    beginning = parse(text.partition("\n\n")[0])
    title = next((heading.text for heading in find_headings(beginning)), place)
    return ManualPage(place, title, lambda: text)


def find_target(place: str, address: str) -> str:
    """Return where a relative address on a page leads, from the manual's folder; its anchor is left out."""
    path = address.partition("#")[0]
    return posixpath.normpath(posixpath.join(posixpath.dirname(place), path)) if path else f"{place}.md"


def is_elsewhere(address: str) -> bool:
    """Return whether an address names a scheme, as https: does, and so leads out of the manual."""
    return ":" in address.partition("/")[0]


def find_linked_files(place: str, links: Iterable[str]) -> set[str]:
    """Return the files that the links of a page lead to, from the manual's folder; pages and pictures among them."""
    return {find_target(place, link) for link in links if not is_elsewhere(link)}
