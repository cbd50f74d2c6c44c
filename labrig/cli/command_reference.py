"""The reference of the commands, as Markdown: every command with its arguments, options and exit codes."""

import inspect
import re
from collections.abc import Iterator
from typing import TypeAlias

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from labrig.errors import (
    AnswerIsNoError,
    BugError,
    InputError,
    InterruptedRunError,
    LabrigError,
    MachineError,
    RecordError,
)
from labrig.protocol.reference import code, escape

AnyCommand: TypeAlias = TyperCommand | TyperGroup

_EXIT_CODES: dict[type[LabrigError], str] = {
    AnswerIsNoError: "It ran, and the answer is no: a target missed, no plan, a calibration refused.",
    InputError: "The input cannot be used, or a file exists that would be overwritten.",
    MachineError: "A device or the computer failed, or motion had to stop.",
    RecordError: "A record is damaged, or a folder is no run.",
    BugError: "labrig itself failed; the message names the file with the traceback.",
    InterruptedRunError: "It was interrupted: by Ctrl+C, or by INT, TERM or HUP.",
}
_REMARK = re.compile(r"\s+\[([^\[\]]*)\]$")


def write_command_reference(app: typer.Typer, title: str) -> str:
    """Return the reference as Markdown; a section for each command, in the order of the help."""
    codes = "".join(f"| {kind.exit_code} | {meaning} |\n" for kind, meaning in _EXIT_CODES.items())
    lines = [
        f"# {title}",
        "",
        "`labrig COMMAND --help` prints the same. With `--json` a command prints one JSON document and nothing else.",
        "",
        "## Exit codes",
        "",
        f"| code | meaning |\n|---|---|\n| 0 | Done. |\n{codes}",
    ]
    for path, command in find_commands(read_tree(app)):
        lines += _describe_command(path, command)
    return "\n".join(lines)


def read_tree(app: typer.Typer) -> TyperGroup:
    """Return the tree of commands, as the parser has it."""
    root = get_command(app)
    assert isinstance(root, TyperGroup)
    return root


def find_commands(
    group: TyperGroup, path: tuple[str, ...] = ("labrig",)
) -> Iterator[tuple[tuple[str, ...], AnyCommand]]:
    """Yield each command below a group with the words that call it; a group stands before its commands."""
    for name, command in group.commands.items():
        assert isinstance(command, TyperCommand | TyperGroup)
        yield (*path, name), command
        if isinstance(command, TyperGroup):
            yield from find_commands(command, (*path, name))


def _describe_command(path: tuple[str, ...], command: AnyCommand) -> Iterator[str]:
    context = typer.Context(command, info_name=" ".join(path))
    usage = " ".join((*path, *command.collect_usage_pieces(context)))
    detail = "" if command.callback is None else inspect.cleandoc(command.callback.__doc__ or "")
    said = (command.help or "").strip()
    yield from (f"## {code(' '.join(path))}", "", escape(said), "")
    if detail and detail != said:
        yield from (escape(detail), "")
    yield from ("```text", usage, "```", "")
    records = [record for param in command.params if (record := param.get_help_record(context)) is not None]
    if records:
        yield "| argument or option | default | meaning |\n|---|---|---|"
        yield from (_describe_parameter(*record) for record in records)
        yield ""


def _describe_parameter(name: str, text: str) -> str:
    """Return a row; the help says at its end what the default is, or that the option is required."""
    remark = _REMARK.search(text)
    default = remark[1].removeprefix("default: ") if remark else ""
    return f"| {code(name)} | {escape(default)} | {escape(_REMARK.sub('', text))} |"
