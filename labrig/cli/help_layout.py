"""How help is laid out: in columns, or one below the other where columns would cut names."""

import importlib
import shutil
import sys
import textwrap
from types import ModuleType
from typing import Any

from typer.core import TyperCommand, TyperGroup

from labrig.cli.plain_values import spare_validators

# On narrower terminals columns cut names, and longer names than this share of the width are cut on any.
_LEAST_COLUMNS, _LARGEST_SHARE = 72, 0.25
_INDENT = "    "
# What the columns of typer import and the help of labrig never shows, and the name that they take from it. Both take a
# quarter of the time of `labrig --help`.
_COLUMNS = "typer.rich_utils"
_NEVER_SHOWN = {"rich.markdown": "Markdown", "rich.traceback": "Traceback"}


class _PlainParams:
    """A command or a group, mixed in: plain values need no validators."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters, with those of typer's own."""
        params = super().get_params(ctx)  # type: ignore[misc]  # the class that it is mixed into has it
        return spare_validators(params)


class HelpfulCommand(_PlainParams, TyperCommand):
    """A command whose help cuts no names: where columns would, each text stands below its name."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help."""
        if _fits_columns(self, ctx):
            _import_columns()
            super().format_help(ctx, formatter)
        else:
            formatter.write(_stack(self, ctx))


class HelpfulGroup(_PlainParams, TyperGroup):
    """A group of commands whose help cuts no names."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help, with the texts of the group's commands."""
        if _fits_columns(self, ctx):
            _import_columns()
            super().format_help(ctx, formatter)
            return
        commands = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        texts = [_stack_text(name, (command and command.help) or "") for name, command in commands]
        last = ("", _wrap(self.epilog)) if self.epilog else ()
        formatter.write("\n".join((_stack(self, ctx), *texts, *last)))


def _import_columns() -> None:
    """Import what lays out columns, without Markdown and tracebacks; whoever imports these later gets them whole."""
    if _COLUMNS in sys.modules:
        return
    stand_ins = {name: ModuleType(name) for name in _NEVER_SHOWN if name not in sys.modules}
    for name, module in stand_ins.items():
        setattr(module, _NEVER_SHOWN[name], type(_NEVER_SHOWN[name], (), {}))
    sys.modules.update(stand_ins)
    try:
        importlib.import_module(_COLUMNS)
    finally:
        for name in stand_ins:
            del sys.modules[name]


def _fits_columns(command: TyperCommand | TyperGroup, ctx: Any) -> bool:
    columns = shutil.get_terminal_size().columns
    longest = max(len(name) for param in command.get_params(ctx) for name in param.opts)
    return columns >= _LEAST_COLUMNS and longest <= _LARGEST_SHARE * columns


def _stack(command: TyperCommand | TyperGroup, ctx: Any) -> str:
    """Return usage and help of a command, then each argument and option with its text below."""
    usage = f"Usage: {ctx.command_path} {' '.join(command.collect_usage_pieces(ctx))}"
    records = [param.get_help_record(ctx) for param in command.get_params(ctx)]
    texts = [_stack_text(*record) for record in records if record is not None]
    return "\n".join((_wrap(usage, _INDENT), "", _wrap(command.help or ""), "", *texts, ""))


def _stack_text(name: str, text: str) -> str:
    plain = text.replace("\\[", "[")  # escaped for rich, which lays out the columns
    return f"{_wrap(name, _INDENT)}\n{_wrap(_INDENT + plain, _INDENT)}"


def _wrap(text: str, below: str = "") -> str:
    """Return a text in lines as wide as the terminal, all but the first behind `below`."""
    columns = shutil.get_terminal_size().columns
    return textwrap.fill(text, columns, subsequent_indent=below, break_on_hyphens=False)
