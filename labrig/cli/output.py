"""How results and failures are printed: one JSON document or a text for people, and errors with their hints."""

import io
import json
import re
import shutil
import sys
import textwrap
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from typing import Annotated, Any

import typer

from labrig.errors import FileFormatError, LabrigError, fault_of

AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of text.")]


# What moves the cursor, colours, renames the window or turns the direction of writing, and half characters of names
# that are no UTF-8. A tab and the end of a line stay.
_CONTROLS = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)


def plain(text: str) -> str:
    r"""Return a text as a terminal may have it: control characters are written out, as `\x1b`.

    Titles, notes, tags and the names of folders come from others, and would otherwise speak to the terminal.
    """
    if text.isprintable():
        return text
    return _CONTROLS.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def print_line(text: str) -> None:
    """Print a line of an answer on standard output."""
    typer.echo(plain(text))


def print_json(document: object) -> None:
    """Print one JSON document; what is unknown or infinite has been made null before."""
    text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False)
    typer.echo(_CONTROLS.sub(lambda found: f"\\u{ord(found[0]):04x}", text))


_UNKNOWN = "-"
_INDENT = "  "


class Talk(io.TextIOBase):
    """Standard error as far as it still has a reader.

    Progress and remarks must not end a run with a needle in tissue because a log, a pipe or a terminal has gone. It is
    standard error as it stands now: a bar puts itself in its place, and what the bar writes must not come back to it.
    """

    def __init__(self) -> None:
        super().__init__()
        self._stream = sys.stderr

    def write(self, text: str) -> int:
        """Write what can be written."""
        with suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush what can be flushed."""
        with suppress(OSError):
            self._stream.flush()

    def isatty(self) -> bool:
        """Return whether a person looks at it."""
        return self._stream.isatty()

    def fileno(self) -> int:
        """Return the descriptor, by which a terminal's width is asked."""
        return self._stream.fileno()


def say(text: str) -> None:
    """Say something to the person at the terminal, on standard error."""
    talk = Talk()
    talk.write(f"{plain(text)}\n")
    talk.flush()


def failure_document(error: LabrigError) -> dict[str, object]:
    """Return the JSON form of a failure: type, message and hint; of bus and drives also what fault it is."""
    document: dict[str, object] = {
        "type": type(error).__name__,
        "message": error.message,
        "hint": error.hint or None,
    }
    fault = fault_of(error)
    return document if fault is None else {**document, "fault": asdict(fault)}


def print_failure(error: LabrigError, as_json: bool) -> None:
    """Print a failure: for people on standard error, and under --json as the document on standard output too."""
    if as_json:
        # Where standard output is what failed, standard error says it alone.
        with suppress(OSError):
            print_json({"error": failure_document(error)})
    for line in failure_lines(error):
        say(line)


def failure_lines(error: LabrigError) -> list[str]:
    """Return the lines that tell a person of a failure: each problem, and under it what to do."""
    if not isinstance(error, FileFormatError):
        return [f"error: {error.message}", *([f"hint: {error.hint}"] if error.hint else [])]
    lines = []
    for problem in error.problems:
        lines.append(f"error: {problem.where}: {problem.message}")
        if problem.hint:
            lines.append(f"hint: {problem.hint}")
    return lines


def tell_checks(checks: Sequence[Mapping[str, Any]], as_json: bool) -> int:
    """Print checks (`status`, `check`, `value`, `solution`, perhaps `axis`), and return 1 where one failed."""
    if as_json:
        print_json(checks)
    else:
        for one in checks:
            axis = f"{one['axis']} " if "axis" in one else ""
            tell(f"{one['status']:4}  {axis}{one['check']}: {one['value']}", 6)
            if one["solution"]:
                tell(f"      {one['solution']}", 6)
    return 1 if any(one["status"] == "FAIL" for one in checks) else 0


def tell(text: str, indent: int = 2) -> None:
    """Print a sentence; a terminal has it folded between words, with all lines but the first indented."""
    for line in text.splitlines() or [""]:
        wrapped = textwrap.wrap(
            line,
            _terminal_columns(),
            subsequent_indent=" " * indent,
            break_long_words=False,
            break_on_hyphens=False,
        )
        print_line("\n".join(wrapped))


def print_table(
    heads: Sequence[str], rows: Sequence[Sequence[object]], under: Sequence[str] | None = None
) -> None:
    """Print a table that fits the terminal; where it is too narrow, a block of `head: value` a row.

    Parameters
    ----------
    under : sequence of str or None
        A line to put below each row; an empty one is left out.
    """
    cells = [[_cell(value) for value in row] for row in rows]
    below = under or [""] * len(rows)
    widths = _widths(heads, cells)
    if _wide(widths) > _terminal_columns():
        for row, line in zip(cells, below, strict=True):
            _print_block(heads, row, line)
        return
    pads = [
        str.rjust if rows and all(isinstance(row[i], int | float | None) for row in rows) else str.ljust
        for i in range(len(heads))
    ]
    lines: list[str] = []
    for cells_of_row, line in zip((heads, *cells), ("", *below), strict=True):
        padded = [pad(cell, width) for pad, cell, width in zip(pads, cells_of_row, widths, strict=True)]
        lines += ["  ".join(padded).rstrip(), *_under(line)]
    print_line("\n".join(lines))  # at once: thousands of runs are listed


def fits(heads: Sequence[str], rows: Sequence[Sequence[object]]) -> bool:
    """Return whether a table is no wider than the terminal; what is no terminal takes every table."""
    if not sys.stdout.isatty():
        return True
    cells = [[_cell(value) for value in row] for row in rows]
    return _wide(_widths(heads, cells)) <= _terminal_columns()


def _widths(heads: Sequence[str], cells: Sequence[Sequence[str]]) -> list[int]:
    return [max(map(len, column)) for column in zip(heads, *cells, strict=True)]


def _wide(widths: Sequence[int]) -> int:
    return sum(widths) + 2 * (len(widths) - 1)


def _print_block(heads: Sequence[str], row: Sequence[str], under: str) -> None:
    """Print the first cell, and the others with their heads on as few lines as the terminal allows."""
    print_line(f"{heads[0]}: {row[0]}" if heads[0] else row[0])
    others = [f"{head}: {cell}" for head, cell in zip(heads[1:], row[1:], strict=True) if cell != _UNKNOWN]
    width = _terminal_columns() - len(_INDENT)
    line = ""
    for one in others:
        joined = f"{line}  {one}" if line else one
        if line and len(joined) > width:
            print_line(_INDENT + line)
            joined = one
        line = joined
    if line:
        print_line(_INDENT + line)
    for line in _under(under):
        print_line(line)


def _under(line: str) -> list[str]:
    """Return a remark on a row as lines to put below it."""
    if not line:
        return []
    return [_INDENT + part for part in textwrap.wrap(line, max(_terminal_columns() - len(_INDENT), 20))]


def _terminal_columns() -> int:
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else 1_000_000


def _cell(value: object) -> str:
    if value is None:
        return _UNKNOWN
    return (
        f"{value:.3f}"
        if isinstance(value, float)
        else plain(str(value)).replace("\n", " ").replace("\t", " ")
    )


def plural(count: int, noun: str) -> str:
    """Return the count with its noun, in the plural where it needs one."""
    return f"{count} {noun}" + ("" if count == 1 else "s")
