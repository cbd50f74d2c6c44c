"""YAML 1.2, a text or a file -> tree of values with positions.

ruamel.yaml composes the nodes and reads the scalars. The nodes are joined here and not by its constructor, because a
file that people write has no tags and no dates, and needs a position for every key, all faults instead of the first,
and bounds on depth and on what aliases expand to.
"""

from codecs import BOM_UTF8
from copy import deepcopy
from functools import lru_cache
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, StreamMark
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode
from ruamel.yaml.reader import ReaderError

from labrig.errors import FileFormatError
from labrig.input_file import open_file
from labrig.protocol.tree import (
    InputFault,
    Plain,
    Position,
    Scalar,
    Tree,
    choice_hint,
    file_format_error,
    show,
)

MAX_BYTES = 256 * 1024  # a hundred times a long protocol; ruamel.yaml reads about 150 kB a second
MAX_DEPTH = 20
MAX_VALUES = 20_000

_HINT = "check the indentation (spaces, no tabs), and that each quote and bracket is closed"
_TAG = "tag:yaml.org,2002:"
_READ_SCALARS = {_TAG + kind for kind in ("int", "float", "bool", "null")}
# Tags that the parser gives to values without one; of scalars, those that are not read are texts.
_OWN_TAGS = _READ_SCALARS | {_TAG + kind for kind in ("str", "seq", "map", "timestamp", "merge", "value")}


def _make_yaml() -> Any:
    """Return ruamel's reader; its attributes are typed by their defaults, None."""
    yaml = YAML(typ="safe", pure=True)
    yaml.max_depth = MAX_DEPTH + 1  # the top counts no level
    return yaml


def resolve_scalar(text: str) -> Scalar:
    """Return the value of an unquoted text."""
    yaml = _make_yaml()
    return _read_scalar(yaml, ScalarNode(yaml.resolver.resolve(ScalarNode, text, (True, False)), text))


def _read_scalar(yaml: Any, node: Node) -> Scalar:
    """Return the value of a scalar; a date is a text."""
    is_read = str(node.tag) in _READ_SCALARS  # which no quoted one is
    value: Scalar = yaml.constructor.construct_object(node) if is_read else str(node.value)
    return value


def load_yaml_values(path: Path | str) -> dict[str, Plain]:
    """Return the values of a YAML file of any kind, as in JSON.

    Raises
    ------
    FileFormatError
        When it is not YAML, or holds no mapping.
    """
    tree = load_tree(Path(path))
    if tree.faults:
        raise file_format_error(tree.faults)
    return deepcopy(tree.section(()))  # the caller's own


def load_tree(path: Path) -> Tree:
    """Return the mapping in a file, with positions. Raises `FileFormatError`."""
    return read_tree(_read_bytes(path).removeprefix(BOM_UTF8), str(path))


def _read_bytes(path: Path) -> bytes:
    try:
        with open_file(path) as file:
            content = file.read(MAX_BYTES + 1)
    except OSError as error:
        is_missing = isinstance(error, FileNotFoundError)
        message = "there is no such file" if is_missing else f"cannot be read: {error.strerror}"
        fault = InputFault(Position(str(path)), (), message, _hint_at_files(path))
        raise file_format_error([fault]) from error
    if len(content) > MAX_BYTES:
        message = f"larger than {MAX_BYTES // 1024} kB, expected a file written by hand"
        raise file_format_error([InputFault(Position(str(path)), (), message, "is this the right file?")])
    return content


def _hint_at_files(path: Path) -> str:
    """Return a hint: the file that `path` probably means, or the YAML files beside it, or in it if it is a folder."""
    try:
        folder = path if path.is_dir() else path.parent
        files = (file for file in folder.iterdir() if file.suffix in {".yaml", ".yml", ".json"})
        names = sorted(file.name for file in files if ".schema" not in file.name)
    except (OSError, ValueError):
        return f"there is no folder {path.parent} that can be read"
    return choice_hint(path.name, names) if names else f"{folder} holds no YAML file"


def read_tree(text: str | bytes, source: str) -> Tree:
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
    raise file_format_error([*tree.faults, tree.fault((), message, "a line is `key: value`, with a space")])


@lru_cache(maxsize=32)  # a run reads each of its files several times; a tree is never changed
def compose(text: str | bytes, source: str) -> Tree:
    """Return the value in `text`, of any kind, with the faults that did not stop the reading.

    Raises
    ------
    FileFormatError
        As `read_tree`, except that any value may be at the top.
    """
    yaml = _make_yaml()
    reader = _NodeReader(source, yaml)
    try:
        root = yaml.compose(text)
        values = None if root is None else reader.read(root, (), root)
    except MarkedYAMLError as error:
        problem = " ".join(filter(None, (error.context, error.problem)))
        # Where a block begins does not tell where it breaks.
        mark = None if "block mapping" in (error.context or "") else error.context_mark
        where = reader.locate(mark or error.problem_mark)
        raise reader.refuse(where, f"this is not YAML: {problem}", _HINT) from error
    except ReaderError as error:  # control characters, and bytes that are not UTF-8
        before = text[: error.position]
        before = before if isinstance(before, str) else before.decode()
        position = Position(source, before.count("\n") + 1, len(before) - before.rfind("\n"))
        reason = f"this is not YAML in UTF-8: {error.reason}"
        raise reader.refuse(position, reason, "save the file as UTF-8 in your editor") from error
    except FileFormatError:
        raise
    except (ValueError, OverflowError) as error:  # escapes beyond Unicode
        raise reader.refuse(Position(source), f"this is not YAML: {' '.join(str(error).split())}") from error
    return Tree(values, {(): Position(source), **reader.positions}, tuple(reader.faults))


class _NodeReader:
    """Reads the values of nodes; collects their positions and faults."""

    def __init__(self, source: str, yaml: Any) -> None:
        self._source, self._yaml, self._count = source, yaml, 0
        self.positions: dict[tuple[str, ...], Position] = {}
        self.faults: list[InputFault] = []

    def refuse(self, position: Position, message: str, hint: str = "") -> FileFormatError:
        """Return the error of a text that cannot be read on."""
        return file_format_error([InputFault(position, (), message, hint)])

    def read(self, node: Node, path: tuple[str, ...], begin: Node) -> Plain:
        """Return the value of `node`, whose path is `path`, and whose entry begins with the node `begin`."""
        self._count += 1  # with aliases expanded, so that a short file cannot fill the memory
        if self._count > MAX_VALUES:
            raise self.refuse(self.locate(node.start_mark), f"holds more than {MAX_VALUES} values")
        if len(path) > MAX_DEPTH:
            raise self.refuse(self.locate(node.start_mark), f"nested deeper than {MAX_DEPTH} levels")
        if str(node.tag) not in _OWN_TAGS:
            tag = str(node.tag).removeprefix(_TAG)
            message = f"the tag {tag} is not allowed, values have no tags"
            self._add_fault(node, path, message, "delete the tag")
        self.positions.setdefault(path, self.locate(begin.start_mark))
        if isinstance(node, MappingNode):
            return self._read_section(node, path)
        if isinstance(node, SequenceNode):
            return [self.read(entry, (*path, str(index)), entry) for index, entry in enumerate(node.value)]
        return _read_scalar(self._yaml, node)

    def _read_section(self, node: MappingNode, path: tuple[str, ...]) -> dict[str, Plain]:
        section: dict[str, Plain] = {}
        for key, child in node.value:
            if not isinstance(key, ScalarNode):
                self._add_fault(key, path, "a key must be a plain word", "quote brackets before a colon")
                continue
            name = str(key.value)
            inner = (*path, name)
            value = self.read(child, inner, key)
            if name in section:
                hint = f"first on line {self.positions[inner].line}; keep one of the two"
                self._add_fault(key, inner, f"the key is given twice, here with {show(value)}", hint)
            section.setdefault(name, value)
        return section

    def _add_fault(self, at: Node, path: tuple[str, ...], message: str, hint: str) -> None:
        self.faults.append(InputFault(self.locate(at.start_mark), path, message, hint))

    def locate(self, mark: StreamMark | None) -> Position:
        """Return the position of a mark."""
        return Position(self._source, mark.line + 1, mark.column + 1) if mark else Position(self._source)
