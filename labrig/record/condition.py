"""The language of `labrig runs --where`: comparisons of a run's fields, joined by and, or, not.

.. code-block:: text

    condition  = choice
    choice     = union { "or" union }
    union      = negation { "and" negation }
    negation   = "not" negation | "(" choice ")" | comparison
    comparison = field ( "=" | "!=" | "<" | "<=" | ">" | ">=" | "~" ) value
    value      = a word, or any text in single or double quotes

A field with several values, such as the gels of a sweep, fits if one of them does; `a != b` is `not a = b`. If both
sides are numbers they are compared as numbers, else as text, so that ISO dates sort correctly. `~` tests whether the
text is contained, ignoring case. A run without the field does not fit.

A condition becomes an SQL expression over the tables of `run_index`; typed text goes only into its parameters.
"""

import re
from collections.abc import Callable, Collection
from dataclasses import dataclass
from difflib import get_close_matches

from labrig.errors import InputError
from labrig.record.json_lines import plain_text

BLOCK_NAME = "block.name"
"""The field with the name of a specimen that has a file."""

ALWAYS_KNOWN = frozenset({"tag", "verdict", "verdict_reason", "note", BLOCK_NAME})
"""Fields that may be searched for even if no run has them."""

_MAX_DEPTH = 50
_MAX_COMPARISONS = 1000
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
_TOKEN = re.compile(
    r"""\s*(?:(?P<symbol><=|>=|!=|=|<|>|~|\(|\))|(?P<quoted>"[^"]*"|'[^']*')|(?P<word>[^\s=!<>~()"']+))"""
)
_JOINTS = frozenset({"and", "or", "not"})
_SIGNS = frozenset({"=", "!=", "<", "<=", ">", ">=", "~"})
_HAS = "run IN (SELECT run FROM held, json_each(held.leaf) AS each WHERE held.name = ?{})"
_SHOWN = "iif(each.type = 'text', each.value, shown(each.value, each.type))"


@dataclass(frozen=True)
class Condition:
    """A parsed condition.

    Attributes
    ----------
    names : tuple of (str, int)
        Its fields, and their columns in the text, from 1.
    sql : str
        An expression in `run`, over the table `held` (run, name, leaf) of the values of a run under each name, as JSON.
    parameters : tuple of str, float or None
        The values of its question marks.
    """

    names: tuple[tuple[str, int], ...]
    sql: str
    parameters: tuple[str | float | None, ...]

    def require_known(self, known: Collection[str]) -> None:
        """Refuse a name that no run has.

        Raises
        ------
        InputError
            Names the place, the name, and the existing fields.
        """
        for name, column in self.names:
            require_field(name, known, f"--where, character {column}")


def require_field(name: str, known: Collection[str], where: str) -> None:
    """Refuse a name that matches no known path; `where` begins the message.

    Raises
    ------
    InputError
    """
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
    """Read a condition.

    Raises
    ------
    InputError
        Names the first invalid character, and what was expected there.
    """
    parser = _Parser(text)
    sql = parser.parse_choice(0)
    parser.expect_end()
    return Condition(tuple(parser.names), sql, tuple(parser.parameters))


@dataclass(frozen=True)
class _Token:
    kind: str
    text: str
    column: int

    def __str__(self) -> str:
        return "the end" if self.kind == "end" else repr(self.text)


def _split_tokens(text: str) -> list[_Token]:
    tokens: list[_Token] = []
    position = 0
    end = len(text.rstrip())
    while position < end:
        match = _TOKEN.match(text, position)
        if match is None or match.lastgroup is None:
            raise _make_error(text, position + 1, "this cannot be read; is a quote open?")
        kind = match.lastgroup
        tokens.append(_Token(kind, match[kind], match.start(kind) + 1))
        position = match.end()
    return [*tokens, _Token("end", "", end + 1)]


class _Parser:
    """A parser in one pass; each method reads one rule of the grammar and returns its SQL."""

    def __init__(self, text: str) -> None:
        self.names: list[tuple[str, int]] = []
        self.parameters: list[str | float | None] = []
        self._text = text
        self._tokens = iter(_split_tokens(text))
        self._next = next(self._tokens)
        self._after_number = False

    def expect_end(self) -> None:
        if self._next.kind != "end":
            goes_alone = " (a number goes alone: its unit stands in the name of the field)"
            unit = goes_alone if self._after_number and self._next.kind == "word" else ""
            raise self._refuse_token(f"and, or, or the end{unit}")

    def parse_choice(self, depth: int) -> str:
        return self._parse_joined(
            "or", lambda: self._parse_joined("and", lambda: self._parse_negation(depth))
        )

    def _parse_joined(self, joint: str, part: Callable[[], str]) -> str:
        parts = [part()]
        while self._accept(joint):
            parts.append(part())
        # In pairs, because SQLite limits the depth of an expression.
        while len(parts) > 1:
            pairs = (parts[start : start + 2] for start in range(0, len(parts), 2))
            parts = [f"({f' {joint} '.join(pair)})" for pair in pairs]
        return parts[0]

    def _parse_negation(self, depth: int) -> str:
        if depth > _MAX_DEPTH:
            raise _make_error(self._text, self._next.column, f"more than {_MAX_DEPTH} levels")
        if self._accept("not"):
            return f"NOT {self._parse_negation(depth + 1)}"
        if self._accept("("):
            inner = self.parse_choice(depth + 1)
            if not self._accept(")"):
                raise self._refuse_token("a closing bracket")
            return f"({inner})"
        return self._parse_comparison()

    def _parse_comparison(self) -> str:
        name = self._next
        if name.kind != "word" or name.text in _JOINTS:
            raise self._refuse_token("the name of a field")
        if len(self.names) == _MAX_COMPARISONS:
            raise _make_error(self._text, name.column, f"more than {_MAX_COMPARISONS} comparisons")
        self._advance()
        sign = self._next
        if sign.text not in _SIGNS or sign.kind != "symbol":
            raise self._refuse_token("one of = != < <= > >= ~")
        self._advance()
        value = self._next
        if value.kind not in {"word", "quoted"}:
            raise self._refuse_token("a value (equal is one =)" if value.text == "=" else "a value")
        self._advance()
        number = _parse_number(value.text) if value.kind == "word" else None
        self._after_number = number is not None
        self.names.append((name.text, name.column))
        text = plain_text(value.text[1:-1] if value.kind == "quoted" else value.text)
        return self._format_comparison(plain_text(name.text), sign.text, text, number)

    def _format_comparison(self, name: str, sign: str, text: str, number: float | None) -> str:
        if sign == "!=":
            self.parameters.append(name)
            return f"({_HAS.format('')} AND NOT {self._format_comparison(name, '=', text, number)})"
        if sign == "~":
            self.parameters += [name, text.casefold()]
            return _HAS.format(f" AND instr(casefold({_SHOWN}), ?)")
        if sign == "=" and number is None:
            self.parameters += [name, text]
            return _HAS.format(f" AND {_SHOWN} = ?")
        # A number and a word have no order, and null has none with any value.
        self.parameters += [name, number, text]
        return _HAS.format(
            f" AND CASE WHEN each.type IN ('integer', 'real') THEN each.value {sign} ?"
            f" ELSE each.type <> 'null' AND {_SHOWN} {sign} ? END"
        )

    def _accept(self, text: str) -> bool:
        if self._next.kind == "quoted" or self._next.text != text:
            return False
        self._advance()
        return True

    def _advance(self) -> None:
        self._next = next(self._tokens)

    def _refuse_token(self, expected: str) -> InputError:
        return _make_error(self._text, self._next.column, f"expected {expected}, found {self._next}")


def _parse_number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _make_error(text: str, column: int, what: str) -> InputError:
    return InputError(
        f"--where {text!r}, character {column}: {what}",
        'for example: --where "gelatin_percent=13 and exit_status=success"',
    )
