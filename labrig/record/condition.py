"""The language of `labrig runs --where`: comparisons of a run's fields, joined by and, or, not.

.. code-block:: text

    condition  = union { "or" union }
    union      = negation { "and" negation }
    negation   = "not" negation | "(" condition ")" | comparison
    comparison = field ( "=" | "!=" | "<" | "<=" | ">" | ">=" | "~" ) value
    value      = a word, or any text in single or double quotes

A field with several values, such as the gels of a sweep, fits if one of them does; `a != b` is `not a = b`. If both
sides are numbers they are compared as numbers, else as text, so that ISO dates sort correctly. `~` tests whether the
text is contained, ignoring case. A run without the field does not fit.
"""

import json
import operator
import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import TypeAlias

from labrig.errors import InputError

Value: TypeAlias = str | int | float | bool | None
Lookup: TypeAlias = Callable[[str], Sequence[Value]]
"""From the name of a field to its values in a run."""

BLOCK_NAME = "block.name"
"""The field with the name of a specimen that has a file."""

ALWAYS_KNOWN = frozenset({"tag", "verdict", "note", BLOCK_NAME})
"""Fields that may be searched for even if no run has them."""

_MAX_DEPTH = 50
# The usual fields; a hint names these out of the two hundred that a run has.
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
_TOKEN = re.compile(r"""\s*(<=|>=|!=|[=<>~()]|"[^"]*"|'[^']*'|[^\s=!<>~()"']+)""")
_JOINTS = frozenset({"and", "or", "not"})
_ORDERS: dict[str, Callable[..., bool]] = {
    "=": operator.eq,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
_SIGNS = (*_ORDERS, "!=", "~")


@dataclass(frozen=True)
class Condition:
    """A parsed condition: the fields that it names with their columns in the text, from 1, and its test of a run."""

    names: tuple[tuple[str, int], ...]
    fits: Callable[[Lookup], bool]

    def require_known(self, known: Collection[str]) -> None:
        """Refuse a name that no run has. Raises `InputError`, which names its place and the existing fields."""
        for name, column in self.names:
            require_field(name, known, f"--where, character {column}")


def require_field(name: str, known: Collection[str], where: str) -> None:
    """Refuse a name that matches no known path; `where` begins the message. Raises `InputError`."""
    if find_paths(name, known):
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


def find_paths(name: str, known: Collection[str]) -> tuple[str, ...]:
    """Return the paths that a name matches: those that are equal to it or end in it."""
    return tuple(path for path in known if path == name or path.endswith(f".{name}"))


def parse_condition(text: str) -> Condition:
    """Read a condition. Raises `InputError`, which names the first invalid character, and what was expected there."""
    parser = _Parser(text)
    fits = parser.parse_condition(0)
    parser.expect_end()
    return Condition(tuple(parser.names), fits)


class _Parser:
    """A parser in one pass; each method reads one rule of the grammar and returns its test."""

    def __init__(self, text: str) -> None:
        self.names: list[tuple[str, int]] = []
        self._text = text
        self._tokens: list[tuple[str, int]] = []
        position, end = 0, len(text.rstrip())
        while position < end:
            match = _TOKEN.match(text, position)
            if match is None:
                raise self._error(position + 1, "this cannot be read; is a quote open?")
            self._tokens.append((match[1], match.start(1) + 1))
            position = match.end()
        self._tokens.append(("", end + 1))

    def expect_end(self) -> None:
        if self._next:
            raise self._refuse(
                "and, or, or the end (a number goes alone: its unit stands in the field's name)"
            )

    def parse_condition(self, depth: int) -> Callable[[Lookup], bool]:
        tests = [self._parse_union(depth)]
        while self._accept("or"):
            tests.append(self._parse_union(depth))
        return lambda lookup: any(test(lookup) for test in tests)

    def _parse_union(self, depth: int) -> Callable[[Lookup], bool]:
        tests = [self._parse_negation(depth)]
        while self._accept("and"):
            tests.append(self._parse_negation(depth))
        return lambda lookup: all(test(lookup) for test in tests)

    def _parse_negation(self, depth: int) -> Callable[[Lookup], bool]:
        if depth > _MAX_DEPTH:
            raise self._error(self._tokens[0][1], f"more than {_MAX_DEPTH} levels")
        if self._accept("not"):
            test = self._parse_negation(depth + 1)
            return lambda lookup: not test(lookup)
        if self._accept("("):
            inner = self.parse_condition(depth + 1)
            if not self._accept(")"):
                raise self._refuse("a closing bracket")
            return inner
        return self._parse_comparison()

    def _parse_comparison(self) -> Callable[[Lookup], bool]:
        if not self._is_word or self._next in _JOINTS:
            raise self._refuse("the name of a field")
        name, column = self._take()
        if self._next not in _SIGNS:
            raise self._refuse("one of = != < <= > >= ~")
        sign, _ = self._take()
        if not self._is_word and self._next[:1] not in {'"', "'"}:
            raise self._refuse("a value (equal is one =)" if self._next == "=" else "a value")
        is_quoted = not self._is_word
        value, _ = self._take()
        self.names.append((name, column))
        number = None if is_quoted else _parse_number(value)
        return _make_test(name, sign, value[1:-1] if is_quoted else value, number)

    @property
    def _next(self) -> str:
        return self._tokens[0][0]

    @property
    def _is_word(self) -> bool:
        return self._next != "" and self._next[0] not in "=!<>~()\"'"

    def _accept(self, text: str) -> bool:
        return self._next == text and bool(self._take())

    def _take(self) -> tuple[str, int]:
        return self._tokens.pop(0)

    def _refuse(self, expected: str) -> InputError:
        found = repr(self._next) if self._next else "the end"
        return self._error(self._tokens[0][1], f"expected {expected}, found {found}")

    def _error(self, column: int, what: str) -> InputError:
        return InputError(
            f"--where {self._text!r}, character {column}: {what}",
            'for example: --where "gelatin_percent=13 and exit_status=success"',
        )


def _make_test(name: str, sign: str, text: str, number: float | None) -> Callable[[Lookup], bool]:
    if sign == "!=":
        equals = _make_test(name, "=", text, number)
        return lambda lookup: bool(lookup(name)) and not equals(lookup)
    if sign == "~":
        sought = text.casefold()
        return lambda lookup: any(sought in _show(value).casefold() for value in lookup(name))
    order = _ORDERS[sign]

    def fits(value: Value) -> bool:
        if value is None:  # it has no order; `=` finds it by name
            return sign == "=" and text == "null"
        if isinstance(value, int | float) and not isinstance(value, bool):
            return number is not None and order(value, number)
        return order(_show(value), text)

    return lambda lookup: any(fits(value) for value in lookup(name))


def _show(value: Value) -> str:
    """Return a value as the files have it."""
    return value if isinstance(value, str) else json.dumps(value)


def _parse_number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
