"""YAML 1.2 text -> tree of values with places.

The events of ruamel.yaml's scanner and parser are composed here and not by its constructor, because a
protocol needs less and wants more: only the core schema of YAML 1.2 (no tags, no dates, no merge keys, so
`no` is a word and `12:30` a text), a place for every value and key, all faults and not the first, and bounds
on depth and on what aliases expand to.
"""

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import TypeAlias

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError
from ruamel.yaml.events import (
    AliasEvent,
    DocumentStartEvent,
    Event,
    MappingEndEvent,
    MappingStartEvent,
    ScalarEvent,
    SequenceEndEvent,
    SequenceStartEvent,
    StreamEndEvent,
)
from ruamel.yaml.reader import ReaderError

from labrig.errors import FileFormatError
from labrig.protocol.tree import Fault, KeyPath, Node, Place, Scalar, Tree, branch, file_format_error

_Start: TypeAlias = ScalarEvent | MappingStartEvent | SequenceStartEvent

MAX_DEPTH = 20
MAX_VALUES = 20_000

_NULL = re.compile(r"|~|null|Null|NULL")
_BOOL = re.compile(r"true|True|TRUE|false|False|FALSE")
_INT = re.compile(r"[-+]?[0-9]{1,18}")  # longer ones are floats: nothing here counts that far
_OCTAL_OR_HEX = re.compile(r"0o[0-7]{1,18}|0x[0-9a-fA-F]{1,15}")
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)")

# What the parser says -> what it means, and what a person can do about it.
_SYNTAX_WORDS = (
    ("'\\t'", "a tab stands where only spaces may", "indent with spaces"),
    (
        "mapping values are not allowed",
        "this colon makes no key",
        "a text with a colon needs quotes; check the indent",
    ),
    ("unexpected end of stream", "a quote is not closed", "it was opened on the line named here"),
    (
        "could not find expected ':'",
        "this line has no colon after its key",
        "a key needs a colon and a space",
    ),
    (
        "expected <block end>",
        "this line does not fit those above",
        "indent it like its neighbours; is a quote open?",
    ),
    (
        "expected ',' or",
        "a bracket is not closed, or a comma is missing",
        "it was opened on the line named here",
    ),
    (
        "unknown escape",
        "a backslash in double quotes means nothing here",
        "write \\\\, or take single quotes",
    ),
    ("cannot start any token", "a value cannot start like this", "put it in quotes"),
)


def resolve_scalar(text: str) -> Scalar:
    """Return what an unquoted text means in the core schema of YAML 1.2 (specification, section 10.3.2)."""
    if _NULL.fullmatch(text):
        return None
    if _BOOL.fullmatch(text):
        return text.lower() == "true"
    return _resolve_number(text)


def _resolve_number(text: str) -> int | float | str:
    if _INT.fullmatch(text):
        return int(text)
    if _OCTAL_OR_HEX.fullmatch(text):
        return int(text, 0)
    if _FLOAT.fullmatch(text):
        return float(text)
    return float(text.replace(".", "", 1)) if _NOT_FINITE.fullmatch(text) else text


def read_tree(text: str, source: str) -> Tree:
    """Return the mapping that `text` holds; `source` names it in messages.

    Raises
    ------
    FileFormatError
        The text is no YAML, empty, more than one document, no mapping at the top, or too deep or too large.
    """
    tree = compose(text, source)
    root = tree.root
    if root.kind == "mapping":
        return tree
    if root.kind == "scalar" and root.scalar is None:
        raise file_format_error(
            [Fault(Place(source), (), "the file is empty, expected keys and values", "is it the right file?")]
        )
    hint = (
        "a key needs a colon and a space: `key: value`"
        if root.kind == "scalar"
        else "the top holds `key: value` lines"
    )
    message = f"the file holds {root.shown()}, expected keys and values"
    raise file_format_error([*tree.faults, Fault(root.place, (), message, hint)])


def compose(text: str, source: str) -> Tree:
    """Return whatever single value `text` holds, with the faults that did not stop the reading.

    Raises
    ------
    FileFormatError
        As `read_tree`, but any value may stand at the top.
    """
    composer = _Composer(text, source)
    return Tree(composer.document(), tuple(composer.faults))


class _Composer:
    """Builds nodes from the events of one text and gathers its faults."""

    def __init__(self, text: str, source: str) -> None:
        self._events: Iterator[Event] = iter(YAML(typ="safe", pure=True).parse(text))
        self._text = text
        self._source = source
        self._anchors: dict[str, Node] = {}
        self.faults: list[Fault] = []

    def _next(self) -> Event:
        try:
            return next(self._events)
        except MarkedYAMLError as error:
            raise self._stopped(_syntax_fault(error, self._source)) from error
        except ReaderError as error:
            raise self._stopped(_character_fault(error, self._text, self._source)) from error
        except (ValueError, OverflowError) as error:  # an escape beyond Unicode, such as "\UFFFFFFFF"
            fault = Fault(Place(self._source), (), "an escape in double quotes names no character")
            raise self._stopped(fault) from error

    def _stopped(self, fault: Fault) -> FileFormatError:
        return file_format_error([*self.faults, fault])

    def document(self) -> Node:
        """Return the value of the only document."""
        self._next()  # stream start
        start = self._next()
        if isinstance(start, StreamEndEvent):
            return Node("scalar", Place(self._source))
        if isinstance(start, DocumentStartEvent) and start.version not in (None, (1, 2)):
            found = ".".join(map(str, start.version))
            self._fault(start, (), f"the file declares YAML {found}, expected 1.2", "delete the %YAML line")
        root = self._node(self._next(), ())
        self._next()  # document end
        after = self._next()
        if not isinstance(after, StreamEndEvent):
            message = "a second document starts here, expected one"
            raise self._stopped(Fault(self._place(after), (), message, "delete this ---"))
        return root

    def _node(self, event: Event, path: KeyPath) -> Node:
        if len(path) > MAX_DEPTH:
            raise self._stopped(Fault(self._place(event), (), f"nested deeper than {MAX_DEPTH} levels"))
        if isinstance(event, AliasEvent):
            return self._alias(event)
        assert isinstance(
            event, ScalarEvent | MappingStartEvent | SequenceStartEvent
        )  # nothing else starts a value
        node = self._value(event, path)
        if event.tag:
            self._refuse_tag(event, path)
        if event.anchor:
            self._anchors[event.anchor] = node
        return node

    def _value(self, event: _Start, path: KeyPath) -> Node:
        if isinstance(event, ScalarEvent):
            text = str(event.value)
            return Node("scalar", self._place(event), resolve_scalar(text) if event.style is None else text)
        if isinstance(event, MappingStartEvent):
            return self._bounded(branch("mapping", self._place(event), self._entries(path)))
        return self._bounded(branch("sequence", self._place(event), self._items(path)))

    def _items(self, path: KeyPath) -> dict[str | int, Node]:
        items: dict[str | int, Node] = {}
        while not isinstance(event := self._next(), SequenceEndEvent):
            items[len(items)] = self._node(event, (*path, len(items)))
        return items

    def _entries(self, path: KeyPath) -> dict[str | int, Node]:
        entries: dict[str | int, Node] = {}
        while not isinstance(event := self._next(), MappingEndEvent):
            key, place = self._key(event, path), self._place(event)
            node = self._node(self._next(), (*path, key or "?"))
            nothing = node.kind == "scalar" and node.scalar is None  # the parser places it at what follows
            node = replace(node, key_place=place, place=place if nothing else node.place)
            if key in entries:
                hint = f"first on line {entries[key].key.line}; keep one of the two"
                self._fault(event, (*path, key), f"the key stands twice, here with {node.shown()}", hint)
            elif key is not None:
                entries[key] = node
        return entries

    def _key(self, event: Event, path: KeyPath) -> str | None:
        """Return the key, or None for one that no file of ours can have; its fault is noted."""
        if not isinstance(event, ScalarEvent):
            self._node(event, (*path, "?"))
            self._fault(event, path, "a key must be a plain word", "brackets before a colon need quotes")
            return None
        if event.value == "<<" and event.style is None:
            self._fault(event, path, "merge keys (<<) are not part of YAML 1.2", "write the keys out")
            return None
        return str(event.value)

    def _alias(self, event: AliasEvent) -> Node:
        if event.anchor not in self._anchors:
            hint = "define it first with &name, or quote the text if the * is meant"
            raise self._stopped(Fault(self._place(event), (), f"*{event.anchor} is not defined above", hint))
        return self._anchors[event.anchor]

    def _bounded(self, node: Node) -> Node:
        if node.size > MAX_VALUES:
            message = f"holds {node.size} values, at most {MAX_VALUES} are read"
            raise self._stopped(Fault(node.place, (), message))
        if node.height > MAX_DEPTH + 1:  # the top counts no level
            raise self._stopped(Fault(node.place, (), f"nested deeper than {MAX_DEPTH} levels"))
        return node

    def _refuse_tag(self, event: _Start, path: KeyPath) -> None:
        tag = str(event.tag).replace("tag:yaml.org,2002:", "!!")
        self._fault(event, path, f"the tag {tag} is not known here, values carry no tags", "delete the tag")

    def _fault(self, event: Event, path: KeyPath, message: str, hint: str = "") -> None:
        self.faults.append(Fault(self._place(event), path, message, hint))

    def _place(self, event: Event) -> Place:
        return Place(self._source, event.start_mark.line + 1, event.start_mark.column + 1)


def _syntax_fault(error: MarkedYAMLError, source: str) -> Fault:
    said = str(error.problem or error.context)
    words, hint = next(((words, hint) for part, words, hint in _SYNTAX_WORDS if part in said), (said, ""))
    mark = error.context_mark if "line named here" in hint and error.context_mark else error.problem_mark
    place = Place(source, mark.line + 1, mark.column + 1) if mark else Place(source)
    return Fault(place, (), f"this is not YAML: {words}", hint)


def _character_fault(error: ReaderError, text: str, source: str) -> Fault:
    before = text[: error.position]
    place = Place(source, before.count("\n") + 1, error.position - (before.rfind("\n") + 1) + 1)
    message = f"the control character U+{error.character:04X} cannot stand in YAML"
    return Fault(place, (), message, "delete it; it may be invisible in your editor")
