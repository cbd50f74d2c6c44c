"""YAML 1.2 text -> tree of values with positions.

ruamel.yaml composes the nodes. They are read here and not by its constructor, because a protocol needs only the core
schema of YAML 1.2 (no tags, dates or merge keys, so `no` is a word and `12:30` a text), but also a position for every
key and value, all faults instead of the first, and bounds on depth and on what aliases expand to.
"""

import re
from collections.abc import Callable
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.composer import Composer, ComposerError, MaxDepthExceededError
from ruamel.yaml.error import MarkedYAMLError, StreamMark
from ruamel.yaml.events import AliasEvent, DocumentStartEvent, Event
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

# Part of the parser's message -> what it means, and what to do about it.
_SYNTAX_WORDS = (
    ("'\\t'", "a tab where only spaces are allowed", "indent with spaces"),
    (
        "mapping values are not allowed",
        "this colon does not follow a key",
        "text with a colon needs quotes; check the indent",
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
    ("found another document", "a second document starts here, expected one", "delete this ---"),
    ("maximum depth", f"nested deeper than {MAX_DEPTH} levels", ""),
)


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
    position, found = tree.at(()).value, f"holds {show(tree.values)}"
    if isinstance(tree.values, list):
        hint = "the top holds `key: value` lines"
    elif tree.values is not None:
        hint = "a key needs a colon and a space: `key: value`"
    else:
        position, found, hint = Position(source), "is empty", "is it the right file?"
    fault = InputFault(position, (), f"the file {found}, expected keys and values", hint)
    raise file_format_error([*tree.faults, fault])


def compose(text: str, source: str) -> Tree:
    """Return the value in `text`, of any kind, with the faults that did not stop the reading.

    Raises
    ------
    FileFormatError
        As `read_tree`, except that any value may be at the top.
    """
    yaml: Any = YAML(typ="safe", pure=True)  # its attributes are typed by their defaults, None
    yaml.Composer = _Composer
    yaml.max_depth = MAX_DEPTH + 1  # the top counts no level
    try:
        root = yaml.compose(text)
    except MarkedYAMLError as error:
        raise file_format_error([_syntax_fault(error, source)]) from error
    except ReaderError as error:
        raise file_format_error([_character_fault(error, text, source)]) from error
    except (ValueError, OverflowError) as error:  # an escape beyond Unicode, such as "\UFFFFFFFF"
        fault = InputFault(Position(source), (), "an escape in double quotes names no character")
        raise file_format_error([fault]) from error
    if root is None:
        return Tree(None, {(): EntryPosition(Position(source), Position(source))})
    reader = _NodeReader(source, [])
    reader.check_version(yaml.composer.start)
    values = reader.read(root, (), root)
    return Tree(values, reader.positions, tuple(reader.faults))


class _RefusedError(ComposerError):
    """Something that YAML allows and a protocol does not."""

    def __init__(self, message: str, mark: StreamMark, hint: str = "") -> None:
        super().__init__(None, None, message, mark, hint)


class _Composer(Composer):
    """The composer of ruamel.yaml with bounds; a node keeps a tag only if the text has one."""

    def __init__(self, loader: Any = None) -> None:
        super().__init__(loader)
        self.warn_double_anchors = False  # the later anchor counts
        self.start: Any = None
        self._values = 0
        self._extents: dict[int, tuple[int, int]] = {}

    def compose_document(self) -> Any:
        self.start = self.parser.peek_event()
        return super().compose_document()

    def compose_node(self, parent: Node | None, index: Node | int | None) -> Any:
        event = self.parser.peek_event()
        is_key = isinstance(parent, MappingNode) and index is None
        self._values += not is_key
        if self._values > MAX_VALUES:  # the extent of a list is known only at its end
            message = f"holds more than {MAX_VALUES} values, at most {MAX_VALUES} are read"
            raise _RefusedError(message, event.start_mark)
        if isinstance(event, AliasEvent):
            self._check_alias(event, is_key=is_key)
            return super().compose_node(parent, index)
        node = super().compose_node(parent, index)
        node.ctag = event.ctag
        self._check_extent(node)
        return node

    def _check_alias(self, event: AliasEvent, *, is_key: bool) -> None:
        anchored = self.anchors.get(event.anchor)
        if anchored is None or anchored.end_mark is None:  # a value must not contain itself
            hint = "define it first with &name, or quote the text if the * is meant"
            raise _RefusedError(f"*{event.anchor} is not defined above", event.start_mark, hint)
        if is_key:
            raise _RefusedError("a key must be a plain word", event.start_mark, "write the key out")

    def _check_extent(self, node: Node) -> None:
        """Count values and levels with aliases expanded, so that a short file cannot fill the memory."""
        children = () if isinstance(node, ScalarNode) else node.value
        extents = [self._extents[id(child[1] if isinstance(child, tuple) else child)] for child in children]
        size = 1 + sum(size for size, _ in extents)
        height = 1 + max((height for _, height in extents), default=0)
        if size > MAX_VALUES:
            raise _RefusedError(f"holds {size} values, at most {MAX_VALUES} are read", node.start_mark)
        if height > MAX_DEPTH + 1:
            raise _RefusedError(f"nested deeper than {MAX_DEPTH} levels", node.start_mark)
        self._extents[id(node)] = size, height


class _NodeReader:
    """Reads the values of nodes; collects their positions and faults."""

    def __init__(self, source: str, faults: list[InputFault]) -> None:
        self._source = source
        self.positions: dict[tuple[str, ...], EntryPosition] = {}
        self.faults = faults

    def check_version(self, start: DocumentStartEvent) -> None:
        """Add a fault if the file declares another version of YAML."""
        if start.version not in (None, (1, 2)):
            found = ".".join(map(str, start.version))
            self._add_fault(
                start, (), f"the file declares YAML {found}, expected 1.2", "delete the %YAML line"
            )

    def read(self, node: Node, path: tuple[str, ...], key: Node) -> Plain:
        """Return the value of `node`, whose path is `path` and whose key is `key`."""
        if node.ctag:
            tag = str(node.ctag).replace("tag:yaml.org,2002:", "!!")
            self._add_fault(
                node, path, f"the tag {tag} is not allowed, values have no tags", "delete the tag"
            )
        value = self._read_value(node, path)
        # The parser puts an empty value where the next key is.
        position = self._position(key if value is None else node)
        self.positions[path] = EntryPosition(self._position(key), position)
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
            name = self._read_key(key, path)
            inner = (*path, "?" if name is None else name)
            is_new = name is not None and name not in section
            # The positions of the first of two equal keys are kept.
            reader = self if is_new else _NodeReader(self._source, self.faults)
            value = reader.read(child, inner, key)
            if name in section:
                hint = f"first on line {self.positions[inner].key.line}; keep one of the two"
                self._add_fault(key, inner, f"the key is given twice, here with {show(value)}", hint)
            elif name is not None:
                section[name] = value
        return section

    def _read_key(self, key: Node, path: tuple[str, ...]) -> str | None:
        """Return the key; add a fault and return None for a key that is not allowed."""
        if not isinstance(key, ScalarNode):
            self._add_fault(key, path, "a key must be a plain word", "brackets before a colon need quotes")
            return None
        if key.value == "<<" and key.style is None:
            self._add_fault(key, path, "merge keys (<<) are not part of YAML 1.2", "write the keys out")
            return None
        return str(key.value)

    def _add_fault(self, at: Node | Event, path: tuple[str, ...], message: str, hint: str) -> None:
        self.faults.append(InputFault(self._position(at), path, message, hint))

    def _position(self, at: Node | Event) -> Position:
        return Position(self._source, at.start_mark.line + 1, at.start_mark.column + 1)


def _syntax_fault(error: MarkedYAMLError, source: str) -> InputFault:
    problem, note = (
        str(error.problem or error.context),
        error.note if isinstance(error, _RefusedError) else "",
    )
    matches = ((words, hint) for part, words, hint in _SYNTAX_WORDS if part in problem)
    words, hint = next(matches, (problem, note))
    mark = error.context_mark if "line named here" in hint and error.context_mark else error.problem_mark
    position = Position(source, mark.line + 1, mark.column + 1) if mark else Position(source)
    is_syntax = not isinstance(error, ComposerError | MaxDepthExceededError)
    return InputFault(position, (), "this is not YAML: " * is_syntax + words, hint)


def _character_fault(error: ReaderError, text: str, source: str) -> InputFault:
    before = text[: error.position]
    position = Position(source, before.count("\n") + 1, error.position - (before.rfind("\n") + 1) + 1)
    message = f"the control character U+{error.character:04X} is not allowed in YAML"
    return InputFault(position, (), message, "delete it; it may be invisible in your editor")
