"""Options that were not given, and plain text, are taken without a validator of their own."""

from pathlib import Path
from typing import Annotated

import pytest
import typer
from typer.core import TyperCommand

from labrig.cli.help_layout import HelpfulCommand


@pytest.mark.parametrize(
    "words",
    [
        ["a"],
        [],
        ["a", "--number", "0"],
        ["a", "--number", "x"],
        ["a", "--path", "b", "--flag"],
        ["7", "--text", "2.50", "--text", ""],
        ["a", "--several", "1", "--several", ""],
        ["a", "--marked", "é\udcff"],
    ],
)
def test_values_are_those_of_typer(words: list[str]) -> None:
    """A command gets the same values, or fails with the same message, as one that validates each of them."""
    assert _call(HelpfulCommand, words) == _call(TyperCommand, words)


def _call(kind: type[TyperCommand], words: list[str]) -> object:
    app = typer.Typer(add_completion=False)
    app.command(cls=kind)(_take)
    try:
        return app(args=words, standalone_mode=False)
    except typer.TyperException as error:
        return error.format_message()


def _mark(value: str | None) -> str:
    return f"marked {value}"


def _take(
    name: str,
    text: str | None = None,
    number: Annotated[int | None, typer.Option(min=1)] = None,
    path: Path | None = None,
    several: list[str] | None = None,
    marked: Annotated[str | None, typer.Option(callback=_mark)] = None,
    flag: bool = False,
) -> object:
    return name, text, number, path, several, marked, flag
