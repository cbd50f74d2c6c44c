"""Prints results and failures: a JSON document or text for people, and errors with their hints."""

import json
import math
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from types import NoneType
from typing import Annotated, Any

import typer

from labrig.errors import FileFormatError, LabrigError, fault_of

AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of text.")]


# Characters that move the cursor, change colours, rename the window or turn the direction of writing, and the halves
# of characters in names that are not UTF-8. Tabs and line ends stay.
CONTROLS = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)


def escape_controls(text: str) -> str:
    r"""Return a text with its control characters written out, as `\x1b`.

    Titles, notes, tags and names of folders come from other people and could otherwise control the terminal.
    """
    if text.isprintable():
        return text
    return CONTROLS.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def print_line(text: str) -> None:
    """Print a line of a result on standard output."""
    typer.echo(escape_controls(text))


def print_json(document: object) -> None:
    """Print one JSON document, in which unknown and infinite values are null already."""
    try:
        text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False)
    except ValueError:  # a sum or ratio of values that a record holds, each of them finite
        text = json.dumps(_make_finite(document), indent=2, ensure_ascii=False, allow_nan=False)
    typer.echo(CONTROLS.sub(lambda found: f"\\u{ord(found[0]):04x}", text))


def _make_finite(value: object) -> object:
    match value:
        case float():
            return value if math.isfinite(value) else None
        case Mapping():
            return {key: _make_finite(item) for key, item in value.items()}
        case list() | tuple():
            return [_make_finite(item) for item in value]
    return value


_UNKNOWN = "-"
_UNLIMITED = 1_000_000
_LEAST_COLUMNS = 20
_WIDEST_TEXT = 100  # longer lines of prose are hard to read
_INDENT = "  "
_NUMBER = (int, float, NoneType)


class SafeStandardError:
    """Standard error without errors if its reader has gone.

    A log, a pipe or a terminal that has gone must not end a run with a needle in tissue. The stream is fixed when this
    is made: a progress bar takes the place of `sys.stderr`, and what the bar writes must not come back to it.

    Its base is none of `io`: those flush in a finaliser, in which Python drops what the handler of a signal raises.
    """

    def __init__(self) -> None:
        self._stream = sys.stderr

    @property
    def encoding(self) -> str | None:
        """The encoding, by which it is chosen what a bar is drawn with; None if it is not known."""
        return self._stream.encoding

    def write(self, text: str) -> int:
        """Write, and ignore errors."""
        with suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush, and ignore errors."""
        with suppress(OSError):
            self._stream.flush()

    def isatty(self) -> bool:
        """Return whether it is a terminal."""
        return self._stream.isatty()

    def fileno(self) -> int:
        """Return the descriptor, from which the width of a terminal is read."""
        return self._stream.fileno()


def say(text: str) -> None:
    """Print a message for the person at the terminal on standard error."""
    stream = SafeStandardError()
    stream.write(f"{escape_controls(text)}\n")
    stream.flush()


def ring_bell() -> None:
    """Ring the bell of the terminal of standard error, if it is one."""
    stream = SafeStandardError()
    if stream.isatty():
        stream.write("\a")
        stream.flush()


def say_wrapped(text: str, indent: int = 2) -> None:
    """Print a message on standard error; on a terminal it is wrapped between words, with further lines indented."""
    say("\n".join(wrapped for line in text.split("\n") for wrapped in _wrap(line, _error_columns(), indent)))


def _error_columns() -> int:
    """Return the width of the terminal of standard error, `COLUMNS` first; without a terminal there is no limit."""
    stream = SafeStandardError()
    if not stream.isatty():
        return _UNLIMITED
    if os.environ.get("COLUMNS", "").isdecimal():
        return max(int(os.environ["COLUMNS"]), _LEAST_COLUMNS)
    try:
        return max(os.get_terminal_size(stream.fileno()).columns, _LEAST_COLUMNS)
    except OSError:
        return _UNLIMITED


def _wrap(line: str, columns: int, indent: int) -> list[str]:
    return textwrap.wrap(
        line, columns, subsequent_indent=" " * indent, break_long_words=False, break_on_hyphens=False
    ) or [""]


def failure_document(error: LabrigError) -> dict[str, object]:
    """Return a failure as JSON: type, message and hint; for bus and drives also the fault."""
    document: dict[str, object] = {
        "type": type(error).__name__,
        "message": error.message,
        "hint": error.hint or None,
    }
    fault = fault_of(error)
    return document if fault is None else {**document, "fault": asdict(fault)}


def print_failure(error: LabrigError, as_json: bool) -> None:
    """Print a failure for people on standard error, and with --json also as a document on standard output."""
    if as_json:
        # If standard output itself failed, standard error alone has the message.
        with suppress(OSError):
            print_json({"error": failure_document(error)})
    for line in failure_lines(error):
        say(line)


def failure_lines(error: LabrigError) -> list[str]:
    """Return the lines that report a failure: each problem, and under it what to do."""
    if not isinstance(error, FileFormatError):
        return [f"error: {error.message}", *([f"hint: {error.hint}"] if error.hint else [])]
    lines = []
    for problem in error.problems:
        lines.append(f"error: {problem.where}: {problem.message}")
        if problem.hint:
            lines.append(f"hint: {problem.hint}")
    return lines


def print_checks(checks: Sequence[Mapping[str, Any]], as_json: bool) -> int:
    """Print checks (`status`, `check`, `value`, `solution`, perhaps `axis`), and return 1 if a check failed."""
    if as_json:
        print_json(checks)
    else:
        for check in checks:
            axis = f"{check['axis']} " if "axis" in check else ""
            print_wrapped(f"{check['status']:4}  {axis}{check['check']}: {check['value']}", 6)
            if check["solution"]:
                print_wrapped(f"      {check['solution']}", 6)
    return 1 if any(check["status"] == "FAIL" for check in checks) else 0


def print_markdown(text: str) -> None:
    """Print Markdown as text for a terminal; a table that is too wide for it becomes a block for each row."""
    from rich.console import Console

    from labrig.cli.markdown_text import TerminalMarkdown

    # A height too, without which a terminal that knows no colours counts as 80 columns wide.
    console = Console(width=min(_terminal_columns(), _WIDEST_TEXT), height=25, highlight=False)
    with console.capture() as captured:
        console.print(TerminalMarkdown(escape_controls(text)), crop=False)
    typer.echo("\n".join(line.rstrip() for line in captured.get().splitlines()))


def print_wrapped(text: str, indent: int = 2) -> None:
    """Print a sentence; on a terminal it is wrapped between words, with all lines but the first indented."""
    for line in text.splitlines() or [""]:
        print_line("\n".join(_wrap(line, _terminal_columns(), indent)))


def print_table(
    heads: Sequence[str], rows: Sequence[Sequence[object]], under: Sequence[str] | None = None
) -> None:
    """Print a table; if the terminal is too narrow for it, print a block of `head: value` for each row.

    Parameters
    ----------
    under : sequence of str or None
        A line to put below each row; empty lines are left out.
    """
    cells = [[format_cell(value) for value in row] for row in rows]
    below = under or [""] * len(rows)
    widths = _measure_columns(heads, cells)
    if _measure_table(widths) > _terminal_columns():
        for row, line in zip(cells, below, strict=True):
            _print_block(heads, row, line)
        return
    numeric = [bool(rows) and all(isinstance(row[i], _NUMBER) for row in rows) for i in range(len(heads))]
    padded = "  ".join(
        f"{{:{'>' if right else '<'}{width}}}" for right, width in zip(numeric, widths, strict=True)
    )
    lines: list[str] = []
    for cells_of_row, line in zip((heads, *cells), ("", *below), strict=True):
        lines.append(padded.format(*cells_of_row).rstrip())
        lines += _wrap_remark(line)
    print_line("\n".join(lines))  # one call: there may be thousands of rows


def fits_terminal(heads: Sequence[str], rows: Sequence[Sequence[object]]) -> bool:
    """Return whether a table is no wider than the terminal; without a terminal every table fits."""
    if not sys.stdout.isatty():
        return True
    cells = [[format_cell(value) for value in row] for row in rows]
    return _measure_table(_measure_columns(heads, cells)) <= _terminal_columns()


def _measure_columns(heads: Sequence[str], cells: Sequence[Sequence[str]]) -> list[int]:
    return [max(map(len, column)) for column in zip(heads, *cells, strict=True)]


def _measure_table(widths: Sequence[int]) -> int:
    return sum(widths) + 2 * (len(widths) - 1)


def _print_block(heads: Sequence[str], row: Sequence[str], under: str) -> None:
    """Print the first cell, then the others with their heads on as few lines as possible."""
    print_line(f"{heads[0]}: {row[0]}" if heads[0] else row[0])
    others = [f"{head}: {cell}" for head, cell in zip(heads[1:], row[1:], strict=True) if cell != _UNKNOWN]
    width = _terminal_columns() - len(_INDENT)
    line = ""
    for cell in others:
        joined = f"{line}  {cell}" if line else cell
        if line and len(joined) > width:
            print_line(_INDENT + line)
            joined = cell
        line = joined
    if line:
        print_line(_INDENT + line)
    for line in _wrap_remark(under):
        print_line(line)


def _wrap_remark(line: str) -> list[str]:
    """Return a remark on a row as the lines to print below it."""
    if not line:
        return []
    return [_INDENT + part for part in textwrap.wrap(line, max(_terminal_columns() - len(_INDENT), 20))]


def _terminal_columns() -> int:
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else _UNLIMITED


def format_cell(value: object) -> str:
    """Return a value as it stands in a table, on one line; a float has three decimals."""
    if value is None:
        return _UNKNOWN
    if isinstance(value, float):
        return f"{value:.3f}"
    text = str(value)
    if text.isprintable():
        return text
    return escape_controls(text).replace("\n", " ").replace("\t", " ")
