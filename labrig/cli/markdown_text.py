"""Markdown for a terminal: what `print_markdown` prints."""

from collections.abc import Iterator, Sequence
from typing import Any, ClassVar

from markdown_it.token import Token
from rich.console import Console, ConsoleOptions, RenderResult
from rich.markdown import CodeBlock, Markdown, MarkdownElement, TableElement
from rich.measure import Measurement
from rich.padding import Padding
from rich.text import Text

_BETWEEN_COLUMNS = 2
_READABLE = 24


class _FittingTable(TableElement):
    """A table; where its columns would be too narrow to read, a block for each row instead."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        heads = _read_cells(self.header.row) if self.header else []
        rows = [_read_cells(row) for row in self.body.rows] if self.body else []
        columns = zip(heads, *rows, strict=True)
        widths = [max(_measure(cell, console, options) for cell in column) for column in columns]
        if sum(widths) + _BETWEEN_COLUMNS * len(widths) <= options.max_width:
            yield from super().__rich_console__(console, options)
            return
        for row in rows:
            yield from _stack(heads, row)


_SHELL = "sh"


class _CopiedCode(CodeBlock):
    """A block of code. Lines of a shell are not broken: a terminal wraps them, and a copied command stays one line."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        if self.lexer_name != _SHELL:
            yield from super().__rich_console__(console, options)
            return
        for line in str(self.text).rstrip().splitlines():
            yield Text(f" {line}", no_wrap=True, overflow="ignore")


def _read_cells(row: Any) -> list[Text]:
    return [cell.content for cell in row.cells]


def _measure(cell: Text, console: Console, options: ConsoleOptions) -> int:
    """Return the least width in which a cell can be read: that of its longest word, or a few words."""
    found = Measurement.get(console, options, cell)
    return max(found.minimum, min(found.maximum, _READABLE))


def _stack(heads: list[Text], row: list[Text]) -> RenderResult:
    """Give the first cell of a row, and below it the other cells that say something, each with its head."""
    yield Text.assemble("\n", row[0])
    for head, cell in zip(heads[1:], row[1:], strict=True):
        if cell.plain:
            yield Padding(Text.assemble(f"{head.plain}: ", cell), (0, 0, 0, 2))


class TerminalMarkdown(Markdown):
    """Markdown for a terminal of any width."""

    elements: ClassVar[dict[str, type[MarkdownElement]]] = {
        **Markdown.elements,
        "table_open": _FittingTable,
        "fence": _CopiedCode,
    }

    def __init__(self, text: str) -> None:
        super().__init__(text, code_theme="ansi_dark", hyperlinks=False)
        for token in self.parsed:
            if token.children:
                token.children = list(_drop_links_in_page(token.children))


def _drop_links_in_page(tokens: Sequence[Token]) -> Iterator[Token]:
    """Yield the parts of a line without links to a heading of the same page, which a terminal cannot follow."""
    dropped = False
    for token in tokens:
        if token.type == "link_open":
            dropped = str(token.attrs.get("href", "")).startswith("#")
        if not (dropped and token.type in {"link_open", "link_close"}):
            yield token
