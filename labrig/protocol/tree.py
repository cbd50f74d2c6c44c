"""The values of a file with their positions, the faults found while reading it, and how messages write both."""

import difflib
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from labrig.errors import FileFormatError, InputError, Problem

Scalar: TypeAlias = str | int | float | bool | None
KeyPath: TypeAlias = tuple[str | int, ...]
Plain: TypeAlias = Scalar | list["Plain"] | dict[str, "Plain"]

MAX_FAULTS = 50  # nobody reads more
_MAX_SHOWN = 60
_MAX_CHOICES = 20


@dataclass(frozen=True)
class Position:
    """A place in a file or an option (`source`); line and column count from 1, 0 if the source has no lines."""

    source: str
    line: int = 0
    column: int = 0

    def __str__(self) -> str:
        return f"{self.source}:{self.line}:{self.column}" if self.line else self.source


@dataclass(frozen=True)
class InputFault:
    """A fault before it becomes a `Problem`: its position, its key path, what is wrong, what to do."""

    position: Position
    path: KeyPath
    message: str
    hint: str = ""

    def problem(self) -> Problem:
        """Return the fault as the user reads it; `where` is `file:line:column key.path`."""
        dotted = ".".join(show_key(part) for part in self.path)
        return Problem(f"{self.position} {dotted}".rstrip(), self.message, self.hint)


@dataclass(frozen=True)
class Tree:
    """What was read from one source.

    Parameters
    ----------
    values : dict, list or scalar
        The values, as JSON would hold them.
    positions : mapping of key path to Position
        Where each entry begins, with its key if it has one; indices as text. An entry without one has the position of
        the section around it.
    faults : tuple of InputFault
        Faults that did not stop the reading.
    """

    values: Plain
    positions: Mapping[tuple[str, ...], Position]
    faults: tuple[InputFault, ...] = ()

    def at(self, path: KeyPath) -> Position:
        """Return the position of the entry at `path`, or of the innermost section on the way to it."""
        keys = tuple(map(str, path))
        while keys not in self.positions:
            keys = keys[:-1]
        return self.positions[keys]

    def fault(self, path: KeyPath, message: str, hint: str = "") -> "InputFault":
        """Return a fault of the entry at `path`."""
        return InputFault(self.at(path), path, message, hint)

    def value(self, path: KeyPath) -> Plain:
        """Return the value at `path`, or None."""
        found = self.values
        for part in path:
            found = _list_entries(found).get(part)
        return found

    def section(self, path: KeyPath) -> dict[str, Plain]:
        """Return the section at `path`, empty if there is none."""
        found = self.value(path)
        return found if isinstance(found, dict) else {}

    def holds(self, path: KeyPath) -> bool:
        """Return whether there is an entry at `path`."""
        return not path or path[-1] in _list_entries(self.value(path[:-1]))

    def put(self, path: KeyPath, value: Plain, position: Position) -> "Tree":
        """Return the tree with `value` at `path`; everything in it has the position `position`.

        Raises
        ------
        InputError
            The path leads through a scalar or to an entry that a list does not have.
        """
        keys = tuple(map(str, path))
        values = _put(self.values, keys, value)
        made = {keys[:end]: position for end in range(1, len(keys) + 1)}
        kept = {key: entry for key, entry in self.positions.items() if key[: len(keys)] != keys}
        return Tree(values, made | kept, self.faults)


def _list_entries(value: Plain) -> Mapping[str | int, Plain]:
    """Return the entries of a section or list by key or index; a scalar has none."""
    if isinstance(value, list):
        return dict(enumerate(value))
    return dict(value.items()) if isinstance(value, dict) else {}


def _put(holder: Plain, keys: tuple[str, ...], value: Plain) -> Plain:
    if not keys:
        return value
    key = keys[0]
    if holder is None or isinstance(holder, dict):
        section = holder or {}
        return {**section, key: _put(section.get(key), keys[1:], value)}
    if not isinstance(holder, list):
        raise InputError(f"{show_key(key)} cannot be set inside {show(holder)}, which is not a section")
    if not key.isdecimal() or int(key) >= len(holder):
        raise InputError(f"{show_key(key)} names no entry of this list, expected 0 to {len(holder) - 1}")
    index = int(key)
    return [*holder[:index], _put(holder[index], keys[1:], value), *holder[index + 1 :]]


def file_format_error(faults: Iterable[InputFault]) -> FileFormatError:
    """Return a single error with all faults, sorted by position, without repetitions."""
    ordered = sorted(
        dict.fromkeys(faults), key=lambda f: (f.position.line == 0, f.position.line, f.position.column)
    )
    problems = tuple(fault.problem() for fault in ordered)
    if len(problems) > MAX_FAULTS:
        rest = Problem(
            ordered[0].position.source, f"and {len(problems) - MAX_FAULTS} more problems like these"
        )
        problems = (*problems[:MAX_FAULTS], rest)
    return FileFormatError(problems)


def show(value: Plain) -> str:
    """Return a value as JSON, shortened, with control characters escaped."""
    text = json.dumps(value, ensure_ascii=not str(value).isprintable())
    return text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]}… ({len(text)} characters)"


def show_key(key: str | int) -> str:
    """Return a part of a key path, quoted unless it is a plain word."""
    text = str(key)
    return text if re.fullmatch(r"[\w.<>-]{1,60}", text) else show(text)


def find_closest(word: str, choices: Iterable[str]) -> str | None:
    """Return the choice that `word` probably means, or None."""
    by_folded = {choice.casefold().replace("-", "_"): choice for choice in choices}
    folded = word.strip().casefold().replace("-", "_").replace(" ", "_")
    found = difflib.get_close_matches(folded, by_folded, n=1, cutoff=0.6)
    return by_folded[found[0]] if found else None


def choice_hint(word: str, choices: Iterable[str]) -> str:
    """Return `did you mean x?` for a word close to a choice, else the choices."""
    names = tuple(choices)
    meant = find_closest(word, names)
    if meant:
        return f"did you mean {show_key(meant)}?"
    return "known here: " + ", ".join(map(show_key, names[:_MAX_CHOICES]))
