"""YAML file -> tree of values with positions, without any model; a search over runs needs no more."""

import difflib
from codecs import BOM_UTF8
from collections.abc import Mapping
from pathlib import Path

from labrig.errors import FileFormatError
from labrig.protocol.formatting import Plain
from labrig.protocol.tree import InputFault, Position, Tree, file_format_error
from labrig.protocol.yaml_text import read_tree

_SUFFIXES = frozenset({".yaml", ".yml", ".json"})
MAX_BYTES = 256 * 1024  # a hundred times a long protocol; ruamel.yaml reads about 150 kB a second


def load_yaml_values(path: Path | str) -> dict[str, Plain]:
    """Return what a YAML file says, of whatever kind it is, as JSON would hold it.

    Raises
    ------
    FileFormatError
        When it is no YAML, or holds no mapping.
    """
    return _values(load_tree(Path(path)))


def parse_yaml_values(text: str, source: str) -> dict[str, Plain]:
    """Return what a YAML text says; `source` names it in messages. Raises as `load_yaml_values`."""
    return _values(read_tree(text, source))


def _values(tree: Tree) -> dict[str, Plain]:
    if tree.faults:
        raise file_format_error(list(tree.faults))
    return tree.section(())


def load_tree(path: Path) -> Tree:
    """Return the mapping that a file holds, with places. Raises `FileFormatError`."""
    content = _read_bytes(path).removeprefix(BOM_UTF8)
    try:
        return read_tree(_decoded(content, str(path)), str(path))
    except FileFormatError as error:
        if path.suffix in _SUFFIXES:
            raise
        raise _unreadable(path, "this is no YAML file", _nearby_hint(path.parent / "x.yaml")) from error


def require_kind(tree: Tree, others: Mapping[str, tuple[str, str]]) -> None:
    """Refuse a file of another kind in one sentence, instead of every key that it has not.

    Parameters
    ----------
    others : mapping of str to (str, str)
        A key that only files of another kind have -> what such a file is, and what to do.

    Raises
    ------
    FileFormatError
    """
    for key, (message, hint) in others.items():
        if tree.holds((key,)):
            raise file_format_error([InputFault(tree.at((key,)).key, (key,), message, hint)])


def _read_bytes(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except FileNotFoundError as error:
        raise _unreadable(path, "there is no such file", _nearby_hint(path)) from error
    except IsADirectoryError as error:
        raise _unreadable(path, "this is a folder, expected a YAML file", _nearby_hint(path / "x")) from error
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = getattr(error, "strerror", None) or str(error)
        raise _unreadable(path, f"cannot be read: {reason}", "check the name and the permissions") from error
    if len(content) > MAX_BYTES:
        message = f"larger than {MAX_BYTES // 1024} kB, expected a file written by hand"
        raise _unreadable(path, message, "is this the right file?")
    return content


def _decoded(content: bytes, source: str) -> str:
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        before = content[: error.start].decode("utf-8")
        position = Position(source, before.count("\n") + 1, len(before) - before.rfind("\n"))
        message = f"the byte 0x{content[error.start]:02x} is not UTF-8, expected text in UTF-8"
        raise file_format_error(
            [InputFault(position, (), message, "save the file as UTF-8 in your editor")]
        ) from error


def _unreadable(path: Path, message: str, hint: str) -> FileFormatError:
    return file_format_error([InputFault(Position(str(path)), (), message, hint)])


def _nearby_hint(path: Path) -> str:
    """Return the YAML files beside `path`, or the one that was probably meant."""
    if not path.parent.is_dir():
        return f"the folder {path.parent} does not exist"
    names = sorted(each.name for each in path.parent.iterdir() if each.suffix in _SUFFIXES)
    if meant := difflib.get_close_matches(path.name, names, n=1):
        return f"did you mean {path.parent / meant[0]}?"
    return f"YAML files there: {', '.join(names[:10])}" if names else f"{path.parent} holds no YAML file"
