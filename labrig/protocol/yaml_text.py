"""YAML 1.2 text -> tree of values with positions.

ruamel.yaml composes the nodes. They are read here and not by its constructor, because a protocol needs only the core
schema of YAML 1.2 (no tags or dates, so `no` is a word and `12:30` a text), but also a position for every key and
value, all faults instead of the first, and bounds on depth and on what aliases expand to.
"""

import re
from collections.abc import Callable
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, StreamMark
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode
from ruamel.yaml.reader import ReaderError

from labrig.protocol.formatting import Plain, Scalar, show
from labrig.protocol.tree import EntryPosition, InputFault, Position, Tree, file_format_error

MAX_DEPTH = 20
MAX_VALUES = 20_000

# The meaning of an unquoted text: the core schema (YAML 1.2, section 10.3.2).
_CORE_SCHEMA: tuple[tuple[str, Callable[[str], Scalar]], ...] = (
    (r"|~|null|Null|NULL", lambda _: None),
    (r"true|True|TRUE|false|False|FALSE", lambda text: text.lower() == "true"),
    (r"[-+]?[0-9]{1,18}", int),  # longer ones become floats
    (r"0o[0-7]{1,18}|0x[0-9a-fA-F]{1,15}", lambda text: int(text, 0)),
    (r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?", float),
    (r"[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)", lambda text: float(text.replace(".", "", 1))),
)
# Tags that the parser gives to values without one.
_OWN_TAGS = {"str", "int", "float", "bool", "null", "seq", "map", "timestamp", "merge", "value"}


class _RefusedError(Exception):
    """Something that YAML allows and a protocol does not."""

    def __init__(self, mark: StreamMark, message: str) -> None:
        super().__init__(message)
        self.mark = mark


def resolve_scalar(text: str) -> Scalar:
    """Return the value of an unquoted text in the core schema."""
    return next((read(text) for pattern, read in _CORE_SCHEMA if re.fullmatch(pattern, text)), text)


def read_tree(text: str, source: str) -> Tree:
    """Return the mapping in `text`; `source` names it in messages.

    Raises
    ------
    FileFormatError
        When the text is not YAML, empty, several documents, no mapping, too deep or too large.
    """
    tree = compose(text, source)
    if isinstance(tree.values, dict):
        return tree
    found = "is empty" if tree.values is None else f"holds {show(tree.values)}"
    message = f"the file {found}, expected keys and values"
    fault = InputFault(tree.at(()).value, (), message, "a line is `key: value`, with a space")
    raise file_format_error([*tree.faults, fault])


def compose(text: str, source: str) -> Tree:
    """Return the value in `text`, of any kind, with the faults that did not stop the reading.

    Raises
    ------
    FileFormatError
        As `read_tree`, except that any value may be at the top.
    """
    yaml: Any = YAML(typ="safe", pure=True)  # its attributes are typed by their defaults, None
    yaml.max_depth = MAX_DEPTH + 1  # the top counts no level
    reader = _NodeReader(source)
    try:
        root = yaml.compose(text)
        values = None if root is None else reader.read(root, (), root)
    except MarkedYAMLError as error:
        problem = " ".join(filter(None, (error.context, error.problem)))
        raise reader.refuse(
            error.context_mark or error.problem_mark, f"this is not YAML: {problem}"
        ) from error
    except _RefusedError as error:
        raise reader.refuse(error.mark, str(error)) from error
    except (ReaderError, ValueError, OverflowError) as error:  # control characters, escapes beyond Unicode
        raise reader.refuse(None, f"this is not YAML: {' '.join(str(error).split())}") from error
    if root is None:
        return Tree(None, {(): EntryPosition(Position(source), Position(source))})
    return Tree(values, reader.positions, tuple(reader.faults))


class _NodeReader:
    """Reads the values of nodes; collects their positions and faults."""

    def __init__(self, source: str) -> None:
        self._source, self._count = source, 0
        self.positions: dict[tuple[str, ...], EntryPosition] = {}
        self.faults: list[InputFault] = []

    def refuse(self, mark: StreamMark | None, message: str) -> Exception:
        """Return the error of a text that cannot be read on."""
        return file_format_error([InputFault(self._locate(mark), (), message)])

    def read(self, node: Node, path: tuple[str, ...], key: Node) -> Plain:
        """Return the value of `node`, whose path is `path` and whose key is `key`."""
        self._count += 1  # with aliases expanded, so that a short file cannot fill the memory
        if self._count > MAX_VALUES:
            raise _RefusedError(node.start_mark, f"holds more than {MAX_VALUES} values")
        if len(path) > MAX_DEPTH:
            raise _RefusedError(node.start_mark, f"nested deeper than {MAX_DEPTH} levels")
        tag = str(node.tag).removeprefix("tag:yaml.org,2002:")
        if tag not in _OWN_TAGS:
            self._add_fault(
                node, path, f"the tag {tag} is not allowed, values have no tags", "delete the tag"
            )
        value = self._read_value(node, path)
        # The parser puts an empty value where the next key is.
        position = self._locate((key if value is None else node).start_mark)
        self.positions.setdefault(path, EntryPosition(self._locate(key.start_mark), position))
        return value

    def _read_value(self, node: Node, path: tuple[str, ...]) -> Plain:
        if isinstance(node, MappingNode):
            return self._read_section(node, path)
        if isinstance(node, SequenceNode):
            return [self.read(entry, (*path, str(index)), entry) for index, entry in enumerate(node.value)]
        plain = isinstance(node, ScalarNode) and node.style is None
        return resolve_scalar(node.value) if plain else str(node.value)

    def _read_section(self, node: MappingNode, path: tuple[str, ...]) -> dict[str, Plain]:
        section: dict[str, Plain] = {}
        for key, child in node.value:
            if not isinstance(key, ScalarNode):
                self._add_fault(
                    key, path, "a key must be a plain word", "brackets before a colon need quotes"
                )
                continue
            name = str(key.value)
            inner = (*path, name)
            value = self.read(child, inner, key)
            if name in section:
                hint = f"first on line {self.positions[inner].key.line}; keep one of the two"
                self._add_fault(key, inner, f"the key is given twice, here with {show(value)}", hint)
            section.setdefault(name, value)
        return section

    def _add_fault(self, at: Node, path: tuple[str, ...], message: str, hint: str) -> None:
        self.faults.append(InputFault(self._locate(at.start_mark), path, message, hint))

    def _locate(self, mark: StreamMark | None) -> Position:
        return Position(self._source, mark.line + 1, mark.column + 1) if mark else Position(self._source)
