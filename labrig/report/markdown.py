"""Markdown (CommonMark 0.31 with tables) as HTML: raw HTML in it stays text, and headings can be linked to."""

import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

from markdown_it import MarkdownIt
from markdown_it.token import Token
from markupsafe import Markup

Change: TypeAlias = Callable[[str], str]
"""Returns the address that takes the place of an address in the text."""


_ADDRESSES = {"link_open": "href", "image": "src"}
"""The attribute with the address of each kind of token that has one."""


@dataclass(frozen=True)
class Heading:
    """A heading of a page.

    Parameters
    ----------
    level : int
        1 for the title.
    text : str
        Without markup.
    anchor : str
        What a link to it has behind the `#`.
    """

    level: int
    text: str
    anchor: str


@dataclass(frozen=True)
class Fence:
    """A block of code: the words behind its opening fence, its text, and its line in the page, counted from 1."""

    info: str
    text: str
    line: int


def parse(text: str) -> list[Token]:
    """Return the tokens of a text; raw HTML is text."""
    return _make_parser().parse(text)


def _make_parser() -> MarkdownIt:
    return MarkdownIt("commonmark", {"html": False}).enable("table")


def find_headings(tokens: Sequence[Token]) -> list[Heading]:
    """Return the headings in their order, each with an anchor of its own."""
    anchors: Counter[str] = Counter()
    found = []
    for token, inside in pairwise(tokens):
        if token.type == "heading_open":
            text = _read_text(inside)
            anchor = make_anchor(text)
            anchors[anchor] += 1
            again = anchors[anchor] - 1
            found.append(Heading(int(token.tag[1:]), text, f"{anchor}-{again}" if again else anchor))
    return found


def make_anchor(heading: str) -> str:
    """Return the anchor of a heading, as GitHub and MyST make it."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def find_links(tokens: Sequence[Token]) -> Iterator[str]:
    """Yield the address of each link and picture."""
    for token in tokens:
        for child in token.children or ():
            if child.type in _ADDRESSES:
                yield str(child.attrs[_ADDRESSES[child.type]])


def find_fences(tokens: Sequence[Token]) -> list[Fence]:
    """Return the blocks of code, also those inside lists."""
    return [
        Fence(token.info.strip(), token.content, token.map[0] + 1)
        for token in tokens
        if token.type == "fence" and token.map is not None
    ]


def find_prose(tokens: Sequence[Token]) -> Iterator[str]:
    """Yield the text of each paragraph and list entry; no heading, table or block of code. Code in a line is a word."""
    for token, inside in pairwise(tokens):
        if token.type == "paragraph_open":
            yield _read_text(inside)


def _read_text(inline: Token) -> str:
    words = {"softbreak": " ", "hardbreak": " "}
    return "".join(
        words.get(child.type, child.content if child.type in {"text", "code_inline", "text_special"} else "")
        for child in inline.children or ()
    )


def make_html(tokens: Sequence[Token], change: Change) -> Markup:
    """Return a parsed text as HTML, with an anchor at each heading.

    Parameters
    ----------
    tokens : sequence of Token
        The text, from `parse`; it stays as it is.
    change : callable
        Takes the address of each link and picture, and returns what stands in its place.
    """
    headings = iter(find_headings(tokens))
    shown = [
        token.copy(attrs={**token.attrs, "id": next(headings).anchor})
        if token.type == "heading_open"
        else _change_addresses(token, change)
        for token in tokens
    ]
    parser = _make_parser()
    return Markup(parser.renderer.render(shown, parser.options, {}))  # noqa: S704 - its renderer escapes all text


def _change_addresses(token: Token, change: Change) -> Token:
    attribute = _ADDRESSES.get(token.type)
    if attribute is not None:
        return token.copy(attrs={**token.attrs, attribute: change(str(token.attrs[attribute]))})
    if token.children:
        return token.copy(children=[_change_addresses(child, change) for child in token.children])
    return token
