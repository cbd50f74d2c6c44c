"""The little language of `labrig runs --where`: comparisons of a run's fields, joined by and, or, not.

.. code-block:: text

    condition  = choice
    choice     = union { "or" union }
    union      = negation { "and" negation }
    negation   = "not" negation | "(" choice ")" | comparison
    comparison = field ( "=" | "!=" | "<" | "<=" | ">" | ">=" | "~" ) value
    value      = a word, or any text in single or double quotes

A field of which a run has several values, such as the gels of a sweep, fits when one of them does; `a != b` is
`not a = b`. Numbers are compared as numbers where both sides are numbers, else both as text: ISO dates so sort as
they should. `~` asks whether the text is contained, capitals aside. A run that lacks the field does not fit.

Parsed by hand into closures over these seven comparisons; nothing of it is ever evaluated as Python or SQL.
"""

import operator
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, TypeAlias

from labrig.errors import InputError

Value: TypeAlias = str | int | float | bool | None
Fields: TypeAlias = Mapping[str, Sequence[Value]]
"""Values by dotted path, such as `protocol.specimens.gelatin_percent`; each path has one or more."""

_MAX_DEPTH = 50
# What people look for; a hint names these, of the two hundred fields that a run has.
_USUAL = (
    "run",
    "protocol",
    "exit_status",
    "started",
    "operator",
    "title",
    "seed",
    "tag",
    "verdict",
    "note",
    "gelatin_percent",
    "needle_id",
    "diameter_mm",
    "mean_radius_mm",
)
_LEAST_LIKENESS = 0.75
_TOKEN = re.compile(
    r"""\s*(?:(?P<symbol><=|>=|!=|=|<|>|~|\(|\))|(?P<quoted>"[^"]*"|'[^']*')|(?P<word>[^\s=!<>~()"']+))"""
)
_JOINTS = frozenset({"and", "or", "not"})
_COMPARE: Mapping[str, Callable[[Any, Any], bool]] = {
    "=": operator.eq,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}


@dataclass(frozen=True)
class _Token:
    kind: str
    text: str
    column: int

    def __str__(self) -> str:
        return "the end" if self.kind == "end" else repr(self.text)


@dataclass(frozen=True)
class Condition:
    """A condition that has been read.

    Attributes
    ----------
    text : str
        As it was given.
    names : tuple of (str, int)
        The fields that it asks for, and the columns at which they stand, from 1.
    """

    text: str
    names: tuple[tuple[str, int], ...]
    _holds: Callable[[Fields], bool]

    def holds(self, fields: Fields) -> bool:
        """Return whether a run with these fields fits."""
        return self._holds(fields)

    def require_known(self, known: Collection[str]) -> None:
        """Refuse a name that no run has.

        Raises
        ------
        InputError
            Names the place, the name, and the fields that there are.
        """
        for name, column in self.names:
            require_field(name, known, f"--where, character {column}")


def require_field(name: str, known: Collection[str], where: str) -> None:
    """Refuse a name that stands for none of the known paths; `where` begins the message.

    Raises
    ------
    InputError
    """
    if paths_of(name, known):
        return
    by_depth = sorted(known, key=lambda path: (path.count("."), path))
    short = list(dict.fromkeys(path.rpartition(".")[2] for path in by_depth))
    near = [path for path in short if path.startswith(name)]
    near = near or get_close_matches(name, short, 1, _LEAST_LIKENESS)
    meant = f"did you mean {near[0]}? " if near else ""
    shown_first = [field for field in _USUAL if field in short] or short[: len(_USUAL)]
    others = len(short) - len(shown_first)
    more = f", and {others} more keys of manifest, protocol and result" if others else ""
    raise InputError(
        f"{where}: no run has a field {name!r}", f"{meant}fields: {', '.join(shown_first)}{more}"
    )


def parse_condition(text: str) -> Condition:
    """Read a condition.

    Raises
    ------
    InputError
        Names the character where it stops making sense, and what was expected there.
    """
    parser = _Parser(text, _tokens(text))
    holds = parser.choice(0)
    parser.expect_end()
    return Condition(text, tuple(parser.names), holds)


def paths_of(name: str, known: Collection[str]) -> tuple[str, ...]:
    """Return the paths that a name stands for: itself, else those with the fewest parts that end in it."""
    if name in known:
        return (name,)
    ending = [path for path in known if path.endswith(f".{name}")]
    least = min((path.count(".") for path in ending), default=0)
    return tuple(path for path in ending if path.count(".") == least)


def paths_for(names: Collection[str], known: Collection[str]) -> frozenset[str]:
    """Return the paths that may stand for one of the names in some run: those that are it, or end in it."""
    endings = tuple(f".{name}" for name in names)
    return frozenset(path for path in known if path in names or path.endswith(endings))


def values_by_name(
    names: Sequence[str], fields_of_runs: Mapping[str, Fields]
) -> dict[str, dict[str, tuple[Value, ...]]]:
    """Return of each run the values under each of the names, each once; runs with the same paths are looked at once."""
    stands_for: dict[tuple[str, ...], list[tuple[str, tuple[str, ...]]]] = {}
    found = {}
    for run, fields in fields_of_runs.items():
        shape = tuple(fields)
        if shape not in stands_for:
            stands_for[shape] = [(name, paths_of(name, shape)) for name in names]
        found[run] = {
            name: tuple(dict.fromkeys([value for path in paths for value in fields[path]]))
            for name, paths in stands_for[shape]
        }
    return found


def values_of(name: str, fields: Fields) -> tuple[Value, ...]:
    """Return the values that a run has under a name, each once; none where it lacks the field."""
    return tuple(dict.fromkeys(value for path in paths_of(name, fields) for value in fields[path]))


def _tokens(text: str) -> list[_Token]:
    tokens: list[_Token] = []
    position = 0
    end = len(text.rstrip())
    while position < end:
        match = _TOKEN.match(text, position)
        if match is None or match.lastgroup is None:
            raise _fault(text, len(text[:position]) + 1, "this cannot be read; is a quote open?")
        kind = match.lastgroup
        tokens.append(_Token(kind, match[kind], match.start(kind) + 1))
        position = match.end()
    return [*tokens, _Token("end", "", end + 1)]


class _Parser:
    """One pass from left to right; each method reads one rule of the grammar."""

    def __init__(self, text: str, tokens: list[_Token]) -> None:
        self.names: list[tuple[str, int]] = []
        self._text = text
        self._tokens = iter(tokens)
        self._next = next(self._tokens)
        self._after_number = False

    def expect_end(self) -> None:
        if self._next.kind != "end":
            raise self._unexpected(f"and, or, or the end{self._unit_after_number()}")

    def choice(self, depth: int) -> Callable[[Fields], bool]:
        parts = [self._union(depth)]
        while self._takes("or"):
            parts.append(self._union(depth))
        return lambda fields: any(part(fields) for part in parts)

    def _union(self, depth: int) -> Callable[[Fields], bool]:
        parts = [self._negation(depth)]
        while self._takes("and"):
            parts.append(self._negation(depth))
        return lambda fields: all(part(fields) for part in parts)

    def _negation(self, depth: int) -> Callable[[Fields], bool]:
        if depth > _MAX_DEPTH:
            raise _fault(self._text, self._next.column, f"more than {_MAX_DEPTH} levels")
        if self._takes("not"):
            inner = self._negation(depth + 1)
            return lambda fields: not inner(fields)
        if self._takes("("):
            inner = self.choice(depth + 1)
            if not self._takes(")"):
                raise self._unexpected("a closing bracket")
            return inner
        return self._comparison()

    def _comparison(self) -> Callable[[Fields], bool]:
        name = self._next
        if name.kind != "word" or name.text in _JOINTS:
            raise self._unexpected("the name of a field")
        self._advance()
        sign = self._next
        if sign.text not in {*_COMPARE, "!=", "~"} or sign.kind != "symbol":
            raise self._unexpected("one of = != < <= > >= ~")
        self._advance()
        value = self._next
        if value.kind not in {"word", "quoted"}:
            raise self._unexpected("a value (equal is one =)" if value.text == "=" else "a value")
        self._advance()
        self._after_number = value.kind == "word" and _number(value.text) is not None
        self.names.append((name.text, name.column))
        return _comparison(name.text, sign.text, value)

    def _unit_after_number(self) -> str:
        """Return a remark where a number is followed by another word, as its unit would be."""
        follows = self._after_number and self._next.kind == "word"
        return " (a number goes alone: its unit stands in the name of the field)" if follows else ""

    def _takes(self, text: str) -> bool:
        if self._next.kind == "quoted" or self._next.text != text:
            return False
        self._advance()
        return True

    def _advance(self) -> None:
        self._next = next(self._tokens)

    def _unexpected(self, expected: str) -> InputError:
        return _fault(self._text, self._next.column, f"expected {expected}, found {self._next}")


def _comparison(name: str, sign: str, value: _Token) -> Callable[[Fields], bool]:
    text = value.text[1:-1] if value.kind == "quoted" else value.text
    if sign == "~":
        wanted = text.casefold()
        return lambda fields: any(wanted in shown(each).casefold() for each in values_of(name, fields))
    compare = _COMPARE["=" if sign == "!=" else sign]
    asked = None if value.kind == "quoted" else _number(text)

    def one_fits(fields: Fields) -> bool:
        return any(_compared(compare, each, text, asked) for each in values_of(name, fields))

    if sign == "!=":
        return lambda fields: bool(values_of(name, fields)) and not one_fits(fields)
    return one_fits


def _compared(compare: Callable[[Any, Any], bool], value: Value, text: str, asked: float | None) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if is_number and asked is not None:
        return compare(value, asked)
    # A number and a word have no order, and null none with anything.
    if (is_number or value is None) and compare is not operator.eq:
        return False
    return compare(shown(value), text)


def shown(value: Value) -> str:
    """Return a value as it is written in a condition and in tables."""
    if value is None:
        return "null"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _fault(text: str, column: int, what: str) -> InputError:
    return InputError(
        f"--where {text!r}, character {column}: {what}",
        'for example: --where "gelatin_percent=13 and exit_status=success"',
    )
